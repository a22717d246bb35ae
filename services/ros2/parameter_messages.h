// What a client of rcl_interfaces/srv/GetParameters and SetParametersAtomically sends and receives,
// as CDR payloads without a service header. Decode* fail with DataLoss.
#ifndef RIPS_SERVICES_ROS2_PARAMETER_MESSAGES_H_
#define RIPS_SERVICES_ROS2_PARAMETER_MESSAGES_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/ros2/cdr.h"

namespace rips::ros2 {

inline constexpr char kGetParametersType[] = "rcl_interfaces/srv/GetParameters";
inline constexpr char kSetParametersAtomicallyType[] = "rcl_interfaces/srv/SetParametersAtomically";

// Most parameters in one request or reply, and most elements of one array value.
inline constexpr size_t kParametersMax = 1'024;
inline constexpr size_t kParameterElementsMax = 65'536;

// What a parameter holds. The index of the alternative is rcl_interfaces/msg/ParameterType:
// 0 not set, 1 bool, 2 integer, 3 double, 4 string, 5 byte[], 6 bool[], 7 integer[], 8 double[],
// 9 string[].
struct ByteArray {
  std::string bytes;
  friend bool operator==(const ByteArray&, const ByteArray&) = default;
};
using ParameterValue =
    std::variant<std::monostate, bool, int64_t, double, std::string, ByteArray, std::vector<bool>,
                 std::vector<int64_t>, std::vector<double>, std::vector<std::string>>;

// Fewest bytes of a value: type, bool, two numbers, a string and five sequences, before alignment.
inline constexpr size_t kParameterValueBytesMin = 2 + 2 * 8 + 6 * 4;
void WriteParameterValue(const ParameterValue& value, CdrWriter& writer);
// A failure is recorded in `reader`.
ParameterValue ReadParameterValue(CdrReader& reader);

std::string EncodeGetParametersRequest(const std::vector<std::string>& names);

// One value per requested name, in that order; a node answers with an empty list if it refuses.
absl::StatusOr<std::vector<ParameterValue>> DecodeGetParametersReply(absl::string_view payload);

// SetParametersAtomically: all of them or none.
struct NamedParameter {
  std::string name;
  ParameterValue value;
  friend bool operator==(const NamedParameter&, const NamedParameter&) = default;
};
std::string EncodeSetParametersRequest(const std::vector<NamedParameter>& parameters);

struct SetParametersResult {
  bool successful = false;
  std::string reason;  // the node's own words
  friend bool operator==(const SetParametersResult&, const SetParametersResult&) = default;
};
absl::StatusOr<SetParametersResult> DecodeSetParametersReply(absl::string_view payload);

// As ROS tools print it: "true", "7", "0.5", "text", "[1, 2]"; "not set" for monostate.
std::string ToString(const ParameterValue& value);

}  // namespace rips::ros2

#endif  // RIPS_SERVICES_ROS2_PARAMETER_MESSAGES_H_

// What the policy server wants to be told of each topic: an ordered table, the first match wins.
#ifndef RIPS_SENSOR_AGENT_INTEREST_H_
#define RIPS_SENSOR_AGENT_INTEREST_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "re2/re2.h"

namespace rips::sensor {

struct InterestRule {
  // RE2, searched in the topic name; empty = every topic.
  std::string topic_regex;
  // Exact ROS type; empty = any.
  std::string type;
  // First bytes of each payload that are sent along; 0 = metadata only.
  uint32_t payload_bytes_max = 0;
};

// Bytes of a table's id.
inline constexpr size_t kInterestIdBytes = 32;
inline constexpr size_t kInterestRulesMax = 1'024;
// RE2 instructions of all patterns of a table.
inline constexpr size_t kInterestInstructionsMax = 200'000;
// RE2's memory for a pattern; for one that does not fit, the larger. The number of larger ones is
// bounded by their instructions.
inline constexpr int64_t kInterestPatternBytes = int64_t{64} << 10;
inline constexpr int64_t kInterestPatternBytesMax = int64_t{1} << 20;
// Whatever a rule asks for, this much of a payload is sent at most.
inline constexpr uint32_t kPayloadBytesMax = 64 * 1024;

// Immutable; any thread.
class Interest {
 public:
  // InvalidArgument: an id of another length, a bad pattern. ResourceExhausted: past a limit. The
  // message names the rule, counted from 1.
  static absl::StatusOr<std::shared_ptr<const Interest>> Create(std::string id,
                                                                std::vector<InterestRule> rules);

  const std::string& id() const { return id_; }
  // At most kPayloadBytesMax. Topics that no rule is about are watched as metadata: 0.
  uint32_t PayloadBytes(absl::string_view topic, absl::string_view type) const;

 private:
  struct Rule {
    std::unique_ptr<const RE2> topic;  // null = every topic
    std::string type;
    uint32_t payload_bytes_max = 0;
  };
  explicit Interest(std::string id) : id_(std::move(id)) {}

  const std::string id_;
  std::vector<Rule> rules_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_INTEREST_H_

// Schemas, channels and messages of an MCAP file. Internal to this folder.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_MCAP_CHANNELS_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_MCAP_CHANNELS_H_

#include <cstdint>
#include <string>

#include "absl/container/flat_hash_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/recording/recorded.h"

namespace rips::recording {

// Record opcodes (MCAP specification, "Records").
enum class McapOp : uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kDataEnd = 0x0f,
};

// Opcode and content length.
inline constexpr size_t kMcapRecordHeaderBytes = 9;

struct McapMessage {
  uint16_t channel = 0;
  int64_t log_time_ns = 0;
  // Into the record's content.
  absl::string_view payload;
};

// Not thread-safe. Every function takes the content of one record; messages of errors say what is
// wrong, not where.
class McapChannels {
 public:
  // DataLoss: cut, an id of 0, another schema or channel under a known id, a schema that was not
  // defined. InvalidArgument: message encoding not `cdr`. ResourceExhausted: a long name.
  absl::Status AddSchema(absl::string_view content);
  absl::Status AddChannel(absl::string_view content);

  // DataLoss: cut, unknown channel, a time beyond int64. ResourceExhausted: a large payload.
  absl::StatusOr<McapMessage> Parse(absl::string_view content) const;
  // `message` was parsed by this.
  Recorded Resolve(const McapMessage& message) const;

 private:
  struct Channel {
    uint16_t schema = 0;
    std::string topic;
    std::string type;

    friend bool operator==(const Channel&, const Channel&) = default;
  };

  // Names by schema id.
  absl::flat_hash_map<uint16_t, std::string> schemas_;
  absl::flat_hash_map<uint16_t, Channel> channels_;
};

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_MCAP_CHANNELS_H_

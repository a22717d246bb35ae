// Between rips-actuator and rips-exec: rips.v1.ExecCall and rips.v1.ExecAnswer, whose order
// helper.proto gives. A message is sent as packets: `+` and bytes, the last one `.` and bytes.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_MESSAGE_H_
#define RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_MESSAGE_H_

#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/port/program_runner.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {

inline constexpr size_t kExecPacketBytesMax = 16 << 10;
// A call with kArgsMax arguments of kArgBytesMax bytes fits.
inline constexpr size_t kExecMessageBytesMax = 288 << 10;
// Of each text of an answer; longer ones are cut.
inline constexpr size_t kExecTextBytesMax = 2048;
inline constexpr absl::Duration kExecTimeoutMax = absl::Hours(24);

// InvalidArgument past kArgsMax or kArgBytesMax, or if one holds a NUL byte.
absl::Status CheckProgramArgs(const std::vector<std::string>& args);

enum class ExecVerb { kStart = 1, kCancel, kExamine };

struct ExecCall {
  ExecVerb verb = ExecVerb::kCancel;
  ProgramRequest program;  // of kStart; of kExamine only its name
};

struct ExecAnswer {
  enum class Kind { kExamined = 1, kBegun, kEnded };
  Kind kind = Kind::kEnded;
  absl::Duration timeout;  // of kBegun: the time after which it is killed
  ProgramResult result;    // of kEnded; of kExamined only its status
};

// A timeout that is none, or more than kExecTimeoutMax, stands for the program's own.
std::string EncodeExecCall(const ExecCall& call);
// InvalidArgument for anything that EncodeExecCall does not give.
absl::StatusOr<ExecCall> DecodeExecCall(absl::string_view message);

std::string EncodeExecAnswer(const ExecAnswer& answer);
// DataLoss for anything that EncodeExecAnswer does not give.
absl::StatusOr<ExecAnswer> DecodeExecAnswer(absl::string_view message);

// At most kExecPacketBytesMax bytes each.
std::vector<std::string> SplitIntoPackets(absl::string_view message);

// The way back. One thread at a time.
class PacketJoiner {
 public:
  // True when `*message` is whole; then the next one begins. InvalidArgument if this is no such
  // packet, ResourceExhausted if the message exceeds kExecMessageBytesMax.
  absl::StatusOr<bool> Add(absl::string_view packet, std::string* message);

 private:
  std::string parts_;
};

// One connection between rips-actuator and rips-exec: messages in and out, nothing blocks. One
// thread at a time.
class ExecChannel {
 public:
  // A connected Unix socket of sequential packets that does not block.
  explicit ExecChannel(UniqueFd fd) : fd_(std::move(fd)) {}

  void Send(absl::string_view message);
  // Writes what there is room for. Aborted: the other side has closed; what was not written is
  // dropped.
  absl::Status Flush();
  bool unsent() const { return !out_.empty(); }

  // The next whole message; none: not there yet. OutOfRange: the other side has closed. Aborted: it
  // closed without reading all we sent; ask again for what it said before. InvalidArgument and
  // ResourceExhausted: it sends what no message is made of.
  absl::StatusOr<std::optional<std::string>> Receive();

  // Events to poll for.
  short events() const;
  int fd() const { return fd_.get(); }

 private:
  UniqueFd fd_;
  std::deque<std::string> out_;  // packets
  PacketJoiner joiner_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_MESSAGE_H_

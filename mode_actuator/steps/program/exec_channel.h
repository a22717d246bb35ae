// One connection between rips-actuator and rips-exec: messages in and out, nothing blocks.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_CHANNEL_H_
#define RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_CHANNEL_H_

#include <deque>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/steps/program/exec_message.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {

// One thread at a time.
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

#endif  // RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_CHANNEL_H_

#include "mode_actuator/steps/program/exec_channel.h"

#include <poll.h>

#include <utility>

#include "services/base/status_macros.h"
#include "services/local_socket/helper_socket.h"

namespace rips::actuator {

void ExecChannel::Send(absl::string_view message) {
  for (std::string& packet : SplitIntoPackets(message)) out_.push_back(std::move(packet));
}

absl::Status ExecChannel::Flush() {
  while (!out_.empty()) {
    const absl::Status sent = SendPacket(fd_.get(), out_.front());
    if (absl::IsUnavailable(sent)) return absl::OkStatus();
    if (!sent.ok()) {
      out_.clear();
      return sent;
    }
    out_.pop_front();
  }
  return absl::OkStatus();
}

absl::StatusOr<std::optional<std::string>> ExecChannel::Receive() {
  while (true) {
    const absl::StatusOr<std::string> packet = ReceivePacket(fd_.get(), kExecPacketBytesMax);
    if (absl::IsUnavailable(packet.status())) return std::nullopt;
    RIPS_RETURN_IF_ERROR(packet.status());
    std::string message;
    RIPS_ASSIGN_OR_RETURN(const bool whole, joiner_.Add(*packet, &message));
    if (whole) return message;
  }
}

short ExecChannel::events() const {
  return static_cast<short>(POLLIN | POLLRDHUP | (out_.empty() ? 0 : POLLOUT));
}

}  // namespace rips::actuator

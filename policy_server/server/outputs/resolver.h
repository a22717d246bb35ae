// Addresses of a host, within a time, and TCP connections to them. Shared by connections only.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_RESOLVER_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_RESOLVER_H_

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/outputs/deadline.h"
#include "services/runtime/unique_fd.h"
#include "services/runtime/wake_fd.h"

namespace rips::outputs {

// Waits until `fd` is ready for `events` of poll(). DeadlineExceeded, or Cancelled if `stop` is
// woken.
absl::Status AwaitFd(int fd, short events, const Deadline& deadline, const WakeFd& stop,
                     absl::string_view doing);

// Names that are resolved at the same time, at most. getaddrinfo cannot be ended: while no name
// server answers, each waits in a thread of its own, for longer than its caller does.
inline constexpr int kLookupsMax = 32;
// One of them, until it is destroyed; null = none is free. Any thread.
std::shared_ptr<void> TakeLookup();

// A connected socket that does not block, to the first address of the host that takes it; each gets
// an equal share of the time that is left. Unavailable, DeadlineExceeded or Cancelled.
absl::StatusOr<UniqueFd> ConnectTo(const std::string& host, int port, const Deadline& deadline,
                                   const WakeFd& stop);

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_RESOLVER_H_

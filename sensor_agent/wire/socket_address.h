// Addresses of local sockets.
#ifndef RIPS_SENSOR_AGENT_WIRE_SOCKET_ADDRESS_H_
#define RIPS_SENSOR_AGENT_WIRE_SOCKET_ADDRESS_H_

#include <sys/socket.h>
#include <sys/un.h>

#include <string>

#include "absl/status/statusor.h"
#include "services/runtime/unique_fd.h"

namespace rips::wire {

// InvalidArgument unless `path` is absolute and fits (107 bytes).
absl::StatusOr<sockaddr_un> LocalAddress(const std::string& path);

// A connection to `path`, on which packets keep their boundaries; it does not block. Unavailable if
// nobody listens there, otherwise the system's error.
absl::StatusOr<UniqueFd> ConnectLocal(const std::string& path);

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_SOCKET_ADDRESS_H_

// Which of many sockets anything happened on since the last look, without a system call for each.
#ifndef RIPS_SERVICES_RPC_SOCKET_ACTIVITY_H_
#define RIPS_SERVICES_RPC_SOCKET_ACTIVITY_H_

#include "absl/container/flat_hash_set.h"
#include "services/runtime/unique_fd.h"

namespace rips::rpc {

// Edges of epoll(7): bytes came, read since or not, or a side was closed. Missed are bytes that
// were read already on a socket that cannot be written to, since its peer does not read. Look on
// one thread; Add and Remove on any.
class SocketActivity {
 public:
  SocketActivity();

  // False: it is not watched (descriptors or the kernel's watches have run out), and the caller has
  // to ask it itself.
  bool Add(int socket);
  // Before `socket` is closed: the kernel forgets it only when all its duplicates are closed.
  void Remove(int socket);
  // Those on which something happened since the last look. One that was removed meanwhile may be
  // among them.
  absl::flat_hash_set<int> Look();

 private:
  UniqueFd epoll_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_SOCKET_ACTIVITY_H_

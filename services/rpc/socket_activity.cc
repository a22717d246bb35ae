#include "services/rpc/socket_activity.h"

#include <sys/epoll.h>

#include <array>
#include <cstddef>

namespace rips::rpc {

SocketActivity::SocketActivity() : epoll_(epoll_create1(EPOLL_CLOEXEC)) {}

bool SocketActivity::Add(int socket) {
  epoll_event event = {};
  // At a look, the kernel asks anew each socket that an edge was on, and drops it if nothing is
  // ready: EPOLLOUT keeps those whose bytes were read meanwhile.
  event.events = EPOLLIN | EPOLLOUT | EPOLLRDHUP | EPOLLET;
  event.data.fd = socket;
  return epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, socket, &event) == 0;
}

void SocketActivity::Remove(int socket) { epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, socket, nullptr); }

absl::flat_hash_set<int> SocketActivity::Look() {
  absl::flat_hash_set<int> active;
  std::array<epoll_event, 512> events;
  while (true) {
    const int count = epoll_wait(epoll_.get(), events.data(), static_cast<int>(events.size()), 0);
    for (int i = 0; i < count; ++i) active.insert(events[static_cast<size_t>(i)].data.fd);
    if (count < static_cast<int>(events.size())) return active;
  }
}

}  // namespace rips::rpc

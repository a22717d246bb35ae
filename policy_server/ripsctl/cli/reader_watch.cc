#include "policy_server/ripsctl/cli/reader_watch.h"

#include <poll.h>

#include <cerrno>
#include <iterator>
#include <utility>

namespace rips::ripsctl {

ReaderWatch::ReaderWatch(int fd, std::function<void()> on_gone) {
  if (fd < 0) return;
  thread_ = std::thread([this, fd, on_gone = std::move(on_gone)] {
    // Asks for no event: only the end of the other side wakes it, which a file does not have.
    pollfd fds[] = {{.fd = fd, .events = 0, .revents = 0},
                    {.fd = stop_.get(), .events = POLLIN, .revents = 0}};
    while (poll(fds, std::size(fds), -1) < 0 && errno == EINTR) {
    }
    if (fds[1].revents != 0 || (fds[0].revents & (POLLERR | POLLHUP)) == 0) return;
    gone_ = true;
    on_gone();
  });
}

ReaderWatch::~ReaderWatch() {
  stop_.Wake();
  if (thread_.joinable()) thread_.join();
}

}  // namespace rips::ripsctl

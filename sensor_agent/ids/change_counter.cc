#include "sensor_agent/ids/change_counter.h"

#include <sys/inotify.h>
#include <unistd.h>

#include <string>

#include "absl/strings/str_cat.h"

namespace rips::sensor {

void ChangeCounter::Watch(int fd) {
  Stop();
  const std::string opened = absl::StrCat("/proc/self/fd/", fd);
  // Where the file really is, if its path is a link; the end tells if it is deleted.
  std::string real(4'096, '\0');
  const ssize_t size = readlink(opened.c_str(), real.data(), real.size());
  if (size <= 0 || static_cast<size_t>(size) == real.size()) return;
  real.resize(static_cast<size_t>(size));
  inotify_ = UniqueFd(inotify_init1(IN_NONBLOCK | IN_CLOEXEC));
  if (inotify_.get() < 0) return;
  directory_ = inotify_add_watch(inotify_.get(), real.substr(0, real.rfind('/') + 1).c_str(),
                                 IN_MODIFY | IN_ONLYDIR);
  if (directory_ < 0) return;
  file_ = inotify_add_watch(inotify_.get(), opened.c_str(), IN_MODIFY);
}

void ChangeCounter::Look() {
  const std::optional<uint64_t> more = Take();
  if (!more.has_value()) {
    changes_.reset();
  } else if (changes_.has_value()) {
    *changes_ += *more;
  }
}

// Nullopt: not known.
std::optional<uint64_t> ChangeCounter::Take() {
  if (inotify_.get() < 0 || file_ < 0) return std::nullopt;
  bool known = true;
  uint64_t changes = 0;
  int before = -1;
  alignas(inotify_event) char events[16 * 1024];
  while (true) {
    const ssize_t size = read(inotify_.get(), events, sizeof(events));
    if (size <= 0) break;
    for (const char* at = events; at < events + size;) {
      const auto* event = reinterpret_cast<const inotify_event*>(at);
      at += sizeof(inotify_event) + event->len;
      known = known && (event->mask & (IN_Q_OVERFLOW | IN_IGNORED)) == 0;
      if (event->wd == file_) {
        ++changes;
        // Without that of the directory, this may be several.
        known = known && before == directory_;
      }
      before = event->wd;
    }
  }
  return known ? std::optional<uint64_t>(changes) : std::nullopt;
}

}  // namespace rips::sensor

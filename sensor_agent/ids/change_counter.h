// Counts the changes of a file's content: each write, and each truncation.
//
// inotify folds equal events in a row into one, so a watch of the file alone cannot tell a write
// that was followed by a truncation from a truncation. With a watch of its directory besides, each
// change makes an event of the directory and then one of the file, and none equals the one before.
//
// Two changes at the very same moment, on two processors, may count as one.
//
// Not thread-safe.
#ifndef RIPS_SENSOR_AGENT_IDS_CHANGE_COUNTER_H_
#define RIPS_SENSOR_AGENT_IDS_CHANGE_COUNTER_H_

#include <cstdint>
#include <optional>

#include "services/runtime/unique_fd.h"

namespace rips::sensor {

class ChangeCounter {
 public:
  // Counts those of the open file `fd` from now on, and of no other file.
  void Watch(int fd);
  void Stop() { *this = ChangeCounter(); }
  // Before reading: what changes later counts for the next time.
  void Look();
  // The file is another one now; until it was read to its end, nothing is known.
  void Forget() { changes_.reset(); }
  // All that changed before the last Look has been read.
  void WasReadToEnd() { changes_ = 0; }
  // Since the file was last read to its end, up to the last Look. Nullopt: not known; it never was,
  // the kernel gives no events or had too many, or the file has left its directory.
  const std::optional<uint64_t>& changes() const { return changes_; }

 private:
  std::optional<uint64_t> Take();

  UniqueFd inotify_;
  int directory_ = -1;
  int file_ = -1;
  std::optional<uint64_t> changes_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_IDS_CHANGE_COUNTER_H_

// Disk blocks that are kept for what must be written on a full disk: a file that holds nothing,
// made shorter when its room is needed and filled up when the disk has room again.
//
// What it can do: others who write to the same file system may take what it gives up before we do;
// therefore it is given up in pieces. On a file system that promises blocks it does not have (thin
// volumes, some network file systems) it promises nothing either.
//
//   state                     Release            Refill
//   whole                     a piece shorter    -
//   short since Release       a piece shorter    whole, or ResourceExhausted
//   never whole (small disk)  a piece shorter    whole, or as it is
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_DISK_RESERVE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_DISK_RESERVE_H_

#include <cstdint>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "services/runtime/unique_fd.h"

namespace rips::store {

// One thread at a time. Internal to this folder.
class DiskReserve {
 public:
  static constexpr int64_t kPieceBytes = 512 << 10;

  // The file (mode 0600) is made if missing, and filled as Refill does; a disk without room for it
  // is no error. `bytes` 0: none is kept. Unavailable if it cannot be opened, FailedPrecondition if
  // it is not a regular file.
  static absl::StatusOr<DiskReserve> Open(const std::string& path, int64_t bytes);
  DiskReserve(DiskReserve&&) noexcept = default;

  // Gives at most kPieceBytes back to the file system. False: there is nothing left to give.
  bool Release();
  // ResourceExhausted: what was given up cannot be had back yet, and nothing has changed.
  absl::Status Refill();
  int64_t held() const { return held_; }

 private:
  DiskReserve(UniqueFd fd, int64_t bytes) : fd_(std::move(fd)), bytes_(bytes) {}

  UniqueFd fd_;
  int64_t bytes_ = 0;
  int64_t held_ = 0;
  bool released_ = false;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_DISK_RESERVE_H_

// What SQLite needs to read a .db3 file that was not closed or was cut: a copy of its own, which it
// may write to. Internal to this folder.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_COPY_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_COPY_H_

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace rips::recording {

// | the file                                          | is read as                              |
// |---------------------------------------------------|-----------------------------------------|
// | is whole, and nothing is beside it                | it is, in its place; nothing is written |
// | has a write-ahead log or a hot journal beside it  | a copy of both, which SQLite recovers   |
// | is shorter than its header says                   | a copy of its whole pages               |
//
// The copy lies in a directory of its own in $TMPDIR, which goes with this. Its open descriptors
// stay valid.
class BagCopy {
 public:
  // `bytes` is the length of the file. DataLoss: not one page is whole. ResourceExhausted: no room
  // for a copy. Unavailable.
  static absl::StatusOr<std::unique_ptr<BagCopy>> Make(const std::string& path, uint64_t bytes);
  ~BagCopy();
  BagCopy(const BagCopy&) = delete;
  BagCopy& operator=(const BagCopy&) = delete;

  // The file to open.
  const std::string& path() const { return path_; }
  // It is ours, and may be written to.
  bool is_copy() const { return !directory_.empty(); }
  // Of everything that is read.
  uint64_t bytes() const { return bytes_; }
  // OK, or as DataLoss why there may be more than can be read, without the file's name.
  const absl::Status& end() const { return end_; }

 private:
  explicit BagCopy(std::string path) : path_(std::move(path)) {}
  absl::Status Copy(const std::string& from, uint64_t bytes, const std::string& suffix);
  absl::Status DropForeignJournal();
  absl::Status Shorten(uint64_t page_bytes, uint64_t pages);

  std::string path_;
  std::string directory_;
  uint64_t bytes_ = 0;
  absl::Status end_;
};

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_BAG_COPY_H_

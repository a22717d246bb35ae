// What the policy server's store held by the server's last word, for the hello of the next process:
// a server whose store was restored from a backup is recognised by it.
//
// The file `store` of the state directory is one line: `rips-store 1`, the generation as 32 hex
// digits, the commit, and the CRC-32C of all that as 8 hex digits.
#ifndef RIPS_SENSOR_AGENT_UPLINK_STORE_FILE_H_
#define RIPS_SENSOR_AGENT_UPLINK_STORE_FILE_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "rips/v1/session.pb.h"
#include "services/runtime/mutex.h"

namespace rips::sensor {

inline constexpr size_t kGenerationBytes = 16;

std::string StoreFile(const std::string& state_dir);

// Replaces the file whole; on the disk when it returns OK. InvalidArgument: the generation has not
// kGenerationBytes.
absl::Status SaveStorePoint(const std::string& path, const rips::v1::StorePoint& point);

// NotFound if there is no file; DataLoss if it is not what SaveStorePoint wrote; else as ReadFile.
absl::StatusOr<rips::v1::StorePoint> LoadStorePoint(const std::string& path);

// The newest store point, in memory, and in the file when Save was called. Any thread.
class StorePointKeeper {
 public:
  // Empty path: in memory only.
  explicit StorePointKeeper(std::string path) : path_(std::move(path)) {}

  // What a former process saved, if it can be read.
  void Load() ABSL_LOCKS_EXCLUDED(mu_);
  // Writes it down, if it has changed. When a stream begins and when it has ended: a backup is
  // restored while the server is stopped. A disk is not written for each commit in between.
  void Save() ABSL_LOCKS_EXCLUDED(mu_);
  // The store of a stream that begins. One with a malformed generation is ignored.
  void Set(const rips::v1::StorePoint& point) ABSL_LOCKS_EXCLUDED(mu_);
  void Raise(uint64_t commit) ABSL_LOCKS_EXCLUDED(mu_);
  // Without a generation: no server has named one.
  rips::v1::StorePoint Get() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  const std::string path_;
  mutable Mutex mu_;
  rips::v1::StorePoint point_ ABSL_GUARDED_BY(mu_);
  // As it stands in the file.
  std::string saved_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_STORE_FILE_H_

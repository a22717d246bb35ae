#include "sensor_agent/uplink/store_file.h"

#include <algorithm>
#include <cstdint>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "sensor_agent/spool/segment.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/log.h"

namespace rips::sensor {
namespace {

constexpr size_t kFileBytesMax = 256;

std::string ToLine(const rips::v1::StorePoint& point) {
  const std::string text = absl::StrCat("rips-store 1 ", absl::BytesToHexString(point.generation()),
                                        " ", point.commit(), " ");
  return absl::StrCat(text, absl::Hex(Crc32c(0, text), absl::kZeroPad8), "\n");
}

}  // namespace

std::string StoreFile(const std::string& state_dir) { return absl::StrCat(state_dir, "/store"); }

absl::Status SaveStorePoint(const std::string& path, const rips::v1::StorePoint& point) {
  if (point.generation().size() != kGenerationBytes) {
    return absl::InvalidArgumentError(absl::StrCat("generation of ", point.generation().size(),
                                                   " bytes, not ", kGenerationBytes));
  }
  return WriteFileAtomically(path, ToLine(point));
}

absl::StatusOr<rips::v1::StorePoint> LoadStorePoint(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(const std::string line, ReadFile(path, kFileBytesMax));
  const std::vector<std::string> words = absl::StrSplit(line, ' ');
  rips::v1::StorePoint point;
  uint64_t commit = 0;
  if (words.size() == 5 && words[2].size() == 2 * kGenerationBytes &&
      absl::SimpleAtoi(words[3], &commit)) {
    point.set_generation(absl::HexStringToBytes(words[2]));
    point.set_commit(commit);
    // Whatever else is wrong with it, its checksum among them.
    if (ToLine(point) == line) return point;
  }
  return absl::DataLossError("it is not what a sensor has written");
}

void StorePointKeeper::Load() {
  if (path_.empty()) return;
  const absl::StatusOr<rips::v1::StorePoint> saved = LoadStorePoint(path_);
  if (saved.ok()) {
    MutexLock lock(&mu_);
    point_ = *saved;
    saved_ = point_.SerializeAsString();
  } else if (!absl::IsNotFound(saved.status())) {
    LogWarning("cannot use the store position saved by the last run",
               {{"file", path_}, {"error", saved.status().ToString()}});
  }
}

void StorePointKeeper::Save() {
  if (path_.empty()) return;
  const rips::v1::StorePoint point = Get();
  const std::string bytes = point.SerializeAsString();
  {
    MutexLock lock(&mu_);
    if (point.generation().empty() || bytes == saved_) return;
  }
  if (absl::Status saved = SaveStorePoint(path_, point); !saved.ok()) {
    LogWarning("cannot save the server's store position", {{"error", saved.ToString()}});
    return;
  }
  MutexLock lock(&mu_);
  saved_ = bytes;
}

void StorePointKeeper::Set(const rips::v1::StorePoint& point) {
  if (point.generation().size() != kGenerationBytes) {
    LogWarning("server sent a malformed store generation");
    return;
  }
  MutexLock lock(&mu_);
  point_ = point;
}

void StorePointKeeper::Raise(uint64_t commit) {
  MutexLock lock(&mu_);
  point_.set_commit(std::max(point_.commit(), commit));
}

rips::v1::StorePoint StorePointKeeper::Get() const {
  MutexLock lock(&mu_);
  return point_;
}

}  // namespace rips::sensor

#include "sensor_agent/uplink/store_file.h"

#include <cstdint>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "sensor_agent/spool/segment.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"

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

}  // namespace rips::sensor

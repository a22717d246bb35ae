#include "policy_server/policy/recording/reader.h"

#include <sys/stat.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/recording/bag_folder.h"
#include "policy_server/policy/recording/bag_reader.h"
#include "policy_server/policy/recording/input_file.h"
#include "policy_server/policy/recording/mcap_reader.h"
#include "policy_server/policy/recording/rips_format.h"
#include "policy_server/policy/recording/rips_reader.h"
#include "policy_server/policy/recording/yaml_reader.h"
#include "services/base/status_macros.h"

namespace rips::recording {
namespace {

constexpr size_t kMagicBytesMax = 16;

struct Packing {
  absl::string_view magic;
  const char* tool;
};
constexpr Packing kPackings[] = {{{"\x28\xb5\x2f\xfd", 4}, "zstd"},
                                 {{"\x1f\x8b", 2}, "gzip"},
                                 {{"\x04\x22\x4d\x18", 4}, "lz4"},
                                 {{"BZh", 3}, "bzip2"},
                                 {{"\xfd\x37zXZ", 5}, "xz"}};

bool Begins(absl::string_view bytes, absl::string_view magic) {
  return bytes.substr(0, magic.size()) == magic;
}

}  // namespace

absl::StatusOr<std::optional<Recorded>> Reader::Next() {
  RIPS_RETURN_IF_ERROR(broken_);
  if (ended_) return std::nullopt;
  absl::StatusOr<std::optional<Recorded>> next = Read();
  if (!next.ok()) {
    broken_ = next.status();
  } else if (!next->has_value()) {
    ended_ = true;
  } else {
    (*next)->index = next_index_++;
  }
  return next;
}

absl::StatusOr<std::unique_ptr<Reader>> OpenFile(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<InputFile> file, InputFile::Open(path));
  if (file->size() == 0) return file->Damaged(0, "the file is empty");
  std::string first;
  RIPS_RETURN_IF_ERROR(file->Read(std::min<uint64_t>(file->size(), kMagicBytesMax), &first));
  file->Rewind();
  if (Begins(first, kSqliteMagic)) return OpenBagFile(path, file->size());
  if (Begins(first, kMcapMagic)) return OpenMcap(std::move(file));
  if (Begins(first, kRipsMagic)) return OpenRips(std::move(file));
  for (const Packing& packing : kPackings) {
    if (!Begins(first, packing.magic)) continue;
    return absl::InvalidArgumentError(absl::StrCat(
        "`", path, "` is compressed; decompress it, even if it is cut, and replay the ",
        "result: ", packing.tool, " -dc FILE > RESULT"));
  }
  return OpenYaml(std::move(file));
}

absl::StatusOr<std::unique_ptr<Reader>> Open(const std::string& path) {
  struct stat info {};
  if (stat(path.c_str(), &info) == 0 && S_ISDIR(info.st_mode)) return OpenBagFolder(path);
  return OpenFile(path);
}

}  // namespace rips::recording

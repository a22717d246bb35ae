#include "policy_server/policy/recording/bag_folder.h"

#include <algorithm>
#include <filesystem>
#include <set>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "policy_server/policy/recording/decompress.h"
#include "policy_server/policy/recording/yaml_tree.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/atomic_file.h"

namespace rips::recording {
namespace {

namespace fs = std::filesystem;

constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
// What is missing at one place: so many texts are given, the rest is counted.
constexpr size_t kTextsMax = 10;

constexpr const char* kStorageEndings[] = {".mcap", ".db3"};
struct Packing {
  const char* ending;
  const char* tool;
};
constexpr Packing kPackings[] = {{".zstd", "zstd"}, {".zst", "zstd"},  {".gz", "gzip"},
                                 {".lz4", "lz4"},   {".bz2", "bzip2"}, {".xz", "xz"}};

// A file of the bag, in its place.
struct BagFile {
  std::string path;
  // Why it cannot be read; empty = it can.
  std::string missing;
};

class BagFolder final : public Reader {
 public:
  // `at_end` is what else is missing, as far as is known.
  BagFolder(std::vector<BagFile> files, std::vector<std::string> at_end)
      : files_(std::move(files)), at_end_(std::move(at_end)) {}

  bool has_graph() const override { return false; }

 private:
  absl::StatusOr<std::optional<Recorded>> Read() override {
    while (true) {
      if (current_ != nullptr) {
        absl::StatusOr<std::optional<Recorded>> event = current_->Next();
        if (event.ok() && event->has_value()) {
          if (!missing_.empty()) (*event)->missing_before = TakeMissing();
          return event;
        }
        RIPS_RETURN_IF_ERROR(Lacks(event.status()));
        current_.reset();
      }
      if (next_ == files_.size()) break;
      const BagFile& file = files_[next_++];
      if (!file.missing.empty()) {
        missing_.push_back(file.missing);
        continue;
      }
      absl::StatusOr<std::unique_ptr<Reader>> opened = OpenFile(file.path);
      RIPS_RETURN_IF_ERROR(Lacks(opened.status()));
      if (opened.ok()) current_ = *std::move(opened);
    }
    missing_.insert(missing_.end(), at_end_.begin(), at_end_.end());
    if (missing_.empty()) return std::nullopt;
    return absl::DataLossError(TakeMissing());
  }

  // Notes that a file is cut or damaged; any other error is returned.
  absl::Status Lacks(const absl::Status& status) {
    if (!absl::IsDataLoss(status)) return status;
    missing_.emplace_back(status.message());
    return absl::OkStatus();
  }

  std::string TakeMissing() {
    const size_t more = missing_.size() - std::min(missing_.size(), kTextsMax);
    missing_.resize(missing_.size() - more);
    return absl::StrCat(absl::StrJoin(std::exchange(missing_, {}), "; "),
                        more > 0 ? absl::StrCat("; and ", more, " more") : "");
  }

  const std::vector<BagFile> files_;
  const std::vector<std::string> at_end_;
  size_t next_ = 0;
  std::unique_ptr<Reader> current_;
  // Since the last event.
  std::vector<std::string> missing_;
};

// Inside the directory, and not the directory itself.
bool IsInside(absl::string_view path) {
  if (path.empty() || absl::StartsWith(path, "/") || absl::EndsWith(path, "/")) return false;
  for (const absl::string_view part : absl::StrSplit(path, '/')) {
    if (part == "..") return false;
  }
  return path.find('\0') == absl::string_view::npos;
}

// The number at its beginning, without leading zeros, which is removed from `text`.
absl::string_view TakeDigits(absl::string_view* text) {
  size_t digits = 0;
  while (digits < text->size() && absl::ascii_isdigit(static_cast<unsigned char>((*text)[digits])))
    ++digits;
  absl::string_view number = text->substr(0, digits);
  text->remove_prefix(digits);
  while (absl::ConsumePrefix(&number, "0")) {
  }
  return number;
}

// `bag_9.mcap` comes before `bag_10.mcap`.
bool IsBefore(absl::string_view left, absl::string_view right) {
  while (!left.empty() && !right.empty()) {
    if (absl::ascii_isdigit(static_cast<unsigned char>(left[0])) &&
        absl::ascii_isdigit(static_cast<unsigned char>(right[0]))) {
      const absl::string_view one = TakeDigits(&left);
      const absl::string_view other = TakeDigits(&right);
      if (one.size() != other.size()) return one.size() < other.size();
      if (one != other) return one < other;
      continue;
    }
    if (left[0] != right[0]) return left[0] < right[0];
    left.remove_prefix(1);
    right.remove_prefix(1);
  }
  return left.size() < right.size();
}
bool ComesBefore(const BagFile& left, const BagFile& right) {
  return IsBefore(left.path, right.path);
}

bool IsStorage(absl::string_view name) {
  return std::any_of(std::begin(kStorageEndings), std::end(kStorageEndings),
                     [&](const char* ending) { return absl::EndsWith(name, ending); });
}

// Null if the name is not that of a compressed file.
const Packing* PackingOf(absl::string_view name) {
  for (const Packing& packing : kPackings) {
    if (absl::EndsWith(name, packing.ending)) return &packing;
  }
  return nullptr;
}

absl::string_view WithoutPacking(absl::string_view name) {
  const Packing* packing = PackingOf(name);
  return packing == nullptr ? name : absl::StripSuffix(name, packing->ending);
}

bool IsFile(const std::string& path) {
  std::error_code ignored;
  return fs::is_regular_file(path, ignored);
}

// Why a compressed file is not read, and what helps.
std::string PackedText(const std::string& path) {
  return absl::StrCat("`", path,
                      "` is compressed; decompress it beside itself: ", PackingOf(path)->tool,
                      " -dc FILE > FILE_WITHOUT_ENDING");
}

// The names of storage files in the directory; plain ones, and compressed ones.
struct Listing {
  std::vector<std::string> plain;
  std::vector<std::string> packed;
};

absl::StatusOr<Listing> List(const std::string& directory) {
  Listing listing;
  std::error_code failed;
  size_t entries = 0;
  for (fs::directory_iterator at(directory, failed), end; !failed && at != end;
       at.increment(failed)) {
    if (++entries > kBagFilesMax) {
      return absl::ResourceExhaustedError(
          absl::StrCat("`", directory, "` has more entries than the limit of ", kBagFilesMax));
    }
    const std::string name = at->path().filename().string();
    if (!IsStorage(WithoutPacking(name)) || !IsFile(at->path().string())) continue;
    (IsStorage(name) ? listing.plain : listing.packed).push_back(name);
  }
  if (failed) {
    return absl::UnavailableError(
        absl::StrCat("cannot list `", directory, "`: ", failed.message()));
  }
  std::sort(listing.plain.begin(), listing.plain.end(), IsBefore);
  std::sort(listing.packed.begin(), listing.packed.end(), IsBefore);
  return listing;
}

// Of metadata that does not say what the bag consists of: DataLoss.
absl::StatusOr<std::vector<std::string>> NamesIn(const YamlNode& root) {
  const YamlNode* information = root.Find("rosbag2_bagfile_information");
  if (information == nullptr) {
    return AtLine(absl::StatusCode::kDataLoss, root.line, "no `rosbag2_bagfile_information`");
  }
  const YamlNode* mode = information->Find("compression_mode");
  if (mode != nullptr && absl::EqualsIgnoreCase(mode->text, "message")) {
    return AtLine(kInvalid, mode->line,
                  absl::StrCat("each message of the bag ", kCompressedMessage));
  }
  const YamlNode* files = information->Find("relative_file_paths");
  if (files == nullptr || files->kind != YamlNode::Kind::kList) {
    return AtLine(absl::StatusCode::kDataLoss, information->line, "no list `relative_file_paths`");
  }
  if (files->items.size() > kBagFilesMax) {
    return AtLine(absl::StatusCode::kResourceExhausted, files->line,
                  absl::StrCat(files->items.size(), " files exceed the limit of ", kBagFilesMax));
  }
  std::vector<std::string> names;
  for (const YamlNode& file : files->items) {
    if (!IsInside(file.text)) {
      return AtLine(kInvalid, file.line,
                    absl::StrCat("`", ros2::Printable(file.text), "` is not a file of the bag"));
    }
    names.push_back(file.text);
  }
  return names;
}

// NotFound: there is no metadata. DataLoss: it is unusable.
absl::StatusOr<std::vector<std::string>> ReadNames(const std::string& metadata) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, ReadFile(metadata, kBagMetadataBytesMax));
  const absl::StatusOr<YamlNode> root = ParseYaml(text, 1);
  absl::StatusOr<std::vector<std::string>> names =
      root.ok() ? NamesIn(*root) : absl::DataLossError(root.status().message());
  if (names.ok()) return names;
  return absl::Status(names.status().code(),
                      absl::StrCat("`", metadata, "`: ", names.status().message()));
}

// The files that the metadata names, and those that it does not.
class BagFiles {
 public:
  BagFiles(std::string directory, Listing listing)
      : directory_(std::move(directory)), listing_(std::move(listing)) {}

  void Add(const std::string& name) {
    // Decompressed beside itself; and the first versions of rosbag2 begin with the directory.
    const std::string plain(WithoutPacking(name));
    for (const std::string& each : {plain, Base(plain)}) {
      if (!IsFile(Path(each))) continue;
      if (!used_.contains(each)) Use(each, {});
      return;
    }
    for (const std::string& each : {name, Base(name)}) {
      if (PackingOf(each) != nullptr && IsFile(Path(each)))
        return Use(each, PackedText(Path(each)));
    }
    files_.push_back({.path = Path(name),
                      .missing = absl::StrCat("`", Path(ros2::Printable(name)),
                                              "`, which metadata.yaml names, is not there")});
  }

  // What the directory has besides; gives the names of what can be read of it.
  std::vector<std::string> AddRest() {
    const bool sorted = std::is_sorted(files_.begin(), files_.end(), ComesBefore);
    std::vector<std::string> added;
    for (const std::string& name : listing_.plain) {
      if (used_.contains(name)) continue;
      added.push_back(name);
      Use(name, {});
    }
    for (const std::string& name : listing_.packed) {
      const std::string plain(WithoutPacking(name));
      if (!used_.contains(name) && !used_.contains(plain)) Use(name, PackedText(Path(name)));
    }
    if (sorted) std::stable_sort(files_.begin(), files_.end(), ComesBefore);
    return added;
  }

  std::vector<BagFile> files() && { return std::move(files_); }
  bool any_to_read() const {
    return std::any_of(files_.begin(), files_.end(),
                       [](const BagFile& file) { return file.missing.empty(); });
  }
  // Why nothing can be read.
  std::string why_none() const { return files_.empty() ? "" : files_.front().missing; }

 private:
  static std::string Base(const std::string& name) { return name.substr(name.rfind('/') + 1); }
  std::string Path(const std::string& name) const { return absl::StrCat(directory_, "/", name); }
  void Use(const std::string& name, std::string missing) {
    used_.insert(name);
    files_.push_back({.path = Path(name), .missing = std::move(missing)});
  }

  const std::string directory_;
  const Listing listing_;
  std::vector<BagFile> files_;
  std::set<std::string> used_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Reader>> OpenBagFolder(const std::string& directory) {
  const absl::StatusOr<std::vector<std::string>> names =
      ReadNames(absl::StrCat(directory, "/metadata.yaml"));
  const bool absent = absl::IsNotFound(names.status());
  if (!names.ok() && !absent && !absl::IsDataLoss(names.status())) return names.status();
  RIPS_ASSIGN_OR_RETURN(Listing listing, List(directory));

  BagFiles files(directory, std::move(listing));
  if (names.ok()) {
    for (const std::string& name : *names) files.Add(name);
  }
  const std::vector<std::string> added = files.AddRest();
  std::vector<std::string> at_end;
  if (absent) {
    at_end.push_back(absl::StrCat("`", directory,
                                  "` has no metadata.yaml, which rosbag2 writes when a recording "
                                  "ends: what was not yet written then is not there"));
  } else if (!names.ok()) {
    at_end.emplace_back(names.status().message());
  } else {
    for (const std::string& name : added) {
      at_end.push_back(
          absl::StrCat("`", directory, "/", name, "` is read, but metadata.yaml does not name it"));
    }
  }
  if (!files.any_to_read()) {
    if (const std::string why = files.why_none(); !why.empty()) {
      return absl::Status(kInvalid, why);
    }
    if (absent) {
      return absl::FailedPreconditionError(
          absl::StrCat("`", directory,
                       "` is a directory without metadata.yaml and without files of a bag (.mcap, "
                       ".db3), so no rosbag2 bag"));
    }
    if (!names.ok()) return absl::Status(kInvalid, names.status().message());
  }
  return std::make_unique<BagFolder>(std::move(files).files(), std::move(at_end));
}

}  // namespace rips::recording

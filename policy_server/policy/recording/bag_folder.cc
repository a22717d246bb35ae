#include "policy_server/policy/recording/bag_folder.h"

#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "policy_server/policy/recording/yaml_tree.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/atomic_file.h"

namespace rips::recording {
namespace {

class BagFolder final : public Reader {
 public:
  explicit BagFolder(std::vector<std::string> paths) : paths_(std::move(paths)) {}

  bool has_graph() const override { return false; }

 private:
  absl::StatusOr<std::optional<Recorded>> Read() override {
    while (true) {
      if (current_ != nullptr) {
        RIPS_ASSIGN_OR_RETURN(std::optional<Recorded> event, current_->Next());
        if (event) return event;
        current_.reset();
      }
      if (next_ == paths_.size()) return std::nullopt;
      RIPS_ASSIGN_OR_RETURN(current_, OpenFile(paths_[next_++]));
    }
  }

  const std::vector<std::string> paths_;
  size_t next_ = 0;
  std::unique_ptr<Reader> current_;
};

// Inside the directory, and not the directory itself.
bool IsInside(absl::string_view path) {
  if (path.empty() || absl::StartsWith(path, "/") || absl::EndsWith(path, "/")) return false;
  for (const absl::string_view part : absl::StrSplit(path, '/')) {
    if (part == "..") return false;
  }
  return path.find('\0') == absl::string_view::npos;
}

absl::StatusOr<std::vector<std::string>> FilesOf(const YamlNode& root) {
  const auto invalid = absl::StatusCode::kInvalidArgument;
  const YamlNode* information = root.Find("rosbag2_bagfile_information");
  if (information == nullptr) {
    return AtLine(invalid, root.line, "no `rosbag2_bagfile_information`");
  }
  for (const char* key : {"compression_format", "compression_mode"}) {
    const YamlNode* value = information->Find(key);
    if (value == nullptr || value->text.empty() || value->text == "NONE") continue;
    return AtLine(invalid, value->line,
                  absl::StrCat("the bag is compressed (`", ros2::Printable(value->text),
                               "`); decompress it first"));
  }
  const YamlNode* files = information->Find("relative_file_paths");
  if (files == nullptr || files->kind != YamlNode::Kind::kList) {
    return AtLine(invalid, information->line, "no list `relative_file_paths`");
  }
  if (files->items.size() > kBagFilesMax) {
    return AtLine(absl::StatusCode::kResourceExhausted, files->line,
                  absl::StrCat(files->items.size(), " files exceed the limit of ", kBagFilesMax));
  }
  std::vector<std::string> names;
  for (const YamlNode& file : files->items) {
    if (!IsInside(file.text)) {
      return AtLine(invalid, file.line,
                    absl::StrCat("`", ros2::Printable(file.text), "` is not a file of the bag"));
    }
    names.push_back(file.text);
  }
  return names;
}

}  // namespace

absl::StatusOr<std::unique_ptr<Reader>> OpenBagFolder(const std::string& directory) {
  const std::string metadata = absl::StrCat(directory, "/metadata.yaml");
  absl::StatusOr<std::string> text = ReadFile(metadata, kBagMetadataBytesMax);
  if (absl::IsNotFound(text.status())) {
    return absl::FailedPreconditionError(
        absl::StrCat("`", directory, "` is a directory without metadata.yaml, so no rosbag2 bag"));
  }
  RIPS_RETURN_IF_ERROR(text.status());
  const absl::StatusOr<YamlNode> root = ParseYaml(*text, 1);
  const absl::StatusOr<std::vector<std::string>> names =
      root.ok() ? FilesOf(*root) : absl::StatusOr<std::vector<std::string>>(root.status());
  if (!names.ok()) {
    return absl::Status(names.status().code(),
                        absl::StrCat("`", metadata, "`: ", names.status().message()));
  }
  std::vector<std::string> paths;
  for (const std::string& name : *names) paths.push_back(absl::StrCat(directory, "/", name));
  return std::make_unique<BagFolder>(std::move(paths));
}

}  // namespace rips::recording

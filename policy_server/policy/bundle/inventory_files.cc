#include "policy_server/policy/bundle/inventory_files.h"

#include <algorithm>
#include <filesystem>
#include <system_error>

#include "absl/container/btree_map.h"
#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_sections.h"
#include "services/text/quote.h"

namespace rips::bundle {
namespace {

bool IsInventoryFile(absl::string_view name) {
  return absl::EndsWith(name, ".yaml") && name.front() != '.' && name.front() != '#';
}

// Sorted. A name that would forge lines of a log is refused.
absl::StatusOr<std::vector<std::string>> ListFiles(const std::string& directory) {
  std::vector<std::string> names;
  std::error_code error;
  size_t entries = 0;
  for (std::filesystem::directory_iterator it(directory, error), end; !error && it != end;
       it.increment(error)) {
    if (++entries > kInventoryEntriesMax) {
      return absl::InvalidArgumentError(absl::StrCat("`", directory, "` has more than ",
                                                     kInventoryEntriesMax, " entries, the limit"));
    }
    std::string name = it->path().filename().string();
    if (absl::EndsWith(name, ".yml")) {
      return absl::InvalidArgumentError(
          absl::StrCat("`", directory, "` has a file ", QuoteBytes(name),
                       ", which is not read; end its name ", "with `.yaml`"));
    }
    if (!IsInventoryFile(name)) continue;
    if (!std::all_of(name.begin(), name.end(), [](char c) { return absl::ascii_isprint(c); })) {
      return absl::InvalidArgumentError(absl::StrCat(
          "`", directory, "` has a file ", QuoteBytes(name), "; name it with printable ASCII"));
    }
    names.push_back(std::move(name));
  }
  if (error) {
    return absl::UnavailableError(absl::StrCat("cannot list `", directory, "`: ", error.message()));
  }
  if (names.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", directory, "` has no file `*.yaml`; each lists robots as robots.yaml"));
  }
  std::sort(names.begin(), names.end());
  return names;
}

// Who may write here says which robots are guarded; by a link, also which file's text an error
// quotes. A path that cannot be looked at is left to the reader.
absl::Status CheckNotEverybodys(const std::string& path) {
  std::error_code error;
  const auto allowed = std::filesystem::status(path, error).permissions();
  if (error || (allowed & std::filesystem::perms::others_write) == std::filesystem::perms::none) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(absl::StrCat("every user may write to `", path,
                                                 "`, and so change which robots are guarded; ",
                                                 "`chmod o-w` it"));
}

absl::StatusOr<Inventory> ReadOne(const std::string& path) {
  RIPS_RETURN_IF_ERROR(CheckNotEverybodys(path));
  RIPS_ASSIGN_OR_RETURN(const std::string text, ReadConfigFile(path));
  return ParseInventory(path, text);
}

absl::StatusOr<InventoryFiles> ReadDirectory(const std::string& directory) {
  RIPS_RETURN_IF_ERROR(CheckNotEverybodys(directory));
  RIPS_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListFiles(directory));
  InventoryFiles read;
  std::vector<InventoryRobot>& robots = read.inventory.robots;
  // By robot: the first file that lists it.
  absl::btree_map<std::string, std::string> listed;
  std::vector<std::string> problems;
  for (const std::string& name : names) {
    const std::string path = (std::filesystem::path(directory) / name).string();
    absl::StatusOr<Inventory> one = ReadOne(path);
    if (!one.ok()) {
      problems.emplace_back(one.status().message());
      continue;
    }
    read.files.emplace_back(path, one->robots.size());
    read.inventory.bundles.insert(read.inventory.bundles.end(), one->bundles.begin(),
                                  one->bundles.end());
    read.inventory.sensor_settings.insert(read.inventory.sensor_settings.end(),
                                          one->sensor_settings.begin(), one->sensor_settings.end());
    read.inventory.settings.merge(one->settings);
    for (InventoryRobot& robot : one->robots) {
      const auto [first, fresh] = listed.emplace(robot.id, path);
      if (!fresh) {
        problems.push_back(absl::StrCat("robot `", robot.id, "` is listed in `", first->second,
                                        "` and in `", path, "`; remove one of both"));
      }
      robots.push_back(std::move(robot));
    }
    if (robots.size() > kRobotsMax) {
      problems.push_back(absl::StrCat("the files of `", directory, "` up to `", name, "` list ",
                                      robots.size(), " robots, which exceed limit ", kRobotsMax));
      break;
    }
  }
  if (!problems.empty()) return absl::InvalidArgumentError(absl::StrJoin(problems, "\n"));
  std::sort(robots.begin(), robots.end(),
            [](const InventoryRobot& a, const InventoryRobot& b) { return a.id < b.id; });
  if (const absl::Status assigned = AssignByLabels(read.inventory); !assigned.ok()) {
    return absl::InvalidArgumentError(absl::StrCat("`", directory, "`: ", assigned.message()));
  }
  return read;
}

}  // namespace

absl::StatusOr<InventoryFiles> ReadInventory(const std::string& path) {
  std::error_code error;
  if (std::filesystem::is_directory(path, error)) return ReadDirectory(path);
  InventoryFiles read;
  RIPS_ASSIGN_OR_RETURN(read.inventory, ReadOne(path));
  read.files.emplace_back(path, read.inventory.robots.size());
  if (const absl::Status assigned = AssignByLabels(read.inventory); !assigned.ok()) {
    return absl::InvalidArgumentError(absl::StrCat("`", path, "`: ", assigned.message()));
  }
  return read;
}

}  // namespace rips::bundle

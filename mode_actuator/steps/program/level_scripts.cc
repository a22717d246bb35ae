#include "mode_actuator/steps/program/level_scripts.h"

#include <dirent.h>
#include <fcntl.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <set>
#include <utility>

#include "absl/status/statusor.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "mode_actuator/steps/program/program_file.h"
#include "services/base/status_macros.h"
#include "services/runtime/unique_fd.h"
#include "services/text/quote.h"

namespace rips::actuator {
namespace {

absl::StatusOr<std::set<std::string>> NamesIn(const std::string& directory) {
  DIR* open_directory = opendir(directory.c_str());
  if (open_directory == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat("scripts: ", QuoteBytes(directory), ": ", std::strerror(errno)));
  }
  std::set<std::string> names;
  while (const dirent* entry = readdir(open_directory)) {
    const absl::string_view name = entry->d_name;
    if (!absl::StartsWith(name, ".") && !absl::EndsWith(name, "~")) names.emplace(name);
    if (names.size() > kScriptFilesMax) break;
  }
  closedir(open_directory);
  if (names.size() <= kScriptFilesMax) return names;
  return absl::InvalidArgumentError(absl::StrCat("scripts: the files in ", QuoteBytes(directory),
                                                 " exceed limit ", kScriptFilesMax));
}

Step ScriptStep(const std::string& name) {
  Step step;
  ProgramStep program;
  program.name = name;
  program.level_args = true;
  step.what = std::move(program);
  step.timeout = kScriptTimeout;
  return step;
}

// The list of steps that a file of this name belongs to, and what --check-config calls it; null if
// it is no level's.
std::vector<Step>* ListOf(absl::string_view name, std::vector<LevelSpec>* levels,
                          std::string* place) {
  for (size_t i = 0; i < levels->size(); ++i) {
    LevelSpec& level = (*levels)[i];
    if (name == level.name + ".to") {
      *place = absl::StrCat("levels[", i, "].enter[", level.enter.size(), "]");
      return &level.enter;
    }
    if (name == level.name + ".from") {
      *place = absl::StrCat("levels[", i, "].leave[", level.leave.size(), "]");
      return &level.leave;
    }
  }
  return nullptr;
}

}  // namespace

absl::Status AddLevelScripts(const std::string& directory, std::vector<LevelSpec>* levels,
                             std::vector<ProgramSpec>* programs,
                             std::vector<ConfigSetting>* settings) {
  RIPS_ASSIGN_OR_RETURN(const std::set<std::string> names, NamesIn(directory));
  const UniqueFd root(open("/", O_PATH | O_DIRECTORY | O_CLOEXEC));
  std::vector<std::string> problems;
  for (const std::string& name : names) {
    const std::string path = absl::StrCat(directory, "/", name);
    std::string place;
    std::vector<Step>* steps = ListOf(name, levels, &place);
    if (steps == nullptr) {
      problems.push_back(absl::StrCat("scripts: ", QuoteBytes(path),
                                      " is of no level; files are called LEVEL.from and LEVEL.to"));
      continue;
    }
    if (const absl::Status safe = CheckProgramPath(root.get(), path); !safe.ok()) {
      problems.push_back(absl::StrCat("scripts: ", safe.message()));
      continue;
    }
    if (FindNamed(*programs, name) != nullptr) {
      problems.push_back(
          absl::StrCat("scripts: a program is called ", QuoteBytes(name), " already"));
      continue;
    }
    ProgramSpec program;
    program.name = name;
    program.path = path;
    program.timeout = kScriptTimeout;
    program.script = true;
    programs->push_back(std::move(program));
    steps->push_back(ScriptStep(name));
    settings->push_back({.path = absl::StrCat(place, ".program.name"),
                         .value = absl::StrCat("\"", name, "\""),
                         .source = absl::StrCat(path, " TO FROM")});
  }
  if (problems.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrJoin(problems, "\n"));
}

}  // namespace rips::actuator

#include "policy_server/policy/inspect/checked_files.h"

#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <optional>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "services/base/status_macros.h"

namespace rips::inspect {
namespace {

using Kind = lang::InspectionProblem::Kind;
using lang::InspectionProblem;

// The kernel looks no further for an interpreter.
constexpr size_t kFirstLineBytesMax = 256;

InspectionProblem FromStatus(const absl::Status& status) {
  const bool missing =
      absl::IsNotFound(status) || absl::IsPermissionDenied(status) || absl::IsUnavailable(status);
  return {.kind = missing ? Kind::kMissing : Kind::kBroken,
          .message = std::string(status.message())};
}

// root may access() anything; a file without any x bit is still not to be executed.
bool MayExecute(const std::string& path, const struct stat& info) {
  return (info.st_mode & (S_IXUSR | S_IXGRP | S_IXOTH)) != 0 && access(path.c_str(), X_OK) == 0;
}

// What the first line of a script names, as the kernel reads it; empty for other files.
std::string InterpreterOf(const std::string& path) {
  std::string line(kFirstLineBytesMax, '\0');
  std::ifstream in(path, std::ios::binary);
  in.read(line.data(), static_cast<std::streamsize>(line.size()));
  line.resize(static_cast<size_t>(in.gcount()));
  absl::string_view rest = line;
  if (!absl::ConsumePrefix(&rest, "#!")) return "";
  rest = rest.substr(0, rest.find('\n'));
  const size_t begin = rest.find_first_not_of(" \t");
  if (begin == absl::string_view::npos) return "";
  rest.remove_prefix(begin);
  return std::string(rest.substr(0, rest.find_first_of(" \t")));
}

std::optional<InspectionProblem> CheckInterpreter(const std::string& name,
                                                  const std::string& shown) {
  // Plugins are started in `/`.
  const std::string path = absl::StartsWith(name, "/") ? name : absl::StrCat("/", name);
  struct stat info = {};
  absl::string_view problem;
  if (stat(path.c_str(), &info) != 0) {
    problem = "not there";
  } else if (!S_ISREG(info.st_mode) || !MayExecute(path, info)) {
    problem = "not executable";
  } else {
    return std::nullopt;
  }
  return InspectionProblem{Kind::kMissing, absl::StrCat(shown, ": its interpreter `",
                                                        absl::CHexEscape(name), "` is ", problem)};
}

std::optional<InspectionProblem> CheckProgram(const std::string& path, const std::string& shown) {
  struct stat info = {};
  if (stat(path.c_str(), &info) != 0) {
    return InspectionProblem{Kind::kMissing, absl::StrCat(shown, ": ", std::strerror(errno))};
  }
  if (!S_ISREG(info.st_mode)) {
    return InspectionProblem{Kind::kBroken, absl::StrCat(shown, ": not a regular file")};
  }
  if (!MayExecute(path, info)) {
    return InspectionProblem{Kind::kMissing, absl::StrCat(shown, ": not executable; chmod +x")};
  }
  const std::string interpreter = InterpreterOf(path);
  return interpreter.empty() ? std::nullopt : CheckInterpreter(interpreter, shown);
}

absl::Status Refusal(const std::vector<InspectionProblem>& problems) {
  return absl::InvalidArgumentError(absl::StrJoin(
      problems, "\n",
      [](std::string* out, const InspectionProblem& problem) { out->append(problem.message); }));
}

}  // namespace

const YaraCompiled& CheckedFiles::Compiled(const std::string& path) {
  const auto known = compiled_.find(path);
  if (known != compiled_.end()) return known->second;
  const absl::StatusOr<std::string> text = source_->Read(path, kYaraFileBytesMax);
  YaraCompiled made = text.ok() ? YaraRules::Compile(*text, path)
                                : YaraCompiled{.problems = {FromStatus(text.status())}};
  return compiled_.emplace(path, std::move(made)).first->second;
}

std::vector<InspectionProblem> CheckedFiles::Check(const lang::Inspection& inspection) {
  if (inspection.kind == lang::Inspection::Kind::kPayload) {
    return Compiled(inspection.path).problems;
  }
  const absl::StatusOr<std::string> path = source_->ProgramPath(inspection);
  if (!path.ok()) return {FromStatus(path.status())};
  const std::optional<InspectionProblem> problem = CheckProgram(*path, inspection.path);
  return problem ? std::vector<InspectionProblem>{*problem} : std::vector<InspectionProblem>{};
}

absl::StatusOr<std::shared_ptr<const YaraRules>> CheckedFiles::Rules(
    const lang::Inspection& inspection) {
  const YaraCompiled& compiled = Compiled(inspection.path);
  if (compiled.rules == nullptr) return Refusal(compiled.problems);
  return compiled.rules;
}

absl::StatusOr<std::string> CheckedFiles::Program(const lang::Inspection& inspection) {
  const std::vector<InspectionProblem> problems = Check(inspection);
  if (!problems.empty()) return Refusal(problems);
  return source_->ProgramPath(inspection);
}

}  // namespace rips::inspect

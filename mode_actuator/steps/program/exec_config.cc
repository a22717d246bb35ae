#include "mode_actuator/steps/program/exec_config.h"

#include <algorithm>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "mode_actuator/steps/port/program_runner.h"
#include "services/runtime/config_sections.h"

namespace rips::actuator {
namespace {

constexpr size_t kSha256Digits = 64;

void ReadRate(const ConfigSection& section, ProgramSpec* program) {
  std::string rate;
  section.Optional("rate", &rate);
  if (rate.empty()) return;
  absl::string_view number = rate;
  if (!absl::ConsumeSuffix(&number, "/min") ||
      !std::all_of(number.begin(), number.end(), absl::ascii_isdigit) ||
      !absl::SimpleAtoi(number, &program->starts_per_minute) || program->starts_per_minute < 1 ||
      program->starts_per_minute > kStartsPerMinuteMax) {
    program->starts_per_minute = 0;
    section.Problem("rate", absl::StrCat("write `N/min`, N from 1 to ", kStartsPerMinuteMax));
  }
}

void ReadSha256(const ConfigSection& section, ProgramSpec* program) {
  section.Optional("sha256", &program->sha256);
  if (program->sha256.empty()) return;
  absl::AsciiStrToLower(&program->sha256);
  if (program->sha256.size() != kSha256Digits ||
      !std::all_of(program->sha256.begin(), program->sha256.end(), absl::ascii_isxdigit)) {
    section.Problem("sha256", "write 64 hexadecimal digits, as sha256sum prints them");
  }
}

}  // namespace

ExecSettings ReadExec(const ConfigSection& root) {
  ExecSettings settings;
  const ConfigSection section = root.OptionalSection("exec");
  if (section.Has("socket")) ReadPath(section, "socket", &settings.socket);
  section.Optional("user", &settings.user);
  section.Optional("run_as", &settings.run_as);
  if (section.Has("cgroup")) ReadPath(section, "cgroup", &settings.cgroup);
  return settings;
}

void ReadProgramGuards(const ConfigSection& section, ProgramSpec* program) {
  if (program->name.size() > kProgramNameBytesMax) {
    section.Problem("name", absl::StrCat("a name of ", program->name.size(),
                                         " bytes exceeds limit ", kProgramNameBytesMax));
  }
  ReadRate(section, program);
  ReadSha256(section, program);
  section.Optional("drill", &program->drill);
}

}  // namespace rips::actuator

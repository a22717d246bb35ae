#include "policy_server/policy/inspect/yara_rules.h"

#include <yara.h>

#include <cstring>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "policy_server/policy/inspect/yara_speed.h"
#include "services/base/status_macros.h"

namespace rips::inspect {
namespace {

using Kind = lang::InspectionProblem::Kind;

// What libyara calls back with.
struct Report {
  std::string name;
  std::vector<lang::InspectionProblem> problems;
  size_t left_out = 0;
  bool at_include = false;

  void Add(Kind kind, int line, absl::string_view message) {
    if (problems.size() >= kYaraProblemsMax) {
      ++left_out;
      return;
    }
    std::string place = line > 0 ? absl::StrCat(name, ":", line) : name;
    problems.push_back({.kind = kind, .message = absl::StrCat(place, ": ", message)});
  }
};

// Messages quote the file, which may hold anything.
std::string Printable(absl::string_view text) {
  std::string printable(text);
  for (char& c : printable) {
    if (!absl::ascii_isprint(c)) c = '?';
  }
  return printable;
}

void OnCompilerMessage(int level, const char* /*file*/, int line, const YR_RULE* /*rule*/,
                       const char* message, void* user_data) {
  auto& report = *static_cast<Report*>(user_data);
  if (std::exchange(report.at_include, false)) {
    report.Add(Kind::kBroken, line, "`include` is not supported; put the rules into this file");
    return;
  }
  report.Add(level == YARA_ERROR_LEVEL_ERROR ? Kind::kBroken : Kind::kSlow, line,
             Printable(message));
}

// Returning nothing makes libyara report an error at the line of the `include`.
const char* OnInclude(const char* /*include*/, const char* /*file*/, const char* /*name_space*/,
                      void* user_data) {
  static_cast<Report*>(user_data)->at_include = true;
  return nullptr;
}

void OnIncludeFree(const char* /*text*/, void* /*user_data*/) {}

// libyara keeps global state from its first use until the process ends: threads may still scan
// while the process exits, so it is not taken down.
bool LibraryIsReady() {
  static const int code = yr_initialize();
  return code == ERROR_SUCCESS;
}

// As fread and fwrite.
size_t ReadFromView(void* to, size_t size, size_t count, void* user_data) {
  auto& rest = *static_cast<absl::string_view*>(user_data);
  if (size == 0 || rest.size() / size < count) return 0;
  std::memcpy(to, rest.data(), size * count);
  rest.remove_prefix(size * count);
  return count;
}

size_t AppendToString(const void* from, size_t size, size_t count, void* user_data) {
  static_cast<std::string*>(user_data)->append(static_cast<const char*>(from), size * count);
  return count;
}

int OnImport(YR_SCAN_CONTEXT* /*context*/, int message, void* data, void* user_data) {
  if (message != CALLBACK_MSG_IMPORT_MODULE) return CALLBACK_CONTINUE;
  *static_cast<std::string*>(user_data) = static_cast<YR_MODULE_IMPORT*>(data)->module_name;
  return CALLBACK_ERROR;  // before the module is loaded
}

// The first module that a scan would load; empty if none. Asked of libyara itself, by a scan of
// nothing: the compiler does not tell.
absl::StatusOr<std::string> FirstImport(YR_RULES* rules) {
  std::string module;
  const uint8_t nothing = 0;
  const int code = yr_rules_scan_mem(rules, &nothing, 0, SCAN_FLAGS_NO_TRYCATCH, OnImport, &module,
                                     /*timeout=*/1);
  if (module.empty() && code == ERROR_SCAN_TIMEOUT) {
    return absl::ResourceExhaustedError("slow: scanning nothing takes more than 1 s");
  }
  if (module.empty() && code != ERROR_SUCCESS) {
    return absl::InternalError(absl::StrCat("cannot be scanned with (libyara error ", code, ")"));
  }
  return module;
}

// Where `module` is imported, from 1; 0 if that is not at the start of a line.
int LineOfImport(absl::string_view text, absl::string_view module) {
  const std::string quoted = absl::StrCat("\"", module, "\"");
  int number = 0;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    ++number;
    line = absl::StripLeadingAsciiWhitespace(line);
    if (!absl::ConsumePrefix(&line, "import")) continue;
    if (absl::ConsumePrefix(&(line = absl::StripLeadingAsciiWhitespace(line)), quoted)) {
      return number;
    }
  }
  return 0;
}

bool HasPublicRule(const YR_RULES* rules) {
  const YR_RULE* rule;
  yr_rules_foreach(rules, rule) {
    if (!RULE_IS_PRIVATE(rule)) return true;
  }
  return false;
}

// What libyara accepts and we do not.
void CheckCompiled(const YaraRules& rules, absl::string_view text, Report& report) {
  const absl::StatusOr<std::string> module = FirstImport(rules.raw());
  if (!module.ok()) {
    report.Add(absl::IsResourceExhausted(module.status()) ? Kind::kSlow : Kind::kBroken, 0,
               module.status().message());
  } else if (!module->empty()) {
    report.Add(Kind::kBroken, LineOfImport(text, *module),
               absl::StrCat("module `", Printable(*module), "`: `import` is not supported"));
  } else if (!HasPublicRule(rules.raw())) {
    report.Add(Kind::kBroken, 0, "no rule that could match; a private rule alone cannot");
  } else if (const absl::Status speed = CheckSpeed(rules, text); !speed.ok()) {
    report.Add(Kind::kSlow, 0, speed.message());
  }
}

// nullptr if there is an error, which is then in `report`.
YR_RULES* CompileText(absl::string_view text, Report& report) {
  YR_COMPILER* raw_compiler = nullptr;
  if (!LibraryIsReady() || yr_compiler_create(&raw_compiler) != ERROR_SUCCESS) {
    report.Add(Kind::kBroken, 0, "libyara cannot be started; is memory short?");
    return nullptr;
  }
  const std::unique_ptr<YR_COMPILER, decltype(&yr_compiler_destroy)> compiler(raw_compiler,
                                                                              yr_compiler_destroy);
  yr_compiler_set_callback(raw_compiler, OnCompilerMessage, &report);
  yr_compiler_set_include_callback(raw_compiler, OnInclude, OnIncludeFree, &report);

  const int errors = yr_compiler_add_string(raw_compiler, std::string(text).c_str(), nullptr);
  if (errors > 0) {
    if (report.problems.empty()) report.Add(Kind::kBroken, 0, "does not compile");
    return nullptr;
  }
  YR_RULES* rules = nullptr;
  if (yr_compiler_get_rules(raw_compiler, &rules) != ERROR_SUCCESS) {
    report.Add(Kind::kBroken, 0, "libyara cannot make rules of it; is memory short?");
    return nullptr;
  }
  return rules;
}

}  // namespace

YaraCompiled YaraRules::Compile(absl::string_view text, absl::string_view name) {
  Report report{.name = std::string(name)};
  std::shared_ptr<const YaraRules> rules;
  if (text.size() > kYaraFileBytesMax) {
    report.Add(Kind::kBroken, 0,
               absl::StrCat(text.size(), " bytes exceed limit ", kYaraFileBytesMax));
  } else if (const size_t nul = text.find('\0'); nul != absl::string_view::npos) {
    report.Add(Kind::kBroken, 0, absl::StrCat("a NUL byte at offset ", nul));
  } else if (YR_RULES* raw = CompileText(text, report); raw != nullptr) {
    rules.reset(new YaraRules(raw));
    // Measured only if libyara itself had no complaint.
    if (report.problems.empty()) CheckCompiled(*rules, text, report);
  }
  if (report.left_out > 0) {
    report.problems.push_back(
        {.kind = Kind::kBroken,
         .message = absl::StrCat(name, ": ", report.left_out, " more problems are not shown")});
  }
  if (!report.problems.empty()) rules = nullptr;
  return {.rules = std::move(rules), .problems = std::move(report.problems)};
}

absl::StatusOr<std::shared_ptr<const YaraRules>> YaraRules::Create(absl::string_view text,
                                                                   absl::string_view name) {
  YaraCompiled compiled = Compile(text, name);
  if (compiled.rules != nullptr) return std::move(compiled.rules);
  return absl::InvalidArgumentError(absl::StrJoin(
      compiled.problems, "\n", [](std::string* out, const lang::InspectionProblem& problem) {
        out->append(problem.message);
      }));
}

absl::Status YaraRules::Prepare() {
  if (LibraryIsReady()) return absl::OkStatus();
  return absl::InternalError("libyara cannot be started; is memory short?");
}

absl::StatusOr<std::shared_ptr<const YaraRules>> YaraRules::Load(absl::string_view compiled) {
  RIPS_RETURN_IF_ERROR(Prepare());
  YR_STREAM stream = {.user_data = &compiled, .read = ReadFromView, .write = nullptr};
  YR_RULES* rules = nullptr;
  if (const int code = yr_rules_load_stream(&stream, &rules); code != ERROR_SUCCESS) {
    return absl::InvalidArgumentError(
        absl::StrCat("libyara does not take compiled rules (error ", code, ")"));
  }
  return std::shared_ptr<const YaraRules>(new YaraRules(rules));
}

absl::StatusOr<std::string> YaraRules::Serialize() const {
  std::string compiled;
  YR_STREAM stream = {.user_data = &compiled, .read = nullptr, .write = AppendToString};
  if (const int code = yr_rules_save_stream(rules_, &stream); code != ERROR_SUCCESS) {
    return absl::InternalError(
        absl::StrCat("libyara cannot write compiled rules (error ", code, ")"));
  }
  return compiled;
}

YaraRules::~YaraRules() { yr_rules_destroy(rules_); }

}  // namespace rips::inspect

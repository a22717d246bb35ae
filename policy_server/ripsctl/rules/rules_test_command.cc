// `ripsctl rules test`: runs unit tests of rules (policy_server/policy/replay/rule_test_file.h).
// Exits with kDone if all passed, kRefused if one failed or rules do not compile, kUsage if a file
// cannot be read or is not well formed; then no test is run. With `--run`, kRefused if no test has
// such a name. JSON:
// {"tests":count,"failed":count,"files":[{"path","ok":bool,"tests":[{"name","line","ok":bool,
// "failures":[{"line","what","expected":[..],"got":[..]}]}],"not_exercised":[rules], "refused"?:{as
// rules check}}]}. `not_exercised` is empty with `--run`. `--output junit`: one test suite a file.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/replay/rule_set.h"
#include "policy_server/policy/replay/rule_test_file.h"
#include "policy_server/policy/replay/rule_test_runner.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/real_clock.h"
#include "services/text/nearest.h"

namespace rips::ripsctl {
namespace {

using replay::FileOutcome;
using replay::TestFailure;
using replay::TestOutcome;

// One file and what became of it.
struct Tested {
  replay::RuleTestFile file;
  replay::RuleSet rules;
  FileOutcome outcome;

  bool refused() const { return rules.program == nullptr; }
  size_t failed() const {
    return static_cast<size_t>(
        std::count_if(outcome.tests.begin(), outcome.tests.end(),
                      [](const TestOutcome& test) { return !test.passed(); }));
  }
};

std::string Escaped(const std::vector<std::string>& lines, absl::string_view indent) {
  std::string out;
  for (const std::string& line : lines) absl::StrAppend(&out, indent, EscapeText(line), "\n");
  return out;
}

void PrintText(const std::vector<Tested>& all, TextStream out) {
  size_t tests = 0;
  size_t failed = 0;
  size_t refused = 0;
  for (const Tested& one : all) {
    const std::string path = EscapeText(one.file.path);
    if (one.refused()) {
      ++refused;
      out << Lines{lang::RenderText(one.rules.files, one.rules.diagnostics)} << path
          << ": not run: its rules were refused\n";
      continue;
    }
    for (const TestOutcome& test : one.outcome.tests) {
      for (const TestFailure& failure : test.failures) {
        out << path << ":" << failure.line << ": " << EscapeText(test.name) << ": "
            << EscapeText(failure.what) << "\n  expected:\n"
            << Lines{Escaped(failure.expected, "    ")} << "  got:\n"
            << Lines{Escaped(failure.got, "    ")};
        if (!failure.note.empty()) out << "  note: " << EscapeText(failure.note) << "\n";
      }
      if (test.unscanned.empty()) continue;
      out << path << ":" << test.line << ": " << EscapeText(test.name)
          << ": an inspection could not tell these rules, and no `unscanned` expects it: "
          << EscapeText(absl::StrJoin(test.unscanned, ", ")) << "\n";
    }
    tests += one.outcome.tests.size();
    failed += one.failed();
    if (!one.outcome.not_exercised.empty()) {
      out << path
          << ": rules not exercised: " << EscapeText(absl::StrJoin(one.outcome.not_exercised, ", "))
          << "\n";
    }
  }
  out << (failed + refused == 0 ? "ok: " : "failed: ") << tests << " tests, " << failed
      << " failed";
  if (refused > 0) out << ", " << refused << " files not run";
  out << "\n";
}

Json TestedToJson(const Tested& one) {
  Json tests = Json::array();
  for (const TestOutcome& test : one.outcome.tests) {
    Json failures = Json::array();
    for (const TestFailure& failure : test.failures) {
      failures.push_back({{"line", failure.line},
                          {"what", failure.what},
                          {"expected", failure.expected},
                          {"got", failure.got}});
      if (!failure.note.empty()) failures.back()["note"] = failure.note;
    }
    tests.push_back({{"name", test.name},
                     {"line", test.line},
                     {"ok", test.passed()},
                     {"failures", std::move(failures)}});
    if (!test.unscanned.empty()) tests.back()["unscanned"] = test.unscanned;
  }
  Json out = {{"path", one.file.path},
              {"ok", !one.refused() && one.failed() == 0},
              {"tests", std::move(tests)},
              {"not_exercised", one.outcome.not_exercised}};
  if (one.refused()) {
    out["refused"] = Json::parse(lang::RenderJson(one.rules.files, one.rules.diagnostics));
  }
  return out;
}

void PrintAllJson(const std::vector<Tested>& all, TextStream out) {
  size_t tests = 0;
  size_t failed = 0;
  Json files = Json::array();
  for (const Tested& one : all) {
    tests += one.outcome.tests.size();
    failed += one.failed();
    files.push_back(TestedToJson(one));
  }
  PrintJson({{"tests", tests}, {"failed", failed}, {"files", std::move(files)}}, out);
}

// In an attribute or as text; EscapeText has taken out what XML cannot hold.
std::string Xml(absl::string_view text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

std::string XmlLine(absl::string_view text) { return Xml(EscapeText(text)); }

std::string JunitText(const std::vector<Tested>& all) {
  std::ostringstream out;
  out << "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites>\n";
  for (const Tested& one : all) {
    const std::string suite = XmlLine(one.file.path);
    out << "  <testsuite name=\"" << suite << "\" tests=\""
        << (one.refused() ? 1 : one.outcome.tests.size()) << "\" failures=\"" << one.failed()
        << "\" errors=\"" << (one.refused() ? 1 : 0) << "\">\n";
    if (one.refused()) {
      out << "    <testcase classname=\"" << suite << "\" name=\"(rules)\">\n"
          << "      <error message=\"the rules were refused\">"
          << Xml(lang::RenderText(one.rules.files, one.rules.diagnostics))
          << "</error>\n    </testcase>\n";
    }
    for (const TestOutcome& test : one.outcome.tests) {
      out << "    <testcase classname=\"" << suite << "\" name=\"" << XmlLine(test.name) << "\"";
      if (test.passed()) {
        out << "/>\n";
        continue;
      }
      out << ">\n";
      for (const TestFailure& failure : test.failures) {
        out << "      <failure message=\"" << XmlLine(failure.what) << "\">" << suite << ":"
            << failure.line << "\nexpected:\n"
            << Xml(Escaped(failure.expected, "  ")) << "got:\n"
            << Xml(Escaped(failure.got, "  "));
        if (!failure.note.empty()) out << "note: " << XmlLine(failure.note) << "\n";
        out << "</failure>\n";
      }
      out << "    </testcase>\n";
    }
    out << "  </testsuite>\n";
  }
  out << "</testsuites>\n";
  return out.str();
}

// `pattern` is a part of `name`; if it holds `*` (any text) or `?` (one byte), all of it. In time
// of the product of their lengths.
bool IsNamed(absl::string_view pattern, absl::string_view name) {
  if (pattern.find_first_of("*?") == absl::string_view::npos) {
    return absl::StrContains(name, pattern);
  }
  size_t at = 0;
  size_t star = absl::string_view::npos;
  size_t after_star = 0;
  for (size_t i = 0; i < name.size();) {
    if (at < pattern.size() && pattern[at] == '*') {
      star = at++;
      after_star = i;
    } else if (at < pattern.size() && (pattern[at] == '?' || pattern[at] == name[i])) {
      ++at;
      ++i;
    } else if (star != absl::string_view::npos) {
      at = star + 1;
      i = ++after_star;
    } else {
      return false;
    }
  }
  return pattern.find_first_not_of('*', at) == absl::string_view::npos;
}

absl::Status NoSuchTest(absl::string_view pattern, const std::vector<std::string>& names) {
  constexpr size_t kShown = 20;
  const std::vector<absl::string_view> views(names.begin(), names.end());
  const std::string hint = NearestHint(pattern, views);
  const size_t shown = std::min(names.size(), kShown);
  std::string list;
  for (size_t i = 0; i < shown; ++i) absl::StrAppend(&list, i > 0 ? ", `" : "`", names[i], "`");
  if (names.size() > shown) absl::StrAppend(&list, " and ", names.size() - shown, " more");
  return absl::NotFoundError(absl::StrCat("no test is named `", pattern, "`; ", hint,
                                          hint.empty() ? "the files have " : " The files have ",
                                          list));
}

class TestRulesCommand final : public Command {
 public:
  TestRulesCommand()
      : Command({"rules", "test", "Run unit tests of rules; needs no server",
                 /*needs_server=*/false, /*writes_junit=*/true}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("FILE", paths_, "Test files, for example warehouse_test.yaml")->required();
    app.add_option(
        "--run", run_,
        "Run only tests of which this is a part of the name, or, with * or ?, all of it");
    app.add_option("--bundle", bundle_,
                   "Directory of a bundle to test in the place of the rules that the files name");
  }
  absl::Status Check() override {
    std::error_code error;
    if (bundle_.empty() || std::filesystem::is_directory(bundle_, error)) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat("--bundle: `", bundle_, "` is not the directory of a bundle"));
  }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    std::vector<Tested> all;
    std::vector<std::string> problems;
    for (const std::string& path : paths_) {
      absl::StatusOr<Tested> tested = Load(path);
      if (tested.ok()) {
        all.push_back(*std::move(tested));
      } else {
        problems.push_back(std::string(tested.status().message()));
      }
    }
    if (!problems.empty()) return Unusable(env, problems);
    if (!run_.empty()) {
      if (const absl::Status chosen = Choose(all); !chosen.ok()) return Failed(env, chosen);
    }
    for (Tested& one : all) {
      if (one.refused()) continue;
      absl::StatusOr<FileOutcome> outcome = replay::RunRuleTests(one.file, one.rules);
      if (!outcome.ok()) {
        problems.push_back(std::string(outcome.status().message()));
        continue;
      }
      one.outcome = *std::move(outcome);
      if (!run_.empty()) one.outcome.not_exercised.clear();
    }
    if (!problems.empty()) return Unusable(env, problems);
    if (env.output == Output::kJunit) {
      env.out.Raw(JunitText(all));
    } else if (env.json()) {
      PrintAllJson(all, env.out);
    } else {
      PrintText(all, env.out);
    }
    const bool good = std::all_of(all.begin(), all.end(), [](const Tested& one) {
      return !one.refused() && one.failed() == 0;
    });
    return good ? ExitCode::kDone : ExitCode::kRefused;
  }

 private:
  absl::StatusOr<Tested> Load(const std::string& path) const {
    Tested out;
    RIPS_ASSIGN_OR_RETURN(const std::string text, ReadConfigFile(path));
    RIPS_ASSIGN_OR_RETURN(out.file, replay::ParseRuleTestFile(path, text));
    if (!bundle_.empty()) out.file.rules = {bundle_};
    RIPS_ASSIGN_OR_RETURN(out.rules,
                          replay::LoadRuleSet(out.file.rules, out.file.options, &clock_));
    return out;
  }

  // Leaves the tests that --run names, and the files that have one. NotFound if none has.
  absl::Status Choose(std::vector<Tested>& all) const {
    std::vector<std::string> names;
    for (Tested& one : all) {
      std::vector<replay::RuleTest>& tests = one.file.tests;
      for (const replay::RuleTest& test : tests) names.push_back(test.name);
      tests.erase(
          std::remove_if(tests.begin(), tests.end(),
                         [&](const replay::RuleTest& test) { return !IsNamed(run_, test.name); }),
          tests.end());
    }
    all.erase(std::remove_if(all.begin(), all.end(),
                             [](const Tested& one) { return one.file.tests.empty(); }),
              all.end());
    if (!all.empty()) return absl::OkStatus();
    return NoSuchTest(run_, names);
  }

  // Messages may have several lines.
  static ExitCode Unusable(Env& env, const std::vector<std::string>& problems) {
    for (const std::string& problem : problems) {
      env.err << "error: " << Lines{problem} << "\n";
    }
    return ExitCode::kUsage;
  }

  const RealClock clock_;
  std::vector<std::string> paths_;
  std::string run_;
  std::string bundle_;
};

}  // namespace

Commands TestRules() { return MakeCommands<TestRulesCommand>(); }

}  // namespace rips::ripsctl

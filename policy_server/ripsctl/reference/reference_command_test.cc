// `ripsctl completion bash` in bash itself, and `ripsctl man` in groff.
#include <filesystem>
#include <string>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/offline_run.h"
#include "policy_server/ripsctl/reference/bash_completion.h"
#include "policy_server/ripsctl/reference/man_page.h"
#include "policy_server/ripsctl/run_program.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class CompletionTest : public testing::Test {
 protected:
  // What bash has in COMPREPLY for these words, the last of which is being written.
  std::string Complete(const std::string& words) {
    directory_.Write(".config/rips/ripsctl.yaml",
                     absl::StrCat("output: json\ncontexts: {lab: {server: \"$(touch ",
                                  directory_.path(), "/ran)\"}, site: {server: \"b:1\"}}\n"));
    const std::string script = directory_.Write("script", RunOffline({"completion", "bash"}).out);
    const std::string test = directory_.Write(
        "test", absl::StrCat("set -u\nsource ", script, "\nexport HOME=", directory_.path(),
                             "\nCOMP_WORDS=(" RIPS_BIN_DIR "/ripsctl ", words,
                             ")\nCOMP_CWORD=$((${#COMP_WORDS[@]} - 1))\n_ripsctl\n",
                             "echo \"${COMPREPLY[*]}\"\n"));
    const Result result = RunProgram({"bash", "--norc", test});
    EXPECT_EQ(result.code, 0) << words;
    EXPECT_EQ(result.err, "") << words;
    return result.out.substr(0, result.out.size() - 1);
  }

  const TestDirectory directory_;
};

TEST_F(CompletionTest, CommandsAndFlags) {
  EXPECT_EQ(Complete("ro"), "robot");
  EXPECT_EQ(Complete("robot l"), "list");
  EXPECT_EQ(Complete("a"), "agent alert audit");
  EXPECT_EQ(Complete("level ''"), "approve history lower raise show");
  EXPECT_EQ(Complete("level lower r1 --acc"), "--accept-blind");
  EXPECT_EQ(Complete("level lower r1 --ser"), "--server");
  EXPECT_EQ(Complete("--server x:1 alert w"), "watch") << "a value is no command";
  EXPECT_EQ(Complete("--server robot l"), "level") << "neither if it looks like one";
  EXPECT_EQ(Complete("--server = x:1 alert w"), "watch") << "as bash splits --server=x:1";
  EXPECT_EQ(Complete("nonsense r"), "record robot rules");
  EXPECT_EQ(Complete("robot show ''"), "");
  EXPECT_EQ(Complete("man"), "") << "hidden";
}

TEST_F(CompletionTest, Values) {
  EXPECT_EQ(Complete("robot list --output ''"), "json text");
  EXPECT_EQ(Complete("robot list --output = j"), "json");
  EXPECT_EQ(Complete("robot list --output ="), "json text");
  EXPECT_EQ(Complete("rules check --dialect p"), "prototype");
  EXPECT_EQ(Complete("--context s"), "site");
  EXPECT_EQ(Complete("robot list --context ''"), "lab site");
  EXPECT_EQ(Complete("context use l"), "lab");
  EXPECT_FALSE(std::filesystem::exists(directory_.path() + "/ran")) << "a setting ran as a command";
  EXPECT_EQ(Complete("context list --n"), "--names");
  EXPECT_EQ(Complete("robot list --cert ''"), "") << "bash completes files";
}

TEST_F(CompletionTest, NeedsNoSettings) {
  EXPECT_EQ(RunOffline({"completion", "bash"}).code, 0);
  EXPECT_EQ(RunOffline({"completion", "fish"}).code, 2);
  EXPECT_EQ(RunOffline({"completion", "bash", "more"}).code, 2);
}

// The subcommands that a page of help lists.
std::vector<std::string> Listed(const std::string& help) {
  std::vector<std::string> names;
  const std::vector<std::string> parts = absl::StrSplit(help, "\nSubcommands:\n");
  if (parts.size() < 2) return names;
  for (const absl::string_view line : absl::StrSplit(parts[1], '\n')) {
    if (line.empty()) break;
    names.push_back(std::string(absl::StripAsciiWhitespace(line.substr(0, 28))));
  }
  return names;
}

TEST(ManPageTest, HasEveryCommandOfTheHelp) {
  const Result page = RunOffline({"man"});
  ASSERT_EQ(page.code, 0);
  const std::string text = absl::StrReplaceAll(page.out, {{"\\-", "-"}});
  const std::vector<std::string> nouns = Listed(RunOffline({"--help"}).out);
  EXPECT_THAT(nouns, Not(testing::Contains("man")));
  int commands = 0;
  for (const std::string& noun : nouns) {
    std::vector<std::string> verbs = Listed(RunOffline({noun, "--help"}).out);
    for (std::string& verb : verbs) verb = absl::StrCat(noun, " ", verb);
    if (verbs.empty()) verbs.push_back(noun);
    for (const std::string& verb : verbs) {
      EXPECT_THAT(text, HasSubstr(absl::StrCat("\n.SS \"ripsctl ", verb, "\"\n")));
      ++commands;
    }
  }
  EXPECT_GT(commands, 40);
  EXPECT_THAT(text, AllOf(HasSubstr(".SH \"EXIT STATUS\"\n.TP\n\\fB0\\fR\nsuccess.\n"),
                          HasSubstr(".SH ENVIRONMENT"), HasSubstr("\\fBRIPSCTL_CONTEXT\\fR"),
                          HasSubstr(".SH FILES"), HasSubstr("ripsctl.yaml")));
}

TEST(ManPageTest, GroffHasNoWarnings) {
  const TestDirectory directory;
  const std::string path = directory.Write("ripsctl.1", RunOffline({"man"}).out);
  const Result version = RunProgram({"bash", "-c", "command -v groff"});
  if (version.code != 0) GTEST_SKIP() << "no groff on this machine";
  const Result page = RunProgram({"groff", "-man", "-ww", "-Tutf8", "-P-cbou", path});
  EXPECT_EQ(page.code, 0);
  EXPECT_EQ(page.err, "");
  std::string text = page.out;
  absl::RemoveExtraAsciiWhitespace(&text);  // lines are filled
  EXPECT_THAT(text, AllOf(HasSubstr("ripsctl level lower [options] ROBOT"),
                          HasSubstr("spiffe://DOMAIN/robot/ROBOT/sensor/HOST"),
                          HasSubstr("one of rips, prototype; default: rips")));
}

TEST(ManPageTest, TextMeansItselfInRoff) {
  const CommandDoc program = {
      .synopsis = ".so /etc/passwd",
      .flags = {{.names = {"--x"}, .value = "T", .text = "'br\\n \\fB\n.sy x", .required = true}},
      .commands = {{.words = "go", .synopsis = "Say \"go\"."}}};
  const std::string page = ManPage(program, "1\"\n.sy x");
  for (const absl::string_view line : absl::StrSplit(page, '\n')) {
    EXPECT_FALSE(absl::StartsWith(line, "'")) << line;
    if (!absl::StartsWith(line, ".")) continue;
    EXPECT_TRUE(absl::StartsWith(line, ".TH ") || absl::StartsWith(line, ".SH ") ||
                absl::StartsWith(line, ".SS ") || line == ".TP" || line == ".PP" || line == ".nh" ||
                line == ".ad l")
        << line;
  }
  EXPECT_THAT(page, HasSubstr("\\(aqbr\\en \\efB .sy x (required).\n"));
  EXPECT_THAT(page, HasSubstr("Say \\(dqgo\\(dq.\n"));
}

TEST(BashCompletionTest, TextCannotLeaveItsQuotes) {
  const CommandDoc program = {
      .flags = {{.names = {"--x"}, .value = "a|b'; exit 7; '", .choices = {"a", "b'; exit 7; '"}}}};
  const Result result = RunProgram({"bash", "-c", BashCompletion(program)});
  EXPECT_EQ(result.code, 0);
  EXPECT_EQ(result.err, "");
}

}  // namespace
}  // namespace rips::ripsctl

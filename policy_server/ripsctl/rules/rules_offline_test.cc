// `ripsctl rules check`, `fmt` and `builtins`: verbs that need neither server nor settings.
#include <sys/stat.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/limits.h"
#include "policy_server/ripsctl/offline_run.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;
using ::testing::StartsWith;

constexpr char kUgly[] = "levels:A;B soft; # two\nrules Msg:true?trigger(B);";
constexpr char kPretty[] = R"(levels:
  A;
  B soft;  # two

rules Msg:
  true ? trigger(B);
)";
constexpr char kBroken[] = "levels: A\nrules Msg: true ? trigger(;\n";
constexpr char kFirstManifest[] = "name: first\nrules: [first.rul]\nlevels: [A, B]\n";

class RulesOfflineTest : public testing::Test {
 protected:
  nlohmann::json RunJson(std::vector<std::string> args, int expected_code,
                         const std::string& input = "") {
    args.insert(args.end(), {"--output", "json"});
    const Result result = RunOffline(args, input);
    EXPECT_EQ(result.code, expected_code) << result.err;
    EXPECT_EQ(result.err, "");
    return nlohmann::json::parse(result.out, nullptr, false);
  }

  std::string Write(const std::string& name, const std::string& text) {
    return directory_.Write(name, text);
  }
  std::string Folder(const std::string& name) {
    const std::string path = absl::StrCat(folder_, "/", name);
    std::filesystem::create_directory(path);
    return path;
  }
  static std::string Read(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  }

  const TestDirectory directory_;
  const std::string folder_ = directory_.path();
};

TEST_F(RulesOfflineTest, CheckLooksAtYaraFilesAndPlugins) {
  const std::string rules = Write("r.rul",
                                  "levels: A;\nrules Msg: topicin(\"/a\") && (payload(\"y.yar\") "
                                  "|| plugin(\"p\")) ? alert(\"x\");\n");
  const Result missing = RunOffline({"rules", "check", rules});
  EXPECT_EQ(missing.code, 1);
  EXPECT_THAT(missing.out,
              AllOf(HasSubstr("y.yar"), HasSubstr("plugins/p"), Not(HasSubstr("ok:"))));

  Write("y.yar", "rule r { condition: nothing }");
  std::filesystem::create_directory(folder_ + "/plugins");
  const std::string plugin = Write("plugins/p", "#!/bin/sh\nexit 0\n");
  EXPECT_EQ(chmod(plugin.c_str(), 0755), 0);
  const nlohmann::json broken = RunJson({"rules", "check", rules}, 1)["files"][0]["diagnostics"];
  ASSERT_EQ(broken.size(), 1u);
  EXPECT_EQ(broken[0]["kind"], "BrokenInspection");

  Write("y.yar", "rule r { strings: $a = \"attack\" condition: $a }");
  EXPECT_EQ(RunOffline({"rules", "check", rules}).out, "ok: 1 rules, 1 levels\n");
}

TEST_F(RulesOfflineTest, CheckReadsStandardInput) {
  EXPECT_EQ(RunOffline({"rules", "check", "-"}, kPretty).out, "ok: 1 rules, 2 levels\n");
  EXPECT_THAT(RunOffline({"rules", "check", "-"}, kBroken).out, HasSubstr("<stdin>:2:1: error: "));
  const std::string levels = Write("levels.rul", "levels: A; B;\n");
  EXPECT_EQ(RunOffline({"rules", "check", levels, "-"}, "rules Msg: true ? trigger(B);").code, 0);
  EXPECT_EQ(RunOffline({"rules", "check", "-", "-"}).code, 2);
  const std::string large(lang::kFileBytesMax + 1, ' ');
  EXPECT_EQ(RunOffline({"rules", "check", "-"}, large).err,
            "error: standard input has more than 1048576 bytes\n");
}

TEST_F(RulesOfflineTest, CheckRefusesWarningsIfAsked) {
  const std::string clean = Write("clean.rul", kPretty);
  const std::string warned =
      Write("warned.rul", "levels: A;\nrules Msg: 017 < 20 ? alert(\"\");\n");

  EXPECT_EQ(RunOffline({"rules", "check", "--werror", clean}).out, "ok: 1 rules, 2 levels\n");
  const Result tolerated = RunOffline({"rules", "check", warned});
  EXPECT_EQ(tolerated.code, 0);
  EXPECT_THAT(tolerated.out, AllOf(HasSubstr("warning: "), HasSubstr("ok: 1 rules, 1 levels\n")));
  const Result refused = RunOffline({"rules", "check", "--werror", warned});
  EXPECT_EQ(refused.code, 1);
  EXPECT_THAT(refused.out, AllOf(HasSubstr("refused: 2 warnings, and --werror is given\n"),
                                 Not(HasSubstr("ok:"))));
  EXPECT_EQ(RunJson({"rules", "check", "--werror", warned}, 1)["files"][0]["ok"], true);
  // A note is no warning.
  const std::string noted =
      Write("noted.rul", "levels: A;\nrules Graph: nodesinclude(\"a\") ? alert(\"\");\n");
  EXPECT_EQ(RunOffline({"rules", "check", "--werror", noted}).code, 0);
}

TEST_F(RulesOfflineTest, CheckTakesABundle) {
  const std::string dir = Folder("first");
  Write("first/manifest.yaml", kFirstManifest);
  Write("first/first.rul", kPretty);
  const std::string ok = "ok: bundle `first`, 1 rules, 2 levels, sha256:";

  const Result result = RunOffline({"rules", "check", dir});

  EXPECT_EQ(result.code, 0) << result.out << result.err;
  EXPECT_THAT(result.out, StartsWith(ok));
  EXPECT_EQ(result.out.size(), ok.size() + 64 + 1);
  EXPECT_EQ(RunOffline({"rules", "check", dir + "/"}).out, result.out);
  EXPECT_EQ(RunOffline({"rules", "check", dir + "/manifest.yaml"}).out, result.out);
  const nlohmann::json json = RunJson({"rules", "check", dir}, 0);
  ASSERT_THAT(json["files"], SizeIs(1));
  EXPECT_EQ(json["files"][0]["path"], dir + "/first.rul");
  EXPECT_EQ(json["files"][0]["ok"], true);
  const std::string id = result.out.substr(ok.size() - 7, 7 + 64);
  EXPECT_EQ(json["bundle"], nlohmann::json({{"name", "first"},
                                            {"id", id},
                                            {"ok", true},
                                            {"problems", nlohmann::json::array()},
                                            {"warnings", nlohmann::json::array()}}));
}

TEST_F(RulesOfflineTest, CheckRefusesABundleAsTheServerDoes) {
  const std::string dir = Folder("first");
  Write("first/first.rul", kPretty);
  const struct {
    std::string manifest;
    std::string message;
  } cases[] = {
      {"name: first\nrules: [gone.rul]\nlevels: [A, B]\n",
       "error: bundle `" + dir + "`: `gone.rul` does not exist\n"},
      {"name: first\nrules: [first.rul]\nlevels: [B, A]\n", "make them equal"},
      {"name: first\nrules: [first.rul]\nlevels: [A, B]\nyara: [x.yar]\n",
       "`x.yar` does not exist"},
      {"name: first\nnme: x\nrules: [first.rul]\nlevels: [A, B]\n",
       "error: " + dir + "/manifest.yaml:2:1: unknown key `nme`; did you mean `name`\n  nme: x\n"},
      {"\x1b[2J: 1\n", "\\x1b"},
  };
  for (const auto& each : cases) {
    Write("first/manifest.yaml", each.manifest);
    const Result result = RunOffline({"rules", "check", dir});
    EXPECT_EQ(result.code, 1) << each.message;
    EXPECT_THAT(result.out,
                AllOf(HasSubstr(each.message), Not(HasSubstr("ok:")), Not(HasSubstr("\x1b"))));
    const nlohmann::json bundle = RunJson({"rules", "check", dir}, 1)["bundle"];
    EXPECT_EQ(bundle["ok"], false);
    EXPECT_EQ(bundle["id"], "");
    EXPECT_THAT(bundle["problems"], SizeIs(1));
  }
  Write("first/manifest.yaml", kFirstManifest);
  Write("first/first.rul", kBroken);
  const nlohmann::json json = RunJson({"rules", "check", dir}, 1);
  EXPECT_THAT(json["files"][0]["diagnostics"], SizeIs(2));
  EXPECT_EQ(json["bundle"]["ok"], false);
  EXPECT_THAT(json["bundle"]["problems"], SizeIs(0));
}

TEST_F(RulesOfflineTest, CheckWarnsOfABundleThatTheServerWouldNotFind) {
  const std::string dir = Folder("copy-of-first");
  Write("copy-of-first/manifest.yaml", kFirstManifest);
  Write("copy-of-first/first.rul", kPretty);

  const Result result = RunOffline({"rules", "check", dir});

  EXPECT_EQ(result.code, 0);
  EXPECT_THAT(result.out, AllOf(StartsWith("warning: the manifest calls it `first`"),
                                HasSubstr("\nok: bundle `first`")));
  EXPECT_EQ(RunOffline({"rules", "check", "--werror", dir}).code, 1);
  EXPECT_THAT(RunJson({"rules", "check", "--werror", dir}, 1)["bundle"]["warnings"], SizeIs(1));
}

TEST_F(RulesOfflineTest, CheckWithWrongArgumentsSaysWhat) {
  const std::string dir = Folder("first");
  Write("first/manifest.yaml", kFirstManifest);
  const std::string rules = Write("first/first.rul", kPretty);
  const struct {
    std::vector<std::string> args;
    std::string message;
  } cases[] = {
      {{"rules", "check"}, "FILE"},
      {{"rules", "check", rules, dir}, "is a bundle; check it alone"},
      {{"rules", "check", dir, dir}, "is a bundle; check it alone"},
      {{"rules", "check", dir, "--dialect", "prototype"}, "a bundle's manifest says it"},
      {{"rules", "check", folder_}, "has no `manifest.yaml`"},
      {{"rules", "check", folder_ + "/none"}, "none"},
      {{"rules", "check", folder_ + "/manifest.yaml"}, "manifest.yaml"},
  };
  for (const auto& each : cases) {
    const Result result = RunOffline(each.args);
    EXPECT_EQ(result.code, 2) << each.message;
    EXPECT_THAT(result.err, HasSubstr(each.message));
    EXPECT_EQ(result.out, "");
  }
}

TEST_F(RulesOfflineTest, FmtPrintsOneFile) {
  const std::string path = Write("a.rul", kUgly);

  const Result result = RunOffline({"rules", "fmt", path});

  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_EQ(result.out, kPretty);
  EXPECT_EQ(Read(path), kUgly);
  const nlohmann::json json = RunJson({"rules", "fmt", path}, 0);
  ASSERT_THAT(json["files"], SizeIs(1));
  EXPECT_EQ(json["files"][0], nlohmann::json({{"path", path},
                                              {"ok", true},
                                              {"diagnostics", nlohmann::json::array()},
                                              {"changed", true},
                                              {"text", kPretty}}));
}

TEST_F(RulesOfflineTest, FmtReadsStandardInput) {
  EXPECT_EQ(RunOffline({"rules", "fmt", "-"}, kUgly).out, kPretty);
  EXPECT_EQ(RunOffline({"rules", "fmt", "-"}).out, "");
  EXPECT_EQ(RunOffline({"rules", "fmt", "--check", "-"}, kPretty).code, 0);
  const Result check = RunOffline({"rules", "fmt", "--check", "-"}, kUgly);
  EXPECT_EQ(check.code, 1);
  EXPECT_EQ(check.out, "<stdin>\n");
  EXPECT_THAT(RunOffline({"rules", "fmt", "-"}, kBroken).err, HasSubstr("<stdin>:2:1: error: "));
  const std::string largest(lang::kFileBytesMax, ' ');
  EXPECT_EQ(RunOffline({"rules", "fmt", "-"}, largest).code, 0);
  EXPECT_EQ(RunOffline({"rules", "fmt", "-"}, largest + " ").err,
            "error: standard input has more than 1048576 bytes\n");
}

TEST_F(RulesOfflineTest, FmtRewritesWhatChanges) {
  const std::string ugly = Write("ugly.rul", kUgly);
  const std::string pretty = Write("pretty.rul", kPretty);
  ASSERT_EQ(chmod(ugly.c_str(), 0640), 0);
  const auto untouched = std::filesystem::last_write_time(pretty);

  const Result result = RunOffline({"rules", "fmt", "--write", ugly, pretty, ugly});

  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_THAT(result.out, StartsWith(absl::StrCat(ugly, "\n")));
  EXPECT_THAT(result.out, Not(HasSubstr("pretty")));
  EXPECT_EQ(Read(ugly), kPretty);
  EXPECT_EQ(std::filesystem::last_write_time(pretty), untouched);
  struct stat status = {};
  ASSERT_EQ(stat(ugly.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 07777, 0640u);
  const Result again = RunOffline({"rules", "fmt", "--write", ugly, pretty});
  EXPECT_EQ(again.code, 0);
  EXPECT_EQ(again.out, "");
}

TEST_F(RulesOfflineTest, FmtRewritesTheFileBehindALink) {
  const std::string path = Write("a.rul", kUgly);
  const std::string link = folder_ + "/link.rul";
  std::filesystem::create_symlink("a.rul", link);

  EXPECT_EQ(RunOffline({"rules", "fmt", "--write", link}).code, 0);

  EXPECT_TRUE(std::filesystem::is_symlink(link));
  EXPECT_EQ(Read(path), kPretty);
}

TEST_F(RulesOfflineTest, FmtChecksWithoutWriting) {
  const std::string ugly = Write("ugly.rul", kUgly);
  const std::string pretty = Write("pretty.rul", kPretty);

  const Result result = RunOffline({"rules", "fmt", "--check", pretty, ugly});

  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.out, absl::StrCat(ugly, "\n"));
  EXPECT_EQ(Read(ugly), kUgly);
  EXPECT_EQ(RunOffline({"rules", "fmt", "--check", pretty}).code, 0);
  const nlohmann::json json = RunJson({"rules", "fmt", "--check", pretty, ugly}, 1);
  EXPECT_EQ(json["files"][0]["changed"], false);
  EXPECT_EQ(json["files"][1]["changed"], true);
  EXPECT_FALSE(json["files"][1].contains("text"));
}

TEST_F(RulesOfflineTest, FmtLeavesABrokenFileAloneAndTreatsTheOthers) {
  const std::string broken = Write("broken.rul", kBroken);
  const std::string ugly = Write("ugly.rul", kUgly);

  const Result result = RunOffline({"rules", "fmt", "--write", broken, ugly});

  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.out, absl::StrCat(ugly, "\n"));
  EXPECT_THAT(result.err, AllOf(HasSubstr(absl::StrCat(broken, ":2:1: error: ")),
                                HasSubstr(absl::StrCat(broken, ":2:27: error: "))));
  EXPECT_EQ(Read(broken), kBroken);
  EXPECT_EQ(Read(ugly), kPretty);
  EXPECT_EQ(RunOffline({"rules", "fmt", broken}).out, "");
  const nlohmann::json json = RunJson({"rules", "fmt", broken}, 1);
  EXPECT_EQ(json["files"][0]["ok"], false);
  EXPECT_EQ(json["files"][0]["changed"], false);
  EXPECT_THAT(json["files"][0]["diagnostics"], SizeIs(2));
}

TEST_F(RulesOfflineTest, FmtWithWrongArgumentsTouchesNothing) {
  const std::string ugly = Write("ugly.rul", kUgly);
  const std::string large = Write("large.rul", std::string(lang::kFileBytesMax + 1, ' '));
  const std::vector<std::vector<std::string>> all = {
      {"rules", "fmt"},
      {"rules", "fmt", ugly, ugly},
      {"rules", "fmt", "--write", "--check", ugly},
      {"rules", "fmt", "--write", "-"},
      {"rules", "fmt", "--check", "-", "-"},
      {"rules", "fmt", "--write", ugly, "/does/not/exist.rul"},
      {"rules", "fmt", "--write", ugly, folder_},
      {"rules", "fmt", "--write", ugly, large},
  };
  for (const auto& args : all) {
    const Result result = RunOffline(args);
    EXPECT_EQ(result.code, 2) << testing::PrintToString(args);
    EXPECT_NE(result.err, "") << testing::PrintToString(args);
    EXPECT_EQ(result.out, "") << testing::PrintToString(args);
  }
  EXPECT_EQ(Read(ugly), kUgly);
}

TEST_F(RulesOfflineTest, BuiltinsNamesEverythingTheCheckerKnows) {
  const nlohmann::json json = RunJson({"rules", "builtins"}, 0);

  EXPECT_EQ(json.size(), lang::Signatures().size() + lang::PredefinedNames().size() +
                             lang::ActionSignatures().size());
  const Result text = RunOffline({"rules", "builtins"});
  const Result markdown = RunOffline({"rules", "builtins", "--markdown"});
  EXPECT_EQ(text.code, 0);
  EXPECT_EQ(markdown.code, 0);
  for (const nlohmann::json& entry : json) {
    EXPECT_THAT(entry["usage"], StartsWith(entry["name"].get<std::string>()));
    for (const char* field : {"name", "kind", "class", "result", "help"}) {
      EXPECT_NE(entry[field], "") << entry;
    }
    EXPECT_THAT(text.out, HasSubstr(absl::StrCat("\n", entry["usage"].get<std::string>(), " ")));
    EXPECT_THAT(markdown.out, HasSubstr(absl::StrCat("| `", entry["name"].get<std::string>())));
  }
}

TEST_F(RulesOfflineTest, BuiltinsAreGroupedByWhereTheyMayStand) {
  const Result text = RunOffline({"rules", "builtins"});

  std::vector<size_t> places;
  for (const char* title : {"Expressions of all rules\n", "\n\nExpressions of `rules Msg`\n",
                            "\n\nExpressions of `rules Msg` and `rules Graph`\n",
                            "\n\nExpressions of `rules External`\n", "\n\nActions\n"}) {
    places.push_back(text.out.find(title));
    EXPECT_NE(places.back(), std::string::npos) << title << text.out;
  }
  EXPECT_TRUE(std::is_sorted(places.begin(), places.end()));
  EXPECT_GT(text.out.find("\nnodes(nodes string...)"), places[2]);
  EXPECT_LT(text.out.find("\nnodes(nodes string...)"), places[3]);
}

TEST_F(RulesOfflineTest, BuiltinsShowsOne) {
  const nlohmann::json json = RunJson({"rules", "builtins", "nodes"}, 0);
  ASSERT_THAT(json, SizeIs(1));
  EXPECT_EQ(json[0]["usage"], "nodes(nodes string...)");
  EXPECT_EQ(json[0]["kind"], "builtin");
  EXPECT_EQ(json[0]["class"], "Graph");
  EXPECT_EQ(json[0]["result"], "bool");
  EXPECT_EQ(json[0]["extension"], false);
  EXPECT_EQ(RunJson({"rules", "builtins", "Robot"}, 0)[0]["extension"], true);
  EXPECT_EQ(RunJson({"rules", "builtins", "trigger"}, 0)[0]["kind"], "action");

  const Result text = RunOffline({"rules", "builtins", "nodes"});
  EXPECT_THAT(text.out, StartsWith("Expressions of `rules Msg` and `rules Graph`\n"
                                   "USAGE                   RESULT  ADDED  MEANING\n"
                                   "nodes(nodes string...)  bool    -      "));
  EXPECT_THAT(RunOffline({"rules", "builtins", "--markdown", "nodes"}).out,
              StartsWith("## Expressions of `rules Msg` and `rules Graph`\n\n"
                         "| usage | result | meaning |\n|---|---|---|\n"
                         "| `nodes(nodes string...)` | bool | "));
}

TEST_F(RulesOfflineTest, BuiltinsShowsTheWordsThatMeanSomething) {
  const nlohmann::json words = RunJson({"rules", "builtins", "agent"}, 0)[0]["words"];
  EXPECT_EQ(words[0]["parameter"], "kind");
  EXPECT_FALSE(words[0].contains("after"));
  EXPECT_EQ(words[1]["parameter"], "state");
  EXPECT_EQ(words[1]["after"], words[0]["values"][0]);
  EXPECT_EQ(words.size(), 1 + words[0]["values"].size());
  for (const nlohmann::json& word : words) EXPECT_FALSE(word["values"].empty()) << word;
  EXPECT_EQ(RunJson({"rules", "builtins", "nodes"}, 0)[0]["words"], nlohmann::json::array());
  EXPECT_THAT(RunOffline({"rules", "builtins", "alert"}).out,
              HasSubstr("; severity: \"info\", \"low\", \"medium\", \"high\", \"critical\"\n"));
}

TEST_F(RulesOfflineTest, BuiltinsRefusesWhatItDoesNotKnow) {
  const Result mistyped = RunOffline({"rules", "builtins", "nodse"});
  EXPECT_EQ(mistyped.code, 2);
  EXPECT_EQ(mistyped.err, "error: the rule language has no `nodse`; did you mean `nodes`?\n");
  EXPECT_EQ(RunOffline({"rules", "builtins", "\x1b[2J"}).err,
            "error: the rule language has no `\\x1b[2J`\n");
  EXPECT_EQ(RunOffline({"rules", "builtins", "--markdown", "--output", "json"}).code, 2);
}

}  // namespace
}  // namespace rips::ripsctl

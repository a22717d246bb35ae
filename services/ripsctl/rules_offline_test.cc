// `ripsctl rules check`, `fmt` and `builtins`: verbs that need neither server nor settings.
#include <stdlib.h>
#include <sys/stat.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/lang/limits.h"
#include "policy_server/lang/signature.h"
#include "services/ripsctl/app.h"

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

struct Outcome {
  int code = -1;
  std::string out;
  std::string err;
};

class RulesOfflineTest : public testing::Test {
 protected:
  RulesOfflineTest() {
    std::string name = (std::filesystem::temp_directory_path() / "ripsctl-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  ~RulesOfflineTest() override {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }

  Outcome Run(const std::vector<std::string>& args, const std::string& input = "") {
    std::istringstream in(input);
    std::ostringstream out;
    std::ostringstream err;
    const int code = RunRipsctl(
        args, {.out = out,
               .err = err,
               .get_env = [](const std::string&) { return std::optional<std::string>(); },
               .connect = [](const RawSettings&)
                   -> absl::StatusOr<std::unique_ptr<v1::OperatorService::StubInterface>> {
                 ADD_FAILURE() << "connected";
                 return absl::InternalError("connected");
               },
               .in = &in});
    return {code, out.str(), err.str()};
  }
  nlohmann::json RunJson(std::vector<std::string> args, int expected_code,
                         const std::string& input = "") {
    args.insert(args.end(), {"--output", "json"});
    const Outcome result = Run(args, input);
    EXPECT_EQ(result.code, expected_code) << result.err;
    EXPECT_EQ(result.err, "");
    return nlohmann::json::parse(result.out, nullptr, false);
  }

  std::string Write(const std::string& name, const std::string& text) {
    const std::string path = absl::StrCat(folder_, "/", name);
    std::ofstream(path, std::ios::binary) << text;
    return path;
  }
  static std::string Read(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  }

  std::string folder_;
};

TEST_F(RulesOfflineTest, CheckLooksAtYaraFilesAndPlugins) {
  const std::string rules = Write("r.rul",
                                  "levels: A;\nrules Msg: topicin(\"/a\") && (payload(\"y.yar\") "
                                  "|| plugin(\"p\")) ? alert(\"x\");\n");
  const Outcome missing = Run({"rules", "check", rules});
  EXPECT_EQ(missing.code, 1);
  EXPECT_THAT(missing.out, AllOf(HasSubstr("y.yar"), HasSubstr("plugins/p"), Not(HasSubstr("ok"))));

  Write("y.yar", "rule r { condition: nothing }");
  std::filesystem::create_directory(folder_ + "/plugins");
  const std::string plugin = Write("plugins/p", "#!/bin/sh\nexit 0\n");
  EXPECT_EQ(chmod(plugin.c_str(), 0755), 0);
  const nlohmann::json broken = RunJson({"rules", "check", rules}, 1)["files"][0]["diagnostics"];
  ASSERT_EQ(broken.size(), 1u);
  EXPECT_EQ(broken[0]["kind"], "BrokenInspection");

  Write("y.yar", "rule r { strings: $a = \"attack\" condition: $a }");
  EXPECT_EQ(Run({"rules", "check", rules}).out, "ok: 1 rules, 1 levels\n");
}

TEST_F(RulesOfflineTest, FmtPrintsOneFile) {
  const std::string path = Write("a.rul", kUgly);

  const Outcome result = Run({"rules", "fmt", path});

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
  EXPECT_EQ(Run({"rules", "fmt", "-"}, kUgly).out, kPretty);
  EXPECT_EQ(Run({"rules", "fmt", "-"}).out, "");
  EXPECT_EQ(Run({"rules", "fmt", "--check", "-"}, kPretty).code, 0);
  const Outcome check = Run({"rules", "fmt", "--check", "-"}, kUgly);
  EXPECT_EQ(check.code, 1);
  EXPECT_EQ(check.out, "<stdin>\n");
  EXPECT_THAT(Run({"rules", "fmt", "-"}, kBroken).err, HasSubstr("<stdin>:2:1: error: "));
  const std::string largest(lang::kFileBytesMax, ' ');
  EXPECT_EQ(Run({"rules", "fmt", "-"}, largest).code, 0);
  EXPECT_EQ(Run({"rules", "fmt", "-"}, largest + " ").err,
            "error: standard input has more than 1048576 bytes\n");
}

TEST_F(RulesOfflineTest, FmtRewritesWhatChanges) {
  const std::string ugly = Write("ugly.rul", kUgly);
  const std::string pretty = Write("pretty.rul", kPretty);
  ASSERT_EQ(chmod(ugly.c_str(), 0640), 0);
  const auto untouched = std::filesystem::last_write_time(pretty);

  const Outcome result = Run({"rules", "fmt", "--write", ugly, pretty, ugly});

  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_THAT(result.out, StartsWith(absl::StrCat(ugly, "\n")));
  EXPECT_THAT(result.out, Not(HasSubstr("pretty")));
  EXPECT_EQ(Read(ugly), kPretty);
  EXPECT_EQ(std::filesystem::last_write_time(pretty), untouched);
  struct stat status = {};
  ASSERT_EQ(stat(ugly.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 07777, 0640u);
  const Outcome again = Run({"rules", "fmt", "--write", ugly, pretty});
  EXPECT_EQ(again.code, 0);
  EXPECT_EQ(again.out, "");
}

TEST_F(RulesOfflineTest, FmtRewritesTheFileBehindALink) {
  const std::string path = Write("a.rul", kUgly);
  const std::string link = folder_ + "/link.rul";
  std::filesystem::create_symlink("a.rul", link);

  EXPECT_EQ(Run({"rules", "fmt", "--write", link}).code, 0);

  EXPECT_TRUE(std::filesystem::is_symlink(link));
  EXPECT_EQ(Read(path), kPretty);
}

TEST_F(RulesOfflineTest, FmtChecksWithoutWriting) {
  const std::string ugly = Write("ugly.rul", kUgly);
  const std::string pretty = Write("pretty.rul", kPretty);

  const Outcome result = Run({"rules", "fmt", "--check", pretty, ugly});

  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.out, absl::StrCat(ugly, "\n"));
  EXPECT_EQ(Read(ugly), kUgly);
  EXPECT_EQ(Run({"rules", "fmt", "--check", pretty}).code, 0);
  const nlohmann::json json = RunJson({"rules", "fmt", "--check", pretty, ugly}, 1);
  EXPECT_EQ(json["files"][0]["changed"], false);
  EXPECT_EQ(json["files"][1]["changed"], true);
  EXPECT_FALSE(json["files"][1].contains("text"));
}

TEST_F(RulesOfflineTest, FmtLeavesABrokenFileAloneAndTreatsTheOthers) {
  const std::string broken = Write("broken.rul", kBroken);
  const std::string ugly = Write("ugly.rul", kUgly);

  const Outcome result = Run({"rules", "fmt", "--write", broken, ugly});

  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.out, absl::StrCat(ugly, "\n"));
  EXPECT_THAT(result.err, AllOf(HasSubstr(absl::StrCat(broken, ":2:1: error: ")),
                                HasSubstr(absl::StrCat(broken, ":2:27: error: "))));
  EXPECT_EQ(Read(broken), kBroken);
  EXPECT_EQ(Read(ugly), kPretty);
  EXPECT_EQ(Run({"rules", "fmt", broken}).out, "");
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
    const Outcome result = Run(args);
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
  const Outcome text = Run({"rules", "builtins"});
  const Outcome markdown = Run({"rules", "builtins", "--markdown"});
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
  const Outcome text = Run({"rules", "builtins"});

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

  const Outcome text = Run({"rules", "builtins", "nodes"});
  EXPECT_THAT(text.out, StartsWith("Expressions of `rules Msg` and `rules Graph`\n"
                                   "USAGE                   RESULT  ADDED  MEANING\n"
                                   "nodes(nodes string...)  bool    -      "));
  EXPECT_THAT(Run({"rules", "builtins", "--markdown", "nodes"}).out,
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
  EXPECT_THAT(Run({"rules", "builtins", "alert"}).out,
              HasSubstr("; severity: \"info\", \"low\", \"medium\", \"high\", \"critical\"\n"));
}

TEST_F(RulesOfflineTest, BuiltinsRefusesWhatItDoesNotKnow) {
  const Outcome mistyped = Run({"rules", "builtins", "nodse"});
  EXPECT_EQ(mistyped.code, 2);
  EXPECT_EQ(mistyped.err, "error: the rule language has no `nodse`; did you mean `nodes`?\n");
  EXPECT_EQ(Run({"rules", "builtins", "\x1b[2J"}).err,
            "error: the rule language has no `\\x1b[2J`\n");
  EXPECT_EQ(Run({"rules", "builtins", "--markdown", "--output", "json"}).code, 2);
}

}  // namespace
}  // namespace rips::ripsctl

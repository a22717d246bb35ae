#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"

namespace rips::ripsctl {
namespace {

using ::testing::HasSubstr;

constexpr char kContexts[] = R"(# Mine.
current: lab   # until Friday
contexts:
  lab: {server: "lab.example:1", ca: lab/ca.pem}
  site: {server: "site.example:2", ca: /etc/site.pem}
)";

class ContextTest : public RipsctlTest {
 protected:
  void SetUp() override { Write(kContexts); }
  void Write(const std::string& text) { File(".config/rips/ripsctl.yaml", text); }
  std::string Read() const {
    std::ostringstream text;
    text << std::ifstream(path_).rdbuf();
    return text.str();
  }

  const std::string path_ = home_ + "/.config/rips/ripsctl.yaml";
};

TEST_F(ContextTest, OneIsChosen) {
  EXPECT_EQ(Run({"robot", "list"}).code, 0);
  EXPECT_EQ(used_.server, "lab.example:1");
  EXPECT_EQ(used_.ca, home_ + "/.config/rips/lab/ca.pem");
  EXPECT_EQ(Run({"robot", "list", "--context", "site"}).code, 0);
  EXPECT_EQ(used_.server, "site.example:2");
  EXPECT_EQ(used_.ca, "/etc/site.pem");
  env_["RIPSCTL_CONTEXT"] = "site";
  EXPECT_EQ(Run({"robot", "list"}).code, 0);
  EXPECT_EQ(used_.server, "site.example:2");
  EXPECT_EQ(Run({"robot", "list", "--context", "lab"}).code, 0);
  EXPECT_EQ(used_.server, "lab.example:1");
}

TEST_F(ContextTest, OneThatIsNotThereIsAUsageError) {
  const Result slip = Run({"robot", "list", "--context", "sote"});
  EXPECT_EQ(slip.code, 2);
  EXPECT_EQ(slip.err,
            "error: --context is `sote`, which is no context of the settings file; did you mean "
            "`site`? It has lab, site\n");
  env_["RIPSCTL_CONTEXT"] = "\x1b[2J";
  const Result hostile = Run({"robot", "list"});
  EXPECT_EQ(hostile.code, 2);
  EXPECT_THAT(hostile.err, HasSubstr("RIPSCTL_CONTEXT is `\\x1b[2J`"));
  EXPECT_EQ(Run({"context", "list"}).code, 0) << "shows what there is";
  env_.clear();
  std::filesystem::remove(path_);
  const Result none = Run({"robot", "list", "--context", "lab"});
  EXPECT_EQ(none.code, 2);
  EXPECT_THAT(none.err, HasSubstr("the settings file has no contexts"));
  EXPECT_EQ(fake_.calls().size(), 0u);
}

TEST_F(ContextTest, AreListed) {
  const Result list = Run({"context", "list"});
  EXPECT_EQ(list.code, 0) << list.err;
  EXPECT_EQ(list.out,
            "CURRENT  CONTEXT  SERVER\n"
            "*        lab      lab.example:1\n"
            "-        site     site.example:2\n");
  EXPECT_EQ(Run({"context", "list", "--names"}).out, "lab\nsite\n");
  EXPECT_EQ(RunJson({"context", "list"}),
            nlohmann::json::parse(R"({"contexts": [{"name": "lab", "server": "lab.example:1"},
                                                   {"name": "site", "server": "site.example:2"}],
                                      "current": "lab"})"));
  EXPECT_EQ(RunJson({"context", "use", "site"})["current"], "site");
  Write("current: lob\ncontexts: {lab: {server: \"a:1\"}}\n");
  EXPECT_THAT(Run({"context", "list"}).err,
              HasSubstr("warning: `current` of the settings file is"));
  EXPECT_EQ(Run({"robot", "list"}).code, 2);
  std::filesystem::remove(path_);
  const Result none = Run({"context", "list"});
  EXPECT_EQ(none.code, 0);
  EXPECT_EQ(none.err, "no contexts in " + path_ + "\n");
  EXPECT_EQ(RunJson({"context", "list"})["current"], nlohmann::json());
}

TEST_F(ContextTest, AFileThatCannotBeWrittenIsNoFailureOfTheServer) {
  std::filesystem::create_directories(path_ + ".tmp/in-the-way");
  const Result result = Run({"context", "use", "site"});
  EXPECT_EQ(result.code, 1);
  EXPECT_THAT(result.err,
              testing::AllOf(HasSubstr("ripsctl.yaml"), testing::Not(HasSubstr("policy server"))));
  EXPECT_EQ(Read(), kContexts);
}

TEST_F(ContextTest, UseChangesTheCurrentOneAndNothingElse) {
  std::filesystem::permissions(path_, std::filesystem::perms(0640));
  const Result use = Run({"context", "use", "site"});
  EXPECT_EQ(use.code, 0) << use.err;
  EXPECT_EQ(use.out, "context site is the current one: server site.example:2\n");
  std::string expected = kContexts;
  expected.replace(expected.find("lab "), 3, "site");
  EXPECT_EQ(Read(), expected);
  EXPECT_EQ(std::filesystem::status(path_).permissions(), std::filesystem::perms(0640));
  EXPECT_EQ(Run({"robot", "list"}).code, 0);
  EXPECT_EQ(used_.server, "site.example:2");

  EXPECT_EQ(RunJson({"context", "use", "lab"})["current"], "lab");
  EXPECT_EQ(Read(), kContexts);
  EXPECT_EQ(Run({"context", "use", "labb"}).code, 2);
  EXPECT_EQ(Read(), kContexts);
}

TEST_F(ContextTest, UseKeepsASymbolicLinkAndMendsABrokenChoice) {
  const std::string real = File("dotfiles/ripsctl.yaml",
                                "current: gone\ncontexts:\n  lab:\n"
                                "    server: a.example:1\n");
  std::filesystem::remove(path_);
  std::filesystem::create_symlink(real, path_);
  EXPECT_EQ(Run({"context", "use", "lab"}).code, 0);
  EXPECT_TRUE(std::filesystem::is_symlink(path_));
  EXPECT_EQ(Read(), "current: lab\ncontexts:\n  lab:\n    server: a.example:1\n");
}

TEST_F(ContextTest, UseRefusesAFileThatItCannotChange) {
  const std::string flow =
      "{current: lab, contexts: {lab: {server: \"a:1\"}, b: {server: \"b:1\"}}}\n";
  Write(flow);
  const Result use = Run({"context", "use", "b"});
  EXPECT_EQ(use.code, 1);
  EXPECT_THAT(use.err, HasSubstr("write `current: b` on a line of its own"));
  EXPECT_EQ(Read(), flow);
  Write("contexts: {lab: {servr: x}}\n");
  EXPECT_EQ(Run({"context", "use", "lab"}).code, 2);
}

}  // namespace
}  // namespace rips::ripsctl

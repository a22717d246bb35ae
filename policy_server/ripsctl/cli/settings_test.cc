#include "policy_server/ripsctl/cli/settings.h"

#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <utility>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::ripsctl {
namespace {

using ::testing::HasSubstr;

GetEnv Fake(std::map<std::string, std::string> variables) {
  return [variables](const std::string& name) -> std::optional<std::string> {
    const auto it = variables.find(name);
    if (it == variables.end()) return std::nullopt;
    return it->second;
  };
}

TEST(SettingsTest, ComeFromFlagThenEnvironmentThenFileThenDefault) {
  SettingsFile file;
  file.top = {.server = "file:1", .cert = "file.pem", .ca = "file-ca.pem"};
  const GetEnv env = Fake({{"RIPSCTL_SERVER", "env:1"}, {"RIPSCTL_CERT", "env.pem"}});
  const RawSettings merged = Merge({.server = "flag:1"}, env, file);
  EXPECT_EQ(merged.server, "flag:1");
  EXPECT_EQ(merged.cert, "env.pem");
  EXPECT_EQ(merged.ca, "file-ca.pem");
  EXPECT_EQ(merged.key, "");
  EXPECT_EQ(merged.output, "text");
  EXPECT_EQ(merged.timeout, "10s");
  EXPECT_EQ(Merge({}, Fake({}), SettingsFile()).server, "127.0.0.1:7443");
}

TEST(SettingsTest, FileIsStrict) {
  const auto settings = ParseSettings("ripsctl.yaml", R"(server: ps.example:7443
cert: /h/cert.pem
key: /h/key.pem
ca: /h/ca.pem
output: json
timeout: 3s
)");
  ASSERT_THAT(settings, IsOk());
  EXPECT_EQ(settings->top.server, "ps.example:7443");
  EXPECT_EQ(settings->top.timeout, "3s");
  EXPECT_THAT(ParseSettings("ripsctl.yaml", "servr: x:1\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("ripsctl.yaml:1:1: unknown key `servr`; did you mean `server`")));
}

TEST(SettingsTest, AContextStandsBetweenTheEnvironmentAndTheTopOfTheFile) {
  const auto file = ParseSettings("/h/ripsctl.yaml", R"(ca: ca.pem
timeout: 3s
current: lab
contexts:
  lab: {server: "lab:1", cert: lab/a.pem, key: lab/a.key, timeout: 5s}
  site: {server: "site:1", ca: /etc/site.pem, output: json}
)");
  ASSERT_THAT(file, IsOk());
  const GetEnv env = Fake({{"RIPSCTL_TIMEOUT", "7s"}});
  EXPECT_EQ(*ChooseContext({}, env, *file), "lab");
  const RawSettings lab = Merge({.cert = "flag.pem", .context = "lab"}, env, *file);
  EXPECT_EQ(lab.server, "lab:1");
  EXPECT_EQ(lab.cert, "flag.pem") << "of the working directory";
  EXPECT_EQ(lab.key, "/h/lab/a.key");
  EXPECT_EQ(lab.ca, "/h/ca.pem");
  EXPECT_EQ(lab.timeout, "7s");
  const RawSettings site = Merge({.context = "site"}, Fake({}), *file);
  EXPECT_EQ(site.ca, "/etc/site.pem");
  EXPECT_EQ(site.cert, "") << "not that of the other context";
  EXPECT_EQ(site.output, "json");
  EXPECT_EQ(site.timeout, "3s");
  EXPECT_EQ(*ChooseContext({}, Fake({}), SettingsFile()), "") << "as before there were contexts";
  EXPECT_THAT(ChooseContext({.context = "nothing-like-it"}, env, *file),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       "--context is `nothing-like-it`, which is no context of the settings file; "
                       "it has lab, site"));
}

TEST(SettingsTest, WrongContextsAreNamed) {
  const std::pair<const char*, const char*> all[] = {
      {"contexts: {Lab: {server: \"a:1\"}}", "`Lab` is not a valid name of a context"},
      {"contexts: {lab: {}}", "server"},
      {"contexts: {lab: }", "lab"},
      {"contexts: {lab: x}", "lab"},
      {"contexts: [lab]", "contexts"},
      {"contexts: {lab: {server: \"a:1\"}, lab: {server: \"b:1\"}}", "lab"},
      {"contexts: {lab: {servr: \"a:1\"}}", "did you mean `server`"},
      {"contexts: {lab: {server: \"a\\x1b:1\"}}", "control character"},
      {"current: [lab]", "current"},
      {"current: lab\ncurrent: lab", "current"},
  };
  for (const auto& [text, message] : all) {
    EXPECT_THAT(ParseSettings("r.yaml", text),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(message)))
        << text;
  }
}

TEST(SettingsTest, OnlyTheLineOfTheCurrentContextChanges) {
  const std::string contexts =
      "contexts:\n  a: {server: \"a:1\"}\n  null-b: {server: \"b:1\"}\n"
      "  \"null\": {server: \"c:1\"}\n";
  const auto with = [](const std::string& text, const char* name) {
    return WithCurrentContext("r.yaml", text, name).value_or("(refused)");
  };
  EXPECT_EQ(with("current: a\n" + contexts, "null-b"), "current: null-b\n" + contexts);
  EXPECT_EQ(with("current:  'a'  # c\n" + contexts, "null-b"),
            "current:  null-b  # c\n" + contexts);
  EXPECT_EQ(with(contexts + "current: a", "null"), contexts + "current: \"null\"");
  EXPECT_EQ(with("# top\n---\n\n" + contexts, "a"), "# top\n---\n\ncurrent: a\n" + contexts);
  EXPECT_EQ(with("current: a\r\nca: x\r\n" + contexts, "null-b"),
            "current: null-b\r\nca: x\r\n" + contexts);
  EXPECT_EQ(with("ca: x\r\n" + contexts, "a"), "current: a\r\nca: x\r\n" + contexts);
  EXPECT_EQ(with("current: \"a b\"\n" + contexts, "a"), "(refused)");
  EXPECT_EQ(with("current:\n" + contexts, "a"), "(refused)");
  EXPECT_EQ(with("current:\n  a\n" + contexts, "null-b"), "(refused)");
  EXPECT_EQ(with("\"current\": a\n" + contexts, "null-b"), "(refused)");
  EXPECT_EQ(with(" ca: x\n contexts: {a: {server: \"a:1\"}}\n", "a"), "(refused)");
}

TEST(SettingsTest, TheShippedExampleIsRight) {
  std::ostringstream text;
  text << std::ifstream(std::string(RIPS_SOURCE_DIR) + "/deploy/config/ripsctl.yaml").rdbuf();
  const auto file = ParseSettings("/h/ripsctl.yaml", text.str());
  ASSERT_THAT(file, IsOk());
  EXPECT_EQ(*ChooseContext({}, Fake({}), *file), "hall-1");
  EXPECT_EQ(Merge({.context = "hall-2"}, Fake({}), *file).ca, "/h/hall-2/ca.pem");
}

TEST(SettingsTest, FileLiesInTheHomeDirectory) {
  EXPECT_EQ(SettingsPath(Fake({{"HOME", "/home/op"}})), "/home/op/.config/rips/ripsctl.yaml");
  EXPECT_EQ(SettingsPath(Fake({})), "");
}

}  // namespace
}  // namespace rips::ripsctl

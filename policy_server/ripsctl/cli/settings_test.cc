#include "policy_server/ripsctl/cli/settings.h"

#include <map>
#include <string>

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
  const RawSettings file = {.server = "file:1", .cert = "file.pem", .ca = "file-ca.pem"};
  const GetEnv env = Fake({{"RIPSCTL_SERVER", "env:1"}, {"RIPSCTL_CERT", "env.pem"}});
  const RawSettings merged = Merge({.server = "flag:1"}, env, file);
  EXPECT_EQ(merged.server, "flag:1");
  EXPECT_EQ(merged.cert, "env.pem");
  EXPECT_EQ(merged.ca, "file-ca.pem");
  EXPECT_EQ(merged.key, "");
  EXPECT_EQ(merged.output, "text");
  EXPECT_EQ(merged.timeout, "10s");
  EXPECT_EQ(Merge({}, Fake({}), {}).server, "127.0.0.1:7443");
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
  EXPECT_EQ(settings->server, "ps.example:7443");
  EXPECT_EQ(settings->timeout, "3s");
  EXPECT_THAT(ParseSettings("ripsctl.yaml", "servr: x:1\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("ripsctl.yaml:1:1: unknown key `servr`; did you mean `server`")));
}

TEST(SettingsTest, FileLiesInTheHomeDirectory) {
  EXPECT_EQ(SettingsPath(Fake({{"HOME", "/home/op"}})), "/home/op/.config/rips/ripsctl.yaml");
  EXPECT_EQ(SettingsPath(Fake({})), "");
}

}  // namespace
}  // namespace rips::ripsctl

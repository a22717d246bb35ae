#include "policy_server/server/config/output_config.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/config/config.h"
#include "services/base/status_matchers.h"

namespace rips::server {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

absl::StatusOr<ParsedServerConfig> Parse(const std::string& outputs) {
  return ParseServerConfig("ps.yaml", absl::StrCat(R"(id: ps1
trust_domain: fleet.example
tls: {ca: /p/ca.pem, cert: /p/cert.pem, key: /p/key.pem}
outputs:
)",
                                                   outputs));
}

TEST(OutputConfigTest, ReadsBothKinds) {
  const auto parsed = Parse(R"(
 - {name: siem, kind: syslog, address: "siem.example:6514", tls: {ca: /c, cert: /d, key: /k}, format: text}
 - {name: pager, kind: webhook, url: "https://pager.example/rips?v=1", ca: /c, secret_file: /s, format: ocsf, severity: high, robots: [r1, (server)]}
 - {name: relay, kind: syslog, address: "tcp://[::1]:514"}
)");
  ASSERT_THAT(parsed, IsOk());
  const std::vector<OutputConfig>& outputs = parsed->config.outputs;
  ASSERT_EQ(outputs.size(), 3u);
  EXPECT_EQ(
      outputs[0],
      (OutputConfig{
          .name = "siem",
          .endpoint = {.host = "siem.example", .port = 6514, .ca = "/c", .cert = "/d", .key = "/k"},
          .format = OutputConfig::Format::kText}));
  EXPECT_EQ(outputs[1],
            (OutputConfig{.name = "pager",
                          .kind = OutputConfig::Kind::kWebhook,
                          .endpoint = {.host = "pager.example", .port = 443, .ca = "/c"},
                          .path = "/rips?v=1",
                          .secret_file = "/s",
                          .format = OutputConfig::Format::kOcsf,
                          .severity = "high",
                          .robots = {"r1", "(server)"}}));
  EXPECT_EQ(outputs[2], (OutputConfig{.name = "relay",
                                      .endpoint = {.host = "::1", .port = 514, .tls = false}}));
  EXPECT_THAT(
      FormatSettings(parsed->settings),
      AllOf(HasSubstr("outputs[1].secret_file: \"/s\""), HasSubstr("https://pager.example/..."),
            Not(HasSubstr("v=1")), HasSubstr("outputs[0].severity: \"info\"")));
}

TEST(OutputConfigTest, TheRootOfAUrlMayBeLeftOut) {
  const auto parsed = Parse(R"( - {name: a, kind: webhook, url: "https://h:8443"})");
  ASSERT_THAT(parsed, IsOk());
  EXPECT_EQ(parsed->config.outputs[0].path, "/");
  EXPECT_EQ(parsed->config.outputs[0].endpoint.port, 8443);
}

TEST(OutputConfigTest, PlainTextLeavesTheMachineOnlyIfAllowed) {
  for (const char* each : {R"(kind: syslog, address: "tcp://siem.example:514")",
                           R"(kind: syslog, address: "tcp://127.evil.example:514")",
                           R"(kind: webhook, url: "http://pager.example/")"}) {
    EXPECT_THAT(Parse(absl::StrCat(" - {name: a, ", each, "}")),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("unencrypted")));
    EXPECT_THAT(Parse(absl::StrCat(" - {name: a, ", each, ", plain: true}")), IsOk());
  }
  EXPECT_THAT(Parse(R"( - {name: a, kind: webhook, url: "http://127.0.0.1:80/"})"), IsOk());
}

TEST(OutputConfigTest, RefusesWhatCannotBeUsed) {
  const auto refuses = [](const std::string& output, const std::string& why) {
    EXPECT_THAT(Parse(absl::StrCat(" - {name: a, ", output, "}")),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(why)))
        << output;
  };
  refuses("kind: mail", "`kind` is `mail`");
  refuses("kind: syslog", "missing key `outputs[0].address`");
  refuses("kind: syslog, address: siem", "write `HOST:PORT`");
  refuses("kind: syslog, address: \"siem:0\"", "write `HOST:PORT`");
  refuses("kind: syslog, address: \"siem:1\", format: ocsf", "`format` is `ocsf`");
  refuses("kind: syslog, address: \"siem:1\", url: x", "unknown key `url`");
  refuses("kind: syslog, address: \"siem:1\", tls: {ca: here}", "write an absolute path");
  refuses("kind: syslog, address: \"siem:1\", tls: {cert: /here}", "go together");
  refuses("kind: syslog, address: \"siem:1\", severity: grave", "`severity` is `grave`");
  refuses("kind: syslog, address: \"siem:1\", robots: [R1]", "is not a valid robot id");
  refuses("kind: webhook, url: \"ftp://h/\"", "`url` is not one");
  refuses("kind: webhook, url: \"https://\"", "`url` is not one");
  refuses("kind: webhook, url: \"https://h:99999/\"", "`url` is not one");
  refuses("kind: webhook, url: \"https://h/a b\"", "`url` is not one");
  refuses(absl::StrCat("kind: webhook, url: \"https://h/", std::string(2'000, 'a'), "\""),
          "2,000 bytes at most");
  refuses("kind: webhook, url: \"https://h/\\r\\nX: y\"", "control character");
  refuses("kind: webhook, url: \"https://h/\", format: text", "`format` is `text`");
  refuses("kind: webhook, url: \"https://h/\", secret_file: s", "must be an absolute path");
  EXPECT_THAT(Parse(" - {name: A_1, kind: syslog, address: \"h:1\"}"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("valid output name")));
}

TEST(OutputConfigTest, MisplacedSecretsAreRefusedAndNotShown) {
  for (const char* output :
       {R"(url: "https://u:hunter2@h/")", R"(url: "x://u:hunter2@h/")",
        R"(url: "https://h/", secret_file: hunter2)", R"(url: "https://h/", secret: hunter2)"}) {
    const auto parsed = Parse(absl::StrCat(" - {name: a, kind: webhook, ", output, "}"));
    ASSERT_THAT(parsed, StatusIs(absl::StatusCode::kInvalidArgument));
    EXPECT_THAT(std::string(parsed.status().message()), Not(HasSubstr("hunter2"))) << output;
  }
}

TEST(OutputConfigTest, HasALimitAndNamesOnce) {
  std::string outputs;
  for (size_t i = 0; i < kOutputsMax; ++i) {
    absl::StrAppend(&outputs, " - {name: o", i, ", kind: syslog, address: \"h:1\"}\n");
  }
  EXPECT_THAT(Parse(outputs), IsOk());
  EXPECT_THAT(Parse(absl::StrCat(outputs, " - {name: o, kind: syslog, address: \"h:1\"}\n")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("9 outputs exceed limit 8")));
  EXPECT_THAT(Parse(absl::StrCat(" - {name: o1, kind: syslog, address: \"h:1\"}\n",
                                 " - {name: o1, kind: syslog, address: \"h:1\"}\n")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("`o1` is listed twice")));
}

TEST(OutputConfigTest, RobotsHaveALimit) {
  const auto parse = [](size_t robots) {
    std::string list;
    for (size_t i = 0; i < robots; ++i) absl::StrAppend(&list, i == 0 ? "" : ", ", "r", i);
    return Parse(
        absl::StrCat(" - {name: a, kind: syslog, address: \"h:1\", robots: [", list, "]}"));
  };
  EXPECT_THAT(parse(kOutputRobotsMax), IsOk());
  EXPECT_THAT(parse(kOutputRobotsMax + 1), StatusIs(absl::StatusCode::kInvalidArgument,
                                                    HasSubstr("1001 robots exceed limit 1000")));
}

TEST(OutputConfigTest, SeveritiesAreOrdered) {
  EXPECT_LT(SeverityRank("info"), SeverityRank("low"));
  EXPECT_LT(SeverityRank("high"), SeverityRank("critical"));
  EXPECT_EQ(SeverityRank("HIGH"), -1);
}

}  // namespace
}  // namespace rips::server

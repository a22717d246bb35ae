#include "mode_actuator/config.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::Pair;

constexpr absl::string_view kConfig = R"(robot: r1
host: base
servers: ["policy.example:7443"]
tls: {ca: /etc/rips/pki/ca.pem, cert: /etc/rips/pki/cert.pem, key: /etc/rips/pki/key.pem}
dds: {domain: 0, interface: lo, security: null}
state_dir: /var/lib/rips/actuator
fail_safe: {level: ALERT, after: 0s}
system_modes: {smh: /etc/rips/smh.yaml, verify: parts}
levels:
  - {name: DEFAULT, enter: [{system_mode: {part: /safety, mode: __DEFAULT__}}], leave: []}
  - name: ALERT
    enter:
      - {system_mode: {part: /safety, mode: ALERT}, timeout: 2s, retries: 2, on_failure: stop}
      - {program: {name: usb_alarm, args: ["on"]}, on_failure: continue}
    leave: []
    on_drift: []
programs:
  - {name: usb_alarm, path: /usr/lib/rips/usb_alarm, timeout: 10s, concurrency: 1}
metrics: "127.0.0.1:9466"
)";

std::string Edited(absl::string_view from, absl::string_view to) {
  const std::string text = absl::StrReplaceAll(kConfig, {{from, to}});
  EXPECT_NE(text, kConfig) << "nothing to replace: " << from;
  return text;
}

TEST(ConfigTest, ReadsWhatItSays) {
  const auto parsed = ParseConfig("actuator.yaml", kConfig);
  ASSERT_THAT(parsed, IsOk());
  const Config& config = parsed->config;

  EXPECT_EQ(config.robot, "r1");
  EXPECT_EQ(config.fail_safe_level, "ALERT");
  EXPECT_EQ(config.fail_safe_after, absl::ZeroDuration());
  EXPECT_TRUE(config.verify_parts);
  ASSERT_EQ(config.levels.size(), 2u);
  const Step& mode = config.levels[1].enter[0];
  EXPECT_EQ(std::get<SystemModeStep>(mode.what), (SystemModeStep{"/safety", "ALERT"}));
  EXPECT_EQ(mode.timeout, absl::Seconds(2));
  EXPECT_EQ(mode.retries, 2);
  EXPECT_EQ(mode.on_failure, OnFailure::kStop);
  const Step& program = config.levels[1].enter[1];
  EXPECT_EQ(std::get<ProgramStep>(program.what), (ProgramStep{"usb_alarm", {"on"}}));
  EXPECT_EQ(program.timeout, absl::Seconds(10));
  EXPECT_EQ(program.on_failure, OnFailure::kContinue);
  EXPECT_EQ(config.levels[0].enter[0].on_failure, OnFailure::kFail);
  EXPECT_EQ(config.floor_hold, absl::Seconds(10));
  EXPECT_THAT(parsed->effective, HasSubstr("timing.reconcile: 2s"));
  EXPECT_THAT(ModeTargets(config.levels),
              ElementsAre(Pair("/safety", "ALERT"), Pair("/safety", "__DEFAULT__")));
}

TEST(ConfigTest, SaysWhereEachMistakeIs) {
  const struct {
    const char* from;
    const char* to;
    const char* message;
  } kCases[] = {
      {"host: base", "hsot: base", "actuator.yaml:2:1: unknown key `hsot`"},
      {"robot: r1", "robot: R_1", ":1:8: `R_1` is not a valid robot id"},
      {"fail_safe: {level: ALERT, after: 0s}\n", "", "missing key `fail_safe`"},
      {"level: ALERT, after: 0s", "after: 0s", "missing key `fail_safe.level`"},
      {"level: ALERT, after: 0s", "level: ALERT", "missing key `fail_safe.after`"},
      {"level: ALERT, after", "level: ALARM, after", ":7:20: `ALARM` is none of `levels`"},
      {"after: 0s", "after: 0", ":7:34: `after`: `0` is not a duration"},
      {"{part: /safety, mode: ALERT}", "{part: safety, mode: ALERT}", "`safety` is not absolute"},
      {"timeout: 2s", "timeout: 4s", "may take 22s (timeout x (1 + retries), summed), limit 20s"},
      {"timeout: 2s", "timeout: 2", ":13:62: `timeout`: `2` is not a duration"},
      {"on_failure: stop", "on_failure: halt", "`halt`"},
      {"name: usb_alarm, args", "name: bell, args", "program `bell` is not in `programs`"},
      {"path: /usr/lib", "path: usr/lib", "is not absolute"},
      {"name: DEFAULT,", "name: ALERT,", "level `ALERT` is listed twice"},
      {"name: DEFAULT,", "name: DE FAULT,", "`DE FAULT` is no level name"},
      {"{program: {name: usb_alarm, args: [\"on\"]}", "{alarm: {device: x, state: \"on\"}",
       "14:17: `alarm` is not available in this version"},
      {"{program: {name: usb_alarm, args: [\"on\"]}", "{firewall: {file: /x.nft}",
       "`firewall` is not available in this version"},
      {"{program: {name: usb_alarm, args: [\"on\"]}", "{retries: 1",
       "a step needs exactly one of `system_mode` and `program`"},
      {"on_drift: []", "on_drift: [{program: {name: usb_alarm}}]",
       "`on_drift` steps are not available in this version"},
      {"    on_drift: []", "    scripts: /x", "`scripts` is not available in this version"},
      {"metrics:", "devices: [{name: relay}]\nmetrics:",
       "`devices` are not available in this version"},
      {"security: null", "security: {keystore: k, enclave: /rips}", "write an absolute path"},
      {"security: null", "security: {keystore: /k}", "enclave"},
      {"system_modes: {smh: /etc/rips/smh.yaml, verify: parts}\n", "",
       "has `system_mode` steps but there is no `system_modes` section"},
      {"policy.example:7443", "policy.example", "`policy.example` is not HOST:PORT"},
      {"metrics:", "  - {name: usb_alarm, path: /x}\nmetrics:", "`usb_alarm` is listed twice"},
  };
  for (const auto& test : kCases) {
    EXPECT_THAT(ParseConfig("actuator.yaml", Edited(test.from, test.to)),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(test.message)))
        << test.to;
  }
}

TEST(ConfigTest, ReportsALaterVersionsStepOnce) {
  const auto parsed = ParseConfig(
      "a.yaml", Edited("{program: {name: usb_alarm, args: [\"on\"]}", "{firewall: {file: /x.nft}"));
  EXPECT_THAT(parsed.status().message(), Not(HasSubstr("unknown key")));
}

TEST(ConfigTest, OrdersAPartOnlyOncePerList) {
  EXPECT_THAT(ParseConfig("a.yaml", Edited("enter: [{system_mode: {part: /safety, mode: "
                                           "__DEFAULT__}}]",
                                           "enter: [{system_mode: {part: /safety, mode: A}}, "
                                           "{system_mode: {part: /safety, mode: B}}]")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is ordered twice")));
}

TEST(ConfigTest, KeepIsLegal) {
  const auto parsed = ParseConfig("a.yaml", Edited("level: ALERT, after", "level: keep, after"));
  ASSERT_THAT(parsed, IsOk());
  EXPECT_EQ(parsed->config.fail_safe_level, "keep");
}

TEST(ConfigTest, LevelsMustNotBeEmptyNorTooMany) {
  const std::string head(kConfig.substr(0, kConfig.find("levels:")));
  EXPECT_THAT(ParseConfig("a.yaml", head + "levels: []\n"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("at least one level")));
  std::string many = "levels:\n";
  for (size_t i = 0; i <= kLevelsMax; ++i) absl::StrAppend(&many, "  - {name: L", i, "}\n");
  EXPECT_THAT(ParseConfig("a.yaml", head + many),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("65 levels exceed limit 64")));
}

TEST(ConfigTest, LevelsAreComparedWithTheSmhFile) {
  const auto smh = ParseSmh(R"(safety:
  ros__parameters:
    type: system
    modes:
      __DEFAULT__: {cam: inactive, arm: active}
      ALERT: {cam: active, arm: inactive}
cam: {ros__parameters: {type: node, modes: {__DEFAULT__: {ros__parameters: {a: 1}}}}}
arm: {ros__parameters: {type: node, modes: {__DEFAULT__: {ros__parameters: {a: 1}}}}}
)");
  ASSERT_THAT(smh, IsOk());
  const auto parsed = ParseConfig("a.yaml", kConfig);
  ASSERT_THAT(parsed, IsOk());
  EXPECT_THAT(CheckLevelsAgainstSmh(parsed->config, *smh), IsOk());
  EXPECT_THAT(MonotonyWarnings(parsed->config, *smh),
              ElementsAre("level `ALERT` activates /cam, which the level before it has off"));

  const auto other = ParseConfig("a.yaml", Edited("mode: ALERT}", "mode: ALARM}"));
  ASSERT_THAT(other, IsOk());
  EXPECT_THAT(CheckLevelsAgainstSmh(other->config, *smh),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("level `ALERT`"), HasSubstr("has no mode `ALARM`"))));
}

TEST(ConfigTest, PartsOfLevelsAndOfTheSmhFileAreProtected) {
  const auto smh = ParseSmh(R"(safety:
  ros__parameters:
    type: system
    modes:
      __DEFAULT__: {cam: active}
cam: {ros__parameters: {type: node, modes: {__DEFAULT__: {ros__parameters: {a: 1}}}}}
)");
  ASSERT_THAT(smh, IsOk());
  std::vector<LevelSpec> levels(1);
  levels[0].enter.push_back({.what = SystemModeStep{.part = "/zoom", .mode = "m"}});
  levels[0].leave.push_back({.what = SystemModeStep{.part = "/cam", .mode = "m"}});
  levels[0].leave.push_back({.what = SystemModeStep{.part = "/no name", .mode = "m"}});
  EXPECT_THAT(ProtectedParts(levels, *smh), ElementsAre("/cam", "/zoom", "/safety"));
  EXPECT_THAT(ProtectedParts({}, Smh{}), ElementsAre());

  Smh many;
  for (size_t i = 0; i < kProtectedPartsMax; ++i) many.nodes[absl::StrCat("/n", i)] = {};
  const std::vector<std::string> parts = ProtectedParts(levels, many);
  EXPECT_EQ(parts.size(), kProtectedPartsMax);
  EXPECT_EQ(parts[1], "/zoom") << "those of the levels first";
}

TEST(ConfigTest, EveryCutIsReadOrRefusedWithoutHarm) {
  for (size_t length = 0; length < kConfig.size(); ++length) {
    ParseConfig("a.yaml", kConfig.substr(0, length)).status().IgnoreError();
  }
}

}  // namespace
}  // namespace rips::actuator

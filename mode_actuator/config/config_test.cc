#include "mode_actuator/config/config.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/firewall/target.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
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
  EXPECT_EQ(config.modes.verify, Verify::kParts);
  EXPECT_EQ(config.modes.backend, Backend::kManager);
  EXPECT_EQ(config.modes.fallback, Fallback::kDirect);
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
  EXPECT_THAT(FormatSettings(parsed->settings), HasSubstr("timing.reconcile: 2s"));
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
       "14:26: device `x` is not in `devices`"},
      {"{program: {name: usb_alarm, args: [\"on\"]}", "{retries: 1",
       "a step needs exactly one of `system_mode`, `program`, `alarm` and `firewall`"},
      {"{program: {name: usb_alarm, args: [\"on\"]}",
       "{program: {name: usb_alarm}, alarm: {device: x, state: \"on\"}",
       "a step needs exactly one of `system_mode`, `program`, `alarm` and `firewall`"},
      {"{program: {name: usb_alarm, args: [\"on\"]}",
       "{alarm: {device: x, state: \"on\"}, firewall: {release: all}",
       "a step needs exactly one of `system_mode`, `program`, `alarm` and `firewall`"},
      {"on_drift: []", "on_drift: [{program: {name: bell}}]",
       "program `bell` is not in `programs`"},
      {"on_drift: []", "on_drift: [{program: {name: usb_alarm}, retries: 2}]",
       "may take 30s (timeout x (1 + retries), summed), limit 20s"},
      {"verify: parts", "verify: manager, backend: direct", "write `verify: parts`"},
      {"verify: parts", "verify: manager, fallback: direct", "write `verify: parts`"},
      {"verify: parts", "backend: both", "`both`"},
      {"    on_drift: []", "    scripts: /x", ":16:5: unknown key `scripts`"},
      {"metrics:", "scripts: x\nmetrics:", "write an absolute path"},
      {"metrics:", "exec: {socket: exec.sock}\nmetrics:", "write an absolute path"},
      {"concurrency: 1", "rate: 3", "write `N/min`, N from 1 to 600"},
      {"concurrency: 1", "rate: 0/min", "write `N/min`"},
      {"concurrency: 1", "rate: 601/min", "write `N/min`"},
      {"concurrency: 1", "rate: -1/min", "write `N/min`"},
      {"concurrency: 1", "sha256: abc", "write 64 hexadecimal digits"},
      {"concurrency: 1", "drill: maybe", "`drill` is `maybe`; write `true` or `false`"},
      {"metrics:", "devices: [{name: relay}]\nmetrics:", "missing key `devices[0].kind`"},
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

TEST(ConfigTest, ReadsOnDriftSteps) {
  const auto parsed =
      ParseConfig("a.yaml", Edited("on_drift: []",
                                   "on_drift: [{system_mode: {part: /arm, mode: STOP}}, "
                                   "{program: {name: usb_alarm}}]"));
  ASSERT_THAT(parsed, IsOk());
  EXPECT_EQ(parsed->config.levels[1].on_drift.size(), 2u);
  EXPECT_THAT(ModeTargets(parsed->config.levels), Contains(Pair("/arm", "STOP")));
}

TEST(ConfigTest, ReadsWhoBringsThePartsThere) {
  const auto with = [](absl::string_view text) {
    return ParseConfig("a.yaml", Edited("verify: parts", text))->config.modes;
  };
  EXPECT_EQ(with("fallback: none").fallback, Fallback::kNone);
  EXPECT_EQ(with("backend: direct").backend, Backend::kDirect);
  // What is not read back from the nodes is not ordered from them.
  EXPECT_EQ(with("verify: manager").fallback, Fallback::kNone);
}

TEST(ConfigTest, ReadsWhatGuardsPrograms) {
  const auto plain = ParseConfig("a.yaml", kConfig);
  ASSERT_THAT(plain, IsOk());
  EXPECT_EQ(plain->config.exec.socket, "/run/rips/exec.sock");
  EXPECT_EQ(plain->config.exec.user, "rips");
  EXPECT_EQ(plain->config.programs[0].starts_per_minute, 0);

  const auto parsed = ParseConfig(
      "a.yaml", Edited("concurrency: 1}",
                       absl::StrCat("rate: 6/min, drill: true, sha256: ", std::string(64, 'A'),
                                    "}\nexec: {socket: /s, user: rx, cgroup: /sys/fs/cgroup/x}")));
  ASSERT_THAT(parsed, IsOk());
  EXPECT_EQ(parsed->config.exec.socket, "/s");
  EXPECT_EQ(parsed->config.exec.user, "rx");
  EXPECT_EQ(parsed->config.exec.cgroup, "/sys/fs/cgroup/x");
  EXPECT_EQ(parsed->config.programs[0].starts_per_minute, 6);
  EXPECT_TRUE(parsed->config.programs[0].drill);
  EXPECT_EQ(parsed->config.programs[0].sha256, std::string(64, 'a'));
}

TEST(ConfigTest, AProgramsNameHasALimit) {
  EXPECT_THAT(ParseConfig("a.yaml", Edited("usb_alarm", std::string(257, 'n'))),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("a name of 257 bytes exceeds limit 256")));
}

TEST(ConfigTest, ReadsAlarms) {
  const auto parsed = ParseConfig(
      "a.yaml", Edited("    leave: []\n    on_drift: []\nprograms:",
                       "      - {alarm: {device: bell, state: \"on\"}, on_failure: continue}\n"
                       "    leave: [{alarm: {device: bell, state: \"off\"}, timeout: 500ms}]\n"
                       "devices: [{name: bell, kind: usb_relay, serial: A1B2C, channel: 2}]\n"
                       "programs:"));
  ASSERT_THAT(parsed, IsOk());
  const Config& config = parsed->config;
  ASSERT_EQ(config.devices.size(), 1u);
  EXPECT_EQ(config.devices[0], (AlarmSpec{"bell", AlarmKind::kUsbRelay, "A1B2C", "", 2}));
  ASSERT_EQ(config.levels[1].enter.size(), 3u);
  const Step& on = config.levels[1].enter[2];
  EXPECT_EQ(std::get<AlarmStep>(on.what), (AlarmStep{"bell", {AlarmPattern::kOn, {}}}));
  EXPECT_EQ(on.timeout, absl::Seconds(1));
  EXPECT_EQ(on.retries, 2);
  EXPECT_EQ(on.on_failure, OnFailure::kContinue);
  EXPECT_EQ(config.levels[1].leave[0].timeout, absl::Milliseconds(500));
  EXPECT_THAT(FormatSettings(parsed->settings),
              AllOf(HasSubstr("devices[0].kind: usb_relay"), HasSubstr("devices[0].channel: 2"),
                    HasSubstr("enter[2].alarm.state: \"on\"")));
}

TEST(ConfigTest, TellsADeviceOnlyOncePerList) {
  EXPECT_THAT(
      ParseConfig("a.yaml", Edited("    on_drift: []\nprograms:",
                                   "devices: [{name: bell, kind: lcus, serial: x}]\nprograms:"))
          .status(),
      IsOk());
  EXPECT_THAT(
      ParseConfig("a.yaml", Edited("    leave: []\n    on_drift: []\nprograms:",
                                   "    leave: [{alarm: {device: bell, state: \"on\"}}, "
                                   "{alarm: {device: bell, state: \"off\"}}]\n"
                                   "devices: [{name: bell, kind: lcus, serial: x}]\nprograms:")),
      StatusIs(absl::StatusCode::kInvalidArgument,
               HasSubstr("device `bell` is ordered twice in one list")));
}

TEST(ConfigTest, OrdersAPartOnlyOncePerList) {
  EXPECT_THAT(ParseConfig("a.yaml", Edited("enter: [{system_mode: {part: /safety, mode: "
                                           "__DEFAULT__}}]",
                                           "enter: [{system_mode: {part: /safety, mode: A}}, "
                                           "{system_mode: {part: /safety, mode: B}}]")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is ordered twice")));
}

constexpr absl::string_view kProgramStep =
    "{program: {name: usb_alarm, args: [\"on\"]}, on_failure: continue}";

TEST(ConfigTest, ReadsFirewallSteps) {
  const auto parsed = ParseConfig(
      "a.yaml",
      absl::StrReplaceAll(
          Edited(kProgramStep,
                 "{firewall: {file: /etc/rips/alert.nft, for: 1h}}\n"
                 "      - {firewall: {isolate_host: [10.0.0.7, \"FD00::07\", "
                 "\"02:00:5E:00:53:01\", 10.0.0.7]}}\n"
                 "      - {firewall: {isolate_participant: "
                 "[01104A3B0000000000000001]}, retries: 0}"),
          {{"leave: []\n    on", "leave: [{firewall: {release: all}}]\n    on"},
           {"metrics:", "firewall: {socket: /run/fw, user: \"7\", hold: 25s}\nmetrics:"}}));
  ASSERT_THAT(parsed, IsOk());

  const FirewallSettings& settings = parsed->config.firewall;
  EXPECT_EQ(settings.socket, "/run/fw");
  EXPECT_EQ(settings.user, "7");
  EXPECT_EQ(settings.hold, absl::Seconds(25));
  const LevelSpec& level = parsed->config.levels[1];
  ASSERT_EQ(level.enter.size(), 4u);
  EXPECT_EQ(std::get<FirewallStep>(level.enter[1].what),
            (FirewallStep{.kind = FirewallStep::Kind::kRules,
                          .file = "/etc/rips/alert.nft",
                          .hold_for = absl::Hours(1)}));
  EXPECT_EQ(level.enter[1].timeout, kFirewallStepTimeout);
  EXPECT_EQ(std::get<FirewallStep>(level.enter[2].what),
            (FirewallStep{.kind = FirewallStep::Kind::kIsolateHosts,
                          .targets = {"10.0.0.7", "fd00::7", "02:00:5e:00:53:01"}}));
  EXPECT_EQ(std::get<FirewallStep>(level.enter[3].what),
            (FirewallStep{.kind = FirewallStep::Kind::kIsolateParticipants,
                          .targets = {"01104a3b0000000000000001"}}));
  EXPECT_EQ(level.enter[3].retries, 0);
  EXPECT_EQ(std::get<FirewallStep>(level.leave[0].what),
            FirewallStep{.kind = FirewallStep::Kind::kRelease});
  EXPECT_THAT(FirewallFiles(parsed->config.levels), ElementsAre("/etc/rips/alert.nft"));
}

TEST(ConfigTest, AFirewallThatOutlivesItsLevelIsWarnedOf) {
  constexpr absl::string_view kFile = "{firewall: {file: /etc/rips/alert.nft}}";
  const auto warnings = [](const std::string& text) {
    const auto parsed = ParseConfig("a.yaml", text);
    EXPECT_THAT(parsed, IsOk());
    return FirewallWarnings(parsed->config.levels);
  };
  const std::string alert = Edited(kProgramStep, kFile);
  EXPECT_THAT(warnings(alert),
              ElementsAre("what level `ALERT` puts into the firewall stays in force at `DEFAULT` "
                          "until its time (`for`) is over; write `{firewall: {release: all}}` in "
                          "the `enter` of `DEFAULT`"));
  EXPECT_THAT(warnings(absl::StrReplaceAll(
                  alert, {{"leave: []\n    on", "leave: [{firewall: {release: all}}]\n    on"}})),
              IsEmpty());
  ParsedConfig parsed = *ParseConfig("a.yaml", alert);
  parsed.config.levels.front().enter.push_back({.what = FirewallStep{}});
  EXPECT_THAT(FirewallWarnings(parsed.config.levels), IsEmpty());
  EXPECT_THAT(warnings(std::string(kConfig)), IsEmpty());
}

TEST(ConfigTest, RefusesFirewallStepsThatCannotBe) {
  std::string many;
  for (size_t i = 0; i <= kTargetsMax; ++i)
    absl::StrAppend(&many, i == 0 ? "" : ", ", "10.1.0.", i);
  const struct {
    std::string step;
    absl::string_view message;
  } kCases[] = {
      {"{}", "exactly one of `file`, `isolate_host`, `isolate_participant` and `release`"},
      {"{file: /a, release: all}", "exactly one of `file`"},
      {"{file: a.nft}", "write an absolute path"},
      {"{file: /a.nft, for: 1s}", "`for`"},
      {"{file: /a.nft, for: 25h}", "`for`"},
      {"{file: /a.nft, rules: x}", "unknown key `rules`"},
      {"{isolate_host: []}", "isolate_host"},
      {"{isolate_host: [base.example]}", "names are not looked up"},
      {"{isolate_host: [127.0.0.1]}", "a loopback address"},
      {"{isolate_host: [10.9.8.7]}", "`10.9.8.7` is a policy server, which is never isolated"},
      {absl::StrCat("{isolate_host: [", many, "]}"), "65 targets exceed limit 64"},
      {"{isolate_participant: [1234]}", "24 hexadecimal digits"},
      {"{release: some}", "write `release: all`"},
      {"{release: all, for: 1h}", "a release has no time limit"},
      {"{file: /a}}, {firewall: {file: /b}", "has two firewall files"},
      {"{file: /a}}, {firewall: {release: all}", "release in `leave`"},
  };
  for (const auto& test : kCases) {
    const std::string text = absl::StrReplaceAll(
        Edited("policy.example:7443", "10.9.8.7:7443"),
        {{"leave: []\n    on", absl::StrCat("leave: [{firewall: ", test.step, "}]\n    on")}});
    EXPECT_THAT(ParseConfig("a.yaml", text),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(test.message)))
        << test.step;
  }
  EXPECT_THAT(ParseConfig("a.yaml", Edited("metrics:", "firewall: {hold: 5s}\nmetrics:")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("`hold`")));
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
              ElementsAre("smh.yaml:6:7: level `ALERT` activates /cam, which the level before it "
                          "has off"));

  const auto other = ParseConfig("a.yaml", Edited("mode: ALERT}", "mode: ALARM}"));
  ASSERT_THAT(other, IsOk());
  EXPECT_THAT(CheckLevelsAgainstSmh(other->config, *smh),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("level `ALERT`"), HasSubstr("has no mode `ALARM`"))));
}

// As the listing of the paper: its HALT leaves the planner active.
TEST(ConfigTest, TheLastLevelShouldNotLeaveANodeAsItWas) {
  const auto smh = ParseSmh(R"(safety:
  ros__parameters:
    type: system
    modes:
      __DEFAULT__: {twist: active, planner: active, arm: active}
      ALERT: {twist: inactive, planner: active, arm: active.SLOW}
twist: {ros__parameters: {type: node, modes: {__DEFAULT__: {ros__parameters: {a: 1}}}}}
planner: {ros__parameters: {type: node, modes: {__DEFAULT__: {ros__parameters: {a: 1}}}}}
arm:
  ros__parameters:
    type: node
    modes: {__DEFAULT__: {ros__parameters: {a: 1}}, SLOW: {ros__parameters: {a: 2}}}
)");
  ASSERT_THAT(smh, IsOk());
  EXPECT_THAT(MonotonyWarnings(ParseConfig("a.yaml", kConfig)->config, *smh),
              ElementsAre("smh.yaml:6:7: level `ALERT` is the most restrictive and leaves /planner "
                          "as it is in the first level"));
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
  EXPECT_THAT(ProtectedParts(levels, *smh, Backend::kManager),
              ElementsAre("/cam", "/zoom", "/safety"));
  EXPECT_THAT(ProtectedParts({}, Smh{}, Backend::kManager), ElementsAre());
  std::vector<LevelSpec> of_system = levels;
  of_system[0].enter.push_back({.what = SystemModeStep{.part = "/safety", .mode = "m"}});
  EXPECT_THAT(ProtectedParts(of_system, *smh, Backend::kDirect), ElementsAre("/cam", "/zoom"))
      << "a robot without a manager has no `/safety` that a sensor could see";

  Smh many;
  for (size_t i = 0; i < kProtectedPartsMax; ++i) many.nodes[absl::StrCat("/n", i)] = {};
  const std::vector<std::string> parts = ProtectedParts(levels, many, Backend::kManager);
  EXPECT_EQ(parts.size(), kProtectedPartsMax);
  EXPECT_EQ(parts[1], "/zoom") << "those of the levels first";
}

TEST(ConfigTest, WhatALevelHasInactiveFollowsItsSteps) {
  const auto smh = ParseSmh(R"(
safety:
  ros__parameters:
    type: system
    modes:
      __DEFAULT__: {cam: active, drive: active}
      HALT: {cam: inactive, drive: inactive}
cam: {ros__parameters: {type: node, modes: {__DEFAULT__: {ros__parameters: {a: 1}}}}}
drive: {ros__parameters: {type: node, modes: {__DEFAULT__: {ros__parameters: {a: 1}}}}}
)");
  ASSERT_THAT(smh, IsOk());
  const auto step = [](const char* part, const char* mode) {
    return Step{.what = SystemModeStep{.part = part, .mode = mode}};
  };
  std::vector<LevelSpec> levels(5);
  levels[0] = {.name = "DEFAULT", .enter = {step("/safety", "__DEFAULT__")}};
  levels[1] = {.name = "LOGGED", .enter = {{.what = ProgramStep{.name = "log"}}}};
  levels[2] = {.name = "HALT", .enter = {step("/safety", "HALT")}};
  levels[3] = {.name = "LOOK", .enter = {step("/safety", "HALT"), step("/cam", "__DEFAULT__")}};
  levels[4] = levels[2];
  levels[4].name = "LAST";
  levels[4].on_drift = {step("/cam", "__DEFAULT__")};
  EXPECT_THAT(InactiveParts(levels, *smh, {"/safety", "/cam", "/drive"}),
              ElementsAre(model::InactiveParts{"DEFAULT", {}},
                          model::InactiveParts{"HALT", {"/cam", "/drive"}},
                          model::InactiveParts{"LOOK", {"/drive"}},
                          model::InactiveParts{"LAST", {"/drive"}}));
  EXPECT_THAT(InactiveParts({levels[2]}, *smh, {"/safety", "/cam"}),
              ElementsAre(model::InactiveParts{"HALT", {"/cam"}}))
      << "a part that is not named to the server is none";
}

TEST(ConfigTest, EveryCutIsReadOrRefusedWithoutHarm) {
  for (size_t length = 0; length < kConfig.size(); ++length) {
    ParseConfig("a.yaml", kConfig.substr(0, length)).status().IgnoreError();
  }
}

}  // namespace
}  // namespace rips::actuator

// `ripsctl rules replay` and `ripsctl rules test`, from the command line on.
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/recording/recording_test_data.h"
#include "policy_server/ripsctl/offline_run.h"
#include "policy_server/ripsctl/run_program.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

constexpr char kRules[] = R"(levels: QUIET; LOUD soft; OFF;
vars: n int = 0;
rules Graph:
  stranger: !nodesonly("/talker") ? alert("a stranger", "high") => trigger(LOUD);
rules Message:
  count: topicin("/chatter") ? set(n, n + 1);
  alarm: topicin("/chatter") && n == 2 ? exec("usb_alarm", "1") !> alert("no alarm");
rules External:
  calm: CurrLevel == LOUD ? trigger(QUIET);
  off: false ? trigger(OFF);
)";

constexpr char kEvents[] = R"(---
event: message
fromtopic: /chatter
rawmsg: AAEAAAYAAABoZWxsbwA=
context:
  nodes: [{node: talker}]
  topics: [{topic: /chatter, parameters: [std_msgs/String], publishers: [talker], subscribers: [~]}]
...
---
event: parameter
...
---
event: message
fromtopic: chatter
...
---
event: graph
context:
  nodes: [{node: talker}, {node: stranger}]
...
)";

constexpr char kTests[] = R"(rules: [a.rul]
tests:
  - name: strangers
    events:
      - graph: {nodes: [/talker, /stranger]}
        expect: {alerts: [{text: a stranger}], level: LOUD}
)";

class RulesReplayTest : public testing::Test {
 protected:
  RulesReplayTest() {
    rules_ = Write("a.rul", kRules);
    events_ = Write("events.yaml", kEvents);
  }
  std::string Write(const std::string& name, const std::string& text) {
    return directory_.Write(name, text);
  }
  std::vector<std::string> ReplayArgs(const std::vector<std::string>& more) {
    std::vector<std::string> args = {"rules", "replay", "--rules", rules_, "--events", events_};
    args.insert(args.end(), more.begin(), more.end());
    return args;
  }
  Result Replay(const std::vector<std::string>& more = {}) { return RunOffline(ReplayArgs(more)); }
  nlohmann::json ReplayJson(std::vector<std::string> more = {}) {
    more.insert(more.end(), {"--output", "json"});
    const Result result = Replay(more);
    EXPECT_EQ(result.code, 0) << result.err;
    EXPECT_EQ(result.err, "");
    return nlohmann::json::parse(result.out, nullptr, false);
  }

  const TestDirectory directory_;
  const std::string folder_ = directory_.path();
  std::string rules_;
  std::string events_;
};

constexpr char kGolden[] =
    R"({"events":{"message":2,"graph":1,"external":0,"undecidable":0,"unattributed":2},)"
    R"("level":"LOUD",)"
    R"("transitions":[{"event":3,"rule":"stranger","from":"QUIET","to":"LOUD",)"
    R"("result":"decided"}],)"
    R"("alerts":[{"event":3,"rule":"stranger","text":"a stranger","severity":"high"}],)"
    R"("execs":[{"event":2,"rule":"alarm","program":"usb_alarm","args":["1"],"result":"ok"}],)"
    R"("variables":{"n":2},"faults":[],)"
    R"("rules":[{"name":"stranger","section":"Graph","evaluated":1,"fired":1,"ns_mean":0},)"
    R"({"name":"count","section":"Msg","evaluated":2,"fired":2,"ns_mean":0},)"
    R"({"name":"alarm","section":"Msg","evaluated":2,"fired":1,"ns_mean":0},)"
    R"({"name":"calm","section":"External","evaluated":0,"fired":0,"ns_mean":0},)"
    R"({"name":"off","section":"External","evaluated":0,"fired":0,"ns_mean":0}]})"
    "\n";

TEST_F(RulesReplayTest, JsonIsTheSameBytesInEveryProcess) {
  const std::vector<std::string> args = ReplayArgs({"--output", "json"});

  EXPECT_EQ(RunOffline(args).out, kGolden);
  const auto printed = [](std::vector<std::string> all) {
    all.insert(all.begin(), RIPS_BIN_DIR "/ripsctl");
    return RunProgram(all).out;
  };
  EXPECT_EQ(printed(args), kGolden);
  EXPECT_EQ(printed(args), kGolden);
  const std::vector<std::string> text = ReplayArgs({});
  EXPECT_EQ(printed(text), RunOffline(text).out);
}

TEST_F(RulesReplayTest, TextIsForPeople) {
  const Result result = Replay({"--exec-fail", "usb_alarm"});

  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_THAT(result.out, StartsWith("events: 2 messages, 1 graph changes, 0 external\n"
                                     "level at the end: LOUD\n"));
  EXPECT_THAT(result.out,
              AllOf(HasSubstr("\nLevels\nEVENT      FROM   TO    RESULT   RULE\n"
                              "3 +0.003s  QUIET  LOUD  decided  stranger\n"),
                    HasSubstr("3 +0.003s  high      stranger  a stranger\n"),
                    HasSubstr("2 +0.002s  failed  alarm  usb_alarm 1\n"), HasSubstr("no alarm\n"),
                    HasSubstr("\nn     2\n"),
                    HasSubstr("FIRED  OF  SECTION   RULE\n2      2   Msg       count\n"),
                    Not(HasSubstr("undecidable"))));
}

TEST_F(RulesReplayTest, FlagsSayWhatTheRobotDoes) {
  EXPECT_EQ(ReplayJson({"--exec-fail", "usb_alarm"})["execs"][0]["result"], "failed");
  EXPECT_EQ(ReplayJson({"--start-level", "OFF"})["level"], "OFF");
  EXPECT_EQ(ReplayJson({"--trigger-fail", "LOUD", "OFF"})["level"], "LOUD");
  // Every 2 ms, over 3 ms.
  const nlohmann::json ticks = ReplayJson({"--virtual-tick", "2", "--start-level", "LOUD"});
  EXPECT_EQ(ticks["events"]["external"], 1);
  EXPECT_EQ(ticks["transitions"][0]["to"], "QUIET");
  EXPECT_EQ(ReplayJson({"--virtual-tick", "2", "--event-interval", "10"})["events"]["external"],
            15);
  EXPECT_EQ(ReplayJson({"--profile"})["rules"].size(), 5u);
  // The prototype's include forms mean the converse.
  const std::string old = Write("old.rul",
                                "levels: A;\nrules Graph: r: nodesinclude(\"/talker\") ? "
                                "alert(\"there\");\n");
  const auto alerts = [&](const std::string& dialect) {
    const Result result = RunOffline({"rules", "replay", "--rules", old, "--events", events_,
                                      "--dialect", dialect, "--output", "json"});
    return nlohmann::json::parse(result.out)["alerts"].size();
  };
  EXPECT_EQ(alerts("rips"), 0u);
  EXPECT_EQ(alerts("prototype"), 1u);
}

TEST_F(RulesReplayTest, SeveralFilesAreOnePolicy) {
  const std::string more = Write("b.rul", "rules Graph: more: n == 2 ? alert(\"from b\");\n");
  const Result result = RunOffline({"rules", "replay", "--rules", rules_, "--rules", more,
                                    "--events", events_, "--output", "json"});
  EXPECT_THAT(result.out, HasSubstr("\"text\":\"from b\""));
}

TEST_F(RulesReplayTest, ShowsWhatOtherRulesWouldHaveDone) {
  std::string other_text = kRules;
  other_text.replace(other_text.find("trigger(LOUD)"), 13, "trigger(OFF) ");
  const std::string other =
      Write("other.rul", other_text + "rules Msg: none: false ? trigger(LOUD);");

  const nlohmann::json against = ReplayJson({"--against", other})["against"];
  EXPECT_EQ(against["same"], false);
  EXPECT_EQ(against["first_difference"], 3);
  EXPECT_EQ(against["level"], nlohmann::json({{"before", "LOUD"}, {"after", "OFF"}}));
  EXPECT_EQ(against["transitions"]["before"][0]["to"], "LOUD");
  EXPECT_EQ(against["transitions"]["after"][0]["to"], "OFF");
  EXPECT_EQ(against["alerts"], nlohmann::json::parse(R"({"before":[],"after":[]})"));
  EXPECT_EQ(ReplayJson({"--against", rules_})["against"]["same"], true);
  EXPECT_THAT(Replay({"--against", rules_}).out,
              HasSubstr("\nagainst: the same levels, alerts, programs and variables\n"));
  EXPECT_THAT(Replay({"--against", other}).out,
              AllOf(HasSubstr("against: the other rules differ from event 3 +0.003s on"),
                    HasSubstr("Levels of --against only")));
}

TEST_F(RulesReplayTest, ComparesVariablesToo) {
  std::string other_text = kRules;
  other_text.replace(other_text.find("n + 1"), 5, "n + 2");
  other_text.replace(other_text.find("n == 2"), 6, "n == 4");
  other_text += "vars: more int = 0;\nrules Msg: never: more > 0 ? set(more, 0);\n";
  const std::string other = Write("other.rul", other_text);

  EXPECT_THAT(Replay({"--against", other}).out, HasSubstr("\nVariables that differ at the end\n"
                                                          "NAME  WITH --rules  WITH --against\n"
                                                          "more  (none)        0\n"
                                                          "n     2             4\n"));
  const nlohmann::json against = ReplayJson({"--against", other})["against"];
  EXPECT_EQ(against["same"], false);
  EXPECT_EQ(against["first_difference"], nullptr);
  EXPECT_EQ(against["variables"], nlohmann::json::parse(R"({"before":{"n":2},
                                                            "after":{"more":0,"n":4}})"));
  // What only one of them runs may fail.
  EXPECT_EQ(Replay({"--against", other, "--exec-fail", "usb_alarm"}).code, 0);
}

TEST_F(RulesReplayTest, SaysWhatWasNotTold) {
  EXPECT_THAT(Replay().out, Not(HasSubstr("no sender")));
  EXPECT_THAT(Replay().out, Not(HasSubstr("unscanned")));
  // The second message has no payload.
  Write("x.yar", "rule x { strings: $a = \"EVIL\" condition: $a }\n");
  const std::string rules = Write("told.rul", R"(levels: A;
rules Msg:
  inspects: topicin("/chatter") && payload("x.yar") ? alert("x");
  asks: topicin("/chatter") ? alert("from " + Sender);
)");
  const auto replay = [&](const std::string& then, const std::string& output = "text") {
    return RunOffline({"rules", "replay", "--rules", rules, "--events", events_,
                       "--on-inspection-error", then, "--output", output})
        .out;
  };

  EXPECT_THAT(
      replay("match"),
      AllOf(HasSubstr("\nunscanned: 1 times a rule asked an inspection that could not tell; "
                      "it fired all the same (see --on-inspection-error): inspects\n"),
            HasSubstr("\nno sender: 2 messages do not say who sent them; `senderin` and "
                      "`sendercount` are false for them\n")));
  EXPECT_THAT(replay("ignore"), HasSubstr("could not tell; it did not fire (see"));
  const nlohmann::json json = nlohmann::json::parse(replay("match", "json"));
  EXPECT_EQ(json["rules"][0]["unscanned"], 1);
  EXPECT_FALSE(json["rules"][1].contains("unscanned"));
}

TEST_F(RulesReplayTest, NamesRulesThatAskWhatABagDoesNotHold) {
  namespace bag = recording;
  const std::string events = Write(
      "bag.mcap", absl::StrCat(bag::McapHeader(), bag::McapSchema(1, "std_msgs/msg/String"),
                               bag::McapChannel(1, 1, "/chatter"), bag::McapMessage(1, 10, "hello"),
                               bag::McapDataEnd(), bag::McapFooter()));
  std::string text = "levels: A;\nrules Msg:\n  told: topicin(\"/chatter\") ? True();\n";
  const auto replay = [&] {
    const std::string rules = Write("bag.rul", text);
    return RunOffline({"rules", "replay", "--rules", rules, "--events", events}).out;
  };
  for (int i = 1; i <= 5; ++i) {
    absl::StrAppend(&text, "  r", i, ": nodesonly(\"/n", i, "\") ? True();\n");
  }
  EXPECT_THAT(replay(), HasSubstr("undecidable: at 1 events a rule asked what the recording does "
                                  "not hold, so it did not fire: r1, r2, r3, r4, r5\n"));
  text += "  r6: nodesonly(\"/n6\") ? True();\n  r7: nodesonly(\"/n7\") ? True();\n";
  EXPECT_THAT(replay(), HasSubstr("did not fire: r1, r2, r3, r4, r5 and 2 more\n"));
}

TEST_F(RulesReplayTest, RefusedRulesAreShownAsCheckDoes) {
  const std::string broken = Write("broken.rul", "levels: A;\nrules Msg: nonsense() ? alert(1);\n");
  for (const std::string output : {"text", "json"}) {
    const Result check = RunOffline({"rules", "check", broken, "--output", output});
    const Result replay =
        RunOffline({"rules", "replay", "--rules", broken, "--events", events_, "--output", output});
    EXPECT_EQ(replay.code, 1);
    EXPECT_EQ(replay.out, check.out);
    EXPECT_EQ(replay.err, "");
    EXPECT_EQ(Replay({"--against", broken, "--output", output}).out, check.out);
  }
}

TEST_F(RulesReplayTest, ACutRecordingIsReplayedAndExitsWithFour) {
  namespace bag = recording;
  const int64_t start = 1'767'225'600'000'000'000;  // 2026-01-01T00:00:00Z
  std::string bytes = absl::StrCat(bag::McapHeader(), bag::McapChannel(1, 0, "/chatter"));
  for (const int64_t at_ms : {0, 400, 12'400}) {
    bytes += bag::McapMessage(1, static_cast<uint64_t>(start + at_ms * 1'000'000), "hello");
  }
  const std::string cut = Write("cut.mcap", bytes + "\x05\x09");
  const std::vector<std::string> args = {"rules", "replay", "--rules", rules_, "--events", cut};

  const Result text = RunOffline(args);
  EXPECT_EQ(text.code, 4);
  EXPECT_EQ(text.err, "");
  EXPECT_THAT(text.out,
              AllOf(StartsWith("events: 3 messages"),
                    HasSubstr(absl::StrCat("\nincomplete recording: cut after 12.4 s (event 2, "
                                           "2026-01-01T00:00:12.400Z): `",
                                           cut, "`: byte ", bytes.size(), ": the file is cut"))));
  std::vector<std::string> more = args;
  more.insert(more.end(), {"--output", "json", "--against", rules_});
  const Result json = RunOffline(more);
  EXPECT_EQ(json.code, 4);
  const nlohmann::json missing = nlohmann::json::parse(json.out)["missing"];
  ASSERT_EQ(missing.size(), 1u);
  EXPECT_EQ(missing[0]["after"], 2);
  EXPECT_EQ(missing[0]["seconds"], 12.4);
  EXPECT_EQ(missing[0]["end"], true);
  // Without times; rules that are refused come first.
  const std::string yaml = Write("cut.yaml", absl::StrCat(kEvents, "---\nevent: mess"));
  const Result untimed = RunOffline({"rules", "replay", "--rules", rules_, "--events", yaml});
  EXPECT_EQ(untimed.code, 4);
  EXPECT_THAT(untimed.out, HasSubstr("\nincomplete recording: cut after event 3: "));
  const std::string broken = Write("broken.rul", "levels: A;\nrules Msg: nonsense() ? alert(1);\n");
  EXPECT_EQ(RunOffline({"rules", "replay", "--rules", broken, "--events", cut}).code, 1);
  // A directory that lacks its first file.
  std::filesystem::create_directory(folder_ + "/bag");
  Write("bag/bag_0.mcap", "");
  Write("bag/bag_1.mcap", bytes);
  const Result folder =
      RunOffline({"rules", "replay", "--rules", rules_, "--events", folder_ + "/bag"});
  EXPECT_EQ(folder.code, 4);
  EXPECT_THAT(folder.out,
              AllOf(HasSubstr("\nincomplete recording: part missing at its beginning: `"),
                    HasSubstr("bag_0.mcap`: byte 0: the file is empty\n"),
                    HasSubstr("has no metadata.yaml")));
}

TEST_F(RulesReplayTest, WhatCannotBeUsedIsAnError) {
  const std::string torn = Write("torn.rips", std::string("\x89RIPS\x01\r\n\x09", 9));
  const auto with = [&](const std::string& events) {
    return std::vector<std::string>{"rules", "replay", "--rules", rules_, "--events", events};
  };
  const std::pair<std::vector<std::string>, std::string> kCases[] = {
      {with(folder_ + "/none"), "none"},
      {with(torn), "torn.rips"},
      {with(rules_), "a.rul"},
      {{"rules", "replay", "--rules", folder_ + "/no.rul", "--events", events_}, "no.rul"},
      {ReplayArgs({"--against", folder_ + "/no.rul"}), "no.rul"},
      {ReplayArgs({"--start-level", "NO"}),
       "--start-level: the rules have no level `NO`; they have QUIET, LOUD, OFF"},
      {ReplayArgs({"--trigger-fail", "NO"}), "--trigger-fail: the rules have no level `NO`"},
      {ReplayArgs({"--exec-fail", "usb"}),
       "--exec-fail: the rules run no program `usb`; they run usb_alarm"},
      {ReplayArgs({"--virtual-tick", "-1"}), "--virtual-tick"},
      {ReplayArgs({"--virtual-tick", "3600001"}), "--virtual-tick"},
      {ReplayArgs({"--event-interval", "3600001"}), "--event-interval"},
      {ReplayArgs({"--event-interval", "x"}), "--event-interval"},
      {ReplayArgs({"--dialect", "x"}), "--dialect"},
      {ReplayArgs({"--on-inspection-error", "x"}), "--on-inspection-error"},
      {ReplayArgs({"--output", "junit"}), "--output is `junit`; write `text` or `json`"},
      {{"rules", "replay", "--rules", rules_}, "--events"},
      {{"rules", "replay", "--events", events_}, "--rules"},
  };
  for (const auto& [args, problem] : kCases) {
    const Result result = RunOffline(args);
    EXPECT_EQ(result.code, 2) << testing::PrintToString(args) << result.out;
    EXPECT_EQ(result.out, "") << testing::PrintToString(args);
    EXPECT_THAT(result.err, HasSubstr(problem)) << testing::PrintToString(args);
  }
}

TEST_F(RulesReplayTest, TestsThatPassExitWithZero) {
  const std::string tests = Write("a_test.yaml", kTests);

  const Result text = RunOffline({"rules", "test", tests, tests});
  EXPECT_EQ(text.code, 0) << text.out << text.err;
  EXPECT_EQ(text.out,
            absl::StrCat(tests, ": rules not exercised: count, alarm, calm\n", tests,
                         ": rules not exercised: count, alarm, calm\n", "ok: 2 tests, 0 failed\n"));
  const Result json = RunOffline({"rules", "test", tests, "--output", "json"});
  EXPECT_EQ(nlohmann::json::parse(json.out),
            nlohmann::json({{"tests", 1},
                            {"failed", 0},
                            {"files",
                             {{{"path", tests},
                               {"ok", true},
                               {"tests",
                                {{{"name", "strangers"},
                                  {"line", 3},
                                  {"ok", true},
                                  {"failures", nlohmann::json::array()}}}},
                               {"not_exercised", {"count", "alarm", "calm"}}}}}}));
  const Result junit = RunOffline({"rules", "test", tests, "--output", "junit"});
  EXPECT_EQ(junit.code, 0);
  EXPECT_THAT(junit.out, AllOf(HasSubstr("tests=\"1\" failures=\"0\" errors=\"0\""),
                               HasSubstr("name=\"strangers\"/>")));
}

TEST_F(RulesReplayTest, TestsThatFailExitWithOneAndTheRestIsRun) {
  std::string failing = kTests;
  failing.replace(failing.find("a stranger"), 10, "a <&>");
  failing += "  - name: another <test>\n    events: [{lost: 1}]\n    expect: {level: OFF}\n";
  const std::string tests = Write("a_test.yaml", failing);

  const Result text = RunOffline({"rules", "test", tests});
  EXPECT_EQ(text.code, 1);
  EXPECT_EQ(text.err, "");
  EXPECT_THAT(
      text.out,
      AllOf(HasSubstr(absl::StrCat(tests, ":6: strangers: alerts\n  expected:\n    text: a <")),
            HasSubstr("  got:\n    rule: stranger, severity: high, text: a stranger\n"),
            HasSubstr(absl::StrCat(tests, ":9: another <test>: level at the end\n")),
            HasSubstr("failed: 2 tests, 2 failed\n")));
  const Result json = RunOffline({"rules", "test", tests, "--output", "json"});
  EXPECT_EQ(json.code, 1);
  EXPECT_EQ(nlohmann::json::parse(json.out)["failed"], 2);
  const Result junit = RunOffline({"rules", "test", tests, "--output", "junit"});
  EXPECT_EQ(junit.code, 1);
  EXPECT_THAT(junit.out, AllOf(HasSubstr("failures=\"2\""), HasSubstr("another &lt;test&gt;"),
                               HasSubstr("a &lt;&amp;&gt;"), Not(HasSubstr("<&"))));
}

TEST_F(RulesReplayTest, TestsSayWhatWasUnscanned) {
  Write("x.yar", "rule x { strings: $a = \"EVIL\" condition: $a }\n");
  Write("x.rul",
        "levels: A;\nrules Msg: r: topicin(\"/t\") && payload(\"x.yar\") ? alert(\"x\");\n");
  const std::string tests = Write("x_test.yaml", R"(rules: [x.rul]
tests:
  - {name: lulled, events: [{message: {topic: /t, size: 9}}], expect: {fired: [r]}}
  - name: surprised
    events: [{message: {topic: /t, size: 9}}]
    expect: {alerts: [], unscanned: [r]}
)");
  const std::string note = "note: an inspection could not tell, so these rules fired: r\n";

  EXPECT_THAT(RunOffline({"rules", "test", tests}).out,
              AllOf(HasSubstr(absl::StrCat(tests,
                                           ":3: lulled: an inspection could not tell these "
                                           "rules, and no `unscanned` expects it: r\n")),
                    HasSubstr(absl::StrCat("  ", note)), HasSubstr("2 tests, 1 failed")));
  const nlohmann::json json =
      nlohmann::json::parse(RunOffline({"rules", "test", tests, "--output", "json"}).out);
  const nlohmann::json& all = json["files"][0]["tests"];
  EXPECT_EQ(all[0]["unscanned"], nlohmann::json({"r"}));
  EXPECT_FALSE(all[1].contains("unscanned"));
  EXPECT_THAT(absl::StrCat("note: ", all[1]["failures"][0]["note"].get<std::string>(), "\n"), note);
  EXPECT_THAT(RunOffline({"rules", "test", tests, "--output", "junit"}).out,
              HasSubstr(absl::StrCat(note, "</failure>")));
}

TEST_F(RulesReplayTest, RunChoosesTestsByName) {
  const std::string tests = Write("a_test.yaml",
                                  "rules: [a.rul]\ntests:\n  - {name: intruders come}\n"
                                  "  - {name: intruder goes, expect: {level: OFF}}\n");
  const std::string others = Write("b_test.yaml", "rules: [a.rul]\ntests: [{name: other}]\n");
  const auto run = [&](const std::string& pattern) {
    return RunOffline({"rules", "test", tests, others, "--run", pattern});
  };

  EXPECT_EQ(run("come").out, "ok: 1 tests, 0 failed\n");
  EXPECT_THAT(run("intruder").out, HasSubstr("failed: 2 tests, 1 failed\n"));
  EXPECT_THAT(run("*e").out, HasSubstr("ok: 1 tests, 0 failed\n"));
  EXPECT_THAT(run("intruder?*").out, HasSubstr("failed: 2 tests, 1 failed\n"));
  EXPECT_THAT(run("*").out, HasSubstr("failed: 3 tests, 1 failed\n"));
  EXPECT_THAT(run("o?h?r").out, HasSubstr("ok: 1 tests, 0 failed\n"));
  const std::string there = "`intruders come`, `intruder goes`, `other`\n";
  for (const char* pattern : {"intruder?", "other?", "?other", "o*x", "INTRUDERS"}) {
    const Result none = run(pattern);
    EXPECT_EQ(none.code, 1) << pattern;
    EXPECT_EQ(none.out, "") << pattern;
    EXPECT_THAT(none.err, AllOf(HasSubstr(absl::StrCat("no test is named `", pattern, "`; ")),
                                HasSubstr(there)));
  }
  EXPECT_THAT(run("othre").err, HasSubstr("did you mean `other`? The files have `intruders come`"));
  EXPECT_THAT(run(std::string(100, '*') + "x").err, HasSubstr("no test is named"));
  const nlohmann::json json = nlohmann::json::parse(
      RunOffline({"rules", "test", tests, others, "--run", "come", "--output", "json"}).out);
  ASSERT_EQ(json["files"].size(), 1u);
  EXPECT_EQ(json["files"][0]["not_exercised"], nlohmann::json::array());
}

TEST_F(RulesReplayTest, NoMatchNamesOnlySomeOfManyTests) {
  std::string text = "rules: [a.rul]\ntests:\n";
  for (int i = 0; i < 25; ++i) absl::StrAppend(&text, "  - {name: t", i, "}\n");
  const Result none = RunOffline({"rules", "test", Write("a_test.yaml", text), "--run", "zzzz"});
  EXPECT_EQ(none.code, 1);
  EXPECT_THAT(none.err, AllOf(HasSubstr("`t19` and 5 more"), Not(HasSubstr("t20"))));
}

// Its manifest starts at LOUD, holds for 2 s, and has two operators lower from OFF.
constexpr char kBundleManifest[] = R"(name: site
rules: [a.rul]
levels: [QUIET, LOUD, OFF]
start_level: LOUD
soft_hold: 2s
two_person: [OFF]
)";

TEST_F(RulesReplayTest, TestsRunABundleAsItsManifestSays) {
  Write("site/manifest.yaml", kBundleManifest);
  Write("site/a.rul", kRules);
  const std::string text = R"(rules: [site]
tests:
  - name: held
    evidence: incomplete
    events:
      - tick: {}
        expect: {level: LOUD, transitions: [{result: refused, reason: blind}]}
      - evidence: complete
      - wait_ms: 1900
      - tick: {}
        expect: {level: LOUD}
      - evidence: complete
      - tick: {}
        expect: {level: QUIET}
  - name: interrupted
    evidence: incomplete
    events:
      - evidence: complete
      - wait_ms: 1900
      - evidence: incomplete
      - evidence: complete
      - wait_ms: 1900
      - tick: {}
        expect: {level: LOUD}
  - name: complete from the beginning
    events: [{tick: {}}]
    expect: {level: QUIET}
  - name: two operators
    start_level: OFF
    events:
      - operator: {lower: LOUD}
        expect: {level: OFF, transitions: []}
      - operator: {lower: LOUD, approved: true}
        expect: {level: LOUD}
      - operator: {lower: QUIET}
        expect: {level: QUIET}
)";
  const std::string tests = Write("a_test.yaml", text);
  const Result result = RunOffline({"rules", "test", tests});
  EXPECT_EQ(result.code, 0) << result.out << result.err;
  EXPECT_THAT(result.out, HasSubstr("ok: 4 tests, 0 failed"));

  // The same tests of the rules alone: no hold, no second operator, and the first level.
  std::string alone = text;
  alone.replace(alone.find("[site]"), 6, "[a.rul]");
  const std::string files = Write("b_test.yaml", alone);
  EXPECT_THAT(RunOffline({"rules", "test", files}).out, HasSubstr("4 tests, 3 failed"));
  EXPECT_THAT(RunOffline({"rules", "test", files, "--bundle", folder_ + "/site"}).out,
              HasSubstr("ok: 4 tests, 0 failed"));
}

TEST_F(RulesReplayTest, BundlesThatCannotBeTestedExitWithTwo) {
  Write("site/manifest.yaml", kBundleManifest);
  Write("site/a.rul", kRules);
  Write("bad/manifest.yaml", "name: bad\nrules: [a.rul]\nlevels: [QUIET]\n");
  Write("bad/a.rul", kRules);
  const std::string of_site = "rules: [site]\ntests: [{name: t}]\n";
  const struct {
    std::string text;
    std::vector<std::string> flags;
    std::string problem;
  } kCases[] = {
      {"dialect: rips\n" + of_site, {}, "x_test.yaml:1: the manifest of the bundle sets"},
      {"on_inspection_error: alert\n" + of_site, {}, "x_test.yaml:1: the manifest of the bundle"},
      {"rules: [bad]\ntests: [{name: t}]\n", {}, "levels"},
      {of_site, {"--bundle", folder_ + "/none"}, "none` is not the directory of a bundle"},
      {of_site, {"--bundle", rules_}, "a.rul` is not the directory of a bundle"},
      {of_site, {"--bundle", folder_}, "manifest.yaml"},
      {"rules: [site, a.rul]\ntests: [{name: t}]\n", {}, "a bundle must be the only entry"},
  };
  for (const auto& [text, flags, problem] : kCases) {
    std::vector<std::string> args = {"rules", "test", Write("x_test.yaml", text)};
    args.insert(args.end(), flags.begin(), flags.end());
    const Result result = RunOffline(args);
    EXPECT_EQ(result.code, 2) << text << result.out;
    EXPECT_THAT(result.err, HasSubstr(problem)) << text;
  }
}

TEST_F(RulesReplayTest, ReplayStartsAtTheLevelOfTheBundle) {
  Write("site/manifest.yaml", kBundleManifest);
  Write("site/a.rul", kRules);
  const auto level = [&](std::vector<std::string> more) {
    std::vector<std::string> args = {
        "rules",           "replay",   "--rules",
        folder_ + "/site", "--events", Write("none.yaml", "---\nevent: parameter\n...\n")};
    args.insert(args.end(), more.begin(), more.end());
    return RunOffline(args).out;
  };
  EXPECT_THAT(level({}), HasSubstr("level at the end: LOUD\n"));
  EXPECT_THAT(level({"--start-level", "QUIET"}), HasSubstr("level at the end: QUIET\n"));
}

TEST_F(RulesReplayTest, RefusedRulesFailTheirTestsOnly) {
  const std::string good = Write("a_test.yaml", kTests);
  Write("broken.rul", "levels: A\n");
  const std::string bad =
      Write("b_test.yaml", "rules: [broken.rul]\ntests: [{name: t, events: []}]\n");

  const Result text = RunOffline({"rules", "test", bad, good});
  EXPECT_EQ(text.code, 1);
  EXPECT_THAT(text.out, AllOf(HasSubstr("broken.rul:"), HasSubstr("its rules were refused"),
                              HasSubstr("failed: 1 tests, 0 failed, 1 files not run\n")));
  const nlohmann::json json =
      nlohmann::json::parse(RunOffline({"rules", "test", bad, "--output", "json"}).out);
  EXPECT_EQ(json["files"][0]["ok"], false);
  EXPECT_EQ(json["files"][0]["refused"]["files"][0]["ok"], false);
  EXPECT_THAT(RunOffline({"rules", "test", bad, "--output", "junit"}).out,
              HasSubstr("<error message=\"the rules were refused\">"));
}

TEST_F(RulesReplayTest, TestFilesThatAreWrongExitWithTwo) {
  const std::string good = Write("a_test.yaml", kTests);
  const std::pair<std::string, std::string> kCases[] = {
      {"rules: [a.rul]\ntests: 5\n", "b_test.yaml:2:"},
      {"rules: [none.rul]\ntests: [{name: t}]\n", "none.rul"},
      {"rules: [a.rul]\ntests: [{name: t, start_level: NO}]\n", "b_test.yaml:2: "},
      {"rules: [a.rul]\ntests: [{name: t, evnts: []}]\n", "did you mean `events`"},
      {std::string("\0\xff", 2), "b_test.yaml"},
  };
  for (const auto& [text, problem] : kCases) {
    const std::string bad = Write("b_test.yaml", text);
    const Result result = RunOffline({"rules", "test", good, bad});
    EXPECT_EQ(result.code, 2) << text;
    EXPECT_EQ(result.out, "") << text;
    EXPECT_THAT(result.err, AllOf(StartsWith("error: "), HasSubstr(problem))) << text;
  }
  EXPECT_EQ(RunOffline({"rules", "test"}).code, 2);
  EXPECT_EQ(RunOffline({"rules", "test", folder_ + "/none.yaml"}).code, 2);
  EXPECT_EQ(RunOffline({"rules", "test", folder_}).code, 2);
  EXPECT_THAT(RunOffline({"rules", "test", good, "--output", "xml"}).err,
              HasSubstr("write `text`, `json` or `junit`"));
}

}  // namespace
}  // namespace rips::ripsctl

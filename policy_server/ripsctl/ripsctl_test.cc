// The whole command line against a server that plays OperatorService on a loopback port.
#include <stdlib.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "gmock/gmock.h"
#include "grpcpp/server_builder.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/app.h"
#include "policy_server/ripsctl/every_verb.h"
#include "policy_server/ripsctl/offline_run.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"
#include "services/base/status_matchers.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/test_pki.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;
using ::testing::StartsWith;

class RipsctlHelpTest : public RipsctlTest {
 protected:
  std::vector<Args> Pages() {
    return HelpPages([this](const Args& args) { return Run(args); });
  }
};

TEST_F(RipsctlTest, ListsRobots) {
  const Result result = Run({"robot", "list"});
  EXPECT_EQ(result.code, 0);
  EXPECT_EQ(result.out,
            "ROBOT  DECIDED      EFFECTIVE    STAGE     DECISION  BUNDLE               HEARD    "
            "DEGRADED\n"
            "r1     COMPROMISED  COMPROMISED  verified  3.17      sha256:bbbbbbbbbbbb  3 s ago  -\n"
            "r2     DEFAULT      -            verified  3.17      sha256:bbbbbbbbbbbb  never*   "
            "sensor base lost; \\x1b[2Jactuator\n"
            "why a robot is at its level, and what to do: ripsctl explain ROBOT\n"
            "* an agent has another version than the server, 0.1.0; see `ripsctl robot show`\n");
  EXPECT_EQ(result.err, "");

  const nlohmann::json list = RunJson({"robot", "list"});
  EXPECT_EQ(list["server_version"], "0.1.0");
  const nlohmann::json robots = list["robots"];
  ASSERT_THAT(robots, SizeIs(2));
  EXPECT_EQ(robots[0], nlohmann::json({{"robot", "r1"},
                                       {"decided_level", "COMPROMISED"},
                                       {"effective_level", "COMPROMISED"},
                                       {"stage", "verified"},
                                       {"decision_id", "3.17"},
                                       {"bundle", "sha256:" + std::string(64, 'b')},
                                       {"degraded", nlohmann::json::array()},
                                       {"degraded_cut", false},
                                       {"pending_approvals", 0},
                                       {"maintenance", nullptr},
                                       {"agents",
                                        {{{"role", "sensor"},
                                          {"host", "base"},
                                          {"version", "0.1.0"},
                                          {"heard", "2026-01-01T00:00:00.000000000Z"},
                                          {"heard_ago_ms", 3'000}}}}}));
  EXPECT_EQ(robots[1]["agents"][0]["version"], "\x1b]0;old\x07") << "escaped as JSON";
  EXPECT_EQ(robots[1]["agents"][1]["heard"], nullptr);
  EXPECT_EQ(robots[1]["agents"][1]["heard_ago_ms"], nullptr);
}

TEST_F(RipsctlTest, ListsTheRobotsWithAllOfTheLabels) {
  const Result result = Run({"robot", "list", "--label", "ring=canary"});
  EXPECT_EQ(result.code, 0);
  EXPECT_THAT(result.out, testing::Not(testing::HasSubstr("r2")));
  EXPECT_EQ(fake_.calls().back(), "ListRobots ring=canary");
  const Result none = Run({"robot", "list", "--label", "ring=canary", "--label", "site=x"});
  EXPECT_EQ(none.code, 1);
  EXPECT_EQ(none.err, "error: the inventory has no robot with ring=canary site=x\n");
  const Result malformed = Run({"robot", "list", "--label", "canary\x1b[2J"});
  EXPECT_NE(malformed.code, 0);
  EXPECT_THAT(malformed.err, testing::HasSubstr("is not a label; write KEY=VALUE"));
  EXPECT_THAT(malformed.err, testing::Not(testing::HasSubstr("\x1b")));
}

TEST_F(RipsctlTest, WatchesRobotsUntilTheServerEndsIt) {
  const Result result = Run({"robot", "watch", "r1"});
  EXPECT_EQ(result.code, 0);
  const std::string time = "20[0-9-]+T[0-9:.]+Z";
  EXPECT_THAT(result.out,
              testing::MatchesRegex(
                  time + "  r1  decided ALERT  effective ALERT  verified  decision 3.17\n" + time +
                  "  r1  decided COMPROMISED  effective COMPROMISED  verified  decision 3.17\n"));
  const Result json = Run({"--output", "json", "robot", "watch"});
  const std::vector<std::string> lines = absl::StrSplit(json.out, '\n', absl::SkipEmpty());
  ASSERT_THAT(lines, SizeIs(2));
  EXPECT_EQ(nlohmann::json::parse(lines[1])["decided_level"], "COMPROMISED");
  fake_.robots_watch_end = grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping");
  const Result resumed = Run({"robot", "watch", "r1"});
  EXPECT_EQ(resumed.code, 0);
  EXPECT_EQ(resumed.err,
            "the connection is lost (stopping); trying again, from where it was\n"
            "connected again\n");
  EXPECT_EQ(std::count(resumed.out.begin(), resumed.out.end(), '\n'), 4);
  fake_.robots_watch_end = grpc::Status(grpc::StatusCode::PERMISSION_DENIED, "banned");
  EXPECT_EQ(Run({"robot", "watch"}).code, 1) << "a refusal is for good";
  fake_.failure = grpc::Status(grpc::StatusCode::UNAVAILABLE, "draining");
  EXPECT_EQ(Run({"robot", "watch"}).code, 3) << "never connected";
}

TEST_F(RipsctlTest, ShowsOneRobot) {
  const Result result = Run({"robot", "show", "r2"});
  EXPECT_EQ(result.code, 0);
  EXPECT_EQ(result.out, absl::StrCat("robot            r2\n"
                                     "decided level    DEFAULT\n"
                                     "effective level  -\n"
                                     "stage            verified\n"
                                     "decision         3.17\n"
                                     "bundle           sha256:",
                                     std::string(64, 'b'),
                                     "\n"
                                     "agent            sensor base: version \\x1b]0;old\\x07 (the "
                                     "server's is 0.1.0), heard 2 d ago\n"
                                     "agent            actuator base: not heard since the server's "
                                     "start\n"
                                     "degraded         sensor base lost\n"
                                     "degraded         \\x1b[2Jactuator\n"));
  EXPECT_EQ(RunJson({"robot", "show", "r1"})["decided_level"], "COMPROMISED");
  const Result missing = Run({"robot", "show", "r3"});
  EXPECT_EQ(missing.code, 1);
  EXPECT_EQ(missing.err, "error: robot `r3` is not in the inventory; see `ripsctl robot list`\n");
}

TEST_F(RipsctlTest, ShowsTheGraph) {
  const nlohmann::json json = RunJson({"robot", "graph", "r1"});
  EXPECT_EQ(json["nodes"].size(), 3u);
  EXPECT_EQ(json["unattributed"].size(), 2u);
  const Result text = Run({"robot", "graph", "r1"});
  EXPECT_EQ(text.code, 0);
  EXPECT_THAT(text.out, testing::StartsWith("changed 2026-01-01T00:00:00.000Z\n\nNODE "));
  fake_.graph_left_out = 12;
  EXPECT_EQ(RunJson({"robot", "graph", "r1"})["left_out"], 12);
  EXPECT_THAT(Run({"robot", "graph", "r1"}).out,
              testing::EndsWith("12 endpoints, nodes and participants do not fit into one "
                                "response\n"));
}

TEST_F(RipsctlTest, ShowsTheSettingsInForce) {
  EXPECT_THAT(Run({"robot", "config", "r1"}).out, HasSubstr("inventory of the policy server\n"));
}

TEST_F(RipsctlTest, ShowsTheLevel) {
  const Result text = Run({"level", "show", "r1"});
  EXPECT_EQ(text.code, 0);
  EXPECT_EQ(text.out,
            "robot            r1\n"
            "decided level    COMPROMISED\n"
            "effective level  COMPROMISED\n"
            "stage            verified\n"
            "decision         3.17\n"
            "levels           DEFAULT < ALERT (soft) < COMPROMISED\n"
            "last change      2026-01-01T00:00:00.000Z ALERT -> COMPROMISED, rule rogue_cmd_vel\n"
            "reason           -\n"
            "detail           -\n");
  const nlohmann::json json = RunJson({"level", "show", "r1"});
  EXPECT_EQ(json["status"]["decision_id"], "3.17");
  EXPECT_EQ(json["levels"][1],
            nlohmann::json({{"name", "ALERT"}, {"soft", true}, {"two_person", false}}));
  EXPECT_EQ(json["last"]["time"], "2026-01-01T00:00:00.000000005Z");
}

TEST_F(RipsctlTest, ListsTheHistory) {
  const Result text = Run({"level", "history", "r1", "--limit", "7"});
  EXPECT_EQ(text.code, 0);
  EXPECT_EQ(text.out,
            "TIME                      FROM   TO           DECISION  STAGE\n"
            "    ID        CAUSE: REASON\n"
            "2026-01-01T00:00:00.000Z  ALERT  COMPROMISED  3.17      verified\n"
            "    11111111  rule rogue_cmd_vel\n"
            "2026-01-01T00:00:00.000Z  ALERT  COMPROMISED  -         refused x7\n"
            "    11111111  rule rogue_cmd_vel: needs an operator\n");
  const nlohmann::json list = RunJson({"level", "history", "r1"})["transitions"];
  ASSERT_THAT(list, SizeIs(2));
  EXPECT_EQ(list[0]["decision_id"], "3.17");
  EXPECT_TRUE(list[1]["decision_id"].is_null());
  EXPECT_EQ(list[1]["count"], 100);
  EXPECT_EQ(Run({"level", "history", "r1", "--limit", "1001"}).code, 2);
  EXPECT_EQ(Run({"level", "history", "r1", "--limit", "0"}).code, 2);
}

TEST_F(RipsctlTest, LowersWithWhatItReadAndShowed) {
  fake_.level_response.add_would_raise_again("unknown_node");
  const Result result =
      Run({"level", "lower", "r1", "--to", "DEFAULT", "--reason", "intruder unplugged"});
  EXPECT_EQ(result.code, 0);
  EXPECT_EQ(
      result.out,
      "r1 is at COMPROMISED (3.17) since 2026-01-01T00:00:00.000Z, rule rogue_cmd_vel\n"
      "r1 goes to DEFAULT (3.18)\n"
      "may be raised again by rule unknown_node at the next change of the graph, not before\n");
  EXPECT_THAT(fake_.calls(), testing::ElementsAre("GetLevel", "ListReceipts r1", "DeEscalate"));
  const v1::LevelRequest request = fake_.last_level_request();
  EXPECT_EQ(request.expected_level(), "COMPROMISED");
  EXPECT_EQ(request.expected_decision_id().term(), 3u);
  EXPECT_EQ(request.expected_decision_id().epoch(), 17u);
  EXPECT_EQ(request.reason(), "intruder unplugged");
  EXPECT_EQ(request.request_id().size(), 16u);
  EXPECT_FALSE(request.accept_blind());
  EXPECT_FALSE(request.dry_run());
}

TEST_F(RipsctlTest, WaitsUntilTheRobotIsAtTheLevel) {
  const auto at = [](const std::string& stage, uint64_t epoch) {
    v1::RobotStatus status = MakeStatus("r1", "DEFAULT");
    status.set_stage(stage);
    if (stage == "failed") status.add_degraded("level not reached: /base does not answer");
    *status.mutable_decision_id() = MakeDecisionId(3, epoch);
    return status;
  };
  const std::vector<std::string> lower = {
      "level", "lower", "r1", "--to", "DEFAULT", "--reason", "x", "--expect", "COMPROMISED@3.17",
      "--wait"};
  // What failed is tried again.
  fake_.level_states = {at("requested", 18), at("failed", 18), at("verified", 18)};
  const Result reached = Run(lower);
  EXPECT_EQ(reached.code, 0) << reached.err;
  EXPECT_EQ(reached.out,
            "r1 goes to DEFAULT (3.18)\n"
            "waiting for the robot to reach it, for at most 30s; Ctrl-C stops the wait, not the "
            "decision\n"
            "r1 is at DEFAULT: every actuator has read it back\n");
  fake_.level_states[0].add_degraded("a second process uses the key of actuator base");
  EXPECT_THAT(Run(lower).out,
              testing::EndsWith("every actuator has read it back\n"
                                "degraded: a second process uses the key of actuator base\n"));
  EXPECT_THAT(fake_.calls(), testing::ElementsAre("DeEscalate", "GetLevel", "GetLevel", "GetLevel",
                                                  "DeEscalate", "GetLevel"));
  fake_.level_states = {at("requested", 18), at("verified", 19)};
  const Result overtaken = Run(lower);
  EXPECT_EQ(overtaken.code, 1);
  EXPECT_THAT(overtaken.out,
              HasSubstr("r1 is not at DEFAULT: a newer decision has replaced this one: "
                        "DEFAULT (3.19)\n"))
      << "what is recorded is an older decision";
  fake_.level_states = {at("verified", 17)};
  EXPECT_THAT(Run(lower).out, HasSubstr("this one: DEFAULT (3.17), rule rogue_cmd_vel\n"));
  fake_.level_states = {at("verified", 18)};
  EXPECT_EQ(RunJson(lower)["reached"], true);
  fake_.level_states = {at("verified", 19)};
  const nlohmann::json missed = RunJson(lower, 1);
  EXPECT_EQ(missed["reached"], false);
  EXPECT_THAT(missed["not_reached_because"].get<std::string>(), HasSubstr("a newer decision"));
}

TEST_F(RipsctlTest, LowersWithWhatTheOperatorExpects) {
  const nlohmann::json json = RunJson({"level", "lower", "r1", "--to", "ALERT", "--reason", "x",
                                       "--expect", "COMPROMISED@2.9", "--accept-blind"});
  EXPECT_EQ(json, nlohmann::json({{"robot", "r1"},
                                  {"to", "ALERT"},
                                  {"dry_run", false},
                                  {"decided_level", "ALERT"},
                                  {"needs_approval", false},
                                  {"soft", false},
                                  {"decision_id", "3.18"},
                                  {"expected", "COMPROMISED@2.9"},
                                  {"would_raise_again", nlohmann::json::array()},
                                  {"blind_because", nlohmann::json::array()}}));
  EXPECT_THAT(fake_.calls(), testing::ElementsAre("DeEscalate")) << "nothing is read first";
  EXPECT_EQ(fake_.last_level_request().expected_decision_id().epoch(), 9u);
  EXPECT_TRUE(fake_.last_level_request().accept_blind());
}

TEST_F(RipsctlTest, ADryRunSaysWhatWouldHappen) {
  fake_.level_response.add_would_raise_again("unknown_node");
  fake_.level_response.add_blind_because("sensor base lost");
  const Result result =
      Run({"level", "lower", "r1", "--to", "DEFAULT", "--reason", "x", "--dry-run"});
  EXPECT_EQ(result.code, 1);
  EXPECT_TRUE(fake_.last_level_request().dry_run());
  EXPECT_THAT(
      result.out,
      HasSubstr(
          "nothing was changed\n"
          "blind: sensor base lost\n"
          "would be refused, because RIPS does not see all of r1 now; "
          "--accept-blind lowers it all the same\n"
          "would be raised again by rule unknown_node at the next change of the graph, not before\n"
          "not tried: rules on messages and on external events; the next of those may raise r1 "
          "again\n"));
  EXPECT_THAT(result.out, testing::Not(HasSubstr("would lower")));

  const Result accepted = Run(
      {"level", "lower", "r1", "--to", "DEFAULT", "--reason", "x", "--dry-run", "--accept-blind"});
  EXPECT_EQ(accepted.code, 0);
  EXPECT_THAT(accepted.out, HasSubstr("would lower r1 to DEFAULT; nothing was changed\n"
                                      "blind: sensor base lost\n"));
}

TEST_F(RipsctlTest, ARaiseToASoftLevelSaysThatRulesMayLowerIt) {
  fake_.level_response.set_soft(true);
  const Result result = Run({"level", "raise", "r1", "--to", "HALT", "--reason", "smoke"});
  EXPECT_EQ(result.out,
            "r1 goes to HALT (3.18)\n"
            "HALT is a soft level: a rule may lower it again as soon as its condition holds\n");
  EXPECT_EQ(RunJson({"level", "raise", "r1", "--to", "HALT", "--reason", "smoke"})["soft"], true);
}

TEST_F(RipsctlTest, Raises) {
  const Result result = Run({"level", "raise", "r1", "--to", "HALT", "--reason", "smoke"});
  EXPECT_EQ(result.code, 0);
  EXPECT_EQ(result.out, "r1 goes to HALT (3.18)\n");
  EXPECT_THAT(fake_.calls(), testing::ElementsAre("Raise"));
  EXPECT_EQ(RunJson({"level", "raise", "r1", "--to", "HALT", "--reason", "smoke"})["decision_id"],
            "3.18");
}

TEST_F(RipsctlTest, ARefusalIsExitCodeOne) {
  fake_.failure = grpc::Status(grpc::StatusCode::FAILED_PRECONDITION,
                               "robot r1 is at HALT (3.19), not COMPROMISED (3.17)\x1b[1m");
  const Result result = Run(
      {"level", "lower", "r1", "--to", "DEFAULT", "--reason", "x", "--expect", "COMPROMISED@3.17"});
  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.out, "");
  EXPECT_EQ(result.err, "error: robot r1 is at HALT (3.19), not COMPROMISED (3.17)\\x1b[1m\n");
  fake_.failure = grpc::Status(grpc::StatusCode::PERMISSION_DENIED, "alice is a viewer");
  const Result denied = Run({"level", "raise", "r1", "--to", "HALT", "--reason", "x"});
  EXPECT_EQ(denied.code, 1);
  EXPECT_EQ(denied.err, "error: refused: alice is a viewer\n");
}

TEST_F(RipsctlHelpTest, EveryVerbThatItNamesPassesOnRefusals) {
  fake_.failure = grpc::Status(grpc::StatusCode::NOT_FOUND, "no such robot");
  const std::vector<Args> all = ServerVerbs(directory_);
  std::vector<Args> tried = all;
  for (const Args& args : OfflineVerbs(directory_)) tried.push_back(args);
  ExpectEveryVerb(Pages(), tried);
  for (const Args& args : all) {
    const Result result = Run(args);
    EXPECT_EQ(result.code, 1) << args[0] << " " << args[1];
    EXPECT_EQ(result.err, "error: no such robot\n") << args[0] << " " << args[1];
  }
}

TEST_F(RipsctlTest, WrongFlagsAreExitCodeTwoAndCallNobody) {
  const std::string long_reason(1'001, 'x');
  const std::vector<std::vector<std::string>> all = {
      {},
      {"robot"},
      {"robot", "dance"},
      {"robot", "show"},
      {"robot", "show", "R_1"},
      {"robot", "show", "r1", "r2"},
      {"robot", "watch", "../r1"},
      {"alert", "list", "R"},
      {"alert", "list", "--severity", "grave"},
      {"alert", "list", "--severity", "HIGH"},
      {"alert", "list", "--rule", std::string(256, 'x')},
      {"alert", "list", "--rule", "\xff"},
      {"alert", "list", "--since", "2"},
      {"alert", "list", "--since", "0ms"},
      {"alert", "list", "--since", "-2h"},
      {"alert", "ack"},
      {"alert", "ack", "\xff"},
      {"alert", "ack", "333333", "--note", long_reason},
      {"alert", "ack", "333333", "--note", "\xff"},
      {"level", "lower", "r1"},
      {"level", "lower", "r1", "--to", "A"},
      {"level", "lower", "r1", "--to", "A", "--reason", "  "},
      {"level", "lower", "r1", "--to", "A", "--reason", long_reason},
      {"level", "lower", "r1", "--to", "A", "--reason", "\xff"},
      {"level", "lower", "r1", "--to", "\xff", "--reason", "x"},
      {"level", "lower", "r1", "--to", "A", "--reason", "x", "--expect", "COMPROMISED"},
      {"level", "lower", "r1", "--to", "A", "--reason", "x", "--expect", "@3.17"},
      {"level", "lower", "r1", "--to", "A", "--reason", "x", "--expect", "C@3"},
      {"level", "lower", "r1", "--to", "A", "--reason", "x", "--expect", "C@3.x"},
      {"rules", "resume", "r1"},
      {"rules", "check"},
      {"rules", "check", "/does/not/exist.rul"},
      {"rules", "check", "--dialect", "other", "x"},
      {"robot", "list", "--output", "xml"},
      {"robot", "list", "--timeout", "10"},
      {"robot", "list", "--timeout", "0s"},
      {"robot", "list", "--server", "nowhere"},
      {"robot", "list", "--no-such-flag"},
      {"robot", "list", "--label", "ring=\xff"},
      {"agent", "ban", "spiffe://td/operator/\xff", "--reason", "x"},
  };
  for (const auto& args : all) {
    const Result result = Run(args);
    EXPECT_EQ(result.code, 2) << testing::PrintToString(args) << result.out;
    EXPECT_NE(result.err, "") << testing::PrintToString(args);
  }
  EXPECT_THAT(fake_.calls(), SizeIs(0));
  EXPECT_EQ(Run({"agent", "ban", "spiffe://td/operator/\xff", "--reason", "x"}).err,
            "error: argument `spiffe://td/operator/\\xff` is not UTF-8; the server takes no other "
            "text, so use a terminal whose locale is UTF-8\n");
  EXPECT_EQ(Run({"level", "lower", "r1", "--to", "A", "--reason", "x", "--expect", "C@3"}).err,
            "error: --expect is `C@3`; write LEVEL@TERM.EPOCH, for example COMPROMISED@3.17\n");
}

TEST_F(RipsctlTest, RobotsThatDidNotAnswerAreNotLeftOut) {
  fake_.no_answer = {"r3"};
  const Result list = Run({"robot", "list"});
  EXPECT_EQ(list.code, 1);
  EXPECT_THAT(list.out, HasSubstr("no response in time"));
  const Result json = Run({"robot", "list", "--output", "json"});
  EXPECT_EQ(nlohmann::json::parse(json.out)["no_answer"], nlohmann::json({"r3"}));
  const Result show = Run({"robot", "show", "r3"});
  EXPECT_EQ(show.code, 1);
  EXPECT_THAT(show.err, HasSubstr("did not respond in time"));
}

TEST_F(RipsctlTest, ResumesRules) {
  EXPECT_EQ(Run({"rules", "resume", "r1", "--reason", "seen to"}).out,
            "rules of r1 may lower soft levels again\n");
  EXPECT_EQ(RunJson({"rules", "resume", "r1", "--reason", "seen to"}),
            nlohmann::json({{"robot", "r1"}, {"resumed", true}}));
  EXPECT_EQ(fake_.calls()[0], "ResumeRules r1 seen to");
}

TEST_F(RipsctlTest, SendsSignals) {
  EXPECT_EQ(Run({"signal", "send", "r1", "SIGUSR1", "--reason", "stop"}).out,
            "the rules of r1 judged SIGUSR1; its level: HALT, before: DEFAULT\n");
  EXPECT_EQ(Run({"signal", "send", "r1", "USR2", "--reason", "go"}).out,
            "the rules of r1 judged SIGUSR2; its level is DEFAULT, as before\n");
  EXPECT_EQ(RunJson({"signal", "send", "r1", "usr1", "--reason", "stop"}),
            nlohmann::json({{"robot", "r1"},
                            {"signal", "SIGUSR1"},
                            {"level_before", "DEFAULT"},
                            {"decided_level", "HALT"}}));
  EXPECT_THAT(fake_.calls(),
              testing::ElementsAre("SendSignal r1 SIGUSR1 stop", "SendSignal r1 SIGUSR2 go",
                                   "SendSignal r1 SIGUSR1 stop"));
  const Result wrong = Run({"signal", "send", "r1", "SIGKILL", "--reason", "stop"});
  EXPECT_EQ(wrong.code, 2);
  EXPECT_THAT(wrong.err, HasSubstr("`SIGKILL` is neither SIGUSR1 nor SIGUSR2"));
}

TEST_F(RipsctlTest, ListsAgentsAndBans) {
  const Result listed = Run({"agent", "list"});
  EXPECT_EQ(listed.code, 0);
  EXPECT_THAT(listed.out, AllOf(HasSubstr("spiffe://td/robot/r1/sensor/base  0f"),
                                HasSubstr("spiffe://td/robot/r2/sensor/base  all"),
                                HasSubstr("stolen"), Not(HasSubstr("\x1b"))));
  EXPECT_EQ(RunJson({"agent", "list"})["agents"][0],
            nlohmann::json({{"uri", "spiffe://td/robot/r1/sensor/base"},
                            {"serial", "0f"},
                            {"not_after", "2026-01-01T00:00:00.000000000Z"}}));
}

TEST_F(RipsctlTest, ResetsATerm) {
  EXPECT_EQ(Run({"agent", "reset-term", "r1", "base", "--reason", "disk replaced"}).out,
            "r1 stays at ALERT by decision 2000000.8; actuator base is armed when it connects "
            "next, within 60 s\n");
  EXPECT_EQ(fake_.calls()[0], "ResetTerm r1 base disk replaced");
  EXPECT_EQ(Run({"agent", "reset-term", "r1", "base"}).code, 2);
  EXPECT_EQ(Run({"agent", "reset-term", "r1", "base", "--reason", " "}).code, 2);
  fake_.failure = grpc::Status(grpc::StatusCode::FAILED_PRECONDITION, "nothing to reset");
  EXPECT_EQ(Run({"agent", "reset-term", "r1", "base", "--reason", "x"}).code, 1);
}

TEST_F(RipsctlTest, BansAndUnbans) {
  const std::string uri = "spiffe://td/robot/r1/sensor/base";
  EXPECT_EQ(Run({"agent", "ban", uri, "--serial", "00AF", "--reason", "stolen"}).out,
            uri + " banned\n");
  EXPECT_EQ(Run({"agent", "unban", uri}).out, uri + " unbanned\n");
  EXPECT_THAT(fake_.calls(), testing::ElementsAre(absl::StrCat("Ban ", uri, " af stolen"),
                                                  "ListAgents", absl::StrCat("Unban ", uri, " ")));
  EXPECT_THAT(Run({"agent", "ban", uri + "s", "--reason", "stolen"}).out,
              HasSubstr("bases banned\nno certificate of this identity was seen"));
  EXPECT_EQ(Run({"agent", "ban", uri}).code, 2);
  EXPECT_EQ(Run({"agent", "ban", uri, "--reason", " "}).code, 2);
  fake_.failure = grpc::Status(grpc::StatusCode::PERMISSION_DENIED, "needs the role `admin`");
  EXPECT_EQ(Run({"agent", "ban", uri, "--reason", "stolen"}).code, 1);
}

TEST_F(RipsctlTest, ChecksRulesWithoutAServer) {
  server_->Shutdown();
  const std::string good = File("good.rul",
                                "levels:\n  DEFAULT;\n  HALT;\nrules Graph:\n"
                                "  r: !nodes(\"/talker\") ? alert(\"x\") => trigger(HALT);\n");
  const Result ok = Run({"rules", "check", good});
  EXPECT_EQ(ok.code, 0) << ok.out;
  EXPECT_EQ(ok.out, "ok: 1 rules, 2 levels\n");
  EXPECT_EQ(RunJson({"rules", "check", good})["files"][0]["ok"], true);

  const std::string bad = File("bad.rul", "rules Graph:\n  nodes(\"/a\") ? trigger(GONE);\n");
  const Result findings = Run({"rules", "check", good, bad});
  EXPECT_EQ(findings.code, 1);
  EXPECT_THAT(findings.out, AllOf(HasSubstr(absl::StrCat(bad, ":2:")), HasSubstr("error: "),
                                  HasSubstr("GONE"), Not(HasSubstr("ok:"))));
  const nlohmann::json json = RunJson({"rules", "check", good, bad}, 1);
  EXPECT_EQ(json["files"][1]["ok"], false);
  EXPECT_EQ(json["files"][1]["diagnostics"][0]["line"], 2);
  EXPECT_THAT(fake_.calls(), SizeIs(0));
}

TEST_F(RipsctlTest, AnAbsentServerIsExitCodeThree) {
  server_->Shutdown();
  const Result result = Run({"robot", "list", "--timeout", "5s"});
  EXPECT_EQ(result.code, 3);
  EXPECT_THAT(result.err, StartsWith("error: cannot reach the policy server: "));
  EXPECT_EQ(Run({"robot", "watch"}).code, 3);
}

TEST_F(RipsctlTest, TakesSettingsFromEveryPlace) {
  std::filesystem::create_directories(home_ + "/.config/rips");
  File(".config/rips/ripsctl.yaml", "server: file.example:1\noutput: json\nca: /f/ca.pem\n");
  env_["RIPSCTL_SERVER"] = "env.example:2";
  EXPECT_THAT(Run({"robot", "list"}).out, StartsWith("{\"robots\":"));
  EXPECT_EQ(used_.server, "env.example:2");
  EXPECT_EQ(used_.ca, "/f/ca.pem");
  EXPECT_THAT(Run({"robot", "list", "--server", "flag.example:3", "--output", "text"}).out,
              StartsWith("ROBOT"));
  EXPECT_EQ(used_.server, "flag.example:3");

  File(".config/rips/ripsctl.yaml", "servr: x\n");
  const Result bad = Run({"robot", "list"});
  EXPECT_EQ(bad.code, 2);
  EXPECT_THAT(bad.err, HasSubstr("unknown key `servr`"));
}

TEST_F(RipsctlTest, SpeaksMutualTls) {
  tls_ = true;
  rpc::TestPki pki;
  const auto credentials = rpc::Credentials::Load(pki.Server());
  ASSERT_THAT(credentials, IsOk());
  FakeOperator service;
  auto server = rpc::RpcServer::Start(
      {.listen = "127.0.0.1:0", .credentials = (*credentials)->ForServer()}, {&service});
  ASSERT_THAT(server, IsOk());

  const auto with = [&](const TlsFiles& files) {
    return Run({"robot", "list", "--server", (*server)->address(), "--ca", files.ca, "--cert",
                files.cert, "--key", files.key});
  };
  const Result good = with(pki.Operator("viewer", "vera"));
  EXPECT_EQ(good.code, 0) << good.err;
  EXPECT_THAT(good.out, StartsWith("ROBOT"));

  rpc::TestPki foreign;
  EXPECT_EQ(with(foreign.Operator()).code, 3);
  const Result no_file = Run({"robot", "list", "--server", (*server)->address(), "--ca", "/none",
                              "--cert", "/none", "--key", "/none"});
  EXPECT_EQ(no_file.code, 2);
  const Result no_flags = Run({"robot", "list"});
  EXPECT_EQ(no_flags.code, 2);
  EXPECT_THAT(no_flags.err, HasSubstr("--ca is missing; give --ca, --cert and --key"));
}

// Its watches do not end by themselves.
class EndlessOperator final : public v1::OperatorService::Service {
 public:
  grpc::Status WatchRobots(grpc::ServerContext* context, const v1::WatchRobotsRequest*,
                           grpc::ServerWriter<v1::RobotStatus>* writer) override {
    writer->Write(MakeStatus("r1", "ALERT"));
    return UntilCancelled(*context);
  }
  grpc::Status WatchAlerts(grpc::ServerContext* context, const v1::WatchAlertsRequest*,
                           grpc::ServerWriter<v1::Alert>* writer) override {
    writer->Write(v1::Alert());
    return UntilCancelled(*context);
  }

 private:
  static grpc::Status UntilCancelled(const grpc::ServerContext& context) {
    const absl::Time limit = absl::Now() + absl::Seconds(20);
    while (!context.IsCancelled() && absl::Now() < limit) absl::SleepFor(absl::Milliseconds(10));
    return grpc::Status(grpc::StatusCode::PERMISSION_DENIED, "it watched until the limit");
  }
};

TEST_F(RipsctlTest, AWatchEndsWhenTheServersCertificateExpires) {
  tls_ = true;
  rpc::TestPki pki;
  const TlsFiles viewer = pki.Operator("viewer", "vera");
  for (const std::string noun : {"robot", "alert"}) {
    const TlsFiles brief = pki.Mint({.folder = "brief-" + noun,
                                     .san = "URI:spiffe://fleet.example/policy-server/ps1",
                                     .age_seconds = 86'400 - 4});
    const auto credentials = rpc::Credentials::Load(brief);
    ASSERT_THAT(credentials, IsOk());
    EndlessOperator service;
    auto server = rpc::RpcServer::Start(
        {.listen = "127.0.0.1:0", .credentials = (*credentials)->ForServer()}, {&service});
    ASSERT_THAT(server, IsOk());

    const Result watch = Run({noun, "watch", "--server", (*server)->address(), "--ca", viewer.ca,
                              "--cert", viewer.cert, "--key", viewer.key});

    EXPECT_NE(watch.code, 0);
    EXPECT_THAT(watch.err, HasSubstr("the policy server: the certificate has expired")) << noun;
  }
}

TEST_F(RipsctlHelpTest, IsAsPinned) {
  const std::string path =
      std::string(RIPS_SOURCE_DIR) + "/policy_server/ripsctl/testdata/help.txt";
  std::string actual;
  for (std::vector<std::string> args : Pages()) {
    args.push_back("--help");
    const Result result = Run(args);
    EXPECT_EQ(result.code, 0);
    absl::StrAppend(&actual, "$ ripsctl ", absl::StrJoin(args, " "), "\n", result.out);
  }
  if (std::getenv("RIPS_UPDATE_GOLDENS") != nullptr) std::ofstream(path) << actual;
  std::ifstream file(path);
  std::ostringstream pinned;
  pinned << file.rdbuf();
  EXPECT_EQ(actual, pinned.str()) << "RIPS_UPDATE_GOLDENS=1 rewrites " << path;
}

TEST_F(RipsctlTest, AVerbThatIsNoneIsNamed) {
  const Result slip = Run({"rules", "chek", "r.rul"});
  EXPECT_EQ(slip.code, 2);
  EXPECT_EQ(slip.err, "error: `rules` has no `chek`; did you mean `check`?\n");
  const Result other = Run({"level", "nonsense"});
  EXPECT_EQ(other.err,
            "error: `level` has no `nonsense`; it has show, history, raise, lower, approve\n");
}

TEST_F(RipsctlTest, RecordsIntoANewFile) {
  const std::string path = home_ + "/r1.rips";
  const Result first = Run({"record", "r1", "--out", path});
  EXPECT_EQ(first.code, 0) << first.err;
  EXPECT_EQ(first.out, absl::StrCat("2 events of r1 in ", path, "\n"));
  EXPECT_EQ(std::filesystem::status(path).permissions(),
            std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  const Result again = Run({"record", "r1", "--out", path});
  EXPECT_EQ(again.code, 2);
  EXPECT_THAT(again.err, HasSubstr("is there already"));
  EXPECT_EQ(Run({"record", "r1", "--out", path, "--force"}).code, 0);
  EXPECT_EQ(Run({"record", "r1", "--out", path, "--force", "--for", "soon"}).code, 2);

  const std::string rules = home_ + "/r.rul";
  std::ofstream(rules) << "levels: A; rules External: signal(\"SIGUSR1\") ? alert(\"seen\");";
  const Result replayed = Run({"rules", "replay", "--rules", rules, "--events", path});
  EXPECT_EQ(replayed.code, 0) << replayed.err;
  EXPECT_THAT(replayed.out, HasSubstr("seen"));
}

TEST_F(RipsctlTest, FetchesTheRecordingOfAnAlertAndSaysHowToReplayIt) {
  const std::string path = home_ + "/alert.rips";
  const Result first = Run({"alert", "recording", "11111111", "--out", path});
  EXPECT_EQ(first.code, 0) << first.err;
  EXPECT_EQ(
      first.out,
      absl::StrCat("1 events in 1.5s of r1 from 2026-01-01T00:00:00.000Z on, at ALERT, in ", path,
                   "\nwith alert 11111111, rogue: who drives\\x1b[1m?\n"
                   "what the rules did with them, with the directory of the robot's bundle "
                   "(sha256:01234567):\n  ripsctl rules replay --rules BUNDLE --events ",
                   path, "\n"));
  EXPECT_EQ(fake_.calls().back(), "GetAlertRecording 11111111");
  EXPECT_EQ(Run({"alert", "recording", "11111111", "--out", path}).code, 2) << "is there already";
  const auto json = RunJson({"alert", "recording", "11111111", "--out", path, "--force"});
  EXPECT_EQ(json["alerts"][0]["id"], std::string(32, '1'));
  EXPECT_EQ(json["end"], "2026-01-01T00:00:01.500000000Z");
  EXPECT_EQ(json["events"], 1);

  // What came is checked, and what is not whole does not stay.
  for (const bool cut : {true, false}) {
    fake_.alert_recording = MakeAlertRecording();
    if (cut) fake_.alert_recording.pop_back();
    if (!cut) fake_.alert_recording[20] ^= 1;
    const Result torn = Run({"alert", "recording", "11111111", "--out", home_ + "/torn.rips"});
    EXPECT_EQ(torn.code, 1);
    EXPECT_THAT(torn.err, HasSubstr(cut ? "cut within a frame" : "checksum"));
    EXPECT_FALSE(std::filesystem::exists(home_ + "/torn.rips"));
  }

  fake_.failure = grpc::Status(grpc::StatusCode::NOT_FOUND, "no recording is kept of it");
  const Result none = Run({"alert", "recording", "2", "--out", home_ + "/none.rips"});
  EXPECT_EQ(none.code, 1);
  EXPECT_THAT(none.err, HasSubstr("no recording is kept of it"));
  EXPECT_FALSE(std::filesystem::exists(home_ + "/none.rips"));
}

TEST_F(RipsctlTest, ARefusedRecordingSaysWhy) {
  fake_.failure = grpc::Status(grpc::StatusCode::NOT_FOUND, "no robot `r2`");
  const Result result = Run({"record", "r2", "--out", home_ + "/r2.rips"});
  EXPECT_EQ(result.code, 1);
  EXPECT_THAT(result.err, HasSubstr("no robot `r2`"));
  EXPECT_FALSE(std::filesystem::exists(home_ + "/r2.rips"));

  // Nor does it take the place of an earlier recording.
  const std::string kept = home_ + "/kept.rips";
  std::ofstream(kept) << "earlier";
  EXPECT_EQ(Run({"record", "r2", "--out", kept, "--force"}).code, 1);
  EXPECT_EQ(std::filesystem::file_size(kept), 7u);
}

}  // namespace
}  // namespace rips::ripsctl

// `ripsctl explain` against the server of the fixture.

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::StartsWith;

class ExplainTest : public RipsctlTest {
 protected:
  ExplainTest() {
    v1::ExplainResponse decision;
    *decision.mutable_transition() = MakeTransition();
    *decision.mutable_evidence() = MakeEvidence();
    fake_.explained["11111111"] = decision;
    fake_.explained[std::string(32, '1')] = decision;
    fake_.explained["r1@3.17"] = decision;
    *fake_.explained[std::string(32, '2')].mutable_alert() = MakeAlert("rogue driver");
  }
};

constexpr char kFirstWords[] = "r1 went from ALERT to COMPROMISED at ";

TEST_F(ExplainTest, ALevelChangeByTheStartOfItsId) {
  fake_.level_response.add_would_raise_again("rogue_cmd_vel");
  const Result result = Run({"explain", "11111111"});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_THAT(result.out, StartsWith(kFirstWords));
  EXPECT_THAT(result.out, AllOf(HasSubstr("Why: rule rogue_cmd_vel, warehouse.rul:31"),
                                HasSubstr("would be raised again by rule rogue_cmd_vel"
                                          " at the next change of the graph, not before\n")));
  EXPECT_THAT(fake_.calls(), ElementsAre("Explain 11111111", "GetLevel", "GetFindings r1",
                                         "ListTransitions", "GetGraph", "DeEscalate"));
  const v1::LevelRequest asked = fake_.last_level_request();
  EXPECT_TRUE(asked.dry_run());
  EXPECT_FALSE(asked.accept_blind());
  EXPECT_EQ(asked.to(), "DEFAULT") << "the lowest";
  EXPECT_EQ(asked.expected_level(), "COMPROMISED");
  EXPECT_EQ(asked.expected_decision_id().epoch(), 17u);
  EXPECT_EQ(asked.request_id().size(), 16u);
  EXPECT_NE(asked.reason(), "");
}

TEST_F(ExplainTest, AnAlertByItsId) {
  const Result result = Run({"explain", std::string(32, '2')});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_THAT(result.out, StartsWith("r1: high alert at "));
}

TEST_F(ExplainTest, ALoweringLeadsToWhatHadRaisedTheRobot) {
  const auto lowered = [](char digit, const char* from, const char* to) {
    v1::Transition transition = MakeTransition();
    transition.set_id(std::string(32, digit));
    transition.set_from(from);
    transition.set_to(to);
    transition.set_cause("operator carol");
    return transition;
  };
  fake_.newer_transitions = {lowered('5', "ALERT", "DEFAULT"),
                             lowered('4', "COMPROMISED", "ALERT")};
  for (const v1::Transition& each : fake_.newer_transitions) {
    *fake_.explained[each.id()].mutable_transition() = each;
    const std::string text = Run({"explain", each.id()}).out;
    EXPECT_THAT(text, HasSubstr("before that, r1 went from ALERT to COMPROMISED at "));
    EXPECT_THAT(text, HasSubstr("\n  who: /intruder at 10.0.0.66\n  why: ripsctl explain "
                                "11111111\n"));
    EXPECT_EQ(RunJson({"explain", each.id()})["raised_before_subjects"][0]["name"], "/intruder");
    EXPECT_EQ(RunJson({"explain", each.id()})["raised_before_by"]["id"], std::string(32, '1'));
  }
  EXPECT_THAT(Run({"explain", std::string(32, '5')}).out,
              HasSubstr("\nbefore that, r1 went from COMPROMISED to ALERT at "));
  EXPECT_TRUE(RunJson({"explain", "11111111"})["raised_before_by"].is_null())
      << "there is no older one";
}

TEST_F(ExplainTest, TheDecisionThatARobotIsAt) {
  EXPECT_THAT(Run({"explain", "r1"}).out, StartsWith(kFirstWords));
  EXPECT_THAT(fake_.calls(), ElementsAre("GetLevel", "Explain r1@3.17", "GetFindings r1",
                                         "ListTransitions", "GetGraph", "DeEscalate"));
}

TEST_F(ExplainTest, ADecisionByItsDecisionId) {
  EXPECT_THAT(Run({"explain", "r1@3.17"}).out, StartsWith(kFirstWords));
  EXPECT_THAT(fake_.calls(), ElementsAre("Explain r1@3.17", "GetLevel", "GetFindings r1",
                                         "ListTransitions", "GetGraph", "DeEscalate"));
  const Result gone = Run({"explain", "r1@3.2"});
  EXPECT_EQ(gone.code, 1);
  EXPECT_EQ(gone.err, "error: there is no record of it\n");
}

TEST_F(ExplainTest, ARobotWhoseNameIsHex) {
  fake_.explained["cafe42@3.17"] = fake_.explained["r1@3.17"];
  EXPECT_THAT(Run({"explain", "cafe42"}).out, StartsWith(kFirstWords));
  EXPECT_THAT(fake_.calls(),
              ElementsAre("Explain cafe42", "GetLevel", "Explain cafe42@3.17", "GetFindings cafe42",
                          "ListTransitions", "GetGraph", "DeEscalate"));
  fake_.unknown_robots = {"cafe42", "r7"};
  const Result neither = Run({"explain", "cafe42"});
  EXPECT_EQ(neither.code, 1);
  EXPECT_EQ(neither.err,
            "error: no alert or level change that is kept, and no robot is `cafe42`; see `ripsctl "
            "alert list`, `ripsctl level history ROBOT` and `ripsctl robot list`\n");
  const Result robot = Run({"explain", "r7"});
  EXPECT_EQ(robot.code, 1);
  EXPECT_EQ(robot.err, "error: no robot `r7`\n");
}

TEST_F(ExplainTest, ARobotForWhichNothingWasDecided) {
  v1::RobotStatus fresh = MakeStatus("r1", "DEFAULT");
  fresh.clear_decision_id();
  fake_.level_states = {fresh};
  const Result result = Run({"explain", "r1"});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_EQ(result.out,
            "nothing was ever decided for r1: it is where it began\n"
            "\n"
            "Findings: none stands\n"
            "\n"
            "Now: r1 is at DEFAULT, verified: every actuator has read the level back\n");
  EXPECT_THAT(fake_.calls(), ElementsAre("GetLevel", "GetFindings r1"))
      << "nothing is below the lowest level";
  const nlohmann::json json = RunJson({"explain", "r1"});
  EXPECT_TRUE(json["transition"].is_null());
  EXPECT_TRUE(json["lowering"].is_null());
  EXPECT_FALSE(json.contains("no_evidence_because"));
}

TEST_F(ExplainTest, ADecisionWithoutRecordIsSaid) {
  fake_.explained.clear();
  const Result result = Run({"explain", "r1"});
  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.err,
            "error: r1 is at COMPROMISED by decision 3.17, and the server has no record of that: "
            "there is no record of it\n");
}

TEST_F(ExplainTest, AnAmbiguousIdIsRefused) {
  fake_.explain_failure = {grpc::StatusCode::INVALID_ARGUMENT, "2 ids begin with `111111`"};
  const Result result = Run({"explain", "111111"});
  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.err, "error: 2 ids begin with `111111`\n");
  EXPECT_THAT(fake_.calls(), ElementsAre("Explain 111111"));
}

TEST_F(ExplainTest, AViewerLearnsAllButWhatWouldRaiseTheRobotAgain) {
  fake_.lower_failure = {grpc::StatusCode::PERMISSION_DENIED, "vera is a viewer"};
  const Result result = Run({"explain", "r1"});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_THAT(result.out, AllOf(StartsWith(kFirstWords),
                                HasSubstr("  what would raise it again: to ask that needs an "
                                          "operator's certificate\n")));
  EXPECT_EQ(RunJson({"explain", "r1"})["lowering"],
            nlohmann::json({{"to", "DEFAULT"},
                            {"not_known_because",
                             "what would raise it again: to ask that needs an operator's "
                             "certificate"}}));
}

TEST_F(ExplainTest, AnOlderServerIsNamed) {
  fake_.explain_failure = {grpc::StatusCode::UNIMPLEMENTED, ""};
  for (const std::string what : {"11111112", "r1@3.1"}) {
    const Result result = Run({"explain", what});
    EXPECT_EQ(result.code, 1);
    EXPECT_EQ(result.err,
              "error: the policy server cannot explain: it is older than this ripsctl; `ripsctl "
              "level history ROBOT` and `ripsctl alert list ROBOT` show what it recorded\n");
  }
}

TEST_F(ExplainTest, AnEmptyAnswerIsAnError) {
  fake_.explained["abcdef"] = {};
  EXPECT_EQ(Run({"explain", "abcdef"}).err,
            "error: the policy server sent nothing that could be explained\n");
}

TEST_F(ExplainTest, AlertsOfTheServerHaveNoRobot) {
  fake_.explained[std::string(32, '2')].mutable_alert()->set_robot("(server)");
  EXPECT_THAT(Run({"explain", std::string(32, '2')}).out, StartsWith("(server): high alert"));
  EXPECT_TRUE(RunJson({"explain", std::string(32, '2')})["now"].is_null());
  EXPECT_THAT(fake_.calls(),
              ElementsAre("Explain " + std::string(32, '2'), "Explain " + std::string(32, '2')));
}

TEST_F(ExplainTest, WhatCannotBeMeantCallsNoServer) {
  for (const std::string what : {"", "R1", "r1@", "@3.17", "r1@3", "r1@3.x", "r1@0.0", "r1@ 3.17",
                                 "r1@+3.17", "r1@03.17", "r1@3.17@3.17", "ABCDEF", "../r1"}) {
    const Result result = Run({"explain", what});
    EXPECT_EQ(result.code, 2) << what;
    EXPECT_NE(result.err, "") << what;
  }
  EXPECT_EQ(Run({"explain"}).code, 2);
  EXPECT_EQ(Run({"explain", "r1", "r2"}).code, 2);
  EXPECT_EQ(Run({"explain", "r1@3"}).err,
            "error: WHAT is `r1@3`; write an id of 6 to 32 digits 0-9a-f, a robot, or "
            "ROBOT@TERM.EPOCH, for example r1@3.17\n");
  EXPECT_THAT(fake_.calls(), IsEmpty());
}

TEST_F(ExplainTest, JsonHasTheSameContent) {
  fake_.level_response.add_would_raise_again("rogue_cmd_vel");
  *fake_.explained["r1@3.17"].add_alerts() = MakeAlert("\x1b[2J");
  const nlohmann::json json = RunJson({"explain", "r1"});
  EXPECT_EQ(json["transition"]["id"], std::string(32, '1'));
  EXPECT_TRUE(json["alert"].is_null());
  const nlohmann::json& evidence = json["evidence"];
  EXPECT_EQ(evidence["place"], "warehouse.rul:31");
  EXPECT_EQ(evidence["event_time"], "2025-12-31T23:59:59.999000000Z");
  EXPECT_EQ(evidence["values"][1],
            nlohmann::json({{"offset", 0}, {"length", 27}, {"depth", 1}, {"value", "2"}}));
  EXPECT_EQ(evidence["subjects"][0],
            nlohmann::json({{"name", "/intruder"},
                            {"role", "publishes /cmd_vel"},
                            {"guid", "01104a3b.00000000.00000000.000003c1"},
                            {"host", "base"},
                            {"pid", 4711},
                            {"address", "10.0.0.66"}}));
  EXPECT_EQ(json["alerts"][0]["text"], "\x1b[2J");
  EXPECT_EQ(json["alerts"][0]["subjects"], nlohmann::json::array());
  EXPECT_EQ(json["now"]["status"]["decided_level"], "COMPROMISED");
  EXPECT_EQ(json["lowering"], nlohmann::json({{"to", "DEFAULT"},
                                              {"would_raise_again", {"rogue_cmd_vel"}},
                                              {"not_tried", {"rules Msg", "rules External"}},
                                              {"needs_approval", false},
                                              {"blind_because", nlohmann::json::array()}}));
  fake_.unknown_robots = {"r1"};
  const nlohmann::json alert = RunJson({"explain", std::string(32, '2')});
  EXPECT_EQ(alert["no_evidence_because"],
            "rule unknown_node; it was recorded before RIPS kept evidence");
  EXPECT_EQ(alert["now_not_known_because"], "no robot `r1`");
}

TEST_F(ExplainTest, AFindingIsSaidToStandAndToBeWhose) {
  const std::string id(32, '9');
  fake_.explained[id] = MakeFindingExplained();
  fake_.coverage = MakeFindings(1);
  fake_.coverage.mutable_finding_state()->set_state("stands");
  fake_.coverage.mutable_finding_state()->set_since_unix_ns(kNewYear);
  const Result result = Run({"explain", id});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("\nFinding: non_ros_reader, topic /camera, GUID "
                                    "01104a3b.00000000.00000000.000001c1\n"
                                    "  still stands, known since 2026-01-01T00:00:00.000Z\n"));
  EXPECT_THAT(fake_.calls(), ElementsAre("Explain " + id, "GetLevel", "GetFindings r1 of /camera",
                                         "GetGraph", "DeEscalate"));
  const nlohmann::json json = RunJson({"explain", id});
  EXPECT_EQ(json["finding"], nlohmann::json({{"kind", "non_ros_reader"},
                                             {"guid", "01104a3b.00000000.00000000.000001c1"},
                                             {"node", ""},
                                             {"topic", "/camera"},
                                             {"state", "stands"},
                                             {"since", "2026-01-01T00:00:00.000000000Z"},
                                             {"ended", nullptr},
                                             {"not_known_because", nlohmann::json::array()}}));
  EXPECT_EQ(json["alert"]["subjects"][0]["address"], "10.0.0.66");
  EXPECT_EQ(json["findings"]["total"], 1);
  EXPECT_EQ(json["findings"]["kinds"][0],
            nlohmann::json({{"kind", "non_ros_reader"}, {"count", 1}}));
  const nlohmann::json& newest = json["findings"]["newest"][0];
  EXPECT_EQ(newest["detail"], "reads without a node \x1b[2J");
  EXPECT_EQ(newest["subjects"][0]["host"], "lab-pc");
  EXPECT_EQ(newest["since"], "2026-01-01T00:00:00.000000000Z");
}

TEST_F(ExplainTest, FindingsThatTheServerDoesNotTellAreNotKnown) {
  fake_.explained[std::string(32, '9')] = MakeFindingExplained();
  fake_.coverage = {};
  const std::string text = Run({"explain", std::string(32, '9')}).out;
  EXPECT_THAT(text, HasSubstr("\n  not known whether it still stands: the policy server is older "
                              "than this ripsctl\n"));
  EXPECT_THAT(text, HasSubstr("\nFindings: not known: the policy server is older than this ripsctl"
                              "\n  try: ripsctl robot coverage r1\n"));
  const nlohmann::json json = RunJson({"explain", std::string(32, '9')});
  EXPECT_TRUE(json["findings"]["total"].is_null());
  EXPECT_EQ(json["finding"]["state"], "not known");
  fake_.unknown_robots = {"r1"};
  const nlohmann::json gone = RunJson({"explain", std::string(32, '9')});
  EXPECT_TRUE(gone["findings"].is_null());
  EXPECT_EQ(gone["finding"]["not_known_because"][0], "the robot's state is not known");
}

}  // namespace
}  // namespace rips::ripsctl

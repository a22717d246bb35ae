// JSON of verbs, and fields of it, that no other test of ripsctl prints; the test `ripsctl_json`
// compares all that these tests print with deploy/schema/ripsctl.
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"

namespace rips::ripsctl {
namespace {

class JsonSampleTest : public RipsctlTest {
 protected:
  nlohmann::json Replay(const std::string& rules, const std::string& events) {
    const Result result = RunOffline({"rules", "replay", "--rules", File("r.rul", rules),
                                      "--events", events, "--output", "json"});
    EXPECT_EQ(result.code, 0) << result.out << result.err;
    return nlohmann::json::parse(result.out, nullptr, false);
  }
};

TEST_F(JsonSampleTest, Agents) {
  const std::string uri = "spiffe://td/robot/r1/sensor/base";
  EXPECT_EQ(RunJson({"agent", "ban", uri, "--serial", "0f", "--reason", "stolen"}),
            nlohmann::json({{"uri", uri}, {"serial", "f"}, {"done", "banned"}}));
  EXPECT_EQ(RunJson({"agent", "unban", uri})["serial"], "");
  EXPECT_EQ(RunJson({"agent", "reset-term", "r1", "base", "--reason", "restored"}),
            nlohmann::json({{"robot", "r1"},
                            {"host", "base"},
                            {"decision_id", "2000000.8"},
                            {"decided_level", "ALERT"}}));
}

TEST_F(JsonSampleTest, Record) {
  const std::string file = absl::StrCat(home_, "/recording");
  EXPECT_EQ(RunJson({"record", "r1", "--out", file}),
            nlohmann::json({{"robot", "r1"}, {"file", file}, {"events", 2}}));
}

TEST_F(JsonSampleTest, CursorOfAnAlert) {
  v1::Alert alert = MakeAlert("who drives?");
  alert.set_cursor("7-" + std::string(32, '2'));
  fake_.alert_watches = {{.alerts = {alert}, .end = grpc::Status::OK}};
  EXPECT_EQ(RunJson({"alert", "watch", "r1"})["cursor"], alert.cursor());
}

TEST_F(JsonSampleTest, DryRunOfALowering) {
  const nlohmann::json json =
      RunJson({"level", "lower", "r1", "--to", "DEFAULT", "--reason", "x", "--dry-run"});
  EXPECT_EQ(json["not_tried"], nlohmann::json({"rules Msg", "rules External"}));
}

TEST_F(JsonSampleTest, ApprovalThatIsFollowed) {
  v1::PendingApproval pending;
  pending.set_id(std::string(32, '3'));
  pending.set_from("COMPROMISED");
  pending.set_to("DEFAULT");
  fake_.pending = {pending};
  fake_.level_response.set_decided_level("DEFAULT");
  *fake_.level_response.mutable_decision_id() = MakeDecisionId(3, 18);
  const std::vector<std::string> approve = {"level",    "approve", "r1",    "333333",
                                            "--reason", "x",       "--wait"};
  v1::RobotStatus reached = MakeStatus("r1", "DEFAULT");
  *reached.mutable_decision_id() = MakeDecisionId(3, 18);
  fake_.level_states = {MakeStatus("r1", "COMPROMISED"), reached};
  EXPECT_EQ(RunJson(approve)["effective_level"], "DEFAULT");

  // A newer decision has replaced it.
  *reached.mutable_decision_id() = MakeDecisionId(3, 19);
  fake_.level_states = {MakeStatus("r1", "COMPROMISED"), reached};
  EXPECT_EQ(RunJson(approve, 1)["reached"], false);
}

TEST_F(JsonSampleTest, ReplayOfASavedRecordingThatCrashes) {
  const nlohmann::json json = Replay(
      "levels: ALERT;\n"
      "rules External:\n"
      "  rogue: signal(\"SIGUSR1\") ? alert(\"who drives\"), True(\"seen\"), crash(\"enough\");\n",
      File("saved.rips", MakeAlertRecording()));
  EXPECT_EQ(json["recorded"].size(), 1u);
  EXPECT_EQ(json["logs"].size(), 1u);
  EXPECT_EQ(json["crashed"], 0);
}

}  // namespace
}  // namespace rips::ripsctl

// Drills and receipts of a whole robot: what operators get, and what is left alone.
#include <optional>

#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using Told = Receipt::Stage;

class RobotDrillTest : public RobotTest {
 protected:
  void Begin(const std::string& level = "ALERT") {
    answer_.reset();
    robot_->StartDrill({.operator_name = "alice", .level = level},
                       [this](const DrillAnswer& answer) { answer_ = answer; });
    Drain();
  }
  // The newest drill command.
  const Command* Sent() const {
    for (auto it = actuator_->commands.rbegin(); it != actuator_->commands.rend(); ++it) {
      if (std::holds_alternative<Drill>(it->what)) return &*it;
    }
    return nullptr;
  }
  void Answer(Told stage, std::vector<StepResult> steps = {}, const std::string& detail = "") {
    ASSERT_NE(Sent(), nullptr);
    robot_->OnReceipt(
        "base", actuator_.get(),
        {.command_id = Sent()->id, .stage = stage, .steps = std::move(steps), .detail = detail});
    Drain();
  }

  std::optional<DrillAnswer> answer_;
};

TEST_F(RobotDrillTest, IsAnsweredWhenTheActuatorHas) {
  Start();
  Arm();
  const RobotStatus before = robot_->Status();
  const size_t decisions = recorder_.decisions.size();
  Begin();
  ASSERT_NE(Sent(), nullptr);
  EXPECT_EQ(std::get<Drill>(Sent()->what).level, "ALERT");
  EXPECT_EQ(Sent()->term, 1u);
  Answer(Told::kAcknowledged);
  EXPECT_FALSE(answer_.has_value());
  Answer(Told::kFailed,
         {{.step = "program horn", .detail = "not there"}, {.step = "x", .ok = true}},
         "program horn: not there");
  ASSERT_TRUE(answer_.has_value());
  EXPECT_THAT(answer_->status, IsOk());
  ASSERT_THAT(answer_->drills, SizeIs(1));
  EXPECT_EQ(answer_->drills[0].stage, Told::kFailed);
  EXPECT_EQ(answer_->drills[0].host, "base");
  EXPECT_THAT(answer_->drills[0].steps, SizeIs(2));

  // A drill that fails says nothing about the level, its commands or what rules may do.
  Pass(1000);
  RobotStatus after = robot_->Status();
  EXPECT_EQ(after, before);
  EXPECT_EQ(recorder_.decisions.size(), decisions);
  EXPECT_EQ(audience_.Count("was not reached"), 0);
  EXPECT_EQ(audience_.Count("drill by alice begins: ALERT"), 1);
  EXPECT_EQ(audience_.Count("drill by alice is over: 1 of 2 steps work; these do not: base: "
                            "program horn (ALERT): not there"),
            1);
}

TEST_F(RobotDrillTest, WithoutALevelEachIsTriedInTurn) {
  Start();
  Arm();
  Begin("");
  std::vector<std::string> levels;
  for (int i = 0; i < 4; ++i) {
    levels.push_back(std::get<Drill>(Sent()->what).level);
    Answer(Told::kVerified, {{.step = "x", .ok = true}});
  }
  EXPECT_THAT(levels, ElementsAre("DEFAULT", "ALERT", "COMPROMISED", "HALT"));
  ASSERT_TRUE(answer_.has_value());
  EXPECT_THAT(answer_->drills, SizeIs(4));
  EXPECT_EQ(audience_.Count("drill by alice is over: 4 of 4 steps work"), 1);
}

TEST_F(RobotDrillTest, RefusalsSayWhy) {
  Start();
  Begin();
  ASSERT_TRUE(answer_.has_value());
  EXPECT_THAT(answer_->status,
              StatusIs(absl::StatusCode::kFailedPrecondition, "no actuator of r1 is attached"));
  Arm();
  Begin("PANIC\n");
  EXPECT_THAT(answer_->status,
              StatusIs(absl::StatusCode::kInvalidArgument,
                       "`PANIC\\n` is not a level of r1 (DEFAULT, ALERT, COMPROMISED, HALT)"));
  Begin();
  std::optional<DrillAnswer> second;
  robot_->StartDrill({.operator_name = "bob"}, [&](const DrillAnswer& answer) { second = answer; });
  ASSERT_TRUE(second.has_value());
  EXPECT_THAT(second->status, StatusIs(absl::StatusCode::kFailedPrecondition,
                                       HasSubstr("a drill of r1 by alice is under way")));
  Answer(Told::kVerified);
  EXPECT_TRUE(answer_.has_value());
  Begin();
  EXPECT_FALSE(answer_.has_value());
}

TEST_F(RobotDrillTest, ASilentActuatorIsAskedAgainAndGivenUp) {
  Start();
  Arm();
  Begin();
  const std::string id = Sent()->id;
  const size_t sent = actuator_->commands.size();
  Pass(3000);
  EXPECT_EQ(actuator_->commands.size(), sent + 1);
  EXPECT_EQ(Sent()->id, id);
  EXPECT_FALSE(answer_.has_value());
  Pass(28'000);
  ASSERT_TRUE(answer_.has_value());
  EXPECT_FALSE(answer_->drills[0].stage.has_value());
  EXPECT_EQ(answer_->drills[0].detail, "no answer in time");
  // Too late: kept among the receipts, and nothing else.
  const std::optional<DrillAnswer> first = answer_;
  Answer(Told::kVerified);
  EXPECT_FALSE(answer_->drills[0].stage.has_value());
  EXPECT_EQ(robot_->core().actuators().receipts().Newest(1)[0].command, "drill ALERT");
}

TEST_F(RobotDrillTest, AnActuatorThatGoesAwayEndsIt) {
  Start();
  Arm();
  Begin();
  robot_->OnActuatorGone("base", actuator_.get());
  Pass(100);
  ASSERT_TRUE(answer_.has_value());
  EXPECT_EQ(answer_->drills[0].stage, Told::kUnknown);
  EXPECT_EQ(answer_->drills[0].detail, "the actuator went away during the drill");
}

TEST_F(RobotDrillTest, ANewSessionDoesNotGoOnWithIt) {
  Start();
  Arm();
  Begin();
  actuator_heartbeats_ = false;
  Pass(2000);
  ConnectActuator({.decision_id = robot_->Status().decision_id,
                   .decided_level = "DEFAULT",
                   .effective_level = "DEFAULT"});
  Pass(100);
  ASSERT_TRUE(answer_.has_value());
  EXPECT_EQ(answer_->drills[0].stage, Told::kUnknown);
}

TEST_F(RobotDrillTest, ARaiseInTheMiddleWins) {
  Start();
  Arm();
  Begin("");
  IntruderAppears();
  EXPECT_EQ(Level(), "ALERT");
  ASSERT_NE(actuator_->level(), nullptr);
  EXPECT_EQ(actuator_->level()->to, "ALERT");
  Answer(Told::kSuperseded, {}, "a level had to be applied");
  ASSERT_TRUE(answer_.has_value());
  EXPECT_THAT(answer_->drills, SizeIs(4));
  for (const DrillEntry& entry : answer_->drills) EXPECT_EQ(entry.stage, Told::kSuperseded);
}

TEST_F(RobotDrillTest, ADrillByAnotherTermIsNoAlarm) {
  Start();
  Arm();
  Begin();
  Answer(Told::kRefusedStale, {}, "term 1 is stale");
  ASSERT_TRUE(answer_.has_value());
  EXPECT_EQ(answer_->drills[0].stage, Told::kRefusedStale);
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(RobotDrillTest, AServerThatStopsAnswers) {
  Start();
  Arm();
  Begin();
  robot_->Drain();
  ASSERT_TRUE(answer_.has_value());
  EXPECT_THAT(answer_->status, StatusIs(absl::StatusCode::kUnavailable, "the server is stopping"));
  Begin();
  EXPECT_THAT(answer_->status, StatusIs(absl::StatusCode::kUnavailable));
}

TEST_F(RobotDrillTest, ReceiptsOfLevelsAreKeptAndTheAlertNamesTheSteps) {
  Start();
  Arm();
  ASSERT_THAT(robot_->core().actuators().receipts().Newest(0), SizeIs(1));
  EXPECT_EQ(robot_->core().actuators().receipts().Newest(0)[0].command, "level DEFAULT");
  EXPECT_EQ(robot_->core().actuators().receipts().Newest(0)[0].receipt.stage, Told::kVerified);

  IntruderAppears();
  const SetLevel set = *actuator_->level();
  const std::string id = actuator_->commands.back().id;
  robot_->OnReceipt("base", actuator_.get(),
                    {.command_id = id,
                     .decision_id = set.decision_id,
                     .stage = Told::kFailed,
                     .steps = {{.step = "system_mode /safety=ALERT", .ok = true},
                               {.step = "program horn",
                                .detail = "exit code 1\x1b",
                                .output_tail = "no such device"}},
                     .detail = "in short"});
  Drain();
  EXPECT_EQ(audience_.Count("level ALERT was not reached: base: program horn: exit code 1\\x1b; "
                            "the decision stands"),
            1);
  const LoggedReceipt newest = robot_->core().actuators().receipts().Newest(1)[0];
  EXPECT_EQ(newest.command, "level ALERT");
  EXPECT_EQ(newest.host, "base");
  EXPECT_EQ(newest.receipt.steps[1].output_tail, "no such device");
}

}  // namespace
}  // namespace rips::pipeline

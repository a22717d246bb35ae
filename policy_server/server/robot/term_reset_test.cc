#include "policy_server/server/robot/decide/term_reset.h"

#include <limits>
#include <string>

#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr uint64_t kHighTerm = 5'000'000;
constexpr uint64_t kMaxTerm = std::numeric_limits<uint64_t>::max();

TEST(JudgeTermTest, FollowsTheTableOfTheHeader) {
  const auto judge = [](DecisionId decision_id, uint64_t highest, uint64_t ours) {
    return JudgeTerm({.decision_id = decision_id, .highest_term = highest}, {.term = ours},
                     std::nullopt);
  };
  EXPECT_EQ(judge({}, 0, 1), TermJump::kNear);
  EXPECT_EQ(judge({1, 1}, 7 + kTermJumpMax, 7), TermJump::kNear);
  EXPECT_EQ(judge({1, 1}, 8 + kTermJumpMax, 7), TermJump::kFar);
  EXPECT_EQ(judge({8 + kTermJumpMax, 1}, 1, 7), TermJump::kFar)
      << "the decision's term counts, too";
  EXPECT_EQ(judge({1, kEpochMax}, 1, 7), TermJump::kNear);
  EXPECT_EQ(judge({1, kEpochMax + 1}, 1, 7), TermJump::kFar);
  EXPECT_EQ(judge({}, kTermResetMax, 7), TermJump::kFar);
  EXPECT_EQ(judge({}, kTermResetMax + 1, 7), TermJump::kOutOfReach);
  EXPECT_EQ(judge({}, kMaxTerm, 7), TermJump::kOutOfReach);
  EXPECT_EQ(judge({kMaxTerm, kMaxTerm}, 0, 7), TermJump::kOutOfReach);
  EXPECT_EQ(judge({}, kTermResetMax, kTermResetMax - 1), TermJump::kNear) << "after a reset";
}

TEST(JudgeTermTest, TheEpochOfOurOwnNewestDecisionIsNeverFar) {
  const DecisionId ours = {3, kEpochMax + 1};
  EXPECT_EQ(JudgeTerm({.decision_id = ours, .highest_term = 3}, ours, std::nullopt),
            TermJump::kNear);
  const DecisionId above = {3, kEpochMax + 2};
  EXPECT_EQ(JudgeTerm({.decision_id = above, .highest_term = 3}, ours, std::nullopt),
            TermJump::kFar);
}

TEST(JudgeTermTest, APardonIsForOneDecisionInALowerTerm) {
  const ShownTerm shown = {.decision_id = {5, kEpochMax + 1}, .highest_term = 5};
  EXPECT_EQ(JudgeTerm(shown, {.term = 7}, shown), TermJump::kNear);
  EXPECT_EQ(JudgeTerm(shown, {.term = 5}, shown), TermJump::kFar) << "not above it yet";
  ShownTerm other = shown;
  ++other.decision_id.epoch;
  EXPECT_EQ(JudgeTerm(other, {.term = 7}, shown), TermJump::kFar);
}

class TermResetTest : public RobotTest {
 protected:
  LevelAnswer Reset(const std::string& host = "base", const std::string& reason = "disk replaced") {
    LevelAnswer got;
    got.status = absl::UnknownError("no answer");
    robot_->ResetTerm({.operator_name = "ann", .host = host, .reason = reason},
                      [&](const LevelAnswer& answer) { got = answer; });
    Drain();
    return got;
  }
  ActuatorHello Hello(DecisionId decision_id, uint64_t highest, const std::string& level) {
    return {.decision_id = decision_id,
            .decided_level = level,
            .effective_level = level,
            .highest_term = highest};
  }
};

TEST_F(TermResetTest, AResetArmsTheActuatorAndLowersNothing) {
  Start();
  ConnectSensor();
  SendSnapshot();
  const ActuatorHello hello = Hello({kHighTerm, 9}, kHighTerm, "COMPROMISED");
  ConnectActuator(hello);
  EXPECT_THAT(actuator_->closed, StatusIs(absl::StatusCode::kFailedPrecondition,
                                          AllOf(HasSubstr("not armed"),
                                                HasSubstr("ripsctl agent reset-term r1 base"))));
  EXPECT_EQ(Level(), "DEFAULT");

  const LevelAnswer answer = Reset();

  EXPECT_THAT(answer.status, IsOk());
  EXPECT_EQ(answer.decision_id.term, kHighTerm + 1);
  EXPECT_EQ(answer.decided_level, "DEFAULT");
  ASSERT_FALSE(recorder_.decisions.empty());
  const store::DecisionRecord& recorded = recorder_.decisions.back();
  EXPECT_EQ(recorded.from, "DEFAULT");
  EXPECT_EQ(recorded.to, "DEFAULT");
  EXPECT_THAT(recorded.cause, HasSubstr("ann"));
  EXPECT_EQ(recorded.reason, "reset-term base: disk replaced");
  EXPECT_EQ(audience_.Count("operator ann lets the server go above term 5000000"), 1);

  ConnectActuator(hello);
  EXPECT_THAT(actuator_->closed, IsOk());
  EXPECT_EQ(Level(), "COMPROMISED") << "what it holds is more restrictive: adopted";
  ASSERT_NE(actuator_->level(), nullptr);
  EXPECT_EQ(actuator_->level()->to, "COMPROMISED");
  EXPECT_GT(actuator_->level()->decision_id, hello.decision_id);
  EXPECT_GT(actuator_->commands.back().term, hello.highest_term);
}

TEST_F(TermResetTest, OursStaysIfItIsMoreRestrictive) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  EXPECT_EQ(Level(), "ALERT");
  robot_->OnActuatorGone("base", actuator_.get());
  ConnectActuator(Hello({kHighTerm, 1}, kHighTerm, "DEFAULT"));

  EXPECT_THAT(Reset().status, IsOk());
  EXPECT_EQ(Level(), "ALERT");
  ConnectActuator(Hello({kHighTerm, 1}, kHighTerm, "DEFAULT"));
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(actuator_->level()->to, "ALERT");
}

TEST_F(TermResetTest, IsRefusedIfNothingIsToBeReset) {
  Start();
  Arm();
  const auto decisions = recorder_.decisions.size();
  EXPECT_THAT(Reset().status,
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("nothing to reset")));
  EXPECT_THAT(Reset("other").status, StatusIs(absl::StatusCode::kNotFound));

  robot_->OnActuatorGone("base", actuator_.get());
  ConnectActuator(Hello({}, kHighTerm, "DEFAULT"));
  EXPECT_THAT(Reset("base", "").status, StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(Reset("base", std::string(1'001, 'x')).status,
              StatusIs(absl::StatusCode::kInvalidArgument));
  ConnectActuator(Hello({}, 1, "DEFAULT"));
  EXPECT_THAT(Reset().status,
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("nothing to reset")))
      << "it was accepted meanwhile";
  EXPECT_EQ(recorder_.decisions.size(), decisions);
}

TEST_F(TermResetTest, GoesAboveOnceNotForAHigherTermThatFollows) {
  Start();
  ConnectActuator(Hello({}, kHighTerm, "DEFAULT"));
  EXPECT_THAT(Reset().status, IsOk());
  EXPECT_THAT(Reset().status, StatusIs(absl::StatusCode::kFailedPrecondition));

  ConnectActuator(Hello({}, 2 * kHighTerm, "DEFAULT"));
  EXPECT_THAT(actuator_->closed, StatusIs(absl::StatusCode::kFailedPrecondition));
}

TEST_F(TermResetTest, ATermThatCannotBeExceededNeedsItsStateFileRemoved) {
  Start();
  for (const uint64_t term : {kTermResetMax + 1, kMaxTerm}) {
    ConnectActuator(Hello({}, term, "DEFAULT"));
    EXPECT_THAT(actuator_->closed, StatusIs(absl::StatusCode::kFailedPrecondition,
                                            HasSubstr("remove its state file")));
    EXPECT_THAT(Reset().status, StatusIs(absl::StatusCode::kFailedPrecondition,
                                         HasSubstr("remove its state file")));
  }
  EXPECT_LE(robot_->Status().decision_id.term, 1u);
  ConnectActuator({.effective_level = "DEFAULT", .state_lost = true});
  EXPECT_THAT(actuator_->closed, IsOk()) << "as it comes without its state";
}

TEST_F(TermResetTest, AnEpochBeyondOursIsOvertakenByTheTerm) {
  Start();
  const ActuatorHello hello = Hello({1, kMaxTerm}, 1, "ALERT");
  ConnectActuator(hello);
  EXPECT_THAT(actuator_->closed, StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(Reset().status, IsOk());

  ConnectActuator(hello);

  EXPECT_THAT(actuator_->closed, IsOk());
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_GT(actuator_->level()->decision_id, hello.decision_id);
  EXPECT_LT(robot_->Status().decision_id.epoch, 100u) << "its epoch is not taken over";
  Obey();
  EXPECT_EQ(Stage(), "verified");
}

TEST_F(TermResetTest, WithoutAStoreNothingIsReset) {
  Start();
  ConnectActuator(Hello({}, kHighTerm, "DEFAULT"));
  recorder_.term_fail = absl::UnavailableError("disk full");
  EXPECT_THAT(Reset().status, StatusIs(absl::StatusCode::kUnavailable));
  recorder_.term_fail = absl::OkStatus();
  EXPECT_THAT(Reset().status, IsOk()) << "asked again";
}

TEST_F(TermResetTest, AStoreThatAnswersLateKeepsNothingElseWaiting) {
  Start();
  ConnectSensor();
  SendSnapshot();
  ConnectActuator(Hello({}, kHighTerm, "DEFAULT"));
  recorder_.questions_held = true;
  LevelAnswer got{.status = absl::UnknownError("no answer yet")};
  robot_->ResetTerm({.operator_name = "ann", .host = "base", .reason = "disk replaced"},
                    [&](const LevelAnswer& answer) { got = answer; });
  Drain();
  EXPECT_THAT(got.status, StatusIs(absl::StatusCode::kUnknown));
  IntruderAppears();
  EXPECT_EQ(Level(), "ALERT");
  recorder_.AnswerAll();
  Drain();
  EXPECT_THAT(got.status, IsOk());
  EXPECT_GT(robot_->Status().decision_id.term, kHighTerm);
  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(TermResetTest, AnActuatorIsArmedWhenTheStoreHasAnswered) {
  Start();
  ConnectSensor();
  SendSnapshot();
  recorder_.questions_held = true;
  const ActuatorHello hello = Hello({3, 9}, 5, "COMPROMISED");
  ConnectActuator(hello);
  EXPECT_TRUE(actuator_->commands.empty());
  IntruderAppears();
  EXPECT_EQ(Level(), "ALERT") << "the robot's thread waits for no store";
  const auto first = actuator_;
  ConnectActuator(hello);
  EXPECT_THAT(first->closed, StatusIs(absl::StatusCode::kAborted)) << "replaced while it waited";
  while (recorder_.AnswerAll()) Drain();
  EXPECT_THAT(actuator_->closed, IsOk());
  EXPECT_EQ(Level(), "COMPROMISED") << "what it holds is more restrictive: adopted";
  ASSERT_NE(actuator_->level(), nullptr);
  EXPECT_EQ(actuator_->level()->to, "COMPROMISED");
  EXPECT_GT(actuator_->commands.back().term, 5u);
}

TEST_F(TermResetTest, AnActuatorThatLeavesWhileTheStoreAnswersIsNotArmed) {
  Start();
  recorder_.questions_held = true;
  ConnectActuator(Hello({3, 9}, 5, "COMPROMISED"));
  robot_->OnActuatorGone("base", actuator_.get());
  while (recorder_.AnswerAll()) Drain();
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_TRUE(actuator_->commands.empty());
}

TEST_F(TermResetTest, ALoweringThatIsNotDurableYetIsNotCommandedByAReset) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  robot_->OnActuatorGone("base", actuator_.get());
  ConnectActuator(Hello({}, kHighTerm, "ALERT"));
  recorder_.held = true;
  robot_->DeEscalate({.operator_name = "ann",
                      .to = "DEFAULT",
                      .reason = "seen",
                      .expected_level = "ALERT",
                      .expected_decision_id = robot_->Status().decision_id,
                      .accept_blind = true},
                     [](const LevelAnswer&) {});
  EXPECT_EQ(Level(), "DEFAULT");

  EXPECT_THAT(Reset().status, StatusIs(absl::StatusCode::kUnavailable));

  recorder_.held = false;
  recorder_.Release();
  Drain();
  EXPECT_THAT(Reset().status, IsOk());
}

TEST_F(TermResetTest, TheTermGrowsToItsEndOnlyByResets) {
  Start();
  ConnectActuator(Hello({}, kTermResetMax, "DEFAULT"));
  EXPECT_THAT(Reset().status, IsOk());
  ConnectActuator(Hello({}, kTermResetMax, "DEFAULT"));
  EXPECT_THAT(actuator_->closed, IsOk());
  // It obeys the new term, which is just above the limit of resets.
  robot_->OnActuatorGone("base", actuator_.get());
  ConnectActuator(Hello({}, kTermResetMax + 1, "DEFAULT"));
  EXPECT_THAT(actuator_->closed, IsOk());
}

}  // namespace
}  // namespace rips::pipeline

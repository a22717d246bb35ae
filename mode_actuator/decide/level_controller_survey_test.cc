// Every start: what the robot shows decides how low the first level may be, whatever the recorded
// state says, since that can be lost or come from a backup.
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/decide/level_controller.h"
#include "mode_actuator/decide/level_controller_test_rig.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;

constexpr int64_t kS = 1'000;  // milliseconds

const absl::Status& Lost() {
  static const absl::Status& lost = *new absl::Status(absl::NotFoundError("no file"));
  return lost;
}

TEST(LevelControllerSurveyTest, NothingIsAppliedBeforeTheRobotWasRead) {
  for (const absl::Status& why : {Lost(), absl::DataLossError("corrupt")}) {
    ExecutorRig rig(why, ExecutorRig::WithSurvey());
    EXPECT_THAT(rig.PopOrder(), ElementsAre("survey", "write"));
    rig.lease = true;
    rig.Advance(2 * kS);
    EXPECT_EQ(rig.PopJobs(), "");
    EXPECT_TRUE(rig.report().state_lost);
    EXPECT_FALSE(rig.report().verified);

    rig.FinishSurvey("HALT");

    EXPECT_EQ(rig.PopJobs(), ">HALT");
    EXPECT_EQ(rig.report().effective, "HALT");
    EXPECT_EQ(rig.report().floor, "HALT");
    EXPECT_EQ(rig.report().floor_reason, "state lost");
    EXPECT_TRUE(rig.report().verified);
    EXPECT_TRUE(rig.report().state_lost);
    EXPECT_EQ(rig.disk()->effective, "HALT");
  }
}

TEST(LevelControllerSurveyTest, AStateOfOtherLevelsIsLostToo) {
  ExecutorRig rig(ExecutorRig::At("GREEN", {6, 1}), ExecutorRig::WithSurvey());
  EXPECT_EQ(rig.PopJobs(), "");
  rig.FinishSurvey("COMPROMISED");
  EXPECT_EQ(rig.PopJobs(), ">COMPROMISED");
  EXPECT_EQ(rig.report().highest_term, 6u);
}

TEST(LevelControllerSurveyTest, TheFloorThatWasFoundLiftsOnceAServerHasDecided) {
  ExecutorRig rig(Lost(), ExecutorRig::WithSurvey());
  rig.FinishSurvey("HALT");
  rig.PopJobs();
  rig.lease = true;
  rig.Advance(60 * kS);
  EXPECT_EQ(rig.report().effective, "HALT");  // a lease alone decides nothing

  rig.evidence = false;
  rig.Level("DEFAULT", {1, 1});
  rig.Advance(60 * kS);
  EXPECT_EQ(rig.report().effective, "HALT");
  rig.evidence = true;
  rig.Advance(1 * kS);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
  EXPECT_EQ(rig.PopJobs(), "HALT>DEFAULT down");
}

TEST(LevelControllerSurveyTest, ItIsOneLossAndDoesNotDoubleTheWait) {
  ExecutorRig rig(Lost(), ExecutorRig::WithSurvey());
  rig.FinishSurvey("HALT");
  rig.Level("DEFAULT", {1, 1});
  rig.lease = true;
  rig.Advance(11 * kS);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
}

TEST(LevelControllerSurveyTest, ARobotThatShowsNoMoreThanTheFailSafeLevelIsBroughtThere) {
  for (const std::string shown : {"", "DEFAULT", "ALERT", "GREEN"}) {
    ExecutorRig rig(Lost(), ExecutorRig::WithSurvey());
    rig.FinishSurvey(shown);
    EXPECT_EQ(rig.PopJobs(), ">ALERT") << shown;
    EXPECT_EQ(rig.report().floor, "ALERT") << shown;
  }
}

TEST(LevelControllerSurveyTest, ASilentRobotDelaysTheFailSafeLevelForALimitedTime) {
  ExecutorRig rig(Lost(), ExecutorRig::WithSurvey());
  rig.Advance(kSurveyNsMax / ExecutorRig::kMs - 50);
  EXPECT_EQ(rig.PopJobs(), "");
  rig.Advance(50);
  EXPECT_EQ(rig.PopJobs(), ">ALERT");
  EXPECT_TRUE(rig.report().verified);

  // Late, it still raises, and once only.
  rig.FinishSurvey("COMPROMISED");
  EXPECT_EQ(rig.PopJobs(), "ALERT>COMPROMISED");
  EXPECT_EQ(rig.report().floor, "COMPROMISED");
  EXPECT_EQ(rig.disk()->effective, "COMPROMISED");
}

TEST(LevelControllerSurveyTest, ALateResultDoesNotLower) {
  ExecutorRig rig(Lost(), ExecutorRig::WithSurvey());
  rig.Advance(4 * kS);
  rig.PopJobs();
  rig.FinishSurvey("DEFAULT");
  EXPECT_EQ(rig.PopJobs(), "");
  EXPECT_EQ(rig.report().effective, "ALERT");
  EXPECT_TRUE(rig.report().verified);
}

TEST(LevelControllerSurveyTest, ARaiseDoesNotWaitForTheSurvey) {
  ExecutorRig rig(Lost(), ExecutorRig::WithSurvey());
  rig.PopOrder();
  rig.Level("COMPROMISED", {1, 1});
  EXPECT_THAT(rig.PopOrder(),
              ElementsAre("apply COMPROMISED", "write", "id-1.1 acknowledged", "id-1.1 verified"));

  rig.FinishSurvey("HALT");  // what it had read when the raise ended it
  EXPECT_EQ(rig.PopJobs(), ">COMPROMISED, COMPROMISED>HALT");
  EXPECT_EQ(rig.report().decided, "COMPROMISED");
  EXPECT_EQ(rig.report().effective, "HALT");
  rig.lease = true;
  rig.Advance(11 * kS);
  EXPECT_EQ(rig.report().effective, "COMPROMISED");  // as the server has decided
}

TEST(LevelControllerSurveyTest, ALateResultEndsALessRestrictiveRaiseThatIsUnderWay) {
  ExecutorRig rig(Lost(), ExecutorRig::WithSurvey());
  rig.auto_finish = false;
  rig.Level("COMPROMISED", {1, 1});
  rig.FinishSurvey("HALT");
  EXPECT_EQ(rig.PopJobs(), ">COMPROMISED, COMPROMISED>HALT");
  rig.Finish(true);
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.1 acknowledged", "id-1.1 verified"));
}

TEST(LevelControllerSurveyTest, ADecisionAtOrBelowTheFloorWaitsForTheSurvey) {
  for (const std::string to : {"DEFAULT", "ALERT"}) {
    ExecutorOptions options = ExecutorRig::WithSurvey();
    options.floor_hold_ns = 0;
    ExecutorRig rig(Lost(), options);
    rig.lease = true;
    rig.Level(to, {1, 1});
    rig.Advance(1 * kS);
    EXPECT_EQ(rig.PopJobs(), "") << to;
    EXPECT_EQ(rig.report().floor, "ALERT") << to;

    rig.auto_finish = false;
    rig.FinishSurvey("HALT");
    EXPECT_EQ(rig.PopJobs(), ">HALT") << to;
    rig.auto_finish = true;
    rig.Finish(true);
    rig.Advance(1 * kS);
    EXPECT_EQ(rig.report().effective, to);
  }
}

TEST(LevelControllerSurveyTest, ASecondRestartSurveysAgainAndHoldsWhatTheFirstOneFound) {
  ExecutorRig first(Lost(), ExecutorRig::WithSurvey());
  first.FinishSurvey("COMPROMISED");

  ExecutorRig second = first.Restarted();
  EXPECT_TRUE(second.report().state_lost);
  EXPECT_TRUE(second.survey().has_value());
  second.Advance(4 * kS);  // no answer this time
  EXPECT_EQ(second.PopJobs(), ">COMPROMISED");

  ExecutorRig third = second.Restarted();
  third.FinishSurvey("HALT");
  EXPECT_EQ(third.PopJobs(), ">HALT");
  ExecutorRig last = third.Restarted();  // nothing above that can be found
  EXPECT_FALSE(last.survey().has_value());
  EXPECT_EQ(last.PopJobs(), ">HALT");
}

TEST(LevelControllerSurveyTest, ACrashDuringTheSurveyForgetsNothing) {
  ExecutorRig first(Lost(), ExecutorRig::WithSurvey());
  first.Advance(1 * kS);
  ExecutorRig second = first.Restarted();
  second.FinishSurvey("HALT");
  EXPECT_EQ(second.PopJobs(), ">HALT");
}

TEST(LevelControllerSurveyTest, AStateFromABackupDoesNotLowerTheRobot) {
  ExecutorRig rig(ExecutorRig::At("DEFAULT"), ExecutorRig::WithSurvey());
  EXPECT_THAT(rig.PopOrder(), ElementsAre("survey", "write"));
  rig.Advance(1 * kS);
  EXPECT_EQ(rig.PopJobs(), "");

  rig.FinishSurvey("HALT");
  EXPECT_EQ(rig.PopJobs(), ">HALT");
  EXPECT_FALSE(rig.report().state_lost);
  EXPECT_EQ(rig.report().decided, "DEFAULT");
  EXPECT_EQ(rig.report().floor, "HALT");
  EXPECT_EQ(rig.report().floor_reason, "the robot showed it at start");
  EXPECT_EQ(rig.disk()->effective, "HALT");

  rig.lease = true;  // the server stands by the decision
  rig.Advance(9 * kS);
  EXPECT_EQ(rig.report().effective, "HALT");
  rig.Advance(2 * kS);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
}

TEST(LevelControllerSurveyTest, AGoodStateThatTheRobotConfirmsRaisesNoFloor) {
  for (const std::string shown : {"", "DEFAULT", "ALERT", "GREEN"}) {
    ExecutorRig rig(ExecutorRig::At("ALERT"), ExecutorRig::WithSurvey());
    rig.FinishSurvey(shown);
    EXPECT_EQ(rig.PopJobs(), ">ALERT") << shown;
    EXPECT_EQ(rig.report().floor, "") << shown;
  }
}

TEST(LevelControllerSurveyTest, ALoweringDuringTheSurveyFollowsItWithoutAFloor) {
  ExecutorRig rig(ExecutorRig::At("ALERT", {6, 1}), ExecutorRig::WithSurvey());
  rig.lease = true;
  rig.Level("DEFAULT", {6, 2}, DecisionId{6, 1});
  EXPECT_EQ(rig.PopJobs(), "");
  rig.FinishSurvey("ALERT");
  EXPECT_EQ(rig.PopJobs(), ">DEFAULT");
  EXPECT_EQ(rig.report().floor, "");
}

TEST(LevelControllerSurveyTest, AGoodStateAtTheLastLevelNeedsNoSurvey) {
  ExecutorRig rig(ExecutorRig::At("HALT"), ExecutorRig::WithSurvey());
  EXPECT_FALSE(rig.survey().has_value());
  EXPECT_EQ(rig.PopJobs(), ">HALT");
}

TEST(LevelControllerSurveyTest, WithKeepAndNothingKnownTheMostRestrictiveLevelNeedsNoSurvey) {
  ExecutorOptions options = ExecutorRig::WithSurvey();
  options.fail_safe.reset();
  ExecutorRig rig(Lost(), options);
  EXPECT_FALSE(rig.survey().has_value());
  EXPECT_EQ(rig.PopJobs(), ">HALT");
}

TEST(LevelControllerSurveyTest, WithKeepWhatTheRobotShowsRaisesWhatTheStateStillSays) {
  ExecutorOptions options = ExecutorRig::WithSurvey();
  options.fail_safe.reset();
  ActuatorState state = ExecutorRig::At("GREEN", {6, 1});
  state.effective = "ALERT";
  ExecutorRig rig(state, options);
  rig.FinishSurvey("COMPROMISED");
  EXPECT_EQ(rig.PopJobs(), ">COMPROMISED");
}

TEST(LevelControllerSurveyTest, WithoutSystemModesTheFloorIsEnteredAtOnce) {
  ExecutorRig rig(Lost());
  EXPECT_FALSE(rig.survey().has_value());
  EXPECT_EQ(rig.PopJobs(), ">ALERT");
}

}  // namespace
}  // namespace rips::actuator

#include "policy_server/server/rollout/rollout.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace rips::rollout {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr char kOld[] = "sha256:old";
constexpr char kNew[] = "sha256:new";
constexpr int64_t kSoakNs = 20 * kNanosPerSecond;
const std::vector<std::string> kLevels = {"DEFAULT", "ALERT", "HALT"};

class RolloutTest : public ::testing::Test {
 protected:
  RolloutTest() {
    for (const char* robot : {"r1", "r2", "r3"}) {
      health_[robot] = {.bundle_id = kOld, .watched = true, .level = "DEFAULT", .levels = kLevels};
    }
  }

  static RolloutRecord Record() {
    return {.plan = {.id = "1",
                     .bundle_id = kNew,
                     .name = "warehouse",
                     .operator_name = "alice",
                     .stages = {{"r1"}, {"r2", "r3"}},
                     .soak_ns = kSoakNs,
                     .alerts_per_minute_max = 5}};
  }
  void Begin() {
    const RolloutStep step = rollout_.Begin(health_, now_);
    EXPECT_THAT(step.activate, ElementsAre("r1"));
  }
  void Take(const std::vector<std::string>& robots) {
    for (const std::string& robot : robots) health_[robot].bundle_id = kNew;
  }
  // Looks each second for so long, until something is to be done.
  RolloutStep LookFor(int64_t ns) {
    for (const int64_t until = now_.boottime_ns + ns; now_.boottime_ns < until;) {
      Pass(kNanosPerSecond);
      RolloutStep step = rollout_.Look(health_, now_);
      if (!step.empty()) return step;
    }
    return {};
  }
  void Pass(int64_t ns) {
    now_.boottime_ns += ns;
    now_.unix_ns += ns;
  }
  const std::string& why() const { return rollout_.record().why; }

  Instant now_{.boottime_ns = 1'000 * kNanosPerSecond, .unix_ns = 5'000 * kNanosPerSecond};
  FleetHealth health_;
  Rollout rollout_{Record(), now_, /*restarted=*/false};
};

TEST_F(RolloutTest, GoesFromStageToStageWhenRobotsHaveBeenHealthyForTheSoakTime) {
  Begin();
  EXPECT_THAT(LookFor(5 * kNanosPerSecond), ::testing::Property(&RolloutStep::empty, true));
  Take({"r1"});
  EXPECT_TRUE(LookFor(kSoakNs).empty());
  EXPECT_THAT(LookFor(2 * kNanosPerSecond).activate, ElementsAre("r2", "r3"));
  EXPECT_EQ(rollout_.record().stage, 1u);
  Take({"r2", "r3"});
  const RolloutStep last = LookFor(kSoakNs + 2 * kNanosPerSecond);
  EXPECT_TRUE(last.over);
  EXPECT_EQ(rollout_.record().state, RolloutState::kDone);
  EXPECT_EQ(rollout_.record().ended_unix_ns, now_.unix_ns);
  EXPECT_TRUE(rollout_.Look(health_, now_).empty());
}

TEST_F(RolloutTest, StopsWhenARobotDoesNotTakeTheBundleAndSaysWhy) {
  Begin();
  health_["r1"].problem = "bundle sha256:new was not taken: its levels differ";
  EXPECT_TRUE(LookFor(kTakeNs).empty());
  EXPECT_TRUE(LookFor(2 * kNanosPerSecond).over);
  EXPECT_EQ(rollout_.record().state, RolloutState::kStopped);
  EXPECT_THAT(why(), HasSubstr("r1: it has not taken the bundle: bundle sha256:new was not taken"));
}

TEST_F(RolloutTest, StopsWhenARobotThatHasIsDegradedForLongAndLeavesTheOthersAlone) {
  Begin();
  Take({"r1"});
  LookFor(5 * kNanosPerSecond);
  health_["r1"].degraded = {"sensor base is not connected"};
  EXPECT_TRUE(LookFor(kGraceNs).empty());
  const RolloutStep stopped = LookFor(2 * kNanosPerSecond);
  EXPECT_TRUE(stopped.over);
  EXPECT_THAT(stopped.activate, IsEmpty());
  EXPECT_THAT(stopped.roll_back, IsEmpty());
  EXPECT_EQ(why(), "r1: it is degraded: sensor base is not connected");
}

TEST_F(RolloutTest, AShortTroubleBeginsTheSoakTimeAnew) {
  Begin();
  Take({"r1"});
  LookFor(kSoakNs - 2 * kNanosPerSecond);
  health_["r1"].degraded = {"the graph of sensor base has not settled"};
  EXPECT_TRUE(LookFor(5 * kNanosPerSecond).empty());
  EXPECT_FALSE(rollout_.healthy_since_unix_ns().has_value());
  health_["r1"].degraded.clear();
  EXPECT_TRUE(LookFor(kSoakNs).empty());
  EXPECT_FALSE(LookFor(3 * kNanosPerSecond).empty());
}

TEST_F(RolloutTest, StopsWhenARobotIsWellInBetweenOnly) {
  Begin();
  Take({"r1"});
  RolloutStep stopped;
  for (int i = 0; i < 6 && stopped.empty(); ++i) {
    health_["r1"].degraded = {"sensor base is silent"};
    stopped = LookFor(4 * kNanosPerSecond);
    if (!stopped.empty()) break;
    health_["r1"].degraded.clear();
    stopped = LookFor(2 * kNanosPerSecond);
  }
  EXPECT_TRUE(stopped.over);
  EXPECT_EQ(why(), "r1: it is degraded: sensor base is silent");
}

TEST_F(RolloutTest, WhatWasWrongBeforeStopsNothingWhateverItsNumbers) {
  health_["r1"].degraded = {"actuator base: disk has 12 MB left"};
  Begin();
  Take({"r1"});
  health_["r1"].degraded = {"actuator base: disk has 7 MB left"};
  EXPECT_THAT(LookFor(kSoakNs + 2 * kNanosPerSecond).activate, ElementsAre("r2", "r3"));
}

TEST_F(RolloutTest, StopsAtOnceWhenALevelRoseOrRulesRaiseTooManyAlerts) {
  health_["r1"].level = "ALERT";
  Begin();
  Take({"r1"});
  EXPECT_TRUE(rollout_.Look(health_, now_).empty());
  Rollout other = rollout_;
  health_["r1"].level = "HALT";
  EXPECT_TRUE(rollout_.Look(health_, now_).over);
  EXPECT_EQ(why(), "r1: its level rose to HALT (`ripsctl explain r1`)");
  health_["r1"].level = "DEFAULT";
  health_["r1"].alerts = 5;
  EXPECT_TRUE(other.Look(health_, now_).empty());
  health_["r1"].alerts = 6;
  EXPECT_TRUE(other.Look(health_, now_).over);
  EXPECT_THAT(other.record().why, HasSubstr("6 alerts within a minute, more than 5"));
}

TEST_F(RolloutTest, LevelsAreComparedByTheTableInForceNow) {
  health_["r1"].level = "ALERT";
  Begin();
  Take({"r1"});
  // The bundle has one more below it: nothing has risen.
  health_["r1"].levels = {"DEFAULT", "NOTICE", "ALERT", "HALT"};
  EXPECT_TRUE(rollout_.Look(health_, now_).empty());
  // It has it no more, and one of a lower place than ALERT had is more than none.
  health_["r1"].levels = {"DEFAULT", "HALT"};
  health_["r1"].level = "DEFAULT";
  EXPECT_TRUE(rollout_.Look(health_, now_).empty());
  health_["r1"].level = "HALT";
  EXPECT_TRUE(rollout_.Look(health_, now_).over);
  EXPECT_THAT(why(), HasSubstr("r1: its level rose to HALT"));
}

TEST_F(RolloutTest, TimeToTakeTheBundleIsNoTimeOfTrouble) {
  Begin();
  EXPECT_TRUE(LookFor(kTakeNs - 5 * kNanosPerSecond).empty());
  Take({"r1"});
  health_["r1"].degraded = {"the graph of sensor base has not settled"};
  EXPECT_TRUE(LookFor(kGraceNs - 2 * kNanosPerSecond).empty());
  health_["r1"].degraded.clear();
  EXPECT_THAT(LookFor(kSoakNs + 2 * kNanosPerSecond).activate, ElementsAre("r2", "r3"));
}

TEST_F(RolloutTest, ARobotOfAStageThatHasNotBegunDoesNotCount) {
  Begin();
  Take({"r1"});
  health_["r2"].level = "HALT";
  health_.erase("r3");
  EXPECT_THAT(LookFor(kSoakNs + 2 * kNanosPerSecond).activate, ElementsAre("r2", "r3"));
  // What r2 was like then is no harm; that r3 does not answer is.
  Take({"r2"});
  EXPECT_TRUE(LookFor(kTakeNs).empty());
  EXPECT_TRUE(LookFor(2 * kNanosPerSecond).over);
  EXPECT_EQ(why(), "r3: it does not answer");
}

TEST_F(RolloutTest, ARobotOfAnEarlierStageStillCounts) {
  Begin();
  Take({"r1"});
  LookFor(kSoakNs + 2 * kNanosPerSecond);
  Take({"r2", "r3"});
  health_["r1"].level = "ALERT";
  EXPECT_TRUE(LookFor(kNanosPerSecond).over);
  EXPECT_THAT(why(), HasSubstr("r1: its level rose"));
}

TEST_F(RolloutTest, GoesBackByItselfIfThePlanWantsIt) {
  RolloutRecord record = Record();
  record.plan.roll_back_when_stopped = true;
  rollout_ = Rollout(record, now_, false);
  Begin();
  Take({"r1"});
  health_["r1"].level = "ALERT";
  EXPECT_THAT(LookFor(kNanosPerSecond).roll_back, ElementsAre("r1"));
}

TEST_F(RolloutTest, AnOperatorStopsItOnceAndTakesNothingBack) {
  Begin();
  RolloutRecord record = Record();
  const RolloutStep step = rollout_.Stop("alice: lunch", now_);
  EXPECT_TRUE(step.over);
  EXPECT_THAT(step.roll_back, IsEmpty());
  EXPECT_TRUE(rollout_.Stop("bob: too", now_).empty());
  EXPECT_EQ(why(), "alice: lunch");
}

TEST_F(RolloutTest, AfterARestartSensorsHaveTimeToComeBackButALevelMustNotRise) {
  Begin();
  Take({"r1"});
  Rollout restarted(rollout_.record(), now_, /*restarted=*/true);
  rollout_ = restarted;
  health_["r1"].degraded = {"sensor base is not connected"};
  health_["r1"].alerts = 100;
  EXPECT_TRUE(LookFor(kRestartGraceNs - 2 * kNanosPerSecond).empty());
  health_["r1"].degraded.clear();
  health_["r1"].alerts = 0;
  EXPECT_TRUE(LookFor(kSoakNs).empty());
  EXPECT_THAT(LookFor(4 * kNanosPerSecond).activate, ElementsAre("r2", "r3"));

  rollout_ = restarted;
  health_["r1"].level = "ALERT";
  EXPECT_TRUE(LookFor(kNanosPerSecond).over);
}

TEST_F(RolloutTest, AHeldRobotMayBeMendedByIt) {
  health_["r1"] = {.degraded = {"no policy: bundle `warehouse` is refused"}};
  Begin();
  health_["r1"] = {.bundle_id = kNew, .watched = true, .level = "HALT", .levels = kLevels};
  EXPECT_THAT(LookFor(kSoakNs + 2 * kNanosPerSecond).activate, ElementsAre("r2", "r3"));
}

TEST_F(RolloutTest, AStageThatNoSensorWatchesProvesNothing) {
  health_["r1"].watched = false;
  health_["r1"].degraded = {"sensor base is not connected"};
  Begin();
  Take({"r1"});
  EXPECT_TRUE(LookFor(10 * kSoakNs).empty());
  EXPECT_THAT(rollout_.not_healthy_because(), HasSubstr("no sensor of a robot of this stage"));
  health_["r1"].watched = true;
  health_["r1"].degraded.clear();
  EXPECT_THAT(LookFor(kSoakNs + 2 * kNanosPerSecond).activate, ElementsAre("r2", "r3"));
  // Of several robots one is enough.
  Take({"r2", "r3"});
  health_["r3"].watched = false;
  EXPECT_TRUE(LookFor(kSoakNs + 2 * kNanosPerSecond).over);
  EXPECT_EQ(rollout_.record().state, RolloutState::kDone);
}

TEST_F(RolloutTest, ARobotThatLeftTheInventoryDoesNotCount) {
  Begin();
  Take({"r1"});
  LookFor(kSoakNs + 2 * kNanosPerSecond);
  Take({"r2"});
  health_["r3"] = {.gone = true};
  EXPECT_TRUE(LookFor(kSoakNs + 2 * kNanosPerSecond).over);
  EXPECT_EQ(rollout_.record().state, RolloutState::kDone);
}

TEST_F(RolloutTest, SaysWhyAStageIsNotHealthyYet) {
  Begin();
  LookFor(kNanosPerSecond);
  EXPECT_EQ(rollout_.not_healthy_because(), "r1: it has not taken the bundle");
  Take({"r1"});
  health_["r1"].degraded = {"the graph of sensor base has not settled"};
  LookFor(kNanosPerSecond);
  EXPECT_THAT(rollout_.not_healthy_because(), HasSubstr("r1: it is degraded: the graph"));
  health_["r1"].degraded.clear();
  LookFor(kNanosPerSecond);
  EXPECT_EQ(rollout_.not_healthy_because(), "");
}

}  // namespace
}  // namespace rips::rollout

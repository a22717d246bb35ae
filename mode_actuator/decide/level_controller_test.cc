#include "mode_actuator/decide/level_controller.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/decide/level_controller_test_rig.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr int64_t kS = 1'000;  // milliseconds

TEST(LevelControllerTest, RefusesOptionsThatContradictThemselves) {
  ExecutorOptions options = ExecutorRig::Options();
  options.fail_safe = "GREEN";
  EXPECT_THAT(LevelController::Create(options, ExecutorRig::At("DEFAULT"), 0),
              StatusIs(absl::StatusCode::kInvalidArgument, "`GREEN` is no level"));
  options.levels.clear();
  EXPECT_THAT(LevelController::Create(options, ExecutorRig::At("DEFAULT"), 0),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST(LevelControllerTest, ReappliesTheLastEffectiveLevelAtStart) {
  ExecutorRig rig(ExecutorRig::At("COMPROMISED", {3, 7}));

  EXPECT_EQ(rig.PopJobs(), ">COMPROMISED");
  EXPECT_EQ(rig.report().decision_id, (DecisionId{3, 7}));
  EXPECT_EQ(rig.report().highest_term, 3u);
  EXPECT_TRUE(rig.report().verified);
  EXPECT_FALSE(rig.report().state_lost);
}

TEST(LevelControllerTest, ARaiseIsAppliedBeforeItIsRecordedAndVerifiedAfterReadBack) {
  ExecutorRig rig;
  rig.auto_finish = rig.auto_persist = false;
  rig.PopOrder();

  rig.Level("COMPROMISED", {1, 2});

  EXPECT_THAT(rig.PopOrder(), ElementsAre("apply COMPROMISED", "write", "id-1.2 acknowledged"));
  EXPECT_EQ(rig.report().effective, "COMPROMISED");
  EXPECT_FALSE(rig.report().verified);
  EXPECT_EQ(rig.writes().back().state.decided, "COMPROMISED");
  EXPECT_EQ(rig.writes().back().state.effective, "COMPROMISED");
  rig.Finish(true);
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 acknowledged", "id-1.2 verified"));
  EXPECT_EQ(rig.report().observed, "/safety=COMPROMISED");
}

TEST(LevelControllerTest, ALoweringIsRecordedBeforeItIsApplied) {
  ExecutorRig rig(ExecutorRig::At("HALT", {1, 1}));
  rig.auto_finish = rig.auto_persist = false;
  rig.PopOrder();
  rig.PopJobs();

  rig.Level("DEFAULT", {1, 2}, DecisionId{1, 1});

  EXPECT_THAT(rig.PopOrder(), ElementsAre("write"));
  EXPECT_EQ(rig.report().decided, "HALT");
  EXPECT_EQ(rig.writes().front().state.decided, "DEFAULT");
  EXPECT_EQ(rig.writes().front().state.effective, "HALT");
  rig.FinishWrite();
  EXPECT_THAT(rig.PopOrder(), ElementsAre("id-1.2 acknowledged", "apply DEFAULT"));
  EXPECT_EQ(rig.PopJobs(), "HALT>DEFAULT down");
  EXPECT_EQ(rig.report().decided, "DEFAULT");
  EXPECT_EQ(rig.report().effective, "HALT");  // until it is read back
  rig.Finish(true);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 acknowledged", "id-1.2 verified"));
}

TEST(LevelControllerTest, ALoweringThatCannotBeRecordedIsNotApplied) {
  ExecutorRig rig(ExecutorRig::At("HALT", {1, 1}));
  rig.disk_works = false;
  rig.PopJobs();

  rig.Level("DEFAULT", {1, 2}, DecisionId{1, 1});

  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 failed"));
  EXPECT_THAT(rig.last_detail(), HasSubstr("cannot be recorded: disk full"));
  EXPECT_EQ(rig.report().decided, "HALT");
  EXPECT_EQ(rig.PopJobs(), "");
  // The same command is judged afresh once the disk works.
  rig.disk_works = true;
  rig.Level("DEFAULT", {1, 2}, DecisionId{1, 1});
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 acknowledged", "id-1.2 verified"));
}

TEST(LevelControllerTest, ARaiseIsAppliedEvenIfItCannotBeRecordedAndTheRecordIsTriedAgain) {
  ExecutorRig rig;
  rig.disk_works = false;
  rig.Level("HALT", {1, 2});
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 acknowledged", "id-1.2 verified"));
  EXPECT_EQ(rig.disk()->decided, "DEFAULT");

  rig.disk_works = true;
  rig.Advance(2 * kS);

  EXPECT_EQ(rig.disk()->decided, "HALT");
}

// One row of the table in the header each.
TEST(LevelControllerTest, JudgesCommands) {
  const struct {
    const char* name;
    const char* to;
    DecisionId decision_id;
    DecisionId based_on;
    uint64_t term;
    std::vector<std::string> receipts;
    const char* decided;
  } kCases[] = {
      {"stale term", "HALT", {4, 9}, {}, 4, {"x refused_stale"}, "ALERT"},
      {"stale term, lowering", "DEFAULT", {4, 9}, {5, 5}, 4, {"x refused_stale"}, "ALERT"},
      {"no decision", "HALT", {0, 0}, {}, 5, {"x refused"}, "ALERT"},
      {"decision of a later term", "HALT", {6, 6}, {}, 5, {"x refused"}, "ALERT"},
      {"unknown level", "GREEN", {5, 6}, {}, 5, {"x refused"}, "ALERT"},
      {"held decision", "ALERT", {5, 5}, {}, 5, {"x acknowledged", "x verified"}, "ALERT"},
      {"held decision, other level", "HALT", {5, 5}, {}, 5, {"x refused"}, "ALERT"},
      {"older decision", "HALT", {5, 4}, {}, 5, {"x refused_stale"}, "ALERT"},
      {"older decision, lowering", "DEFAULT", {5, 4}, {5, 5}, 5, {"x refused_stale"}, "ALERT"},
      {"lowering on nothing", "DEFAULT", {5, 6}, {}, 5, {"x refused"}, "ALERT"},
      {"lowering on another", "DEFAULT", {5, 6}, {5, 4}, 5, {"x refused"}, "ALERT"},
      {"lowering", "DEFAULT", {5, 6}, {5, 5}, 5, {"x acknowledged", "x verified"}, "DEFAULT"},
      {"equal", "ALERT", {5, 6}, {}, 5, {"x acknowledged", "x verified"}, "ALERT"},
      {"raise", "HALT", {5, 6}, {}, 5, {"x acknowledged", "x verified"}, "HALT"},
      {"raise of a later term", "HALT", {7, 6}, {}, 7, {"x acknowledged", "x verified"}, "HALT"},
      {"decision of an older term",
       "HALT",
       {5, 6},
       {},
       7,
       {"x acknowledged", "x verified"},
       "HALT"},
  };
  for (const auto& test : kCases) {
    ExecutorRig rig(ExecutorRig::At("ALERT", {5, 5}));
    rig.PopReceipts();
    rig.Level(test.to, test.decision_id, test.based_on, "x", test.term);
    EXPECT_EQ(rig.PopReceipts(), test.receipts) << test.name << ": " << rig.last_detail();
    EXPECT_EQ(rig.report().decided, test.decided) << test.name;
    EXPECT_EQ(rig.report().highest_term, std::max<uint64_t>(5, test.term)) << test.name;
  }
}

TEST(LevelControllerTest, AHigherTermIsRecordedAndFencesAfterARestart) {
  ExecutorRig rig(ExecutorRig::At("ALERT", {5, 5}));
  EXPECT_TRUE(rig.executor().AdmitTerm(9));
  rig.Advance(100);

  ExecutorRig next = rig.Restarted();

  EXPECT_FALSE(next.executor().AdmitTerm(8));
  next.Level("HALT", {8, 6}, {}, "x", 8);
  EXPECT_THAT(next.PopReceipts(), ElementsAre("x refused_stale"));
}

TEST(LevelControllerTest, ADuplicateGetsTheSameReceiptAndDoesNothing) {
  ExecutorRig rig;
  rig.Level("ALERT", {1, 2});
  rig.Level("HALT", {1, 3});
  rig.PopReceipts();
  rig.PopJobs();

  rig.Level("ALERT", {1, 2});
  rig.Level("HALT", {1, 3});

  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 verified", "id-1.3 verified"));
  EXPECT_EQ(rig.PopJobs(), "");
  EXPECT_EQ(rig.report().effective, "HALT");
}

TEST(LevelControllerTest, TheHeldDecisionSentAgainIsVerifiedWithoutEnteringTwice) {
  ExecutorRig rig(ExecutorRig::At("COMPROMISED", {1, 4}));
  rig.PopJobs();

  rig.term = 2;  // a restarted server sends its newest decision under a new id
  rig.Level("COMPROMISED", {1, 4}, {}, "again");

  EXPECT_THAT(rig.PopReceipts(), ElementsAre("again acknowledged", "again verified"));
  EXPECT_EQ(rig.PopJobs(), "");
}

TEST(LevelControllerTest, AMoreRestrictiveCommandPreempts) {
  ExecutorRig rig;
  rig.auto_finish = false;
  rig.PopJobs();
  rig.Level("ALERT", {1, 2});
  const ApplyLevel first = *rig.job();

  rig.Level("HALT", {1, 3});

  EXPECT_EQ(rig.PopJobs(), "DEFAULT>ALERT, ALERT>HALT");
  EXPECT_THAT(rig.PopReceipts(),
              ElementsAre("id-1.2 acknowledged", "id-1.2 superseded", "id-1.3 acknowledged"));
  rig.FinishJob(first, true);  // what was replaced says nothing any more
  EXPECT_FALSE(rig.report().verified);
  EXPECT_THAT(rig.PopReceipts(), IsEmpty());
  rig.Finish(true);
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.3 verified"));
}

TEST(LevelControllerTest, OfLessRestrictiveCommandsTheNewestWaits) {
  ExecutorRig rig;
  rig.auto_finish = false;
  rig.PopJobs();
  rig.Level("HALT", {1, 2});
  rig.Level("COMPROMISED", {1, 3}, DecisionId{1, 2});
  rig.Level("DEFAULT", {1, 4}, DecisionId{1, 3});

  EXPECT_EQ(rig.PopJobs(), "DEFAULT>HALT");
  EXPECT_EQ(rig.report().effective, "HALT");
  rig.Finish(true);
  EXPECT_EQ(rig.PopJobs(), "HALT>DEFAULT down");
  rig.Finish(true);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
  EXPECT_THAT(rig.PopReceipts(),
              ElementsAre("id-1.2 acknowledged", "id-1.2 superseded", "id-1.3 acknowledged",
                          "id-1.3 superseded", "id-1.4 acknowledged", "id-1.4 verified"));
}

TEST(LevelControllerTest, ARaiseStopsALoweringThatIsBeingRecorded) {
  ExecutorRig rig(ExecutorRig::At("HALT", {1, 1}));
  rig.auto_persist = false;
  rig.PopJobs();
  rig.Level("DEFAULT", {1, 2}, DecisionId{1, 1});

  rig.Level("HALT", {1, 3});
  rig.FinishWrite();
  rig.FinishWrite();

  EXPECT_EQ(rig.PopJobs(), "");
  EXPECT_EQ(rig.report().effective, "HALT");
  EXPECT_EQ(rig.disk()->decided, "HALT");
  EXPECT_EQ(rig.disk()->decision_id, (DecisionId{1, 3}));
  EXPECT_THAT(rig.PopReceipts(),
              ElementsAre("id-1.2 superseded", "id-1.3 acknowledged", "id-1.3 verified"));
}

TEST(LevelControllerTest, ALoweringMayBeBasedOnTheOneBeingRecorded) {
  ExecutorRig rig(ExecutorRig::At("HALT", {1, 1}));
  rig.auto_persist = false;
  rig.Level("COMPROMISED", {1, 2}, DecisionId{1, 1});
  rig.Level("ALERT", {1, 3}, DecisionId{1, 2});
  rig.auto_persist = true;
  rig.FinishWrite();

  EXPECT_EQ(rig.report().effective, "ALERT");
  EXPECT_THAT(rig.PopReceipts(),
              ElementsAre("id-1.2 superseded", "id-1.3 acknowledged", "id-1.3 verified"));
}

TEST(LevelControllerTest, ACrashWhileALoweringIsUnderWayComesBackAtTheOldLevel) {
  ExecutorRig rig(ExecutorRig::At("HALT", {1, 1}));
  rig.auto_finish = false;
  rig.Level("DEFAULT", {1, 2}, DecisionId{1, 1});
  EXPECT_EQ(rig.disk()->decided, "DEFAULT");

  ExecutorRig next = rig.Restarted();

  EXPECT_EQ(next.report().effective, "HALT");
  EXPECT_EQ(next.report().floor_reason, "restart");
  EXPECT_EQ(next.report().decision_id, (DecisionId{1, 2}));
  next.lease = true;
  next.Advance(11 * kS);
  EXPECT_EQ(next.report().effective, "DEFAULT");
}

// --- failure

TEST(LevelControllerTest, AFailedRaiseIsReportedOnceAndTriedUntilItIsReached) {
  ExecutorRig rig;
  rig.robot_reaches = false;
  rig.PopJobs();

  rig.Level("COMPROMISED", {1, 2});

  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 acknowledged", "id-1.2 failed"));
  EXPECT_EQ(rig.last_detail(), "lies");
  EXPECT_EQ(rig.report().effective, "COMPROMISED");
  EXPECT_FALSE(rig.report().verified);
  rig.Advance(20 * kS);  // retries after 2, 4, 8 s
  EXPECT_EQ(rig.PopJobs(),
            "DEFAULT>COMPROMISED, DEFAULT>COMPROMISED retry, DEFAULT>COMPROMISED retry, "
            "DEFAULT>COMPROMISED retry");
  EXPECT_THAT(rig.PopReceipts(), IsEmpty());
  rig.robot_reaches = true;
  rig.Advance(10 * kS);
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 verified"));
}

TEST(LevelControllerTest, AFailedLoweringKeepsTheEffectiveLevel) {
  ExecutorRig rig(ExecutorRig::At("HALT", {1, 1}));
  rig.robot_reaches = false;

  rig.Level("DEFAULT", {1, 2}, DecisionId{1, 1});

  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 acknowledged", "id-1.2 failed"));
  EXPECT_EQ(rig.report().effective, "HALT");
  EXPECT_EQ(rig.report().decided, "DEFAULT");
  rig.robot_reaches = true;
  rig.lease = true;  // else a floor would rise meanwhile
  rig.Advance(3 * kS);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 verified"));
}

// Finds the level left, and enters it again, `times`.
void LeaveLevel(ExecutorRig& rig, int times) {
  for (int i = 0; i < times; ++i) {
    for (int step = 0; step < 100 && !rig.job().has_value(); ++step) rig.Advance(50);
    ASSERT_TRUE(rig.job().has_value());
    ASSERT_EQ(rig.job()->kind, JobKind::kCheck);
    rig.Finish(false);
    ASSERT_EQ(rig.job()->kind, JobKind::kRetry);
    if (i + 1 < times) rig.Finish(true);
  }
}

ExecutorOptions WithOnDrift() {
  ExecutorOptions options = ExecutorRig::Options();
  options.on_drift = {"ALERT"};
  return options;
}

TEST(LevelControllerTest, OnDriftFollowsTheThirdDriftOnceAfterTheLevelWasOrderedAgain) {
  ExecutorRig rig(ExecutorRig::At("ALERT"), WithOnDrift());
  rig.auto_finish = false;
  rig.lease = true;
  rig.PopJobs();
  LeaveLevel(rig, 3);
  EXPECT_THAT(rig.report().degraded,
              ElementsAre("ALERT was left again and again: 3 times in 60 s"));
  rig.Finish(false, "lies");  // that it does not help is no reason to wait
  ASSERT_TRUE(rig.job().has_value());
  EXPECT_EQ(rig.job()->kind, JobKind::kOnDrift);
  EXPECT_EQ(rig.job()->to, "ALERT");
  rig.Finish(false, "program horn: exit code 1");
  EXPECT_THAT(rig.report().degraded, ElementsAre(HasSubstr("failed: program horn: exit code 1")));
  EXPECT_EQ(rig.PopJobs(), ">ALERT retry, >ALERT retry, >ALERT retry, >ALERT on_drift");
  rig.Advance(3 * kS);
  rig.Finish(true);
  LeaveLevel(rig, 1);
  rig.Finish(true);
  EXPECT_EQ(rig.PopJobs(), ">ALERT retry, >ALERT retry");  // not again within the window
  EXPECT_EQ(rig.report().drifts, 4u);
  rig.auto_finish = true;
  rig.Advance(61 * kS);
  EXPECT_THAT(rig.report().degraded, IsEmpty());
}

TEST(LevelControllerTest, WithoutOnDriftStepsItIsToldOnly) {
  ExecutorRig rig(ExecutorRig::At("ALERT"));
  rig.auto_finish = false;
  rig.lease = true;
  LeaveLevel(rig, 3);
  rig.Finish(true);
  EXPECT_FALSE(rig.job().has_value());
  EXPECT_THAT(rig.report().degraded, ElementsAre(HasSubstr("left again and again")));
}

TEST(LevelControllerTest, ARaiseDoesNotWaitForOnDriftSteps) {
  ExecutorRig rig(ExecutorRig::At("ALERT"), WithOnDrift());
  rig.auto_finish = false;
  rig.lease = true;
  LeaveLevel(rig, 3);
  rig.Finish(true);
  ASSERT_EQ(rig.job()->kind, JobKind::kOnDrift);
  const ApplyLevel on_drift = *rig.job();
  rig.PopJobs();
  rig.Level("COMPROMISED", {1, 2});
  EXPECT_EQ(rig.PopJobs(), "ALERT>COMPROMISED");
  rig.FinishJob(on_drift, true);  // late, and of a job that was replaced
  EXPECT_THAT(rig.report().degraded, IsEmpty());
  rig.Finish(true);
  EXPECT_EQ(rig.report().effective, "COMPROMISED");
  EXPECT_TRUE(rig.report().verified);
}

TEST(LevelControllerTest, DriftIsCountedAndTheLevelIsReassertedAtOnce) {
  ExecutorRig rig(ExecutorRig::At("ALERT"));
  rig.auto_finish = false;
  rig.PopJobs();
  rig.Advance(2 * kS + 100);
  ASSERT_TRUE(rig.job().has_value());
  ASSERT_EQ(rig.job()->kind, JobKind::kCheck);

  rig.Finish(false);

  EXPECT_EQ(rig.report().drifts, 1u);
  EXPECT_FALSE(rig.report().verified);
  EXPECT_EQ(rig.PopJobs(), ">ALERT retry");
  rig.Finish(true);
  EXPECT_TRUE(rig.report().verified);
}

// --- lease and floor

TEST(LevelControllerTest, TheLeaseRunsFromTheEchoAndNotFromArrival) {
  ExecutorRig rig;
  EXPECT_TRUE(rig.Grant(/*echo_age_ms=*/14'000));
  rig.Advance(900);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
  rig.Advance(200);
  EXPECT_EQ(rig.report().effective, "ALERT");
  EXPECT_EQ(rig.report().floor_reason, "lease expired");
  EXPECT_EQ(rig.report().decided, "DEFAULT");
}

TEST(LevelControllerTest, IgnoresLeasesThatCannotBe) {
  ExecutorRig rig;
  EXPECT_TRUE(rig.Grant(1'000));
  EXPECT_FALSE(rig.Grant(2'000));  // an older echo
  EXPECT_FALSE(rig.Grant(-1));     // an echo from the future
  EXPECT_FALSE(rig.executor().OnLease({.echo_boottime_ns = 0, .term = 1, .ttl_ms = 1}, 5));
  rig.term = 0;
  EXPECT_FALSE(rig.Grant());
  rig.term = 4;
  EXPECT_TRUE(rig.Grant());
  rig.term = 3;
  EXPECT_FALSE(rig.Grant());
  EXPECT_EQ(rig.report().highest_term, 4u);
}

TEST(LevelControllerTest, ALeaseHasALimit) {
  ExecutorRig rig;
  EXPECT_TRUE(rig.Grant(0, /*ttl_ms=*/4'000'000'000));
  rig.Advance(kLeaseNsMax / ExecutorRig::kMs - 100);
  EXPECT_EQ(rig.report().floor, "");
  rig.Advance(200);
  EXPECT_EQ(rig.report().floor, "ALERT");
}

TEST(LevelControllerTest, FailSafeWaitsForItsTime) {
  ExecutorOptions options = ExecutorRig::Options();
  options.fail_safe_after_ns = 20 * kNanosPerSecond;
  ExecutorRig rig(ExecutorRig::At("DEFAULT"), options);
  rig.Grant();
  rig.Advance(34 * kS + 900);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
  rig.Advance(200);
  EXPECT_EQ(rig.report().effective, "ALERT");
}

TEST(LevelControllerTest, KeepRaisesNothing) {
  ExecutorOptions options = ExecutorRig::Options();
  options.fail_safe.reset();
  ExecutorRig rig(ExecutorRig::At("DEFAULT"), options);
  rig.Advance(60 * kS);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
  EXPECT_EQ(rig.report().floor, "");
}

TEST(LevelControllerTest, ARestartedActuatorWaitsALittleForItsFirstLease) {
  ExecutorRig rig;
  rig.Advance(14 * kS);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
  rig.Advance(2 * kS);
  EXPECT_EQ(rig.report().effective, "ALERT");
}

TEST(LevelControllerTest, AFloorBelowTheDecisionChangesNothing) {
  ExecutorRig rig(ExecutorRig::At("HALT"));
  rig.PopJobs();
  rig.Advance(30 * kS);
  EXPECT_EQ(rig.report().floor, "ALERT");
  EXPECT_EQ(rig.report().effective, "HALT");
  EXPECT_EQ(rig.PopJobs(), "");
}

TEST(LevelControllerTest, AFloorHoldsBackALoweringUntilItLifts) {
  ExecutorRig rig(ExecutorRig::At("HALT", {1, 1}));
  rig.Advance(30 * kS);
  rig.Grant();
  rig.Level("DEFAULT", {1, 2}, DecisionId{1, 1});

  EXPECT_EQ(rig.report().decided, "DEFAULT");
  EXPECT_EQ(rig.report().effective, "ALERT");
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 acknowledged"));
  rig.lease = true;
  rig.Advance(11 * kS);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 verified"));
}

TEST(LevelControllerTest, ARaiseBelowTheFloorIsVerifiedAtTheFloor) {
  ExecutorOptions options = ExecutorRig::Options();
  options.fail_safe = "HALT";
  ExecutorRig rig(ExecutorRig::At("DEFAULT"), options);
  rig.Advance(20 * kS);
  rig.PopJobs();

  rig.Level("ALERT", {1, 2});

  EXPECT_EQ(rig.report().effective, "HALT");
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 acknowledged", "id-1.2 verified"));
  EXPECT_EQ(rig.PopJobs(), "");
}

TEST(LevelControllerTest, AFloorLiftsAfterTenSecondsOfALiveLeaseOfTheCurrentTerm) {
  ExecutorRig rig;
  rig.Advance(16 * kS);
  ASSERT_EQ(rig.report().effective, "ALERT");
  rig.lease = true;
  rig.Advance(9 * kS);
  EXPECT_EQ(rig.report().effective, "ALERT");
  rig.term = 2;  // another server: the ten seconds begin again
  rig.Advance(9 * kS);
  EXPECT_EQ(rig.report().effective, "ALERT");
  rig.Advance(2 * kS);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
  EXPECT_EQ(rig.report().floor_reason, "");
  EXPECT_EQ(rig.disk()->effective, "DEFAULT");
}

TEST(LevelControllerTest, AFloorDoesNotLiftWithoutEvidence) {
  ExecutorRig rig;
  rig.Advance(16 * kS);
  rig.lease = true;
  rig.evidence = false;
  rig.Advance(60 * kS);
  EXPECT_EQ(rig.report().effective, "ALERT");
  rig.evidence = true;
  rig.Advance(1 * kS);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
}

TEST(LevelControllerTest, AFloorDoesNotLiftWhileTheRecordIsBehind) {
  ExecutorRig rig;
  rig.disk_works = false;
  rig.Advance(16 * kS);
  rig.lease = true;
  rig.Advance(60 * kS);
  EXPECT_EQ(rig.report().effective, "ALERT");
  rig.disk_works = true;
  rig.Advance(2 * kS);
  EXPECT_EQ(rig.report().effective, "DEFAULT");
}

TEST(LevelControllerTest, EachRepeatedLossDoublesTheWait) {
  ExecutorRig rig;
  const auto lose_and_regain = [&] {
    rig.lease = false;
    rig.Advance(16 * kS);
    EXPECT_EQ(rig.report().effective, "ALERT");
    rig.lease = true;
    int64_t waited = 0;
    while (rig.report().effective == "ALERT" && waited < 1'000 * kS) {
      rig.Advance(500);
      waited += 500;
    }
    return waited / kS;
  };
  EXPECT_EQ(lose_and_regain(), 10);
  EXPECT_EQ(lose_and_regain(), 20);
  EXPECT_EQ(lose_and_regain(), 40);
  EXPECT_EQ(lose_and_regain(), 80);
  EXPECT_EQ(lose_and_regain(), 160);
  EXPECT_LE(lose_and_regain(), 300);
  rig.Advance(700 * kS);  // ten quiet minutes forgive
  EXPECT_EQ(lose_and_regain(), 10);
}

TEST(LevelControllerTest, AGapNoTickSawIsAGap) {
  ExecutorRig rig;
  rig.lease = true;
  rig.Advance(12 * kS);
  rig.lease = false;
  ASSERT_EQ(rig.report().floor, "");
  LevelController& executor = rig.executor();
  const int64_t later = rig.now_ns() + 3'600 * kNanosPerSecond;  // the host was suspended

  EXPECT_TRUE(executor.OnLease(
      {.echo_boottime_ns = later, .term = 1, .ttl_ms = 15'000, .evidence_complete = true}, later));

  EXPECT_EQ(executor.Report(later).floor, "ALERT");
}

// --- a lost state

TEST(LevelControllerTest, WithoutAStateItHoldsTheFailSafeLevelUntilAServerHasSpoken) {
  for (const absl::Status& why : {absl::NotFoundError("no file"), absl::DataLossError("corrupt")}) {
    ExecutorRig rig(why);
    EXPECT_EQ(rig.report().effective, "ALERT");
    EXPECT_EQ(rig.report().floor_reason, "state lost");
    EXPECT_TRUE(rig.report().state_lost);
    EXPECT_TRUE(rig.report().decision_id.none());
    EXPECT_EQ(rig.report().decided, "");
    rig.lease = true;
    rig.Advance(60 * kS);
    EXPECT_EQ(rig.report().effective, "ALERT");
    EXPECT_TRUE(rig.Restarted().report().state_lost);

    rig.Level("DEFAULT", {1, 1});
    EXPECT_FALSE(rig.report().state_lost);
    rig.Advance(1 * kS);
    EXPECT_EQ(rig.report().effective, "DEFAULT");
  }
}

TEST(LevelControllerTest, WithKeepAndNoStateItHoldsTheMostRestrictiveLevel) {
  ExecutorOptions options = ExecutorRig::Options();
  options.fail_safe.reset();
  ExecutorRig rig(absl::NotFoundError("no file"), options);
  EXPECT_EQ(rig.report().effective, "HALT");
}

TEST(LevelControllerTest, AStateOfOtherLevelsIsLost) {
  ExecutorRig rig(ExecutorRig::At("GREEN", {6, 1}));
  EXPECT_EQ(rig.report().effective, "ALERT");
  EXPECT_TRUE(rig.report().state_lost);
  EXPECT_EQ(rig.report().highest_term, 6u);  // fencing survives
}

TEST(LevelControllerTest, ALostDecisionDoesNotLowerWhatIsKnownToBeHeld) {
  ActuatorState state = ExecutorRig::At("GREEN", {6, 1});
  state.effective = "HALT";
  ExecutorRig rig(state);
  EXPECT_EQ(rig.report().effective, "HALT");
}

// --- limits

TEST(LevelControllerTest, RemembersALimitedNumberOfReceipts) {
  ExecutorRig rig;
  for (uint64_t epoch = 2; epoch < 2 + 2 * kRecentReceiptsMax; ++epoch) {
    rig.Level("HALT", {1, epoch});
  }
  rig.PopReceipts();
  rig.Level("HALT", {1, 2});  // forgotten, but its decision id tells
  EXPECT_THAT(rig.PopReceipts(), ElementsAre("id-1.2 refused_stale"));
}

}  // namespace
}  // namespace rips::actuator

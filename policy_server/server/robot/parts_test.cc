// A robot's small parts.
#include "absl/container/btree_set.h"
#include "absl/strings/str_format.h"
#include "gmock/gmock.h"
#include "policy_server/server/robot/context/id_source.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::MatchesRegex;
using ::testing::SizeIs;

constexpr int64_t kSecond = kNanosPerSecond;

Instant At(int64_t seconds) { return {.boottime_ns = seconds * kSecond, .unix_ns = seconds}; }

TEST(IdSourceTest, AFewDigitsTellIdsApart) {
  IdSource ids("0123456789abcdef0123456789abcdef");
  IdSource others("0123456789abcdef0123456789abcdee");
  absl::btree_set<std::string> begin;
  for (int i = 0; i < 1'000; ++i) {
    for (IdSource* source : {&ids, &others}) {
      const std::string id = source->Next();
      EXPECT_THAT(id, MatchesRegex("[0-9a-f]{32}"));
      begin.insert(id.substr(0, 8));
    }
  }
  EXPECT_THAT(begin, SizeIs(2'000));
}

TEST(SequenceTrackTest, AcceptsInOrderAndSkipsWhatWasJudged) {
  SequenceTrack track;

  EXPECT_EQ(track.Accept("a", Lane::kControl, 1, 3)->skip, 0u);
  EXPECT_EQ(track.Accept("a", Lane::kControl, 2, 4)->skip, 2u);
  EXPECT_EQ(track.Accept("a", Lane::kControl, 1, 2)->skip, 2u);
  EXPECT_EQ(track.Judged("a", Lane::kControl), 5u);
  EXPECT_EQ(track.Judged("a", Lane::kMessages), 0u);
  EXPECT_EQ(track.Judged("b", Lane::kControl), 0u);
}

TEST(SequenceTrackTest, WhatTheStoreHasIsNotForgottenForOthersOfTheStore) {
  SequenceTrack track;
  track.Load("0 the live one", Lane::kControl, 7);
  for (int i = 0; i < 40; ++i) track.Load(absl::StrCat("x", i), Lane::kControl, 1);
  EXPECT_EQ(track.Judged("0 the live one", Lane::kControl), 7u);

  track.Restore("0 the live one", Lane::kControl, 0);
  for (int i = 0; i < 100; ++i) {
    ASSERT_THAT(track.Accept("0 the live one", Lane::kControl, 8 + i, 1), IsOk());
  }
  EXPECT_EQ(track.Judged("0 the live one", Lane::kControl), 107u);
  EXPECT_EQ(track.all().size(), SequenceTrack::kIncarnationsMax);

  SequenceTrack durable;
  for (const auto& [key, judged] : track.all()) durable.Load(key.first, key.second, judged);
  durable.Load("gone", Lane::kControl, 3);
  durable.KeepOnly(track);
  EXPECT_EQ(durable.all(), track.all());
}

TEST(SequenceTrackTest, WhatASensorAnnouncesIsForgottenLast) {
  SequenceTrack track;
  for (char name = 'a'; name < 'u'; ++name) {
    track.Load(std::string(16, name), Lane::kMessages, 7);
  }
  ASSERT_GT(track.all().size(), SequenceTrack::kIncarnationsMax);
  const std::string oldest(16, 'a');
  const std::string another(16, 'b');
  for (const std::string& announced : {oldest, another, std::string(16, 'z')}) {
    track.Announce(announced);
  }
  track.Restore(another, Lane::kMessages, 7);
  track.Restore(std::string(16, 'y'), Lane::kMessages, 1);
  EXPECT_EQ(track.Judged(oldest, Lane::kMessages), 7u);
  EXPECT_EQ(track.Judged(another, Lane::kMessages), 7u);
  EXPECT_EQ(track.Judged(std::string(16, 'z'), Lane::kMessages), 0u);
}

TEST(SequenceTrackTest, CountsWhatIsMissingInTheMessageLane) {
  SequenceTrack track;

  EXPECT_EQ(track.Accept("a", Lane::kMessages, 11, 2)->missing, 10u);
  EXPECT_EQ(track.Judged("a", Lane::kMessages), 12u);
}

TEST(SequenceTrackTest, RefusesGapsInTheControlLaneAndNonsense) {
  SequenceTrack track;

  EXPECT_THAT(track.Accept("a", Lane::kControl, 2, 1),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(track.Accept("a", Lane::kMessages, 0, 1),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(track.Accept("a", Lane::kMessages, UINT64_MAX, 2),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_EQ(track.Judged("a", Lane::kControl), 0u);
}

TEST(SequenceTrackTest, ForgetsTheOldestIncarnationPastItsLimit) {
  SequenceTrack track;

  for (size_t i = 0; i <= SequenceTrack::kIncarnationsMax; ++i) {
    ASSERT_THAT(track.Accept(absl::StrCat("i", i), Lane::kControl, 1, 1), IsOk());
  }

  EXPECT_EQ(track.Judged("i0", Lane::kControl), 0u);
  EXPECT_EQ(track.Judged("i1", Lane::kControl), 1u);
}

TEST(EvidenceGateTest, IsCompleteOnlyAfterTheWholeHold) {
  EvidenceGate gate(5 * kSecond, At(100));

  EXPECT_THAT(gate.Assess(At(104)).blind_because, SizeIs(1));
  EXPECT_THAT(gate.Assess(At(105)).blind_because, IsEmpty());
}

TEST(EvidenceGateTest, AProblemOrADisturbanceStartsTheHoldAnew) {
  EvidenceGate gate(5 * kSecond, At(100));
  gate.Update({"sensor base is silent"}, true, At(106));
  EXPECT_THAT(gate.Assess(At(106)).blind_because[0], HasSubstr("silent"));

  gate.Update({}, true, At(107));
  EXPECT_THAT(gate.Assess(At(110)).blind_because[0], HasSubstr("4.0 s of 5.0 s"));
  Instant nearly = At(110);
  nearly.boottime_ns += 990 * kNanosPerMilli;
  EXPECT_THAT(gate.Assess(nearly).blind_because[0], HasSubstr("4.9 s of 5.0 s"));
  EXPECT_THAT(gate.Assess(At(112)).blind_because, IsEmpty());

  gate.Disturb("3 observations were lost", At(113));
  EXPECT_THAT(gate.Assess(At(117)).blind_because[0], HasSubstr("were lost"));
  EXPECT_THAT(gate.Assess(At(118)).blind_because, IsEmpty());
}

TEST(EvidenceGateTest, ALevelThatIsNotVerifiedStartsTheHoldAnewAndBreaksNothing) {
  EvidenceGate gate(5 * kSecond, At(100));
  gate.Update({}, false, At(106));
  EXPECT_THAT(gate.Assess(At(106)).blind_because, ElementsAre("the last level is not verified"));
  gate.Restart(At(107));
  gate.Update({}, true, At(108));
  EXPECT_THAT(gate.Assess(At(111)).blind_because[0], HasSubstr("the level has changed"));

  EXPECT_EQ(gate.broken_by(), "");
  gate.Update({"sensor base is silent"}, false, At(112));
  EXPECT_EQ(gate.broken_by(), "sensor base is silent");
  gate.Disturb("3 observations were lost", At(113));
  EXPECT_EQ(gate.broken_by(), "3 observations were lost");
  gate.Restart(At(113));
  EXPECT_EQ(gate.broken_by(), "") << "known to who decided then";
  gate.Contradict("sensor base found impostor");
  EXPECT_EQ(gate.broken_by(), "sensor base found impostor") << "at the same time, but after it";
  gate.Update({}, true, At(114));
  EXPECT_THAT(gate.Assess(At(118)).blind_because, IsEmpty()) << "it was seen";
}

TEST(AlertLimiterTest, FoldsWhatExceedsTheBurst) {
  AlertLimiter limiter({.per_second = 1, .burst = 3});
  const engine::AlertEffect alert{.rule = "r", .text = "x"};

  int admitted = 0;
  for (int i = 0; i < 10; ++i) admitted += limiter.Admit(alert, At(100)) ? 1 : 0;

  EXPECT_EQ(admitted, 3);
  EXPECT_THAT(limiter.Due(At(100)), IsEmpty());
  const auto due = limiter.Due(At(101));
  ASSERT_THAT(due, SizeIs(1));
  EXPECT_THAT(due[0].text, HasSubstr("7 more"));
  EXPECT_THAT(limiter.Due(At(103)), IsEmpty());
  EXPECT_TRUE(limiter.Admit(alert, At(103)));
  EXPECT_TRUE(limiter.Admit({.rule = "other"}, At(100))) << "rules do not share";
}

class CommandReconcilerTest : public ::testing::Test {
 protected:
  Receipt Answer(const Outgoing& outgoing, Receipt::Stage stage) {
    return {.command_id = outgoing.command.id,
            .decision_id = std::get<SetLevel>(outgoing.command.what).decision_id,
            .stage = stage};
  }

  IdSource ids_{"c"};
  CommandReconciler ledger_{{"a", "b"}, &ids_};
};

TEST_F(CommandReconcilerTest, ALevelIsVerifiedWhenEveryListedActuatorSaysSo) {
  ledger_.Order({1, 1}, 1, "ALERT", "rule x", /*lowers=*/false);
  ledger_.Attach("a", {}, 0, "DEFAULT", {}, At(100));
  const auto first = ledger_.Due(1, At(100));
  ASSERT_THAT(first, SizeIs(1));

  ledger_.OnReceipt("a", Answer(first[0], Receipt::Stage::kAcknowledged), At(100));
  EXPECT_EQ(ledger_.stage(), Stage::kRequested) << "b has not answered";
  ledger_.Attach("b", {}, 0, "DEFAULT", {}, At(101));
  const auto second = ledger_.Due(1, At(101));
  ASSERT_THAT(second, SizeIs(1));
  ledger_.OnReceipt("b", Answer(second[0], Receipt::Stage::kVerified), At(101));
  EXPECT_EQ(ledger_.stage(), Stage::kAcknowledged);
  ledger_.OnReceipt("a", Answer(first[0], Receipt::Stage::kVerified), At(102));
  EXPECT_EQ(ledger_.stage(), Stage::kVerified);
}

TEST_F(CommandReconcilerTest, ALoweringNamesTheDecisionIdTheActuatorHolds) {
  ledger_.Attach("a", {1, 4}, 2, "COMPROMISED", {}, At(100));
  ledger_.Order({1, 5}, 1, "ALERT", "operator alice", /*lowers=*/true);

  const auto due = ledger_.Due(1, At(100));

  ASSERT_THAT(due, SizeIs(1));
  EXPECT_EQ(std::get<SetLevel>(due[0].command.what).based_on, (DecisionId{1, 4}));
  EXPECT_EQ(std::get<SetLevel>(due[0].command.what).from, "COMPROMISED");
}

TEST_F(CommandReconcilerTest, ALoweringThatFailedUnacknowledgedIsStillBasedOnTheDecisionBefore) {
  ledger_.Attach("a", {1, 4}, 2, "COMPROMISED", {}, At(100));
  ledger_.Order({1, 5}, 1, "ALERT", "operator alice", /*lowers=*/true);
  const auto due = ledger_.Due(1, At(100));
  ledger_.OnReceipt("a", Answer(due[0], Receipt::Stage::kFailed), At(100));

  const auto again = ledger_.Due(1, At(110));

  ASSERT_THAT(again, SizeIs(1));
  EXPECT_NE(again[0].command.id, due[0].command.id);
  EXPECT_EQ(std::get<SetLevel>(again[0].command.what).based_on, (DecisionId{1, 4}));
}

TEST_F(CommandReconcilerTest, ALoweringRightAfterARaiseIsBasedOnTheRaiseOnceThatIsHeld) {
  ledger_.Attach("a", {1, 1}, 0, "DEFAULT", {}, At(100));
  ledger_.Order({1, 2}, 2, "COMPROMISED", "rule up", /*lowers=*/false);
  const auto raise = ledger_.Due(1, At(100));
  ledger_.Order({1, 3}, 1, "ALERT", "operator alice", /*lowers=*/true);
  // The raise was acknowledged after it had been overtaken.
  ledger_.OnReceipt("a", Answer(raise[0], Receipt::Stage::kAcknowledged), At(100));

  const auto lowering = ledger_.Due(1, At(100));

  ASSERT_THAT(lowering, SizeIs(1));
  EXPECT_EQ(std::get<SetLevel>(lowering[0].command.what).based_on, (DecisionId{1, 2}));
  EXPECT_EQ(std::get<SetLevel>(lowering[0].command.what).from, "COMPROMISED");
}

TEST_F(CommandReconcilerTest, ARefusedLoweringIsTriedAgainWithTheDecisionThatIsHeldByThen) {
  ledger_.Attach("a", {1, 1}, 1, "ALERT", {}, At(100));
  ledger_.Order({1, 2}, 2, "COMPROMISED", "rule up", /*lowers=*/false);
  const auto raise = ledger_.Due(1, At(100));
  ledger_.Order({1, 3}, 0, "DEFAULT", "operator alice", /*lowers=*/true);
  const auto early = ledger_.Due(1, At(100));
  EXPECT_EQ(std::get<SetLevel>(early[0].command.what).based_on, (DecisionId{1, 1}));
  ledger_.OnReceipt("a", Answer(raise[0], Receipt::Stage::kAcknowledged), At(101));
  ledger_.OnReceipt("a", Answer(early[0], Receipt::Stage::kRefused), At(101));

  const auto again = ledger_.Due(1, At(110));

  ASSERT_THAT(again, SizeIs(1));
  EXPECT_EQ(std::get<SetLevel>(again[0].command.what).based_on, (DecisionId{1, 2}));
}

TEST_F(CommandReconcilerTest, TheNewestDecisionIdUnderAnotherLevelIsNotTheNewestDecision) {
  IdSource ids("c");
  CommandReconciler ledger({"a"}, &ids);
  ledger.Order({1, 5}, 0, "DEFAULT", "", /*lowers=*/true);
  ledger.Attach("a", {1, 5}, 3, "HALT", {}, At(100));
  EXPECT_EQ(ledger.stage(), Stage::kRequested);
  ledger.Attach("a", {1, 5}, 0, "DEFAULT", {}, At(100));
  EXPECT_EQ(ledger.stage(), Stage::kAcknowledged);
}

TEST_F(CommandReconcilerTest, AFailureFromBeforeTheSessionWaitsForTheFirstHeartbeat) {
  for (const bool verified : {true, false}) {
    IdSource ids("c");
    CommandReconciler ledger({"a"}, &ids);
    ledger.Order({1, 5}, 2, "COMPROMISED", "restored", /*lowers=*/false);
    ledger.Attach("a", {1, 5}, 2, "COMPROMISED", {}, At(100));
    ledger.OnReceipt("a",
                     {.command_id = "of another process",
                      .decision_id = {1, 5},
                      .stage = Receipt::Stage::kFailed,
                      .detail = "minutes ago"},
                     At(100));
    EXPECT_EQ(ledger.stage(), Stage::kAcknowledged);

    ledger.OnHeartbeat("a", /*effective=*/2, verified, At(101));

    EXPECT_EQ(ledger.stage(), verified ? Stage::kVerified : Stage::kFailed);
    EXPECT_EQ(ledger.failure().empty(), verified);
  }
}

TEST_F(CommandReconcilerTest, EachSessionWaitsForAHeartbeatOfItsOwn) {
  IdSource ids("c");
  CommandReconciler ledger({"a"}, &ids);
  ledger.Order({1, 5}, 2, "COMPROMISED", "restored", /*lowers=*/false);
  ledger.Attach("a", {1, 5}, 2, "COMPROMISED", {}, At(100));
  ledger.OnHeartbeat("a", /*effective=*/2, /*verified=*/true, At(101));
  EXPECT_EQ(ledger.stage(), Stage::kVerified);

  ledger.Detach("a");
  ledger.Attach("a", {1, 5}, 2, "COMPROMISED", {}, At(110));
  ledger.OnReceipt("a",
                   {.command_id = "of the session before",
                    .decision_id = {1, 5},
                    .stage = Receipt::Stage::kFailed},
                   At(110));
  EXPECT_EQ(ledger.stage(), Stage::kAcknowledged);

  ledger.OnHeartbeat("a", /*effective=*/2, /*verified=*/true, At(111));
  EXPECT_EQ(ledger.stage(), Stage::kVerified);
  EXPECT_EQ(ledger.failure(), "");
}

TEST_F(CommandReconcilerTest, ReceiptsOfOlderDecisionsChangeNothing) {
  ledger_.Attach("a", {}, 0, "DEFAULT", {}, At(100));
  ledger_.Order({1, 1}, 1, "ALERT", "", /*lowers=*/false);
  const auto old = ledger_.Due(1, At(100));
  ledger_.Order({1, 2}, 2, "COMPROMISED", "", /*lowers=*/false);

  ledger_.OnReceipt("a", Answer(old[0], Receipt::Stage::kVerified), At(101));

  EXPECT_EQ(ledger_.stage(), Stage::kRequested);
}

TEST_F(CommandReconcilerTest, ALoweringIsVerifiedOnlyAtItsLevelARaiseAlsoAbove) {
  for (const bool lowers : {false, true}) {
    IdSource ids("c");
    CommandReconciler ledger({"a"}, &ids);
    ledger.Attach("a", {1, 1}, 2, "COMPROMISED", {}, At(100));
    ledger.Order({1, 2}, 1, "ALERT", "", lowers);
    const auto due = ledger.Due(1, At(100));
    ledger.OnReceipt("a", Answer(due[0], Receipt::Stage::kAcknowledged), At(100));

    ledger.OnHeartbeat("a", /*effective=*/2, /*verified=*/true, At(100));

    EXPECT_EQ(ledger.stage() == Stage::kVerified, !lowers);
  }
}

TEST_F(CommandReconcilerTest, NoFinalReceiptInTimeIsAFailure) {
  IdSource ids("c");
  CommandReconciler ledger({"a"}, &ids);
  ledger.Attach("a", {}, 0, "DEFAULT", {}, At(100));
  ledger.Order({1, 1}, 1, "ALERT", "", /*lowers=*/false);
  const auto due = ledger.Due(1, At(100));
  ledger.OnReceipt("a", Answer(due[0], Receipt::Stage::kAcknowledged), At(101));

  ledger.Due(1, At(119));
  EXPECT_EQ(ledger.stage(), Stage::kAcknowledged);
  ledger.Due(1, At(120));
  EXPECT_EQ(ledger.stage(), Stage::kFailed);
}

}  // namespace
}  // namespace rips::pipeline

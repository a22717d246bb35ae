// The pipeline's small parts, and its threads.
#include <atomic>

#include "absl/strings/str_format.h"
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/shard/mailbox.h"
#include "policy_server/server/shard/pipeline.h"
#include "policy_server/server/shard/store_recorder.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr int64_t kSecond = kNanosPerSecond;

Instant At(int64_t seconds) { return {.boottime_ns = seconds * kSecond, .unix_ns = seconds}; }

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
  gate.Update({"sensor base is silent"}, At(106));
  EXPECT_THAT(gate.Assess(At(106)).blind_because[0], HasSubstr("silent"));

  gate.Update({}, At(107));
  EXPECT_THAT(gate.Assess(At(110)).blind_because[0], HasSubstr("4.0 s of 5.0 s"));
  EXPECT_THAT(gate.Assess(At(112)).blind_because, IsEmpty());

  gate.Disturb("3 observations were lost", At(113));
  EXPECT_THAT(gate.Assess(At(117)).blind_because[0], HasSubstr("were lost"));
  EXPECT_THAT(gate.Assess(At(118)).blind_because, IsEmpty());
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

class CommandLedgerTest : public ::testing::Test {
 protected:
  CommandLedgerTest() : ledger_({"a", "b"}, [this] { return absl::StrCat("c", ++ids_); }) {}

  Receipt Answer(const Outgoing& outgoing, Receipt::Stage stage) {
    return {.command_id = outgoing.command.id,
            .mark = std::get<SetLevel>(outgoing.command.what).mark,
            .stage = stage};
  }

  int ids_ = 0;
  CommandReconciler ledger_;
};

TEST_F(CommandLedgerTest, ALevelIsVerifiedWhenEveryListedActuatorSaysSo) {
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

TEST_F(CommandLedgerTest, ALoweringNamesTheMarkTheActuatorHolds) {
  ledger_.Attach("a", {1, 4}, 2, "COMPROMISED", {}, At(100));
  ledger_.Order({1, 5}, 1, "ALERT", "operator alice", /*lowers=*/true);

  const auto due = ledger_.Due(1, At(100));

  ASSERT_THAT(due, SizeIs(1));
  EXPECT_EQ(std::get<SetLevel>(due[0].command.what).based_on, (Mark{1, 4}));
  EXPECT_EQ(std::get<SetLevel>(due[0].command.what).from, "COMPROMISED");
}

TEST_F(CommandLedgerTest, ALoweringThatFailedUnacknowledgedIsStillBasedOnTheMarkBefore) {
  ledger_.Attach("a", {1, 4}, 2, "COMPROMISED", {}, At(100));
  ledger_.Order({1, 5}, 1, "ALERT", "operator alice", /*lowers=*/true);
  const auto due = ledger_.Due(1, At(100));
  ledger_.OnReceipt("a", Answer(due[0], Receipt::Stage::kFailed), At(100));

  const auto again = ledger_.Due(1, At(110));

  ASSERT_THAT(again, SizeIs(1));
  EXPECT_NE(again[0].command.id, due[0].command.id);
  EXPECT_EQ(std::get<SetLevel>(again[0].command.what).based_on, (Mark{1, 4}));
}

TEST_F(CommandLedgerTest, ALoweringRightAfterARaiseIsBasedOnTheRaiseOnceThatIsHeld) {
  ledger_.Attach("a", {1, 1}, 0, "DEFAULT", {}, At(100));
  ledger_.Order({1, 2}, 2, "COMPROMISED", "rule up", /*lowers=*/false);
  const auto raise = ledger_.Due(1, At(100));
  ledger_.Order({1, 3}, 1, "ALERT", "operator alice", /*lowers=*/true);
  // The raise was acknowledged after it had been overtaken.
  ledger_.OnReceipt("a", Answer(raise[0], Receipt::Stage::kAcknowledged), At(100));

  const auto lowering = ledger_.Due(1, At(100));

  ASSERT_THAT(lowering, SizeIs(1));
  EXPECT_EQ(std::get<SetLevel>(lowering[0].command.what).based_on, (Mark{1, 2}));
  EXPECT_EQ(std::get<SetLevel>(lowering[0].command.what).from, "COMPROMISED");
}

TEST_F(CommandLedgerTest, ARefusedLoweringIsTriedAgainWithTheDecisionThatIsHeldByThen) {
  ledger_.Attach("a", {1, 1}, 1, "ALERT", {}, At(100));
  ledger_.Order({1, 2}, 2, "COMPROMISED", "rule up", /*lowers=*/false);
  const auto raise = ledger_.Due(1, At(100));
  ledger_.Order({1, 3}, 0, "DEFAULT", "operator alice", /*lowers=*/true);
  const auto early = ledger_.Due(1, At(100));
  EXPECT_EQ(std::get<SetLevel>(early[0].command.what).based_on, (Mark{1, 1}));
  ledger_.OnReceipt("a", Answer(raise[0], Receipt::Stage::kAcknowledged), At(101));
  ledger_.OnReceipt("a", Answer(early[0], Receipt::Stage::kRefused), At(101));

  const auto again = ledger_.Due(1, At(110));

  ASSERT_THAT(again, SizeIs(1));
  EXPECT_EQ(std::get<SetLevel>(again[0].command.what).based_on, (Mark{1, 2}));
}

TEST_F(CommandLedgerTest, TheNewestMarkUnderAnotherLevelIsNotTheNewestDecision) {
  CommandReconciler ledger({"a"}, [] { return "id"; });
  ledger.Order({1, 5}, 0, "DEFAULT", "", /*lowers=*/true);
  ledger.Attach("a", {1, 5}, 3, "HALT", {}, At(100));
  EXPECT_EQ(ledger.stage(), Stage::kRequested);
  ledger.Attach("a", {1, 5}, 0, "DEFAULT", {}, At(100));
  EXPECT_EQ(ledger.stage(), Stage::kAcknowledged);
}

TEST_F(CommandLedgerTest, AFailureFromBeforeTheSessionWaitsForTheFirstHeartbeat) {
  for (const bool verified : {true, false}) {
    CommandReconciler ledger({"a"}, [] { return "id"; });
    ledger.Order({1, 5}, 2, "COMPROMISED", "restored", /*lowers=*/false);
    ledger.Attach("a", {1, 5}, 2, "COMPROMISED", {}, At(100));
    ledger.OnReceipt("a",
                     {.command_id = "of another process",
                      .mark = {1, 5},
                      .stage = Receipt::Stage::kFailed,
                      .detail = "minutes ago"},
                     At(100));
    EXPECT_EQ(ledger.stage(), Stage::kAcknowledged);

    ledger.OnBeat("a", /*effective=*/2, verified, At(101));

    EXPECT_EQ(ledger.stage(), verified ? Stage::kVerified : Stage::kFailed);
    EXPECT_EQ(ledger.failure().empty(), verified);
  }
}

TEST_F(CommandLedgerTest, ReceiptsOfOlderDecisionsChangeNothing) {
  ledger_.Attach("a", {}, 0, "DEFAULT", {}, At(100));
  ledger_.Order({1, 1}, 1, "ALERT", "", /*lowers=*/false);
  const auto old = ledger_.Due(1, At(100));
  ledger_.Order({1, 2}, 2, "COMPROMISED", "", /*lowers=*/false);

  ledger_.OnReceipt("a", Answer(old[0], Receipt::Stage::kVerified), At(101));

  EXPECT_EQ(ledger_.stage(), Stage::kRequested);
}

TEST_F(CommandLedgerTest, ALoweringIsVerifiedOnlyAtItsLevelARaiseAlsoAbove) {
  for (const bool lowers : {false, true}) {
    CommandReconciler ledger({"a"}, [] { return "id"; });
    ledger.Attach("a", {1, 1}, 2, "COMPROMISED", {}, At(100));
    ledger.Order({1, 2}, 1, "ALERT", "", lowers);
    const auto due = ledger.Due(1, At(100));
    ledger.OnReceipt("a", Answer(due[0], Receipt::Stage::kAcknowledged), At(100));

    ledger.OnBeat("a", /*effective=*/2, /*verified=*/true, At(100));

    EXPECT_EQ(ledger.stage() == Stage::kVerified, !lowers);
  }
}

TEST_F(CommandLedgerTest, NoFinalReceiptInTimeIsAFailure) {
  CommandReconciler ledger({"a"}, [] { return "id"; });
  ledger.Attach("a", {}, 0, "DEFAULT", {}, At(100));
  ledger.Order({1, 1}, 1, "ALERT", "", /*lowers=*/false);
  const auto due = ledger.Due(1, At(100));
  ledger.OnReceipt("a", Answer(due[0], Receipt::Stage::kAcknowledged), At(101));

  ledger.Due(1, At(119));
  EXPECT_EQ(ledger.stage(), Stage::kAcknowledged);
  ledger.Due(1, At(120));
  EXPECT_EQ(ledger.stage(), Stage::kFailed);
}

// What several threads may tell at once.
class CountingAudience final : public RobotObserver {
 public:
  void OnAlert(const store::AlertRecord&) override { ++alerts; }
  void OnNotice(const std::string&) override {}
  void OnStatus(const RobotStatus&) override { ++statuses; }
  void OnRuleLog(const std::string&, const std::string&, const std::string&) override {}
  std::atomic<int> alerts = 0;
  std::atomic<int> statuses = 0;
};

TEST(PipelineTest, RunsTasksOnTheRobotsThreadInOrderControlFirst) {
  FakeClock clock;
  store::FakeStore store;
  store::Committer committer(&store);
  StoreRecorder recorder(&store, &committer);
  CountingAudience audience;
  std::atomic<int> ids = 0;
  Pipeline pipeline(2, &clock);
  const std::vector<lang::SourceFile> files = {{.path = "t.rul", .text = kPaperRules}};
  const auto program = *engine::CompiledPolicy::Create(*lang::Compile(files).rules);
  for (const char* id : {"r1", "r2", "r3"}) {
    ASSERT_THAT(pipeline.Add({.id = id}, {.program = program, .bundle_id = "b"}, Timing{}, {}, 1,
                             {.recorder = &recorder,
                              .audience = &audience,
                              .new_id = [&ids] { return absl::StrFormat("%032x", ++ids); }}),
                IsOk());
  }
  // Before Start nothing runs: control overtakes messages that were posted earlier.
  std::vector<int> order;  // touched on r1's thread alone
  const auto note = [&order](int n) { return [&order, n](Robot&) { order.push_back(n); }; };
  ASSERT_THAT(pipeline.Post("r1", Lane::kMessages, note(3)), IsOk());
  ASSERT_THAT(pipeline.Post("r1", Lane::kControl, note(1)), IsOk());
  ASSERT_THAT(pipeline.Post("r1", Lane::kControl, note(2)), IsOk());

  pipeline.Start();
  std::atomic<int> raised = 0;
  pipeline.ForEach([&](Robot& robot) {
    robot.Raise({.operator_name = "alice", .to = "HALT", .reason = "drill"},
                [&raised](const LevelAnswer& answer) { raised += answer.status.ok() ? 1 : 0; });
  });
  // The answers come when the committer's thread has made the decisions durable.
  while (raised < 3) pipeline.ForEach([](Robot&) {});
  ASSERT_THAT(pipeline.Post("r1", Lane::kMessages, note(4)), IsOk());
  std::atomic<bool> last = false;
  while (!last) {
    pipeline.ForEach([&](Robot& robot) {
      if (robot.id() == "r1") last = order.size() == 4;
    });
  }
  pipeline.Stop();
  committer.Stop();

  EXPECT_THAT(order, ::testing::ElementsAre(1, 2, 3, 4));
  EXPECT_EQ(store.ListTransitions("r2", 10)->front().to, "HALT");
  EXPECT_GE(audience.statuses, 3);
}

TEST(PipelineTest, RefusesUnknownRobotsAndTasksPastItsLimit) {
  FakeClock clock;
  FakeRecorder recorder;
  FakeObserver audience;
  Pipeline pipeline(1, &clock, {.control_max = 2, .messages_max = 1});
  const std::vector<lang::SourceFile> files = {{.path = "t.rul", .text = kPaperRules}};
  ASSERT_THAT(
      pipeline.Add({.id = "r1"},
                   {.program = *engine::CompiledPolicy::Create(*lang::Compile(files).rules)},
                   Timing{}, {}, 1,
                   {.recorder = &recorder, .audience = &audience, .new_id = [] { return "id"; }}),
      IsOk());
  const auto nothing = [](Robot&) {};

  EXPECT_THAT(pipeline.Post("r9", Lane::kControl, nothing), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(pipeline.Post("r1", Lane::kMessages, nothing), IsOk());
  EXPECT_THAT(pipeline.Post("r1", Lane::kMessages, nothing),
              StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_THAT(pipeline.Post("r1", Lane::kControl, nothing), IsOk());
}

TEST(MailboxTest, CutsAFloodingPeerOffAndNobodyElse) {
  FakeClock clock;
  FakeRecorder recorder;
  FakeObserver audience;
  Pipeline pipeline(1, &clock, {.control_max = 100, .messages_max = 100});
  const std::vector<lang::SourceFile> files = {{.path = "t.rul", .text = kPaperRules}};
  ASSERT_THAT(
      pipeline.Add({.id = "r1"},
                   {.program = *engine::CompiledPolicy::Create(*lang::Compile(files).rules)},
                   Timing{}, {}, 1,
                   {.recorder = &recorder, .audience = &audience, .new_id = [] { return "id"; }}),
      IsOk());
  const auto nothing = [](Robot&) {};
  Mailbox flooding(&pipeline, "r1", {.tasks = 3, .bytes = 1'000});
  Mailbox large(&pipeline, "r1", {.tasks = 3, .bytes = 1'000});
  Mailbox other(&pipeline, "r1");
  Mailbox unknown(&pipeline, "r9");

  for (int i = 0; i < 3; ++i) ASSERT_THAT(flooding.Post(Lane::kControl, 1, nothing), IsOk());
  EXPECT_THAT(flooding.Post(Lane::kControl, 1, nothing),
              StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_THAT(large.Post(Lane::kMessages, 1'001, nothing),
              StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_THAT(other.Post(Lane::kControl, 1, nothing), IsOk());
  EXPECT_THAT(unknown.Post(Lane::kControl, 1, nothing),
              StatusIs(absl::StatusCode::kPermissionDenied));
}

}  // namespace
}  // namespace rips::pipeline

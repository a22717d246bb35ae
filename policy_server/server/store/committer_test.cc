#include "policy_server/server/store/committer.h"

#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/fake_store.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"
#include "services/runtime/mutex.h"

namespace rips::store {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::SizeIs;

// A door that a test opens.
class Gate {
 public:
  void Pass() {
    MutexLock lock(&mutex_);
    ++arrived_;
    changed_.NotifyAll();
    while (!open_) changed_.Wait(lock);
  }
  void WaitForArrival() {
    MutexLock lock(&mutex_);
    while (arrived_ == 0) changed_.Wait(lock);
  }
  void Open() {
    MutexLock lock(&mutex_);
    open_ = true;
    changed_.NotifyAll();
  }

 private:
  Mutex mutex_;
  CondVar changed_;
  bool open_ ABSL_GUARDED_BY(mutex_) = false;
  int arrived_ ABSL_GUARDED_BY(mutex_) = 0;
};

// Collects what callbacks were told, in order.
class Told {
 public:
  Committer::Done Next(int id) {
    return [this, id](const absl::Status& status) {
      MutexLock lock(&mutex_);
      ids_.push_back(id);
      codes_.push_back(status.code());
    };
  }
  std::vector<int> ids() {
    MutexLock lock(&mutex_);
    return ids_;
  }
  std::vector<absl::StatusCode> codes() {
    MutexLock lock(&mutex_);
    return codes_;
  }

 private:
  Mutex mutex_;
  std::vector<int> ids_ ABSL_GUARDED_BY(mutex_);
  std::vector<absl::StatusCode> codes_ ABSL_GUARDED_BY(mutex_);
};

WriteBatch Decision(uint64_t epoch) { return Decide("r1", {1, epoch}, "A", "B"); }

TEST(CommitterTest, GroupsWhatQueuesDuringAFlushAndKeepsOrder) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Gate gate;
  Told told;
  store.OnCommit([&] { gate.Pass(); });
  Committer committer(&store);

  ASSERT_THAT(committer.Submit(Decision(1), told.Next(1)), IsOk());
  gate.WaitForArrival();
  for (int i = 2; i <= 20; ++i) {
    ASSERT_THAT(committer.Submit(Decision(static_cast<uint64_t>(i)), told.Next(i)), IsOk());
  }
  EXPECT_EQ(committer.waiting(), 19u);
  gate.Open();
  committer.Stop();

  EXPECT_THAT(store.commit_sizes(), ElementsAre(1, 19));
  std::vector<int> expected;
  for (int i = 1; i <= 20; ++i) expected.push_back(i);
  EXPECT_EQ(told.ids(), expected);
  EXPECT_EQ(store.Load("r1")->decision_id, (DecisionId{1, 20}));
}

// How far the observations of r1 are judged, and nothing else.
WriteBatch Progress(uint64_t sequence) {
  WriteBatch batch{.robot = "r1", .tenure = 1};
  batch.checkpoint.high_water[{.host = "base", .incarnation = "00", .lane = {}}] = sequence;
  return batch;
}

TEST(CommitterTest, ProgressIsWrittenWithTheNextUrgentBatch) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Told told;
  // Without the decision, the test would take an hour.
  Committer committer(&store, {.gather = absl::Hours(1)});
  ASSERT_THAT(committer.Submit(Progress(1), told.Next(1)), IsOk());
  ASSERT_THAT(committer.Submit(Progress(2), told.Next(2)), IsOk());
  ASSERT_THAT(committer.Submit(Decision(1), told.Next(3)), IsOk());
  while (told.ids().size() < 3) std::this_thread::yield();

  EXPECT_THAT(store.commit_sizes(), ElementsAre(3));
  EXPECT_THAT(told.ids(), ElementsAre(1, 2, 3));
  committer.Stop();
}

TEST(CommitterTest, ProgressIsWrittenAfterGather) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Told told;
  Committer committer(&store, {.gather = absl::Milliseconds(1)});
  ASSERT_THAT(committer.Submit(Progress(1), told.Next(1)), IsOk());
  while (told.ids().empty()) std::this_thread::yield();
  EXPECT_THAT(store.commit_sizes(), ElementsAre(1));
}

TEST(CommitterTest, StopDoesNotWaitForGather) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Told told;
  Committer committer(&store, {.gather = absl::Hours(1)});
  ASSERT_THAT(committer.Submit(Progress(1), told.Next(1)), IsOk());
  committer.Stop();
  EXPECT_THAT(told.codes(), ElementsAre(absl::StatusCode::kOk));
}

TEST(CommitterTest, OnlyProgressWaits) {
  const auto with = [](auto change) {
    WriteBatch batch = Progress(1);
    change(batch);
    return batch;
  };
  const WriteBatch hurried[] = {
      with([](WriteBatch& batch) { batch.refusals.emplace_back(); }),
      with([](WriteBatch& batch) { batch.stages.emplace_back(); }),
      with([](WriteBatch& batch) { batch.alerts.push_back(MakeAlert("r1", "a")); }),
      with([](WriteBatch& batch) { batch.receipts.emplace_back(); }),
      with([](WriteBatch& batch) { batch.acks.emplace_back(); }),
      with([](WriteBatch& batch) { batch.checkpoint.bundle = "b"; }),
      with([](WriteBatch& batch) { batch.checkpoint.maintenance.emplace(); }),
      {.robot = "r1", .tenure = 1},
  };
  for (const WriteBatch& batch : hurried) {
    FakeStore store;
    ASSERT_THAT(store.Acquire("r1"), IsOk());
    Told told;
    Committer committer(&store, {.gather = absl::Hours(1)});
    ASSERT_THAT(committer.Submit(batch, told.Next(1)), IsOk());
    while (told.ids().empty()) std::this_thread::yield();
  }
}

TEST(CommitterTest, AGroupHasALimit) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Gate gate;
  Told told;
  store.OnCommit([&] { gate.Pass(); });
  Committer committer(&store, {.group_max = 4});

  ASSERT_THAT(committer.Submit(Decision(1), told.Next(1)), IsOk());
  gate.WaitForArrival();
  for (int i = 2; i <= 8; ++i) {
    ASSERT_THAT(committer.Submit(Decision(static_cast<uint64_t>(i)), told.Next(i)), IsOk());
  }
  gate.Open();
  committer.Stop();

  EXPECT_THAT(store.commit_sizes(), ElementsAre(1, 4, 3));
}

TEST(CommitterTest, RefusesMoreThanMayWait) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Gate gate;
  Told told;
  store.OnCommit([&] { gate.Pass(); });
  Committer committer(&store, {.waiting_max = 2});

  ASSERT_THAT(committer.Submit(Decision(1), told.Next(1)), IsOk());
  gate.WaitForArrival();
  ASSERT_THAT(committer.Submit(Decision(2), told.Next(2)), IsOk());
  ASSERT_THAT(committer.Submit(Decision(3), told.Next(3)), IsOk());
  EXPECT_THAT(committer.Submit(Decision(4), told.Next(4)),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("more than 2 batches")));
  EXPECT_EQ(committer.refused(), 1u);
  gate.Open();
  committer.Stop();

  EXPECT_THAT(told.ids(), ElementsAre(1, 2, 3));
}

TEST(CommitterTest, TellsOfAFailingDiskAndRecovers) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Told told;
  Gate first;
  Committer committer(&store);
  EXPECT_TRUE(committer.healthy());

  store.FailWrites(absl::UnavailableError("disk on fire"));
  Committer::Done done = told.Next(1);
  ASSERT_THAT(committer.Submit(Decision(1),
                               [&](const absl::Status& status) {
                                 std::move(done)(status);
                                 first.Pass();
                               }),
              IsOk());
  first.WaitForArrival();
  EXPECT_FALSE(committer.healthy());

  store.FailWrites(absl::OkStatus());
  ASSERT_THAT(committer.Submit(Decision(2), told.Next(2)), IsOk());
  first.Open();
  committer.Stop();

  EXPECT_TRUE(committer.healthy());
  EXPECT_THAT(told.codes(), ElementsAre(absl::StatusCode::kUnavailable, absl::StatusCode::kOk));
  EXPECT_EQ(store.Load("r1")->decision_id, (DecisionId{1, 2}))
      << "a failed batch is not tried again";
}

WriteBatch OneAlert(const std::string& text) {
  WriteBatch batch{.robot = "r1", .tenure = 1};
  batch.alerts.push_back(MakeAlert("r1", text));
  return batch;
}

TEST(CommitterTest, WhatIsPutFirstIsKeptAndWrittenBeforeTheRest) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Told told;
  Committer committer(&store);
  store.FailWrites(absl::UnavailableError("disk on fire"));
  const auto try_one = [&](int id) {
    Gate gate;
    gate.Open();
    ASSERT_THAT(committer.Submit(OneAlert(absl::StrCat("later ", id)),
                                 [&](const absl::Status&) { gate.Pass(); }),
                IsOk());
    gate.WaitForArrival();
  };
  committer.PutFirst(OneAlert("outage"), told.Next(1));
  try_one(1);
  try_one(2);
  EXPECT_THAT(told.ids(), ElementsAre());
  EXPECT_GE(committer.failures(), 2u);
  EXPECT_THAT(committer.health(),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("disk on fire")));

  store.FailWrites(absl::OkStatus());
  try_one(3);
  committer.Stop();

  EXPECT_THAT(told.codes(), ElementsAre(absl::StatusCode::kOk));
  EXPECT_THAT(committer.health(), IsOk());
  const auto alerts = store.AlertsAfter("", 0, 0);
  ASSERT_THAT(alerts->alerts, SizeIs(2));
  EXPECT_EQ(alerts->alerts[0].text, "outage");
  EXPECT_EQ(alerts->alerts[1].text, "later 3");
}

TEST(CommitterTest, AWriteThatDoesNotEndIsAnOutage) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  FakeClock clock;
  Told told;
  Gate disk;
  store.OnCommit([&] { disk.Pass(); });
  Committer committer(&store, {.hang_ns = 5 * kNanosPerSecond}, &clock);
  ASSERT_THAT(committer.Submit(Decision(1), told.Next(1)), IsOk());
  disk.WaitForArrival();
  clock.Advance(4 * kNanosPerSecond);
  EXPECT_TRUE(committer.healthy());
  clock.Advance(2 * kNanosPerSecond);
  EXPECT_THAT(committer.health(), StatusIs(absl::StatusCode::kUnavailable,
                                           HasSubstr("has not ended for more than 5 s")));
  disk.Open();
  committer.Stop();
  EXPECT_TRUE(committer.healthy());
  EXPECT_THAT(told.codes(), ElementsAre(absl::StatusCode::kOk));
}

TEST(CommitterTest, TellsHowLongEachTransactionTook) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  FakeClock clock;
  std::vector<int64_t> took_ns;
  Committer committer(&store,
                      {.before_commit =
                           [&](std::span<const WriteBatch>) {
                             clock.Advance(7);
                             return absl::UnavailableError("no audit");
                           },
                       .on_commit = [&](int64_t ns) { took_ns.push_back(ns); }},
                      &clock);
  Told told;
  ASSERT_THAT(committer.Submit(Decision(1), told.Next(1)), IsOk());
  committer.Stop();

  EXPECT_THAT(took_ns, ElementsAre(7));
}

TEST(CommitterTest, OnAFullDiskRaisesAreWrittenFromTheReserve) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  store.FillDisk(true);
  Told told;
  Gate disk;
  store.OnCommit([&] { disk.Pass(); });
  Committer committer(&store);
  // The first holds the disk, so that the others are one group.
  ASSERT_THAT(committer.Submit(OneAlert("first"), told.Next(1)), IsOk());
  disk.WaitForArrival();
  WriteBatch raise = Decision(1);
  raise.uses_reserve = true;
  ASSERT_THAT(committer.Submit(OneAlert("second"), told.Next(2)), IsOk());
  ASSERT_THAT(committer.Submit(std::move(raise), told.Next(3)), IsOk());
  disk.Open();
  committer.Stop();

  EXPECT_THAT(told.ids(), ElementsAre(1, 2, 3));
  EXPECT_THAT(told.codes(),
              ElementsAre(absl::StatusCode::kResourceExhausted,
                          absl::StatusCode::kResourceExhausted, absl::StatusCode::kOk));
  EXPECT_EQ(store.Load("r1")->decision_id, (DecisionId{1, 1}));
  EXPECT_FALSE(committer.healthy()) << "the reserve alone is no health";
}

TEST(CommitterTest, ARaiseThatIsWrittenAloneIsNoHealthEither) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  store.FillDisk(true);
  Told told;
  Gate disk;
  store.OnCommit([&] { disk.Pass(); });
  Committer committer(&store);
  ASSERT_THAT(committer.Submit(OneAlert("first"), told.Next(1)), IsOk());
  disk.WaitForArrival();
  WriteBatch raise = Decision(1);
  raise.uses_reserve = true;
  ASSERT_THAT(committer.Submit(std::move(raise), told.Next(2)), IsOk());
  disk.Open();
  committer.Stop();

  EXPECT_THAT(told.codes(),
              ElementsAre(absl::StatusCode::kResourceExhausted, absl::StatusCode::kOk));
  EXPECT_FALSE(committer.healthy());
}

TEST(CommitterTest, ABadBatchHurtsNoOther) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Gate gate;
  Told told;
  store.OnCommit([&] { gate.Pass(); });
  Committer committer(&store);

  ASSERT_THAT(committer.Submit(Decision(1), told.Next(1)), IsOk());
  gate.WaitForArrival();
  ASSERT_THAT(committer.Submit(Decision(2), told.Next(2)), IsOk());
  ASSERT_THAT(committer.Submit(Decide("r1", {1, 1}, "A", "C"), told.Next(3)), IsOk());
  ASSERT_THAT(committer.Submit(Decide("r1", {0, 0}, "A", "C"), told.Next(4)), IsOk());
  WriteBatch fenced = Decision(4);
  fenced.tenure = 2;
  ASSERT_THAT(committer.Submit(std::move(fenced), told.Next(5)), IsOk());
  ASSERT_THAT(committer.Submit(Decision(5), told.Next(6)), IsOk());
  gate.Open();
  committer.Stop();

  EXPECT_THAT(told.ids(), ElementsAre(1, 2, 3, 4, 5, 6));
  EXPECT_THAT(told.codes(),
              ElementsAre(absl::StatusCode::kOk, absl::StatusCode::kOk,
                          absl::StatusCode::kAlreadyExists, absl::StatusCode::kInvalidArgument,
                          absl::StatusCode::kAborted, absl::StatusCode::kOk));
  EXPECT_THAT(store.commit_sizes(), ElementsAre(1, 5)) << "none is tried again";
  EXPECT_TRUE(committer.healthy());
  EXPECT_EQ(store.Load("r1")->decision_id, (DecisionId{1, 5}));
}

TEST(CommitterTest, StopCommitsWhatWaitsAndThenRefuses) {
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Told told;
  Committer committer(&store);
  for (int i = 1; i <= 100; ++i) {
    ASSERT_THAT(committer.Submit(Decision(static_cast<uint64_t>(i)), told.Next(i)), IsOk());
  }
  committer.Stop();
  committer.Stop();

  EXPECT_THAT(told.ids(), SizeIs(100));
  EXPECT_EQ(store.Load("r1")->decision_id, (DecisionId{1, 100}));
  EXPECT_THAT(committer.Submit(Decision(101), told.Next(101)),
              StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_EQ(committer.refused(), 0u);
}

TEST(CommitterTest, TakesFromManyThreadsInEachOnesOrder) {
  constexpr int kThreads = 4;
  constexpr int kEach = 200;
  FakeStore store;
  ASSERT_THAT(store.Acquire("r1"), IsOk());
  Told told;
  Committer committer(&store);
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < kEach; ++i) {
        WriteBatch batch{.robot = absl::StrCat("r", t)};
        batch.alerts.push_back(MakeAlert(batch.robot, absl::StrCat(i)));
        EXPECT_THAT(committer.Submit(std::move(batch), told.Next(t * kEach + i)), IsOk());
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  committer.Stop();

  const std::vector<int> ids = told.ids();
  ASSERT_THAT(ids, SizeIs(kThreads * kEach));
  std::vector<int> next(kThreads, 0);
  for (int id : ids) EXPECT_EQ(id % kEach, next[static_cast<size_t>(id / kEach)]++);
}

}  // namespace
}  // namespace rips::store

#include "policy_server/policy/inspect/inspection_pool.h"

#include <functional>
#include <map>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/fake_clock.h"

namespace rips::inspect {
namespace {

using engine::Verdict;
using ::testing::Each;
using ::testing::ElementsAre;

// A door that a test opens; those inside wait.
class Gate {
 public:
  void Pass() {
    MutexLock lock(&mu_);
    ++arrived_;
    changed_.NotifyAll();
    while (!open_) changed_.Wait(lock);
  }
  void WaitForArrivals(int count) {
    MutexLock lock(&mu_);
    while (arrived_ < count) changed_.Wait(lock);
  }
  void Open() {
    MutexLock lock(&mu_);
    open_ = true;
    changed_.NotifyAll();
  }

 private:
  Mutex mu_;
  CondVar changed_;
  bool open_ ABSL_GUARDED_BY(mu_) = false;
  int arrived_ ABSL_GUARDED_BY(mu_) = 0;
};

// Inspections are what a test says they are.
class FakeSet final : public InspectionSet {
 public:
  using Inspect = std::function<Verdict(uint32_t, const Message&)>;
  explicit FakeSet(Inspect inspect) : inspect_(std::move(inspect)) {}

  size_t size() const override { return 100; }
  std::unique_ptr<Session> NewSession() const override {
    ++sessions;
    return std::make_unique<FakeSession>(inspect_, &alive);
  }

  mutable std::atomic<int> sessions = 0;
  mutable std::atomic<int> alive = 0;

 private:
  class FakeSession final : public Session {
   public:
    FakeSession(FakeSet::Inspect inspect, std::atomic<int>* alive)
        : inspect_(std::move(inspect)), alive_(alive) {
      ++*alive_;
    }
    ~FakeSession() override { --*alive_; }
    Verdict Inspect(uint32_t index, const Message& message) override {
      return inspect_(index, message);
    }

   private:
    FakeSet::Inspect inspect_;
    std::atomic<int>* alive_;
  };

  const Inspect inspect_;
};

struct Answer {
  std::string robot;
  std::string payload;
  std::vector<Verdict> verdicts;
  InspectionStats stats;
};

// Collects answers in their order.
class Answers {
 public:
  InspectionPool::Done Next(const std::string& robot, const std::string& payload) {
    return [this, robot, payload](std::vector<Verdict> verdicts, const InspectionStats& stats) {
      MutexLock lock(&mu_);
      all_.push_back({robot, payload, std::move(verdicts), stats});
      changed_.NotifyAll();
    };
  }
  std::vector<Answer> Wait(size_t count) {
    MutexLock lock(&mu_);
    while (all_.size() < count) changed_.Wait(lock);
    return all_;
  }
  size_t size() {
    MutexLock lock(&mu_);
    return all_.size();
  }

 private:
  Mutex mu_;
  CondVar changed_;
  std::vector<Answer> all_ ABSL_GUARDED_BY(mu_);
};

class InspectionPoolTest : public ::testing::Test {
 protected:
  // `gate` payloads wait; `slow N` ones take N milliseconds.
  InspectionPoolTest() {
    set_ = std::make_shared<FakeSet>([this](uint32_t index, const Message& message) {
      if (message.payload == "gate") gate_.Pass();
      if (message.payload == "slow") clock_.Advance(50 * kNanosPerMilli);
      if (message.payload == "stuck") clock_.Advance(3 * kNanosPerSecond);
      return index % 2 == 1 ? Verdict::kYes : Verdict::kNo;
    });
  }
  void Start(PoolOptions options = {}) {
    pool_ = std::make_unique<InspectionPool>(options, &clock_);
  }
  Skipped Submit(const std::string& robot, const std::string& payload,
                 std::vector<uint32_t> indices = {0}) {
    const auto kept = std::make_shared<const std::string>(payload);
    return pool_->Submit(
        {.set = set_,
         .indices = std::move(indices),
         .message = {.robot = robot, .payload = *kept, .owner = kept, .available = true}},
        answers_.Next(robot, payload));
  }
  // Occupies one thread.
  void Block(const std::string& robot = "blocker") {
    ASSERT_EQ(Submit(robot, "gate"), Skipped::kNot);
    gate_.WaitForArrivals(1);
  }

  FakeClock clock_;
  Gate gate_;
  Answers answers_;
  std::shared_ptr<FakeSet> set_;
  std::unique_ptr<InspectionPool> pool_;
};

TEST_F(InspectionPoolTest, GivesOneVerdictPerIndexInOrder) {
  Start();
  ASSERT_EQ(Submit("r1", "x", {1, 2, 3, 3}), Skipped::kNot);
  ASSERT_EQ(Submit("r1", "x", {}), Skipped::kNot);

  const std::vector<Answer> answers = answers_.Wait(2);

  EXPECT_THAT(answers[0].verdicts,
              ElementsAre(Verdict::kYes, Verdict::kNo, Verdict::kYes, Verdict::kYes));
  EXPECT_THAT(answers[1].verdicts, ElementsAre());
  EXPECT_EQ(answers[0].stats.skipped, Skipped::kNot);
  pool_->Stop();
  EXPECT_EQ(pool_->answered(Skipped::kNot), 2u);
  EXPECT_EQ(pool_->verdicts(Verdict::kYes), 3u);
  EXPECT_EQ(pool_->verdicts(Verdict::kNo), 1u);
}

TEST_F(InspectionPoolTest, RobotsTakeTurns) {
  Start({.queue_time_max = absl::Hours(1)});
  Block();
  for (int i = 0; i < 5; ++i) Submit("flood", absl::StrCat(i));
  Submit("a", "0");
  Submit("b", "0");
  Submit("b", "1");
  gate_.Open();

  std::vector<std::string> order;
  for (const Answer& answer : answers_.Wait(9)) {
    order.push_back(absl::StrCat(answer.robot, answer.payload));
  }
  EXPECT_THAT(order, ElementsAre("blockergate", "flood0", "a0", "b0", "flood1", "b1", "flood2",
                                 "flood3", "flood4"));
}

TEST_F(InspectionPoolTest, OneRobotIsAnsweredInOrderByManyThreads) {
  Start({.threads = 8, .queue_time_max = absl::Hours(1)});
  for (int i = 0; i < 50; ++i) {
    for (const char* robot : {"a", "b", "c"}) {
      ASSERT_EQ(Submit(robot, absl::StrCat(1000 + i)), Skipped::kNot);
    }
  }
  std::map<std::string, std::string> last;
  for (const Answer& answer : answers_.Wait(150)) {
    EXPECT_LT(last[answer.robot], answer.payload) << answer.robot;
    last[answer.robot] = answer.payload;
  }
}

TEST_F(InspectionPoolTest, QueueIsLimitedPerRobotOnly) {
  Start({.waiting_per_robot_max = 2});
  Block();
  EXPECT_EQ(Submit("a", "0"), Skipped::kNot);
  EXPECT_EQ(Submit("a", "1"), Skipped::kNot);
  EXPECT_EQ(Submit("a", "2"), Skipped::kRobotFull);
  for (int i = 0; i < 3000; ++i) {
    ASSERT_EQ(Submit(absl::StrCat("b", i), "x"), Skipped::kNot) << "others do not fill its queue";
  }
  EXPECT_EQ(pool_->waiting(), 3002u);
  gate_.Open();
  answers_.Wait(3003);
  EXPECT_EQ(Submit("a", "3"), Skipped::kNot);
  answers_.Wait(3004);
  pool_->Stop();
  EXPECT_EQ(pool_->answered(Skipped::kRobotFull), 1u);
  EXPECT_EQ(pool_->answered(Skipped::kNot), 3004u);
}

TEST_F(InspectionPoolTest, PayloadsAreNotCopied) {
  Start();
  Block();
  const auto kept = std::make_shared<const std::string>("attack");
  const char* seen = nullptr;
  const auto set = std::make_shared<FakeSet>([&](uint32_t, const Message& message) {
    seen = message.payload.data();
    return Verdict::kNo;
  });
  pool_->Submit({.set = set,
                 .indices = {0},
                 .message = {.robot = "a", .payload = *kept, .owner = kept, .available = true}},
                answers_.Next("a", ""));
  EXPECT_EQ(kept.use_count(), 2);
  gate_.Open();
  answers_.Wait(2);
  EXPECT_EQ(seen, kept->data());
}

TEST_F(InspectionPoolTest, WaitingForOthersIsNoVerdict) {
  Start();
  Block();
  for (const char* robot : {"a", "b"}) ASSERT_EQ(Submit(robot, "x", {1}), Skipped::kNot);
  clock_.Advance(3600 * kNanosPerSecond);
  gate_.Open();

  const std::vector<Answer> answers = answers_.Wait(3);

  for (size_t i = 1; i < answers.size(); ++i) {
    EXPECT_EQ(answers[i].stats.skipped, Skipped::kNot) << answers[i].robot;
    EXPECT_THAT(answers[i].verdicts, ElementsAre(Verdict::kYes));
    EXPECT_EQ(answers[i].stats.waited_ns, 3600 * kNanosPerSecond);
  }
  EXPECT_EQ(pool_->answered(Skipped::kLate), 0u);
}

TEST_F(InspectionPoolTest, WhatWaitedTooLongForItsOwnRobotIsNotInspected) {
  Start({.work_per_second = absl::Seconds(10)});
  Block();
  for (int i = 0; i < 7; ++i) ASSERT_EQ(Submit("a", "slow"), Skipped::kNot);  // 50 ms each
  ASSERT_EQ(Submit("b", "x"), Skipped::kNot);
  gate_.Open();

  std::vector<Skipped> own;
  for (const Answer& answer : answers_.Wait(9)) {
    if (answer.robot == "a") own.push_back(answer.stats.skipped);
    if (answer.robot == "b") {
      EXPECT_EQ(answer.stats.skipped, Skipped::kNot);
    }
  }
  EXPECT_THAT(own, ElementsAre(Skipped::kNot, Skipped::kNot, Skipped::kNot, Skipped::kNot,
                               Skipped::kNot, Skipped::kNot, Skipped::kLate))
      << "250 ms is still in time";
}

// Whoever was stuck may not take the last thread.
TEST_F(InspectionPoolTest, SlowRobotsLeaveAThreadForTheOthers) {
  Start({.threads = 2, .work_per_second = absl::Seconds(100)});
  Submit("evil", "stuck");
  Submit("bad", "stuck");
  answers_.Wait(2);
  ASSERT_EQ(Submit("evil", "gate"), Skipped::kNot);
  gate_.WaitForArrivals(1);
  ASSERT_EQ(Submit("bad", "gate"), Skipped::kNot);

  for (int i = 0; i < 20; ++i) {
    ASSERT_EQ(Submit("a", "x"), Skipped::kNot);
    EXPECT_EQ(answers_.Wait(3 + i).back().robot, "a");
  }
  EXPECT_EQ(pool_->waiting(), 1u) << "`bad` waits for `evil`";
  gate_.Open();
  answers_.Wait(24);
}

TEST_F(InspectionPoolTest, ASlowRobotIsForgivenInTime) {
  Start({.threads = 2, .work_per_second = absl::Seconds(100)});
  Submit("evil", "stuck");
  Submit("bad", "stuck");
  answers_.Wait(2);
  clock_.Advance(11 * kNanosPerSecond);
  Submit("evil", "gate");
  Submit("bad", "gate");
  gate_.WaitForArrivals(2);
  gate_.Open();
  answers_.Wait(4);
}

// A process was started anew because another robot's message had ended it.
TEST_F(InspectionPoolTest, StartingProcessesIsNobodysCost) {
  class Starting final : public Session {
   public:
    explicit Starting(FakeClock* clock) : clock_(clock) {}
    Verdict Inspect(uint32_t, const Message&) override {
      clock_->Advance(kNanosPerSecond + 10);
      return Verdict::kNo;
    }
    int64_t TakeStartNs() override { return kNanosPerSecond; }

   private:
    FakeClock* clock_;
  };
  class StartingSet final : public InspectionSet {
   public:
    explicit StartingSet(FakeClock* clock) : clock_(clock) {}
    size_t size() const override { return 1; }
    std::unique_ptr<Session> NewSession() const override {
      return std::make_unique<Starting>(clock_);
    }

   private:
    FakeClock* clock_;
  };
  Start();
  const auto set = std::make_shared<StartingSet>(&clock_);
  for (int i = 0; i < 5; ++i) {
    pool_->Submit({.set = set, .indices = {0}, .message = {.robot = "a"}}, answers_.Next("a", ""));
    EXPECT_EQ(answers_.Wait(i + 1).back().stats.skipped, Skipped::kNot);
  }
  pool_->Stop();
  EXPECT_EQ(pool_->worked_ns(), 50);
}

TEST_F(InspectionPoolTest, ARobotThatUsedItsTimeIsNotInspectedUntilItHasSomeAgain) {
  Start({.work_per_second = absl::Milliseconds(200)});
  // Each takes 50 ms of the 200; while it runs, 10 ms come back.
  for (int i = 0; i < 5; ++i) {
    ASSERT_EQ(Submit("a", "slow"), Skipped::kNot);
    EXPECT_EQ(answers_.Wait(i + 1).back().stats.skipped, Skipped::kNot) << i;
  }
  Submit("a", "slow");
  EXPECT_EQ(answers_.Wait(6).back().stats.skipped, Skipped::kBudget);
  EXPECT_THAT(answers_.Wait(6).back().verdicts, ElementsAre(Verdict::kUnscanned));
  Submit("b", "slow");
  EXPECT_EQ(answers_.Wait(7).back().stats.skipped, Skipped::kNot) << "another robot";

  clock_.Advance(kNanosPerSecond);
  Submit("a", "slow");
  EXPECT_EQ(answers_.Wait(8).back().stats.skipped, Skipped::kNot);
  EXPECT_EQ(pool_->answered(Skipped::kBudget), 1u);
  EXPECT_EQ(pool_->worked_ns(), 7 * 50 * kNanosPerMilli);
}

TEST_F(InspectionPoolTest, ALongInspectionIsADebt) {
  Start({.work_per_second = absl::Milliseconds(200)});
  Submit("a", "stuck", {1, 1, 1});
  const Answer first = answers_.Wait(1).back();
  EXPECT_THAT(first.verdicts, ElementsAre(Verdict::kYes, Verdict::kUnscanned, Verdict::kUnscanned))
      << "what was found out is told";
  EXPECT_EQ(first.stats.skipped, Skipped::kBudget);

  clock_.Advance(10 * kNanosPerSecond);  // 13 s since it began pay for 2.6 of the 2.8 s
  Submit("a", "x");
  EXPECT_EQ(answers_.Wait(2).back().stats.skipped, Skipped::kBudget);
  clock_.Advance(2 * kNanosPerSecond);
  Submit("a", "x");
  EXPECT_EQ(answers_.Wait(3).back().stats.skipped, Skipped::kNot);
}

TEST_F(InspectionPoolTest, RobotsRememberedAreLimited) {
  Start({.robots_max = 2});
  Submit("a", "slow");
  answers_.Wait(1);
  Submit("b", "slow");
  answers_.Wait(2);
  EXPECT_EQ(Submit("c", "x"), Skipped::kFull) << "both still owe";
  // A robot's turn ends after its answer.
  while (Submit("c", "x") != Skipped::kNot) {
    clock_.Advance(kNanosPerSecond);
  }
  answers_.Wait(3);
}

// A process that the kernel does not let go.
TEST_F(InspectionPoolTest, AStuckThreadDoesNotStopOtherRobots) {
  Start();
  Block("evil");
  EXPECT_EQ(pool_->threads(), 1u);
  ASSERT_EQ(Submit("a", "x"), Skipped::kNot);
  clock_.Advance(3001 * kNanosPerMilli);

  ASSERT_EQ(Submit("b", "x"), Skipped::kNot);

  const std::vector<Answer> answers = answers_.Wait(2);
  EXPECT_EQ(pool_->threads(), 2u);
  EXPECT_EQ(answers[0].robot, "a");
  EXPECT_EQ(answers[0].stats.skipped, Skipped::kNot);
  EXPECT_EQ(answers[1].robot, "b");
  EXPECT_EQ(answers[1].stats.skipped, Skipped::kNot);
  // The robot that is stuck waits for its own.
  ASSERT_EQ(Submit("evil", "x"), Skipped::kNot);
  ASSERT_EQ(Submit("a", "x"), Skipped::kNot);
  EXPECT_EQ(answers_.Wait(3)[2].robot, "a");
  gate_.Open();
  answers_.Wait(5);
}

TEST_F(InspectionPoolTest, GrowthIsLimited) {
  Start({.queue_time_max = absl::Hours(1)});
  for (int i = 0; i < kPoolThreadsMax; ++i) {
    ASSERT_EQ(Submit(absl::StrCat("evil", i), "gate"), Skipped::kNot);
    gate_.WaitForArrivals(i + 1);
    clock_.Advance(4 * kNanosPerSecond);
  }
  Submit("a", "x");
  EXPECT_EQ(pool_->threads(), static_cast<size_t>(kPoolThreadsMax));
  gate_.Open();
  answers_.Wait(kPoolThreadsMax + 1);
}

TEST_F(InspectionPoolTest, StopAnswersWhatWaitsAndRefusesTheRest) {
  Start();
  Block();
  Submit("a", "0", {1, 1});
  Submit("b", "0");
  std::thread stopper([this] { pool_->Stop(); });
  while (Submit("c", "x") != Skipped::kStopped) std::this_thread::yield();
  gate_.Open();
  stopper.join();

  const std::vector<Answer> answers = answers_.Wait(3);
  EXPECT_EQ(answers[0].stats.skipped, Skipped::kNot) << "what was under way is finished";
  for (size_t i = 1; i < answers.size(); ++i) {
    EXPECT_EQ(answers[i].stats.skipped, Skipped::kStopped);
    EXPECT_THAT(answers[i].verdicts, Each(Verdict::kUnscanned));
  }
  const size_t answered = answers_.size();
  pool_->Stop();
  EXPECT_EQ(Submit("a", "x"), Skipped::kStopped);
  EXPECT_EQ(answers_.size(), answered);
  EXPECT_EQ(set_->alive, 0);
}

TEST_F(InspectionPoolTest, SessionsAreMadeOncePerThreadAndSet) {
  Start();
  for (int i = 0; i < 10; ++i) {
    Submit("a", "x");
    answers_.Wait(i + 1);
  }
  EXPECT_EQ(set_->sessions, 1);
}

TEST_F(InspectionPoolTest, SessionsOfAPolicyThatIsGoneAreDropped) {
  Start();
  auto old_set = std::make_shared<FakeSet>([](uint32_t, const Message&) { return Verdict::kNo; });
  const std::weak_ptr<FakeSet> old = old_set;
  pool_->Submit({.set = std::move(old_set), .indices = {0}, .message = {.robot = "a"}},
                answers_.Next("a", ""));
  answers_.Wait(1);
  // Dropped at the latest when the thread comes for the request after the next.
  Submit("a", "x");
  answers_.Wait(2);
  Submit("a", "x");
  answers_.Wait(3);
  EXPECT_TRUE(old.expired());
}

TEST_F(InspectionPoolTest, SessionsKeptByAThreadAreLimited) {
  Start();
  std::vector<std::shared_ptr<FakeSet>> sets;
  size_t answered = 0;
  for (int i = 0; i < 40; ++i) {
    sets.push_back(
        std::make_shared<FakeSet>([](uint32_t, const Message&) { return Verdict::kNo; }));
    pool_->Submit({.set = sets.back(), .indices = {0}, .message = {.robot = "a"}},
                  answers_.Next("a", ""));
    answers_.Wait(++answered);
  }
  int alive = 0;
  for (const auto& set : sets) alive += set->alive;
  EXPECT_EQ(alive, 16);
  EXPECT_EQ(sets.back()->alive, 1) << "the last one used stays";
}

TEST_F(InspectionPoolTest, ADoneMaySubmit) {
  Start();
  pool_->Submit({.set = set_, .indices = {0}, .message = {.robot = "a"}},
                [&](std::vector<Verdict>, const InspectionStats&) {
                  EXPECT_EQ(Submit("a", "again"), Skipped::kNot);
                });
  EXPECT_EQ(answers_.Wait(1)[0].payload, "again");
}

TEST_F(InspectionPoolTest, ManyThreadsSubmitAndOneStops) {
  Start({.threads = 4});
  std::atomic<int> taken = 0;
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < 500; ++i) {
        if (Submit(absl::StrCat("r", t), "x", {0, 1}) == Skipped::kNot) ++taken;
      }
    });
  }
  answers_.Wait(10);
  pool_->Stop();
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(answers_.size(), static_cast<size_t>(taken));
  EXPECT_EQ(pool_->waiting(), 0u);
}

}  // namespace
}  // namespace rips::inspect

#include "services/runtime/bounded_queue.h"

#include <atomic>
#include <memory>
#include <thread>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::Optional;

TEST(BoundedQueueTest, GivesItemsInOrder) {
  BoundedQueue<int> queue({.capacity = 3});

  EXPECT_TRUE(queue.Push(1));
  EXPECT_TRUE(queue.Push(2));
  EXPECT_TRUE(queue.Push(3));

  EXPECT_THAT(queue.Pop(absl::ZeroDuration()), Optional(1));
  EXPECT_THAT(queue.PopAll(absl::ZeroDuration()), ElementsAre(2, 3));
  EXPECT_EQ(queue.dropped(), 0u);
}

TEST(BoundedQueueTest, RefusesTheNewItemWhenFull) {
  BoundedQueue<int> queue({.capacity = 2});
  queue.Push(1);
  queue.Push(2);

  EXPECT_FALSE(queue.Push(3));

  EXPECT_EQ(queue.dropped(), 1u);
  EXPECT_THAT(queue.PopAll(absl::ZeroDuration()), ElementsAre(1, 2));
}

TEST(BoundedQueueTest, DropsTheOldestItemWhenFull) {
  BoundedQueue<std::unique_ptr<int>> queue({.capacity = 2, .on_full = OnFull::kDropOldest});

  for (int i = 1; i <= 5; ++i) EXPECT_TRUE(queue.Push(std::make_unique<int>(i)));

  EXPECT_EQ(queue.dropped(), 3u);
  EXPECT_EQ(queue.size(), 2u);
  EXPECT_EQ(**queue.Pop(absl::ZeroDuration()), 4);
}

TEST(BoundedQueueTest, PopAllTakesAtMostMax) {
  BoundedQueue<int> queue({.capacity = 5});
  for (int i = 0; i < 5; ++i) queue.Push(i);

  EXPECT_THAT(queue.PopAll(absl::ZeroDuration(), 2), ElementsAre(0, 1));
  EXPECT_EQ(queue.size(), 3u);
}

TEST(BoundedQueueTest, PopGivesUpAfterItsTimeout) {
  BoundedQueue<int> queue({.capacity = 1});
  const int64_t start_ns = BoottimeNow();

  EXPECT_EQ(queue.Pop(absl::Milliseconds(20)), std::nullopt);

  EXPECT_GE(BoottimeNow() - start_ns, 20 * kNanosPerMilli);
}

TEST(BoundedQueueTest, CloseRefusesNewItemsAndKeepsOldOnes) {
  BoundedQueue<int> queue({.capacity = 2});
  queue.Push(1);

  queue.Close();

  EXPECT_FALSE(queue.Push(2));
  EXPECT_EQ(queue.dropped(), 0u);
  EXPECT_THAT(queue.Pop(absl::InfiniteDuration()), Optional(1));
  EXPECT_EQ(queue.Pop(absl::InfiniteDuration()), std::nullopt);
}

TEST(BoundedQueueTest, CloseWakesEveryWaiter) {
  BoundedQueue<int> queue({.capacity = 1});
  std::thread one([&] { EXPECT_EQ(queue.Pop(absl::InfiniteDuration()), std::nullopt); });
  std::thread many([&] { EXPECT_THAT(queue.PopAll(absl::Hours(1)), IsEmpty()); });

  queue.Close();

  one.join();
  many.join();
}

TEST(BoundedQueueTest, LosesNothingBetweenManyThreads) {
  constexpr int kThreads = 3;
  constexpr int kItems = 2000;
  BoundedQueue<int> queue({.capacity = 16});
  std::atomic<int64_t> taken = 0;
  std::atomic<int64_t> sum = 0;
  std::vector<std::thread> consumers;
  for (int i = 0; i < kThreads; ++i) {
    consumers.emplace_back([&] {
      while (true) {
        const std::vector<int> batch = queue.PopAll(absl::InfiniteDuration(), 5);
        if (batch.empty()) return;
        for (const int item : batch) sum += item;
        taken += static_cast<int64_t>(batch.size());
      }
    });
  }
  std::vector<std::thread> producers;
  for (int i = 0; i < kThreads; ++i) {
    producers.emplace_back([&] {
      for (int item = 1; item <= kItems; ++item) {
        while (!queue.Push(item)) std::this_thread::yield();
      }
    });
  }

  for (std::thread& thread : producers) thread.join();
  queue.Close();
  for (std::thread& thread : consumers) thread.join();

  EXPECT_EQ(taken, kThreads * kItems);
  EXPECT_EQ(sum, kThreads * int64_t{kItems} * (kItems + 1) / 2);
}

TEST(MutexTest, CondVarHandsOverUnderTheLock) {
  Mutex mu;
  CondVar changed;
  int turns = 0;
  const auto play = [&](int parity) {
    for (int i = 0; i < 500; ++i) {
      MutexLock lock(&mu);
      while (turns % 2 != parity) changed.Wait(lock);
      ++turns;
      changed.NotifyAll();
    }
  };

  std::thread even([&] { play(0); });
  std::thread odd([&] { play(1); });
  even.join();
  odd.join();

  MutexLock lock(&mu);
  EXPECT_EQ(turns, 1000);
}

TEST(MutexTest, WaitUntilSaysWhenTheDeadlineHasPassed) {
  Mutex mu;
  CondVar never;
  MutexLock lock(&mu);
  const int64_t deadline_ns = BoottimeAfter(absl::Milliseconds(10));

  while (never.WaitUntil(lock, deadline_ns)) {
  }

  EXPECT_GE(BoottimeNow(), deadline_ns);
  EXPECT_FALSE(never.WaitUntil(lock, deadline_ns));
  EXPECT_FALSE(never.WaitFor(lock, absl::Milliseconds(1)));
}

TEST(RealClockTest, BoottimeGoesForwardAndSaturates) {
  const RealClock clock;
  const Instant first = clock.Now();
  const Instant second = clock.Now();

  EXPECT_LE(first.boottime_ns, second.boottime_ns);
  EXPECT_GT(first.unix_ns, 1'700'000'000 * kNanosPerSecond);
  EXPECT_EQ(BoottimeAfter(absl::InfiniteDuration()), INT64_MAX);
}

}  // namespace
}  // namespace rips

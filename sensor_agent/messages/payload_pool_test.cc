#include "sensor_agent/messages/payload_pool.h"

#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::sensor {
namespace {

constexpr size_t kEach = 100 + kPayloadOverheadBytes;

TEST(PayloadPoolTest, KeepsWhatFitsAndCountsWhatDoesNot) {
  PayloadPool pool(2 * kEach);
  const std::string bytes(100, 'x');
  Payload first = pool.Keep(bytes);
  const Payload second = pool.Keep(bytes);
  ASSERT_NE(first, nullptr);
  EXPECT_EQ(*first, bytes);
  EXPECT_EQ(pool.bytes(), 2 * kEach);
  EXPECT_EQ(pool.Keep(""), nullptr) << "an empty one costs, too";
  EXPECT_EQ(pool.Keep(bytes), nullptr);
  EXPECT_EQ(pool.bytes(), 2 * kEach) << "what was refused is not held";
  EXPECT_EQ(pool.TakeRefused(), 2u);
  EXPECT_EQ(pool.TakeRefused(), 0u);

  const Payload shared = first;
  first = nullptr;
  EXPECT_EQ(pool.Keep(bytes), nullptr) << "still held";
  EXPECT_EQ(*shared, bytes);
}

TEST(PayloadPoolTest, RoomComesBackWithTheLastHolder) {
  PayloadPool pool(kEach);
  for (int i = 0; i < 1'000; ++i) EXPECT_NE(pool.Keep(std::string(100, 'x')), nullptr);
  EXPECT_EQ(pool.bytes(), 0u);
}

TEST(PayloadPoolTest, PayloadsOutliveThePool) {
  std::optional<PayloadPool> pool(std::in_place, 1'000);
  const Payload payload = pool->Keep("abc");
  pool.reset();
  EXPECT_EQ(*payload, "abc");
}

TEST(PayloadPoolTest, HoldsItsLimitBetweenThreads) {
  PayloadPool pool(10 * kEach);
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&] {
      const std::string bytes(100, 'x');
      for (int i = 0; i < 2'000; ++i) {
        const Payload one = pool.Keep(bytes);
        const Payload two = pool.Keep(bytes);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(pool.bytes(), 0u);
  EXPECT_EQ(pool.TakeRefused(), 0u) << "there is room for eight";
}

}  // namespace
}  // namespace rips::sensor

#include "services/rpc/reading_pace.h"

#include "gtest/gtest.h"

namespace rips::rpc {
namespace {

using Next = ReadingPace::Next;
constexpr int64_t kMilli = kNanosPerMilli;

int64_t CpuNs() {
  timespec now = {};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return now.tv_sec * kNanosPerSecond + now.tv_nsec;
}

void Work(int64_t ns) {
  for (const int64_t end_ns = CpuNs() + ns; CpuNs() < end_ns;) {
  }
}

TEST(ReadingPaceTest, ABurstAndThenSoMuchASecond) {
  ReadingPace pace({}, 0);
  for (int i = 0; i < 50; ++i) ASSERT_EQ(pace.OnRead(10 * kMilli, 0), Next::kRead) << i;
  EXPECT_EQ(pace.OnRead(10 * kMilli, 0), Next::kPauseIsNews);
  EXPECT_FALSE(pace.MayRead(0));
  EXPECT_FALSE(pace.MayRead(99 * kMilli));
  EXPECT_TRUE(pace.MayRead(101 * kMilli));
  int64_t used_ns = 0;
  for (int64_t now_ns = 101 * kMilli; now_ns < 10'101 * kMilli; now_ns += 10 * kMilli) {
    if (!pace.MayRead(now_ns)) continue;
    used_ns += 10 * kMilli;
    EXPECT_NE(pace.OnRead(10 * kMilli, now_ns), Next::kPauseIsNews);
  }
  EXPECT_NEAR(static_cast<double>(used_ns), 1e9, 2e7) << "a tenth of a processor";
}

TEST(ReadingPaceTest, IsNewsAgainAfterTenMinutes) {
  ReadingPace pace({}, 0);
  EXPECT_EQ(pace.OnRead(600 * kMilli, 0), Next::kPauseIsNews);
  EXPECT_EQ(pace.OnRead(600 * kMilli, 599'000 * kMilli), Next::kPause);
  EXPECT_EQ(pace.OnRead(600 * kMilli, 600'000 * kMilli), Next::kPauseIsNews);
}

TEST(ReadingPaceTest, ALotOfAnHonestSensorIsRead) {
  ReadingPace pace({}, 0);
  // 1,000 batches and 1,000 pieces of payloads a second, for a minute.
  for (int64_t now_ns = 0; now_ns < 60'000 * kMilli; now_ns += kMilli) {
    ASSERT_EQ(pace.OnRead(20'000, now_ns), Next::kRead);
    ASSERT_EQ(pace.OnRead(60'000, now_ns), Next::kRead);
  }
}

TEST(ReadingCostTest, AThreadThatIsKeptFromItsWorkIsNotThePeersFault) {
  const ReadingCost long_one(1 << 20);
  const ReadingCost short_one(1'000);
  Work(5 * kMilli);
  timespec nap = {.tv_sec = 0, .tv_nsec = 50 * kMilli};
  nanosleep(&nap, nullptr);
  const int64_t took_ns = long_one.Take();
  EXPECT_GE(took_ns, 5 * kMilli + (1 << 18)) << "and what came before it was here";
  EXPECT_LT(took_ns, 50 * kMilli) << "it slept";
  EXPECT_EQ(short_one.Take(), 120'000 + 5'250) << "no more than 1,000 bytes can cost";
}

TEST(ReadingPacesTest, OneThatComesBackIsKnown) {
  ReadingPaces paces;
  std::shared_ptr<ReadingPace> pace = paces.Of("r1", 0);
  EXPECT_EQ(pace->OnRead(600 * kMilli, 0), Next::kPauseIsNews);
  pace.reset();
  paces.Prune(kMilli);
  EXPECT_FALSE(paces.Of("r1", kMilli)->MayRead(kMilli));
  EXPECT_TRUE(paces.Of("r2", kMilli)->MayRead(kMilli));
  EXPECT_EQ(paces.size(), 2u);
  const std::shared_ptr<ReadingPace> open = paces.Of("r2", kMilli);
  paces.Prune(700'000 * kMilli);
  EXPECT_EQ(paces.size(), 1u) << "those of open streams stay";
}

}  // namespace
}  // namespace rips::rpc

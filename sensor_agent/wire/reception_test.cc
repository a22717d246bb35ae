#include "sensor_agent/wire/reception.h"

#include "gtest/gtest.h"
#include "sensor_agent/wire/rtps_bytes.h"

namespace rips::wire {
namespace {

constexpr int64_t kStepNs = 200 * kNanosPerMilli;
constexpr uint64_t kFar = uint64_t{1} << 40;

class ReceptionTest : public testing::Test {
 protected:
  void Sent(NumberRun run) {
    Traffic traffic{.writer = TestGuid(1, 0x103), .data = 1, .data_last = run.last};
    traffic.numbers.Add(run);
    reception_.OnWire(traffic, now_ns_);
  }
  void Heartbeat(uint64_t first, uint64_t last) {
    reception_.OnWire({.writer = TestGuid(1, 0x103),
                       .heartbeat = 1,
                       .heartbeat_last = last,
                       .heartbeat_least = last,
                       .dropped_last = first - 1},
                      now_ns_);
  }
  void Got(NumberRun run) {
    for (uint64_t number = run.first; number <= run.last; ++number) reception_.Received(number);
  }
  // The next interval of the tap, in which 10 samples go out.
  bool Step(bool we_get_them, uint64_t count = 10) {
    now_ns_ += kStepNs;
    const NumberRun run = {.first = next_, .last = next_ + count - 1};
    next_ += count;
    Sent(run);
    if (we_get_them) Got(run);
    return reception_.Missing(now_ns_);
  }

  int64_t now_ns_ = 100 * kNanosPerSecond;
  uint64_t next_ = 1;
  Reception reception_{now_ns_};
};

TEST_F(ReceptionTest, WhatReachesUsIsNotMissed) {
  for (int i = 0; i < 100; ++i) EXPECT_FALSE(Step(/*we_get_them=*/true));
}

TEST_F(ReceptionTest, SamplesThatGoPastUsAreMissedWithinFourSeconds) {
  for (int i = 0; i < 10; ++i) EXPECT_FALSE(Step(true));
  int steps = 0;
  while (!Step(false)) ASSERT_LT(++steps, 4 * 5);
  EXPECT_GE(steps, 2 * 5);
  EXPECT_GE(reception_.missed(), 50);
  EXPECT_GE(reception_.sent(), reception_.missed());
}

TEST_F(ReceptionTest, AHighNumberThatWeGotHidesNothing) {
  Sent({.first = kFar, .last = kFar});
  Got({.first = kFar, .last = kFar});
  int steps = 0;
  while (!Step(false)) ASSERT_LT(++steps, 4 * 5);
}

TEST_F(ReceptionTest, AFewSamplesForUsHideNothing) {
  int steps = 0;
  for (;;) {
    reception_.Received(next_);  // one of ten
    if (Step(false)) break;
    ASSERT_LT(++steps, 4 * 5);
  }
}

TEST_F(ReceptionTest, IsOverWhenHalfOfThemComeAgain) {
  for (int i = 0; i < 20; ++i) Step(false);
  EXPECT_TRUE(Step(false));
  int steps = 0;
  while (Step(true)) ASSERT_LT(++steps, 4 * 5);
}

TEST_F(ReceptionTest, HistoryThatWeHaveHadIsHeard) {
  Got({.first = 1, .last = 1'000});
  next_ = 1'001;
  for (int i = 0; i < 100; ++i) {
    now_ns_ += kStepNs;
    Sent({.first = 1, .last = 1'000});  // to one late joiner after the other
    EXPECT_FALSE(reception_.Missing(now_ns_));
  }
}

TEST_F(ReceptionTest, ALostSampleCountsOnceHoweverOftenItIsSentAgain) {
  for (int i = 0; i < 200; ++i) {
    now_ns_ += kStepNs;
    Sent({.first = 5, .last = 9});
    EXPECT_FALSE(reception_.Missing(now_ns_));
  }
}

TEST_F(ReceptionTest, OneSecondOfLossIsNone) {
  for (int round = 0; round < 5; ++round) {
    for (int i = 0; i < 5; ++i) EXPECT_FALSE(Step(false));
    for (int i = 0; i < 10; ++i) EXPECT_FALSE(Step(true));
  }
}

TEST_F(ReceptionTest, SamplesThatComeLateAreHeard) {
  for (int i = 0; i < 50; ++i) {
    now_ns_ += kStepNs;
    Sent({.first = next_, .last = next_ + 9});
    if (i >= 4) Got({.first = next_ - 40, .last = next_ - 31});
    next_ += 10;
    EXPECT_FALSE(reception_.Missing(now_ns_));
  }
}

TEST_F(ReceptionTest, ManyLossesAreNotWhatGoesPastUs) {
  for (int i = 0; i < 50; ++i) {
    now_ns_ += kStepNs;
    Sent({.first = next_, .last = next_ + 1'999});
    for (uint64_t k = 0; k < 2'000; k += 1 + (k % 10 == 8)) reception_.Received(next_ + k);
    next_ += 2'000;
    EXPECT_FALSE(reception_.Missing(now_ns_));
  }
  int steps = 0;
  while (!Step(false, 2'000)) {
    for (uint64_t k = 0; k < 200; ++k) reception_.Received(next_ - 2'000 + 10 * k);
    ASSERT_LT(++steps, 5 * 5);
  }
}

TEST_F(ReceptionTest, FewSamplesTakeLonger) {
  int steps = 0;
  while (!Step(false, 1)) ASSERT_LT(++steps, 100);
  EXPECT_GE(reception_.missed(), Reception::kSamplesMissed);
}

TEST_F(ReceptionTest, WhatWasSentBeforeTheWriterKnewUsIsNotMissed) {
  reception_ = Reception(now_ns_ + 10 * kNanosPerSecond);
  for (int i = 0; i < 49; ++i) EXPECT_FALSE(Step(false));
  for (int i = 0; i < 50; ++i) EXPECT_FALSE(Step(true));
}

TEST_F(ReceptionTest, WhatWeLostOurselvesIsExcused) {
  for (int i = 0; i < 100; ++i) {
    EXPECT_FALSE(Step(false));
    if (i % 5 == 0) reception_.Excuse();
  }
}

TEST_F(ReceptionTest, HeartbeatsSpeakOfWhatPassesElsewhere) {
  bool missing = false;
  for (uint64_t last = 10; last < 210 && !missing; last += 10) {
    now_ns_ += kStepNs;
    Heartbeat(1, last);
    missing = reception_.Missing(now_ns_);
  }
  EXPECT_TRUE(missing);
}

TEST_F(ReceptionTest, WhatAHeartbeatSaysHasGoneNeedNotHaveBeenSent) {
  for (uint64_t last = 10; last < 1'000; last += 10) {
    now_ns_ += kStepNs;
    Heartbeat(last, last);  // keep last 1
    Got({.first = last, .last = last});
    EXPECT_FALSE(reception_.Missing(now_ns_));
  }
  // A forged one is no number of samples.
  for (int i = 0; i < 30; ++i) {
    now_ns_ += kStepNs;
    Heartbeat(1, kFar + static_cast<uint64_t>(i) * 2'000'000);
    EXPECT_FALSE(reception_.Missing(now_ns_));
  }
}

}  // namespace
}  // namespace rips::wire

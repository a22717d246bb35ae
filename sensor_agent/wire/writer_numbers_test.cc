#include "sensor_agent/wire/writer_numbers.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/wire/rtps_bytes.h"
#include "services/base/clock.h"

namespace rips::wire {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr uint64_t kFar = uint64_t{1} << 40;

Traffic Data(uint64_t first, uint64_t last, uint32_t entity = 0x103) {
  return {.writer = TestGuid(1, entity), .data = 1, .data_last = last, .data_least = first};
}
Traffic Heartbeat(uint64_t first, uint64_t last) {
  return {.writer = TestGuid(1, 0x103),
          .heartbeat = 1,
          .heartbeat_last = last,
          .heartbeat_least = last,
          .dropped_last = first - 1};
}
Traffic Gap(uint64_t base) { return {.writer = TestGuid(1, 0x103), .dropped_last = base - 1}; }

class WriterNumbersTest : public testing::Test {
 protected:
  std::string Take(const Traffic& traffic) {
    now_ns_ += 200 * kNanosPerMilli;
    return numbers_.Take(traffic, now_ns_);
  }

  WriterNumbers numbers_;
  int64_t now_ns_ = 100 * kNanosPerSecond;
};

TEST_F(WriterNumbersTest, AWriterThatGoesOnIsHonest) {
  for (uint64_t i = 1; i < 2'000'000; i += 20'000) {
    EXPECT_THAT(Take(Data(i, i + 19'999)), IsEmpty());
    EXPECT_THAT(Take(Heartbeat(i, i + 19'999)), IsEmpty());
  }
}

TEST_F(WriterNumbersTest, AJumpIsFoundAtOnce) {
  Take(Data(1, 10));
  EXPECT_THAT(Take(Data(11, kFar)), HasSubstr("number 1099511627776 right after 10"));
  // It begins anew, and finds the next one, too.
  EXPECT_THAT(Take(Data(12, 14)), IsEmpty());
  EXPECT_THAT(Take(Data(kFar, kFar)), HasSubstr("right after 14"));
}

TEST_F(WriterNumbersTest, HeartbeatsAndGapsJumpToo) {
  Take(Data(1, 1));
  EXPECT_THAT(Take(Heartbeat(kFar, kFar)), HasSubstr("right after 1"));
  Take(Data(2, 2));
  EXPECT_THAT(Take(Gap(kFar)), HasSubstr("right after 2"));
  // First 2^40, last 1: there is nothing left.
  Take(Data(3, 3));
  EXPECT_THAT(Take({.writer = TestGuid(1, 0x103),
                    .heartbeat = 1,
                    .heartbeat_last = 3,
                    .heartbeat_least = 3,
                    .dropped_last = kFar}),
              HasSubstr("right after 3"));
}

TEST_F(WriterNumbersTest, NumbersThatGoBackAreOfTwoWriters) {
  // The forged one came first.
  EXPECT_THAT(Take(Data(kFar, kFar)), IsEmpty());
  EXPECT_EQ(Take(Data(1, 3)), "number 1 after 1099511627776");

  EXPECT_THAT(Take(Heartbeat(kFar, kFar)), IsEmpty());
  EXPECT_EQ(Take(Heartbeat(1, 1)), "last number by HEARTBEAT 1 after 1099511627776");
}

TEST_F(WriterNumbersTest, HeartbeatsGoBackByNothing) {
  Take(Data(5'000, 5'000));
  EXPECT_THAT(Take(Heartbeat(1, 5'000 - WriterNumbers::kHeartbeatBack)), IsEmpty());
  EXPECT_EQ(Take(Heartbeat(1, 5'000 - WriterNumbers::kHeartbeatBack - 1)),
            "last number by HEARTBEAT 4935 after 5000");
}

TEST_F(WriterNumbersTest, BothWithinOneInterval) {
  EXPECT_EQ(Take(Data(7, kFar)), "number 7 and number 1099511627776 at the same time");
}

TEST_F(WriterNumbersTest, ALongHistoryIsHonest) {
  // To a late joiner, of a writer that we know from its newest sample.
  Take(Data(900'000, 900'000));
  EXPECT_THAT(Take(Data(1, 500'000)), IsEmpty());
  // With keys old samples stay for ever.
  WriterNumbers keys;
  EXPECT_THAT(keys.Take(Data(9'000'000, 9'000'000, 0x102), now_ns_), IsEmpty());
  EXPECT_THAT(keys.Take(Data(1, 9'000'000, 0x102), now_ns_ + kNanosPerSecond), IsEmpty());
}

TEST_F(WriterNumbersTest, AWriterThatWasNotHeardForLongMayBeFarOn) {
  Take(Data(1, 10));
  now_ns_ += 3'600 * kNanosPerSecond;
  EXPECT_THAT(Take(Data(10'000'000'000, 10'000'000'000)), IsEmpty());
}

TEST_F(WriterNumbersTest, NothingSaysNothing) {
  EXPECT_THAT(Take(Traffic{.writer = TestGuid(1, 0x103), .packets = 1}), IsEmpty());
  Take(Data(1'000, 1'000));
  // Last number zero, as some greet new readers.
  EXPECT_THAT(Take(Traffic{.writer = TestGuid(1, 0x103), .heartbeat = 1}), IsEmpty());
}

}  // namespace
}  // namespace rips::wire

#include "sensor_agent/outbox/backlog_queue.h"

#include <memory>
#include <string>
#include <vector>

#include "gmock/gmock.h"

namespace rips::sensor {
namespace {

using ::testing::IsEmpty;
using ::testing::IsNull;
using ::testing::NotNull;
using ::testing::SizeIs;

class BacklogQueueTest : public ::testing::Test {
 protected:
  void Put(uint64_t first_sequence, uint32_t count) {
    queue_.Put({.first_sequence = first_sequence,
                .count = count,
                .bytes = std::make_shared<const std::string>("b")});
  }

  BacklogQueue queue_{StreamKey{}};
  std::vector<SpoolRecord> release_;
};

// Found by tests/simulation (seed 9): what the sensor had sent live before its stream broke was
// judged when the next stream had been answered already.
TEST_F(BacklogQueueTest, TakesAnAcknowledgementOfWhatAnEarlierConnectionBrought) {
  Put(6, 6);
  Put(12, 1);
  EXPECT_TRUE(queue_.Rewind());
  EXPECT_THAT(queue_.Front(), IsNull()) << "the server says first where it stands";
  EXPECT_FALSE(queue_.Acknowledge(5, release_));
  ASSERT_THAT(queue_.Front(), NotNull());
  EXPECT_TRUE(queue_.Acknowledge(11, release_)) << "nothing was sent on this connection";
  ASSERT_THAT(queue_.entries(), SizeIs(1));
  EXPECT_EQ(queue_.Front()->first_sequence, 12u);
  queue_.MarkSent();
  EXPECT_TRUE(queue_.Acknowledge(12, release_));
  EXPECT_THAT(queue_.entries(), IsEmpty());
  EXPECT_EQ(queue_.sent(), 0u);
}

TEST_F(BacklogQueueTest, AnAcknowledgementWithinABatchKeepsAllOfIt) {
  Put(1, 10);
  queue_.Rewind();
  queue_.Acknowledge(0, release_);
  queue_.MarkSent();
  EXPECT_FALSE(queue_.Acknowledge(9, release_));
  EXPECT_THAT(queue_.entries(), SizeIs(1));
}

}  // namespace
}  // namespace rips::sensor

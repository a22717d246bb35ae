#include "services/rpc/outgoing_queue.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::rpc {
namespace {

using ::testing::ElementsAre;

TEST(OutgoingQueueTest, BulkGoesWhenNothingElseWaits) {
  OutgoingQueue<int> queue(8);
  EXPECT_TRUE(queue.PushBulk(101));
  EXPECT_TRUE(queue.PushBulk(102));
  EXPECT_TRUE(queue.Push(1));
  EXPECT_TRUE(queue.Push(2));
  EXPECT_EQ(queue.Pop(), 1);
  EXPECT_FALSE(queue.Written());
  EXPECT_EQ(queue.Pop(), 2);
  EXPECT_FALSE(queue.Written());
  EXPECT_EQ(queue.Pop(), 101);
  EXPECT_EQ(queue.bulk_unwritten(), 2u) << "it is being written";
  EXPECT_TRUE(queue.Push(3));
  EXPECT_FALSE(queue.Written());
  EXPECT_EQ(queue.Pop(), 3);
  EXPECT_FALSE(queue.Written());
  EXPECT_EQ(queue.Pop(), 102);
  EXPECT_TRUE(queue.Written());
  EXPECT_EQ(queue.bulk_unwritten(), 0u);
}

TEST(OutgoingQueueTest, WhatIsNotBeingWrittenCanBeTakenBack) {
  OutgoingQueue<int> queue(8);
  for (const int item : {1, 2, 3}) EXPECT_TRUE(queue.PushBulk(item));
  EXPECT_EQ(queue.Pop(), 1);
  EXPECT_THAT(queue.RecallBulk(), ElementsAre(2, 3));
  EXPECT_EQ(queue.bulk_unwritten(), 1u);
  EXPECT_TRUE(queue.Written());
}

TEST(OutgoingQueueTest, EachKindHasItsLimit) {
  OutgoingQueue<int> queue(2);
  for (const bool taken : {true, true, false}) {
    EXPECT_EQ(queue.Push(1), taken);
    EXPECT_EQ(queue.PushBulk(1), taken);
  }
  EXPECT_EQ(queue.Pop(), 1);
  EXPECT_TRUE(queue.Push(1));
  EXPECT_FALSE(queue.PushBulk(1));
}

TEST(OutgoingQueueTest, AClosedQueueTakesAndGivesNothing) {
  OutgoingQueue<int> queue(2);
  EXPECT_TRUE(queue.Push(1));
  queue.Close();
  EXPECT_FALSE(queue.Push(1));
  EXPECT_FALSE(queue.PushBulk(1));
  EXPECT_EQ(queue.Pop(), std::nullopt);
}

}  // namespace
}  // namespace rips::rpc

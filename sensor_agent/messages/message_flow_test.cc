#include "sensor_agent/messages/message_flow.h"

#include <optional>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::sensor {
namespace {

using ros2::Guid;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr int64_t kMs = 1'000'000;

Guid WriterGuid(uint8_t participant, uint8_t number = 1) {
  Guid guid;
  guid.bytes = {0x01, 0x10, 0, 0, 0, 0, 0, 0, 0, 0, 0, participant, 0, 0, number, 0x03};
  return guid;
}

class MessageFlowTest : public testing::Test {
 protected:
  explicit MessageFlowTest(FlowOptions options = {})
      : graph_({.own = WriterGuid(200).Participant()}, 0), flow_(options, &graph_) {}

  void Discover(const Guid& writer, ros2::Qos qos = {}) {
    graph_.EndpointSeen({.guid = writer,
                         .writer = true,
                         .topic = "rt/chatter",
                         .type = "std_msgs::msg::dds_::String_",
                         .qos = std::move(qos)},
                        now_ns_);
  }
  void Claim(const Guid& writer, const std::string& node) {
    Guid info = writer;
    info.bytes[14] = 99;
    ASSERT_THAT(graph_.NodesClaimed(
                    info,
                    {.participant = writer.Participant(),
                     .nodes = {{.node_namespace = "/", .node_name = node, .writers = {writer}}}},
                    now_ns_),
                IsOk());
  }
  void Known(const Guid& writer, const std::string& node, ros2::Qos qos = {}) {
    Discover(writer, std::move(qos));
    Claim(writer, node);
  }
  void Take(const Guid& writer, uint64_t sequence, bool latched = false) {
    flow_.Take({.writer = writer,
                .reader = latched ? latched_ : volatile_,
                .size_bytes = 24,
                .sequence = sequence,
                .received_ns = now_ns_},
               now_ns_, output_);
  }
  // Lets `ms` pass, as the agent does: graph first, then messages.
  void Pass(int64_t ms) {
    now_ns_ += ms * kMs;
    graph_.Poll(now_ns_);
    flow_.Poll(now_ns_, output_);
  }
  std::vector<uint64_t> Sequences() {
    std::vector<uint64_t> sequences;
    for (const MessageSeen& each : output_.messages) sequences.push_back(each.writer_sequence);
    return sequences;
  }
  std::string NodeOf(size_t index) { return output_.messages.at(index).source->writer.node; }

  const std::shared_ptr<const ReaderKey> volatile_ =
      std::make_shared<ReaderKey>(ReaderKey{"/chatter", "std_msgs/msg/String", false});
  const std::shared_ptr<const ReaderKey> latched_ =
      std::make_shared<ReaderKey>(ReaderKey{"/chatter", "std_msgs/msg/String", true});
  int64_t now_ns_ = 1'000 * kMs;
  GraphBuilder graph_;
  MessageFlow flow_;
  MessageFlow::Output output_;
};

TEST_F(MessageFlowTest, KnowsHowFarAWriterHasCome) {
  const Guid writer = WriterGuid(1);
  Known(writer, "talker");
  EXPECT_EQ(flow_.HighestSequence(writer), 0);

  Take(writer, 7);
  Take(writer, 5);

  EXPECT_EQ(flow_.HighestSequence(writer), 7);
  EXPECT_EQ(flow_.HighestSequence(WriterGuid(2)), 0);
}

TEST_F(MessageFlowTest, ThePayloadStaysWithItsMessageAndIsNotCopied) {
  const Guid writer = WriterGuid(1);
  const Payload payload = std::make_shared<const std::string>("abcd");
  const auto take = [&](uint64_t sequence) {
    flow_.Take({.writer = writer,
                .reader = volatile_,
                .size_bytes = 24,
                .payload = payload,
                .sequence = sequence},
               now_ns_, output_);
  };
  take(1);
  EXPECT_THAT(output_.messages, IsEmpty()) << "it waits for its writer's node";
  EXPECT_EQ(payload.use_count(), 2);
  Known(writer, "talker");
  Pass(1);
  take(1);
  EXPECT_EQ(flow_.counters().duplicates, 1u);
  Take(writer, 2);
  ASSERT_THAT(output_.messages, SizeIs(2));
  EXPECT_EQ(output_.messages[0].payload, payload);
  EXPECT_EQ(output_.messages[1].payload, nullptr);
  EXPECT_EQ(payload.use_count(), 2) << "that of the duplicate is let go";
}

TEST_F(MessageFlowTest, ATopicReadAnewJudgesNothingTwiceAndCountsNoLoss) {
  const Guid writer = WriterGuid(1);
  Known(writer, "mapper", {.reliable = true, .transient_local = true});
  const auto take = [&](const std::shared_ptr<const ReaderKey>& reader, uint64_t sequence) {
    flow_.Take({.writer = writer, .reader = reader, .size_bytes = 24, .sequence = sequence},
               now_ns_, output_);
  };
  for (uint64_t sequence = 1; sequence <= 3; ++sequence) take(latched_, sequence);
  // Meanwhile 4 to 9 were written; the writer keeps two, and later three of them.
  auto again = std::make_shared<ReaderKey>(*latched_);
  again->resumed = true;
  Pass(60'000);
  for (const uint64_t sequence : {2, 3, 8, 9}) take(again, sequence);
  EXPECT_THAT(Sequences(), ElementsAre(1, 2, 3, 8, 9));
  EXPECT_THAT(output_.losses, IsEmpty()) << "what nobody needed is no loss";
  EXPECT_EQ(flow_.counters().duplicates, 2u);
  take(again, 12);
  ASSERT_THAT(output_.losses, SizeIs(1)) << "only what came before the first is excused";
  EXPECT_EQ(output_.losses[0].count, 2u);
  // A sample under the old reader that was still on its way.
  take(latched_, 9);
  EXPECT_EQ(flow_.counters().duplicates, 3u);
}

TEST_F(MessageFlowTest, AMessageNamesTheGraphThatShowsItsWriter) {
  const auto version = [&] { return output_.messages.back().graph_version; };
  const Guid old = WriterGuid(1);
  Known(old, "talker");
  Take(old, 1);
  EXPECT_EQ(version(), 1u) << "nothing was sent yet";
  Pass(10'000);
  ASSERT_EQ(graph_.version(), 1u);
  Take(old, 2);
  EXPECT_EQ(version(), 1u);

  const Guid fresh = WriterGuid(2);
  Known(fresh, "other");
  Take(fresh, 1);
  EXPECT_EQ(version(), 2u) << "the step that will show it is still to come";
  Take(old, 3);
  EXPECT_EQ(version(), 1u) << "which is no reason to wait";
  Pass(200);
  ASSERT_EQ(graph_.version(), 2u);
  Take(fresh, 2);
  EXPECT_EQ(version(), 2u);

  graph_.EndpointGone(fresh, now_ns_);
  flow_.WriterGone(fresh, now_ns_);
  Pass(200);
  ASSERT_EQ(graph_.version(), 3u);
  Take(fresh, 3);
  EXPECT_EQ(version(), 2u) << "in the newest graph it stands no more";
}

TEST_F(MessageFlowTest, AWriterWhoseNodeBecomesKnownNamesTheStepThatSaysSo) {
  const Guid writer = WriterGuid(1);
  Pass(10'000);
  Discover(writer);
  Pass(100);
  ASSERT_EQ(graph_.version(), 2u) << "it stands there as pending";
  Take(writer, 1);
  Claim(writer, "talker");
  flow_.Poll(now_ns_, output_);
  ASSERT_THAT(output_.messages, SizeIs(1));
  EXPECT_EQ(output_.messages[0].graph_version, 3u);
}

TEST_F(MessageFlowTest, WhatTheQueueLostIsNoGapAsWell) {
  const Guid writer = WriterGuid(1);
  Known(writer, "talker");
  Take(writer, 1);
  // 2 and 3 were lost by the network, 4 to 9 by the queue.
  flow_.QueueLost(writer, "/chatter", 6, now_ns_, output_);
  Take(writer, 10);
  Take(writer, 12);
  flow_.QueueLost(WriterGuid(2), "/chatter", 4, now_ns_, output_);
  uint64_t lost = 0;
  for (const Loss& loss : output_.losses) lost += loss.count;
  EXPECT_EQ(lost, 6u + 2 + 1 + 4);
  EXPECT_EQ(output_.losses[0].cause, LossCause::kQueueFull);
  EXPECT_EQ(output_.losses[0].source->writer.guid, writer);
  EXPECT_EQ(output_.losses[1].count, 2u);
  EXPECT_EQ(output_.losses[1].cause, LossCause::kDdsGap);
  EXPECT_EQ(output_.losses[3].source, nullptr);
}

TEST_F(MessageFlowTest, AWriterThatComesBackIsRemembered) {
  const Guid writer = WriterGuid(1);
  Known(writer, "talker");
  Take(writer, 1);
  graph_.EndpointGone(writer, now_ns_);
  flow_.WriterGone(writer, now_ns_);
  Pass(5'000);
  Known(writer, "talker");
  Pass(20'000);
  Take(writer, 1);
  Take(writer, 4);
  EXPECT_THAT(Sequences(), ElementsAre(1, 1, 4)) << "the second may be another one";
  ASSERT_THAT(output_.losses, SizeIs(1)) << "what it wrote while it was out of reach";
  EXPECT_EQ(output_.losses[0].count, 2u);
}

TEST_F(MessageFlowTest, MessageOfAKnownWriterRunsAtOnceAndTheFirstIsUrgent) {
  Known(WriterGuid(1), "talker");
  Take(WriterGuid(1), 7);
  Take(WriterGuid(1), 8);
  ASSERT_THAT(Sequences(), ElementsAre(7, 8));
  EXPECT_EQ(NodeOf(0), "/talker");
  EXPECT_EQ(output_.messages[0].source->topic, "/chatter");
  EXPECT_EQ(output_.messages[0].source->type, "std_msgs/msg/String");
  EXPECT_TRUE(output_.messages[0].urgent);
  EXPECT_FALSE(output_.messages[1].urgent);
  EXPECT_EQ(output_.messages[0].source, output_.messages[1].source);
  EXPECT_THAT(output_.losses, IsEmpty()) << "what was written before we came is no loss";
}

TEST_F(MessageFlowTest, MessagesOfAPendingWriterWaitForItsNode) {
  Discover(WriterGuid(1));
  Take(WriterGuid(1), 1);
  Take(WriterGuid(1), 2);
  Pass(400);
  EXPECT_THAT(output_.messages, IsEmpty());
  Claim(WriterGuid(1), "talker");
  Pass(1);
  ASSERT_THAT(Sequences(), ElementsAre(1, 2));
  EXPECT_EQ(NodeOf(0), "/talker");
  EXPECT_EQ(flow_.counters().unattributed, 0);
}

TEST_F(MessageFlowTest, AfterTheGraceTheMessageRunsWithoutNode) {
  Discover(WriterGuid(1));
  Take(WriterGuid(1), 1);
  EXPECT_EQ(flow_.NextDue(), now_ns_ + 500 * kMs);
  Pass(499);
  EXPECT_THAT(output_.messages, IsEmpty());
  Pass(1);
  ASSERT_THAT(Sequences(), ElementsAre(1));
  EXPECT_EQ(NodeOf(0), "");
  EXPECT_FALSE(output_.messages[0].source->writer.pending);
  EXPECT_EQ(flow_.NextDue(), kNever);
  EXPECT_EQ(flow_.counters().unattributed, 1);

  Claim(WriterGuid(1), "slow");
  Take(WriterGuid(1), 2);
  EXPECT_EQ(NodeOf(1), "/slow");
  EXPECT_TRUE(output_.messages[1].urgent) << "the writer is introduced anew";
}

TEST_F(MessageFlowTest, MessageBeforeItsWriterIsDiscoveredWaits) {
  Take(WriterGuid(1), 1);
  Pass(100);
  EXPECT_THAT(output_.messages, IsEmpty());
  Known(WriterGuid(1), "talker");
  Pass(1);
  ASSERT_THAT(Sequences(), ElementsAre(1));
  EXPECT_EQ(NodeOf(0), "/talker");
}

TEST_F(MessageFlowTest, MessageOfAWriterNeverDiscoveredRunsAfterTheGrace) {
  Take(WriterGuid(1), 1);
  Pass(500);
  Take(WriterGuid(1), 2);
  ASSERT_THAT(Sequences(), ElementsAre(1, 2));
  EXPECT_EQ(output_.messages[0].source->writer.guid, WriterGuid(1));
}

TEST_F(MessageFlowTest, MessageWithoutWriterRunsAtOnce) {
  Take(Guid{}, 3);
  Take(Guid{}, 3);
  EXPECT_THAT(Sequences(), ElementsAre(3, 3));
}

TEST_F(MessageFlowTest, GapIsALossOfThatWriter) {
  Known(WriterGuid(1), "talker");
  Take(WriterGuid(1), 10);
  Take(WriterGuid(1), 15);
  ASSERT_THAT(output_.losses, SizeIs(1));
  EXPECT_EQ(output_.losses[0].cause, LossCause::kDdsGap);
  EXPECT_EQ(output_.losses[0].count, 4);
  EXPECT_EQ(output_.losses[0].source->writer.guid, WriterGuid(1));
  EXPECT_EQ(output_.losses[0].topic, "/chatter");
}

TEST_F(MessageFlowTest, RepeatedSequenceIsADuplicate) {
  Known(WriterGuid(1), "talker");
  Take(WriterGuid(1), 10);
  Take(WriterGuid(1), 10);
  Take(WriterGuid(1), 11);
  Take(WriterGuid(1), 10);
  EXPECT_THAT(Sequences(), ElementsAre(10, 11));
  EXPECT_EQ(flow_.counters().duplicates, 2);
}

constexpr uint64_t kForged = uint64_t{1} << 40;

TEST_F(MessageFlowTest, LowerNumbersThatHaveNotComeAreJudgedAfterAJump) {
  const Guid writer = WriterGuid(1);
  Known(writer, "talker");
  for (const uint64_t number : {100, 101}) Take(writer, number);
  Take(writer, kForged);
  ASSERT_THAT(output_.jumps, SizeIs(1));
  EXPECT_EQ(output_.jumps[0].writer, writer);
  EXPECT_EQ(output_.jumps[0].detail, "its numbers jumped from 101 to 1099511627776");
  const size_t losses = output_.losses.size();
  for (const uint64_t number : {101, 102, 103, 103, 104}) Take(writer, number);
  EXPECT_THAT(Sequences(), ElementsAre(100, 101, kForged, 102, 103, 104));
  EXPECT_EQ(output_.jumps.at(1).detail, "its numbers went back from 1099511627776 to 102");
  EXPECT_EQ(output_.losses.size(), losses);
  Take(writer, 107);
  EXPECT_EQ(output_.losses.back().count, 2u) << "gaps count on where the writer is";
}

TEST_F(MessageFlowTest, AFirstNumberThatNoWriterReachesIsAJump) {
  Known(WriterGuid(1), "talker");
  Known(WriterGuid(2), "other");
  Take(WriterGuid(2), 600'000'000);
  EXPECT_THAT(output_.jumps, IsEmpty()) << "a week at 1 kHz";
  Take(WriterGuid(1), kForged + 1);
  ASSERT_THAT(output_.jumps, SizeIs(1));
  EXPECT_EQ(output_.jumps[0].detail, "its first number is 1099511627777");
  Take(WriterGuid(1), 1);
  EXPECT_EQ(Sequences().back(), 1u);
}

TEST_F(MessageFlowTest, AnOutageIsNoJump) {
  const Guid writer = WriterGuid(1);
  Known(writer, "talker");
  Take(writer, 1);
  Take(writer, 10'001);
  now_ns_ += 3'600'000 * kMs;
  Take(writer, 10'001 + 3'600'000);  // an hour at 1 kHz
  now_ns_ += 10 * kMs;
  Take(writer, 10'001 + 3'600'000 + 15'000);  // a burst that our queue did not hold
  EXPECT_THAT(output_.jumps, IsEmpty());
  EXPECT_THAT(output_.losses, SizeIs(3));
}

TEST_F(MessageFlowTest, TheHistoryOfALatchedWriterIsNoStepBack) {
  const Guid writer = WriterGuid(1);
  Known(writer, "mapper", {.reliable = true, .transient_local = true});
  graph_.SetNotVisible(writer, "its latched reader is refused", now_ns_);
  Take(writer, 50'000);
  Take(writer, 1, /*latched=*/true);
  EXPECT_THAT(Sequences(), ElementsAre(50'000, 1));
  EXPECT_THAT(output_.jumps, IsEmpty());
}

TEST_F(MessageFlowTest, AWriterThatComesBackMayBeginAgain) {
  const Guid writer = WriterGuid(1);
  Known(writer, "talker");
  for (const uint64_t number : {1, 2, 3}) Take(writer, number);
  flow_.WriterGone(writer, now_ns_);
  graph_.EndpointGone(writer, now_ns_);
  Known(writer, "talker");
  for (const uint64_t number : {1, 2, 2}) Take(writer, number);
  EXPECT_THAT(Sequences(), ElementsAre(1, 2, 3, 1, 2));
  EXPECT_THAT(output_.losses, IsEmpty());
  EXPECT_THAT(output_.jumps, IsEmpty());
}

TEST_F(MessageFlowTest, UnknownSequenceIsNeitherDuplicateNorGap) {
  Known(WriterGuid(1), "talker");
  Take(WriterGuid(1), 0);
  Take(WriterGuid(1), 0);
  EXPECT_THAT(output_.messages, SizeIs(2));
  EXPECT_THAT(output_.losses, IsEmpty());
}

TEST_F(MessageFlowTest, LatchedWriterIsReadOnceAlthoughTwoReadersMatch) {
  Known(WriterGuid(1), "map", {.reliable = true, .transient_local = true});
  Take(WriterGuid(1), 5);  // the best-effort reader, live
  Take(WriterGuid(1), 4, /*latched=*/true);
  Take(WriterGuid(1), 5, /*latched=*/true);
  EXPECT_THAT(Sequences(), ElementsAre(4, 5));
  EXPECT_THAT(output_.losses, IsEmpty());
}

TEST_F(MessageFlowTest, LatchedWriterWithoutALatchedReaderIsReadByTheOther) {
  Known(WriterGuid(1), "map", {.reliable = true, .transient_local = true});
  graph_.SetNotVisible(WriterGuid(1), "no reader", now_ns_);
  Take(WriterGuid(1), 5);
  EXPECT_THAT(Sequences(), ElementsAre(5));
}

TEST_F(MessageFlowTest, WriterThatHasGoneKeepsItsNodeForQueuedMessages) {
  Known(WriterGuid(1), "talker");
  Take(WriterGuid(1), 1);
  flow_.WriterGone(WriterGuid(1), now_ns_);
  graph_.EndpointGone(WriterGuid(1), now_ns_);
  Pass(9'999);
  Take(WriterGuid(1), 2);
  ASSERT_THAT(Sequences(), ElementsAre(1, 2));
  EXPECT_EQ(NodeOf(1), "/talker");
  Pass(1);
  Take(WriterGuid(1), 3);
  EXPECT_THAT(output_.messages, SizeIs(2)) << "forgotten: must wait as an unknown one";
}

TEST_F(MessageFlowTest, TheFirstMessageOfAWriterThatHasGoneHasItsNode) {
  Pass(2'000);
  Known(WriterGuid(1), "talker");
  Pass(20);
  // `ros2 topic pub --once`: sample and end are found in one look, the end first.
  flow_.WriterGone(WriterGuid(1), now_ns_);
  graph_.EndpointGone(WriterGuid(1), now_ns_);
  const uint64_t showing = graph_.version();
  Pass(20);
  EXPECT_GT(graph_.version(), showing);
  Take(WriterGuid(1), 1);
  ASSERT_THAT(Sequences(), ElementsAre(1)) << "must not wait";
  EXPECT_EQ(NodeOf(0), "/talker");
  EXPECT_EQ(output_.messages[0].graph_version, showing);
}

class CrowdedFlowTest : public MessageFlowTest {
 protected:
  CrowdedFlowTest() : MessageFlowTest({.waiting_per_writer = 2, .waiting = 3, .writers = 4}) {}
};

TEST_F(CrowdedFlowTest, WritersThatCameAndWentAreForgotten) {
  Pass(2'000);
  // Each is gone before its sample is looked at, and no node claims it.
  for (uint8_t i = 1; i <= 4; ++i) {
    Discover(WriterGuid(i));
    flow_.WriterGone(WriterGuid(i), now_ns_);
    graph_.EndpointGone(WriterGuid(i), now_ns_);
    Pass(600);
    Take(WriterGuid(i), 1);
  }
  Pass(11'000);
  output_.messages.clear();
  Known(WriterGuid(9), "talker");
  Take(WriterGuid(9), 1);
  Take(WriterGuid(9), 1);
  EXPECT_THAT(output_.messages, SizeIs(1)) << "there is no room to remember it";
}

TEST_F(CrowdedFlowTest, FullWaitingRoomRunsTheOldestOfThatWriter) {
  Discover(WriterGuid(1));
  Take(WriterGuid(1), 1);
  Take(WriterGuid(1), 2);
  EXPECT_THAT(output_.messages, IsEmpty());
  Take(WriterGuid(1), 3);
  EXPECT_THAT(Sequences(), ElementsAre(1));
  Discover(WriterGuid(2));
  Take(WriterGuid(2), 21);
  Take(WriterGuid(2), 22);
  EXPECT_THAT(Sequences(), ElementsAre(1, 21));
  Discover(WriterGuid(3));
  Take(WriterGuid(3), 31);
  EXPECT_THAT(Sequences(), ElementsAre(1, 21, 31)) << "no room at all";
  Pass(500);
  EXPECT_THAT(output_.messages, SizeIs(6)) << "nothing is lost";
}

TEST_F(CrowdedFlowTest, WritersBeyondTheLimitStillRun) {
  for (uint8_t i = 1; i <= 6; ++i) {
    Known(WriterGuid(i), "n");
    Take(WriterGuid(i), 1);
    Take(WriterGuid(i), 1);
  }
  EXPECT_THAT(output_.messages, SizeIs(4 + 2 * 2)) << "the last two without duplicate detection";
}

}  // namespace
}  // namespace rips::sensor

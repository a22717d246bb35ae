#include "sensor_agent/outbox/outbox.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::sensor {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::Optional;
using ::testing::SizeIs;

constexpr int64_t kMs = 1'000'000;

std::shared_ptr<const MessageSource> Source(const std::string& topic) {
  return std::make_shared<const MessageSource>(MessageSource{.topic = topic, .type = "a/msg/A"});
}

class OutboxTest : public testing::Test {
 protected:
  explicit OutboxTest(OutboxLimits limits = {}) : outbox_(limits) { outbox_.ReleaseMessages(); }

  // Messages are told apart by their size.
  void AddMessages(uint32_t first, uint32_t last, bool urgent = false) {
    for (uint32_t i = first; i <= last; ++i) {
      outbox_.AddMessage(
          {.boottime_ns = i * kMs, .source = source_, .size_bytes = i, .urgent = urgent});
    }
  }
  void AddGraph(uint64_t from, uint64_t to) {
    outbox_.AddGraph({.from_version = from, .to_version = to, .settled = true}, now_ns_);
  }
  void AddPayload(uint32_t size, size_t bytes) {
    outbox_.AddMessage({.boottime_ns = size * kMs,
                        .source = source_,
                        .size_bytes = size,
                        .payload = std::make_shared<const std::string>(bytes, 'x')});
  }
  std::vector<size_t> UnsentPayloads() {
    std::vector<size_t> all;
    for (size_t i = 0; i < outbox_.unsent(Lane::kMessages); ++i) {
      all.push_back(PayloadBytes(outbox_.UnsentMessage(i)));
    }
    return all;
  }
  // (sequence, size) of every unsent message.
  std::vector<std::pair<uint64_t, uint32_t>> UnsentMessages() {
    std::vector<std::pair<uint64_t, uint32_t>> all;
    for (size_t i = 0; i < outbox_.unsent(Lane::kMessages); ++i) {
      all.emplace_back(outbox_.NextSequence(Lane::kMessages) + i,
                       outbox_.UnsentMessage(i).size_bytes);
    }
    return all;
  }
  std::vector<std::string> UnsentControl() {
    std::vector<std::string> all;
    for (size_t i = 0; i < outbox_.unsent(Lane::kControl); ++i) {
      const auto& what = outbox_.UnsentControl(i).what;
      const uint64_t sequence = outbox_.NextSequence(Lane::kControl) + i;
      if (const auto* graph = std::get_if<GraphChange>(&what)) {
        all.push_back(
            absl::StrCat(sequence, ":graph ", graph->from_version, "-", graph->to_version));
      } else if (const auto* loss = std::get_if<Loss>(&what)) {
        all.push_back(absl::StrCat(sequence, ":loss ", loss->topic, " ", loss->count));
      } else if (const auto* signal = std::get_if<SignalSeen>(&what)) {
        all.push_back(absl::StrCat(sequence, ":", signal->name, " ", signal->count));
      } else {
        all.push_back(absl::StrCat(sequence, ":state"));
      }
    }
    return all;
  }

  const std::shared_ptr<const MessageSource> source_ = Source("/t");
  int64_t now_ns_ = 1'000 * kMs;
  Outbox outbox_;
};

TEST_F(OutboxTest, NumbersAreGivenWhenSentAndLanesCountForThemselves) {
  AddMessages(1, 3);
  AddGraph(0, 1);
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{1, 0})) << "nothing was sent yet";

  outbox_.MarkSent(Lane::kMessages, 2);
  outbox_.MarkSent(Lane::kControl, 1);

  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{1, 2}));
  EXPECT_EQ(outbox_.Unacked(Lane::kControl), (SequenceRange{1, 1}));
  EXPECT_THAT(UnsentMessages(), ElementsAre(std::pair(3, 3)));
}

TEST_F(OutboxTest, AcknowledgementIsCumulativeAndRepeatable) {
  AddMessages(1, 5);
  outbox_.MarkSent(Lane::kMessages, 4);
  EXPECT_THAT(outbox_.Acknowledge(Lane::kMessages, 3), IsOk());
  EXPECT_THAT(outbox_.Acknowledge(Lane::kMessages, 3), IsOk());
  EXPECT_THAT(outbox_.Acknowledge(Lane::kMessages, 1), IsOk());
  EXPECT_THAT(outbox_.Acknowledge(Lane::kMessages, 0), IsOk());
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{4, 4}));
  EXPECT_EQ(outbox_.acknowledged(Lane::kMessages), 3);
  EXPECT_THAT(UnsentMessages(), ElementsAre(std::pair(5, 5)));
  EXPECT_THAT(outbox_.OldestUnacked(), Optional(4 * kMs));
}

TEST_F(OutboxTest, AcknowledgementBeyondWhatWasSentIsRefusedAndForgetsNothing) {
  AddMessages(1, 5);
  outbox_.MarkSent(Lane::kMessages, 2);
  EXPECT_THAT(outbox_.Acknowledge(Lane::kMessages, 3),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("acknowledgement of 3, but the last sequence sent is 2")));
  EXPECT_THAT(outbox_.Acknowledge(Lane::kControl, 1), Not(IsOk()));
  EXPECT_THAT(outbox_.Acknowledge(Lane::kMessages, UINT64_MAX), Not(IsOk()));
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{1, 2}));
}

TEST_F(OutboxTest, AfterReconnectExactlyTheUnackedGoAgainUnderTheirNumbers) {
  AddMessages(1, 6);
  outbox_.MarkSent(Lane::kMessages, 5);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kMessages, 2), IsOk());

  outbox_.Rewind();
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{3, 5}));
  // The server knew more than its acknowledgements had told us.
  ASSERT_THAT(outbox_.Acknowledge(Lane::kMessages, 3), IsOk());

  EXPECT_THAT(UnsentMessages(), ElementsAre(std::pair(4, 4), std::pair(5, 5), std::pair(6, 6)));
  EXPECT_THAT(outbox_.DueAt(Lane::kMessages, {}, now_ns_, now_ns_), Optional(now_ns_))
      << "a backlog does not wait for the linger";
}

TEST_F(OutboxTest, PayloadsFillABatchAndAreAccounted) {
  const BatchPolicy policy{.observations = 100, .bytes = 1'000, .linger_ns = 20 * kMs};
  const auto due = [&] { return outbox_.DueAt(Lane::kMessages, policy, now_ns_, now_ns_); };
  AddPayload(1, 999);
  EXPECT_THAT(due(), Optional(now_ns_ + 20 * kMs));
  AddPayload(2, 1);
  EXPECT_THAT(due(), Optional(now_ns_)) << "a batch full of payload";
  EXPECT_EQ(outbox_.bytes(), 2 * (CostOf(MessageSeen{}) + kPayloadOverheadBytes) + 1'000);

  outbox_.MarkSent(Lane::kMessages, 1);
  EXPECT_THAT(due(), Optional(now_ns_ + 20 * kMs));
  outbox_.Renumber();
  ASSERT_TRUE(outbox_.snapshot_wanted());
  outbox_.ReplaceGraph({}, now_ns_);
  EXPECT_THAT(due(), Optional(now_ns_)) << "all of it is to be sent again";
  outbox_.MarkSent(Lane::kMessages, 2);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kMessages, 2), IsOk());
  EXPECT_EQ(outbox_.bytes(), 0u);
  AddPayload(3, 10);
  EXPECT_THAT(due(), Optional(now_ns_ + 20 * kMs));

  AddPayload(4, 2'000);
  outbox_.SetPrimary(false);
  outbox_.SetPrimary(true);
  outbox_.ReplaceGraph({}, now_ns_);
  AddPayload(5, 10);
  EXPECT_THAT(due(), Optional(now_ns_ + 20 * kMs)) << "what was dropped counts no more";
}

TEST_F(OutboxTest, BatchIsDueWhenIdleUrgentFullOrAfterTheLinger) {
  const BatchPolicy policy{.observations = 4, .linger_ns = 20 * kMs};
  EXPECT_EQ(outbox_.DueAt(Lane::kMessages, policy, 0, now_ns_), std::nullopt);
  AddMessages(1, 1);
  EXPECT_THAT(outbox_.DueAt(Lane::kMessages, policy, now_ns_ - 20 * kMs, now_ns_),
              Optional(now_ns_))
      << "idle";
  EXPECT_THAT(outbox_.DueAt(Lane::kMessages, policy, now_ns_ - 5 * kMs, now_ns_),
              Optional(now_ns_ + 15 * kMs));
  AddMessages(2, 4);
  EXPECT_THAT(outbox_.DueAt(Lane::kMessages, policy, now_ns_, now_ns_), Optional(now_ns_))
      << "full";
  outbox_.MarkSent(Lane::kMessages, 4);
  AddMessages(5, 5, /*urgent=*/true);
  EXPECT_THAT(outbox_.DueAt(Lane::kMessages, policy, now_ns_, now_ns_), Optional(now_ns_));
  outbox_.MarkSent(Lane::kMessages, 1);
  AddMessages(6, 6);
  EXPECT_THAT(outbox_.DueAt(Lane::kMessages, policy, now_ns_, now_ns_),
              Optional(now_ns_ + 20 * kMs))
      << "urgency ends when the urgent one is sent";
  AddGraph(0, 1);
  EXPECT_THAT(outbox_.DueAt(Lane::kControl, policy, now_ns_, now_ns_), Optional(now_ns_));
}

TEST(OutboxHoldTest, MessagesWaitUntilReleased) {
  Outbox outbox;
  outbox.AddMessage({.boottime_ns = 1, .source = Source("/t"), .urgent = true});
  EXPECT_EQ(outbox.DueAt(Lane::kMessages, {}, 0, 10), std::nullopt);
  outbox.ReleaseMessages();
  EXPECT_THAT(outbox.DueAt(Lane::kMessages, {}, 0, 10), Optional(10));
}

TEST_F(OutboxTest, LossesSignalsAndStateMergeUntilSent) {
  outbox_.AddLoss({.cause = LossCause::kDdsGap,
                   .topic = "/t",
                   .source = source_,
                   .count = 2,
                   .first_boottime_ns = 5,
                   .last_boottime_ns = 6});
  outbox_.AddLoss({.cause = LossCause::kDdsGap,
                   .topic = "/t",
                   .source = source_,
                   .count = 3,
                   .first_boottime_ns = 4,
                   .last_boottime_ns = 9});
  outbox_.AddLoss({.cause = LossCause::kLimit, .count = 1});
  outbox_.AddSignal("SIGUSR1", now_ns_);
  outbox_.AddSignal("SIGUSR1", now_ns_);
  outbox_.AddState({.overloaded = true, .outbox_bytes = 1}, now_ns_);
  outbox_.AddState({.outbox_bytes = 2}, now_ns_);
  EXPECT_THAT(outbox_.DueAt(Lane::kControl, {}, now_ns_, now_ns_), Optional(now_ns_));

  outbox_.FlushMerged(now_ns_);

  EXPECT_THAT(UnsentControl(), ElementsAre("1:loss /t 5", "2:loss  1", "3:SIGUSR1 2", "4:state"));
  EXPECT_EQ(std::get<SensorState>(outbox_.UnsentControl(3).what),
            (SensorState{.overloaded = true, .outbox_bytes = 2}));
  const Loss loss = std::get<Loss>(outbox_.UnsentControl(0).what);
  EXPECT_EQ(loss.first_boottime_ns, 4);
  EXPECT_EQ(loss.last_boottime_ns, 9);

  outbox_.MarkSent(Lane::kControl, 4);
  outbox_.AddSignal("SIGUSR2", now_ns_);
  EXPECT_THAT(outbox_.DueAt(Lane::kControl, {}, now_ns_, now_ns_), Optional(now_ns_ + 100 * kMs));
  outbox_.FlushMerged(now_ns_ + 99 * kMs);
  EXPECT_THAT(UnsentControl(), IsEmpty());
  outbox_.FlushMerged(now_ns_ + 100 * kMs);
  EXPECT_THAT(UnsentControl(), ElementsAre("5:SIGUSR2 1"));
}

class SmallOutboxTest : public OutboxTest {
 protected:
  static constexpr uint32_t kRoom = 16;
  SmallOutboxTest()
      : OutboxTest({.message_bytes = kRoom * CostOf(MessageSeen{}),
                    .control_bytes = 2'000,
                    .loss_records = 2}) {}
};

TEST_F(SmallOutboxTest, FullOutboxShedsTheOldestMessagesAsOneCountedRun) {
  AddMessages(1, kRoom + 1);
  // Down to 7/8 of 16 = 14.
  EXPECT_THAT(UnsentMessages(), SizeIs(14));
  EXPECT_EQ(UnsentMessages().front(), (std::pair<uint64_t, uint32_t>(1, 4)));
  EXPECT_EQ(outbox_.shed_messages(), 3);
  outbox_.FlushMerged(now_ns_);
  EXPECT_THAT(UnsentControl(), ElementsAre("1:loss /t 3"));
  const Loss loss = std::get<Loss>(outbox_.UnsentControl(0).what);
  EXPECT_EQ(loss.cause, LossCause::kOutboxShed);
  EXPECT_EQ(loss.source, source_);
  EXPECT_EQ(loss.first_boottime_ns, 1 * kMs);
  EXPECT_EQ(loss.last_boottime_ns, 3 * kMs);
}

TEST_F(SmallOutboxTest, MessagesInFlightAreShedLast) {
  AddMessages(1, 10);
  outbox_.MarkSent(Lane::kMessages, 10);
  AddMessages(11, kRoom + 1);
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{1, 10}));
  EXPECT_EQ(UnsentMessages().front(), (std::pair<uint64_t, uint32_t>(11, 14)));

  outbox_.MarkSent(Lane::kMessages, 4);
  AddMessages(18, 20);  // 17 held, of them 14 in flight: 3 unsent go
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{1, 14}));
  EXPECT_THAT(UnsentMessages(), IsEmpty());
  outbox_.MarkSent(Lane::kMessages, 0);
  AddMessages(21, 22);
  outbox_.MarkSent(Lane::kMessages, 2);
  AddMessages(23, 23);  // now the one unsent and two in flight go
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{3, 16}));
  outbox_.FlushMerged(now_ns_);
  EXPECT_EQ(UnsentControl().back(), "1:loss /t 7") << "numbers that do not come tell themselves";
  EXPECT_THAT(outbox_.Acknowledge(Lane::kMessages, 2), IsOk()) << "came too late: no harm";
  EXPECT_EQ(outbox_.shed_messages(), 3 + 3 + 3);
}

// Fewer messages fit with a payload; the payloads go first, the oldest of them.
TEST_F(SmallOutboxTest, PayloadsAreShedBeforeMessages) {
  const size_t room = outbox_.limits().message_bytes;
  for (uint32_t i = 1; outbox_.shed_payloads() == 0; ++i) {
    ASSERT_LT(i, 100u);
    AddPayload(i, 40);
    EXPECT_LE(outbox_.bytes(), room);
  }
  std::vector<size_t> held = UnsentPayloads();
  ASSERT_GE(held.size(), 3u);
  EXPECT_EQ(held.front(), 0u);
  EXPECT_EQ(held.back(), 40u);
  EXPECT_TRUE(std::is_sorted(held.begin(), held.end())) << "the oldest";
  EXPECT_EQ(std::count(held.begin(), held.end(), 0u), outbox_.shed_payloads());
  EXPECT_EQ(outbox_.shed_messages(), 0u);
  EXPECT_EQ(UnsentMessages().front(), (std::pair<uint64_t, uint32_t>(1, 1)));
  outbox_.FlushMerged(now_ns_);
  EXPECT_THAT(UnsentControl(), IsEmpty()) << "the messages are there: no loss";

  // With messages alone the payloads go until none is left, then messages.
  AddMessages(101, 101 + kRoom);
  for (const size_t bytes : UnsentPayloads()) EXPECT_EQ(bytes, 0u);
  EXPECT_GT(outbox_.shed_messages(), 0u);
  EXPECT_LE(outbox_.bytes(), room);
}

TEST_F(SmallOutboxTest, PayloadsInFlightAreShedLastAndTheirNumbersStay) {
  AddPayload(1, 40);
  AddPayload(2, 400);
  outbox_.MarkSent(Lane::kMessages, 1);
  const auto until_shed = [&](uint64_t count) {
    for (uint32_t i = 10; outbox_.shed_payloads() < count && i < 100; ++i) AddMessages(i, i);
  };
  until_shed(1);
  outbox_.Rewind();
  EXPECT_EQ(UnsentPayloads()[0], 40u);
  EXPECT_EQ(UnsentPayloads()[1], 0u);
  until_shed(2);
  EXPECT_EQ(UnsentPayloads()[0], 0u);
  EXPECT_EQ(UnsentMessages().front(), (std::pair<uint64_t, uint32_t>(1, 1)));
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{1, 1}));
}

TEST_F(SmallOutboxTest, AMessageLargerThanTheOutboxStaysWithoutItsPayload) {
  AddPayload(1, 64 * 1024);
  EXPECT_THAT(UnsentPayloads(), ElementsAre(0u));
  EXPECT_EQ(outbox_.shed_payloads(), 1u);
  EXPECT_EQ(outbox_.bytes(), CostOf(MessageSeen{}));
}

TEST_F(SmallOutboxTest, ControlIsNeverShedButUnsentGraphStepsFoldIntoASnapshot) {
  AddGraph(0, 1);
  outbox_.MarkSent(Lane::kControl, 1);
  outbox_.AddSignal("SIGUSR1", now_ns_);
  uint64_t version = 1;
  while (!outbox_.snapshot_wanted()) {
    ASSERT_LT(version, 100u);
    AddGraph(version, version + 1);
    ++version;
  }
  EXPECT_EQ(outbox_.DueAt(Lane::kControl, {}, 0, now_ns_), std::nullopt)
      << "nothing may be sent before the snapshot is there";
  outbox_.ReplaceGraph({{.from_version = 0, .to_version = version + 1, .settled = true}}, now_ns_);
  outbox_.FlushMerged(now_ns_);
  EXPECT_THAT(UnsentControl(), ElementsAre(absl::StrCat("2:graph 0-", version + 1),
                                           absl::StrCat("3:loss  ", version - 1), "4:SIGUSR1 1"));
}

TEST_F(SmallOutboxTest, LossesOfManySourcesBecomeOne) {
  for (const char* topic : {"/a", "/b", "/c", "/d"}) {
    outbox_.AddLoss({.cause = LossCause::kQueueFull, .topic = topic, .count = 1});
  }
  outbox_.FlushMerged(now_ns_);
  EXPECT_THAT(UnsentControl(), ElementsAre("1:loss  2", "2:loss /a 1", "3:loss /b 1"));
}

TEST_F(OutboxTest, SnapshotTakesThePlaceOfEveryGraphStep) {
  AddGraph(0, 1);
  AddGraph(1, 2);
  outbox_.MarkSent(Lane::kControl, 2);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kControl, 1), IsOk());
  outbox_.Rewind();
  outbox_.AddSignal("SIGUSR1", now_ns_);
  outbox_.FlushMerged(now_ns_);
  AddGraph(2, 3);

  outbox_.WantSnapshot();
  outbox_.ReplaceGraph({{.from_version = 0, .to_version = 4}, {.from_version = 4, .to_version = 5}},
                       now_ns_);

  EXPECT_FALSE(outbox_.snapshot_wanted());
  EXPECT_THAT(UnsentControl(),
              ElementsAre("2:loss  1", "3:graph 0-4", "4:graph 4-5", "5:SIGUSR1 1"));
}

TEST_F(OutboxTest, NewIncarnationCountsFromOneWithTheSnapshotFirst) {
  AddMessages(1, 3);
  outbox_.AddSignal("SIGUSR1", now_ns_);
  outbox_.FlushMerged(now_ns_);
  AddGraph(0, 1);
  outbox_.MarkSent(Lane::kControl, 2);
  outbox_.MarkSent(Lane::kMessages, 2);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kMessages, 1), IsOk());

  outbox_.Renumber();
  EXPECT_TRUE(outbox_.snapshot_wanted());
  outbox_.ReplaceGraph({{.from_version = 0, .to_version = 2}}, now_ns_);

  EXPECT_THAT(UnsentControl(), ElementsAre("1:graph 0-2", "2:SIGUSR1 1"));
  EXPECT_THAT(UnsentMessages(), ElementsAre(std::pair(1, 2), std::pair(2, 3)));
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{1, 0}));
}

TEST_F(OutboxTest, SecondarySensorReportsNeitherGraphNorMessages) {
  AddMessages(1, 2);
  outbox_.MarkSent(Lane::kMessages, 1);
  AddGraph(0, 1);
  outbox_.SetPrimary(false);
  AddMessages(3, 3);
  AddGraph(1, 2);
  outbox_.AddSignal("SIGUSR1", now_ns_);
  outbox_.FlushMerged(now_ns_);
  EXPECT_THAT(UnsentMessages(), IsEmpty());
  EXPECT_THAT(UnsentControl(), ElementsAre("1:SIGUSR1 1"));
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{1, 1})) << "in flight: stays";

  outbox_.SetPrimary(true);
  EXPECT_TRUE(outbox_.snapshot_wanted());
}

TEST_F(OutboxTest, TheOldestWithoutNumberAreTakenAndTheRestGoesOn) {
  AddMessages(1, 10);
  outbox_.MarkSent(Lane::kMessages, 2);
  EXPECT_EQ(outbox_.OldestUnnumbered(), 3 * kMs);

  const std::vector<MessageSeen> taken = outbox_.PopOldest({.observations = 4}, 100 * kMs);

  ASSERT_THAT(taken, SizeIs(4));
  EXPECT_EQ(taken.front().size_bytes, 3u);
  EXPECT_EQ(outbox_.Unacked(Lane::kMessages), (SequenceRange{1, 2}));
  EXPECT_EQ(UnsentMessages().front(), (std::pair<uint64_t, uint32_t>(3, 7)));
  EXPECT_THAT(outbox_.PopOldest({}, 9 * kMs), SizeIs(2)) << "none of 9 ms or later";
  EXPECT_THAT(outbox_.PopOldest({}, 100 * kMs), SizeIs(2));
  EXPECT_EQ(outbox_.OldestUnnumbered(), std::nullopt);
  EXPECT_EQ(outbox_.message_bytes(), 2 * CostOf(MessageSeen{}));
}

TEST_F(OutboxTest, WhatIsTakenIsOfOneGraphAndBringsIt) {
  const auto of_version = [&](uint64_t version) {
    return MessageSeen{.boottime_ns = kMs, .source = source_, .graph_version = version};
  };
  AddGraph(0, 1);
  for (const uint64_t version : {1, 1, 2, 1, 3}) outbox_.AddMessage(of_version(version));
  AddGraph(1, 2);
  AddGraph(2, 3);
  outbox_.MarkSent(Lane::kControl, 3);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kControl, 3), IsOk()) << "the server has these graphs";

  GraphTrail::Brought brought;
  std::vector<MessageSeen> taken = outbox_.PopOldest({}, 100 * kMs);
  EXPECT_THAT(taken, SizeIs(2));
  std::vector<GraphChange> graph = outbox_.GraphOf(taken, brought);
  ASSERT_THAT(graph, SizeIs(1));
  EXPECT_TRUE(graph[0].whole());
  EXPECT_EQ(graph[0].to_version, 1u);
  taken = outbox_.PopOldest({}, 100 * kMs);
  EXPECT_THAT(taken, SizeIs(2)) << "a version back does not end it";
  graph = outbox_.GraphOf(taken, brought);
  ASSERT_THAT(graph, SizeIs(1));
  EXPECT_EQ(graph[0].from_version, 1u);

  taken = outbox_.DrainMessages({});
  EXPECT_THAT(taken, SizeIs(1));
  EXPECT_EQ(outbox_.GraphOf(taken, brought).at(0).to_version, 3u);
  EXPECT_THAT(outbox_.GraphOf({}, brought), IsEmpty());
}

TEST_F(OutboxTest, ASensorThatIsNotPrimaryBringsNoGraph) {
  AddGraph(0, 1);
  outbox_.SetPrimary(false);
  GraphTrail::Brought brought;
  EXPECT_THAT(outbox_.GraphOf({{.source = source_, .graph_version = 1}}, brought), IsEmpty());
}

TEST_F(OutboxTest, PayloadsEndABatchThatIsTaken) {
  for (uint32_t i = 1; i <= 3; ++i) AddPayload(i, 600);
  EXPECT_THAT(outbox_.PopOldest({.observations = 10, .bytes = 1'000}, 100 * kMs), SizeIs(2));
  EXPECT_THAT(outbox_.PopOldest({.observations = 10, .bytes = 1}, 100 * kMs), SizeIs(1))
      << "one in any case";
}

TEST_F(OutboxTest, ControlThatIsTakenLeavesTheGraph) {
  AddGraph(0, 1);
  outbox_.AddControl({.boottime_ns = 1, .what = IdsAlert{.message = "a"}});
  AddGraph(1, 2);
  for (int i = 0; i < 3; ++i) outbox_.AddControl({.boottime_ns = 2, .what = IdsAlert{}});
  outbox_.MarkSent(Lane::kControl, 1);

  EXPECT_THAT(outbox_.PopOldestControl({.observations = 3}), SizeIs(3));

  EXPECT_THAT(UnsentControl(), ElementsAre("2:graph 1-2", "3:state"));
  EXPECT_THAT(outbox_.PopOldestControl({}), SizeIs(1));
  EXPECT_THAT(outbox_.PopOldestControl({}), IsEmpty());
  outbox_.MarkSent(Lane::kControl, 1);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kControl, 2), IsOk());
  EXPECT_EQ(outbox_.control_bytes(), 0u);
}

TEST_F(OutboxTest, AServerWithoutGraphGetsEveryStepAfterASnapshotOfWhatWasAcknowledged) {
  AddGraph(0, 1);
  AddGraph(1, 2);
  outbox_.MarkSent(Lane::kControl, 2);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kControl, 2), IsOk());
  AddGraph(2, 3);
  AddGraph(3, 4);

  EXPECT_FALSE(outbox_.GraphStartsWithSnapshot());
  EXPECT_TRUE(outbox_.StartGraphWithSnapshot(now_ns_));

  EXPECT_THAT(UnsentControl(), ElementsAre("3:graph 0-2", "4:graph 2-3", "5:graph 3-4"));
  EXPECT_TRUE(outbox_.GraphStartsWithSnapshot());
}

TEST_F(OutboxTest, AStepWithANumberBecomesASnapshotUnderIt) {
  AddGraph(0, 1);
  outbox_.MarkSent(Lane::kControl, 1);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kControl, 1), IsOk());
  AddGraph(1, 2);
  outbox_.MarkSent(Lane::kControl, 1);
  AddGraph(2, 3);
  outbox_.Rewind();

  EXPECT_TRUE(outbox_.StartGraphWithSnapshot(now_ns_));

  EXPECT_THAT(UnsentControl(), ElementsAre("2:graph 0-2", "3:graph 2-3"));
}

TEST_F(OutboxTest, WithoutAStepTheSnapshotIsOfWhatWasAcknowledged) {
  EXPECT_FALSE(outbox_.StartGraphWithSnapshot(now_ns_)) << "nothing was acknowledged";
  AddGraph(0, 1);
  outbox_.MarkSent(Lane::kControl, 1);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kControl, 1), IsOk());
  EXPECT_TRUE(outbox_.StartGraphWithSnapshot(now_ns_));
  EXPECT_THAT(UnsentControl(), ElementsAre("2:graph 0-1"));
}

TEST_F(OutboxTest, StepsThatWereLeftOutNeedASnapshotOfNow) {
  AddGraph(0, 1);
  outbox_.MarkSent(Lane::kControl, 1);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kControl, 1), IsOk());
  AddGraph(1, 2);
  outbox_.ReplaceGraph({}, now_ns_);
  AddGraph(2, 3);
  EXPECT_FALSE(outbox_.StartGraphWithSnapshot(now_ns_));

  outbox_.CloseGraph(now_ns_);
  outbox_.FlushMerged(now_ns_ + kMs);
  EXPECT_THAT(UnsentControl(), ElementsAre("2:loss  2")) << "the next process cannot use them";
}

TEST_F(OutboxTest, StepsThatNoServerHasAreLeftToTheNextProcess) {
  AddGraph(0, 1);
  outbox_.MarkSent(Lane::kControl, 1);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kControl, 1), IsOk());
  outbox_.CloseGraph(now_ns_);
  EXPECT_THAT(UnsentControl(), IsEmpty()) << "there is no news";
  AddGraph(1, 2);
  AddGraph(2, 3);
  const int64_t taken_ns = outbox_.UnsentControl(0).boottime_ns;
  outbox_.CloseGraph(taken_ns + 100 * kMs);
  EXPECT_THAT(UnsentControl(), ElementsAre("2:graph 0-1", "3:graph 1-2", "4:graph 2-3"));
  EXPECT_EQ(outbox_.UnsentControl(0).boottime_ns, taken_ns)
      << "a server takes several changes of one time for one";
  EXPECT_FALSE(std::get<GraphChange>(outbox_.UnsentControl(0).what).settled)
      << "what it shows is not judged again";
  outbox_.CloseGraph(taken_ns + 100 * kMs);
  EXPECT_THAT(UnsentControl(), SizeIs(3)) << "once";
}

TEST_F(OutboxTest, BytesReturnToZeroWhenAllIsAcknowledged) {
  AddMessages(1, 100);
  AddGraph(0, 1);
  outbox_.AddLoss({.topic = "/some/topic", .count = 1});
  outbox_.FlushMerged(now_ns_);
  EXPECT_GT(outbox_.bytes(), 0u);
  outbox_.MarkSent(Lane::kMessages, 100);
  outbox_.MarkSent(Lane::kControl, 2);
  ASSERT_THAT(outbox_.Acknowledge(Lane::kMessages, 100), IsOk());
  ASSERT_THAT(outbox_.Acknowledge(Lane::kControl, 2), IsOk());
  EXPECT_EQ(outbox_.bytes(), 0u);
  EXPECT_EQ(outbox_.OldestUnacked(), std::nullopt);
}

TEST_F(OutboxTest, PayloadsThatWereSentAreLetGoOfFirstAndCountIfTheyMustGoAgain) {
  for (const uint32_t size : {1u, 2u, 3u, 4u}) AddPayload(size, size == 2 ? 10 : 1'000);
  outbox_.MarkSent(Lane::kMessages, 3);
  const size_t bytes = outbox_.message_bytes();
  outbox_.DropSentPayloads(bytes, 100);
  EXPECT_EQ(outbox_.message_bytes(), bytes) << "there is room";
  outbox_.DropSentPayloads(bytes - 1, 100);
  EXPECT_EQ(outbox_.message_bytes(), bytes - 1'000 - kPayloadOverheadBytes) << "the oldest";
  outbox_.DropSentPayloads(0, 100);
  EXPECT_THAT(UnsentPayloads(), ElementsAre(1'000)) << "what is not sent stays";
  EXPECT_EQ(outbox_.shed_payloads(), 0u) << "the server has them";
  ASSERT_THAT(outbox_.Acknowledge(Lane::kMessages, 1), IsOk());
  outbox_.Rewind();
  EXPECT_THAT(UnsentPayloads(), ElementsAre(10, 0, 1'000));
  EXPECT_EQ(outbox_.shed_payloads(), 1u);
  outbox_.Rewind();
  EXPECT_EQ(outbox_.shed_payloads(), 1u);
}

TEST_F(OutboxTest, LatePayloadsOfUnsentMessagesAreShed) {
  for (const uint32_t size : {1u, 2u, 3u, 4u, 5u}) AddPayload(size, size == 3 ? 10 : 1'000);
  outbox_.MarkSent(Lane::kMessages, 1);
  const size_t bytes = outbox_.bytes();
  outbox_.ShedUnsentPayloads(5 * kMs, 100);
  EXPECT_THAT(UnsentPayloads(), ElementsAre(0, 10, 0, 1'000)) << "neither small nor young ones";
  EXPECT_EQ(outbox_.shed_payloads(), 2u);
  EXPECT_EQ(outbox_.bytes(), bytes - 2 * (1'000 + kPayloadOverheadBytes));
  outbox_.ShedUnsentPayload(outbox_.UnsentMessage(3).payload);
  EXPECT_THAT(UnsentPayloads(), ElementsAre(0, 10, 0, 0));
  outbox_.Rewind();
  EXPECT_THAT(UnsentPayloads(), ElementsAre(1'000, 0, 10, 0, 0)) << "what was sent kept its own";
  EXPECT_EQ(outbox_.shed_payloads(), 3u);
}

}  // namespace
}  // namespace rips::sensor

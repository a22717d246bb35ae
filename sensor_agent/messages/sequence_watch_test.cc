#include "sensor_agent/messages/sequence_watch.h"

#include <map>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::sensor {
namespace {

using ros2::Guid;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

constexpr int64_t kMs = 1'000'000;
constexpr int64_t kSecond = 1'000 * kMs;
constexpr uint64_t kForged = uint64_t{1} << 41;

Guid GuidOf(uint8_t participant, uint8_t third, uint8_t last) {
  return {{0x01, 0x10, 0, 0, 0, 0, 0, 0, 0, 0, 0, participant, 0, 0, third, last}};
}
const Guid kParticipant = GuidOf(1, 1, 0xc1);
const Guid kPublications = GuidOf(1, 0x03, 0xc2);
const Guid kWriter = GuidOf(1, 1, 0x03);

// A middleware that drops what is below `next`.
class SequenceWatchTest : public testing::Test {
 protected:
  void Receive(const Guid& writer, uint64_t number) {
    HeldNumbers& held = held_[writer];
    held.last = std::max(held.last, number);
    if (number < held.next) {
      held.discarded += 100;
    } else {
      held.next = number + 1;
    }
  }
  // A look later.
  std::vector<std::string> Look(int64_t ms = 500) {
    now_ns_ += ms * kMs;
    std::vector<std::string> details;
    for (const SequenceJump& each : watch_.Poll(now_ns_)) details.push_back(each.detail);
    return details;
  }
  // A writer at `hz` for `seconds`; gives the jumps.
  std::vector<std::string> Run(uint64_t& number, uint64_t hz, int seconds) {
    std::vector<std::string> all;
    for (int i = 0; i < 2 * seconds; ++i) {
      for (uint64_t n = 0; n < std::max<uint64_t>(hz / 2, 1); ++n) Receive(kWriter, ++number);
      for (std::string& each : Look()) all.push_back(std::move(each));
    }
    return all;
  }

  int64_t now_ns_ = 100 * kSecond;
  std::map<Guid, HeldNumbers> held_;
  std::vector<Guid> forgotten_;
  SequenceWatch watch_{{},
                       [this](const Guid& guid) -> std::optional<HeldNumbers> {
                         const auto it = held_.find(guid);
                         if (it == held_.end()) return std::nullopt;
                         return it->second;
                       },
                       [this](const Guid& guid) {
                         forgotten_.push_back(guid);
                         held_[guid] = {.next = 1};
                       }};
};

TEST_F(SequenceWatchTest, AJumpOfARunningWriterIsToldOnceAndForgottenEachTime) {
  watch_.WriterSeen(kWriter, WriterKind::kMessages);
  uint64_t number = 600'000'000;
  EXPECT_THAT(Run(number, 100, 2), IsEmpty());
  Receive(kWriter, kForged);
  Receive(kWriter, ++number);
  EXPECT_THAT(Look(), ElementsAre("its numbers jumped from 600000200 to 2199023255552"));
  EXPECT_THAT(forgotten_, ElementsAre(kWriter));
  EXPECT_THAT(Run(number, 100, 2), IsEmpty());
  EXPECT_EQ(held_[kWriter].next, number + 1) << "it is heard";
  Receive(kWriter, kForged);
  EXPECT_THAT(Run(number, 100, 2), IsEmpty()) << "told";
  EXPECT_EQ(held_[kWriter].next, number + 1) << "heard again";
  EXPECT_EQ(forgotten_.size(), 2u);
}

TEST_F(SequenceWatchTest, AFirstNumberThatNoWriterReachesIsAJump) {
  watch_.WriterSeen(kWriter, WriterKind::kMessages);
  Receive(kWriter, kForged);
  EXPECT_THAT(Look(), ElementsAre("its first number is 2199023255552"));
  uint64_t number = 0;
  EXPECT_THAT(Run(number, 10, 2), IsEmpty());
  EXPECT_EQ(held_[kWriter].next, number + 1);
}

TEST_F(SequenceWatchTest, WhatANumberBelowTheBoundHidesComesOutByItsDrops) {
  watch_.WriterSeen(kWriter, WriterKind::kMessages);
  Receive(kWriter, kForged / 4);
  EXPECT_THAT(Look(), IsEmpty()) << "an old writer";
  uint64_t number = 0;
  EXPECT_THAT(Run(number, 10, 3),
              ElementsAre(testing::StartsWith("its numbers went back from 549755813888 to ")));
  EXPECT_THAT(forgotten_, ElementsAre(kWriter));
  EXPECT_EQ(held_[kWriter].next, number + 1);
}

TEST_F(SequenceWatchTest, SmallStepsAreForgottenToo) {
  watch_.WriterSeen(kWriter, WriterKind::kMessages);
  uint64_t number = 5'000;
  Run(number, 10, 2);
  Receive(kWriter, number + 5'000);
  EXPECT_THAT(Run(number, 10, 3), IsEmpty()) << "MessageFlow counts the gap";
  EXPECT_EQ(held_[kWriter].next, number + 1);
}

TEST_F(SequenceWatchTest, HonestWritersDoNothingOfTheKind) {
  watch_.WriterSeen(kWriter, WriterKind::kMessages);
  held_[kWriter] = {.next = 1};
  EXPECT_THAT(Look(), IsEmpty());
  uint64_t number = 600'000'000;  // weeks at 1 kHz before we came
  EXPECT_THAT(Run(number, 1'000, 3), IsEmpty());
  number += 3'600'000;  // an hour without network
  EXPECT_THAT(Look(3'600'000), IsEmpty());
  EXPECT_THAT(Run(number, 1'000, 3), IsEmpty());
  // Samples that others asked for again, between its own.
  for (int i = 0; i < 20; ++i) {
    Receive(kWriter, number - 5);
    Receive(kWriter, ++number);
    EXPECT_THAT(Look(), IsEmpty());
  }
  // Discovered anew: it starts again.
  watch_.WriterGone(kWriter);
  held_.erase(kWriter);
  EXPECT_THAT(Look(), IsEmpty());
  watch_.WriterSeen(kWriter, WriterKind::kMessages);
  held_[kWriter] = {.next = 1};
  number = 0;
  EXPECT_THAT(Run(number, 1'000, 3), IsEmpty());
  EXPECT_THAT(forgotten_, IsEmpty());
}

TEST_F(SequenceWatchTest, OfALatchedWriterOneDropIsEnoughToAskAgain) {
  watch_.WriterSeen(kWriter, WriterKind::kLatched);
  Receive(kWriter, 1);
  Look();
  held_[kWriter].next = 4;  // by a gap that nobody wrote
  Look();
  Look(5'000);
  Receive(kWriter, 2);
  EXPECT_THAT(Look(), IsEmpty());
  EXPECT_THAT(forgotten_, ElementsAre(kWriter));
  // It sends again what it has; samples that others ask for later are no reason to go on so.
  Receive(kWriter, 1);
  Receive(kWriter, 2);
  for (int i = 0; i < 10; ++i) {
    EXPECT_THAT(Look(), IsEmpty());
  }
  EXPECT_EQ(forgotten_.size(), 1u);
}

TEST_F(SequenceWatchTest, ALatchedWriterOfOneSampleCannotBeMovedFar) {
  watch_.WriterSeen(kWriter, WriterKind::kLatched);
  held_[kWriter] = {.next = 1, .last = 1};  // asked for
  EXPECT_THAT(Look(), IsEmpty());
  Receive(kWriter, 50'000);  // it has been there for long
  EXPECT_THAT(Look(), IsEmpty());
  watch_.WriterGone(kWriter);
  held_[kWriter] = {.next = 2, .last = 1};
  watch_.WriterSeen(kWriter, WriterKind::kLatched);
  EXPECT_THAT(Look(), IsEmpty());
  held_[kWriter].next = 1'000'000'000;  // a heartbeat
  EXPECT_THAT(Look(), ElementsAre("its numbers jumped from 1 to 999999999"));
  // What it has kept comes a look later: no other jump.
  held_[kWriter] = {.next = 1, .last = 1};
  Look();
  EXPECT_EQ(forgotten_.size(), 1u);
  Receive(kWriter, 1);
  Look();
  EXPECT_EQ(forgotten_.size(), 1u);
}

TEST_F(SequenceWatchTest, DiscoveryIsWatchedWithoutBeingShown) {
  watch_.ParticipantSeen(kParticipant);
  for (uint64_t number = 1; number <= 40; ++number) Receive(kPublications, number);
  EXPECT_THAT(Look(), IsEmpty());
  Look(3'600'000);
  held_[kPublications].next = held_[kPublications].last = 100'000'000;  // a heartbeat
  EXPECT_THAT(Look(), ElementsAre("its numbers jumped from 40 to 100000000"));
  EXPECT_THAT(forgotten_, ElementsAre(kPublications));
  watch_.ParticipantGone(kParticipant);
  held_[kPublications].next = kForged;
  EXPECT_THAT(Look(), IsEmpty());
}

TEST_F(SequenceWatchTest, APeerThatJumpsAllTheTimeIsForgottenSeldom) {
  watch_.WriterSeen(kWriter, WriterKind::kMessages);
  Receive(kWriter, 1);
  Look();
  for (int i = 0; i < 120; ++i) {
    Receive(kWriter, kForged);
    Look();
  }
  EXPECT_GE(forgotten_.size(), 9u);
  EXPECT_LE(forgotten_.size(), 12u) << "0.5, 1, 2, 4 s apart, then 8 s";
}

TEST_F(SequenceWatchTest, WhatOthersFindIsToldOnceDiscoveryShowsTheWriter) {
  const Guid unread = GuidOf(1, 2, 0x03);
  watch_.Jumped({.writer = unread, .detail = "early"});
  EXPECT_THAT(Look(), IsEmpty());
  watch_.WriterSeen(unread, WriterKind::kUnread);
  EXPECT_EQ(watch_.NextDue(), 0);
  EXPECT_THAT(Look(), ElementsAre("early"));
  watch_.Jumped({.writer = unread, .detail = "again"});
  EXPECT_THAT(Look(), IsEmpty());
  EXPECT_THAT(forgotten_, IsEmpty()) << "nobody reads it";
  // Of the middleware's own writers once their participant is there.
  watch_.Jumped({.writer = GuidOf(2, 0x01, 0xc2), .detail = "unknown"});
  EXPECT_THAT(Look(), IsEmpty());
  watch_.ParticipantSeen(kParticipant);
  watch_.Jumped({.writer = GuidOf(1, 0x01, 0xc2), .detail = "announcements"});
  EXPECT_THAT(Look(), ElementsAre("announcements"));
}

TEST_F(SequenceWatchTest, ManyWritersThatJumpAtOnceTakeTurns) {
  for (int i = 0; i < 300; ++i) {
    const Guid guid = GuidOf(static_cast<uint8_t>(i % 250), static_cast<uint8_t>(1 + i / 250), 3);
    watch_.WriterSeen(guid, WriterKind::kMessages);
    Receive(guid, kForged);
  }
  EXPECT_EQ(Look().size(), 300u);
  EXPECT_EQ(forgotten_.size(), SequenceWatchOptions().forgets);
  Look();
  EXPECT_EQ(forgotten_.size(), 300u);
}

}  // namespace
}  // namespace rips::sensor

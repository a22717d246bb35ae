#include "policy_server/audit/returned_head.h"

#include <functional>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/audit/log_samples.h"
#include "services/base/status_matchers.h"

namespace rips::audit {
namespace {

using model::AuditHead;
using testing::ElementsAre;

HeadVerdict Compared(const Segments& segments, const AuditHead& head) {
  const auto verdicts = CompareHeads(segments, head.segment, {head});
  EXPECT_TRUE(verdicts.ok()) << verdicts.status();
  return verdicts.ok() && verdicts->size() == 1 ? verdicts->front() : HeadVerdict::kForged;
}

TEST(ReturnedHeadTest, EachHeadThatALogEverHadIsHeld) {
  SampleLog log;
  std::vector<AuditHead> heads;
  for (int segment = 0; segment < 2; ++segment) {
    log.BeginSegment();
    for (const size_t records : {1, 3, 2}) {
      log.Group(records);
      heads.push_back(log.proven);
    }
  }
  for (const AuditHead& head : heads) {
    EXPECT_EQ(Compared(log.segments, head), HeadVerdict::kHeld) << head.sequence;
  }
}

TEST(ReturnedHeadTest, ALogThatWasPutBackIsContradicted) {
  SampleLog log = TwoSegments();
  const SegmentsInMemory before = log.segments;
  log.Group(2);
  EXPECT_EQ(Compared(before, log.proven), HeadVerdict::kContradicted);
}

TEST(ReturnedHeadTest, ALogThatWasPutBackAndGrewAgainIsContradicted) {
  SampleLog log = TwoSegments();
  SampleLog back = log;
  log.Group(2);
  // Other groups, so other hashes at the same sequences.
  back.Group(1);
  back.Group(3);
  ASSERT_GT(back.head.sequence, log.head.sequence);
  EXPECT_EQ(Compared(back.segments, log.proven), HeadVerdict::kContradicted);
  EXPECT_EQ(Compared(back.segments, back.proven), HeadVerdict::kHeld);
}

TEST(ReturnedHeadTest, ARecordThatWasRewrittenIsContradicted) {
  SampleLog log = TwoSegments();
  std::string& file = log.file(2);
  for (size_t byte = kHeaderBytes; byte < file.size(); ++byte) {
    file[byte] = static_cast<char>(file[byte] ^ 1);
    // The seal behind the record is not read: the head has its own.
    const HeadVerdict verdict = Compared(log.segments, log.proven);
    const size_t seal = PieceStarts(TwoSegments().file(2))[3];
    EXPECT_EQ(verdict, byte < seal ? HeadVerdict::kContradicted : HeadVerdict::kHeld) << byte;
    file[byte] = static_cast<char>(file[byte] ^ 1);
  }
}

TEST(ReturnedHeadTest, AnotherLogOrALogPutBackPastTheSegmentDoesNotKnowIt) {
  SampleLog log = TwoSegments();
  EXPECT_EQ(Compared(TwoSegments().segments, log.proven), HeadVerdict::kUnknownSegment);
  SegmentsInMemory back = log.segments;
  back.files.erase(SegmentName(2));
  EXPECT_EQ(Compared(back, log.proven), HeadVerdict::kUnknownSegment);
  EXPECT_EQ(Compared(SegmentsInMemory(), log.proven), HeadVerdict::kUnknownSegment);
}

TEST(ReturnedHeadTest, ASegmentThatWasMovedAwayIsOlder) {
  SampleLog log;
  log.BeginSegment();
  log.Group(1);
  const AuditHead first = log.proven;
  log.BeginSegment();
  log.Group(1);
  log.segments.files.erase(SegmentName(1));
  EXPECT_EQ(Compared(log.segments, first), HeadVerdict::kOlder);
}

TEST(ReturnedHeadTest, WhatTheKeyHasNotSignedIsForged) {
  SampleLog log = TwoSegments();
  for (const auto& lie : std::vector<std::function<void(AuditHead&)>>{
           [](AuditHead& head) { head.sequence += 7; }, [](AuditHead& head) { head.hash[0] ^= 1; },
           [](AuditHead& head) { head.signature[63] ^= 1; }}) {
    AuditHead head = log.proven;
    lie(head);
    EXPECT_EQ(Compared(log.segments, head), HeadVerdict::kForged);
  }
}

TEST(ReturnedHeadTest, AHeadWithItsOwnKeyProvesNothing) {
  const SampleLog log = TwoSegments();
  const SigningKey mine = *SigningKey::Generate();
  AuditHead head = log.proven;
  head.public_key = mine.public_key();
  head.sequence += 1;
  head.signature = *mine.Sign(SealToSign(head.segment, head.sequence, head.hash));
  EXPECT_EQ(Compared(log.segments, head), HeadVerdict::kUnknownSegment);
}

TEST(ReturnedHeadTest, EachOfManyGetsItsOwnVerdict) {
  SampleLog log = TwoSegments();
  const AuditHead held = log.proven;
  AuditHead forged = held;
  forged.hash[0] ^= 1;
  AuditHead other = held;
  other.public_key[0] ^= 1;
  const SegmentsInMemory before = log.segments;
  log.Group(1);
  const auto verdicts = CompareHeads(before, 2, {held, forged, other, log.proven});
  ASSERT_TRUE(verdicts.ok());
  EXPECT_THAT(*verdicts, ElementsAre(HeadVerdict::kHeld, HeadVerdict::kForged,
                                     HeadVerdict::kUnknownSegment, HeadVerdict::kContradicted));
}

TEST(ReturnedHeadTest, ASegmentCutWithinItsHeaderIsNotKnown) {
  SampleLog log = TwoSegments();
  log.file(2).resize(kHeaderBytes - 1);
  EXPECT_EQ(Compared(log.segments, log.proven), HeadVerdict::kUnknownSegment);
}

}  // namespace
}  // namespace rips::audit

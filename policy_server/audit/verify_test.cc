#include "policy_server/audit/verify.h"

#include <algorithm>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/audit/log_samples.h"
#include "services/base/status_matchers.h"

namespace rips::audit {
namespace {

using testing::HasSubstr;
using testing::SizeIs;

std::string KindOf(const Segments& segments, absl::Span<const Head> heads = {}) {
  const absl::StatusOr<Report> report = Verify(segments, heads);
  if (!report.ok()) return report.status().ToString();
  return report->fault ? std::string(KindName(report->fault->kind)) : "whole";
}

TEST(AuditVerifyTest, AWholeLogIsReadInOrder) {
  const SampleLog log = TwoSegments();
  std::vector<std::string> payloads;
  const auto report = Verify(log.segments, {}, [&](uint64_t sequence, absl::string_view payload) {
    EXPECT_EQ(payload, absl::StrCat("record ", sequence));
    payloads.emplace_back(payload);
  });
  ASSERT_TRUE(report.ok());
  EXPECT_FALSE(report->fault.has_value());
  EXPECT_THAT(payloads, SizeIs(5));
  EXPECT_EQ(report->segments, 2u);
  EXPECT_EQ(report->records, 5u);
  EXPECT_EQ(report->head, log.head);
  EXPECT_THAT(report->identity, SizeIs(kHashBytes));
}

TEST(AuditVerifyTest, ASegmentWithoutRecordsIsWhole) {
  SampleLog log;
  EXPECT_EQ(KindOf(log.segments), "whole");
  log.BeginSegment();
  EXPECT_EQ(KindOf(log.segments), "whole");
  log.BeginSegment();
  log.Group(1);
  EXPECT_EQ(KindOf(log.segments), "whole");
}

TEST(AuditVerifyTest, EveryFlippedBitIsAnAlteration) {
  for (const uint64_t number : {1, 2}) {
    SampleLog log = TwoSegments();
    std::string& file = log.file(number);
    for (size_t bit = 0; bit < 8 * file.size(); ++bit) {
      file[bit / 8] = static_cast<char>(file[bit / 8] ^ (1 << (bit % 8)));
      ASSERT_EQ(KindOf(log.segments), "altered") << number << " " << bit;
      file[bit / 8] = static_cast<char>(file[bit / 8] ^ (1 << (bit % 8)));
    }
  }
}

TEST(AuditVerifyTest, EveryCutIsATruncationButAtASeal) {
  for (const uint64_t number : {1, 2}) {
    const SampleLog whole = TwoSegments();
    SampleLog log = whole;
    const std::string file = log.file(number);
    std::vector<size_t> starts = PieceStarts(file);
    // Behind the header, and behind each of the two seals.
    const std::vector<size_t> sealed = {kHeaderBytes, starts[number == 1 ? 3 : 2], starts.back()};
    for (size_t cut = 0; cut < file.size(); ++cut) {
      log.file(number) = file.substr(0, cut);
      const bool at_seal = std::find(sealed.begin(), sealed.end(), cut) != sealed.end();
      // What follows tells of a first segment; of the last only a head does.
      const bool hidden = number == 2 && at_seal;
      ASSERT_EQ(KindOf(log.segments), hidden ? "whole" : "truncated") << number << " " << cut;
      if (!hidden) continue;
      EXPECT_EQ(KindOf(log.segments, {whole.head}), "rolled back") << cut;
    }
  }
}

TEST(AuditVerifyTest, RecordsTakenOutAreMissing) {
  const SampleLog whole = TwoSegments();
  // Each record or seal but the last, which the header of the next segment tells of.
  for (size_t i = 0; i < 4; ++i) {
    SampleLog log = whole;
    const std::vector<size_t> at = PieceStarts(log.file(1));
    log.file(1).erase(at[i], at[i + 1] - at[i]);
    EXPECT_EQ(KindOf(log.segments), "missing") << i;
  }
  SampleLog group = whole;
  const std::vector<size_t> at = PieceStarts(group.file(1));
  group.file(1).erase(at[0], at[3] - at[0]);
  EXPECT_EQ(KindOf(group.segments), "missing");
}

TEST(AuditVerifyTest, RecordsInAnotherOrderAreReordered) {
  SampleLog log = TwoSegments();
  std::string& file = log.file(1);
  const std::vector<size_t> at = PieceStarts(file);
  const std::string one = file.substr(at[0], at[1] - at[0]);
  const std::string two = file.substr(at[1], at[2] - at[1]);
  file.replace(at[0], one.size() + two.size(), two + one);
  EXPECT_EQ(KindOf(log.segments), "reordered");

  SampleLog twice = TwoSegments();
  twice.file(1).insert(at[1], one);
  EXPECT_EQ(KindOf(twice.segments), "reordered");
}

TEST(AuditVerifyTest, FilesGoneAreMissingAndFilesSwappedReordered) {
  SampleLog gone = TwoSegments();
  gone.BeginSegment();
  gone.Group(1);
  SampleLog swapped = gone;
  SampleLog first = gone;
  first.segments.files.erase(SegmentName(1));
  EXPECT_EQ(KindOf(first.segments), "missing");
  SampleLog second = gone;
  second.segments.files.erase(SegmentName(2));
  EXPECT_EQ(KindOf(second.segments), "missing");
  SampleLog last = gone;
  last.segments.files.erase(SegmentName(3));
  EXPECT_EQ(KindOf(last.segments), "whole");
  EXPECT_EQ(KindOf(last.segments, {gone.head}), "rolled back");
  std::swap(swapped.file(2), swapped.file(3));
  EXPECT_EQ(KindOf(swapped.segments), "reordered");
  std::swap(swapped.file(1), swapped.file(2));
  EXPECT_EQ(KindOf(swapped.segments), "reordered");
}

TEST(AuditVerifyTest, ALogPutBackOrReplacedIsRolledBack) {
  SampleLog log = TwoSegments();
  const SampleLog yesterday = log;
  log.Group(3);
  EXPECT_EQ(KindOf(log.segments, {yesterday.head, log.head}), "whole");
  EXPECT_EQ(KindOf(yesterday.segments, {log.head}), "rolled back");
  // As long, and another.
  EXPECT_EQ(KindOf(TwoSegments().segments, {yesterday.head}), "rolled back");
}

TEST(AuditVerifyTest, ARecordRewrittenWithItsHashesFailsAtTheSeal) {
  SampleLog log = TwoSegments();
  std::string& file = log.file(2);
  // As one writes who has the files and no key: all hashes anew, the seals as they were.
  std::string forged = file.substr(0, kHeaderBytes);
  std::string hash = Sha256(forged);
  const std::vector<size_t> at = PieceStarts(file);
  for (size_t i = 0; i + 1 < at.size(); ++i) {
    Piece piece;
    size_t size = 0;
    ASSERT_EQ(ParsePiece(absl::string_view(file).substr(at[i]), &piece, &size), Parsed::kPiece);
    if (piece.kind == Piece::Kind::kRecord && piece.sequence == 5) piece.payload = "another";
    piece.previous_hash = hash;
    forged += EncodePiece(piece);
    hash = piece.hash;
  }
  file = forged;
  const absl::StatusOr<Report> report = Verify(log.segments);
  ASSERT_TRUE(report.ok());
  ASSERT_TRUE(report->fault.has_value());
  EXPECT_EQ(report->fault->kind, Fault::Kind::kAltered);
  EXPECT_EQ(report->fault->sequence, 5u);
  EXPECT_THAT(report->fault->text, HasSubstr("not signed"));
}

TEST(AuditVerifyTest, ASegmentOfAnotherKeyIsAltered) {
  SampleLog log = TwoSegments();
  SampleLog other = TwoSegments();
  log.file(2) = other.file(2);
  EXPECT_EQ(KindOf(log.segments), "altered");
}

TEST(AuditVerifyTest, WhatACrashLeftIsNoPartOfTheLog) {
  SampleLog log;
  log.BeginSegment();
  log.Group(2);
  log.file(1) += "RIPr and more";
  EXPECT_EQ(KindOf(log.segments), "truncated");
  log.BeginSegment();
  log.Group(1);
  const absl::StatusOr<Report> report = Verify(log.segments);
  ASSERT_TRUE(report.ok());
  EXPECT_FALSE(report->fault.has_value()) << report->fault->text;
  ASSERT_THAT(report->torn, SizeIs(1));
  EXPECT_EQ(report->torn[0].bytes, 13u);
  EXPECT_EQ(report->records, 3u);
}

TEST(AuditVerifyTest, HeadsAreReadAsTheyAreWritten) {
  const Head head{.sequence = 812, .hash = Sha256("x")};
  EXPECT_EQ(*ParseHead(FormatHead(head)), head);
  for (const char* wrong : {"", "812", "812:", "0:00", ":", "x:", "812:zz", "-1:00"}) {
    EXPECT_FALSE(ParseHead(wrong).ok()) << wrong;
  }
}

}  // namespace
}  // namespace rips::audit

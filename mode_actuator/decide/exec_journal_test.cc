#include "mode_actuator/decide/exec_journal.h"

#include "absl/strings/str_format.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using Stage = Receipt::Stage;

std::string Id(int n) { return absl::StrFormat("%032d", n); }

ExecJournal Sample() {
  ExecJournal ledger;
  EXPECT_THAT(ledger.Begin(Id(1)), IsOk());
  ledger.Finish(Id(1), Stage::kFailed, 3);
  EXPECT_THAT(ledger.Begin(Id(2)), IsOk());
  return ledger;
}

TEST(ExecJournalTest, ReadsBackWhatItWrites) {
  const auto ledger = ExecJournal::Decode(Sample().Encode());
  ASSERT_THAT(ledger, IsOk());
  EXPECT_EQ(ledger->Find(Id(1))->stage, Stage::kFailed);
  EXPECT_EQ(ledger->Find(Id(1))->exit_code, 3);
  EXPECT_EQ(ledger->Find(Id(2))->stage, Stage::kAcknowledged);
  EXPECT_FALSE(ledger->Find(Id(3)).has_value());
  EXPECT_THAT(ExecJournal::Decode(ExecJournal().Encode()), IsOk());
}

TEST(ExecJournalTest, WhatWasNotFinishedAtStartIsUnknownOnce) {
  auto ledger = ExecJournal::Decode(Sample().Encode());
  ASSERT_THAT(ledger, IsOk());

  const std::vector<Receipt> unknown = ledger->CloseUnfinished();

  ASSERT_EQ(unknown.size(), 1u);
  EXPECT_EQ(unknown[0].command_id, Id(2));
  EXPECT_EQ(unknown[0].stage, Stage::kUnknown);
  EXPECT_EQ(ledger->Find(Id(2))->stage, Stage::kUnknown);
  EXPECT_TRUE(ledger->CloseUnfinished().empty());
}

TEST(ExecJournalTest, EveryCutAndEveryFlippedBitIsFound) {
  const std::string bytes = Sample().Encode();
  for (size_t length = 0; length < bytes.size(); ++length) {
    EXPECT_THAT(ExecJournal::Decode(bytes.substr(0, length)),
                StatusIs(absl::StatusCode::kDataLoss));
  }
  for (size_t i = 0; i < bytes.size() * 8; ++i) {
    std::string flipped = bytes;
    flipped[i / 8] = static_cast<char>(flipped[i / 8] ^ (1 << (i % 8)));
    EXPECT_THAT(ExecJournal::Decode(flipped), StatusIs(absl::StatusCode::kDataLoss)) << i;
  }
}

TEST(ExecJournalTest, ForgetsTheOldestFinishedFirstAndNeverARunningOne) {
  ExecJournal ledger;
  EXPECT_THAT(ledger.Begin(Id(0)), IsOk());  // runs on
  for (int i = 1; i < static_cast<int>(kExecIdsMax) + 10; ++i) {
    EXPECT_THAT(ledger.Begin(Id(i)), IsOk());
    ledger.Finish(Id(i), Stage::kVerified, 0);
  }
  EXPECT_TRUE(ledger.Find(Id(0)).has_value());
  EXPECT_FALSE(ledger.Find(Id(1)).has_value());
  EXPECT_TRUE(ledger.Find(Id(11)).has_value());
  EXPECT_LE(ledger.Encode().size(), kJournalBytesMax);
  EXPECT_THAT(ExecJournal::Decode(ledger.Encode()), IsOk());
}

TEST(ExecJournalTest, HasALimit) {
  ExecJournal ledger;
  for (int i = 0; i < static_cast<int>(kExecIdsMax); ++i) EXPECT_THAT(ledger.Begin(Id(i)), IsOk());
  EXPECT_THAT(ledger.Begin(Id(9'999)), StatusIs(absl::StatusCode::kResourceExhausted,
                                                "programs under way exceed limit 512"));
  ledger.Forget(Id(7));
  EXPECT_THAT(ledger.Begin(Id(9'999)), IsOk());
}

}  // namespace
}  // namespace rips::actuator

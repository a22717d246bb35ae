#include "policy_server/server/robot/context/durable_outbox.h"

#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::pipeline {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class DurableOutboxTest : public ::testing::Test {
 protected:
  static store::DecisionRecord Decision(const std::string& id, const std::string& from = "DEFAULT",
                                        const std::string& to = "HALT") {
    return {.id = id, .from = from, .to = to};
  }
  static levels::Transition Lowering(uint64_t epoch) {
    return {.from = 2, .to = 0, .decision_id = {.term = 1, .epoch = epoch}};
  }
  static store::Checkpoint UpTo(uint64_t sequence) {
    store::Checkpoint checkpoint;
    checkpoint.high_water[{.host = "base", .incarnation = "aa"}] = sequence;
    return checkpoint;
  }
  static std::vector<std::string> Ids(const std::vector<store::DecisionRecord>& decisions) {
    std::vector<std::string> ids;
    for (const store::DecisionRecord& decision : decisions) ids.push_back(decision.id);
    return ids;
  }

  DurableOutbox outbox_{"r1", 7};
};

TEST_F(DurableOutboxTest, OneBatchIsInFlightAndTheRestWaits) {
  outbox_.AddDecision(Decision("a"));
  ASSERT_TRUE(outbox_.CanSeal());
  EXPECT_THAT(Ids(outbox_.Seal(UpTo(7))->decisions), ElementsAre("a"));
  outbox_.AddDecision(Decision("b"));
  EXPECT_FALSE(outbox_.CanSeal());
  EXPECT_FALSE(outbox_.done());
  const auto settled = outbox_.OnRecorded(true);
  EXPECT_THAT(Ids(settled.decisions), ElementsAre("a"));
  EXPECT_EQ(settled.judged.begin()->second, 7u);
  ASSERT_TRUE(outbox_.CanSeal());
  EXPECT_THAT(Ids(outbox_.Seal(UpTo(9))->decisions), ElementsAre("b"));
  outbox_.OnRecorded(true);
  EXPECT_TRUE(outbox_.done());
}

TEST_F(DurableOutboxTest, WhatCouldNotBeRecordedStandsBeforeWhatCameSince) {
  outbox_.AddDecision(Decision("a"));
  outbox_.AddStage({.stage = "requested"});
  outbox_.AddAlert({.id = "1"});
  outbox_.Seal(UpTo(7));
  outbox_.AddDecision(Decision("b"));
  outbox_.AddStage({.stage = "verified"});
  outbox_.AddAlert({.id = "2"});
  outbox_.OnRecorded(false);
  EXPECT_FALSE(outbox_.due()) << "not at once again";
  EXPECT_TRUE(outbox_.unsaved().sequences && outbox_.unsaved().variables &&
              outbox_.unsaved().bundle);
  const auto batch = outbox_.Seal(UpTo(9));
  EXPECT_THAT(Ids(batch->decisions), ElementsAre("a", "b"));
  ASSERT_THAT(batch->stages, SizeIs(2));
  EXPECT_EQ(batch->stages[0].stage, "requested");
  ASSERT_THAT(batch->alerts, SizeIs(2));
  EXPECT_EQ(batch->alerts[0].id, "1");
  EXPECT_EQ(batch->checkpoint.high_water.begin()->second, 9u) << "only that of now";
}

TEST_F(DurableOutboxTest, AbandonedItHandsOutNothingMore) {
  outbox_.AddDecision(Decision("a"));
  outbox_.Seal(UpTo(7));
  outbox_.AddDecision(Decision("b"));
  outbox_.Abandon();
  EXPECT_FALSE(outbox_.done()) << "one is in flight";
  outbox_.OnRecorded(false);
  EXPECT_TRUE(outbox_.done());
  EXPECT_FALSE(outbox_.CanSeal());
}

TEST_F(DurableOutboxTest, ALoweringHoldsBackUntilItIsReleased) {
  EXPECT_TRUE(outbox_.held_back().none());
  outbox_.AddLowering(Lowering(3));
  outbox_.AddLowering(Lowering(5));
  EXPECT_EQ(outbox_.held_back(), Lowering(5).decision_id);
  outbox_.Touch(&DurableOutbox::Unsaved::sequences);
  outbox_.Seal(UpTo(7));
  const auto settled = outbox_.OnRecorded(true);
  ASSERT_THAT(settled.lowerings, SizeIs(2));
  EXPECT_EQ(settled.lowerings[0].decision_id, Lowering(3).decision_id);
  outbox_.Release(Lowering(3).decision_id);
  EXPECT_FALSE(outbox_.held_back().none()) << "a newer one still waits";
  outbox_.Release(Lowering(5).decision_id);
  EXPECT_TRUE(outbox_.held_back().none());
}

TEST_F(DurableOutboxTest, ALoweringThatCouldNotBeRecordedIsHandedBackOnce) {
  outbox_.AddDecision(Decision("a", "HALT", "DEFAULT"));
  outbox_.AddLowering(Lowering(3));
  outbox_.Seal(UpTo(7));
  EXPECT_THAT(outbox_.OnRecorded(false).lowerings, SizeIs(1));
  outbox_.Seal(UpTo(7));
  EXPECT_THAT(outbox_.OnRecorded(true).lowerings, IsEmpty());
}

TEST_F(DurableOutboxTest, AlertsInFlightAreNotRecordedYet) {
  outbox_.AddAlert({.id = "in flight"});
  outbox_.Seal(UpTo(7));
  outbox_.AddAlert({.id = "waits"});
  const auto ids = [&] {
    std::vector<std::string> each;
    for (const store::AlertRecord& alert : outbox_.alerts()) each.push_back(alert.id);
    return each;
  };
  EXPECT_THAT(ids(), ElementsAre("in flight", "waits"));
  outbox_.OnRecorded(false);
  EXPECT_THAT(ids(), ElementsAre("in flight", "waits"));
  outbox_.Seal(UpTo(7));
  outbox_.OnRecorded(true);
  EXPECT_THAT(ids(), IsEmpty());
}

TEST_F(DurableOutboxTest, TheOldestAlertsGoFirstAndAreCounted) {
  for (size_t i = 0; i < DurableOutbox::kAlertsMax; ++i) {
    EXPECT_TRUE(outbox_.AddAlert({.id = absl::StrCat(i)}));
  }
  EXPECT_FALSE(outbox_.AddAlert({.id = "newest"}));
  EXPECT_THAT(outbox_.alerts(), SizeIs(DurableOutbox::kAlertsMax));
  EXPECT_EQ(outbox_.alerts().front().id, "1");
  outbox_.Seal(UpTo(7));
  EXPECT_EQ(outbox_.OnRecorded(false).alerts_dropped, 0u) << "said when it can be recorded";
  outbox_.Seal(UpTo(7));
  EXPECT_EQ(outbox_.OnRecorded(true).alerts_dropped, 1u);
}

TEST_F(DurableOutboxTest, TheReserveIsForRaisesOnly) {
  const auto table = levels::LevelTable({{"DEFAULT"}, {"ALERT"}, {"HALT"}});
  outbox_.AddDecision(Decision("raise", "DEFAULT", "HALT"));
  outbox_.AddDecision(Decision("lowering", "HALT", "DEFAULT"));
  outbox_.AddDecision(Decision("raise to less than was held", "DEFAULT", "ALERT"));
  outbox_.AddDecision(Decision("raise again", "ALERT", "HALT"));
  const store::WriteBatch raises = outbox_.Raises(table);
  EXPECT_EQ(raises.robot, "r1");
  EXPECT_EQ(raises.tenure, 7u);
  EXPECT_TRUE(raises.uses_reserve);
  EXPECT_THAT(Ids(raises.decisions), ElementsAre("raise", "raise again"));
}

TEST_F(DurableOutboxTest, OfOneCommandTheNewestReceiptWaitsAlsoAfterAFailure) {
  using Stage = model::Receipt::Stage;
  const auto receipt = [](const std::string& command, Stage stage) {
    return store::ReceiptRecord{.host = "base", .receipt = {.command_id = command, .stage = stage}};
  };
  outbox_.AddReceipt(receipt("1", Stage::kAcknowledged));
  outbox_.AddReceipt(receipt("2", Stage::kAcknowledged));
  ASSERT_TRUE(outbox_.CanSeal());
  EXPECT_THAT(outbox_.Seal({})->receipts, SizeIs(2));
  outbox_.AddReceipt(receipt("1", Stage::kVerified));
  outbox_.OnRecorded(false);
  EXPECT_THAT(outbox_.Seal({})->receipts,
              ElementsAre(receipt("2", Stage::kAcknowledged), receipt("1", Stage::kVerified)));
  for (size_t i = 0; i <= DurableOutbox::kReceiptsMax; ++i) {
    outbox_.AddReceipt(receipt(absl::StrCat("more ", i), Stage::kVerified));
  }
  outbox_.OnRecorded(true);
  EXPECT_THAT(outbox_.Seal({})->receipts, SizeIs(DurableOutbox::kReceiptsMax));
}

}  // namespace
}  // namespace rips::pipeline

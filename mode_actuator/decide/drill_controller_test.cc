#include "mode_actuator/decide/drill_controller.h"

#include <optional>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::actuator {
namespace {

using ::testing::HasSubstr;
using Stage = Receipt::Stage;

class DrillControllerTest : public ::testing::Test {
 protected:
  Receipt Ask(const std::string& id, const std::string& level = "ALERT", bool admitted = true) {
    begun_.reset();
    return desk_.OnCommand({.id = id, .term = 3, .what = model::Drill{.level = level}}, admitted,
                           "DEFAULT", [this](const DrillJob& job) {
                             if (!free_) return false;
                             begun_ = job;
                             return true;
                           });
  }

  DrillController desk_{{"DEFAULT", "ALERT"}};
  bool free_ = true;
  std::optional<DrillJob> begun_;
};

TEST_F(DrillControllerTest, ADrillThatFindsNothingIsVerified) {
  const Receipt begun = Ask("a");
  EXPECT_EQ(begun.stage, Stage::kAcknowledged);
  EXPECT_EQ(begun.effective_level, "DEFAULT");
  ASSERT_TRUE(begun_.has_value());
  EXPECT_EQ(begun_->level, "ALERT");
  EXPECT_EQ(begun_->held, "DEFAULT");

  const Receipt over = desk_.OnOutcome({.id = "a", .steps = {{.step = "x", .ok = true}}});
  EXPECT_EQ(over.stage, Stage::kVerified);
  EXPECT_EQ(over.command_id, "a");
  EXPECT_EQ(over.effective_level, "DEFAULT");
  EXPECT_EQ(over.steps.size(), 1u);
  EXPECT_EQ(over.detail, "");
}

TEST_F(DrillControllerTest, FailedStepsAreNamed) {
  Ask("a");
  const Receipt over = desk_.OnOutcome({.id = "a",
                                        .steps = {{.step = "program horn", .detail = "gone"},
                                                  {.step = "y", .ok = true},
                                                  {.step = "z", .detail = "silent"}}});
  EXPECT_EQ(over.stage, Stage::kFailed);
  EXPECT_EQ(over.detail, "program horn: gone; z: silent");
}

TEST_F(DrillControllerTest, AStepThatFailsWithoutAWordFailsTheDrill) {
  Ask("a");
  EXPECT_EQ(desk_.OnOutcome({.id = "a", .steps = {{.step = "x"}}}).stage, Stage::kFailed);
}

TEST_F(DrillControllerTest, TheDetailHasALimit) {
  Ask("a");
  const Receipt over =
      desk_.OnOutcome({.id = "a", .steps = {{.step = "x", .detail = std::string(5000, 'y')}}});
  EXPECT_EQ(over.detail.size(), kDrillDetailBytesMax + 3);
}

TEST_F(DrillControllerTest, ALevelThatHadToBeAppliedSupersedesIt) {
  Ask("a");
  const Receipt over = desk_.OnOutcome({.id = "a", .cancelled = true, .steps = {{.step = "x"}}});
  EXPECT_EQ(over.stage, Stage::kSuperseded);
  EXPECT_EQ(over.detail, "a level had to be applied");
  EXPECT_EQ(over.steps.size(), 1u);
  EXPECT_EQ(Ask("b").stage, Stage::kAcknowledged);
}

TEST_F(DrillControllerTest, ADuplicateGetsTheReceiptThatIsKnown) {
  Ask("a");
  EXPECT_EQ(Ask("a").stage, Stage::kAcknowledged);
  EXPECT_FALSE(begun_.has_value());
  desk_.OnOutcome({.id = "a", .steps = {{.step = "x", .detail = "no"}}});
  const Receipt again = Ask("a");
  EXPECT_EQ(again.stage, Stage::kFailed);
  EXPECT_EQ(again.steps.size(), 1u);
  EXPECT_FALSE(begun_.has_value());
}

TEST_F(DrillControllerTest, RefusalsSayWhy) {
  const Receipt stale = Ask("a", "ALERT", false);
  EXPECT_EQ(stale.stage, Stage::kRefusedStale);
  EXPECT_EQ(stale.detail, "term 3 is stale");
  const Receipt unknown = Ask("b", "\x1bPANIC");
  EXPECT_EQ(unknown.stage, Stage::kRefused);
  EXPECT_EQ(unknown.detail, "no level `\\x1bPANIC`; there are DEFAULT, ALERT");
  free_ = false;
  const Receipt busy = Ask("c");
  EXPECT_EQ(busy.stage, Stage::kRefused);
  EXPECT_EQ(busy.detail, "a level is being applied");
  free_ = true;
  EXPECT_EQ(Ask("d").stage, Stage::kAcknowledged);
  const Receipt second = Ask("e");
  EXPECT_EQ(second.stage, Stage::kRefused);
  EXPECT_EQ(second.detail, "another drill runs");
  EXPECT_FALSE(begun_.has_value());
}

TEST_F(DrillControllerTest, KeepsALimitedNumberOfReceiptsAndTheOneThatRuns) {
  Ask("runs");
  for (size_t i = 0; i < 2 * kDrillReceiptsMax; ++i) Ask(absl::StrCat("n", i));
  EXPECT_EQ(Ask("runs").stage, Stage::kAcknowledged);
  EXPECT_FALSE(begun_.has_value());
  desk_.OnOutcome({.id = "runs"});
  // Forgotten: it is begun as if it were new.
  EXPECT_EQ(Ask("n0").stage, Stage::kAcknowledged);
  EXPECT_TRUE(begun_.has_value());
}

}  // namespace
}  // namespace rips::actuator

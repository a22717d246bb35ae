// The control plane in one thread under seeded chance: no run violates an invariant, and the
// checker finds each planted fault.
#include <optional>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "gtest/gtest.h"
#include "services/base/test_rounds.h"
#include "tests/simulation/world.h"

namespace rips::simulation {
namespace {

constexpr uint64_t kFirstSeed = 1;
constexpr uint64_t kSteps = 100'000;
constexpr uint64_t kStepsEach = 5'000;

std::string Shown(const std::optional<Finding>& found) {
  if (!found.has_value()) return "no violation";
  return absl::StrCat("seed ", found->seed, ", step ", found->step, ": ",
                      found->violation.invariant, " violated: ", found->violation.what, "\n",
                      absl::StrJoin(found->trace, "\n"));
}

// Each as a fault of the wiring; which invariant the checker names.
void ExpectFound(Fault fault, const std::string& invariant) {
  const std::optional<Finding> found = Search(kFirstSeed, kSteps, kStepsEach, fault);
  ASSERT_TRUE(found.has_value());
  EXPECT_EQ(found->violation.invariant, invariant) << Shown(found);
  ::testing::Test::RecordProperty("seed", absl::StrCat(found->seed));
  ::testing::Test::RecordProperty("step", absl::StrCat(found->step));
}

TEST(SimulationTest, NoInvariantIsViolated) {
  Counts counts;
  const std::optional<Finding> found =
      Search(kFirstSeed, Rounds(kSteps), kStepsEach, Fault::kNone, &counts);
  EXPECT_FALSE(found.has_value()) << Shown(found);
  // A run in which nothing happens shows nothing.
  EXPECT_GT(counts.decisions, Rounds(100u));
  EXPECT_GT(counts.soft_lowerings, Rounds(4u));
  EXPECT_GT(counts.operator_lowerings, Rounds(20u));
  EXPECT_GT(counts.approved_lowerings, Rounds(5u));
  EXPECT_GT(counts.judged, Rounds(1'000u));
  EXPECT_GT(counts.resent, Rounds(10u));
  EXPECT_GT(counts.verified, Rounds(50u));
  EXPECT_GT(counts.floors, Rounds(10u));
  EXPECT_GT(counts.lifted, Rounds(10u));
  EXPECT_GT(counts.refused_stale, Rounds(10u));
}

TEST(SimulationTest, OneSeedIsOneRun) {
  World first(7);
  World second(7);
  for (int i = 0; i < 3'000; ++i) {
    first.Step();
    second.Step();
  }
  EXPECT_EQ(first.trace(), second.trace());
}

TEST(SimulationTest, FindsALoweringThatIsSentBeforeItIsDurable) {
  ExpectFound(Fault::kEarlyLowering, "I2");
}

TEST(SimulationTest, FindsAStaleTermThatIsObeyed) { ExpectFound(Fault::kStaleTerm, "I1"); }

TEST(SimulationTest, FindsAnAcknowledgementBeforeTheCommit) {
  ExpectFound(Fault::kEarlyAcknowledgement, "I2");
}

TEST(SimulationTest, FindsALostLeaseThatIsIgnored) { ExpectFound(Fault::kIgnoredLease, "I5"); }

TEST(SimulationTest, FindsAnObservationThatIsJudgedTwice) {
  ExpectFound(Fault::kJudgedTwice, "I3");
}

}  // namespace
}  // namespace rips::simulation

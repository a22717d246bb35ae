#include "tests/support/robot_sim/floor.h"

#include <algorithm>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/clock.h"
#include "services/base/status_matchers.h"
#include "tests/support/robot_sim/commands.h"
#include "tests/support/robot_sim/patrol.h"

namespace rips::robot_sim {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr int64_t kTenthNs = kNanosPerSecond / 10;

// A corridor of 10 cells, and a way round its middle.
constexpr char kSmall[] = R"(width: 12
height: 8
cell_mm: 100
free: [1 1 10 1, 1 2 1 4, 2 4 9 4, 10 2 10 4]
keep_out: 5 0 6 2
places: {A: 1 1, B: 10 1}
person: {from: 5 6, to: 5 2, cells: 2, takes: 4s}
)";

Floor Small() {
  auto plan = ParseFloorPlan(kSmall, "small.yaml");
  EXPECT_THAT(plan, IsOk());
  return Floor(*std::move(plan));
}

Floor OfTheExperiment() {
  auto text = ReadFile(RIPS_SOURCE_DIR "/deploy/paper/floor.yaml");
  EXPECT_THAT(text, IsOk());
  auto plan = ParseFloorPlan(*text, "floor.yaml");
  EXPECT_THAT(plan, IsOk());
  return Floor(*std::move(plan));
}

int64_t Free(const Floor& floor, const InTheWay& in_the_way) {
  return std::ranges::count(floor.Grid(in_the_way), '\0');
}

TEST(FloorTest, CountsAsThePaperDoes) {
  const Floor floor = OfTheExperiment();
  EXPECT_EQ(floor.Grid({}).size(), 198u * 209u);
  EXPECT_EQ(Free(floor, {}), 1'662);
  EXPECT_EQ(Free(floor, {.keep_out = true}), 1'662 - 52 * 5);
  // Eight cells of the detour, which is three wide.
  EXPECT_EQ(Free(floor, {.keep_out = true, .person = Cell{60, 163}}), 1'662 - 52 * 5 - 8 * 3);
}

TEST(FloorTest, TheWayIsTheShortestThatIsFree) {
  const Floor floor = Small();
  EXPECT_EQ(floor.Way({1, 1}, {10, 1}, {}).size(), 9u);
  const std::vector<Cell> round = floor.Way({1, 1}, {10, 1}, {.keep_out = true});
  EXPECT_EQ(round.size(), 3u + 9u + 3u);
  for (const Cell& cell : round) EXPECT_FALSE(floor.plan().keep_out.Has(cell));
  EXPECT_THAT(floor.Way({1, 1}, {10, 1}, {.keep_out = true, .person = Cell{5, 4}}), IsEmpty());
  EXPECT_THAT(floor.Way({1, 1}, {1, 1}, {}), IsEmpty());
}

TEST(FloorTest, WhoStandsWhereItIsNotFreeLeavesByTheNearestWay) {
  const std::vector<Cell> way = Small().Way({5, 1}, {10, 1}, {.keep_out = true});
  EXPECT_THAT(way, ElementsAre(Cell{4, 1}));
}

TEST(FloorTest, APersonWalksAcrossAndIsGone) {
  const Floor floor = Small();
  EXPECT_EQ(floor.PersonAfter(0), (Cell{5, 6}));
  EXPECT_EQ(floor.PersonAfter(2 * kNanosPerSecond), (Cell{5, 4}));
  EXPECT_EQ(floor.PersonAfter(4 * kNanosPerSecond), (Cell{5, 2}));
  EXPECT_EQ(floor.PersonAfter(4 * kNanosPerSecond + 1), std::nullopt);
}

TEST(FloorTest, AFileThatMakesNoSenseSaysWhere) {
  for (const auto& [from, to, why] :
       {std::tuple("places: {A: 1 1", "places: {A: 1 9", "a cell of the floor"),
        std::tuple("1 1 10 1", "1 1 12 1", "a rectangle on the floor"),
        std::tuple("5 0 6 2", "6 0 5 2", "a rectangle on the floor"),
        std::tuple("width: 12", "width: 0", "width"),
        std::tuple("width: 12", "width: 4097", "width"),
        std::tuple("cells: 2", "cells: 101", "cells"),
        std::tuple("places:", "plces:", "unknown key `plces`")}) {
    std::string text = kSmall;
    text.replace(text.find(from), std::string(from).size(), to);
    EXPECT_THAT(ParseFloorPlan(text, "small.yaml"),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(why)));
  }
}

// A robot that obeys each command at once.
class PatrolTest : public ::testing::Test {
 protected:
  // Drives for so long. Gives how far it came, in metres.
  double Drive(double seconds, bool keep_out = false) {
    double metres = 0;
    for (int i = 0; i < static_cast<int>(10 * seconds); ++i) {
      const Twist twist = patrol_.Steer(now_ns_, keep_out, 1.0);
      const Floor::Point before = patrol_.at();
      patrol_.Drive(now_ns_ += kTenthNs / 10, twist);
      metres += std::abs(patrol_.at().x - before.x) + std::abs(patrol_.at().y - before.y);
      const Cell at = patrol_.floor().CellOf(patrol_.at());
      EXPECT_TRUE(patrol_.floor().IsFree(at, {})) << at.x << " " << at.y;
      EXPECT_FALSE(keep_out && patrol_.floor().plan().keep_out.Has(at)) << at.x << " " << at.y;
    }
    return metres;
  }
  Cell At() { return patrol_.floor().CellOf(patrol_.at()); }

  Patrol patrol_{Small()};
  int64_t now_ns_ = 1'000 * kNanosPerSecond;
};

TEST_F(PatrolTest, StandsUntilItIsSentAndStopsWhereItIsSent) {
  EXPECT_EQ(Drive(1), 0);
  EXPECT_THAT(patrol_.Send("nowhere"), StatusIs(absl::StatusCode::kNotFound));
  ASSERT_THAT(patrol_.Send("B"), IsOk());
  EXPECT_NEAR(Drive(20), 0.9, 0.02);
  EXPECT_EQ(At(), (Cell{10, 1}));
  EXPECT_NEAR(Drive(1), 0, 0.01);
}

TEST_F(PatrolTest, GoesRoundTheZoneAndBackThroughItWhenItIsFree) {
  ASSERT_THAT(patrol_.Send("B"), IsOk());
  EXPECT_NEAR(Drive(40, /*keep_out=*/true), 1.5, 0.05);
  EXPECT_EQ(At(), (Cell{10, 1}));
  ASSERT_THAT(patrol_.Send("A"), IsOk());
  EXPECT_NEAR(Drive(20), 0.9, 0.05);
  EXPECT_EQ(At(), (Cell{1, 1}));
}

TEST_F(PatrolTest, WaitsForAPersonInTheWay) {
  ASSERT_THAT(patrol_.Send("B"), IsOk());
  Drive(5, /*keep_out=*/true);
  patrol_.SendPerson(now_ns_ - 2 * kNanosPerSecond);  // in the middle of the detour
  const double before = Drive(4, /*keep_out=*/true);
  EXPECT_LT(before, 0.2);
  patrol_.SendPerson(now_ns_ - 60 * kNanosPerSecond);  // gone
  EXPECT_GT(Drive(5, /*keep_out=*/true), 0.4);
}

}  // namespace
}  // namespace rips::robot_sim

#include "policy_server/ripsctl/top/fleet_view.h"

#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/samples.h"
#include "services/text/utf8.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::SizeIs;
using ::testing::StartsWith;

const absl::Time kNow = absl::FromUnixSeconds(1'767'225'600);  // 2026-01-01T00:00:00Z
constexpr TerminalSize kSize = {.columns = 100, .rows = 24};

std::vector<std::string> Texts(const std::vector<ScreenLine>& lines) {
  std::vector<std::string> texts;
  for (const ScreenLine& line : lines) texts.push_back(line.text);
  return texts;
}

// The names in the table, in their order.
std::vector<std::string> Names(const std::vector<ScreenLine>& lines) {
  std::vector<std::string> names;
  for (size_t i = 3; i < lines.size(); ++i) {
    if (lines[i].style == LineStyle::kReverse) continue;
    const std::string row = lines[i].text.substr(2);
    names.push_back(row.substr(0, row.find(' ')));
  }
  return names;
}

class FleetViewTest : public testing::Test {
 protected:
  FleetViewTest() {
    view_.Connected();
    view_.SetLevels("sha256:" + std::string(64, 'b'), {"DEFAULT", "ALERT", "HALT"});
  }
  // `change` of a robot that is as it should be.
  template <typename Change>
  void Add(const std::string& robot, const std::string& level, const Change& change) {
    v1::RobotStatus status = MakeStatus(robot, level);
    change(status);
    view_.Update(status);
  }
  void Add(const std::string& robot, const std::string& level) {
    Add(robot, level, [](v1::RobotStatus&) {});
  }

  FleetView view_{"ps.example:7443"};
};

TEST_F(FleetViewTest, ShowsAMaintenanceBeforeWhatMayComeOfIt) {
  Add("r1", "DEFAULT", [](v1::RobotStatus& status) {
    *status.mutable_maintenance() = MakeMaintenance();
    status.add_degraded("sensor base lost");
  });
  EXPECT_THAT(view_.Render(kSize, kNow)[3].text,
              HasSubstr("  maintenance until 18:20 UTC (carol); sensor base lost"));
}

TEST_F(FleetViewTest, HasAHeaderAndARowForEachRobot) {
  Add("r1", "DEFAULT");
  Add("r2", "ALERT", [](v1::RobotStatus& status) { status.add_degraded("sensor base lost"); });
  EXPECT_THAT(Texts(view_.Render(kSize, kNow)),
              ElementsAre("ripsctl top  ps.example:7443  2026-01-01 00:00:00Z  q ends",
                          "2 robots: 1 ALERT, 1 DEFAULT; 1 degraded",
                          "  ROBOT  DECIDED  EFFECTIVE  STAGE     DEGRADED",
                          "  r2     ALERT    ALERT      verified  sensor base lost",
                          "  r1     DEFAULT  DEFAULT    verified  -"));
}

TEST_F(FleetViewTest, TheMostUrgentRobotsComeFirst) {
  Add("calm-2", "DEFAULT");
  Add("calm-1", "DEFAULT");
  Add("degraded", "DEFAULT", [](v1::RobotStatus& status) { status.add_degraded("x"); });
  Add("approve", "DEFAULT", [](v1::RobotStatus& status) { status.set_pending_approvals(1); });
  Add("requested", "DEFAULT", [](v1::RobotStatus& status) { status.set_stage("requested"); });
  Add("alert", "ALERT");
  Add("halt", "HALT");
  Add("still-high", "DEFAULT", [](v1::RobotStatus& status) { status.set_effective_level("HALT"); });
  Add("unknown", "NEW");
  Add("failed", "DEFAULT", [](v1::RobotStatus& status) { status.set_stage("failed"); });
  Add("alone", "DEFAULT", [](v1::RobotStatus& status) { status.clear_effective_level(); });
  const auto lines = view_.Render(kSize, kNow);
  EXPECT_THAT(Names(lines),
              ElementsAre("failed", "unknown", "halt", "still-high", "alert", "requested",
                          "degraded", "approve", "alone", "calm-1", "calm-2"));
  EXPECT_EQ(lines[1].text,
            "11 robots: 1 NEW, 1 HALT, 1 ALERT, 8 DEFAULT; 1 failed; 1 degraded; 1 to be approved");
  EXPECT_THAT(lines[3].text, StartsWith("! failed"));
  EXPECT_EQ(lines[3].style, LineStyle::kBold);
  EXPECT_EQ(lines.back().style, LineStyle::kPlain);
  EXPECT_THAT(Texts(lines), testing::Contains(HasSubstr("1 lowering to be approved")));
}

TEST_F(FleetViewTest, AnUpdateTakesThePlaceOfTheOldStatus) {
  Add("r1", "HALT");
  Add("r1", "DEFAULT");
  EXPECT_EQ(view_.Render(kSize, kNow)[1].text, "1 robot: 1 DEFAULT");
}

TEST_F(FleetViewTest, SaysWhatTheTerminalHasNoRoomFor) {
  for (int i = 10; i < 60; ++i) Add(absl::StrCat("r", i), i == 59 ? "HALT" : "DEFAULT");
  const auto lines = view_.Render({.columns = 100, .rows = 10}, kNow);
  ASSERT_THAT(lines, SizeIs(10));
  EXPECT_THAT(Names(lines), ElementsAre("r59", "r10", "r11", "r12", "r13", "r14"));
  EXPECT_EQ(lines[9].text, "44 more robots, less urgent, for which the terminal has no room");
  EXPECT_EQ(lines[9].style, LineStyle::kReverse);
  // Exactly enough.
  const auto all = view_.Render({.columns = 100, .rows = 53}, kNow);
  EXPECT_THAT(all, SizeIs(53));
  EXPECT_THAT(Names(all), SizeIs(50));
  const auto low = view_.Render({.columns = 100, .rows = 3}, kNow);
  ASSERT_THAT(low, SizeIs(3));
  EXPECT_THAT(low[2].text, StartsWith("50 more robots"));
}

TEST_F(FleetViewTest, FitsEverySize) {
  for (int i = 0; i < 5; ++i) {
    Add(std::string(63, static_cast<char>('a' + i)), std::string(300, 'L'),
        [](v1::RobotStatus& status) { status.add_degraded(std::string(5'000, 'x')); });
  }
  for (const bool lost : {false, true}) {
    if (lost) view_.Lost("x", kNow);
    for (size_t columns = 0; columns < 140; columns += 7) {
      for (size_t rows = 0; rows < 12; ++rows) {
        const auto lines = view_.Render({.columns = columns, .rows = rows}, kNow);
        EXPECT_LE(lines.size(), rows);
        for (const ScreenLine& line : lines) EXPECT_LE(CountCodePoints(line.text), columns);
      }
    }
  }
  EXPECT_THAT(view_.Render({.columns = 30, .rows = 1}, kNow)[0].text,
              AllOf(StartsWith("NOT CURRENT since"), testing::EndsWith(">")));
}

TEST_F(FleetViewTest, IsWhollyStaleWhileTheConnectionIsLost) {
  Add("r1", "HALT");
  Add("r2", "DEFAULT");
  view_.Lost("socket\x1b[2J closed", kNow);
  view_.Lost("and again", kNow + absl::Seconds(5));
  const auto lines = view_.Render(kSize, kNow + absl::Seconds(75));
  EXPECT_EQ(lines[0].text,
            "NOT CURRENT since 2026-01-01 00:00:00Z, 75 s ago: the connection is lost "
            "(socket\\x1b[2J closed); tr>");
  EXPECT_EQ(lines[0].style, LineStyle::kReverse);
  EXPECT_THAT(std::vector<ScreenLine>(lines.begin() + 1, lines.end()),
              AllOf(SizeIs(5), Each(Field(&ScreenLine::style, LineStyle::kDim))));
  EXPECT_THAT(lines[4].text, StartsWith("? r1"));
  EXPECT_THAT(lines[5].text, StartsWith("? r2"));

  // A robot is current again when its status has come.
  view_.Connected();
  Add("r2", "DEFAULT");
  const auto again = view_.Render(kSize, kNow + absl::Seconds(80));
  EXPECT_EQ(again[1].text, "2 robots: 1 HALT, 1 DEFAULT; 1 not heard of again");
  EXPECT_THAT(again[3].text, AllOf(StartsWith("? r1"), HasSubstr("no status since")));
  EXPECT_EQ(again[3].style, LineStyle::kDim);
  EXPECT_THAT(again[4].text, StartsWith("  r2"));
  EXPECT_EQ(again[4].style, LineStyle::kPlain);
}

TEST(FleetViewStartTest, SaysThatItWaits) {
  const FleetView view("ps\x1b[2J");
  EXPECT_THAT(
      Texts(view.Render(kSize, kNow)),
      ElementsAre("ripsctl top  ps\\x1b[2J  2026-01-01 00:00:00Z  q ends",
                  "waiting for the first status", "  ROBOT  DECIDED  EFFECTIVE  STAGE  DEGRADED"));
}

TEST_F(FleetViewTest, HostileTextIsHarmless) {
  const std::string hostile = "\x1b]0;x\x07\n\xff\xc2\x9b\xe2\x80\xae";
  Add("r1" + hostile, "L" + hostile, [&](v1::RobotStatus& status) {
    status.set_stage(hostile);
    status.set_bundle_version(hostile);
    status.set_effective_level(hostile);
    status.add_degraded(hostile);
  });
  view_.Lost(hostile, kNow);
  const auto lines = view_.Render({.columns = 400, .rows = 24}, kNow);
  for (const ScreenLine& line : lines) {
    for (const char c : line.text) {
      EXPECT_TRUE(c >= ' ' && c <= '~') << line.text;
    }
  }
  EXPECT_THAT(lines[4].text, HasSubstr("r1\\x1b]0;x\\x07\\x0a\\xff\\u009b\\u202e"));
}

TEST(ScreenBytesTest, ReplaceWhatWasThere) {
  EXPECT_EQ(ScreenBytes({{"a", LineStyle::kPlain}, {"b", LineStyle::kReverse}}),
            "\x1b[Ha\x1b[0m\x1b[K\r\n\x1b[7mb\x1b[0m\x1b[K\x1b[J");
  EXPECT_EQ(ScreenBytes({}), "\x1b[H\x1b[J");
}

TEST_F(FleetViewTest, AServerCannotFillTheMemory) {
  const size_t bytes = MakeStatus("r1", "ALERT").ByteSizeLong();
  FleetView view("ps", 2 * bytes);
  view.Connected();
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(view.Update(MakeStatus("r1", "ALERT")));
  EXPECT_TRUE(view.Update(MakeStatus("r2", "ALERT")));
  EXPECT_FALSE(view.Update(MakeStatus("r3", "ALERT")));
  EXPECT_TRUE(view.Update(MakeStatus("r2", "HALT"))) << "which is shorter";
}

}  // namespace
}  // namespace rips::ripsctl

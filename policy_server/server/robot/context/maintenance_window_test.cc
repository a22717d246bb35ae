#include "policy_server/server/robot/context/maintenance_window.h"

#include <limits>
#include <string>

#include "gmock/gmock.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::HasSubstr;

constexpr int64_t kMinute = 60 * kNanosPerSecond;
constexpr int64_t kHour = 60 * kMinute;

class MaintenanceWindowTest : public ::testing::Test {
 protected:
  absl::Status Begin(int64_t for_ns, const std::string& by = "carol (spiffe://td serial 0c)") {
    return window_.Begin(for_ns, by, "reboot", clock_.Now());
  }
  bool Holds() const { return window_.At(clock_.Now()).has_value(); }

  FakeClock clock_;
  MaintenanceWindow window_;
};

TEST_F(MaintenanceWindowTest, HoldsUntilItsTime) {
  EXPECT_FALSE(Holds());
  EXPECT_EQ(window_.MarkAt(clock_.Now()), "");
  EXPECT_EQ(window_.PopOver(clock_.Now()), std::nullopt);
  ASSERT_THAT(Begin(2 * kHour), IsOk());
  EXPECT_EQ(window_.MarkAt(clock_.Now()),
            "in maintenance until 2026-01-01 02:00:00 UTC (asked by carol: reboot)");
  const auto now = window_.At(clock_.Now());
  ASSERT_TRUE(now.has_value());
  EXPECT_EQ(now->began_unix_ns, clock_.Now().unix_ns);
  EXPECT_EQ(now->until_unix_ns, clock_.Now().unix_ns + 2 * kHour);
  clock_.Advance(2 * kHour - 1);
  EXPECT_TRUE(Holds());
  EXPECT_EQ(window_.PopOver(clock_.Now()), std::nullopt);
  clock_.Advance(1);
  EXPECT_FALSE(Holds());
  EXPECT_EQ(window_.PopOver(clock_.Now()), now);
  EXPECT_EQ(window_.PopOver(clock_.Now()), std::nullopt) << "once";
}

TEST_F(MaintenanceWindowTest, TakesAMinuteToADay) {
  for (const int64_t bad :
       {int64_t{0}, kMinute - 1, 24 * kHour + 1, int64_t{-1}, std::numeric_limits<int64_t>::max(),
        std::numeric_limits<int64_t>::min()}) {
    EXPECT_THAT(Begin(bad),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("1 minute to 24 hours")));
    EXPECT_FALSE(Holds());
  }
  EXPECT_THAT(Begin(kMinute), IsOk());
  EXPECT_THAT(Begin(24 * kHour), IsOk());
  EXPECT_FALSE(Begin(24 * kHour + 1).ok());
  clock_.Advance(24 * kHour - 1);
  EXPECT_TRUE(Holds()) << "a refused one changes nothing";
}

TEST_F(MaintenanceWindowTest, ANewOneReplacesTheEnd) {
  ASSERT_THAT(Begin(3 * kHour), IsOk());
  clock_.Advance(kHour);
  ASSERT_THAT(Begin(kMinute, "dave"), IsOk());
  EXPECT_EQ(window_.At(clock_.Now())->by, "dave");
  clock_.Advance(kMinute);
  EXPECT_FALSE(Holds());
  EXPECT_EQ(window_.PopOver(clock_.Now())->by, "dave");
}

TEST_F(MaintenanceWindowTest, EndsWhenItIsEnded) {
  ASSERT_THAT(Begin(kHour), IsOk());
  window_.End();
  EXPECT_FALSE(Holds());
  EXPECT_EQ(window_.PopOver(clock_.Now()), std::nullopt) << "it did not end by time";
}

TEST_F(MaintenanceWindowTest, AWallClockThatIsSetBackMakesItNoLonger) {
  ASSERT_THAT(Begin(24 * kHour), IsOk());
  clock_.JumpUnix(-7 * 24 * kHour);
  clock_.Advance(24 * kHour - 1);
  EXPECT_TRUE(Holds());
  clock_.Advance(1);
  EXPECT_FALSE(Holds());
  EXPECT_TRUE(window_.PopOver(clock_.Now()).has_value());
}

TEST_F(MaintenanceWindowTest, AWallClockThatIsPastTheEndEndsIt) {
  ASSERT_THAT(Begin(kHour), IsOk());
  clock_.JumpUnix(kHour);
  EXPECT_FALSE(Holds());
}

TEST_F(MaintenanceWindowTest, AfterARestartTheWallClockDecides) {
  ASSERT_THAT(Begin(kHour), IsOk());
  const store::Maintenance stored = *window_.At(clock_.Now());
  clock_.Advance(20 * kMinute);
  MaintenanceWindow later;
  later.Restore(stored, {.boottime_ns = 5, .unix_ns = clock_.Now().unix_ns});
  const auto after = [&](int64_t ns) {
    return Instant{.boottime_ns = 5 + ns, .unix_ns = clock_.Now().unix_ns + ns};
  };
  EXPECT_EQ(later.At(after(0)), stored);
  EXPECT_EQ(later.At(after(40 * kMinute - 1)), stored);
  EXPECT_EQ(later.At(after(40 * kMinute)), std::nullopt);
  EXPECT_EQ(later.PopOver(after(40 * kMinute)), stored);
}

TEST_F(MaintenanceWindowTest, OneThatIsOverAtARestartIsLeftToBeReported) {
  const int64_t now_ns = clock_.Now().unix_ns;
  const int64_t ends[] = {now_ns - 1,
                          now_ns,
                          1,
                          -1,
                          now_ns + 24 * kHour + 1,
                          std::numeric_limits<int64_t>::max(),
                          std::numeric_limits<int64_t>::min()};
  for (const int64_t until : ends) {
    SCOPED_TRACE(until);
    const store::Maintenance stored{
        .began_unix_ns = now_ns, .until_unix_ns = until, .by = "carol", .reason = "reboot"};
    window_.Restore(stored, clock_.Now());
    EXPECT_FALSE(Holds());
    EXPECT_EQ(window_.PopOver(clock_.Now()), stored);
  }
  window_.Restore({.until_unix_ns = now_ns + 24 * kHour, .by = "carol"}, clock_.Now());
  EXPECT_TRUE(Holds()) << "just not too far ahead";
  window_.Restore({}, clock_.Now());
  EXPECT_FALSE(Holds());
  EXPECT_EQ(window_.PopOver(clock_.Now()), std::nullopt) << "there was none";
}

}  // namespace
}  // namespace rips::pipeline

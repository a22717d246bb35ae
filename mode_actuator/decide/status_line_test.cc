#include "mode_actuator/decide/status_line.h"

#include "gtest/gtest.h"

namespace rips::actuator {
namespace {

TEST(StatusLineTest, NamesTheLevelAndWhatIsWrong) {
  const absl::Status gone = absl::UnavailableError("connection refused");
  EXPECT_EQ(StatusLine({}, false, absl::OkStatus()),
            "level not known, not verified; not connected to a policy server");
  EXPECT_EQ(StatusLine({.effective = "ALERT", .verified = true}, true, gone),
            "level ALERT, verified; connected");
  EXPECT_EQ(StatusLine({.effective = "ALERT",
                        .floor = "ALERT",
                        .floor_reason = "no lease for 5 s",
                        .degraded = {"no alarm lamp", "no rips-fw", "no rips-exec"}},
                       false, gone),
            "level ALERT, not verified; floor ALERT: no lease for 5 s; not connected to a policy "
            "server: connection refused; degraded: no alarm lamp, 2 more");
}

}  // namespace
}  // namespace rips::actuator

#include "services/runtime/await.h"

#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/clock.h"
#include "services/base/status_matchers.h"

namespace rips {
namespace {

using ::testing::ElementsAre;

TEST(RepeatFilterTest, SaysTheSameAgainOnlyAfterTenMinutes) {
  RepeatFilter filter;
  EXPECT_TRUE(filter.Pass("no key", 0));
  EXPECT_FALSE(filter.Pass("no key", 599 * kNanosPerSecond));
  EXPECT_TRUE(filter.Pass("no key", 600 * kNanosPerSecond));
  EXPECT_TRUE(filter.Pass("not yet valid", 600 * kNanosPerSecond));
  EXPECT_FALSE(filter.Pass("not yet valid", 601 * kNanosPerSecond));
}

TEST(AwaitTest, TriesWithLongerPausesUntilItWorks) {
  int attempts = 0;
  std::vector<absl::Duration> pauses;
  const absl::Status status = Await(
      "the key", [&] { return ++attempts < 7 ? absl::NotFoundError("no key") : absl::OkStatus(); },
      [&](absl::Duration pause) {
        pauses.push_back(pause);
        return false;
      });
  EXPECT_THAT(status, IsOk());
  EXPECT_THAT(pauses, ElementsAre(absl::Seconds(1), absl::Seconds(2), absl::Seconds(4),
                                  absl::Seconds(8), absl::Seconds(10), absl::Seconds(10)));
}

TEST(AwaitTest, GivesUpOnWhatNoWaitingMends) {
  const absl::Status status = Await(
      "the key", [] { return absl::PermissionDeniedError("another's"); },
      [](absl::Duration) -> bool {
        ADD_FAILURE() << "waited";
        return true;
      });
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kPermissionDenied));
}

TEST(AwaitTest, EndsWhenAskedTo) {
  const absl::Status status = Await(
      "the key", [] { return absl::UnavailableError("no key"); },
      [](absl::Duration) { return true; });
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kCancelled));
}

}  // namespace
}  // namespace rips

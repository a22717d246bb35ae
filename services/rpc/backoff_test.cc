#include "services/rpc/backoff.h"

#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::rpc {
namespace {

using ::testing::ElementsAre;

absl::Duration Ms(int64_t ms) { return absl::Milliseconds(ms); }

// Without jitter.
double Middle() { return 0.5; }

std::vector<absl::Duration> Delays(ReconnectPacer& pacer, CloseClass close_class, int count) {
  std::vector<absl::Duration> delays;
  for (int i = 0; i < count; ++i) delays.push_back(pacer.Next(close_class));
  return delays;
}

TEST(BackoffTest, DoublesUpToTheMaximum) {
  ReconnectPacer sensor(SensorBackoff(), Middle);
  ReconnectPacer actuator(ActuatorBackoff(), Middle);

  EXPECT_THAT(Delays(sensor, CloseClass::kRetry, 7),
              ElementsAre(Ms(200), Ms(400), Ms(800), Ms(1600), Ms(3200), Ms(5000), Ms(5000)));
  EXPECT_THAT(Delays(actuator, CloseClass::kReidentify, 6),
              ElementsAre(Ms(200), Ms(400), Ms(800), Ms(1600), Ms(2000), Ms(2000)));
}

TEST(BackoffTest, NeverStopsTryingWhatWasRefused) {
  ReconnectPacer pacer(SensorBackoff(), Middle);

  EXPECT_THAT(Delays(pacer, CloseClass::kRefused, 8),
              ElementsAre(Ms(1000), Ms(2000), Ms(4000), Ms(8000), Ms(16000), Ms(32000), Ms(60000),
                          Ms(60000)));
  EXPECT_THAT(Delays(pacer, CloseClass::kSecondSession, 3),
              ElementsAre(Ms(1000), Ms(2000), Ms(2000)));
}

TEST(BackoffTest, StartsAgainAfterAMessage) {
  ReconnectPacer pacer(SensorBackoff(), Middle);
  Delays(pacer, CloseClass::kRetry, 5);
  Delays(pacer, CloseClass::kRefused, 5);

  pacer.MessageReceived();

  EXPECT_EQ(pacer.Next(CloseClass::kRetry), Ms(200));
  EXPECT_EQ(pacer.Next(CloseClass::kRefused), Ms(1000));
}

TEST(BackoffTest, JittersByTwentyPercentWithoutDrifting) {
  double random = 0;
  Backoff backoff(SensorBackoff(), [&] { return random; });

  EXPECT_EQ(backoff.Next(), Ms(160));
  EXPECT_EQ(backoff.Next(), Ms(320));
  random = 1;
  EXPECT_EQ(backoff.Next(), Ms(960));
  EXPECT_EQ(backoff.Next(), Ms(1920));
}

TEST(BackoffTest, ClassifiesEveryCode) {
  const auto name = [](absl::StatusCode code) { return CloseClassName(ClassifyClose(code)); };
  for (int i = 0; i <= 16; ++i) {
    const auto code = static_cast<absl::StatusCode>(i);
    absl::string_view expected = "retry";
    if (code == absl::StatusCode::kUnauthenticated) expected = "reidentify";
    if (code == absl::StatusCode::kAlreadyExists) expected = "second_session";
    for (const auto refused :
         {absl::StatusCode::kPermissionDenied, absl::StatusCode::kUnimplemented,
          absl::StatusCode::kFailedPrecondition, absl::StatusCode::kInvalidArgument}) {
      if (code == refused) expected = "refused";
    }
    EXPECT_EQ(name(code), expected) << code;
  }
}

}  // namespace
}  // namespace rips::rpc

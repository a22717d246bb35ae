#include "services/runtime/log_limiter.h"

#include <optional>
#include <string>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"

namespace rips {
namespace {

TEST(LogLimiterTest, LinesOfOneSourceDoNotCountForOthers) {
  LogLimiter limiter;
  int written = 0;
  for (int i = 0; i < 1'000; ++i) written += limiter.Admit("noisy", 0.0).has_value() ? 1 : 0;
  EXPECT_EQ(written, 50);
  EXPECT_EQ(limiter.Admit("quiet", 0.0), 0u);
  EXPECT_EQ(limiter.Admit("noisy", 0.5), std::nullopt);
  EXPECT_EQ(limiter.Admit("noisy", 2.0), 951u) << "says what it left out";
}

TEST(LogLimiterTest, SourcesBeyondTheMostShareOnePlace) {
  LogLimiter limiter;
  for (size_t i = 0; i < LogLimiter::kSourcesMax; ++i) limiter.Admit(absl::StrCat(i), 0.0);
  int written = 0;
  for (int i = 0; i < 1'000; ++i) {
    written += limiter.Admit(absl::StrCat("new ", i), 0.0).has_value() ? 1 : 0;
  }
  EXPECT_EQ(written, 50);
}

}  // namespace
}  // namespace rips

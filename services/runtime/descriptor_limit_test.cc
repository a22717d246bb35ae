#include "services/runtime/descriptor_limit.h"

#include <sys/resource.h>

#include "gtest/gtest.h"

namespace rips {
namespace {

TEST(DescriptorLimitTest, IsRaisedAsFarAsItMayBeAndNeverLowered) {
  rlimit before = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  const rlimit low = {.rlim_cur = 100, .rlim_max = 200};
  EXPECT_EXIT(
      {
        setrlimit(RLIMIT_NOFILE, &low);
        const bool right = RaiseDescriptorLimit(50) == 100 && RaiseDescriptorLimit(150) == 150 &&
                           RaiseDescriptorLimit(1'000) == 200;
        _exit(right ? 0 : 1);
      },
      ::testing::ExitedWithCode(0), "");
}

}  // namespace
}  // namespace rips

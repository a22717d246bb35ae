#include "services/runtime/file_lock.h"

#include <stdlib.h>
#include <unistd.h>

#include <filesystem>
#include <string>

#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips {
namespace {

class LockFileTest : public ::testing::Test {
 protected:
  LockFileTest() {
    std::string name = "/tmp/rips-lock-XXXXXX";
    dir_ = mkdtemp(name.data());
  }
  ~LockFileTest() override { std::filesystem::remove_all(dir_); }

  std::string dir_;
};

TEST_F(LockFileTest, IsHeldByOneUntilItIsClosed) {
  auto first = LockFile(dir_ + "/lock");
  ASSERT_THAT(first, IsOk());
  EXPECT_THAT(LockFile(dir_ + "/lock"), StatusIs(absl::StatusCode::kFailedPrecondition));
  first->Reset();
  EXPECT_THAT(LockFile(dir_ + "/lock"), IsOk());
}

TEST_F(LockFileTest, SaysWhatIsNotThere) {
  EXPECT_THAT(LockFile(dir_ + "/none/lock"), StatusIs(absl::StatusCode::kNotFound));
  ASSERT_EQ(symlink("elsewhere", (dir_ + "/link").c_str()), 0);
  EXPECT_THAT(LockFile(dir_ + "/link"), StatusIs(absl::StatusCode::kUnavailable))
      << "a link may lead anywhere";
}

}  // namespace
}  // namespace rips

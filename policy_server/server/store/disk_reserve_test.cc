#include "policy_server/server/store/disk_reserve.h"

#include <sys/stat.h>

#include <filesystem>
#include <fstream>

#include "gtest/gtest.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/status_matchers.h"

namespace rips::store {
namespace {

constexpr int64_t kBytes = 3 * DiskReserve::kPieceBytes;

int64_t Allocated(const std::string& path) {
  struct stat info = {};
  return stat(path.c_str(), &info) == 0 ? int64_t{info.st_blocks} * 512 : -1;
}

TEST(DiskReserveTest, GivesItsRoomUpInPiecesAndTakesItBack) {
  const TempDir dir;
  const std::string path = dir.File("reserve");
  auto reserve = DiskReserve::Open(path, kBytes);
  ASSERT_THAT(reserve, IsOk());
  EXPECT_EQ(Allocated(path), kBytes) << "blocks, not a hole";

  EXPECT_TRUE(reserve->Release());
  EXPECT_EQ(Allocated(path), kBytes - DiskReserve::kPieceBytes);
  EXPECT_TRUE(reserve->Release());
  EXPECT_TRUE(reserve->Release());
  EXPECT_FALSE(reserve->Release()) << "nothing is left";
  EXPECT_EQ(Allocated(path), 0);

  EXPECT_THAT(reserve->Refill(), IsOk());
  EXPECT_EQ(Allocated(path), kBytes);
}

TEST(DiskReserveTest, IsFoundAgainAndFilledUp) {
  const TempDir dir;
  const std::string path = dir.File("reserve");
  { ASSERT_THAT(DiskReserve::Open(path, DiskReserve::kPieceBytes), IsOk()); }
  const auto reserve = DiskReserve::Open(path, kBytes);
  ASSERT_THAT(reserve, IsOk());
  EXPECT_EQ(reserve->held(), kBytes);
  EXPECT_EQ(Allocated(path), kBytes);
}

TEST(DiskReserveTest, AHoleHoldsNothing) {
  const TempDir dir;
  const std::string path = dir.File("reserve");
  std::ofstream(path).put('x');
  std::filesystem::resize_file(path, kBytes);
  ASSERT_LT(Allocated(path), kBytes);
  ASSERT_THAT(DiskReserve::Open(path, kBytes), IsOk());
  EXPECT_EQ(Allocated(path), kBytes);
}

TEST(DiskReserveTest, RefusesWhatIsNotAFile) {
  const TempDir dir;
  EXPECT_THAT(DiskReserve::Open(dir.File("no/such/reserve"), kBytes),
              StatusIs(absl::StatusCode::kUnavailable));
  std::filesystem::create_symlink("/dev/null", dir.File("link"));
  EXPECT_THAT(DiskReserve::Open(dir.File("link"), kBytes),
              StatusIs(absl::StatusCode::kUnavailable));
}

TEST(DiskReserveTest, NoneIsKeptWhereNoneIsAskedFor) {
  const TempDir dir;
  auto reserve = DiskReserve::Open(dir.File("reserve"), 0);
  ASSERT_THAT(reserve, IsOk());
  EXPECT_FALSE(reserve->Release());
  EXPECT_THAT(reserve->Refill(), IsOk());
}

}  // namespace
}  // namespace rips::store

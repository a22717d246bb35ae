#include "sensor_agent/uplink/store_file.h"

#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/ids.h"
#include "services/base/status_matchers.h"
#include "services/runtime/atomic_file.h"

namespace rips::sensor {
namespace {

class StoreFileTest : public testing::Test {
 protected:
  StoreFileTest()
      : dir_(std::filesystem::temp_directory_path() / absl::StrCat("rips-store-file-", NewId())) {
    std::filesystem::create_directories(dir_);
    point_.set_generation("0123456789abcdef");
    point_.set_commit(390);
  }
  ~StoreFileTest() override { std::filesystem::remove_all(dir_); }

  std::string path() const { return StoreFile(dir_.string()); }
  void Write(const std::string& bytes) {
    std::ofstream(path(), std::ios::binary | std::ios::trunc) << bytes;
  }

  const std::filesystem::path dir_;
  rips::v1::StorePoint point_;
};

TEST_F(StoreFileTest, WhatIsKeptIsFoundAgain) {
  for (const uint64_t commit : {uint64_t{0}, uint64_t{390}, ~uint64_t{0}}) {
    point_.set_commit(commit);
    ASSERT_THAT(SaveStorePoint(path(), point_), IsOk());
    const auto kept = LoadStorePoint(path());
    ASSERT_THAT(kept, IsOk());
    EXPECT_EQ(kept->generation(), "0123456789abcdef");
    EXPECT_EQ(kept->commit(), commit);
  }
}

TEST_F(StoreFileTest, NoFileIsNoPoint) {
  EXPECT_THAT(LoadStorePoint(path()), StatusIs(absl::StatusCode::kNotFound));
}

TEST_F(StoreFileTest, EveryCutAndEveryFlippedBitIsNoticed) {
  ASSERT_THAT(SaveStorePoint(path(), point_), IsOk());
  const std::string whole = *ReadFile(path(), 1'000);
  for (size_t size = 0; size < whole.size(); ++size) {
    Write(whole.substr(0, size));
    EXPECT_THAT(LoadStorePoint(path()), StatusIs(absl::StatusCode::kDataLoss)) << size;
  }
  for (size_t bit = 0; bit < 8 * whole.size(); ++bit) {
    std::string flipped = whole;
    flipped[bit / 8] = static_cast<char>(flipped[bit / 8] ^ (1 << bit % 8));
    Write(flipped);
    EXPECT_THAT(LoadStorePoint(path()), StatusIs(absl::StatusCode::kDataLoss)) << bit;
  }
  Write(whole + "more");
  EXPECT_THAT(LoadStorePoint(path()), StatusIs(absl::StatusCode::kDataLoss));
}

TEST_F(StoreFileTest, LargeFilesOtherThingsAndOtherSizesAreRefused) {
  Write(std::string(1'000, 'x'));
  EXPECT_THAT(LoadStorePoint(path()), StatusIs(absl::StatusCode::kResourceExhausted));
  std::filesystem::remove(path());
  std::filesystem::create_directory(path());
  EXPECT_THAT(LoadStorePoint(path()), StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_FALSE(SaveStorePoint(path(), point_).ok());
  point_.set_generation("short");
  EXPECT_THAT(SaveStorePoint(path(), point_), StatusIs(absl::StatusCode::kInvalidArgument));
}

}  // namespace
}  // namespace rips::sensor

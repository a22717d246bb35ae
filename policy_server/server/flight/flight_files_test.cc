#include "policy_server/server/flight/flight_files.h"

#include <sys/mount.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/policy/recording/rips_writer.h"
#include "services/base/status_matchers.h"

namespace rips::flight {
namespace {

namespace fs = std::filesystem;

using ::testing::HasSubstr;

std::string Id(char digit) { return std::string(32, digit); }

class FlightFilesTest : public ::testing::Test {
 protected:
  FlightFilesTest() {
    char name[] = "/tmp/rips_flight.XXXXXX";
    root_ = mkdtemp(name);
    options_.directory = root_ + "/recordings";
    options_.free_bytes_min = 0;
    Open();
  }
  ~FlightFilesTest() override { fs::remove_all(root_); }
  void Open() {
    auto files = FlightFiles::Open(options_);
    ASSERT_THAT(files, IsOk());
    files_ = *std::move(files);
  }
  absl::Status Save(const std::string& robot, const std::string& alert, size_t padding = 0) {
    const recording::RecordedOrigin origin{.robot = robot,
                                           .bundle_id = std::string(padding, 'b'),
                                           .start_unix_ns = ++time_,
                                           .alerts = {{.id = alert}}};
    return files_->Save(origin, *recording::EncodeStart(origin));
  }
  bool Kept(const std::string& alert) const { return files_->Find(alert).ok(); }

  std::string root_;
  FlightFilesOptions options_;
  std::unique_ptr<FlightFiles> files_;
  int64_t time_ = 0;
};

TEST_F(FlightFilesTest, FindsWhatItSavedAlsoAfterARestart) {
  ASSERT_THAT(Save("r1", Id('a')), IsOk());
  ASSERT_THAT(Save("r2", Id('b')), IsOk());
  for (int i = 0; i < 2; ++i) {
    const auto found = files_->Find("aaaaaaaa");
    ASSERT_THAT(found, IsOk());
    EXPECT_THAT(*found, HasSubstr("/r1/"));
    EXPECT_TRUE(fs::exists(*found));
    EXPECT_THAT(files_->Find("cccccc").status(), StatusIs(absl::StatusCode::kNotFound));
    Open();
  }
}

TEST_F(FlightFilesTest, AnIdMustTellAlertsApartAndBeOne) {
  ASSERT_THAT(Save("r1", "aaaaaa" + std::string(26, '1')), IsOk());
  ASSERT_THAT(Save("r1", "aaaaaa" + std::string(26, '2')), IsOk());
  EXPECT_THAT(files_->Find("aaaaaa").status(), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(files_->Find("aaaaaa1"), IsOk());
  for (const char* bad : {"", "../r1", "AAAAAA", "gggggg", "%", "aaaaa"}) {
    EXPECT_THAT(files_->Find(bad).status(), StatusIs(absl::StatusCode::kInvalidArgument)) << bad;
  }
  EXPECT_THAT(files_->Find(std::string(33, 'a')).status(),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST_F(FlightFilesTest, ARobotThatSavesMostMakesRoomAndNoOtherDoes) {
  options_.bytes_max = 10'000;
  Open();
  ASSERT_THAT(Save("quiet", Id('a'), 1'000), IsOk());
  for (int i = 0; i < 50; ++i) {
    ASSERT_THAT(
        Save("noisy", absl::StrCat(absl::Hex(i, absl::kZeroPad16), "0000000000000000"), 1'000),
        IsOk());
    EXPECT_LE(files_->bytes(), options_.bytes_max);
  }
  EXPECT_TRUE(Kept(Id('a')));
  EXPECT_FALSE(Kept("0000000000000000"));
  EXPECT_TRUE(Kept("0000000000000031")) << "the newest";
  uint64_t on_disk = 0;
  for (const auto& each : fs::recursive_directory_iterator(options_.directory)) {
    if (each.is_regular_file()) on_disk += each.file_size();
  }
  EXPECT_EQ(on_disk, files_->bytes());
  // A lower limit counts from the next start on.
  options_.bytes_max = 3'000;
  Open();
  EXPECT_LE(files_->bytes(), 3'000u);
  EXPECT_TRUE(Kept(Id('a')));
}

TEST_F(FlightFilesTest, WhatIsNoRecordingIsLeftAlone) {
  ASSERT_THAT(Save("r1", Id('a')), IsOk());
  const std::string torn = options_.directory + "/r1/torn.rips";
  std::ofstream(torn) << "\x89RIPS";
  std::ofstream(options_.directory + "/r1/notes.txt") << "mine";
  std::ofstream(options_.directory + "/loose.rips") << "x";
  fs::create_directories(options_.directory + "/r2");
  fs::copy_file(*files_->Find(Id('a')), options_.directory + "/r2/of_r1.rips");
  options_.bytes_max = 1;
  Open();
  EXPECT_EQ(files_->bytes(), 0u) << "only its own made room";
  EXPECT_TRUE(fs::exists(torn));
  EXPECT_TRUE(fs::exists(options_.directory + "/r1/notes.txt"));
  EXPECT_TRUE(fs::exists(options_.directory + "/r2/of_r1.rips"));
}

TEST_F(FlightFilesTest, RefusesWhatCannotBeKept) {
  options_.bytes_max = 500;
  Open();
  EXPECT_THAT(Save("r1", Id('a'), 1'000), StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_THAT(Save("../r1", Id('a')), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(Save("r1", "../a"), StatusIs(absl::StatusCode::kInvalidArgument));
  ASSERT_THAT(Save("r1", Id('a')), IsOk());
  EXPECT_THAT(files_->CheckWritable(), IsOk());
  options_.free_bytes_min = ~uint64_t{0} >> 1;
  Open();
  EXPECT_THAT(Save("r1", Id('b')).message(), HasSubstr("left to the store"));
  EXPECT_TRUE(Kept(Id('a'))) << "nothing is lost by that";
}

// On a file system of its own, which is small.
TEST_F(FlightFilesTest, OnADiskThatFillsUpItsOwnMakeRoom) {
  const std::string disk = root_ + "/disk";
  fs::create_directory(disk);
  if (mount("none", disk.c_str(), "tmpfs", 0, "size=4m") != 0) GTEST_SKIP() << "mount needs root";
  options_.directory = disk + "/recordings";
  options_.free_bytes_min = uint64_t{2} << 20;
  Open();
  for (const char digit : {'a', 'b', 'c', 'd'}) {
    EXPECT_THAT(Save("r1", Id(digit), 800'000), IsOk()) << digit;
  }
  EXPECT_FALSE(Kept(Id('a')));
  EXPECT_TRUE(Kept(Id('d')));
  std::ofstream(disk + "/others") << std::string(3'000'000, 'x');
  EXPECT_FALSE(Save("r1", Id('e'), 800'000).ok());
  EXPECT_TRUE(Kept(Id('d'))) << "to remove it would not have been enough";
  files_.reset();
  umount(disk.c_str());
}

TEST_F(FlightFilesTest, SaysWhyThereIsNone) {
  const auto why = [this](const std::string& alert) {
    return std::string(files_->Find(alert).status().message());
  };
  EXPECT_THAT(why(Id('a')), HasSubstr("its id is wrong"));
  files_->Expect(Id('a'));
  EXPECT_THAT(files_->Find("aaaaaa").status(),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("try again")));
  files_->Lose(Id('a'), "disk on fire");
  EXPECT_THAT(why("aaaaaa"), HasSubstr("could not be saved: disk on fire"));
  ASSERT_THAT(Save("r1", Id('a')), IsOk());
  EXPECT_TRUE(Kept("aaaaaaa"));
  options_.bytes_max = 1'500;
  Open();
  ASSERT_THAT(Save("r1", Id('b'), 1'000), IsOk());
  ASSERT_THAT(Save("r1", Id('c'), 1'000), IsOk());
  EXPECT_THAT(why(Id('b')), HasSubstr("made room for newer ones"));
  for (size_t i = 0; i < FlightFiles::kMissingMax; ++i) {
    files_->Expect(absl::StrCat(absl::Hex(i, absl::kZeroPad16), "0000000000000000"));
  }
  EXPECT_THAT(why(Id('b')), HasSubstr("too old"));
}

TEST_F(FlightFilesTest, WithoutItsDirectoryItSaysSo) {
  options_.directory = root_ + "/not/there";
  EXPECT_THAT(FlightFiles::Open(options_).status().message(), HasSubstr("/not/there"));
  EXPECT_THAT(Save("r1", Id('a')), IsOk());
  fs::remove_all(root_ + "/recordings");
  EXPECT_FALSE(files_->CheckWritable().ok());
  EXPECT_THAT(Save("r1", Id('b')), IsOk()) << "it is made again";
  fs::remove_all(root_);
  EXPECT_FALSE(Save("r1", Id('c')).ok());
}

}  // namespace
}  // namespace rips::flight

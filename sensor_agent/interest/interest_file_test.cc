#include "sensor_agent/interest/interest_file.h"

#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/ids.h"
#include "services/base/status_matchers.h"
#include "services/runtime/atomic_file.h"

namespace rips::sensor {
namespace {

using ::testing::HasSubstr;

class InterestFileTest : public testing::Test {
 protected:
  InterestFileTest()
      : dir_(std::filesystem::temp_directory_path() / absl::StrCat("rips-interest-", NewId())) {
    std::filesystem::create_directories(dir_);
  }
  ~InterestFileTest() override { std::filesystem::remove_all(dir_); }

  std::string path() const { return InterestFile(dir_.string()); }
  // Payloads of /a, metadata of /b, nothing of /c and of what is not named.
  static rips::v1::Interest Wire() {
    rips::v1::Interest wire;
    const auto add = [&wire](const char* regex, rips::v1::InterestRule::Depth depth) {
      rips::v1::InterestRule* rule = wire.add_rules();
      rule->set_topic_regex(regex);
      rule->set_depth(depth);
      return rule;
    };
    add("^/a$", rips::v1::InterestRule::PAYLOAD)->set_payload_bytes_max(10);
    add("^/b$", rips::v1::InterestRule::METADATA)->set_payload_bytes_max(20);
    add("^/c$", rips::v1::InterestRule::NOTHING);
    wire.add_kept_topics("/cmd_vel");
    wire.set_id(InterestId(wire));
    return wire;
  }
  void Write(const std::string& bytes) {
    std::ofstream(path(), std::ios::binary | std::ios::trunc) << bytes;
  }

  const std::filesystem::path dir_;
};

TEST_F(InterestFileTest, WhatIsKeptIsFoundAgain) {
  ASSERT_THAT(SaveInterest(path(), Wire()), IsOk());
  const auto interest = LoadInterest(path());
  ASSERT_THAT(interest, IsOk());
  EXPECT_EQ((*interest)->id(), Wire().id());
  EXPECT_EQ((*interest)->Of("/a", "t"), (Wanted{.messages = true, .payload_bytes = 10}));
  EXPECT_EQ((*interest)->Of("/b", "t"), Wanted{.messages = true}) << "no payload is asked for";
  EXPECT_EQ((*interest)->Of("/c", "t"), Wanted{});
  EXPECT_EQ((*interest)->Of("/d", "t"), Wanted{});
  EXPECT_TRUE((*interest)->Names("/b"));
  EXPECT_EQ(*(*interest)->kept_topics(), ros2::TopicNames{"/cmd_vel"});
  EXPECT_FALSE((*interest)->Names("/c"));
}

TEST_F(InterestFileTest, NoFileIsNoInterest) {
  EXPECT_THAT(LoadInterest(path()), StatusIs(absl::StatusCode::kNotFound));
}

TEST_F(InterestFileTest, EveryCutAndEveryFlippedBitIsNoticed) {
  const std::string whole = Wire().SerializeAsString();
  for (size_t size = 0; size < whole.size(); ++size) {
    Write(whole.substr(0, size));
    EXPECT_FALSE(LoadInterest(path()).ok()) << "cut to " << size;
  }
  for (size_t bit = 0; bit < 8 * whole.size(); ++bit) {
    std::string flipped = whole;
    flipped[bit / 8] = static_cast<char>(flipped[bit / 8] ^ (1 << bit % 8));
    Write(flipped);
    EXPECT_FALSE(LoadInterest(path()).ok()) << "bit " << bit;
  }
  Write(absl::StrCat(whole, "more"));
  EXPECT_FALSE(LoadInterest(path()).ok());
}

TEST_F(InterestFileTest, LargeFilesAndOtherThingsAreRefused) {
  Write(std::string(kInterestFileBytesMax + 1, 'x'));
  EXPECT_THAT(LoadInterest(path()), StatusIs(absl::StatusCode::kResourceExhausted));
  std::filesystem::remove(path());
  std::filesystem::create_directory(path());
  EXPECT_THAT(LoadInterest(path()), StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_FALSE(SaveInterest(path(), Wire()).ok());
  EXPECT_FALSE(SaveInterest((dir_ / "missing" / "interest").string(), Wire()).ok());
}

TEST_F(InterestFileTest, AnInterestThatMakesNoSenseIsRefusedFromDiskAsFromTheWire) {
  rips::v1::Interest bad = Wire();
  bad.mutable_rules(1)->set_topic_regex("(");
  bad.set_id(InterestId(bad));
  ASSERT_THAT(SaveInterest(path(), bad), IsOk());
  EXPECT_THAT(LoadInterest(path()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("rule 2")));
  bad = Wire();
  bad.mutable_rules(2)->set_depth(rips::v1::InterestRule::DEPTH_UNSPECIFIED);
  EXPECT_THAT(InterestFromWire(bad), StatusIs(absl::StatusCode::kInvalidArgument,
                                              HasSubstr("rule 3: depth 0 is not known")));
}

}  // namespace
}  // namespace rips::sensor

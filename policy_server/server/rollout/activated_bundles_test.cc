#include "policy_server/server/rollout/activated_bundles.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include "policy_server/server/store/fake_store.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/status_matchers.h"

namespace rips::rollout {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::UnorderedElementsAre;

constexpr char kA[] = "sha256:aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa";
constexpr char kB[] = "sha256:bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb";

ActivatedBundles Some() {
  ActivatedBundles some;
  some.robots["r1"] = {.bundle_id = kA,
                       .name = "warehouse",
                       .operator_name = "alice",
                       .reason = "a \"quoted\" reason, \xC3\xA4",
                       .time_unix_ns = 1'700'000'000'000'000'001,
                       .before = ""};
  some.robots["r2"] = {.name = "warehouse", .operator_name = "bob", .before = kB};
  some.robots["r3"] = {.bundle_id = kB, .name = "dock"};
  some.shadows["r1"] = {.bundle_id = kB, .operator_name = "carol", .reason = "to see"};
  RolloutRecord& record = some.rollout.emplace();
  record.plan = {.id = "0f",
                 .bundle_id = kA,
                 .from_directory = true,
                 .name = "warehouse",
                 .operator_name = "alice",
                 .reason = "new rules",
                 .stages = {{"r1"}, {"r2", "r3"}},
                 .soak_ns = 7,
                 .alerts_per_minute_max = 3,
                 .roll_back_when_stopped = true};
  record.state = RolloutState::kStopped;
  record.why = "r1: it does not answer";
  record.rolled_back = "r1 by bob: x";
  record.stage = 1;
  record.began_unix_ns = 5;
  record.ended_unix_ns = 6;
  record.before["r1"] = {.degraded = {"x", "y"}, .level = "ALERT", .bundle_id = kB};
  record.before["r2"] = {};
  return some;
}

class ActivatedBundlesTest : public ::testing::Test {
 protected:
  std::string Content() const {
    std::ifstream file(path_);
    std::stringstream text;
    text << file.rdbuf();
    return text.str();
  }
  void Write(const std::string& text) const { std::ofstream(path_) << text; }

  store::TempDir dir_;
  const std::string path_ = dir_.File("activated.json");
};

TEST_F(ActivatedBundlesTest, ComesBackAsItWasWritten) {
  const auto text = FormatActivatedBundles(Some());
  ASSERT_THAT(text, IsOk());
  const auto read = ParseActivatedBundles(*text);
  ASSERT_THAT(read, IsOk());
  EXPECT_EQ(*read, Some());
  EXPECT_THAT(Some().bundles(), UnorderedElementsAre(kA, kB));
}

TEST_F(ActivatedBundlesTest, NoFileIsNothingActivated) {
  store::FakeStore store;
  const Activations activations(path_, &store);
  EXPECT_THAT(activations.problem(), IsOk());
  EXPECT_EQ(activations.now(), ActivatedBundles());
}

TEST_F(ActivatedBundlesTest, AFileCutAtAnyByteIsDamagedOrWhole) {
  const std::string whole = *FormatActivatedBundles(Some());
  for (size_t bytes = 0; bytes < whole.size(); ++bytes) {
    const auto read = ParseActivatedBundles(whole.substr(0, bytes));
    if (read.ok()) {
      EXPECT_EQ(*read, Some()) << bytes;
    } else {
      EXPECT_TRUE(absl::IsDataLoss(read.status())) << read.status();
    }
  }
}

TEST_F(ActivatedBundlesTest, RefusesARollOutThatCannotBe) {
  for (const char* text :
       {R"({"rollout": {"state": "flying", "stages": [{"robots": ["r1"]}]}})",
        R"({"rollout": {"state": "running"}})",
        R"({"rollout": {"state": "running", "stage": 1, "stages": [{"robots": ["r1"]}]}})",
        R"({"robots": []})", R"([])", "no JSON"}) {
    EXPECT_THAT(ParseActivatedBundles(text), StatusIs(absl::StatusCode::kDataLoss)) << text;
  }
}

TEST_F(ActivatedBundlesTest, WhatALaterVersionAddsIsNoDamage) {
  const auto read = ParseActivatedBundles(
      R"({"robots": {"r1": {"bundleId": "sha256:x", "name": "w", "mood": 3}}, "later": [1]})");
  ASSERT_THAT(read, IsOk());
  EXPECT_EQ(read->robots.at("r1").bundle_id, "sha256:x");
}

TEST_F(ActivatedBundlesTest, CountsWhileTheInventoryHasThePolicyOfThatName) {
  store::FakeStore store;
  Activations activations(path_, &store);
  EXPECT_THAT(activations.problem(), IsOk());
  ASSERT_THAT(activations.Set(Some()), IsOk());
  EXPECT_EQ(activations.For({.id = "r1", .bundle = "warehouse"}), kA);
  EXPECT_EQ(activations.For({.id = "r1", .bundle = "dock"}), "");
  EXPECT_EQ(activations.For({.id = "r2", .bundle = "warehouse"}), "");
  EXPECT_EQ(activations.For({.id = "r9", .bundle = "warehouse"}), "");
}

TEST_F(ActivatedBundlesTest, WhatCannotBeWrittenDoesNotCount) {
  store::FakeStore store;
  Activations activations(dir_.File("missing/activated.json"), &store);
  EXPECT_FALSE(activations.Set(Some()).ok());
  EXPECT_EQ(activations.For({.id = "r1", .bundle = "warehouse"}), "");
}

TEST_F(ActivatedBundlesTest, AfterDamageEachRobotKeepsWhatJudgedItLast) {
  store::FakeStore store;
  const auto acquired = store.Acquire("r1");
  ASSERT_THAT(acquired, IsOk());
  ASSERT_THAT(
      store.Commit({.robot = "r1", .tenure = acquired->tenure, .checkpoint = {.bundle = kB}}),
      IsOk());
  Write("{ half");
  Activations activations(path_, &store);
  EXPECT_THAT(activations.problem(), StatusIs(absl::StatusCode::kDataLoss));
  EXPECT_TRUE(std::filesystem::exists(path_ + ".damaged"));
  EXPECT_TRUE(std::filesystem::exists(path_)) << "a full disk may keep another from being written";
  EXPECT_EQ(activations.For({.id = "r1", .bundle = "warehouse"}), kB);
  EXPECT_EQ(activations.For({.id = "r2", .bundle = "warehouse"}), "");
  // What an operator activates then takes nothing from r1.
  ActivatedBundles next = activations.now();
  next.robots["r2"] = {.bundle_id = kA, .name = "warehouse"};
  ASSERT_THAT(activations.Set(next), IsOk());
  Activations restarted(path_, &store);
  EXPECT_THAT(restarted.problem(), IsOk());
  EXPECT_EQ(restarted.For({.id = "r1", .bundle = "warehouse"}), kB);
  EXPECT_EQ(restarted.For({.id = "r2", .bundle = "warehouse"}), kA);
}

TEST_F(ActivatedBundlesTest, AFileThatIsGoneOrOlderIsNotTakenForWhatWasActivated) {
  store::FakeStore store;
  const auto acquired = store.Acquire("r1");
  ASSERT_THAT(
      store.Commit({.robot = "r1", .tenure = acquired->tenure, .checkpoint = {.bundle = kB}}),
      IsOk());
  Activations activations(path_, &store);
  ActivatedBundles first;
  first.robots["r1"] = {.bundle_id = kA, .name = "warehouse"};
  ASSERT_THAT(activations.Set(first), IsOk());
  const std::string old = Content();
  ASSERT_THAT(activations.Set(Some()), IsOk());
  ActivatedBundles third = Some();
  third.shadows.clear();
  ASSERT_THAT(activations.Set(third), IsOk());
  EXPECT_THAT(Activations(path_, &store).problem(), IsOk());
  for (const char* how : {"older", "empty", "gone"}) {
    if (std::string(how) == "older") Write(old);
    if (std::string(how) == "empty") Write("{}");
    if (std::string(how) == "gone") std::filesystem::remove(path_);
    Activations restarted(path_, &store);
    EXPECT_THAT(restarted.problem(), StatusIs(absl::StatusCode::kDataLoss)) << how;
    EXPECT_EQ(restarted.For({.id = "r1", .bundle = "warehouse"}), kB) << how;
    EXPECT_FALSE(restarted.now().rollout.has_value());
  }
}

TEST_F(ActivatedBundlesTest, ACrashBetweenStoreAndFileIsNoDamage) {
  store::FakeStore store;
  Activations activations(path_, &store);
  ASSERT_THAT(activations.Set(Some()), IsOk());
  const std::string before = Content();
  ActivatedBundles next = Some();
  next.robots.erase("r1");
  ASSERT_THAT(activations.Set(next), IsOk());
  Write(before);  // the store had been told, the file not been written
  Activations restarted(path_, &store);
  EXPECT_THAT(restarted.problem(), IsOk());
  EXPECT_EQ(restarted.now(), Some());
}

TEST_F(ActivatedBundlesTest, AFileThatIsTooLargeIsNotTakenForNothingActivated) {
  std::ofstream(path_) << "{";
  std::filesystem::resize_file(path_, (uint64_t{64} << 20) + 1);
  store::FakeStore store;
  EXPECT_THAT(Activations(path_, &store).problem(), StatusIs(absl::StatusCode::kResourceExhausted));
}

TEST_F(ActivatedBundlesTest, WhatCouldNotBeReadAgainIsNotWritten) {
  store::FakeStore store;
  Activations activations(path_, &store);
  ASSERT_THAT(activations.Set(Some()), IsOk());
  ActivatedBundles huge = Some();
  huge.robots["r1"].reason = std::string(size_t{65} << 20, 'x');
  EXPECT_THAT(activations.Set(huge),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("exceeds limit")));
  EXPECT_EQ(activations.now(), Some());
  EXPECT_EQ(Activations(path_, &store).now(), Some());
}

TEST_F(ActivatedBundlesTest, AStoreThatFailsAndNoFileIsNotNothingActivated) {
  store::FakeStore store;
  store.FailReads(absl::UnavailableError("disk"));
  EXPECT_THAT(Activations(path_, &store).problem(), StatusIs(absl::StatusCode::kUnavailable));
}

}  // namespace
}  // namespace rips::rollout

#include "policy_server/server/shard/store_watch.h"

#include <atomic>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "policy_server/server/robot/fake_ports.h"
#include "policy_server/server/robot/model/robot_config.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"
#include "services/runtime/bounded_queue.h"

namespace rips::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr absl::Duration kLong = absl::Seconds(60);

class QuietObserver final : public RobotObserver {
 public:
  void OnAlert(const store::AlertRecord&) override { ++alerts; }
  void OnNotice(const std::string& text) override { notices.push_back(text); }
  void OnStatus(const RobotStatus&) override {}
  void OnRuleLog(const std::string&, const std::string&, const std::string&) override {}
  std::atomic<int> alerts = 0;
  std::vector<std::string> notices;
};

class StoreWatchTest : public ::testing::Test {
 protected:
  void SetUp() override { ASSERT_THAT(store_.Acquire("r1"), IsOk()); }
  void TearDown() override {
    disk_.Close();
    committer_.Stop();
  }
  // A robot's checkpoint; returns what became of it.
  absl::Status Write() {
    BoundedQueue<absl::Status> done{{.capacity = 1}};
    store::WriteBatch batch{.robot = "r1", .tenure = 1, .checkpoint = {.rules_halted = false}};
    const absl::Status taken =
        committer_.Submit(std::move(batch), [&](const absl::Status& status) { done.Push(status); });
    if (!taken.ok()) return taken;
    return *done.Pop(kLong);
  }
  std::vector<std::string> Texts() {
    std::vector<std::string> texts;
    const auto page = store_.AlertsAfter("", 0, 0);
    for (const store::AlertRecord& alert : page->alerts) {
      texts.push_back(absl::StrCat(alert.robot, " ", alert.severity, " ", alert.text));
    }
    return texts;
  }

  FakeClock clock_;
  store::FakeStore store_;
  store::Committer committer_{&store_, {}, &clock_};
  QuietObserver audience_;
  std::atomic<int> ids_ = 0;
  ServerAlerts alerts_{&committer_, &audience_, &clock_,
                       [this] { return absl::StrFormat("%032x", ++ids_); }};
  std::vector<bool> healthy_;
  uint64_t failures_ = 0;
  StoreWatch watch_{&committer_,
                    &alerts_,
                    &clock_,
                    "/var/state.db",
                    {.healthy = [this](bool ok) { healthy_.push_back(ok); },
                     .failures = [this](uint64_t by) { failures_ += by; }},
                    absl::InfiniteDuration()};
  BoundedQueue<int> disk_{{.capacity = 1}};
};

TEST_F(StoreWatchTest, AnOutageIsOneAlertWrittenFirstAndOneWhenItIsOver) {
  EXPECT_THAT(healthy_, ElementsAre(true));
  store_.FailWrites(absl::UnavailableError("disk on fire"));
  for (int i = 0; i < 5; ++i) {
    EXPECT_FALSE(Write().ok());
    watch_.Look();
    clock_.Advance(kNanosPerSecond);
  }
  EXPECT_THAT(healthy_, ElementsAre(true, false));
  EXPECT_GE(failures_, 5u);
  EXPECT_EQ(audience_.alerts, 0) << "an alert is durable before it is told";
  EXPECT_THAT(audience_.notices, ElementsAre(HasSubstr("disk on fire"))) << "the outage is not";

  store_.FailWrites(absl::OkStatus());
  EXPECT_THAT(Write(), IsOk());
  ASSERT_EQ(Texts().size(), 1u);
  EXPECT_THAT(Texts()[0], AllOf(HasSubstr("(server) critical the store /var/state.db cannot be"),
                                HasSubstr("disk on fire")));
  watch_.Look();
  EXPECT_THAT(healthy_, ElementsAre(true, false, true));
  clock_.Advance(StoreWatch::kCalmNs + kNanosPerSecond);
  watch_.Look();
  EXPECT_THAT(Write(), IsOk());
  ASSERT_EQ(Texts().size(), 2u);
  EXPECT_THAT(Texts()[1], HasSubstr("(server) info store is writable again after"));
  EXPECT_EQ(audience_.alerts, 2);
}

TEST_F(StoreWatchTest, AnOutageIsLoggedOnceWhenItBeginsAndOnceWhenItIsOver) {
  ::testing::internal::CaptureStderr();
  store_.FailWrites(absl::UnavailableError("disk on fire"));
  for (int i = 0; i < 3; ++i) {
    EXPECT_FALSE(Write().ok());
    watch_.Look();
    clock_.Advance(kNanosPerSecond);
  }
  store_.FailWrites(absl::OkStatus());
  EXPECT_THAT(Write(), IsOk());
  clock_.Advance(StoreWatch::kCalmNs);
  watch_.Look();
  watch_.Look();
  const std::string log = ::testing::internal::GetCapturedStderr();

  const std::vector<std::string> lines = absl::StrSplit(log, '\n', absl::SkipEmpty());
  EXPECT_THAT(lines, ElementsAre(HasSubstr(" error cannot write the store store=/var/state.db "
                                           "reason=\"disk on fire\""),
                                 HasSubstr(" info store is writable again store=/var/state.db ")))
      << log;
}

// A viewer's certificate is enough to make the server say things.
TEST_F(StoreWatchTest, WhatTheServerSaysOfItselfIsFoldedByKindAndCut) {
  const auto flood = [&] {
    alerts_.Raise("(server)", engine::Severity::kHigh, std::string(1 << 20, 'x'));
  };
  for (int i = 0; i < 1'000; ++i) flood();
  alerts_.Raise("(server)", engine::Severity::kCritical, "another place, another kind");
  EXPECT_THAT(Write(), IsOk());
  const std::vector<std::string> told = Texts();
  ASSERT_EQ(told.size(), 21u);
  EXPECT_LE(told[0].size(), kOwnAlertBytesMax + 20);
  EXPECT_THAT(told[20], HasSubstr("another kind"));
  clock_.Advance(61 * kNanosPerSecond);
  flood();
  EXPECT_THAT(Write(), IsOk());
  ASSERT_EQ(Texts().size(), 23u);
  EXPECT_THAT(Texts()[21], HasSubstr("980 more alerts of this kind within a minute"));
}

TEST_F(StoreWatchTest, WhatIsSaidOfOneRobotFoldsNothingOfAnother) {
  const auto raise = [&](const std::string& robot) {
    alerts_.Raise(robot, engine::Severity::kHigh, "the same place, the same kind");
  };
  for (int i = 0; i < 1'000; ++i) raise("r1");
  EXPECT_THAT(Write(), IsOk());
  ASSERT_LT(Texts().size(), 100u);
  raise("r2");
  EXPECT_THAT(Write(), IsOk());
  EXPECT_THAT(Texts().back(), HasSubstr("r2 high the same place"));
}

TEST_F(StoreWatchTest, AFailureBetweenTwoLooksIsNotOverlooked) {
  store_.FailWrites(absl::UnavailableError("disk on fire"));
  EXPECT_FALSE(Write().ok());
  store_.FailWrites(absl::OkStatus());
  EXPECT_THAT(Write(), IsOk());
  watch_.Look();
  EXPECT_THAT(Write(), IsOk());
  ASSERT_EQ(Texts().size(), 1u);
  EXPECT_THAT(Texts()[0], HasSubstr("can be written again by now"));
}

TEST_F(StoreWatchTest, ADiskThatHangsIsAnOutage) {
  BoundedQueue<int> arrived{{.capacity = 10}};
  store_.OnCommit([&] {
    arrived.Push(1);
    disk_.Pop(kLong);
  });
  ASSERT_THAT(committer_.Submit({}, [](const absl::Status&) {}), IsOk());
  ASSERT_TRUE(arrived.Pop(kLong).has_value());
  watch_.Look();
  EXPECT_THAT(healthy_, ElementsAre(true));
  clock_.Advance(6 * kNanosPerSecond);
  watch_.Look();
  EXPECT_THAT(healthy_, ElementsAre(true, false));
  disk_.Close();
  EXPECT_THAT(Write(), IsOk());
  committer_.Stop();
  ASSERT_EQ(Texts().size(), 1u);
  EXPECT_THAT(Texts()[0], HasSubstr("has not ended for more than 5 s"));
}

}  // namespace
}  // namespace rips::pipeline

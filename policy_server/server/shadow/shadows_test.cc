#include "policy_server/server/shadow/shadows.h"

#include <atomic>
#include <map>
#include <string>

#include "policy_server/server/shadow/shadow_test_data.h"
#include "services/runtime/bounded_queue.h"

namespace rips::shadow {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Key;
using ::testing::SizeIs;

constexpr char kAlertAll[] = "rules Msg: all: true ? alert(Topic);";

class ShadowsTest : public ::testing::Test {
 protected:
  absl::Status Begin(const std::string& robot, ShadowPolicy policy) {
    return shadows_.Begin(
        robot, {.policy = std::move(policy), .operator_name = "alice", .reason = "to see"},
        [&](std::shared_ptr<pipeline::ShadowRecorder> tap, auto also) {
          EXPECT_NE(also, nullptr);
          tap->OnBegin(StateOf(graph_));
          taps_[robot] = std::move(tap);
          return absl::OkStatus();
        });
  }
  bool Message(const std::string& robot, const std::string& topic = "/a",
               const std::string& payload = "") {
    return taps_[robot]->OnEvent(MessageOn(topic, graph_, 1, payload));
  }
  ShadowReport Report(const std::string& robot) const {
    return shadows_.Report(robot, /*with_examples=*/true).value_or(ShadowReport());
  }
  bool Judged(const std::string& robot, uint64_t events) const {
    return Eventually([&] { return Report(robot).events >= events; });
  }
  // Whose inspections wait until Allow.
  ShadowPolicy Waiting() {
    ShadowPolicy policy =
        PolicyFrom("rules Msg: bad: topicin(\"/a\") && payload(\"a.yar\") ? alert(\"x\");");
    policy.inspections = std::make_shared<FakeInspections>([this](const inspect::Message&) {
      ++asked_;
      allowed_.Pop(absl::Seconds(60));
      return engine::Verdict::kNo;
    });
    return policy;
  }
  void Allow(int inspections) {
    for (int i = 0; i < inspections; ++i) allowed_.Push(0);
  }

  const std::shared_ptr<const ros2::RosGraph> graph_ = GraphOf({"/camera"});
  std::atomic<int> asked_ = 0;
  BoundedQueue<int> allowed_{{.capacity = 100'000}};
  std::map<std::string, std::shared_ptr<pipeline::ShadowRecorder>> taps_;
  Shadows shadows_;
};

TEST_F(ShadowsTest, ReportsWhatAShadowWouldHaveDoneAndWhatTheRobotDid) {
  ASSERT_THAT(Begin("r1", PolicyFrom(kAlertAll)), IsOk());
  EXPECT_TRUE(Message("r1"));
  taps_["r1"]->OnOutcome({.counts = {.alerts = 1, .raises = 1}, .level = "ALERT"});
  EXPECT_TRUE(Message("r1", "/b"));
  ASSERT_TRUE(Judged("r1", 2));
  const ShadowReport report = Report("r1");
  EXPECT_EQ(report.name, "candidate");
  EXPECT_EQ(report.operator_name, "alice");
  EXPECT_EQ(report.reason, "to see");
  EXPECT_GT(report.began_unix_ns, 0);
  EXPECT_EQ(report.would, (ShadowCounts{.alerts = 2}));
  EXPECT_EQ(report.live, (ShadowCounts{.alerts = 1, .raises = 1}));
  EXPECT_EQ(report.level, "DEFAULT");
  EXPECT_EQ(report.live_level, "ALERT");
  EXPECT_EQ(report.missed, 0u);
  EXPECT_THAT(report.examples, SizeIs(2));
  EXPECT_THAT(shadows_.Reports(), ElementsAre(Key("r1")));
  EXPECT_THAT(shadows_.Reports()["r1"].examples, IsEmpty());
  EXPECT_EQ(shadows_.Report("r2", true), std::nullopt);
}

TEST_F(ShadowsTest, OneForEachRobotAndSoManyAtMost) {
  for (size_t i = 0; i < Shadows::kRobotsMax; ++i) {
    ASSERT_THAT(Begin(absl::StrCat("r", i), PolicyFrom(kAlertAll)), IsOk());
  }
  EXPECT_THAT(Begin("r0", PolicyFrom(kAlertAll)), StatusIs(absl::StatusCode::kAlreadyExists));
  EXPECT_THAT(Begin("more", PolicyFrom(kAlertAll)), StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_TRUE(shadows_.End("r0"));
  EXPECT_FALSE(shadows_.End("r0"));
  EXPECT_FALSE(Message("r0")) << "the robot learns of it with the next event";
  EXPECT_THAT(Begin("more", PolicyFrom(kAlertAll)), IsOk());
  EXPECT_THAT(shadows_.Reports(), SizeIs(Shadows::kRobotsMax));
}

TEST_F(ShadowsTest, ARobotThatCannotBeTappedHasNone) {
  EXPECT_THAT(shadows_.Begin("r1", {.policy = PolicyFrom(kAlertAll)},
                             [](auto, auto) { return absl::NotFoundError("no such robot"); }),
              StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(shadows_.Reports(), IsEmpty());
  EXPECT_THAT(Begin("r1", PolicyFrom(kAlertAll)), IsOk());
}

TEST_F(ShadowsTest, ACrashStopsItAndAnotherMayTakeItsPlace) {
  ASSERT_THAT(Begin("r1", PolicyFrom("rules Msg: boom: true ? crash(\"no\");")), IsOk());
  Message("r1");
  ASSERT_TRUE(Eventually([&] { return !Report("r1").problem.empty(); }));
  EXPECT_THAT(Report("r1").problem, HasSubstr("crash"));
  EXPECT_EQ(Report("r1").events, 1u);
  EXPECT_TRUE(Eventually([&] { return !Message("r1"); }));
  EXPECT_THAT(Begin("r1", PolicyFrom(kAlertAll)), IsOk());
  EXPECT_EQ(Report("r1").problem, "");
  Message("r1");
  EXPECT_TRUE(Judged("r1", 1));
}

TEST_F(ShadowsTest, ACrashBeforeWhatWaitsLeavesNothingOfItInMemory) {
  ShadowPolicy policy = PolicyFrom("rules Msg: boom: payload(\"a.yar\") ? crash(\"no\");");
  policy.inspections = std::make_shared<FakeInspections>([this](const inspect::Message&) {
    const bool second = ++asked_ == 2;
    allowed_.Pop(absl::Seconds(60));
    return second ? engine::Verdict::kYes : engine::Verdict::kNo;
  });
  ASSERT_THAT(Begin("r1", std::move(policy)), IsOk());
  Message("r1", "/a", "x");
  ASSERT_TRUE(Eventually([&] { return asked_ == 1; }));
  Message("r1", "/a", "y");
  for (int i = 0; i < 100; ++i) taps_["r1"]->OnEvent(TickAt(graph_));
  Allow(1);
  ASSERT_TRUE(Eventually([&] { return asked_ == 2; }));
  absl::SleepFor(absl::Milliseconds(20));  // longer than a turn, which ends with the crash
  Allow(1);
  ASSERT_TRUE(Eventually([&] { return !Report("r1").problem.empty(); }));
  const auto* tap = static_cast<const ShadowTap*>(taps_["r1"].get());
  EXPECT_TRUE(Eventually([&] { return tap->bytes() == 0; }));
  EXPECT_EQ(tap->events(), 0u);
}

TEST_F(ShadowsTest, ARobotThatRetiresStopsItWhenAllIsJudged) {
  ASSERT_THAT(Begin("r1", PolicyFrom(kAlertAll)), IsOk());
  for (int i = 0; i < 100; ++i) Message("r1");
  taps_["r1"]->OnRetired();
  ASSERT_TRUE(Eventually([&] { return !Report("r1").problem.empty(); }));
  EXPECT_THAT(Report("r1").problem, HasSubstr("its robot is no longer judged by this server"));
  EXPECT_EQ(Report("r1").would.alerts, 100u);
}

TEST_F(ShadowsTest, AnInspectionThatHangsMakesItMissEventsAndHoldsNoRobotUp) {
  ASSERT_THAT(Begin("r1", Waiting()), IsOk());
  Message("r1", "/a", "x");
  ASSERT_TRUE(Eventually([&] { return asked_ == 1; }));
  constexpr uint64_t kSent = 3 * ShadowTap::kEventsMax;
  // Returns, although the shadow does not go on: else this test would not end.
  for (uint64_t i = 0; i < kSent; ++i) EXPECT_TRUE(taps_["r1"]->OnEvent(TickAt(graph_)));
  EXPECT_EQ(Report("r1").missed, kSent - ShadowTap::kEventsMax);
  EXPECT_EQ(asked_, 1);
  Allow(1);
  EXPECT_TRUE(Judged("r1", 1 + ShadowTap::kEventsMax));
}

TEST_F(ShadowsTest, ItsEndIsNotHeldUpEither) {
  ASSERT_THAT(Begin("r1", Waiting()), IsOk());
  Message("r1", "/a", "x");
  ASSERT_TRUE(Eventually([&] { return asked_ == 1; }));
  EXPECT_TRUE(shadows_.End("r1"));
  EXPECT_EQ(shadows_.Report("r1", true), std::nullopt);
  EXPECT_THAT(Begin("r1", PolicyFrom(kAlertAll)), IsOk());
  Message("r1");
  EXPECT_EQ(Report("r1").events, 0u);
  Allow(1);
  EXPECT_TRUE(Judged("r1", 1));
}

TEST_F(ShadowsTest, ASlowOneTakesItsTurnsAndOthersTakeTheirs) {
  ASSERT_THAT(Begin("slow", Waiting()), IsOk());
  ASSERT_THAT(Begin("quick", PolicyFrom(kAlertAll)), IsOk());
  for (int i = 0; i < 1'000; ++i) Message("slow", "/a", "x");
  ASSERT_TRUE(Eventually([&] { return asked_ == 1; }));
  Message("quick");
  // Each inspection of the slow one takes longer than a turn.
  int allowed = 0;
  const bool judged = Eventually([&] {
    if (asked_ > allowed) Allow(1), ++allowed;
    return Report("quick").events == 1;
  });
  EXPECT_TRUE(judged);
  EXPECT_LT(allowed, 500);
  Allow(1'000);
}

TEST_F(ShadowsTest, StopEndsAllAndNothingBeginsAnyMore) {
  ASSERT_THAT(Begin("r1", PolicyFrom(kAlertAll)), IsOk());
  for (int i = 0; i < 100; ++i) Message("r1");
  shadows_.Stop();
  EXPECT_FALSE(Message("r1"));
  EXPECT_THAT(shadows_.Reports(), IsEmpty());
  EXPECT_FALSE(shadows_.End("r1"));
  EXPECT_THAT(Begin("r2", PolicyFrom(kAlertAll)), StatusIs(absl::StatusCode::kUnavailable));
  shadows_.Stop();
}

}  // namespace
}  // namespace rips::shadow

// Robots on threads: order, limits, and what one peer may post.
#include "policy_server/server/shard/pipeline.h"

#include <atomic>

#include "absl/strings/str_format.h"
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/shard/mailbox.h"
#include "policy_server/server/shard/store_recorder.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

// What several threads may tell at once.
class CountingObserver final : public RobotObserver {
 public:
  void OnAlert(const store::AlertRecord&) override { ++alerts; }
  void OnNotice(const std::string&) override {}
  void OnStatus(const RobotStatus&) override { ++statuses; }
  void OnRuleLog(const std::string&, const std::string&, const std::string&) override {}
  std::atomic<int> alerts = 0;
  std::atomic<int> statuses = 0;
};

TEST(PipelineTest, RunsTasksOnTheRobotsThreadInOrderControlFirst) {
  FakeClock clock;
  store::FakeStore store;
  store::Committer committer(&store);
  StoreRecorder recorder(&store, &committer);
  CountingObserver audience;
  std::atomic<int> ids = 0;
  Pipeline pipeline(2, &clock);
  const std::vector<lang::SourceFile> files = {{.path = "t.rul", .text = kPaperRules}};
  const auto program = *engine::CompiledPolicy::Create(*lang::Compile(files).rules);
  for (const char* id : {"r1", "r2", "r3"}) {
    ASSERT_EQ(store.Acquire(id)->tenure, 1u);
    ASSERT_THAT(pipeline.Add({.id = id}, {.program = program, .bundle_id = "b"}, Timing{}, {}, 1,
                             {.recorder = &recorder,
                              .audience = &audience,
                              .new_id = [&ids] { return absl::StrFormat("%032x", ++ids); }}),
                IsOk());
  }
  // Before Start nothing runs: control overtakes messages that were posted earlier.
  std::vector<int> order;  // touched on r1's thread alone
  const auto note = [&order](int n) { return [&order, n](Robot&) { order.push_back(n); }; };
  ASSERT_THAT(pipeline.Post("r1", Lane::kMessages, note(3)), IsOk());
  ASSERT_THAT(pipeline.Post("r1", Lane::kControl, note(1)), IsOk());
  ASSERT_THAT(pipeline.Post("r1", Lane::kControl, note(2)), IsOk());

  pipeline.Start();
  std::atomic<int> raised = 0;
  pipeline.ForEach([&](Robot& robot) {
    robot.Raise({.operator_name = "alice", .to = "HALT", .reason = "drill"},
                [&raised](const LevelAnswer& answer) { raised += answer.status.ok() ? 1 : 0; });
  });
  // The answers come when the committer's thread has made the decisions durable.
  while (raised < 3) pipeline.ForEach([](Robot&) {});
  ASSERT_THAT(pipeline.Post("r1", Lane::kMessages, note(4)), IsOk());
  std::atomic<bool> last = false;
  while (!last) {
    pipeline.ForEach([&](Robot& robot) {
      if (robot.id() == "r1") last = order.size() == 4;
    });
  }
  pipeline.Stop();
  committer.Stop();

  EXPECT_THAT(order, ::testing::ElementsAre(1, 2, 3, 4));
  EXPECT_EQ(store.ListTransitions("r2", 10)->front().to, "HALT");
  EXPECT_GE(audience.statuses, 3);
}

TEST(PipelineTest, RefusesUnknownRobotsAndTasksPastItsLimit) {
  FakeClock clock;
  FakeRecorder recorder;
  FakeObserver audience;
  Pipeline pipeline(1, &clock, {.control_max = 2, .messages_max = 1});
  const std::vector<lang::SourceFile> files = {{.path = "t.rul", .text = kPaperRules}};
  ASSERT_THAT(
      pipeline.Add({.id = "r1"},
                   {.program = *engine::CompiledPolicy::Create(*lang::Compile(files).rules)},
                   Timing{}, {}, 1,
                   {.recorder = &recorder, .audience = &audience, .new_id = [] { return "id"; }}),
      IsOk());
  const auto nothing = [](Robot&) {};

  EXPECT_THAT(pipeline.Post("r9", Lane::kControl, nothing), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(pipeline.Post("r1", Lane::kMessages, nothing), IsOk());
  EXPECT_THAT(pipeline.Post("r1", Lane::kMessages, nothing),
              StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_THAT(pipeline.Post("r1", Lane::kControl, nothing), IsOk());
}

TEST(MailboxTest, CutsOffOnlyTheFloodingPeer) {
  FakeClock clock;
  FakeRecorder recorder;
  FakeObserver audience;
  Pipeline pipeline(1, &clock, {.control_max = 100, .messages_max = 100});
  const std::vector<lang::SourceFile> files = {{.path = "t.rul", .text = kPaperRules}};
  ASSERT_THAT(
      pipeline.Add({.id = "r1"},
                   {.program = *engine::CompiledPolicy::Create(*lang::Compile(files).rules)},
                   Timing{}, {}, 1,
                   {.recorder = &recorder, .audience = &audience, .new_id = [] { return "id"; }}),
      IsOk());
  const auto nothing = [](Robot&) {};
  Mailbox flooding(&pipeline, "r1", {.tasks = 3, .bytes = 1'000});
  Mailbox large(&pipeline, "r1", {.tasks = 3, .bytes = 1'000});
  Mailbox other(&pipeline, "r1");
  Mailbox unknown(&pipeline, "r9");

  for (int i = 0; i < 3; ++i) ASSERT_THAT(flooding.Post(Lane::kControl, 1, nothing), IsOk());
  EXPECT_THAT(flooding.Post(Lane::kControl, 1, nothing),
              StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_THAT(large.Post(Lane::kMessages, 1'001, nothing),
              StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_THAT(other.Post(Lane::kControl, 1, nothing), IsOk());
  EXPECT_THAT(unknown.Post(Lane::kControl, 1, nothing),
              StatusIs(absl::StatusCode::kPermissionDenied));
}

}  // namespace
}  // namespace rips::pipeline

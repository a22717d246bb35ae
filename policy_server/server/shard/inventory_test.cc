// Robots that come, change and go while the server runs, and robots that do not answer.
#include <atomic>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/shard/mailbox.h"
#include "policy_server/server/shard/pipeline.h"
#include "policy_server/server/shard/store_recorder.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/status_matchers.h"
#include "services/runtime/bounded_queue.h"

namespace rips::pipeline {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr absl::Duration kLong = absl::Seconds(60);

// Holds whoever passes until the test opens it.
class Gate {
 public:
  void Pass() {
    arrived_.Push(1);
    open_.Pop(kLong);
  }
  void WaitForArrival() { ASSERT_TRUE(arrived_.Pop(kLong).has_value()); }
  void Open() { open_.Close(); }

 private:
  BoundedQueue<int> arrived_{{.capacity = 1'000}};
  BoundedQueue<int> open_{{.capacity = 1}};
};

class QuietObserver final : public RobotObserver {
 public:
  void OnAlert(const store::AlertRecord&) override { ++alerts; }
  void OnNotice(const std::string&) override {}
  void OnStatus(const RobotStatus&) override {}
  void OnRuleLog(const std::string&, const std::string&, const std::string&) override {}
  std::atomic<int> alerts = 0;
};

class LiveFleetTest : public ::testing::Test {
 protected:
  void SetUp() override {
    lang::CompileResult compiled = lang::Compile({{.path = "t.rul", .text = kPaperRules}});
    ASSERT_TRUE(compiled.rules);
    program_ = *engine::CompiledPolicy::Create(*std::move(compiled.rules));
    ASSERT_THAT(Add("r1"), IsOk());
    ASSERT_THAT(Add("r2"), IsOk());
    pipeline_.Start();
  }
  void TearDown() override {
    disk_.Open();
    gate_.Open();
    pipeline_.Stop();
    committer_.Stop();
  }
  absl::Status Add(const std::string& id) {
    const auto acquired = store_.Acquire(id);
    if (!acquired.ok()) return acquired.status();
    return Add(id, *acquired);
  }
  absl::Status Add(const std::string& id, const store::Acquired& acquired) {
    return pipeline_.Add(
        {.id = id, .sensor_hosts = {"base"}, .primary_sensor = "base", .actuator_hosts = {"base"}},
        {.program = program_, .bundle_id = "sha256:0"}, Timing{}, acquired.record, acquired.tenure,
        {.recorder = &recorder_, .audience = &audience_, .new_id = [this] {
           return absl::StrFormat("%032x", ++ids_);
         }});
  }
  // Runs on the robot's thread; returns when it has.
  void OnRobot(const std::string& id, std::function<void(Robot&)> task) {
    BoundedQueue<int> done{{.capacity = 1}};
    ASSERT_THAT(pipeline_.Post(id, Lane::kControl,
                               [&](Robot& robot) {
                                 task(robot);
                                 done.Push(1);
                               }),
                IsOk());
    ASSERT_TRUE(done.Pop(kLong).has_value());
  }
  void Raise(const std::string& id, const std::string& level) {
    BoundedQueue<int> done{{.capacity = 1}};
    OnRobot(id, [&](Robot& robot) {
      robot.Raise({.operator_name = "alice", .to = level, .reason = "drill"},
                  [&](const LevelAnswer& answer) { done.Push(answer.status.ok() ? 1 : 0); });
    });
    ASSERT_EQ(done.Pop(kLong), 1);
  }

  FakeClock clock_;
  store::FakeStore store_;
  store::Committer committer_{&store_};
  StoreRecorder recorder_{&store_, &committer_};
  QuietObserver audience_;
  std::atomic<int> ids_ = 0;
  std::shared_ptr<const engine::CompiledPolicy> program_;
  Gate gate_;
  Gate disk_;
  Pipeline pipeline_{2, &clock_};
};

TEST_F(LiveFleetTest, WhoDoesNotAnswerInTimeIsNamedAndTouchesNothingOfTheAsker) {
  ASSERT_THAT(pipeline_.Post("r1", Lane::kControl, [this](Robot&) { gate_.Pass(); }), IsOk());
  gate_.WaitForArrival();

  auto late = std::make_shared<std::atomic<int>>(0);
  Gathered<std::string> gathered;
  {
    // Gone when the late robot answers.
    auto answer = std::make_unique<std::string>("level ");
    do {
      gathered = pipeline_.Gather<std::string>(
          [late, text = *answer](Robot& robot) {
            ++*late;
            return text + robot.Status().decided_level;
          },
          absl::Milliseconds(200));
    } while (gathered.answers.empty());
  }
  EXPECT_THAT(gathered.silent, ElementsAre("r1"));
  ASSERT_EQ(gathered.answers.size(), 1u);
  EXPECT_EQ(gathered.answers.at("r2"), "level DEFAULT");

  const auto kept = std::make_shared<int>(0);
  pipeline_.Gather<std::shared_ptr<int>>([kept](Robot&) { return kept; }, absl::Milliseconds(1));
  const int before = *late;
  gate_.Open();
  OnRobot("r1", [](Robot&) {});
  EXPECT_GT(*late, before) << "it runs later, with what it owns";
  EXPECT_THAT(pipeline_.Gather<int>([](Robot&) { return 1; }).silent, IsEmpty());
  EXPECT_EQ(kept.use_count(), 1) << "the late answer went with the place that it was put into";
}

TEST_F(LiveFleetTest, AStoppingShardIsNotWaitedFor) {
  pipeline_.Stop();
  EXPECT_THAT(pipeline_.ForEach([](Robot&) {}, absl::Hours(1)), ElementsAre("r1", "r2"));
}

TEST_F(LiveFleetTest, ARemovedRobotAnswersWhatWasAskedBeforeAndNothingAfter) {
  auto sensor = std::make_shared<FakeSensor>();
  OnRobot("r1", [&](Robot& robot) {
    robot.OnSensorHello("base", sensor, {.incarnation = "0123456789abcdef"});
  });
  ASSERT_THAT(pipeline_.Post("r1", Lane::kControl, [this](Robot&) { gate_.Pass(); }), IsOk());
  gate_.WaitForArrival();
  std::atomic<int> asked = 0;
  std::atomic<int> judged = 0;
  ASSERT_THAT(pipeline_.Post("r1", Lane::kControl, [&](Robot&) { ++asked; }), IsOk());
  for (int i = 0; i < 100; ++i) {
    ASSERT_THAT(pipeline_.Post("r1", Lane::kMessages, [&](Robot&) { ++judged; }), IsOk());
  }

  ASSERT_THAT(pipeline_.Remove("r1", absl::PermissionDeniedError("r1 was removed")), IsOk());

  EXPECT_THAT(pipeline_.robots(), ElementsAre("r2"));
  EXPECT_THAT(pipeline_.Post("r1", Lane::kControl, [](Robot&) {}),
              StatusIs(absl::StatusCode::kNotFound));
  Mailbox mailbox(&pipeline_, "r1");
  EXPECT_THAT(mailbox.Post(Lane::kControl, 1, [](Robot&) {}),
              StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_THAT(pipeline_.Remove("r1", absl::OkStatus()), StatusIs(absl::StatusCode::kNotFound));
  gate_.Open();
  ASSERT_TRUE(pipeline_.WaitGone("r1", kLong));
  EXPECT_EQ(asked, 1);
  EXPECT_THAT(sensor->closed,
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("was removed")));
  // The other robot of the shards lives on.
  OnRobot("r2", [](Robot&) {});
}

TEST_F(LiveFleetTest, ARemovedRobotStaysUntilItsDecisionsAreDurableAndComesBackAtItsLevel) {
  Raise("r1", "COMPROMISED");
  store_.FailWrites(absl::UnavailableError("disk on fire"));
  OnRobot("r1", [](Robot& robot) {
    robot.Raise({.operator_name = "alice", .to = "HALT", .reason = "drill"},
                [](const LevelAnswer&) {});
  });
  ASSERT_THAT(pipeline_.Remove("r1", absl::PermissionDeniedError("r1 was removed")), IsOk());
  EXPECT_FALSE(pipeline_.WaitGone("r1", absl::Milliseconds(100)));
  EXPECT_EQ(store_.Load("r1")->level, "COMPROMISED") << "not recorded yet";
  store_.FailWrites(absl::OkStatus());
  // Not acquired anew: what it still has to record would be refused.
  EXPECT_THAT(Add("r1", {}), StatusIs(absl::StatusCode::kUnavailable));

  // It is tried again with the checkpoint.
  while (!pipeline_.WaitGone("r1", absl::Milliseconds(10))) clock_.Advance(kNanosPerSecond);
  EXPECT_EQ(store_.Load("r1")->level, "HALT");
  ASSERT_THAT(Add("r1"), IsOk());
  std::string level;
  OnRobot("r1", [&](Robot& robot) { level = robot.Status().decided_level; });
  EXPECT_EQ(level, "HALT");
  EXPECT_THAT(Add("r1", {}), StatusIs(absl::StatusCode::kAlreadyExists));
}

TEST_F(LiveFleetTest, ARecordThatEndsAfterTheRobotTouchesNothingOfIt) {
  store_.OnCommit([this] { disk_.Pass(); });
  auto answered = std::make_shared<BoundedQueue<absl::Status>>(
      BoundedQueue<absl::Status>::Options{.capacity = 1});
  OnRobot("r1", [&](Robot& robot) {
    robot.Raise({.operator_name = "alice", .to = "HALT", .reason = "drill"},
                [answered](const LevelAnswer& answer) { answered->Push(answer.status); });
  });
  disk_.WaitForArrival();
  ASSERT_THAT(pipeline_.Remove("r1", absl::PermissionDeniedError("r1 was removed")), IsOk());
  const auto answer = answered->Pop(kLong);
  ASSERT_TRUE(answer.has_value());
  EXPECT_THAT(*answer, StatusIs(absl::StatusCode::kPermissionDenied));
  disk_.Open();
  ASSERT_TRUE(pipeline_.WaitGone("r1", kLong));
  EXPECT_EQ(store_.Load("r1")->level, "HALT");
}

TEST_F(LiveFleetTest, AHeldRobotIsListedAndRefusedWithWords) {
  const RobotStatus status{.robot = "r3", .decided_level = "HALT", .degraded = {"no policy"}};
  ASSERT_THAT(pipeline_.Hold(status, absl::FailedPreconditionError("no policy")), IsOk());
  EXPECT_THAT(pipeline_.held(), ElementsAre(status));
  EXPECT_THAT(pipeline_.robots(), ElementsAre("r1", "r2"));
  Mailbox mailbox(&pipeline_, "r3");
  EXPECT_THAT(mailbox.Post(Lane::kControl, 1, [](Robot&) {}),
              StatusIs(absl::StatusCode::kFailedPrecondition, "no policy"));
  EXPECT_THAT(pipeline_.Hold({.robot = "r1"}, absl::OkStatus()),
              StatusIs(absl::StatusCode::kAlreadyExists));

  ASSERT_THAT(Add("r3"), IsOk());
  EXPECT_THAT(pipeline_.held(), IsEmpty());
  OnRobot("r3", [](Robot&) {});
}

TEST_F(LiveFleetTest, RobotsComeAndGoUnderTraffic) {
  std::atomic<bool> over = false;
  std::thread traffic([&] {
    while (!over) {
      for (const Lane lane : {Lane::kControl, Lane::kMessages}) {
        pipeline_.Post("r1", lane, [](Robot& robot) { robot.Status(); }).IgnoreError();
      }
      pipeline_.ForEach([](Robot& robot) { robot.Status(); }, absl::Milliseconds(10));
    }
  });
  for (int i = 0; i < 20; ++i) {
    ASSERT_THAT(pipeline_.Remove("r1", absl::PermissionDeniedError("removed")), IsOk());
    while (!pipeline_.WaitGone("r1", absl::Milliseconds(10))) clock_.Advance(kNanosPerSecond);
    ASSERT_THAT(Add("r1"), IsOk());
  }
  over = true;
  traffic.join();
}

// ------------------------------------------------------------------------- hosts of one robot

using RobotInventoryTest = RobotTest;

TEST_F(RobotInventoryTest, AHostThatIsNoLongerListedIsClosedWithWords) {
  Start();
  Arm();
  robot_->SetHosts({.id = "r1", .sensor_hosts = {"laptop"}, .primary_sensor = "laptop"});
  Drain();
  EXPECT_THAT(sensor_->closed, StatusIs(absl::StatusCode::kPermissionDenied,
                                        HasSubstr("no longer lists sensor `base`")));
  EXPECT_THAT(actuator_->closed, StatusIs(absl::StatusCode::kPermissionDenied,
                                          HasSubstr("no longer lists actuator `base`")));
  const auto again = std::make_shared<FakeSensor>();
  robot_->OnSensorHello("base", again, {.incarnation = kIncarnation});
  EXPECT_THAT(again->closed, StatusIs(absl::StatusCode::kPermissionDenied));
  const auto laptop = std::make_shared<FakeSensor>();
  robot_->OnSensorHello("laptop", laptop, {.incarnation = kIncarnation});
  EXPECT_THAT(laptop->closed, IsOk());
  EXPECT_TRUE(laptop->setup.primary);
  EXPECT_TRUE(laptop->setup.want_snapshot);
}

TEST_F(RobotInventoryTest, ALevelIsVerifiedOnlyWhenANewActuatorSaysSoToo) {
  Start();
  Arm();
  ASSERT_EQ(Stage(), "verified");
  robot_->SetHosts({.id = "r1",
                    .sensor_hosts = {"base"},
                    .primary_sensor = "base",
                    .actuator_hosts = {"base", "arm"}});
  Drain();
  EXPECT_THAT(sensor_->closed, IsOk()) << "who has not changed stays";
  EXPECT_THAT(actuator_->closed, IsOk());
  EXPECT_NE(Stage(), "verified");
  EXPECT_THAT(robot_->Status().degraded,
              ::testing::Contains(HasSubstr("actuator arm holds no live lease")));
}

TEST_F(RobotInventoryTest, ASensorThatBecomesPrimaryStartsAnew) {
  Start();
  ConnectSensor();
  robot_->SetHosts({.id = "r1",
                    .sensor_hosts = {"base", "laptop"},
                    .primary_sensor = "laptop",
                    .actuator_hosts = {"base"}});
  EXPECT_THAT(sensor_->closed, StatusIs(absl::StatusCode::kAborted));
  ConnectSensor();
  EXPECT_FALSE(sensor_->setup.primary);
}

}  // namespace
}  // namespace rips::pipeline

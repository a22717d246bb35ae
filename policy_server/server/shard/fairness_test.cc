// Robots that cost much beside one that does not: turns, budgets, slow robots, lateness; and control
// batches that are judged in turns.
#include <atomic>
#include <string>
#include <thread>
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

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;

constexpr int64_t kFairMs = kNanosPerMilli;
constexpr absl::Duration kFairPatience = absl::Seconds(60);

// When its leases were sent.
struct TimedActuator final : ActuatorLink {
  explicit TimedActuator(const Clock* clock) : clock_(clock) {}
  void Grant(const LeaseGrant& lease) override {
    sent_ns.push_back(clock_->Now().boottime_ns);
    evidence_complete.push_back(lease.evidence_complete);
  }
  void Send(const Command&) override {}
  void Close(const absl::Status& status) override { closed = status; }
  std::vector<int64_t> sent_ns;
  std::vector<bool> evidence_complete;
  absl::Status closed;

 private:
  const Clock* clock_;
};

class SilentObserver final : public RobotObserver {
 public:
  void OnAlert(const store::AlertRecord&) override {}
  void OnNotice(const std::string&) override {}
  void OnStatus(const RobotStatus&) override {}
  void OnRuleLog(const std::string&, const std::string&, const std::string&) override {}
};

// Robots r1 and r2 on one thread. Time passes where a test says so, and where tasks work.
class FairnessTest : public ::testing::Test {
 protected:
  using Names = BoundedQueue<std::string>;

  void Open(PipelineLimits limits) {
    lang::CompileResult compiled = lang::Compile({{.path = "t.rul", .text = kPaperRules}});
    ASSERT_TRUE(compiled.rules);
    program_ = *engine::CompiledPolicy::Create(*std::move(compiled.rules));
    pipeline_ = std::make_unique<Pipeline>(
        1, &clock_, limits,
        PipelineReports{.late = [this](const std::string& robot, int64_t) { late_.Push(robot); },
                        .deferred = [this](const std::string& robot) { deferred_.Push(robot); },
                        .moved =
                            [this](const std::string& robot, bool slow) {
                              moved_.Push(absl::StrCat(robot, slow ? " slow" : " back"));
                            },
                        .refused = [this](const std::string& robot) { refused_.Push(robot); },
                        .advanced = [this] { ++advanced_; }},
        [this] { return cpu_ns_.load(); });
    for (const char* id : {"r1", "r2"}) AddRobot(id);
  }
  void AddRobot(const std::string& id) {
    ASSERT_EQ(store_.Acquire(id)->tenure, 1u);
    ASSERT_THAT(pipeline_->Add({.id = id,
                                .sensor_hosts = {"base"},
                                .primary_sensor = "base",
                                .actuator_hosts = {"base"}},
                               {.program = program_, .bundle_id = "b"},
                               Timing{.lost_ns = 10'000 * kNanosPerSecond}, {}, 1,
                               {.recorder = &recorder_,
                                .audience = &audience_,
                                .new_id = [this] { return absl::StrFormat("%032x", ++ids_); }}),
                IsOk());
  }
  void TearDown() override {
    gate_.Close();
    if (pipeline_ != nullptr) pipeline_->Stop();
    committer_.Stop();
  }
  // No robot is deferred or moved.
  static PipelineLimits TurnsOnly() {
    return {.cpu_burst_ns = 1'000'000 * kNanosPerSecond,
            .long_task_ns = 1'000'000 * kNanosPerSecond};
  }
  void Post(const std::string& robot, Queue queue, std::function<void(Robot&)> task) {
    ASSERT_THAT(pipeline_->Post(robot, queue, std::move(task)), IsOk());
  }
  // Of a task: takes the processor for `ms`.
  void Work(int64_t ms) {
    cpu_ns_ += ms * kFairMs;
    clock_.Advance(ms * kFairMs);
  }
  // Tasks of r2, each of which works for `ms`.
  void Flood(int count, int64_t ms, Queue queue = Queue::kControl) {
    for (int i = 0; i < count; ++i) {
      Post("r2", queue, [this, ms](Robot&) {
        Work(ms);
        ++flooded_;
      });
    }
  }
  // Runs on the robot's thread, as an order; returns when it has.
  void OnRobot(const std::string& robot, std::function<void(Robot&)> task) {
    BoundedQueue<int> done{{.capacity = 1}};
    Post(robot, Queue::kOrders, [&](Robot& each) {
      task(each);
      done.Push(1);
    });
    ASSERT_TRUE(done.Pop(kFairPatience).has_value());
  }

  FakeClock clock_;
  std::atomic<int64_t> cpu_ns_ = 0;
  store::FakeStore store_;
  store::Committer committer_{&store_};
  StoreRecorder recorder_{&store_, &committer_};
  SilentObserver audience_;
  std::atomic<int> ids_ = 0;
  std::shared_ptr<const engine::CompiledPolicy> program_;
  std::atomic<int> flooded_ = 0;
  Names late_{{.capacity = 1'000}};
  Names deferred_{{.capacity = 1'000}};
  Names moved_{{.capacity = 1'000}};
  Names refused_{{.capacity = 1'000}};
  std::atomic<int> advanced_ = 0;
  // Held by the test until closed.
  BoundedQueue<int> arrived_{{.capacity = 1}};
  BoundedQueue<int> gate_{{.capacity = 1}};
  std::unique_ptr<Pipeline> pipeline_;
};

TEST_F(FairnessTest, AQuietRobotWaitsForOneTurnOfAFloodingOne) {
  Open(TurnsOnly());
  Flood(1'000, 1);
  int before = -1;
  Post("r1", Queue::kMessages, [&](Robot&) { before = flooded_; });
  pipeline_->Start();
  while (flooded_ < 1'000) OnRobot("r2", [](Robot&) {});
  OnRobot("r1", [](Robot&) {});
  EXPECT_LE(before, 2) << "messages of one robot wait for no control of another";
}

TEST_F(FairnessTest, LeasesOfAllRobotsGoOutBetweenAnyTwoTasks) {
  Open(TurnsOnly());
  auto actuator = std::make_shared<TimedActuator>(&clock_);
  Post("r1", Queue::kActuators, [&](Robot& robot) {
    robot.OnActuatorHello(
        "base", actuator,
        {.levels = {"DEFAULT", "ALERT", "COMPROMISED", "HALT"}, .effective_level = "DEFAULT"});
  });
  Flood(1'000, 80);
  pipeline_->Start();
  while (flooded_ < 1'000) OnRobot("r2", [](Robot&) {});
  pipeline_->Stop();

  ASSERT_THAT(actuator->sent_ns, SizeIs(::testing::Gt(100u)));
  int64_t longest_ns = 0;
  for (size_t i = 1; i < actuator->sent_ns.size(); ++i) {
    longest_ns = std::max(longest_ns, actuator->sent_ns[i] - actuator->sent_ns[i - 1]);
  }
  EXPECT_LE(longest_ns, (500 + 2 * 80 + 50) * kFairMs) << "a heartbeat, and what is under way";
}

TEST_F(FairnessTest, LeasesOfManyRobotsGoOutInTime) {
  constexpr int kRobots = 200;
  Open(TurnsOnly());
  std::vector<std::shared_ptr<TimedActuator>> actuators;
  for (int i = 3; i <= kRobots; ++i) {
    const std::string id = absl::StrCat("r", i);
    AddRobot(id);
    actuators.push_back(std::make_shared<TimedActuator>(&clock_));
    Post(id, Queue::kActuators, [actuator = actuators.back()](Robot& robot) {
      robot.OnActuatorHello(
          "base", actuator,
          {.levels = {"DEFAULT", "ALERT", "COMPROMISED", "HALT"}, .effective_level = "DEFAULT"});
    });
  }
  pipeline_->Start();
  Flood(500, 60);
  while (flooded_ < 500) OnRobot("r2", [](Robot&) {});
  pipeline_->Stop();

  for (const auto& actuator : actuators) {
    // 30 s have passed, and a heartbeat is due every 500 ms.
    ASSERT_THAT(actuator->sent_ns, SizeIs(::testing::Gt(20u)));
    int64_t longest_ns = 0;
    for (size_t i = 1; i < actuator->sent_ns.size(); ++i) {
      longest_ns = std::max(longest_ns, actuator->sent_ns[i] - actuator->sent_ns[i - 1]);
    }
    EXPECT_LE(longest_ns, (500 + 4 * 60 + 50) * kFairMs) << "a heartbeat, and what is under way";
  }
}

TEST_F(FairnessTest, ARobotWithoutBudgetWaitsButNotItsOrdersNorOtherRobots) {
  Open({.cpu_per_second_ns = 250 * kFairMs,
        .cpu_burst_ns = 100 * kFairMs,
        .long_task_ns = 1'000'000 * kNanosPerSecond});
  Flood(10, 200);
  Flood(1, 0, Queue::kActuators);
  Post("r2", Queue::kMessages, [&](Robot&) { EXPECT_EQ(flooded_, 11); });
  pipeline_->Start();
  std::vector<std::string> degraded;
  do {
    OnRobot("r2", [&](Robot& robot) { degraded = robot.Status().degraded; });
  } while (std::none_of(degraded.begin(), degraded.end(), [](const std::string& text) {
    return absl::StrContains(text, "more than its share");
  }));
  EXPECT_EQ(flooded_, 2) << "the actuator's first, then one that uses the budget up";
  OnRobot("r1", [&](Robot& robot) {
    EXPECT_THAT(robot.Status().degraded, Not(Contains(HasSubstr("more than its share"))));
  });

  // What deferred tasks cost flows in again, and no faster.
  int64_t passed_ms = 0;
  while (flooded_ < 11) {
    clock_.Advance(400 * kFairMs);
    passed_ms += 400;
    OnRobot("r2", [](Robot&) {});
    OnRobot("r1", [](Robot&) {});
  }
  EXPECT_GE(passed_ms, 9 * 200 * 2) << "a quarter of the time, at most";
  EXPECT_EQ(deferred_.Pop(kFairPatience), "r2");
  EXPECT_FALSE(deferred_.Pop(absl::ZeroDuration()).has_value()) << "once an episode";
  do {
    clock_.Advance(1 * kNanosPerSecond);
    OnRobot("r2", [&](Robot& robot) { degraded = robot.Status().degraded; });
  } while (std::any_of(degraded.begin(), degraded.end(), [](const std::string& text) {
    return absl::StrContains(text, "more than its share");
  }));
}

TEST_F(FairnessTest, WhatCompletesARobotsOwnDecisionIsNotDeferred) {
  Open({.cpu_burst_ns = 100 * kFairMs, .long_task_ns = 1'000'000 * kNanosPerSecond});
  Flood(2, 10'000);
  pipeline_->Start();
  while (flooded_ < 1) OnRobot("r1", [](Robot&) {});
  BoundedQueue<absl::Status> answered{{.capacity = 1}};
  OnRobot("r2", [&](Robot& robot) {
    robot.Raise({.operator_name = "alice", .to = "HALT", .reason = "it is under attack"},
                [&](const LevelAnswer& answer) { answered.Push(answer.status); });
  });
  const auto answer = answered.Pop(kFairPatience);
  ASSERT_TRUE(answer.has_value());
  EXPECT_THAT(*answer, IsOk());
  EXPECT_EQ(flooded_, 1);
}

TEST_F(FairnessTest, ARobotWithALongTaskMovesToTheSlowThreadAndComesBack) {
  Open({.cpu_burst_ns = 1'000'000 * kNanosPerSecond});
  pipeline_->Start();
  const auto thread_of = [&](const std::string& robot) {
    std::thread::id id;
    OnRobot(robot, [&](Robot&) { id = std::this_thread::get_id(); });
    return id;
  };
  const std::thread::id home = thread_of("r1");
  EXPECT_EQ(thread_of("r2"), home);
  Post("r2", Queue::kControl, [&](Robot&) { Work(30); });
  EXPECT_EQ(moved_.Pop(kFairPatience), "r2 slow");
  while (thread_of("r2") == home) {
  }
  EXPECT_EQ(thread_of("r1"), home);

  // A task that hangs there does not reach r1, and order is kept over the way back.
  Post("r2", Queue::kControl, [&](Robot&) {
    arrived_.Push(1);
    gate_.Pop(kFairPatience);
  });
  ASSERT_TRUE(arrived_.Pop(kFairPatience).has_value());
  std::vector<int> order;
  for (int i = 0; i < 10; ++i) {
    Post("r2", Queue::kControl, [&order, i](Robot&) { order.push_back(i); });
  }
  OnRobot("r1", [](Robot&) {});
  gate_.Close();
  while (thread_of("r2") != home) clock_.Advance(kNanosPerSecond);
  // An order would overtake them.
  Post("r2", Queue::kControl, [&](Robot&) { arrived_.Push(2); });
  ASSERT_TRUE(arrived_.Pop(kFairPatience).has_value());
  EXPECT_THAT(order, SizeIs(10));
  EXPECT_TRUE(std::is_sorted(order.begin(), order.end()));
  EXPECT_EQ(moved_.Pop(kFairPatience), "r2 back");
}

TEST_F(FairnessTest, AThreadThatHangsIsReportedOnceWithItsRobotWhileItHangs) {
  Open(TurnsOnly());
  pipeline_->Start();
  Post("r2", Queue::kControl, [&](Robot&) {
    arrived_.Push(1);
    gate_.Pop(kFairPatience);
  });
  ASSERT_TRUE(arrived_.Pop(kFairPatience).has_value());
  std::optional<std::string> late;
  while (!late) {
    clock_.Advance(20 * kFairMs);
    late = late_.Pop(absl::Milliseconds(10));
  }
  EXPECT_EQ(*late, "r2");
  for (int i = 0; i < 50; ++i) {
    clock_.Advance(20 * kFairMs);
    EXPECT_FALSE(late_.Pop(absl::Milliseconds(5)).has_value()) << "once an episode";
  }
}

// The service manager's watchdog hears no more then.
TEST_F(FairnessTest, NothingAdvancesWhileAThreadHangs) {
  Open(TurnsOnly());
  pipeline_->Start();
  const auto advances = [this] {
    for (const int before = advanced_; advanced_ == before;) {
      clock_.Advance(50 * kFairMs);
      arrived_.Pop(absl::Milliseconds(1));
    }
  };
  advances();
  Post("r2", Queue::kControl, [&](Robot&) {
    arrived_.Push(1);
    gate_.Pop(kFairPatience);
  });
  ASSERT_TRUE(arrived_.Pop(kFairPatience).has_value());
  const int before = advanced_;
  std::optional<std::string> late;
  while (!late) {
    clock_.Advance(20 * kFairMs);
    late = late_.Pop(absl::Milliseconds(10));
  }
  for (int i = 0; i < 50; ++i) {
    clock_.Advance(50 * kFairMs);
    late_.Pop(absl::Milliseconds(5));
  }
  EXPECT_LE(advanced_, before + 1) << "of the round before it hung";
  gate_.Close();
  advances();
}

TEST_F(FairnessTest, ARobotsFullQueueRefusesNoOtherRobotNorItsOrders) {
  Open({.control_max = 3, .messages_max = 2});
  Flood(3, 0);
  const auto nothing = [](Robot&) {};
  EXPECT_THAT(pipeline_->Post("r2", Queue::kControl, nothing),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("robot `r2`")));
  EXPECT_EQ(refused_.Pop(kFairPatience), "r2");
  Post("r2", Queue::kOrders, nothing);
  Post("r2", Queue::kActuators, nothing);
  Post("r2", Queue::kMessages, nothing);
  Post("r1", Queue::kControl, nothing);
  Mailbox mailbox(pipeline_.get(), "r1", {.tasks = 1, .bytes = 1'000});
  EXPECT_THAT(mailbox.Post(Lane::kMessages, 1, nothing), IsOk());
  EXPECT_THAT(mailbox.Post(Lane::kMessages, 1, nothing),
              StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_EQ(refused_.Pop(kFairPatience), "r1");
}

TEST_F(FairnessTest, ADeferredRobotThatIsRemovedRunsWhatWasPostedBefore) {
  Open({.cpu_burst_ns = 100 * kFairMs, .long_task_ns = 1'000'000 * kNanosPerSecond});
  Flood(3, 200);
  pipeline_->Start();
  while (flooded_ < 1) OnRobot("r1", [](Robot&) {});
  ASSERT_THAT(pipeline_->Remove("r2", absl::PermissionDeniedError("r2 was removed")), IsOk());
  while (!pipeline_->WaitGone("r2", absl::Milliseconds(1))) clock_.Advance(100 * kFairMs);
  EXPECT_EQ(flooded_, 3);
}

TEST_F(FairnessTest, TheGraphIsReadWithoutTheRobotsThread) {
  Open(TurnsOnly());
  pipeline_->Start();
  OnRobot("r2", [&](Robot& robot) {
    auto sensor = std::make_shared<FakeSensor>();
    robot.OnSensorHello("base", sensor, {.incarnation = "0123456789abcdef"});
    ros2::GraphDelta content;
    content.upsert_participants.push_back(
        {.guid = {.bytes = {1, 0x10, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1}}});
    auto batch = std::make_shared<Batch>();
    batch->incarnation = "0123456789abcdef";
    batch->lane = Lane::kControl;
    batch->first_sequence = 1;
    batch->observations.push_back(
        {.what = GraphChange{.to_version = 1, .settled = true, .delta = content}});
    robot.OnBatch("base", sensor.get(), batch);
  });
  Post("r2", Queue::kControl, [&](Robot&) {
    arrived_.Push(1);
    gate_.Pop(kFairPatience);
  });
  ASSERT_TRUE(arrived_.Pop(kFairPatience).has_value());
  const absl::StatusOr<GraphView> view = pipeline_->Graph("r2");
  ASSERT_THAT(view.status(), IsOk());
  ASSERT_NE(view->graph, nullptr);
  EXPECT_THAT(view->graph->participants(), SizeIs(1));
  EXPECT_NE(view->changed_unix_ns, 0);
  EXPECT_THAT(pipeline_->Graph("r9").status(), StatusIs(absl::StatusCode::kNotFound));
}

// --------------------------------------------------------------------- control batches in turns

class GraphTap final : public EventRecorder {
 public:
  explicit GraphTap(std::function<void()> on_graph) : on_graph_(std::move(on_graph)) {}
  bool OnLevel(const LevelChange&) override { return true; }
  bool OnEvent(const JudgedEvent& judged) override {
    if (std::holds_alternative<engine::GraphEvent>(judged.event.what)) {
      nodes.push_back(judged.graph->nodes().size());
      on_graph_();
    }
    if (std::holds_alternative<engine::MessageEvent>(judged.event.what)) {
      ++messages;
      if (message_takes) message_takes();
    }
    return true;
  }
  int messages = 0;
  std::function<void()> message_takes;
  // Of each graph that was judged.
  std::vector<size_t> nodes;

 private:
  std::function<void()> on_graph_;
};

class ControlTurnTest : public RobotTest {
 protected:
  void SetUp() override {
    Start();
    Arm();
    tap_ = std::make_shared<GraphTap>([this] { clock_.Advance(graph_takes_ms_ * kFairMs); });
    ASSERT_THAT(robot_->AddTap(tap_), IsOk());
  }
  // Deltas that add a node each, `apart_ms` of the sensor's time from one to the next.
  std::vector<Observation> Deltas(int count, int64_t apart_ms) {
    std::vector<Observation> out;
    for (int i = 0; i < count; ++i) {
      ros2::GraphDelta delta;
      AddNode(&delta, static_cast<uint8_t>(100 + i), absl::StrCat("/n", i));
      out.push_back({.boottime_ns = Boottime() - (count - i) * apart_ms * kFairMs,
                     .what = GraphChange{.from_version = graph_version_,
                                         .to_version = graph_version_ + 1,
                                         .settled = true,
                                         .delta = std::move(delta)}});
      ++graph_version_;
    }
    return out;
  }

  int64_t graph_takes_ms_ = 0;
  std::shared_ptr<GraphTap> tap_;
};

TEST_F(ControlTurnTest, OfABatchFourGraphsAreJudgedTheLastAmongThem) {
  SendBatch(Lane::kControl, Deltas(100, 0));
  EXPECT_THAT(tap_->nodes, ElementsAre(3, 4, 5, 102));
  EXPECT_THAT(robot_->core().graph().nodes(), SizeIs(102));
  SendBatch(Lane::kControl, Deltas(1, 0));
  EXPECT_THAT(tap_->nodes, SizeIs(5)) << "the next batch has its own";
}

TEST_F(ControlTurnTest, WhatAnHonestSensorTellsIsJudgedGraphByGraphABacklogToo) {
  SendBatch(Lane::kControl, Deltas(100, 20));
  ASSERT_THAT(tap_->nodes, SizeIs(100));
  for (size_t i = 0; i < 100; ++i) EXPECT_EQ(tap_->nodes[i], i + 3);
}

TEST_F(ControlTurnTest, AnIntruderInTheLastGraphOfAFloodRaises) {
  std::vector<Observation> flood = Deltas(100, 0);
  ros2::GraphDelta intruder;
  AddNode(&intruder, 9, "/intruder");
  std::get<GraphChange>(flood.back().what).delta = intruder;
  SendBatch(Lane::kControl, std::move(flood));
  EXPECT_NE(Level(), "DEFAULT");
}

TEST_F(ControlTurnTest, AMessageThatNamesAVersionThatWasNotJudgedFindsItsWriter) {
  std::vector<Observation> flood = Deltas(100, 0);
  AddNode(&std::get<GraphChange>(flood[50].what).delta, 20, "/late", "/cmd_vel");
  const uint64_t version = std::get<GraphChange>(flood[50].what).to_version;
  SendBatch(Lane::kControl, std::move(flood));
  const uint64_t acknowledged = sensor_->acknowledged[static_cast<int>(Lane::kMessages)];
  SendBatch(Lane::kMessages, {{.what = MessageSeen{.topic = "/cmd_vel",
                                                   .type = "geometry_msgs/msg/Twist",
                                                   .writer = Writer(20),
                                                   .size_bytes = 52,
                                                   .graph_version = version}}});
  Pass(1'000);
  EXPECT_GT(sensor_->acknowledged[static_cast<int>(Lane::kMessages)], acknowledged);
}

TEST_F(ControlTurnTest, ABatchThatTakesLongIsJudgedInTurnsInOrder) {
  graph_takes_ms_ = 5;
  SendBatch(Lane::kControl, Deltas(4, 20));
  EXPECT_TRUE(robot_->HasControl());
  EXPECT_THAT(tap_->nodes, ElementsAre(3));
  // Another one comes meanwhile.
  SendBatch(Lane::kControl, Deltas(1, 0));
  EXPECT_THAT(tap_->nodes, ElementsAre(3, 4));
  int turns = 0;
  while (robot_->HasControl()) {
    robot_->Advance();
    ASSERT_LT(++turns, 10);
  }
  EXPECT_THAT(tap_->nodes, ElementsAre(3, 4, 5, 6, 6)) << "the last one shows a node that is there";
  Pass(1'100);
  EXPECT_EQ(sensor_->acknowledged[static_cast<int>(Lane::kControl)],
            next_sequence_[static_cast<int>(Lane::kControl)] - 1);
}

TEST_F(ControlTurnTest, MessagesThatWaitedForAGraphAreJudgedInTurnsToo) {
  for (int i = 0; i < 10; ++i) {
    SendBatch(Lane::kMessages, {{.what = MessageSeen{.topic = "/cmd_vel",
                                                     .type = "geometry_msgs/msg/Twist",
                                                     .writer = Writer(30),
                                                     .size_bytes = 52,
                                                     .graph_version = 2}}});
  }
  tap_->message_takes = [this] { clock_.Advance(1 * kFairMs); };
  ros2::GraphDelta delta;
  AddNode(&delta, 30, "/new", "/cmd_vel");
  SendDelta(std::move(delta));
  EXPECT_TRUE(robot_->HasMessages());
  EXPECT_EQ(tap_->messages, 3) << "one, and two milliseconds";
  int turns = 0;
  while (robot_->HasMessages()) {
    robot_->Advance();
    ASSERT_LT(++turns, 10);
  }
  EXPECT_EQ(tap_->messages, 10);
}

TEST_F(ControlTurnTest, AStreamThatEndsBetweenTwoTurnsLeavesNoGraphUnjudged) {
  graph_takes_ms_ = 5;
  std::vector<Observation> flood = Deltas(100, 0);
  AddNode(&std::get<GraphChange>(flood[4].what).delta, 9, "/intruder");
  SendBatch(Lane::kControl, std::move(flood));
  // Three are judged, and of the merged ones as many as a turn takes.
  for (int i = 0; i < 2; ++i) robot_->Advance();
  graph_takes_ms_ = 0;
  robot_->OnSensorGone("base", sensor_.get());
  robot_->Advance();
  EXPECT_FALSE(robot_->HasControl());
  EXPECT_EQ(tap_->nodes.back(), robot_->core().graph().nodes().size());
}

TEST_F(ControlTurnTest, WhatWaitsForItsTurnIsIncompleteEvidence) {
  Pass(6'000);
  EXPECT_THAT(robot_->Status().degraded, Not(Contains(HasSubstr("share"))));
  robot_->SetBacklog(true);
  Pass(600);
  EXPECT_THAT(robot_->Status().degraded, Contains(HasSubstr("more than its share")));
  EXPECT_FALSE(actuator_->leases.back().evidence_complete);
  robot_->SetBacklog(false);
  Pass(600);
  EXPECT_TRUE(actuator_->leases.back().evidence_complete);
}

}  // namespace
}  // namespace rips::pipeline

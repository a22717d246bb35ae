#include "policy_server/server/fleet_metrics.h"

#include <atomic>
#include <fstream>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/server/robot/fake_ports.h"
#include "policy_server/server/shard/store_recorder.h"
#include "policy_server/server/store/fake_store.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"
#include "services/runtime/bounded_queue.h"

namespace rips::server {
namespace {

using pipeline::Queue;
using pipeline::Robot;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::StartsWith;
using ::testing::UnorderedElementsAre;

constexpr absl::Duration kLong = absl::Seconds(60);
constexpr char kDay[] = "86400";

bundle::Inventory InventoryOf(const std::vector<std::string>& robots) {
  bundle::Inventory inventory;
  for (const std::string& id : robots) {
    inventory.robots.push_back({.id = id,
                                .bundle = "b",
                                .sensors = {{.host = "base", .primary = true}, {.host = "arm"}},
                                .actuators = {"base"}});
  }
  return inventory;
}

// Two robots on threads, looked at when the test says so.
class FleetMetricsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    for (const char* id : {"r1", "r2"}) ASSERT_THAT(Add(id), IsOk());
    pipeline_.Start();
    fleet_.SetInventory(InventoryOf({"r1", "r2"}));
    Start({});
  }
  void TearDown() override {
    fleet_.Stop();
    pipeline_.Stop();
    committer_.Stop();
  }
  void Start(FleetMetricsSources sources) {
    fleet_.Start(std::move(sources), absl::InfiniteDuration());
  }
  pipeline::Policy PolicyOf(const std::string& levels, const std::string& bundle) {
    lang::CompileResult compiled =
        lang::Compile({{.path = "t.rul", .text = absl::StrCat("levels:\n", levels)}});
    EXPECT_TRUE(compiled.rules);
    return {.program = *engine::CompiledPolicy::Create(*std::move(compiled.rules)),
            .bundle_id = bundle};
  }
  absl::Status Add(const std::string& id) {
    const auto acquired = store_.Acquire(id);
    if (!acquired.ok()) return acquired.status();
    return pipeline_.Add({.id = id,
                          .sensor_hosts = {"base", "arm"},
                          .primary_sensor = "base",
                          .actuator_hosts = {"base"}},
                         PolicyOf("  DEFAULT;\n  ALERT;\n  HALT;\n", "sha256:0"), {},
                         acquired->record, acquired->tenure,
                         {.recorder = &recorder_, .audience = &audience_, .new_id = [this] {
                            return absl::StrFormat("%032x", ++ids_);
                          }});
  }
  // Runs on the robot's thread, after what waits; returns when it has.
  void OnRobot(const std::string& id, const std::function<void(Robot&)>& task) {
    BoundedQueue<int> done{{.capacity = 1}};
    ASSERT_THAT(pipeline_.Post(id, Queue::kOrders,
                               [&](Robot& robot) {
                                 task(robot);
                                 done.Push(1);
                               }),
                IsOk());
    ASSERT_TRUE(done.Pop(kLong).has_value());
  }
  void Raise(const std::string& id, const std::string& level) {
    OnRobot(id, [&](Robot& robot) {
      robot.Raise({.operator_name = "alice", .to = level, .reason = "drill"}, [](const auto&) {});
    });
  }
  // Asks, waits for the answers, shows them.
  void Look() {
    fleet_.Look();
    for (const std::string& robot : pipeline_.robots()) OnRobot(robot, [](Robot&) {});
    fleet_.Look();
  }
  // Of the page: lines of that metric without its name.
  std::vector<std::string> Lines(const std::string& name) {
    std::vector<std::string> lines;
    for (absl::string_view line : absl::StrSplit(metrics_.Text(), '\n')) {
      if (!absl::StartsWith(line, name)) continue;
      const absl::string_view rest = line.substr(name.size());
      if (absl::StartsWith(rest, "{") || absl::StartsWith(rest, " ")) lines.emplace_back(rest);
    }
    return lines;
  }

  FakeClock clock_;
  Metrics metrics_;
  store::FakeStore store_;
  store::Committer committer_{&store_};
  pipeline::StoreRecorder recorder_{&store_, &committer_};
  pipeline::SilentObserver audience_;
  std::atomic<int> ids_ = 0;
  pipeline::Pipeline pipeline_{2, &clock_};
  FleetMetrics fleet_{&pipeline_, &clock_, &metrics_};
};

TEST_F(FleetMetricsTest, ShowsWhichRobotsAreInMaintenance) {
  OnRobot("r2", [](Robot& robot) {
    EXPECT_THAT(robot.SetMaintenance(
                    {.operator_name = "carol", .reason = "reboot", .for_ns = 60 * kNanosPerSecond}),
                IsOk());
  });
  Look();
  EXPECT_THAT(Lines("rips_robot_maintenance"), ElementsAre("{robot=\"r1\"} 0", "{robot=\"r2\"} 1"));
}

TEST_F(FleetMetricsTest, ShowsTheLevelInForceAndNoOther) {
  Look();
  EXPECT_THAT(Lines("rips_robot_level"), ElementsAre("{level=\"DEFAULT\",robot=\"r1\"} 1",
                                                     "{level=\"DEFAULT\",robot=\"r2\"} 1"));

  Raise("r1", "HALT");
  Look();

  EXPECT_THAT(Lines("rips_robot_level"),
              ElementsAre("{level=\"HALT\",robot=\"r1\"} 1", "{level=\"DEFAULT\",robot=\"r2\"} 1"));
  EXPECT_THAT(Lines("rips_robot_level_index"), ElementsAre("{robot=\"r1\"} 2", "{robot=\"r2\"} 0"));
  EXPECT_THAT(Lines("rips_robot_effective_level_index"), IsEmpty()) << "no actuator is attached";
  EXPECT_THAT(Lines("rips_robot_stage"), Contains("{robot=\"r1\",stage=\"requested\"} 1"));
  EXPECT_THAT(Lines("rips_robot_judged"), ElementsAre("{robot=\"r1\"} 1", "{robot=\"r2\"} 1"));
  EXPECT_THAT(Lines("rips_robot_approvals_waiting"),
              ElementsAre("{robot=\"r1\"} 0", "{robot=\"r2\"} 0"));
  EXPECT_THAT(Lines("rips_robot_degraded"), Not(Contains("{robot=\"r1\"} 0"))) << "no agents";
}

TEST_F(FleetMetricsTest, AnotherTableOfLevelsLeavesNothingOfTheOld) {
  Raise("r1", "ALERT");
  Look();

  OnRobot("r1", [&](Robot& robot) {
    ASSERT_THAT(robot.SwapPolicy(PolicyOf("  LOW;\n  DEFAULT;\n  MID;\n  ALERT;\n", "sha256:1")),
                IsOk());
  });
  Look();

  EXPECT_THAT(Lines("rips_robot_level"), Contains("{level=\"ALERT\",robot=\"r1\"} 1"));
  EXPECT_THAT(Lines("rips_robot_level"), testing::SizeIs(2));
  EXPECT_THAT(Lines("rips_robot_level_index"), Contains("{robot=\"r1\"} 3"));
  EXPECT_THAT(Lines("rips_robot_bundle_info"), ElementsAre("{bundle=\"sha256:1\",robot=\"r1\"} 1",
                                                           "{bundle=\"sha256:0\",robot=\"r2\"} 1"));
}

TEST_F(FleetMetricsTest, ARobotThatLeavesTheInventoryVanishes) {
  metrics_.AddGauge("rips_blind_reasons", "", {{"robot", "r1"}}).Set(1);
  const Gauge blind = metrics_.AddGauge("rips_blind_reasons", "", {{"robot", "r2"}});
  Look();
  EXPECT_THAT(metrics_.Text(), HasSubstr("\"r2\""));

  ASSERT_THAT(pipeline_.Remove("r2", absl::NotFoundError("removed")), IsOk());
  fleet_.SetInventory(InventoryOf({"r1"}));
  blind.Set(7);  // of a robot that is leaving
  Look();

  EXPECT_THAT(metrics_.Text(), Not(HasSubstr("\"r2\"")));
  EXPECT_THAT(Lines("rips_robot_level"), ElementsAre("{level=\"DEFAULT\",robot=\"r1\"} 1"));
  EXPECT_THAT(Lines("rips_blind_reasons"), ElementsAre("{robot=\"r1\"} 1"));

  ASSERT_TRUE(pipeline_.WaitGone("r2", kLong));
  ASSERT_THAT(Add("r2"), IsOk());
  fleet_.SetInventory(InventoryOf({"r1", "r2"}));
  Look();
  EXPECT_THAT(Lines("rips_robot_level"), testing::SizeIs(2)) << "it is back";
}

TEST_F(FleetMetricsTest, ARobotThatIsHeldShowsWhatIsKnownWithoutIt) {
  Look();
  ASSERT_THAT(pipeline_.Remove("r2", absl::NotFoundError("removed")), IsOk());
  ASSERT_TRUE(pipeline_.WaitGone("r2", kLong));
  ASSERT_THAT(pipeline_.Hold({.robot = "r2",
                              .decided_level = "ALERT",
                              .degraded = {"no policy"},
                              .policy_problem = "no policy"},
                             absl::FailedPreconditionError("no policy")),
              IsOk());
  Look();

  EXPECT_THAT(Lines("rips_robot_level"), Contains("{level=\"ALERT\",robot=\"r2\"} 1"));
  EXPECT_THAT(Lines("rips_robot_level_index"), ElementsAre("{robot=\"r1\"} 0"));
  EXPECT_THAT(Lines("rips_robot_judged"), ElementsAre("{robot=\"r1\"} 1", "{robot=\"r2\"} 0"));
  EXPECT_THAT(Lines("rips_robot_policy_problem"),
              ElementsAre("{robot=\"r1\"} 0", "{robot=\"r2\"} 1"));
  EXPECT_THAT(Lines("rips_robot_degraded"), Contains("{robot=\"r2\"} 1"));
  EXPECT_THAT(Lines("rips_robot_bundle_info"), testing::SizeIs(1));
  EXPECT_THAT(Lines("rips_robot_agents_connected"), testing::SizeIs(2)) << "of r1 alone";

  ASSERT_THAT(Add("r2"), IsOk());
  Look();
  EXPECT_THAT(Lines("rips_robot_judged"), ElementsAre("{robot=\"r1\"} 1", "{robot=\"r2\"} 1"));
}

TEST_F(FleetMetricsTest, CountsAgentsWithASession) {
  const auto sensor = std::make_shared<pipeline::FakeSensor>();
  OnRobot("r1", [&](Robot& robot) {
    robot.OnSensorHello("arm", sensor, {.incarnation = "0123456789abcdef", .clock = clock_.Now()});
  });
  OnRobot("r2", [&](Robot& robot) {
    pipeline::ActuatorHello hello;
    hello.levels = {"DEFAULT", "ALERT", "HALT"};
    hello.effective_level = "DEFAULT";
    hello.clock = clock_.Now();
    robot.OnActuatorHello("base", std::make_shared<pipeline::FakeActuator>(), hello);
  });
  // It has a session when the store has answered.
  while (Lines("rips_robot_effective_level_index").empty()) Look();

  EXPECT_THAT(
      Lines("rips_robot_agents_listed"),
      ElementsAre("{agent=\"sensor\",robot=\"r1\"} 2", "{agent=\"actuator\",robot=\"r1\"} 1",
                  "{agent=\"sensor\",robot=\"r2\"} 2", "{agent=\"actuator\",robot=\"r2\"} 1"));
  EXPECT_THAT(
      Lines("rips_robot_agents_connected"),
      ElementsAre("{agent=\"sensor\",robot=\"r1\"} 1", "{agent=\"actuator\",robot=\"r1\"} 0",
                  "{agent=\"sensor\",robot=\"r2\"} 0", "{agent=\"actuator\",robot=\"r2\"} 1"));

  OnRobot("r1", [&](Robot& robot) { robot.OnSensorGone("arm", sensor.get()); });
  Look();
  EXPECT_THAT(Lines("rips_robot_agents_connected"), Contains("{agent=\"sensor\",robot=\"r1\"} 0"));
}

TEST_F(FleetMetricsTest, ARobotWhoseThreadDoesNotAnswerAgesAndIsAskedOnce) {
  Look();
  BoundedQueue<int> arrived{{.capacity = 1}};
  BoundedQueue<int> open{{.capacity = 1}};
  ASSERT_THAT(pipeline_.Post("r1", Queue::kControl,
                             [&](Robot&) {
                               arrived.Push(1);
                               open.Pop(kLong);
                             }),
              IsOk());
  ASSERT_TRUE(arrived.Pop(kLong).has_value());

  for (int i = 0; i < 3; ++i) {
    clock_.Advance(2 * kNanosPerSecond);
    fleet_.Look();
  }

  EXPECT_THAT(Lines("rips_robot_status_age_seconds"), Contains("{robot=\"r1\"} 6"));
  EXPECT_THAT(Lines("rips_robot_level"), Contains(HasSubstr("r1"))) << "what it said last";
  // One question, and perhaps an answer of the store to the robot's start.
  EXPECT_THAT(Lines("rips_robot_tasks_waiting"),
              Contains(testing::AnyOf("{queue=\"orders\",robot=\"r1\"} 1",
                                      "{queue=\"orders\",robot=\"r1\"} 2")));
  open.Push(1);
  Look();
  EXPECT_THAT(Lines("rips_robot_status_age_seconds"), Contains("{robot=\"r1\"} 0"));
  EXPECT_THAT(Lines("rips_robot_tasks_waiting"), testing::SizeIs(2 * pipeline::kQueueCount));
}

TEST_F(FleetMetricsTest, ShowsTheFirstCertificateToExpireOfListedAgentsOnly) {
  rpc::CertificateMonitor monitor({.own = {}, .interval = absl::InfiniteDuration()}, &clock_,
                                  &metrics_);
  const absl::Time now = absl::FromUnixNanos(clock_.Now().unix_ns);
  const auto see = [&](rpc::Role role, const std::string& robot, const std::string& host,
                       int days) {
    monitor.Seen({.identity = {.role = role, .trust_domain = "t", .robot = robot, .host = host},
                  .not_after = now + absl::Hours(24 * days),
                  .not_before = now});
  };
  see(rpc::Role::kSensor, "r1", "base", 9);
  see(rpc::Role::kSensor, "r1", "arm", 1);
  see(rpc::Role::kSensor, "r1", "not_listed", -5);
  see(rpc::Role::kActuator, "r1", "arm", -5);
  see(rpc::Role::kActuator, "r2", "base", -1);
  see(rpc::Role::kSensor, "stranger", "base", 1);
  monitor.Seen({.identity = {.role = rpc::Role::kOperator, .trust_domain = "t", .name = "alice"},
                .not_after = now});
  Start({.certificates = &monitor});
  Look();

  EXPECT_THAT(Lines("rips_robot_certificate_expiry_seconds"),
              ElementsAre(absl::StrCat("{agent=\"sensor\",robot=\"r1\"} ", kDay),
                          absl::StrCat("{agent=\"actuator\",robot=\"r2\"} -", kDay)));
  EXPECT_THAT(Lines("rips_certificate_expiry_seconds"),
              UnorderedElementsAre(HasSubstr("alice"), HasSubstr("name=\"r1/base\""),
                                   HasSubstr("name=\"r1/arm\",role=\"sensor\""),
                                   HasSubstr("name=\"r2/base\"")));
  fleet_.SetInventory(InventoryOf({"r2"}));
  Look();
  EXPECT_THAT(Lines("rips_robot_certificate_expiry_seconds"), testing::SizeIs(1));
}

TEST_F(FleetMetricsTest, ShowsStreamsQueuesAndTheSizeOfTheStore) {
  store::TempDir dir;
  std::ofstream(dir.File("s.db")) << "12345";
  rpc::SessionWatch sessions(&clock_, absl::InfiniteDuration());
  store::Committer idle(&store_);
  const auto stream = sessions.Add(
      {.identity = {.role = rpc::Role::kOperator}, .not_after = absl::InfiniteFuture()},
      [](const grpc::Status&) {});
  stream->greeted = true;
  rollout::OrderThread orders(&clock_);
  rollout::OrderThread pushes(&clock_);
  ASSERT_TRUE(orders.Post([] {}));
  Start({.sessions = &sessions,
         .orders = &orders,
         .pushes = &pushes,
         .committer = &idle,
         .store_path = dir.File("s.db")});
  Look();

  EXPECT_THAT(
      Lines("rips_streams_open"),
      ElementsAre("{agent=\"sensor\"} 0", "{agent=\"actuator\"} 0", "{agent=\"operator\"} 1"));
  EXPECT_THAT(Lines("rips_bundle_orders_waiting"),
              ElementsAre("{queue=\"orders\"} 1", "{queue=\"pushes\"} 0"));
  EXPECT_THAT(Lines("rips_store_batches_waiting"), ElementsAre(" 0"));
  EXPECT_THAT(Lines("rips_store_refused_total"), ElementsAre(" 0"));
  EXPECT_THAT(Lines("rips_store_bytes"), ElementsAre("{file=\"database\"} 5"));
}

TEST(IsShownTest, HidesWhatIsOfNoListedRobotOrHost) {
  const FleetMetrics::Listed listed = {{"r1", {.sensors = {"base"}, .actuators = {"arm"}}}};
  const auto shown = [&](const MetricLabels& labels) { return IsShown(listed, labels); };

  EXPECT_TRUE(shown({{"reason", "slow"}}));
  EXPECT_TRUE(shown({{"robot", "r1"}}));
  EXPECT_FALSE(shown({{"robot", "r2"}}));
  EXPECT_FALSE(shown({{"robot", ""}}));
  EXPECT_TRUE(shown({{"robot", "r1"}, {"host", "arm"}}));
  EXPECT_FALSE(shown({{"robot", "r1"}, {"host", "gone"}}));
  const auto certificate = [&](const char* whose, const char* role, const char* name) {
    return shown({{"whose", whose}, {"role", role}, {"name", name}});
  };
  EXPECT_TRUE(certificate("own", "policy-server", "main"));
  EXPECT_TRUE(certificate("peer", "operator", "alice"));
  EXPECT_TRUE(certificate("peer", "sensor", "r1/base"));
  EXPECT_FALSE(certificate("peer", "sensor", "r1/arm"));
  EXPECT_FALSE(certificate("peer", "actuator", "r1/base"));
  EXPECT_FALSE(certificate("peer", "actuator", "r2/arm"));
  EXPECT_FALSE(certificate("peer", "actuator", "r1"));
  EXPECT_FALSE(certificate("peer", "actuator", ""));
}

}  // namespace
}  // namespace rips::server

#include "policy_server/server/fleet.h"

#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/server/robot/fake_ports.h"
#include "policy_server/server/shard/store_recorder.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/fake_store.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/fake_clock.h"
#include "services/base/ids.h"
#include "services/base/status_matchers.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/real_clock.h"

namespace rips::server {
namespace {

using pipeline::Lane;
using pipeline::Robot;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

constexpr absl::Duration kLong = absl::Seconds(60);

// Real bundles on disk, a store in memory that outlives several servers.
class FleetTest : public ::testing::Test {
 protected:
  void SetUp() override {
    options_ = {.inventory = dir_.File("robots.yaml"), .leaving = kLong};
    sources_ = {.bundles_source = dir_.File("source"), .bundles_dir = dir_.File("kept")};
    WriteBundle("good", "DEFAULT, ALERT, HALT");
    WriteBundle("other", "DEFAULT, ALERT, HALT");
    List({{"r1", "good"}, {"r2", "other"}});
  }
  void TearDown() override { Stop(); }

  void WriteBundle(const std::string& name, const std::string& levels,
                   const std::string& more = "") {
    const std::string path = absl::StrCat(sources_.bundles_source, "/", name);
    std::filesystem::create_directories(path);
    std::ofstream(path + "/manifest.yaml")
        << "name: " << name << "\nrules: [r.rul]\nlevels: [" << levels << "]\n";
    std::ofstream rules(path + "/r.rul");
    rules << "levels:\n";
    for (absl::string_view level : absl::StrSplit(levels, ", ")) rules << "  " << level << ";\n";
    rules << more;
  }
  void Break(const std::string& name) {
    std::ofstream(absl::StrCat(sources_.bundles_source, "/", name, "/r.rul"))
        << "levels: nonsense(";
  }
  void List(const std::vector<std::pair<std::string, std::string>>& robots,
            const std::string& actuators = "base") {
    std::ofstream file(options_.inventory);
    file << "robots:\n";
    for (const auto& [id, bundle] : robots) {
      file << "  - {id: " << id << ", bundle: " << bundle
           << ", sensors: [{host: base, primary: true}], actuators: [" << actuators << "]}\n";
    }
  }
  absl::Status Start() {
    committer_ = std::make_unique<store::Committer>(&store_);
    recorder_ = std::make_unique<pipeline::StoreRecorder>(&store_, committer_.get());
    alerts_ =
        std::make_unique<pipeline::ServerAlerts>(committer_.get(), &audience_, &clock_, NewId);
    pipeline_ = std::make_unique<pipeline::Pipeline>(2, &clock_);
    policies_ = std::make_unique<PolicySource>(
        sources_,
        [this](const std::string& dir, const std::string& name) { return Load(dir, name); });
    fleet_ = std::make_unique<Fleet>(
        options_, &store_, pipeline_.get(), alerts_.get(), policies_.get(),
        pipeline::Ports{.recorder = recorder_.get(), .audience = &audience_, .new_id = NewId},
        FleetCounts{.robots =
                        [this](size_t armed, size_t on_last_good, size_t held) {
                          counts_ = {armed, on_last_good, held};
                        },
                    .inventory =
                        [this](const bundle::Inventory& now, bool refused) {
                          refused_ = refused;
                          in_force_.emplace_back();
                          for (const auto& robot : now.robots) in_force_.back().push_back(robot.id);
                        }});
    const absl::Status status = fleet_->Start();
    pipeline_->Start();
    return status;
  }
  void Stop() {
    if (pipeline_ != nullptr) pipeline_->Stop();
    if (committer_ != nullptr) committer_->Stop();
    fleet_.reset();
    pipeline_.reset();
  }
  void Restart() {
    Stop();
    ASSERT_THAT(Start(), IsOk());
  }
  absl::StatusOr<pipeline::Policy> Load(const std::string& dir, const std::string& name) {
    absl::StatusOr<bundle::Bundle> loaded = bundle::LoadBundle(dir, &real_clock_);
    if (!loaded.ok()) return loaded.status();
    if (!name.empty() && loaded->manifest.name != name) {
      return absl::InvalidArgumentError("another name");
    }
    return pipeline::Policy{.program = loaded->program, .bundle_id = loaded->id};
  }
  template <typename T>
  T Ask(const std::string& robot, std::function<T(Robot&)> ask) {
    BoundedQueue<T> answer{{.capacity = 1}};
    const absl::Status posted =
        pipeline_->Post(robot, Lane::kControl, [&](Robot& each) { answer.Push(ask(each)); });
    EXPECT_THAT(posted, IsOk());
    return posted.ok() ? *answer.Pop(kLong) : T();
  }
  pipeline::RobotStatus Status(const std::string& robot) {
    return Ask<pipeline::RobotStatus>(robot, [](Robot& each) { return each.Status(); });
  }
  void Raise(const std::string& robot, const std::string& level) {
    BoundedQueue<int> done{{.capacity = 1}};
    Ask<int>(robot, [&](Robot& each) {
      each.Raise({.operator_name = "alice", .to = level, .reason = "drill"},
                 [&](const pipeline::LevelAnswer& answer) { done.Push(answer.status.ok()); });
      return 0;
    });
    ASSERT_EQ(done.Pop(kLong), 1);
  }
  // Also ends the server, so that everything is written.
  std::vector<std::string> CriticalAlerts(const std::string& robot) {
    Stop();
    std::vector<std::string> texts;
    const auto alerts = store_.ListAlerts(robot, 1'000);
    for (const store::AlertRecord& alert : *alerts) {
      if (alert.severity == "critical") texts.push_back(alert.text);
    }
    return texts;
  }

  store::TempDir dir_;
  FleetOptions options_;
  PolicySource::Options sources_;
  FakeClock clock_;
  RealClock real_clock_;
  store::FakeStore store_;
  pipeline::SilentObserver audience_;
  std::unique_ptr<store::Committer> committer_;
  std::unique_ptr<pipeline::StoreRecorder> recorder_;
  std::unique_ptr<pipeline::ServerAlerts> alerts_;
  std::unique_ptr<pipeline::Pipeline> pipeline_;
  std::unique_ptr<PolicySource> policies_;
  std::unique_ptr<Fleet> fleet_;
  std::vector<size_t> counts_;
  // Robots of each inventory that was told to be in force.
  std::vector<std::vector<std::string>> in_force_;
  bool refused_ = false;  // the inventory that was read last
};

TEST_F(FleetTest, ABrokenBundleCostsItsRobotOnlyWhichGoesOnByItsLastGoodOne) {
  ASSERT_THAT(Start(), IsOk());
  Raise("r1", "ALERT");
  const std::string good = Status("r1").bundle_version;
  Break("good");
  Restart();

  const pipeline::RobotStatus status = Status("r1");
  EXPECT_EQ(status.decided_level, "ALERT");
  EXPECT_EQ(status.bundle_version, good);
  EXPECT_THAT(status.degraded, Contains(HasSubstr("the last good policy sha256:")));
  EXPECT_THAT(Status("r2").degraded, testing::Not(Contains(HasSubstr("refused"))));
  EXPECT_THAT(counts_, ElementsAre(1, 1, 0));
  EXPECT_THAT(CriticalAlerts("r1"), ElementsAre(HasSubstr("bundle `good` is refused")));
  EXPECT_THAT(CriticalAlerts("r2"), IsEmpty());
}

TEST_F(FleetTest, ARobotWithoutAnyGoodPolicyIsHeldAndArmedWhenItsBundleIsMended) {
  Break("good");
  ASSERT_THAT(Start(), IsOk());
  ASSERT_THAT(pipeline_->held(), SizeIs(1));
  EXPECT_EQ(pipeline_->held()[0].robot, "r1");
  EXPECT_THAT(pipeline_->held()[0].degraded, Contains(HasSubstr("no policy")));
  EXPECT_THAT(pipeline_->Post("r1", Lane::kControl, [](Robot&) {}),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("no policy")));
  EXPECT_EQ(Status("r2").decided_level, "DEFAULT");
  EXPECT_THAT(counts_, ElementsAre(1, 0, 1));

  fleet_->Reload();  // still broken: nothing new to say
  WriteBundle("good", "DEFAULT, ALERT, HALT");
  fleet_->Reload();
  EXPECT_THAT(pipeline_->held(), IsEmpty());
  EXPECT_EQ(Status("r1").decided_level, "DEFAULT");
  EXPECT_THAT(counts_, ElementsAre(2, 0, 0));
  EXPECT_THAT(CriticalAlerts("r1"), SizeIs(1));
}

TEST_F(FleetTest, ALevelThatTheBundleNoLongerDeclaresCostsThatRobotOnlyAndNeverSinks) {
  ASSERT_THAT(Start(), IsOk());
  Raise("r1", "ALERT");
  WriteBundle("good", "DEFAULT, HALT");
  Restart();
  EXPECT_EQ(Status("r1").decided_level, "ALERT") << "by the last good bundle";
  EXPECT_THAT(Status("r1").degraded, Contains(HasSubstr("does not declare")));

  std::filesystem::remove_all(sources_.bundles_dir);
  // The copy is gone too.
  Restart();
  ASSERT_THAT(pipeline_->held(), SizeIs(1));
  EXPECT_EQ(pipeline_->held()[0].decided_level, "ALERT");
  EXPECT_EQ(Status("r2").decided_level, "DEFAULT");

  WriteBundle("good", "DEFAULT, ALERT, HALT");
  fleet_->Reload();
  EXPECT_EQ(Status("r1").decided_level, "ALERT");
}

TEST_F(FleetTest, ACopyThatWasChangedIsNotUsed) {
  ASSERT_THAT(Start(), IsOk());
  Raise("r1", "ALERT");
  for (const auto& entry : std::filesystem::recursive_directory_iterator(sources_.bundles_dir)) {
    if (entry.path().filename() == "r.rul") {
      std::ofstream(entry.path()) << "levels:\n  DEFAULT;\n  ALERT;\n  HALT;\n\n";
    }
  }
  Break("good");
  Restart();
  EXPECT_THAT(pipeline_->held(), SizeIs(1));
}

TEST_F(FleetTest, RobotsComeChangeAndGoWithoutARestart) {
  ASSERT_THAT(Start(), IsOk());
  Raise("r2", "HALT");
  List({{"r1", "other"}, {"r3", "good"}}, "base, arm");
  fleet_->Reload();
  EXPECT_THAT(pipeline_->robots(), ElementsAre("r1", "r3"));
  EXPECT_THAT(Status("r1").degraded, Contains(HasSubstr("actuator arm holds no live lease")));
  EXPECT_EQ(Status("r3").decided_level, "DEFAULT");
  EXPECT_THAT(pipeline_->Post("r2", Lane::kControl, [](Robot&) {}),
              StatusIs(absl::StatusCode::kNotFound));

  List({{"r1", "good"}, {"r2", "other"}});
  fleet_->Reload();
  EXPECT_EQ(Status("r2").decided_level, "HALT") << "as it was recorded";
  EXPECT_NE(Status("r1").bundle_version, Status("r2").bundle_version);
}

TEST_F(FleetTest, AnInventoryThatIsRefusedLeavesTheOldOneInForce) {
  ASSERT_THAT(Start(), IsOk());
  for (const char* text : {"robots: [", "robots:\n  - {id: r1}\n", "", "robots: []\n"}) {
    std::ofstream(options_.inventory) << text;
    fleet_->Reload();
    EXPECT_THAT(pipeline_->robots(), ElementsAre("r1", "r2")) << text;
  }
  std::filesystem::remove(options_.inventory);
  fleet_->Reload();
  EXPECT_THAT(pipeline_->robots(), ElementsAre("r1", "r2"));
  Stop();
  EXPECT_THAT(store_.ListAlerts(std::string(store::kServerRobot), 100)->front().text,
              HasSubstr("the inventory is refused, the old one stays in force"));
}

TEST_F(FleetTest, OtherSettingsOfSensorsAreOneAlertWhateverTheNumberOfRobots) {
  std::vector<std::pair<std::string, std::string>> robots;
  for (int i = 10; i < 32; ++i) robots.emplace_back(absl::StrCat("r", i), "good");
  List(robots);
  ASSERT_THAT(Start(), IsOk());
  std::ofstream(options_.inventory, std::ios::app) << "sensor_settings: [{set: {settle: 3s}}]\n";
  fleet_->Reload();
  fleet_->Reload();  // nothing changes
  Stop();
  const auto alerts = store_.ListAlerts(std::string(store::kServerRobot), 100);
  ASSERT_EQ(alerts->size(), 1u);
  EXPECT_THAT(alerts->front().text,
              AllOf(HasSubstr("sets other settings for sensors of 22 robots: r10, r11, "),
                    HasSubstr("r29, ...; those"), Not(HasSubstr("r30"))));
  EXPECT_EQ(alerts->front().severity, "info");
}

TEST_F(FleetTest, ADirectoryIsTakenAsAWholeOrTheOldInventoryStays) {
  const std::string dir = dir_.File("robots.d");
  std::filesystem::create_directory(dir);
  const auto list = [&](const char* file, const std::string& robot) {
    options_.inventory = absl::StrCat(dir, "/", file);
    List({{robot, "good"}});
    options_.inventory = dir;
  };
  list("a.yaml", "r1");
  list("b.yaml", "r2");
  ASSERT_THAT(Start(), IsOk());
  EXPECT_THAT(pipeline_->robots(), ElementsAre("r1", "r2"));
  list("c.yaml", "r3");
  list("b.yaml", "r1");
  fleet_->Reload();
  EXPECT_THAT(pipeline_->robots(), ElementsAre("r1", "r2")) << "r1 is in two files: not even r3";
  EXPECT_TRUE(refused_);
  std::filesystem::remove(dir + "/b.yaml");
  fleet_->Reload();
  EXPECT_FALSE(refused_);
  EXPECT_THAT(pipeline_->robots(), ElementsAre("r1", "r3"));
  std::filesystem::remove_all(dir);
  fleet_->Reload();
  EXPECT_THAT(pipeline_->robots(), ElementsAre("r1", "r3")) << "the directory vanished";
  std::filesystem::create_directory(dir);
  fleet_->Reload();
  EXPECT_THAT(pipeline_->robots(), ElementsAre("r1", "r3")) << "it is empty";
  Stop();
  const auto alerts = store_.ListAlerts(std::string(store::kServerRobot), 100);
  ASSERT_THAT(alerts, IsOk());
  bool named = false;
  for (const store::AlertRecord& alert : *alerts) {
    named |= absl::StrContains(alert.text, "a.yaml") && absl::StrContains(alert.text, "b.yaml");
  }
  EXPECT_TRUE(named);
}

TEST_F(FleetTest, KnowsAgentsAndLabelsOfTheInventory) {
  const bundle::Inventory inventory = {
      {{.id = "r1", .sensors = {{"base", true}}, .actuators = {"arm"}, .labels = {{"k", "v"}}}}};
  EXPECT_THAT(AgentsOf(inventory),
              ElementsAre(pipeline::AgentId{"r1", pipeline::AgentKind::kSensor, "base"},
                          pipeline::AgentId{"r1", pipeline::AgentKind::kActuator, "arm"}));
  EXPECT_TRUE(LabelsOf(inventory).at("r1").contains("k=v"));
}

TEST_F(FleetTest, TellsTheInventoryInForceAtTheStartAndAtEachReload) {
  ASSERT_THAT(Start(), IsOk());
  List({{"r2", "other"}, {"r3", "good"}});
  fleet_->Reload();
  std::ofstream(options_.inventory) << "robots: [";
  fleet_->Reload();

  EXPECT_THAT(in_force_, ElementsAre(ElementsAre("r1", "r2"), ElementsAre("r2", "r3"),
                                     ElementsAre("r2", "r3")));
}

TEST_F(FleetTest, ABundleThatIsRefusedAtReloadLeavesTheOldOneInForceAndIsShown) {
  ASSERT_THAT(Start(), IsOk());
  const std::string before = Status("r1").bundle_version;
  Break("good");
  fleet_->Reload();
  EXPECT_EQ(Status("r1").bundle_version, before);
  EXPECT_THAT(Status("r1").degraded, Contains(HasSubstr("the old policy stays in force")));
  WriteBundle("good", "DEFAULT, ALERT, HALT",
              "rules External:\n  a: false ? trigger(ALERT);\n  h: false ? trigger(HALT);\n");
  fleet_->Reload();
  EXPECT_NE(Status("r1").bundle_version, before);
  EXPECT_THAT(Status("r1").degraded,
              testing::Not(Contains(HasSubstr("the old policy stays in force"))));
  Stop();
  int again = 0;
  const auto alerts = store_.ListAlerts("r1", 100);
  ASSERT_THAT(alerts, IsOk());
  for (const store::AlertRecord& alert : *alerts) {
    again += absl::StrContains(alert.text, "is in order again") ? 1 : 0;
  }
  EXPECT_EQ(again, 1);
}

TEST_F(FleetTest, ARobotThatAnotherServerAcquiresIsHeldWithAnAlertAndCostsNoOther) {
  ASSERT_THAT(Start(), IsOk());
  Raise("r1", "ALERT");
  ASSERT_THAT(store_.Acquire("r1"), IsOk());
  BoundedQueue<absl::Status> answer{{.capacity = 1}};
  Ask<int>("r1", [&](Robot& each) {
    each.DeEscalate({.operator_name = "alice",
                     .to = "DEFAULT",
                     .reason = "calm",
                     .expected_level = "ALERT",
                     .expected_decision_id = each.Status().decision_id,
                     .accept_blind = true},
                    [&](const pipeline::LevelAnswer& given) { answer.Push(given.status); });
    return 0;
  });
  const auto refused = answer.Pop(kLong);
  ASSERT_TRUE(refused.has_value());
  EXPECT_THAT(*refused, StatusIs(absl::StatusCode::kAborted));
  ASSERT_TRUE(pipeline_->WaitGone("r1", kLong));
  EXPECT_THAT(pipeline_->robots(), ElementsAre("r2"));
  ASSERT_THAT(pipeline_->held(), SizeIs(1));
  EXPECT_THAT(pipeline_->held()[0].degraded, ElementsAre(HasSubstr("owned by another policy")));
  EXPECT_THAT(pipeline_->Post("r1", Lane::kControl, [](Robot&) {}),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("owned by another")));
  EXPECT_EQ(store_.Load("r1")->level, "ALERT") << "nothing was lowered";
  Raise("r2", "HALT");

  fleet_->Reload();
  EXPECT_EQ(Status("r1").decided_level, "ALERT");
  Raise("r1", "HALT");
  EXPECT_THAT(CriticalAlerts("r1"), ElementsAre(HasSubstr("owned by another policy server")));
}

TEST_F(FleetTest, AStoreThatCannotBeWrittenIsAnErrorOfAll) {
  store_.FailWrites(absl::UnavailableError("disk on fire"));
  EXPECT_THAT(Start(), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("disk on fire")));
}

}  // namespace
}  // namespace rips::server

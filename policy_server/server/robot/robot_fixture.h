// A robot on a hand-stepped clock, with agents and a store that do what the test says; for tests.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_FIXTURE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_FIXTURE_H_

#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/server/robot/fake_ports.h"
#include "policy_server/server/robot/robot.h"
#include "services/base/fake_clock.h"

namespace rips::pipeline {

inline constexpr char kPaperRules[] = R"(
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
vars:
  intruder bool = false;
rules Graph:
  unknown_node: !nodesinclude("/camera", "/navigator", "/rips") ?
    set(intruder, true) => alert("unknown node", "high") => trigger(ALERT);
  known_nodes: nodesinclude("/camera", "/navigator", "/rips") && intruder ? set(intruder, false);
rules Msg:
  rogue: topicin("/cmd_vel") && !publishers("/navigator") ?
    alert("rogue cmd_vel", "critical") => trigger(COMPROMISED);
rules External:
  quiet: CurrLevel == ALERT && !intruder ? trigger(DEFAULT);
  last: false ? trigger(HALT);
)";

// Records at once, later, or not at all.
class FakeRecorder final : public Recorder {
 public:
  void Record(store::WriteBatch batch, std::function<void(const absl::Status&)> done) override {
    waiting_.emplace_back(std::move(batch), std::move(done));
    if (!held) Release();
  }
  bool healthy() const override { return healthy_; }
  void FindDecision(const std::string&, const DecisionId& decision_id,
                    std::function<void(const FoundDecision&)> done) override {
    Answer([this, decision_id, done = std::move(done)] {
      for (const store::DecisionRecord& decision : decisions) {
        if (decision.decision_id == decision_id) return done(decision.to);
      }
      done(std::nullopt);
    });
  }
  void NextTerm(const std::string&, uint64_t, uint64_t above,
                std::function<void(const absl::StatusOr<uint64_t>&)> done) override {
    Answer([this, above, done = std::move(done)] {
      if (!term_fail.ok()) return done(term_fail);
      newest_term = std::max(newest_term, above) + 1;
      done(newest_term);
    });
  }
  // Questions to the store are answered at once, or by this. False: none waited.
  bool AnswerAll() {
    bool any = false;
    while (!questions_.empty()) {
      auto question = std::move(questions_.front());
      questions_.pop_front();
      question();
      any = true;
    }
    return any;
  }
  store::StorePoint point() const override {
    return {.generation = generations.back().id, .commit = generations.back().last_commit};
  }
  bool GoesOnFrom(const store::StorePoint& seen) const override {
    return store::GoesOnFrom(generations, point().commit, seen);
  }
  void Release() {
    while (!waiting_.empty()) {
      auto [batch, done] = std::move(waiting_.front());
      waiting_.pop_front();
      const absl::Status status = reserve && batch.uses_reserve ? absl::OkStatus() : fail;
      if (!batch.uses_reserve) healthy_ = fail.ok();
      if (status.ok()) Take(batch);
      done(status);
    }
  }
  size_t waiting() const { return waiting_.size(); }
  void Take(const store::WriteBatch& batch) {
    ++generations.back().last_commit;
    decisions.insert(decisions.end(), batch.decisions.begin(), batch.decisions.end());
    refusals.insert(refusals.end(), batch.refusals.begin(), batch.refusals.end());
    stages.insert(stages.end(), batch.stages.begin(), batch.stages.end());
    for (const auto& [key, sequence] : batch.checkpoint.high_water) high_water[key] = sequence;
    if (batch.checkpoint.variables) variables = *batch.checkpoint.variables;
    if (batch.checkpoint.rules_halted) rules_halted = *batch.checkpoint.rules_halted;
    if (batch.checkpoint.soft_suspended) soft_suspended = *batch.checkpoint.soft_suspended;
    if (batch.checkpoint.resumed_at) resumed_at = *batch.checkpoint.resumed_at;
    if (batch.checkpoint.maintenance) maintenance = *batch.checkpoint.maintenance;
  }

  bool held = false;
  absl::Status fail, term_fail;
  uint64_t newest_term = 0;
  bool questions_held = false;
  // What may use the reserve succeeds all the same.
  bool reserve = false;
  std::vector<store::DecisionRecord> decisions;
  std::vector<store::RefusalRecord> refusals;
  std::vector<store::StageUpdate> stages;
  store::HighWater high_water;
  store::Variables variables;
  bool rules_halted = false, soft_suspended = false;
  DecisionId resumed_at;
  store::Maintenance maintenance;
  std::vector<store::Generation> generations = {{.id = std::string(16, 'g')}};

 private:
  void Answer(std::function<void()> question) {
    questions_.push_back(std::move(question));
    if (!questions_held) AnswerAll();
  }

  bool healthy_ = true;
  std::deque<std::function<void()>> questions_;
  std::deque<std::pair<store::WriteBatch, std::function<void(const absl::Status&)>>> waiting_;
};

class RobotTest : public ::testing::Test {
 protected:
  static constexpr char kIncarnation[] = "0123456789abcdef";

  void Start(const std::string& rules = kPaperRules, const store::RobotRecord& record = {},
             uint64_t term = 1) {
    const std::vector<lang::SourceFile> files = {{.path = "test.rul", .text = rules}};
    lang::CompileResult compiled = lang::Compile(files);
    ASSERT_TRUE(compiled.rules) << lang::RenderText(files, compiled.diagnostics);
    auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules));
    ASSERT_TRUE(program.ok()) << program.status();
    Ports ports{
        .clock = &clock_,
        .recorder = &recorder_,
        .audience = &audience_,
        .counts = counts_,
        .post = [this](std::function<void()> task) { posted_.push_back(std::move(task)); },
        .post_work = [this](std::function<void()> task) { posted_.push_back(std::move(task)); },
        .fenced = [this](const std::string& robot, auto&) { fenced_.push_back(robot); },
        .flight_recorder = flight_recorder_,
        .new_id = [this] { return absl::StrCat("id", ++ids_); }};
    auto robot = Robot::Create({.id = "r1",
                                .sensor_hosts = sensor_hosts_,
                                .primary_sensor = "base",
                                .actuator_hosts = {"base"}},
                               {.program = *program,
                                .bundle_id = "sha256:0",
                                .two_person = two_person_,
                                .inspector = inspector_},
                               Timing{.graph_wait_ns = 500 * kNanosPerMilli}, record, term,
                               std::move(ports));
    ASSERT_TRUE(robot.ok()) << robot.status();
    robot_ = *std::move(robot);
    Drain();
  }

  // Runs what was posted to the robot's thread.
  void Drain() {
    while (!posted_.empty()) {
      auto task = std::move(posted_.front());
      posted_.pop_front();
      task();
    }
  }

  // Time passes in steps of 50 ms; agents that are connected keep beating.
  void Pass(int64_t ms) {
    for (int64_t passed = 0; passed < ms; passed += 50) {
      clock_.Advance(50 * kNanosPerMilli);
      if (sensor_ && sensor_heartbeats_) SendSensorHeartbeat();
      if (actuator_ && actuator_heartbeats_) Heartbeat();
      robot_->OnTime();
      Drain();
    }
  }
  int64_t Boottime() const { return clock_.Now().boottime_ns; }
  void ConnectSensor(std::vector<SpooledRange> spooled = {}) {
    sensor_ = std::make_shared<FakeSensor>();
    robot_->OnSensorHello("base", sensor_,
                          {.incarnation = kIncarnation, .clock = clock_.Now(), .spooled = spooled});
    AnswerInterest();
    Drain();
  }
  void SendSensorHeartbeat() {
    robot_->OnSensorHeartbeat("base", sensor_.get(),
                              {.clock = clock_.Now(), .echo_boottime_ns = Boottime()});
  }
  void AnswerInterest(const std::string& problem = "") {
    robot_->OnInterestAnswer("base", sensor_.get(),
                             {.id = sensor_->interest_id(), .problem = problem});
  }
  void ConnectActuator(ActuatorHello hello) {
    actuator_ = std::make_shared<FakeActuator>();
    hello.levels = {"DEFAULT", "ALERT", "COMPROMISED", "HALT"};
    hello.clock = clock_.Now();
    effective_ = hello.effective_level;
    verified_ = false;
    robot_->OnActuatorHello("base", actuator_, hello);
    Drain();
  }
  void Heartbeat() {
    robot_->OnActuatorHeartbeat("base", actuator_.get(),
                                {.boottime_ns = Boottime(),
                                 .effective_level = effective_,
                                 .observed = absl::StrCat("/safety=", effective_),
                                 .verified = verified_,
                                 .floor_reason = floor_,
                                 .degraded = degraded_,
                                 .drifts = drifts_});
  }
  // The newest level command is obeyed.
  void Obey(Receipt::Stage stage = Receipt::Stage::kVerified, const std::string& detail = "") {
    ASSERT_NE(actuator_->level(), nullptr);
    const SetLevel set = *actuator_->level();
    const std::string id = actuator_->commands.back().id;
    robot_->OnReceipt(
        "base", actuator_.get(),
        {.command_id = id, .decision_id = set.decision_id, .stage = Receipt::Stage::kAcknowledged});
    robot_->OnReceipt(
        "base", actuator_.get(),
        {.command_id = id, .decision_id = set.decision_id, .stage = stage, .detail = detail});
    if (stage == Receipt::Stage::kVerified) {
      effective_ = set.to;
      verified_ = true;
    }
    Drain();
  }
  static ros2::Guid Participant(uint8_t n) {
    ros2::Guid guid;
    guid.bytes = {1, 0x10, n, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1};
    return guid;
  }
  static ros2::Guid Writer(uint8_t n) {
    ros2::Guid guid = Participant(n);
    guid.bytes[14] = 2;
    guid.bytes[15] = 3;
    return guid;
  }
  static void AddNode(ros2::GraphDelta* delta, uint8_t n, const std::string& name,
                      const std::string& publishes = "") {
    delta->upsert_participants.push_back({.guid = Participant(n)});
    delta->upsert_nodes.push_back({.full_name = name, .participant = Participant(n)});
    if (publishes.empty()) return;
    delta->upsert_endpoints.push_back({.guid = Writer(n),
                                       .kind = ros2::EndpointKind::kPublisher,
                                       .name = publishes,
                                       .type = "geometry_msgs/msg/Twist",
                                       .node = name,
                                       .visibility = ros2::Visibility::kWatched});
  }
  static ros2::GraphDelta NormalGraph() {
    ros2::GraphDelta graph;
    AddNode(&graph, 1, "/camera");
    AddNode(&graph, 2, "/navigator", "/cmd_vel");
    return graph;
  }

  void SendBatch(Lane lane, std::vector<Observation> observations, size_t payload_bytes = 0) {
    uint64_t& next = next_sequence_[static_cast<int>(lane)];
    for (Observation& observation : observations) {
      if (observation.boottime_ns == 0) observation.boottime_ns = Boottime();
    }
    const size_t count = observations.size();
    robot_->OnBatch("base", sensor_.get(),
                    std::make_shared<const Batch>(Batch{.incarnation = incarnation_,
                                                        .lane = lane,
                                                        .first_sequence = next,
                                                        .observations = std::move(observations),
                                                        .bytes = 100,
                                                        .payload_bytes = payload_bytes}));
    next += count;
    Drain();
  }
  void SendSnapshot(bool settled = true) {
    graph_version_ = 1;
    SendBatch(Lane::kControl,
              {{.what = GraphChange{.to_version = 1, .settled = settled, .delta = NormalGraph()}}});
  }
  void SendDelta(ros2::GraphDelta delta) {
    const uint64_t from = graph_version_;
    SendBatch(Lane::kControl, {{.what = GraphChange{from, from + 1, true, std::move(delta)}}});
    ++graph_version_;
  }
  void SendMessage(uint8_t writer, const char* topic = "/cmd_vel") {
    SendBatch(Lane::kMessages, {{.what = MessageSeen{.topic = topic,
                                                     .type = "geometry_msgs/msg/Twist",
                                                     .writer = Writer(writer),
                                                     .size_bytes = 52}}});
  }
  void IntruderAppears() {
    ros2::GraphDelta delta;
    AddNode(&delta, 9, "/intruder");
    SendDelta(std::move(delta));
  }
  void IntruderLeaves() {
    ros2::GraphDelta delta;
    delta.gone_guids = {Participant(9)};
    SendDelta(std::move(delta));
  }
  // Sensor and actuator connected, graph settled, DEFAULT verified.
  void Arm() {
    ConnectSensor();
    ConnectActuator({.effective_level = "DEFAULT"});
    SendSnapshot();
    Obey();
    Pass(100);
  }
  std::string Level() const { return robot_->Status().decided_level; }
  std::string Stage() const { return robot_->Status().stage; }

  std::vector<std::string> sensor_hosts_ = {"base"};
  std::vector<std::string> two_person_;
  FakeClock clock_;
  FakeRecorder recorder_;
  FakeObserver audience_;
  Counts counts_;
  std::deque<std::function<void()>> posted_;
  std::vector<std::string> fenced_;
  std::function<std::unique_ptr<FlightRecorder>(const std::string&)> flight_recorder_;
  int ids_ = 0;
  std::unique_ptr<Robot> robot_;
  std::shared_ptr<FakeInspector> inspector_ = std::make_shared<FakeInspector>();
  std::shared_ptr<FakeSensor> sensor_;
  std::shared_ptr<FakeActuator> actuator_;
  bool sensor_heartbeats_ = true, actuator_heartbeats_ = true;
  std::string effective_, floor_, incarnation_ = kIncarnation;
  bool verified_ = false;
  std::vector<std::string> degraded_;
  uint64_t drifts_ = 0;
  uint64_t next_sequence_[kLaneCount] = {1, 1};
  uint64_t graph_version_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_FIXTURE_H_

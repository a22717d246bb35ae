// What a robot's rules fired on, saved with the alert, and replayed to the same verdict.
#include "policy_server/server/flight/flight_archive.h"

#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "policy_server/policy/recording/reader.h"
#include "policy_server/policy/replay/replayer.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/robot/told_findings.h"
#include "services/base/status_matchers.h"
#include "services/runtime/bounded_queue.h"

namespace rips::flight {
namespace {

namespace fs = std::filesystem;

using ::testing::IsEmpty;
using ::testing::SizeIs;

class FlightArchiveTest : public pipeline::RobotTest {
 protected:
  FlightArchiveTest() {
    char name[] = "/tmp/rips_archive.XXXXXX";
    root_ = mkdtemp(name);
    files_ = *FlightFiles::Open({.directory = root_ + "/r", .free_bytes_min = 0});
    archive_ = std::make_unique<FlightArchive>(
        files_.get(), ArchiveReports{.saved = [this] { ++saved_; },
                                     .failed = [this] { ++failed_; },
                                     .problem = [this](auto&) { ++problems_; }});
    flight_recorder_ = [this](const std::string& robot) { return archive_->NewRecorder(robot); };
  }
  ~FlightArchiveTest() override {
    robot_.reset();
    archive_.reset();
    fs::remove_all(root_);
  }
  // Everything that waits is on the disk.
  void Settle() {
    robot_.reset();
    archive_.reset();
  }
  std::vector<store::AlertRecord> AlertsOf(const std::string& rule) {
    std::vector<store::AlertRecord> out;
    for (const store::AlertRecord& alert : audience_.alerts) {
      if (alert.rule == rule) out.push_back(alert);
    }
    return out;
  }
  // RIPS's own of that text; there must be one.
  store::AlertRecord OwnAlert(const std::string& text) {
    for (const store::AlertRecord& alert : AlertsOf(std::string(pipeline::kOwnRule))) {
      if (alert.text == text) return alert;
    }
    ADD_FAILURE() << "no alert `" << text << "`";
    return {};
  }
  // What the robot's rules do with the recording of that alert.
  replay::Result ReplayOf(const store::AlertRecord& alert) {
    const auto path = files_->Find(alert.id);
    EXPECT_THAT(path, IsOk()) << alert.text;
    if (!path.ok()) return {};
    auto reader = recording::Open(*path);
    EXPECT_THAT(reader, IsOk());
    const auto start = program_->rules().levels.Find((*reader)->origin()->level);
    auto result = replay::Replay(**reader, program_, {.start_level = *start}, nullptr);
    EXPECT_THAT(result, IsOk());
    return *std::move(result);
  }
  // As Start, and keeps the rules for replays.
  void Fly(const std::string& rules = pipeline::kPaperRules) {
    Start(rules);
    program_ = robot_->core().policy().program;
    Arm();
  }
  static bool Fired(const replay::Result& result, const store::AlertRecord& alert) {
    for (const auto& each : result.alerts) {
      if (each.rule == alert.rule && each.text == alert.text) return true;
    }
    return false;
  }

  std::string root_;
  std::atomic<int> saved_ = 0, failed_ = 0, problems_ = 0;
  std::unique_ptr<FlightFiles> files_;
  std::unique_ptr<FlightArchive> archive_;
  std::shared_ptr<const engine::CompiledPolicy> program_;
};

TEST_F(FlightArchiveTest, AnAlertReplaysToTheSameVerdict) {
  Fly();
  for (int i = 0; i < 20; ++i) {
    SendMessage(2);
    Pass(1'000);
  }
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder", "/cmd_vel");
  SendDelta(std::move(delta));
  SendMessage(9);
  Obey();
  Pass(10'000);
  const auto unknown = AlertsOf("unknown_node");
  const auto rogue = AlertsOf("rogue");
  ASSERT_THAT(unknown, SizeIs(1));
  ASSERT_THAT(rogue, SizeIs(1));
  Settle();
  EXPECT_TRUE(Fired(ReplayOf(unknown[0]), unknown[0]));
  const replay::Result result = ReplayOf(rogue[0]);
  EXPECT_TRUE(Fired(result, rogue[0]));
  EXPECT_EQ(result.level, "COMPROMISED");
  EXPECT_THAT(result.faults, IsEmpty());
}

// What a replay from the middle could not know by itself.
TEST_F(FlightArchiveTest, VariablesLevelUptimeTicksAndOperatorsAreInIt) {
  Fly(R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
vars:
  seen int = 0;
rules Msg:
  count: topicin("/cmd_vel") ? set(seen, seen + 1);
rules External:
  late_in_the_day: CurrLevel == COMPROMISED && seen > 3 && Uptime > 60000000000 ?
    alert("seen " + string(seen), "high");
  last: false ? trigger(HALT), trigger(COMPROMISED), trigger(ALERT), trigger(DEFAULT);
)");
  for (int i = 0; i < 4; ++i) SendMessage(2);
  Pass(70'000);  // the messages are long forgotten
  EXPECT_THAT(AlertsOf("late_in_the_day"), IsEmpty());
  robot_->Raise({.operator_name = "alice", .to = "COMPROMISED", .reason = "drill"},
                [](const pipeline::LevelAnswer&) {});
  Pass(1'000);
  const auto alerts = AlertsOf("late_in_the_day");
  ASSERT_THAT(alerts, testing::Not(IsEmpty()));
  EXPECT_EQ(alerts[0].text, "seen 4");
  Settle();
  const replay::Result result = ReplayOf(alerts[0]);
  EXPECT_TRUE(Fired(result, alerts[0]));
  EXPECT_EQ(result.level, "COMPROMISED");
}

TEST_F(FlightArchiveTest, WhichFindingsStandIsInIt) {
  Fly(R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules External:
  stands: CurrLevel < COMPROMISED && findingstands("impostor") && !findingstands("non_ros_reader") ?
    alert("one stands", "high") => trigger(COMPROMISED);
  last: false ? trigger(HALT), trigger(ALERT), trigger(DEFAULT);
)");
  SendBatch(pipeline::Lane::kControl,
            {{.what = pipeline::FindingSeen{.kind = "impostor", .node = "/rips"}}});
  Pass(1'000);
  EXPECT_THAT(AlertsOf("stands"), IsEmpty()) << "of readers it is not known";
  SendBatch(pipeline::Lane::kControl, {{.what = pipeline::ToldFindings(*robot_)}});
  Pass(1'000);
  const auto alerts = AlertsOf("stands");
  ASSERT_THAT(alerts, SizeIs(1));
  Settle();
  const replay::Result result = ReplayOf(alerts[0]);
  EXPECT_TRUE(Fired(result, alerts[0]));
  EXPECT_THAT(result.alerts, SizeIs(1));
  EXPECT_GT(result.events.undecidable, 0u);
}

TEST_F(FlightArchiveTest, ARobotThatIsNotSeenIsNotLoweredByTheReplayEither) {
  Fly();
  IntruderAppears();  // to ALERT, which is soft
  Obey();
  sensor_heartbeats_ = false;  // blind from now on
  Pass(8'000);
  ASSERT_EQ(Level(), "ALERT");
  const auto alerts = AlertsOf("unknown_node");
  ASSERT_THAT(alerts, SizeIs(1));
  robot_->Report(engine::Severity::kHigh, "saved");
  Pass(10'000);
  const store::AlertRecord saved = OwnAlert("saved");
  Settle();
  EXPECT_EQ(ReplayOf(saved).level, "ALERT");
}

TEST_F(FlightArchiveTest, AnIntruderThatWasThereBeforeIsNotJudgedAgain) {
  Fly();
  IntruderAppears();
  Obey();
  Pass(60'000);
  SendMessage(2);
  robot_->Report(engine::Severity::kCritical, "much later");
  Pass(6'000);
  const store::AlertRecord later = OwnAlert("much later");
  Settle();
  EXPECT_THAT(ReplayOf(later).alerts, IsEmpty());
}

TEST_F(FlightArchiveTest, AlertsOfAStormShareRecordings) {
  Fly();
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder", "/cmd_vel");
  SendDelta(std::move(delta));
  for (int i = 0; i < 200; ++i) {
    SendMessage(9);
    Pass(50);
  }
  const auto rogue = AlertsOf("rogue");
  ASSERT_GT(rogue.size(), 3u);
  Settle();
  for (const store::AlertRecord& alert : rogue) EXPECT_THAT(files_->Find(alert.id), IsOk());
  EXPECT_LE(saved_, 5) << "in 10 s";
  EXPECT_EQ(failed_, 0);
}

// The alert that stops the robot comes milliseconds after the one that a stranger is there.
TEST_F(FlightArchiveTest, AGraverAlertIsSavedAtOnce) {
  Fly();
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder", "/cmd_vel");
  SendDelta(std::move(delta));
  while (saved_ == 0) Pass(50);
  SendMessage(9);
  for (int i = 0; i < 100 && saved_ < 2; ++i) absl::SleepFor(absl::Milliseconds(20));
  const auto rogue = AlertsOf("rogue");
  ASSERT_THAT(rogue, SizeIs(1));
  EXPECT_THAT(files_->Find(rogue[0].id), IsOk()) << "although no time has passed";
  // One that is as grave waits, and says so.
  SendMessage(9);
  robot_->Report(engine::Severity::kCritical, "as grave");
  Pass(50);
  const auto own = AlertsOf(std::string(pipeline::kOwnRule));
  EXPECT_THAT(files_->Find(own.back().id).status(),
              StatusIs(absl::StatusCode::kFailedPrecondition));
  Settle();
  EXPECT_THAT(files_->Find(own.back().id), IsOk());
}

TEST_F(FlightArchiveTest, OnlyGraveAlertsAreSaved) {
  Fly();
  robot_->Report(engine::Severity::kMedium, "nothing much");
  Pass(6'000);
  const store::AlertRecord mild = OwnAlert("nothing much");
  Settle();
  EXPECT_EQ(saved_, 0);
  EXPECT_THAT(files_->Find(mild.id).status(), StatusIs(absl::StatusCode::kNotFound));
}

TEST_F(FlightArchiveTest, AnotherBundleSavesWhatTheOldOneJudged) {
  Fly();
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder", "/cmd_vel");
  SendDelta(std::move(delta));
  SendMessage(9);
  SendMessage(9);
  pipeline::Policy other = robot_->core().policy();
  other.bundle_id = "sha256:1";
  ASSERT_THAT(robot_->SwapPolicy(other), IsOk());
  Pass(100);
  const auto rogue = AlertsOf("rogue");
  ASSERT_THAT(rogue, testing::Not(IsEmpty()));
  Settle();
  for (const store::AlertRecord& alert : rogue) EXPECT_TRUE(Fired(ReplayOf(alert), alert));
}

// The graph that a replay of that file ends with.
ros2::RosGraph GraphAtTheEnd(const std::string& path) {
  ros2::RosGraph graph(ros2::kWideGraphLimits);
  auto reader = recording::Open(path);
  EXPECT_THAT(reader, IsOk());
  while (true) {
    const auto event = *(*reader)->Next();
    if (!event) return graph;
    const auto apply = [&](const recording::RecordedGraph& change) {
      if (change.whole) graph.Clear();
      EXPECT_THAT(graph.Apply(change.content), IsOk());
    };
    if (event->context) apply(*event->context);
    if (const auto* change = std::get_if<recording::RecordedGraph>(&event->what)) apply(*change);
  }
}

// Changes that come one at a time, several at once, as a snapshot, and of a writer that is judged
// against an earlier graph.
TEST_F(FlightArchiveTest, AReplayEndsWithTheGraphOfTheRobot) {
  Fly();
  const auto change = [this](uint8_t node, bool gone = false) {
    ros2::GraphDelta delta;
    if (gone) delta.gone_guids = {Participant(node)};
    if (!gone) AddNode(&delta, node, absl::StrCat("/node", node), "/scan");
    const uint64_t from = graph_version_++;
    return pipeline::Observation{
        .what = pipeline::GraphChange{from, graph_version_, true, std::move(delta)}};
  };
  const auto send = [this](std::vector<pipeline::Observation> changes) {
    SendBatch(pipeline::Lane::kControl, std::move(changes));
    Pass(50);
  };
  for (uint8_t round = 0; round < 6; ++round) {
    const uint8_t node = 20 + 10 * round;
    send({change(node)});
    send({change(node + 1), change(node + 2)});
    SendBatch(pipeline::Lane::kMessages,
              {{.what = pipeline::MessageSeen{.topic = "/cmd_vel",
                                              .type = "geometry_msgs/msg/Twist",
                                              .writer = Writer(2),
                                              .size_bytes = 52,
                                              .graph_version = graph_version_ - 2}}});
    if (round % 2 == 0) send({change(node, true)});
    std::vector<pipeline::Observation> many;
    for (uint8_t i = 3; i < 10; ++i) many.push_back(change(node + i));
    send(std::move(many));
    send({change(node + 3, true)});
    if (round == 2) SendSnapshot();
    robot_->Report(engine::Severity::kCritical, absl::StrCat("round ", round));
    Pass(50);
    const std::string alert = OwnAlert(absl::StrCat("round ", round)).id;
    while (absl::IsFailedPrecondition(files_->Find(alert).status())) Pass(50);
    const auto path = files_->Find(alert);
    ASSERT_THAT(path, IsOk());
    const ros2::RosGraph replayed = GraphAtTheEnd(*path);
    const ros2::RosGraph& graph = robot_->core().graph();
    EXPECT_TRUE(ros2::RosGraph::Diff(replayed, graph).empty()) << round;
    EXPECT_EQ(replayed.nodes().size(), graph.nodes().size());
  }
}

TEST_F(FlightArchiveTest, EveryMessageOfABatchIsInIt) {
  Fly();
  std::vector<pipeline::Observation> messages;
  for (int i = 0; i < 100; ++i) {
    messages.push_back({.what = pipeline::MessageSeen{.topic = "/cmd_vel",
                                                      .type = "geometry_msgs/msg/Twist",
                                                      .writer = Writer(2),
                                                      .size_bytes = 52,
                                                      .payload = absl::StrCat("payload ", i)}});
  }
  SendBatch(pipeline::Lane::kMessages, std::move(messages));
  robot_->Report(engine::Severity::kCritical, "saved");
  Pass(100);
  const store::AlertRecord saved = OwnAlert("saved");
  Settle();
  auto reader = recording::Open(*files_->Find(saved.id));
  ASSERT_THAT(reader, IsOk());
  int next = 0;
  while (const auto event = *(*reader)->Next()) {
    const auto* message = std::get_if<recording::RecordedMessage>(&event->what);
    if (message == nullptr) continue;
    EXPECT_EQ(message->payload, absl::StrCat("payload ", next++));
    EXPECT_EQ(message->sender, "/navigator");
  }
  EXPECT_EQ(next, 100);
}

// Recorders without a robot, each holding a message of `bytes` by its own account.
class FlightLimitsTest : public FlightArchiveTest {
 protected:
  std::unique_ptr<pipeline::FlightRecorder> NewRecorder(const std::string& robot) {
    auto recorder = archive_->NewRecorder(robot);
    recorder->BeginPiece(State(), now_);
    return recorder;
  }
  pipeline::RulesState State() const { return {.bundle_id = "b", .level = "L", .graph = graph_}; }
  void AddMessage(pipeline::FlightRecorder& recorder, size_t bytes) {
    auto batch = std::make_shared<pipeline::Batch>();
    batch->observations.push_back({.what = pipeline::MessageSeen{.topic = "/t"}});
    batch->bytes = bytes;
    const auto* seen = &std::get<pipeline::MessageSeen>(batch->observations[0].what);
    recorder.OnEvent({.event = {.what = engine::MessageEvent{.topic = seen->topic}},
                      .graph = graph_,
                      .message = seen,
                      .batch = batch});
  }
  std::string Keep(pipeline::FlightRecorder& recorder) {
    const std::string id = absl::StrCat(absl::Hex(++alerts_, absl::kZeroPad16), "0000000000000000");
    recorder.Keep({.id = id, .rule = "r", .text = "t"});
    return id;
  }
  // Saves, if it may, and everything has come to the disk. True: it did.
  bool Save(pipeline::FlightRecorder& recorder) {
    const int before = saved_;
    if (!recorder.wants_piece(now_)) return false;
    recorder.BeginPiece(State(), now_);
    for (int i = 0; i < 50 && saved_ == before; ++i) absl::SleepFor(absl::Milliseconds(2));
    return saved_ > before;
  }

  const std::shared_ptr<const ros2::RosGraph> graph_ = std::make_shared<ros2::RosGraph>();
  Instant now_{.boottime_ns = kNanosPerSecond};
  uint64_t alerts_ = 0;
};

TEST_F(FlightLimitsTest, ARobotThatSavesMuchSlowsDown) {
  const auto recorder = NewRecorder("r1");
  int saved = 0;
  for (int i = 0; i < 40; ++i) {
    AddMessage(*recorder, size_t{3} << 20);
    Keep(*recorder);
    now_.boottime_ns += FlightArchive::kPauseNs;
    saved += Save(*recorder) ? 1 : 0;
  }
  EXPECT_GE(saved, 10) << "32 MiB at once";
  EXPECT_LE(saved, 36) << "and 64 KiB a second";
}

TEST_F(FlightLimitsTest, OfTooManyAlertsItIsSaid) {
  const auto recorder = NewRecorder("r1");
  std::string last;
  for (size_t i = 0; i < FlightArchive::kAlertsMax; ++i) last = Keep(*recorder);
  const std::string over = Keep(*recorder);
  ASSERT_TRUE(Save(*recorder));
  EXPECT_THAT(files_->Find(last), IsOk());
  EXPECT_THAT(files_->Find(over).status().message(), testing::HasSubstr("too many alerts"));
}

TEST_F(FlightLimitsTest, WhatWaitsForASlowDiskIsBounded) {
  BoundedQueue<int> go_on{{.capacity = 1}};  // the disk, until it is closed
  archive_ = std::make_unique<FlightArchive>(files_.get(), ArchiveReports{.saved = [&] {
                                               ++saved_;
                                               go_on.Pop(absl::InfiniteDuration());
                                             }});
  std::vector<std::unique_ptr<pipeline::FlightRecorder>> recorders;
  int taken = 0;
  for (int i = 0; i < 40; ++i) {
    recorders.push_back(NewRecorder(absl::StrCat("r", i)));
    AddMessage(*recorders.back(), size_t{400} << 10);
    for (int m = 0; m < 8; ++m) {  // 3 MiB, in pieces
      if (recorders.back()->wants_piece(now_)) recorders.back()->BeginPiece(State(), now_);
      AddMessage(*recorders.back(), size_t{400} << 10);
    }
    recorders.back()->BeginPiece(State(), now_);
    Keep(*recorders.back());
    taken += recorders.back()->wants_piece(now_) ? 1 : 0;
    recorders.back()->BeginPiece(State(), now_);
  }
  EXPECT_GT(taken, 10);
  EXPECT_LT(taken, 30) << "64 MiB";
  go_on.Close();
  recorders.clear();
  archive_.reset();
  EXPECT_EQ(saved_, 40) << "none is lost";
}

TEST_F(FlightArchiveTest, AFullDiskIsReportedOnceAndStopsNothing) {
  fs::remove_all(root_);
  Fly();
  for (int i = 0; i < 4; ++i) {
    robot_->Report(engine::Severity::kHigh, absl::StrCat("problem ", i));
    Pass(6'000);
  }
  Settle();
  EXPECT_GE(failed_, 2);
  EXPECT_EQ(problems_, 1);
}

}  // namespace
}  // namespace rips::flight

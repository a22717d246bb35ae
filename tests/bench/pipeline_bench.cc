// What the threads that judge cost: a task on its way through a shard, and the longest pieces of
// work that one robot can make.
#include <time.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <future>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "policy_server/server/flight/flight_archive.h"
#include "policy_server/server/flight/flight_files.h"
#include "policy_server/server/robot/fake_ports.h"
#include "policy_server/server/shard/pipeline.h"
#include "services/runtime/real_clock.h"
#include "tests/bench/world.h"

namespace rips::bench {
namespace {

using pipeline::Batch;
using pipeline::Lane;
using pipeline::Robot;

constexpr int kMessages = 64;
constexpr int kTasksPerRobot = 1'000;
constexpr char kIncarnation[] = "0123456789abcdef";
constexpr int kFullGraph = 16'384;

double CpuSeconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + static_cast<double>(now.tv_nsec) * 1e-9;
}

// Everything is durable at once.
class NullRecorder final : public pipeline::Recorder {
 public:
  void Record(store::WriteBatch, std::function<void(const absl::Status&)> done) override {
    done(absl::OkStatus());
  }
  bool healthy() const override { return true; }
  void FindDecision(const std::string&, const DecisionId&,
                    std::function<void(const pipeline::FoundDecision&)> done) override {
    done(std::nullopt);
  }
  void NextTerm(const std::string&, uint64_t, uint64_t above,
                std::function<void(const absl::StatusOr<uint64_t>&)> done) override {
    done(above + 1);
  }
  store::StorePoint point() const override { return {}; }
  bool GoesOnFrom(const store::StorePoint&) const override { return true; }
};

class NullObserver final : public pipeline::RobotObserver {
 public:
  void OnAlert(const store::AlertRecord&) override {}
  void OnNotice(const std::string&) override {}
  void OnStatus(const pipeline::RobotStatus&) override {}
  void OnRuleLog(const std::string&, const std::string&, const std::string&) override {}
};

pipeline::Timing Patient() {
  constexpr int64_t kHour = 3'600 * kNanosPerSecond;
  return {.stale_ns = kHour, .lost_ns = kHour, .backlog_ns = kHour};
}

ros2::Guid At(uint32_t participant, uint32_t entity) {
  ros2::Guid guid;
  for (int i = 0; i < 4; ++i) {
    guid.bytes[4 + i] = static_cast<uint8_t>(participant >> (24 - 8 * i));
    guid.bytes[12 + i] = static_cast<uint8_t>(entity >> (24 - 8 * i));
  }
  return guid;
}

// 64 participants with a node each; every topic has four publishers.
ros2::GraphDelta FullGraph(int endpoints) {
  ros2::GraphDelta graph;
  for (int i = 0; i < endpoints; ++i) {
    const uint32_t p = 1 + i % 64;
    const std::string node = absl::StrCat("/node", p);
    if (i < 64) {
      graph.upsert_participants.push_back({.guid = At(p, 0x1c1)});
      graph.upsert_nodes.push_back({.full_name = node, .participant = At(p, 0x1c1)});
    }
    graph.upsert_endpoints.push_back({.guid = At(p, (i << 8) + 3),
                                      .name = absl::StrCat("/robot/topic", i / 4),
                                      .type = "std_msgs/msg/String",
                                      .node = node,
                                      .visibility = ros2::Visibility::kWatched});
  }
  return graph;
}

std::shared_ptr<const Batch> One(uint64_t sequence, pipeline::Observation seen) {
  auto batch = std::make_shared<Batch>();
  batch->incarnation = kIncarnation;
  batch->lane = Lane::kControl;
  batch->first_sequence = sequence;
  seen.boottime_ns = RealClock().Now().boottime_ns;
  batch->observations.push_back(std::move(seen));
  return batch;
}

// ------------------------------------------------------------------------ tasks through a shard

struct Load {
  std::string robot;
  std::shared_ptr<pipeline::FakeSensor> sensor = std::make_shared<pipeline::FakeSensor>();
  std::vector<std::shared_ptr<const Batch>> batches;
};

Load MakeLoad(int robot, const std::vector<std::string>& topics) {
  Load load{.robot = absl::StrCat("r", robot)};
  for (int i = 0; i < kTasksPerRobot; ++i) {
    auto batch = std::make_shared<Batch>();
    batch->incarnation = kIncarnation;
    batch->first_sequence = 1 + i * kMessages;
    batch->bytes = 1;
    for (int m = 0; m < kMessages; ++m) {
      pipeline::Observation& observation = batch->observations.emplace_back();
      observation.boottime_ns = RealClock().Now().boottime_ns;
      observation.what = pipeline::MessageSeen{.topic = topics[m % topics.size()],
                                               .type = kType,
                                               .writer = WriterOf(m % topics.size()),
                                               .size_bytes = 100};
    }
    load.batches.push_back(std::move(batch));
  }
  return load;
}

// The flight recorder of a server, on files of its own.
class Flights {
 public:
  pipeline::Ports With(pipeline::Ports ports) {
    ports.flight_recorder = [this](const std::string& robot) {
      return archive_.NewRecorder(robot);
    };
    return ports;
  }
  ~Flights() { std::filesystem::remove_all(directory_); }

 private:
  const std::string directory_ = absl::StrCat("/tmp/rips_bench_flight.", getpid());
  std::unique_ptr<flight::FlightFiles> files_ =
      *flight::FlightFiles::Open({.directory = directory_});
  flight::FlightArchive archive_{files_.get(), {}};
};

// CPU time of the shard's thread for batches of messages, from the first to the last.
void RunShardMessages(benchmark::State& state, Flights* flights) {
  const int robots = static_cast<int>(state.range(0));
  const RealClock clock;
  const std::vector<std::string> topics = Topics();
  NullRecorder recorder;
  NullObserver audience;
  const auto program = MakeProgram(TopicRules(100));
  for (auto _ : state) {
    pipeline::Ports ports{
        .recorder = &recorder, .audience = &audience, .new_id = [] { return "id"; }};
    if (flights != nullptr) ports = flights->With(std::move(ports));
    pipeline::Pipeline pipeline(1, &clock);
    std::vector<Load> loads;
    for (int r = 0; r < robots; ++r) {
      loads.push_back(MakeLoad(r, topics));
      const Load& load = loads.back();
      if (!pipeline
               .Add({.id = load.robot, .sensor_hosts = {"base"}, .primary_sensor = "base"},
                    {.program = program}, Patient(), {}, 1, ports)
               .ok()) {
        return state.SkipWithError("no robot");
      }
    }
    double began_s = 0;
    double ended_s = 0;
    int left = robots * kTasksPerRobot;
    std::promise<void> done;
    for (const Load& load : loads) {
      pipeline
          .Post(load.robot, Lane::kControl,
                [&](Robot& robot) {
                  robot.OnSensorHello("base", load.sensor, {.incarnation = kIncarnation});
                  robot.OnBatch(
                      "base", load.sensor.get(),
                      One(1, {.what = pipeline::GraphChange{
                                  .to_version = 1, .settled = true, .delta = GraphOfTopics()}}));
                  began_s = CpuSeconds();
                })
          .IgnoreError();
    }
    for (int i = 0; i < kTasksPerRobot; ++i) {
      for (const Load& load : loads) {
        const auto posted = pipeline.Post(load.robot, Lane::kMessages, [&, i](Robot& robot) {
          robot.OnBatch("base", load.sensor.get(), load.batches[i]);
          if (--left > 0) return;
          ended_s = CpuSeconds();
          done.set_value();
        });
        if (!posted.ok()) return state.SkipWithError("refused");
      }
    }
    pipeline.Start();
    // Without a question to the thread: each would wake another one, which costs more than a task.
    done.get_future().wait();
    pipeline.Stop();
    state.SetIterationTime(ended_s - began_s);
  }
  SetEvents(state, int64_t{kMessages} * robots * kTasksPerRobot);
}
void ShardMessages(benchmark::State& state) { RunShardMessages(state, nullptr); }
BENCHMARK(ShardMessages)->Name("shard/messages")->Arg(1)->Arg(4)->UseManualTime();

// The same with the last events kept for recordings.
void ShardMessagesKept(benchmark::State& state) {
  Flights flights;
  RunShardMessages(state, &flights);
}
BENCHMARK(ShardMessagesKept)->Name("shard/messages_kept")->Arg(1)->Arg(4)->UseManualTime();

// --------------------------------------------------------------------- long pieces of one robot

std::vector<lang::SourceFile> WarehouseRules() {
  std::vector<lang::SourceFile> files;
  const std::filesystem::path folder = std::filesystem::path(RIPS_BENCH_RULES) / "warehouse";
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() != ".rul") continue;
    std::stringstream text;
    text << std::ifstream(entry.path()).rdbuf();
    files.push_back({.path = entry.path().filename().string(), .text = text.str()});
  }
  return files;
}

// A robot with a graph of kFullGraph endpoints, under the warehouse policy.
class FullRobot {
 public:
  explicit FullRobot(Flights* flights = nullptr) {
    pipeline::Ports ports{.clock = &clock_,
                          .recorder = &recorder_,
                          .audience = &audience_,
                          .post = [](const std::function<void()>& task) { task(); },
                          .new_id = [] { return "id"; }};
    if (flights != nullptr) ports = flights->With(std::move(ports));
    auto robot = Robot::Create({.id = "r", .sensor_hosts = {"base"}, .primary_sensor = "base"},
                               {.program = MakeProgram(WarehouseRules())}, Patient(), {}, 1,
                               std::move(ports));
    robot_ = *std::move(robot);
    robot_->OnSensorHello("base", sensor_, {.incarnation = kIncarnation});
  }
  void Snapshot(const ros2::GraphDelta& graph) {
    Send(
        {.what = pipeline::GraphChange{.to_version = ++version_, .settled = true, .delta = graph}});
  }
  void Delta(ros2::GraphDelta delta) {
    ++version_;
    Send({.what = pipeline::GraphChange{.from_version = version_ - 1,
                                        .to_version = version_,
                                        .settled = true,
                                        .delta = std::move(delta)}});
  }
  void Send(pipeline::Observation seen) {
    robot_->OnBatch("base", sensor_.get(), One(++sequence_, std::move(seen)));
  }
  Robot& robot() { return *robot_; }

 private:
  RealClock clock_;
  NullRecorder recorder_;
  NullObserver audience_;
  std::shared_ptr<pipeline::FakeSensor> sensor_ = std::make_shared<pipeline::FakeSensor>();
  std::unique_ptr<Robot> robot_;
  uint64_t sequence_ = 0;
  uint64_t version_ = 0;
};

void LongSnapshot(benchmark::State& state) {
  FullRobot full;
  const ros2::GraphDelta graph = FullGraph(kFullGraph);
  for (auto _ : state) full.Snapshot(graph);
}
BENCHMARK(LongSnapshot)->Name("long/snapshot")->Unit(benchmark::kMillisecond);

void RunLongDelta(benchmark::State& state, Flights* flights) {
  FullRobot full(flights);
  full.Snapshot(FullGraph(kFullGraph));
  const ros2::Endpoint one = FullGraph(1).upsert_endpoints[0];
  for (auto _ : state) {
    ros2::GraphDelta delta;
    delta.upsert_endpoints = {one};
    full.Delta(std::move(delta));
  }
}
void LongDelta(benchmark::State& state) { RunLongDelta(state, nullptr); }
BENCHMARK(LongDelta)->Name("long/delta")->Unit(benchmark::kMillisecond);

void LongDeltaKept(benchmark::State& state) {
  Flights flights;
  RunLongDelta(state, &flights);
}
BENCHMARK(LongDeltaKept)->Name("long/delta_kept")->Unit(benchmark::kMillisecond);

// Names that no node has, as many as fit into a message of 1 MiB.
void LongGoneNodes(benchmark::State& state) {
  FullRobot full;
  full.Snapshot(FullGraph(kFullGraph));
  for (auto _ : state) {
    ros2::GraphDelta delta;
    for (int i = 0; i < 100'000; ++i) delta.gone_nodes.push_back(absl::StrCat("/gone", i));
    full.Delta(std::move(delta));
  }
}
BENCHMARK(LongGoneNodes)->Name("long/gone_nodes")->Unit(benchmark::kMillisecond);

void LongTime(benchmark::State& state) {
  FullRobot full;
  full.Snapshot(FullGraph(kFullGraph));
  for (auto _ : state) full.robot().OnTime();
}
BENCHMARK(LongTime)->Name("long/on_time")->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace rips::bench

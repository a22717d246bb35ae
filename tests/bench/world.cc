#include "tests/bench/world.h"

#include <malloc.h>

#include <algorithm>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "services/base/check.h"

namespace rips::bench {
namespace {

constexpr char kLevels[] = "levels: DEFAULT; ALERT;\n";
// Rules that one file holds: files have a limit.
constexpr int kRulesPerFile = 2'500;
constexpr size_t kDraws = 8'192;

// Numbers that look drawn at random; the same on every machine.
class Draws {
 public:
  // In [0, 1).
  double Next() {
    state_ = state_ * 6'364'136'223'846'793'005u + 1'442'695'040'888'963'407u;
    return static_cast<double>(state_ >> 11) / static_cast<double>(uint64_t{1} << 53);
  }

 private:
  uint64_t state_ = 1;
};

// Rules numbered 0 to `count`, in as many files as they need.
template <typename Rule>
std::vector<lang::SourceFile> Files(absl::string_view head, int count, const Rule& rule) {
  std::vector<lang::SourceFile> files = {{.path = "bench0.rul", .text = std::string(head)}};
  for (int i = 0; i < count; ++i) {
    if (i > 0 && i % kRulesPerFile == 0) {
      files.push_back({.path = absl::StrCat("bench", files.size(), ".rul")});
    }
    if (i % kRulesPerFile == 0) absl::StrAppend(&files.back().text, "rules Msg:\n");
    absl::StrAppend(&files.back().text, "  ", rule(i), "\n");
  }
  return files;
}

ros2::Guid ParticipantGuid() {
  ros2::Guid guid;
  guid.bytes[0] = 1;
  guid.bytes[14] = 0x01;
  guid.bytes[15] = 0xc1;
  return guid;
}

void AddPublisher(ros2::GraphDelta& graph, const std::string& topic, size_t index) {
  graph.upsert_endpoints.push_back({.guid = WriterOf(index),
                                    .kind = ros2::EndpointKind::kPublisher,
                                    .name = topic,
                                    .type = kType,
                                    .node = kSender});
}

// Counting references costs more in a process that has had more than one thread.
void BeThreaded() {
  static const bool once = [] {
    std::thread([] {}).join();
    return true;
  }();
  static_cast<void>(once);
}

}  // namespace

std::string PatternOf(int rule) { return absl::StrFormat("^/robot_%05d/.*", rule); }

std::vector<lang::SourceFile> TopicRules(int count) {
  return Files(kLevels, count, [](int i) {
    return absl::StrFormat(
        "rule_%05d: topicmatches(\"%s\") && publishercount(2, 100) ? alert(\"too many\") => "
        "trigger(ALERT);",
        i, PatternOf(i));
  });
}

std::vector<lang::SourceFile> PlainRules(int count) {
  const std::string head =
      absl::StrCat(kLevels, "vars: speed int = 5000; turns int = 7000;\n",
                   "rules External: set_by_nobody: false ? set(speed, 0), set(turns, 0);\n");
  return Files(head, count, [](int i) {
    return absl::StrFormat(
        "rule_%05d: topicin(\"%s\") && publishercount(1, 3) && speed + turns > %d && "
        "Sender == \"/rogue%04d\" ? alert(\"rogue\") => trigger(ALERT);",
        i, kDrivenTopic, i, i);
  });
}

std::vector<std::string> Topics() {
  std::vector<std::string> topics;
  for (int i = 0; i < kTopics; ++i) {
    topics.push_back(absl::StrFormat("/robot_%05d/sensor_%d/scan", 20'000 + i / 10, i % 10));
  }
  return topics;
}

std::vector<uint32_t> ZipfDraws() {
  std::vector<double> up_to;
  double sum = 0;
  for (int i = 0; i < kTopics; ++i) up_to.push_back(sum += 1.0 / (i + 1));
  std::vector<uint32_t> draws;
  Draws random;
  for (size_t i = 0; i < kDraws; ++i) {
    const auto at = std::upper_bound(up_to.begin(), up_to.end(), random.Next() * sum);
    const auto index = static_cast<uint32_t>(at - up_to.begin());
    draws.push_back(std::min<uint32_t>(index, kTopics - 1));
  }
  return draws;
}

ros2::Guid WriterOf(size_t index) {
  ros2::Guid guid = ParticipantGuid();
  guid.bytes[13] = static_cast<uint8_t>(index >> 8);
  guid.bytes[14] = static_cast<uint8_t>(index);
  guid.bytes[15] = 0x03;
  return guid;
}

ros2::GraphDelta GraphOfTopics() {
  ros2::GraphDelta graph;
  graph.upsert_participants.push_back({.guid = ParticipantGuid()});
  graph.upsert_nodes.push_back({.full_name = kSender, .participant = ParticipantGuid()});
  size_t index = 0;
  for (const std::string& topic : Topics()) AddPublisher(graph, topic, index++);
  AddPublisher(graph, kDrivenTopic, index++);
  AddPublisher(graph, kGuardedTopic, index++);
  AddPublisher(graph, kGuardedTopic, index++);
  return graph;
}

std::shared_ptr<const engine::CompiledPolicy> MakeProgram(
    const std::vector<lang::SourceFile>& files) {
  lang::CompileResult compiled = lang::Compile(files);
  if (!compiled.rules.has_value()) {
    std::fputs(lang::RenderText(files, compiled.diagnostics).c_str(), stderr);
  }
  RIPS_CHECK(compiled.rules.has_value(), "rules of a benchmark are right");
  auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules));
  RIPS_CHECK(program.ok(), "rules of a benchmark are well formed");
  return *std::move(program);
}

Instant Now() {
  return {.boottime_ns = 1'000 * kNanosPerSecond, .unix_ns = 1'700'000'000 * kNanosPerSecond};
}

engine::RobotState MakeRobot(std::shared_ptr<const engine::CompiledPolicy> program) {
  BeThreaded();
  const levels::LevelTable levels = program->rules().levels;
  engine::RobotState robot(std::move(program), levels::LevelMachine(levels, 0, {1, 1}, 1), Now());
  ros2::RosGraph graph;
  RIPS_CHECK(graph.Apply(GraphOfTopics()).ok(), "the graph of a benchmark is right");
  robot.graph = std::move(graph);
  return robot;
}

engine::Event MessageOn(absl::string_view topic, const ros2::Guid& writer) {
  engine::Event event{.time_unix_ns = Now().unix_ns};
  event.what = engine::MessageEvent{
      .topic = topic, .type = kType, .writer = writer, .sender = kSender, .size_bytes = 1'024};
  return event;
}

size_t BytesInUse() {
  const struct mallinfo2 info = mallinfo2();
  return info.uordblks + info.hblkhd;
}

void SetEvents(benchmark::State& state, int64_t per_iteration) {
  const auto events = static_cast<double>(state.iterations() * per_iteration);
  state.counters["events_per_s"] = benchmark::Counter(events, benchmark::Counter::kIsRate);
  state.counters["s_per_event"] =
      benchmark::Counter(events, benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
}

}  // namespace rips::bench

// Rules, a graph and a robot for benchmarks: the same ones for all of them.
#ifndef RIPS_TESTS_BENCH_WORLD_H_
#define RIPS_TESTS_BENCH_WORLD_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "benchmark/benchmark.h"
#include "policy_server/policy/engine/evaluator.h"
#include "policy_server/policy/lang/check/compile.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::bench {

inline constexpr int kTopics = 1'000;
inline constexpr char kType[] = "sensor_msgs/msg/LaserScan";
inline constexpr char kSender[] = "/navigator";

// Rule `i` asks for topics of robot `i` with at least two publishers.
std::string PatternOf(int rule);
// `count` of them. They apply to no topic of Topics().
std::vector<lang::SourceFile> TopicRules(int count);
// `count` rules of 13 nodes that all apply to kDrivenTopic and are false at the last operand, as
// NativeRules computes them in C++ (expression_bench.cc).
std::vector<lang::SourceFile> PlainRules(int count);
inline constexpr char kDrivenTopic[] = "/cmd_vel";
// A topic on which rule 7 of TopicRules fires.
inline constexpr char kGuardedTopic[] = "/robot_00007/camera/image_raw";

// kTopics names.
std::vector<std::string> Topics();
// Indices below kTopics; the k-th is drawn about 1/k times as often as the first. The same at each
// call.
std::vector<uint32_t> ZipfDraws();
// The writer on topic `index` of Topics().
ros2::Guid WriterOf(size_t index);
// One publisher for each of Topics() and for kDrivenTopic, two for kGuardedTopic.
ros2::GraphDelta GraphOfTopics();

// The rules must be right.
std::shared_ptr<const engine::CompiledPolicy> MakeProgram(
    const std::vector<lang::SourceFile>& files);
engine::RobotState MakeRobot(std::shared_ptr<const engine::CompiledPolicy> program);
Instant Now();
engine::Event MessageOn(absl::string_view topic, const ros2::Guid& writer = {});

// Calls of operator new of this thread so far.
uint64_t Allocations();
// Bytes in use, of whichever allocator call.
size_t BytesInUse();

// Events per second, and the nanoseconds of one.
void SetEvents(benchmark::State& state, int64_t per_iteration);

}  // namespace rips::bench

#endif  // RIPS_TESTS_BENCH_WORLD_H_

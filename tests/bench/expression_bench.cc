// Ten rules that apply: what their expressions cost beside the same ones in C++.
#include <array>
#include <utility>
#include <vector>

#include "tests/bench/world.h"

namespace rips::bench {
namespace {

constexpr int kRules = 10;

// What PlainRules looks at, already found out.
struct Facts {
  bool on_topic = true;
  int64_t publishers = 1;
  int64_t speed = 5'000;
  int64_t turns = 7'000;
  absl::string_view sender = kSender;
};

constexpr std::array<absl::string_view, kRules> kRogues = {
    "/rogue0000", "/rogue0001", "/rogue0002", "/rogue0003", "/rogue0004",
    "/rogue0005", "/rogue0006", "/rogue0007", "/rogue0008", "/rogue0009"};

// A function each: the engine's rules share nothing but their facts either.
template <int rule>
[[gnu::noinline]] bool NativeRule(const Facts& facts) {
  return facts.on_topic && facts.publishers >= 1 && facts.publishers <= 3 &&
         facts.speed + facts.turns > rule && facts.sender == kRogues[rule];
}

template <int... rules>
bool AnyNative(const Facts& facts, std::integer_sequence<int, rules...> /*all*/) {
  return (static_cast<int>(NativeRule<rules>(facts)) | ...) != 0;
}

void Native(benchmark::State& state) {
  Facts facts;
  for (auto _ : state) {
    benchmark::DoNotOptimize(&facts);
    benchmark::ClobberMemory();
    if (AnyNative(facts, std::make_integer_sequence<int, kRules>())) {
      state.SkipWithError("a rule fired that does not apply");
      break;
    }
  }
}
BENCHMARK(Native)->Name("P2/native");

// Events on `topic` under kRules rules.
void Engine(benchmark::State& state, const char* topic) {
  engine::RobotState robot = MakeRobot(MakeProgram(PlainRules(kRules)));
  engine::Event rogue = MessageOn(kDrivenTopic, WriterOf(kTopics));
  std::get<engine::MessageEvent>(rogue.what).sender = kRogues[0];
  const uint64_t counted = Allocations();
  if (engine::Evaluate(rogue, Now(), robot).fired != 1) {
    state.SkipWithError("the rules do not work");
  } else if (Allocations() == counted) {
    state.SkipWithError("allocations are not counted");
  }
  const engine::Event event = MessageOn(topic, WriterOf(kTopics));
  engine::Evaluate(event, Now(), robot);
  const uint64_t before = Allocations();
  for (auto _ : state) {
    const engine::Outcome outcome = engine::Evaluate(event, Now(), robot);
    if (outcome.fired != 0 || outcome.faults != 0 || outcome.undecidable != 0) {
      state.SkipWithError("a rule fired that does not apply");
      break;
    }
  }
  if (Allocations() != before) state.SkipWithError("rules that do not fire took heap memory");
}
BENCHMARK_CAPTURE(Engine, all_apply, kDrivenTopic)->Name("P2/engine_all_apply");
BENCHMARK_CAPTURE(Engine, none_applies, "/odom")->Name("P2/engine_none_applies");

}  // namespace
}  // namespace rips::bench

// A new policy: from its text to a robot that runs it.
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "tests/bench/world.h"

namespace rips::bench {
namespace {

void Reload(benchmark::State& state, std::vector<lang::SourceFile> (*rules)(int)) {
  const auto count = static_cast<int>(state.range(0));
  const std::vector<lang::SourceFile> files = rules(count);
  engine::RobotState robot = MakeRobot(MakeProgram(files));
  for (auto _ : state) {
    lang::CompileResult compiled = lang::Compile(files);
    if (!compiled.rules.has_value()) {
      state.SkipWithError("the rules do not compile");
      break;
    }
    auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules));
    if (!program.ok() || !robot.SwapProgram(*std::move(program)).ok()) {
      state.SkipWithError("the rules are not taken");
      break;
    }
  }
  const size_t before = BytesInUse();
  const std::shared_ptr<const engine::CompiledPolicy> another = MakeProgram(files);
  const size_t bytes = BytesInUse() - before;
  if (another->rules().rules.size() < static_cast<size_t>(count)) {
    state.SkipWithError("rules were lost");
  }
  state.counters["bytes_per_rule"] = static_cast<double>(bytes) / count;
}
BENCHMARK_CAPTURE(Reload, topic, &TopicRules)
    ->Name("P9/reload_topic_rules")
    ->Arg(1'000)
    ->Arg(10'000)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(Reload, plain, &PlainRules)
    ->Name("P9/reload_plain_rules")
    ->Arg(1'000)

    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace rips::bench

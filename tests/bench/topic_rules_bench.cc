// Many rules that ask for topics: what an event costs on which none of them applies, and what a
// topic costs that was never seen.
#include <algorithm>
#include <memory>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "re2/re2.h"
#include "tests/bench/world.h"

namespace rips::bench {
namespace {

bool Fires(engine::RobotState& robot, absl::string_view topic) {
  return engine::Evaluate(MessageOn(topic), Now(), robot).fired > 0;
}

std::vector<std::unique_ptr<const RE2>> Regexes(int count) {
  std::vector<std::unique_ptr<const RE2>> out;
  for (int i = 0; i < count; ++i) out.push_back(std::make_unique<const RE2>(PatternOf(i)));
  return out;
}

// The yardstick: the pattern of one rule, where it is found and where it is not. RE2 compares the
// literal beginning of a pattern first and stops there if it differs.
void Re2(benchmark::State& state, bool found) {
  const RE2 regex(PatternOf(7));
  const std::string topic = found ? kGuardedTopic : Topics()[0];
  for (auto _ : state) {
    if (RE2::PartialMatch(topic, regex) != found) {
      state.SkipWithError("a pattern gave the wrong answer");
      break;
    }
  }
}
BENCHMARK_CAPTURE(Re2, found, true)->Name("P1/re2_found");
BENCHMARK_CAPTURE(Re2, not_found, false)->Name("P1/re2_not_found");

void NoneApplies(benchmark::State& state) {
  engine::RobotState robot = MakeRobot(MakeProgram(TopicRules(static_cast<int>(state.range(0)))));
  const std::vector<std::string> topics = Topics();
  std::vector<engine::Event> events;
  for (size_t i = 0; i < topics.size(); ++i) events.push_back(MessageOn(topics[i], WriterOf(i)));
  const std::vector<uint32_t> draws = ZipfDraws();
  if (!Fires(robot, kGuardedTopic)) state.SkipWithError("the rules do not work");
  for (const engine::Event& event : events) engine::Evaluate(event, Now(), robot);
  size_t at = 0;
  const uint64_t before = Allocations();
  for (auto _ : state) {
    const engine::Outcome outcome = engine::Evaluate(events[draws[at]], Now(), robot);
    if (outcome.fired != 0 || outcome.faults != 0) {
      state.SkipWithError("a rule fired that does not apply");
      break;
    }
    at = (at + 1) % draws.size();
  }
  if (Allocations() != before) state.SkipWithError("an event that fires nothing took heap memory");
}
BENCHMARK(NoneApplies)->Name("P1/none_applies")->Arg(100)->Arg(1'000)->Arg(10'000);

// Every event is on a topic with a name of its own, as an attacker would make them up.
void NewTopics(benchmark::State& state) {
  engine::RobotState robot = MakeRobot(MakeProgram(TopicRules(static_cast<int>(state.range(0)))));
  int name = 0;
  for (auto _ : state) {
    if (Fires(robot, absl::StrCat("/robot_made_up_", name++))) {
      state.SkipWithError("a rule fired that does not apply");
      break;
    }
  }
  if (!Fires(robot, kGuardedTopic)) state.SkipWithError("the rules no longer work");
}
BENCHMARK(NewTopics)->Name("P1/new_topic")->Arg(100)->Arg(1'000)->Arg(10'000);

// So many names that all is forgotten several times; what is kept of them meanwhile.
void Flood(benchmark::State& state) {
  const auto names = static_cast<int>(state.range(1));
  engine::RobotState robot = MakeRobot(MakeProgram(TopicRules(static_cast<int>(state.range(0)))));
  const size_t before = BytesInUse();
  size_t most = before;
  for (auto _ : state) {
    for (int name = 0; name < names; ++name) {
      if (Fires(robot, absl::StrFormat("/robot_%d/made_up", 90'000 + name))) {
        state.SkipWithError("a rule fired that does not apply");
        break;
      }
      if (name % 64 == 0) most = std::max(most, BytesInUse());
    }
  }
  SetEvents(state, names);
  state.counters["bytes_max"] = static_cast<double>(most - before);
  if (!Fires(robot, kGuardedTopic)) state.SkipWithError("the rules no longer work");
}
BENCHMARK(Flood)
    ->Name("P1/flood")
    ->Args({1'000, 4'000})
    ->Args({1'000, 100'000})
    ->Iterations(1)
    ->Unit(benchmark::kMillisecond);

// A new topic without RE2::Set: the patterns one by one.
void OneByOne(benchmark::State& state) {
  const auto regexes = Regexes(static_cast<int>(state.range(0)));
  int name = 0;
  for (auto _ : state) {
    const std::string topic = absl::StrCat("/robot_made_up_", name++);
    for (const std::unique_ptr<const RE2>& regex : regexes) {
      if (RE2::PartialMatch(topic, *regex)) {
        state.SkipWithError("a pattern was found that is not there");
        break;
      }
    }
  }
}
BENCHMARK(OneByOne)->Name("P1/new_topic_one_by_one")->Arg(100)->Arg(1'000)->Arg(10'000);

}  // namespace
}  // namespace rips::bench

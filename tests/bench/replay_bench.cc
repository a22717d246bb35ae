// A recording in memory, replayed.
#include <optional>
#include <vector>

#include "policy_server/policy/replay/replayer.h"
#include "tests/bench/world.h"

namespace rips::bench {
namespace {

using recording::Recorded;

constexpr size_t kEvents = 20'000;

class MemoryReader final : public recording::Reader {
 public:
  explicit MemoryReader(const std::vector<Recorded>& events) : events_(events) {}

  bool has_graph() const override { return true; }

 private:
  absl::StatusOr<std::optional<Recorded>> Read() override {
    if (next_ == events_.size()) return std::nullopt;
    return events_[next_++];
  }

  const std::vector<Recorded>& events_;  // Not owned; outlives this.
  size_t next_ = 0;
};

std::vector<Recorded> Recording() {
  const std::vector<std::string> topics = Topics();
  const std::vector<uint32_t> draws = ZipfDraws();
  std::vector<Recorded> events;
  events.push_back({.what = recording::RecordedGraph{
                        .content = GraphOfTopics(), .whole = true, .settled = true}});
  for (size_t i = 1; i < kEvents; ++i) {
    const uint32_t topic = draws[i % draws.size()];
    events.push_back({.index = i,
                      .time_unix_ns = Now().unix_ns + static_cast<int64_t>(i) * kNanosPerMilli,
                      .what = recording::RecordedMessage{.topic = topics[topic],
                                                         .type = kType,
                                                         .sender = kSender,
                                                         .writer = WriterOf(topic),
                                                         .size_bytes = 1'024}});
  }
  events[0].time_unix_ns = Now().unix_ns;
  return events;
}

void Replay(benchmark::State& state) {
  const auto program = MakeProgram(TopicRules(static_cast<int>(state.range(0))));
  const std::vector<Recorded> events = Recording();
  for (auto _ : state) {
    MemoryReader reader(events);
    const auto result = replay::Replay(reader, program, {}, nullptr);
    if (!result.ok() || !result->alerts.empty()) {
      state.SkipWithError("the recording was not replayed");
      break;
    }
  }
  SetEvents(state, kEvents);
}
BENCHMARK(Replay)->Name("replay/events")->Arg(100)->Arg(1'000)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace rips::bench

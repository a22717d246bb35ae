// Rules and recordings in memory. Test code only.
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_REPLAY_TEST_DATA_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_REPLAY_TEST_DATA_H_

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "gmock/gmock.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/policy/replay/replayer.h"
#include "services/base/check.h"
#include "services/base/status_matchers.h"

namespace rips::replay {

using recording::Recorded;
using recording::RecordedGraph;
using recording::RecordedMessage;

constexpr char kLevels[] = "levels: A; B soft; C soft; D;\n";

// The rules after `kLevels`; warnings do not matter, nor that a level is never reached.
inline std::shared_ptr<const engine::CompiledPolicy> MakeProgram(
    const std::string& rules, engine::CompiledPolicyOptions options = {},
    lang::CheckedRules::Dialect dialect = lang::CheckedRules::Dialect::kRips) {
  const std::vector<lang::SourceFile> files = {
      {.path = "t.rul",
       .text = absl::StrCat(kLevels, rules,
                            "\nrules External: hatch: false ? trigger(A), trigger(B), "
                            "trigger(C), trigger(D);\n")}};
  lang::CompileResult compiled = lang::Compile(files, {.dialect = dialect});
  EXPECT_TRUE(compiled.rules.has_value()) << lang::RenderText(files, compiled.diagnostics);
  RIPS_CHECK(compiled.rules.has_value(), "rules of a test compile");
  auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules), options);
  EXPECT_THAT(program, IsOk());
  return *std::move(program);
}

// Gives the events of a vector, numbered, then the status.
class FakeReader final : public recording::Reader {
 public:
  explicit FakeReader(std::vector<Recorded> events, bool has_graph = true,
                      absl::Status end = absl::OkStatus())
      : events_(std::move(events)), has_graph_(has_graph), end_(std::move(end)) {}

  bool has_graph() const override { return has_graph_; }
  const recording::RecordedOrigin* origin() const override {
    return robot.robot.empty() ? nullptr : &robot;
  }

  recording::RecordedOrigin robot;

 private:
  absl::StatusOr<std::optional<Recorded>> Read() override {
    if (next_ < events_.size()) return events_[next_++];
    if (!end_.ok()) return end_;
    return std::nullopt;
  }

  std::vector<Recorded> events_;
  size_t next_ = 0;
  bool has_graph_;
  absl::Status end_;
};

template <typename What>
Recorded Event(What what, std::optional<int64_t> time_ms = std::nullopt) {
  Recorded event;
  event.what = std::move(what);
  if (time_ms.has_value()) event.time_unix_ns = *time_ms * kNanosPerMilli;
  return event;
}
inline Recorded Signal(std::optional<int64_t> time_ms = std::nullopt) {
  return Event(model::SignalSeen{.name = "SIGUSR1"}, time_ms);
}
inline Recorded Message(const std::string& topic, const std::string& sender = "",
                        std::optional<int64_t> time_ms = std::nullopt) {
  return Event(RecordedMessage{.topic = topic,
                               .type = "std_msgs/msg/String",
                               .sender = sender,
                               .payload = "\1\2\3\4",
                               .size_bytes = 4},
               time_ms);
}

inline ros2::Guid ParticipantGuid(uint8_t number) {
  ros2::Guid guid;
  guid.bytes[0] = number;
  return guid.Participant();
}
inline ros2::Guid WriterGuid(uint8_t participant) {
  ros2::Guid guid = ParticipantGuid(participant);
  guid.bytes[12] = guid.bytes[13] = 0;
  guid.bytes[14] = 1;
  guid.bytes[15] = 3;
  return guid;
}

// Nodes that publish on /t, participants numbered from 1.
inline RecordedGraph Graph(const std::vector<std::string>& nodes, bool whole = true,
                           bool settled = true, uint8_t first = 1) {
  RecordedGraph graph{.whole = whole, .settled = settled};
  for (const std::string& node : nodes) {
    graph.content.upsert_participants.push_back({.guid = ParticipantGuid(first)});
    graph.content.upsert_nodes.push_back(
        {.full_name = node, .participant = ParticipantGuid(first)});
    graph.content.upsert_endpoints.push_back({.guid = WriterGuid(first),
                                              .kind = ros2::EndpointKind::kPublisher,
                                              .name = "/t",
                                              .type = "std_msgs/msg/String",
                                              .node = node});
    ++first;
  }
  return graph;
}

inline Result Replayed(const std::shared_ptr<const engine::CompiledPolicy>& program,
                       std::vector<Recorded> events, ReplayOptions options = {},
                       bool has_graph = true, inspect::Session* session = nullptr) {
  FakeReader reader(std::move(events), has_graph);
  absl::StatusOr<Result> result = Replay(reader, program, std::move(options), session);
  EXPECT_THAT(result, IsOk());
  return result.ok() ? *std::move(result) : Result();
}

// "3 rule text" of each alert.
inline std::vector<std::string> Alerts(const Result& result) {
  std::vector<std::string> out;
  for (const Alerted& alert : result.alerts) {
    out.push_back(absl::StrCat(alert.at.event, " ", alert.rule, " ", alert.text));
  }
  return out;
}
// "3 rule A->B" or "3 rule A->B refused: why".
inline std::vector<std::string> Transitions(const Result& result) {
  std::vector<std::string> out;
  for (const Changed& change : result.transitions) {
    out.push_back(absl::StrCat(change.at.event, " ", change.rule, " ", change.from, "->", change.to,
                               change.refused ? absl::StrCat(" refused: ", change.reason) : ""));
  }
  return out;
}
inline std::vector<std::string> Execs(const Result& result) {
  std::vector<std::string> out;
  for (const Executed& exec : result.execs) {
    out.push_back(absl::StrCat(exec.at.event, " ", exec.rule, " ", exec.program, "(",
                               absl::StrJoin(exec.args, ","), ") ", exec.ok ? "ok" : "failed"));
  }
  return out;
}

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_REPLAY_TEST_DATA_H_

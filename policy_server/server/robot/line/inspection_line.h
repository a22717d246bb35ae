// The message lane of a robot's sensors: batches wait here, in order, until each message of the
// first has been inspected and the graph is in force under which it was taken. The control lane
// never waits. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_INSPECTION_LINE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_INSPECTION_LINE_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "policy_server/policy/engine/evaluator.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/line/former_graph.h"
#include "policy_server/server/robot/line/graph_history.h"
#include "policy_server/server/robot/line/waiting_batches.h"
#include "policy_server/server/robot/sensors/losses.h"
#include "policy_server/server/robot/sensors/sensor_host.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it. `host` is the one of the first batch.
class InspectionLine {
 public:
  InspectionLine(Context* context, Losses* losses, engine::RobotState* state)
      : context_(*context), losses_(*losses), state_(*state) {}

  void Push(WaitingBatch batch);
  void Clear() { batches_.clear(); }
  // The first batch may go on; false: it waits for a graph or for inspections, or there is none.
  bool ready() const { return ready_ && !batches_.empty(); }
  // What the first batch waits for may have come: the graph, the time, a policy, the session's end.
  void Wake() { ready_ = true; }
  void OnInspected(const input::Inspected& in);

  // All three: ready(). The batch that is being judged.
  const WaitingBatch& first() const { return batches_.front().waiting; }
  // Asks for inspections, as far as messages know their graph, and gives what can be judged now,
  // which counts as judged; nullopt: nothing yet.
  std::optional<Piece> Next(const SensorHost& host);
  void Pop() { batches_.pop_front(); }

  // The host's graph is in force from now on.
  void OnGraph(const SensorHost& host);
  // Drops graphs that no message names any more.
  void Expire(bool backlog) { history_.Expire(context_.now_ns(), backlog); }
  // Against which graph a message of the batch is judged.
  GraphHistory::Choice Choose(const SensorHost& host, const Batch& batch,
                              const MessageSeen& message);
  // The event of a message that is judged against the graph that was chosen for it.
  static engine::MessageEvent EventOf(const MessageSeen& message,
                                      const GraphHistory::Choice& choice);
  // What to know of a message that was not given the graph of its time; empty: it was.
  std::string Remark(const MessageSeen& message, const GraphHistory::Choice& choice) const;

 private:
  struct Entry {
    WaitingBatch waiting;
    int64_t arrived_ns = 0;
    uint64_t ticket = 0;
    // The graph that it brings is in use.
    bool has_graph = false;
    // Under which it was asked.
    std::shared_ptr<const engine::CompiledPolicy> program;
    // As in Piece.
    std::vector<std::vector<engine::Verdict>> verdicts;
    // Observations before this one have been asked for, if they need it.
    size_t asked = 0;
    // Answers that have not come.
    size_t unanswered = 0;
  };
  // How many observations can be judged.
  size_t Ask(Entry& entry, const SensorHost& host);
  void AskOne(Entry& entry, const SensorHost& host, size_t index, std::vector<uint32_t> needed);
  // The message has a graph, or has waited for one long enough.
  bool KnowsGraph(const Entry& entry, const SensorHost& host, const MessageSeen& message);

  Context& context_;
  Losses& losses_;
  engine::RobotState& state_;
  std::deque<Entry> batches_;
  uint64_t last_ticket_ = 0;
  bool ready_ = false;
  GraphHistory history_;
  FormerGraph former_{FormerGraph::kOfMessages};
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_INSPECTION_LINE_H_

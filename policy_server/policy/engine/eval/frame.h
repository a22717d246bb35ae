// One event under one program: sets up what its expressions are evaluated on.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_EVAL_FRAME_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_EVAL_FRAME_H_

#include <cstdint>
#include <memory>

#include "policy_server/policy/engine/eval/evaluation.h"
#include "policy_server/policy/engine/state/internal.h"

namespace rips::engine {

// Borrows all it is given; lives for one call.
class Frame {
 public:
  // `program` is the one in force, or that of `parked`, the chain that goes on (else null).
  // `cache`: what is remembered of topics and graph under the program in force; null: nothing.
  Frame(const RobotState& state, const std::shared_ptr<const CompiledPolicy>& program,
        const Event& event, int64_t time_ns, Instant now, TopicCache* cache,
        const ParkedChain* parked = nullptr);
  Frame(const Frame&) = delete;
  Frame& operator=(const Frame&) = delete;

  // For one evaluation: the level goes on meanwhile. `level` is of the table in force. What was
  // evaluated before is no longer valid.
  Evaluation& Enter(const lang::TypedRule& rule, levels::LevelIndex level);

  const CompiledPolicy& program() const { return *program_; }
  const std::shared_ptr<const CompiledPolicy>& shared_program() const { return program_; }
  const ParkedChain* parked() const { return parked_; }
  const Event& event() const { return event_; }
  int64_t time_ns() const { return run_.time_ns; }
  // Null if the event is no message or nothing is remembered.
  const TopicEntry* topic() const { return run_.topic; }
  bool in_force() const { return in_force_; }
  // Nodes evaluated.
  uint64_t steps() const { return run_.steps; }

 private:
  // Of `program`, which is not in force.
  Variables FindVariables() const;

  const RobotState& state_;
  const std::shared_ptr<const CompiledPolicy>& program_;
  const Event& event_;
  const ParkedChain* parked_;
  bool in_force_;
  // Of a message on a topic that is not remembered.
  std::vector<absl::string_view> types_;
  Evaluation run_;
  // That run_.level and run_.level_name are of; none before the first Enter.
  levels::LevelIndex entered_ = -1;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_EVAL_FRAME_H_

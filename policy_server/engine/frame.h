// One event under one program: what its expressions are evaluated on.
#ifndef RIPS_POLICY_SERVER_ENGINE_FRAME_H_
#define RIPS_POLICY_SERVER_ENGINE_FRAME_H_

#include <cstdint>
#include <memory>

#include "absl/container/inlined_vector.h"
#include "policy_server/engine/compiled.h"
#include "policy_server/engine/event.h"
#include "policy_server/engine/expression.h"
#include "policy_server/engine/internal.h"
#include "policy_server/engine/robot_state.h"

namespace rips::engine {

// Borrows all it is given; lives for one call.
class Frame {
 public:
  // `program` is the one in force, or that of `parked`, the chain that goes on (else null).
  Frame(const RobotState& state, std::shared_ptr<const Program> program, const Event& event,
        int64_t time_ns, const ParkedChain* parked);
  Frame(const Frame&) = delete;
  Frame& operator=(const Frame&) = delete;

  // For one evaluation: the level and the clock go on meanwhile. `level` is of the table in force.
  Context For(const lang::TypedRule& rule, levels::LevelIndex level, Instant now) const;

  const Program& program() const { return *program_; }
  const std::shared_ptr<const Program>& shared_program() const { return program_; }
  const ParkedChain* parked() const { return parked_; }
  const Event& event() const { return event_; }
  int64_t time_ns() const { return time_ns_; }
  const Scene& scene() const { return scene_; }
  bool in_force() const { return in_force_; }
  // Answers topic predicates from now on.
  void set_verdict(const TopicVerdict* verdict) { verdict_ = verdict; }

 private:
  Variables FindVariables() const;
  void Look(const MessageEvent& message);

  const RobotState& state_;
  std::shared_ptr<const Program> program_;
  const Event& event_;
  int64_t time_ns_;
  const ParkedChain* parked_;
  bool in_force_;
  Variables variables_;
  absl::InlinedVector<absl::string_view, 4> types_;
  Scene scene_;
  const TopicVerdict* verdict_ = nullptr;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_ENGINE_FRAME_H_

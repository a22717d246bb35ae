// Runs rules and chains of one robot, for one call of the evaluator.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_CHAINS_CHAINS_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_CHAINS_CHAINS_H_

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "policy_server/policy/engine/eval/frame.h"
#include "policy_server/policy/engine/state/effect.h"
#include "policy_server/policy/engine/state/internal.h"
#include "policy_server/policy/engine/state/robot_state.h"

namespace rips::engine {

// A parked chain and what it was told.
struct Answered {
  std::unique_ptr<ParkedChain> chain;
  bool ok = false;
};

// What a chain that asked for a level is told now: true, false, or nothing yet.
std::optional<bool> AnswerOf(levels::LevelIndex wants, bool lowering, const RobotState& state);

// Borrows all it is given, for its life.
class Runner {
 public:
  Runner(const Instant& now, RobotState& state, Outcome& outcome)
      : now_(now), state_(state), in_(state.internal()), outcome_(outcome) {}

  // Every rule of the event's class.
  void Run(const Event& event);
  // Lets them go on, in order.
  void Resume(std::vector<Answered> answered);

 private:
  enum class Step { kSucceeded, kFailed, kParked };

  // The rule under evaluation.
  struct Current {
    Frame& frame;
    uint32_t rule_index;
    const lang::TypedRule& rule;
    bool faulted = false;
    // It fired though an inspection was not told.
    bool unscanned = false;
    // What was left out of the graph may turn its value.
    bool graph_open = false;
    // Why it faulted first.
    std::string fault = {};
    SharedTrace trace = {};
  };

  void RunRule(Frame& frame, uint32_t index);
  void RunChain(Current& current, uint32_t chain, size_t action);
  Step Act(Current& current, uint32_t chain, size_t index);
  Step Alert(Current& current, const lang::TypedAction& action);
  Step Set(Current& current, const lang::TypedAction& action);
  Step Exec(Current& current, uint32_t chain, size_t index);
  Step Trigger(Current& current, uint32_t chain, size_t index);
  Step Debug(Current& current, const lang::TypedAction& action);
  Step Crash(Current& current, const lang::TypedAction& action);

  bool Fires(Current& current);
  // Nullopt on a fault, which has then been reported.
  std::optional<lang::Value> Arg(Current& current, const lang::TypedExpr& arg);
  std::optional<std::string> TextArg(Current& current, const lang::TypedExpr& arg);
  // The level that `trigger` names, in the table in force.
  std::optional<levels::LevelIndex> LevelArg(Current& current, const lang::TypedExpr& arg);

  void ReportFault(Current& current, absl::string_view what, absl::string_view consequence);
  void ReportFull(const Current& current);
  void NoteCut(const Current& current, const Evaluation& run);
  void Tell(const Current& current, RuleObserver::RuleResult came, absl::string_view what = {});
  void Refuse(const Current& current, levels::Transition transition);
  // Built in place: assigning a variant makes gcc 12 warn of what is not so.
  template <typename What>
  void Add(What effect) {
    outcome_.effects.emplace_back(std::in_place_type<What>, std::move(effect));
  }
  void Raise(const Current& current, Severity severity, std::string text);
  std::unique_ptr<ParkedChain> MakeParked(const Current& current, uint32_t chain, size_t index);
  bool Full() const { return in_.parked.size() >= in_.limits.parked_max; }

  const Instant& now_;
  RobotState& state_;
  // A rule has changed the level since this was made.
  bool decided_ = false;
  RobotState::Internal& in_;
  Outcome& outcome_;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_CHAINS_CHAINS_H_

// The alerts of one robot: admitted by their limits, cut, stamped with the level and a maintenance,
// and handed to the outbox. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ALERTS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ALERTS_H_

#include <optional>
#include <source_location>
#include <string>

#include "policy_server/policy/engine/state/effect.h"
#include "policy_server/policy/levels/level_machine.h"
#include "policy_server/server/robot/context/alert_limiter.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/durable_outbox.h"
#include "policy_server/server/robot/context/maintenance_window.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Alerts {
 public:
  Alerts(Context* context, DurableOutbox* outbox, const levels::LevelMachine* level,
         const MaintenanceWindow* maintenance)
      : context_(*context), outbox_(*outbox), level_(*level), maintenance_(*maintenance) {}

  // RIPS's own. What one place in the code says is one kind, for the limit.
  void Raise(engine::Severity severity, const std::string& text,
             std::source_location where = std::source_location::current());
  // The same of a kind that is given; `event`: what it was raised for, may be empty. False: it was
  // folded away.
  bool RaiseOfKind(const std::string& kind, engine::Severity severity, const std::string& text,
                   const std::string& event = "", engine::SharedTrace trace = nullptr);
  // Alerts of that kind that were folded away, if their summary is due. The caller raises it.
  std::optional<FoldedAlerts> PopFolded(const std::string& kind) {
    return own_.Pop(kind, context_.now());
  }
  // As of the last one that was folded away, with these words; no limit holds.
  void RaiseFolded(FoldedAlerts folded, const std::string& text, const std::string& event,
                   engine::SharedTrace trace = nullptr);
  // RIPS's own, that an agent is absent: high, but info, with the reason, in a maintenance. Those
  // of a maintenance are a kind of their own: they use up no rate of those after it.
  void RaiseAbsence(const std::string& text,
                    std::source_location where = std::source_location::current());
  // A rule's.
  void RaiseOfRule(const engine::AlertEffect& alert, const std::string& event);
  // What limits have folded away and is due.
  void Summarize();

 private:
  void Add(engine::AlertEffect alert, const std::string& event);

  Context& context_;
  DurableOutbox& outbox_;
  const levels::LevelMachine& level_;
  const MaintenanceWindow& maintenance_;
  AlertLimiter rules_;
  AlertLimiter own_{kOwnAlertLimits};
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ALERTS_H_

// Lowerings that need a second operator (Policy::two_person), and those that wait for one. A
// restart forgets them: the robot's decision is another one then. Pure.
//
//   one that waits ends by                     then
//   the approval of another identity           it is decided
//   a rejection, also by who asked             nothing is decided
//   another request of who asked               only the newer one waits
//   a ban of who asked                         nothing is decided
//   another decision or bundle                 nothing is decided: neither of the two saw that
//   a rule that asks for a level above `to`    nothing is decided, even if the robot is there
//   a graph on which a rule would do so, and   nothing is decided: the robot is another one than
//   did not when it was asked, or on which     the first operator saw
//   others publish a topic that rules name
//   any other graph                            it waits; the second operator is told the difference
//                                              (GraphChanges), and must accept it
//   kApprovalNs                                nothing is decided
//
// Whether the certificate of who asked counts yet is for the caller to know (Requesters).
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_APPROVALS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_APPROVALS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/policy/levels/level_table.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/model/level_order.h"
#include "services/base/clock.h"
#include "services/base/decision_id.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Approvals {
 public:
  static constexpr int64_t kApprovalNs = 600 * kNanosPerSecond;
  // One for each operator; one more is refused.
  static constexpr size_t kPendingMax = 16;

  Approvals(Context* context, const engine::RobotState* state, Alerts* alerts)
      : context_(*context), state_(*state), alerts_(*alerts) {}

  // A lowering to `to` leaves a level that says so, or goes past one.
  bool Needed(levels::LevelIndex to) const;
  // The order waits from now on, or still, if it asks for the same again; another one of the same
  // identity does no more. `answer` is told its id. ResourceExhausted past kPendingMax.
  void Ask(const LevelOrder& order, LevelAnswer& answer);
  // The lowering that `approval` is about, which goes on waiting. NotFound; FailedPrecondition: it
  // has ended just now.
  absl::StatusOr<LevelOrder> Find(const ApprovalOrder& approval);
  // How the graph differs from the one that who asked saw; of a lowering that waits. At most
  // kChangesMax, printable; empty = it does not.
  std::vector<std::string> ChangesSince(absl::string_view id) const;
  // It waits no more.
  void Remove(absl::string_view id);
  // Ends what may not be approved any more, each with an alert.
  void Expire() { End(""); }
  // Ends what an operator asked for who is banned by now, with an alert.
  void EndOf(absl::string_view identity);
  // Oldest first.
  std::vector<PendingApproval> pending() const;

 private:
  // The robot as the first operator saw it.
  struct Seen {
    DecisionId decision_id;
    engine::CurrentGraph::Version graph;
    // Rules that would ask for a level above the one to lower to.
    std::vector<std::string> would_raise;
    std::string bundle_id;
    absl::btree_map<levels::LevelIndex, engine::LevelRequests> level_requests;
  };
  struct Pending {
    std::string id;
    LevelOrder order;
    Seen seen;
    Instant asked;
  };

  Seen Now(const LevelOrder& order) const;
  // What the graph has that speaks against the lowering and was not there; empty = nothing.
  std::string GraphSince(const Pending& pending) const;
  // Why it may not be approved any more; empty = it may.
  std::string WhyOver(const Pending& pending) const;
  // Which rule has asked for a level above the one to lower to, while the bundle was the one that
  // was seen; empty = none.
  std::string RuleSince(const Pending& pending) const;
  // An alert, of which each operator has a limit of their own: none hides another's requests.
  void Report(const LevelOrder& asked, engine::Severity severity, const std::string& text);
  // Says so; the caller removes it.
  void ReportEnd(const Pending& pending, absl::string_view why);
  // Why the lowering of that id has ended just now; empty = it has not.
  std::string End(absl::string_view id);

  Context& context_;
  const engine::RobotState& state_;
  Alerts& alerts_;
  // Oldest first.
  std::vector<Pending> pending_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_APPROVALS_H_

#include "mode_actuator/steps/system_mode/direct_modes.h"

#include <algorithm>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/base/status_macros.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {
namespace {

// configure, then activate.
constexpr int kTransitionsMax = 2;
// Between an order and the look whether it was carried out.
constexpr absl::Duration kSettlePeriod = absl::Milliseconds(10);

absl::Status OrderNode(NodeClient& node, const ExpectedPart& expected, const NodeView& view) {
  uint8_t state = view.state;
  for (int i = 0; i < kTransitionsMax; ++i) {
    const uint8_t transition = NextTransition(state, expected.state);
    if (transition == 0) break;
    // Not active before it has the values of its mode.
    if (transition == kTransitionActivate) {
      RIPS_RETURN_IF_ERROR(node.SetParameters(expected.parameters));
    }
    RIPS_RETURN_IF_ERROR(node.Transition(transition));
    RIPS_ASSIGN_OR_RETURN(state, node.State());
  }
  if (state == kStateFinalized) {
    return absl::FailedPreconditionError("it is finalized; its process must be started again");
  }
  if (view.state_ok && !expected.parameters.empty()) {
    return node.SetParameters(expected.parameters);
  }
  return absl::OkStatus();
}

// What can be ordered of a node whose state is not known.
void OrderUnread(NodeClient& node, const ExpectedPart& expected) {
  // Whether it was heard is not known either.
  if (expected.state == PartState::kInactive) {
    node.Transition(kTransitionDeactivate).IgnoreError();
  } else if (!expected.parameters.empty()) {
    node.SetParameters(expected.parameters).IgnoreError();
  }
}

// One round over the nodes after the other.
class Rounds {
 public:
  Rounds(NodeClients& nodes, const Clock& clock, int64_t end_ns, const CancelFlag& cancel)
      : nodes_(nodes), clock_(clock), end_ns_(end_ns), cancel_(cancel) {}

  // Looks at all, and orders those that are wrong. Gives what was found wrong.
  std::vector<std::string> Go(std::vector<const ExpectedPart*> parts) {
    std::stable_sort(parts.begin(), parts.end(),
                     [this](const auto* a, const auto* b) { return Rank(*a) < Rank(*b); });
    std::vector<std::string> wrong;
    std::vector<std::pair<const ExpectedPart*, NodeView>> to_activate;
    for (const ExpectedPart* part : parts) {
      if (cancel_.cancelled()) break;
      NodeView view = nodes_.at(part->node)->Poll(*part);
      if (view.wrong.empty()) continue;
      const auto why = refusals_.find(part->node);
      wrong.push_back(why == refusals_.end() ? view.wrong
                                             : absl::StrCat(view.wrong, " (", why->second, ")"));
      if (view.ambiguous && !view.answers) {
        OrderAll(*part);
      } else if (!view.answers) {
        slow_.insert(part->node);
      } else if (part->state == PartState::kActive && !view.state_ok) {
        to_activate.emplace_back(part, std::move(view));
      } else {
        Order(*part, view);
      }
    }
    for (const auto& [part, view] : to_activate) Order(*part, view);
    return wrong;
  }
  bool failing() const { return !refusals_.empty() || !slow_.empty() || !unread_ns_.empty(); }

 private:
  int Rank(const ExpectedPart& part) const {
    return (slow_.contains(part.node) ? 2 : 0) + (part.state == PartState::kActive ? 1 : 0);
  }
  void OrderAll(const ExpectedPart& part) {
    const int64_t now_ns = clock_.Now().boottime_ns;
    const auto [last_ns, is_first] = unread_ns_.try_emplace(part.node, now_ns);
    if (!is_first && now_ns - last_ns->second < absl::ToInt64Nanoseconds(kBlindPeriod)) return;
    last_ns->second = now_ns;
    OrderUnread(*nodes_.at(part.node), part);
  }
  void Order(const ExpectedPart& part, const NodeView& view) {
    if (cancel_.cancelled() || clock_.Now().boottime_ns >= end_ns_) return;
    const absl::Status status = OrderNode(*nodes_.at(part.node), part, view);
    refusals_.erase(part.node);
    if (!status.ok()) refusals_[part.node] = std::string(status.message());
    if (absl::IsDeadlineExceeded(status)) slow_.insert(part.node);
  }

  NodeClients& nodes_;
  const Clock& clock_;
  const int64_t end_ns_;
  const CancelFlag& cancel_;
  absl::btree_map<std::string, std::string> refusals_;  // why the last order failed
  std::set<std::string> slow_;
  absl::btree_map<std::string, int64_t> unread_ns_;  // when OrderAll ordered it last
};

}  // namespace

std::string JoinParts(const std::vector<std::string>& parts) {
  const size_t shown = std::min(parts.size(), kDetailPartsMax);
  std::string text = absl::StrJoin(parts.begin(), parts.begin() + shown, ", ");
  if (shown < parts.size()) absl::StrAppend(&text, " and ", parts.size() - shown, " more");
  return text;
}

absl::Status OrderNodes(NodeClients& nodes, const std::vector<ExpectedPart>& expected,
                        int64_t end_ns, const Clock& clock, const CancelFlag& cancel) {
  std::vector<const ExpectedPart*> parts;
  for (const ExpectedPart& part : expected) parts.push_back(&part);
  Rounds rounds(nodes, clock, end_ns, cancel);
  while (true) {
    const std::vector<std::string> wrong = rounds.Go(parts);
    if (cancel.cancelled()) return absl::CancelledError("cancelled");
    if (wrong.empty()) return absl::OkStatus();
    if (clock.Now().boottime_ns >= end_ns) return absl::DeadlineExceededError(JoinParts(wrong));
    // What was ordered is looked at soon; what failed is tried again after a while.
    cancel.WaitFor(rounds.failing() ? kReadPeriod : kSettlePeriod);
  }
}

}  // namespace rips::actuator

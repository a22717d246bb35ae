#include "policy_server/policy/engine/state/event.h"

#include "absl/strings/str_cat.h"

namespace rips::engine {
namespace {

std::string DescribeMessage(const MessageEvent& message) {
  const std::string from = message.sender.empty()
                               ? absl::StrCat("(unattributed ", ToString(message.writer), ")")
                               : std::string(message.sender);
  return absl::StrCat("message on ", message.topic, " from ", from);
}

// Not a function for the variant itself, to which each alternative converts: a kind that lacks here
// does not compile.
struct ExternalDescriber {
  std::string operator()(const model::IdsAlert& ids) const {
    return absl::StrCat("ids alert ", ids.gid, ":", ids.sid, " ", ids.message);
  }
  std::string operator()(const model::SignalSeen& signal) const {
    return absl::StrCat("signal ", signal.name);
  }
  std::string operator()(const AgentEvent& agent) const {
    return absl::StrCat(agent.agent, " ", agent.state);
  }
  std::string operator()(const model::Finding& finding) const {
    const std::string& about = finding.node.empty() ? finding.topic : finding.node;
    return absl::StrCat("finding ", finding.kind, about.empty() ? "" : ": ", about);
  }
  std::string operator()(const model::Loss& loss) const {
    const std::string of = loss.topic.empty() ? "" : absl::StrCat(" on ", loss.topic);
    return absl::StrCat("loss of ", loss.count, " events", of);
  }
  std::string operator()(const TickEvent&) const { return "tick"; }
};

}  // namespace

std::string Describe(const Event& event) {
  const auto* external = std::get_if<ExternalEvent>(&event.what);
  if (external != nullptr) return std::visit(ExternalDescriber(), *external);
  if (const auto* message = std::get_if<MessageEvent>(&event.what))
    return DescribeMessage(*message);
  return "graph change";
}

}  // namespace rips::engine

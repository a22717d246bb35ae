#include "policy_server/policy/engine/state/event.h"

#include "absl/strings/str_cat.h"

namespace rips::engine {
namespace {

struct Describer {
  std::string operator()(const MessageEvent& message) const {
    const std::string from = message.sender.empty()
                                 ? absl::StrCat("(unattributed ", ToString(message.writer), ")")
                                 : std::string(message.sender);
    return absl::StrCat("message on ", message.topic, " from ", from);
  }
  std::string operator()(const GraphEvent&) const { return "graph change"; }
  std::string operator()(const ExternalEvent& external) const {
    return std::visit(*this, external);
  }
  std::string operator()(const IdsEvent& ids) const {
    return absl::StrCat("ids alert ", ids.gid, ":", ids.sid, " ", ids.message);
  }
  std::string operator()(const SignalEvent& signal) const {
    return absl::StrCat("signal ", signal.name);
  }
  std::string operator()(const AgentEvent& agent) const {
    return absl::StrCat(agent.agent, " ", agent.state);
  }
  std::string operator()(const FindingEvent& finding) const {
    const std::string& about = finding.node.empty() ? finding.topic : finding.node;
    return absl::StrCat("finding ", finding.kind, about.empty() ? "" : ": ", about);
  }
  std::string operator()(const LossEvent& loss) const {
    const std::string of = loss.topic.empty() ? "" : absl::StrCat(" on ", loss.topic);
    return absl::StrCat("loss of ", loss.count, " events", of);
  }
  std::string operator()(const TickEvent&) const { return "tick"; }
};

}  // namespace

std::string Describe(const Event& event) { return std::visit(Describer(), event.what); }

}  // namespace rips::engine

#include "policy_server/ripsctl/robot/agent_contact_text.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace rips::ripsctl {
namespace {

bool Differs(const v1::AgentContact& agent, absl::string_view server_version) {
  return agent.heard_unix_ns() != 0 && !server_version.empty() && agent.version() != server_version;
}

}  // namespace

std::string AgoText(uint64_t ago_ms) {
  const uint64_t seconds = ago_ms / 1'000;
  constexpr uint64_t kMinute = 60;
  constexpr uint64_t kHour = 60 * kMinute;
  constexpr uint64_t kDay = 24 * kHour;
  if (seconds < 2 * kMinute) return absl::StrCat(seconds, " s ago");
  if (seconds < 2 * kHour) return absl::StrCat(seconds / kMinute, " min ago");
  if (seconds < 2 * kDay) return absl::StrCat(seconds / kHour, " h ago");
  return absl::StrCat(seconds / kDay, " d ago");
}

bool HasOtherVersion(const v1::RobotStatus& status, absl::string_view server_version) {
  return std::any_of(status.agents().begin(), status.agents().end(),
                     [&](const v1::AgentContact& agent) { return Differs(agent, server_version); });
}

std::string OldestContact(const v1::RobotStatus& status, absl::string_view server_version) {
  if (status.agents().empty()) return "";
  uint64_t oldest_ms = 0;
  bool never = false;
  for (const v1::AgentContact& agent : status.agents()) {
    oldest_ms = std::max(oldest_ms, agent.heard_ago_ms());
    never |= agent.heard_unix_ns() == 0;
  }
  return absl::StrCat(never ? "never" : AgoText(oldest_ms),
                      HasOtherVersion(status, server_version) ? "*" : "");
}

std::string AgentText(const v1::AgentContact& agent, absl::string_view server_version) {
  const std::string name = absl::StrCat(agent.role(), " ", agent.host(), ": ");
  if (agent.heard_unix_ns() == 0) return absl::StrCat(name, "not heard since the server's start");
  return absl::StrCat(
      name, "version ", agent.version().empty() ? "not given" : agent.version(),
      Differs(agent, server_version) ? absl::StrCat(" (the server's is ", server_version, ")") : "",
      ", heard ", AgoText(agent.heard_ago_ms()));
}

}  // namespace rips::ripsctl

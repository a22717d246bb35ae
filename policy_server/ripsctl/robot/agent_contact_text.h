// When a robot's agents were last heard, and their versions, as text.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_ROBOT_AGENT_CONTACT_TEXT_H_
#define RIPS_POLICY_SERVER_RIPSCTL_ROBOT_AGENT_CONTACT_TEXT_H_

#include <cstdint>
#include <string>

#include "absl/strings/string_view.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

// `3 s ago`, `5 min ago`, `2 h ago`, `2 d ago`, rounded down; seconds up to two minutes, minutes up
// to two hours, hours up to two days.
std::string AgoText(uint64_t ago_ms);

// An agent has said another version than the server's. False if one of both is not known.
bool HasOtherVersion(const v1::RobotStatus& status, absl::string_view server_version);

// Of the agent that was heard longest ago: `3 s ago`, `never`, empty without agents; with `*` at
// the end if HasOtherVersion.
std::string OldestContact(const v1::RobotStatus& status, absl::string_view server_version);

// `sensor base: version 0.9.0 (the server's is 0.1.0), heard 3 s ago`. Not escaped.
std::string AgentText(const v1::AgentContact& agent, absl::string_view server_version);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_ROBOT_AGENT_CONTACT_TEXT_H_

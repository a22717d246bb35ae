// Messages of OperatorService as the JSON that ripsctl promises. Output is ASCII; bytes that are
// not UTF-8 become U+FFFD. Marks are "term.epoch", or null when unset.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_JSON_VIEW_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_JSON_VIEW_H_

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "policy_server/ripsctl/cli/text_stream.h"
#include "rips/v1/observation.pb.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

using Json = nlohmann::ordered_json;

// {"role","host","version","heard","heard_ago_ms"}; the last two are null if it was not heard.
Json ToJson(const v1::AgentContact& agent);
// {"robot","decided_level","effective_level","stage","decision_id","bundle","degraded":[..],
// "degraded_cut","pending_approvals","agents":[..],"findings","findings_not_known"}; without the last
// three if the answer has none.
Json ToJson(const v1::Maintenance& maintenance);
Json ToJson(const v1::RobotStatus& status);
// {"id","robot","time","from","to","cause","reason","decision_id","refused","count","stage",
// "detail"}
Json ToJson(const v1::Transition& transition);
// {"id","time","robot","rule","severity","text","level","event","decision_id","subjects":[..]}
Json ToJson(const v1::Alert& alert);
// The same with "acknowledged": {"by","time","note"}, null if it is not.
Json AlertWithAck(const v1::Alert& alert);
Json ToJson(const v1::Acknowledgement& ack);
// {"name","role","guid","host","pid","address"}; pid is null when not known.
Json ToJson(const v1::Subject& subject);
// {"place","condition","values":[{"offset","length","depth","value"}],"subjects":[..],"event",
//  "event_time","bundle","cut"}
Json ToJson(const v1::Evidence& evidence);
// {"alert","transition","evidence","alerts":[..],"transitions":[..]}; null what is not there.
Json ToJson(const v1::ExplainResponse& response);
// {"id","from","to","decision_id","operator","reason","accept_blind","asked","expires"}
Json ToJson(const v1::PendingApproval& pending);
// {"status":{..},"levels":[{"name","soft","two_person"}],"last":transition or null,
//  "pending_approvals":[..],"rules_cannot_lower_because",
//  "lowering_rules":[{"rule","holds","evidence"}]}; null at the lowest level, or not known.
Json ToJson(const v1::GetLevelResponse& response);

// "publisher", "subscriber", "service", "client" or "unknown".
const char* KindName(v1::Endpoint::Kind kind);
// As hexadecimal digits; "invalid" if it is no GUID.
std::string GuidText(const std::string& bytes);
// `at TIME by WHO: NOTE`, escaped.
std::string AckText(const v1::Acknowledgement& ack);
// "3.17"; "-" when unset.
std::string DecisionIdText(const v1::DecisionId& decision_id);

// On one line.
void PrintJson(const Json& json, TextStream out);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_JSON_VIEW_H_

// The findings of a robot's sensors in an explanation: those that stand, and what is known of the
// one that an alert or a level change is about. What is not known never reads as "none stands".
#ifndef RIPS_POLICY_SERVER_RIPSCTL_EXPLAIN_FINDINGS_VIEW_H_
#define RIPS_POLICY_SERVER_RIPSCTL_EXPLAIN_FINDINGS_VIEW_H_

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/text_stream.h"
#include "policy_server/ripsctl/explain/explain_text.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

// Whether the finding that was recorded still stands; nothing if it was none.
void PrintFinding(const Explanation& explanation, TextStream out);
// What stands of the robot now, in brief.
void PrintFindingsNow(absl::string_view robot,
                      const absl::StatusOr<v1::GetCoverageResponse>& findings, TextStream out);

// {"kind","guid","node","topic","state","since","ended","not_known_because":[..]}; null if it was
// none.
Json FindingJson(const Explanation& explanation);
// {"total","kinds":[{"kind","count"}],"newest":[{"kind","guid","node","topic","detail","since",
// "subjects":[..]}],"not_known_because":[..]}; "total" is null if nothing is known.
Json FindingsJson(const absl::StatusOr<v1::GetCoverageResponse>& findings);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_EXPLAIN_FINDINGS_VIEW_H_

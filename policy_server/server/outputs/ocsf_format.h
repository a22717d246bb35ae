// Alerts as Detection Findings of OCSF 1.1 (class 2004), one JSON object each, in ASCII as
// FormatAlertLine. deploy/schema/ocsf-detection-finding.schema.json says what is written.
//
//   alert                        finding
//   id, rule, text               finding_info.uid, .title and .analytic.name, .desc and message
//   time                         time, in ms
//   severity info .. critical    severity_id 1 .. 5
//   robot                        resources[0]
//   subjects                     evidences: data, and process if its pid is known
//   level, decision_id, event    unmapped
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_OCSF_FORMAT_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_OCSF_FORMAT_H_

#include <string>

#include "policy_server/server/store/records.h"

namespace rips::outputs {

std::string FormatOcsf(const store::AlertRecord& alert);

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_OCSF_FORMAT_H_

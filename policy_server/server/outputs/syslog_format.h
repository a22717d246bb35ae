// Alerts as syslog messages (RFC 5424), framed by their length (RFC 6587 §3.4.1, RFC 5425 §4.3.1).
//
//   <83>1 2026-01-01T00:00:00.000000Z HOST rips - RULE [rips@32473 id=".." robot=".." rule=".."
//   severity=".." level=".." decision="3.17"] BOM MSG            (one line, a space before BOM)
//
// | severity of the alert | of syslog         |
// |-----------------------|-------------------|
// | critical              | 2 (Critical)      |
// | high                  | 3 (Error)         |
// | medium                | 4 (Warning)       |
// | low                   | 5 (Notice)        |
// | info                  | 6 (Informational) |
//
// The facility is 10 (security). MSGID has printable ASCII, each other byte of the rule's name as
// `_`, cut to 32. 32473 is the enterprise number for documentation (RFC 5612): RIPS has none.
//
// Text from a robot may be anything. In MSG (format text) and in the values `\` is doubled; control
// characters, and those that change the direction or the line, become `\uXXXX`; a byte that is not
// UTF-8 becomes U+FFFD. Format json is ASCII (FormatAlertLine). Nothing is cut; many receivers cut
// at 8 KiB (RFC 5425 §4.3.1). Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_SYSLOG_FORMAT_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_SYSLOG_FORMAT_H_

#include <string>

#include "absl/strings/string_view.h"
#include "policy_server/server/store/records.h"

namespace rips::outputs {

// `json` empty: format text; else the alert as FormatAlertLine writes it. `host`: HOSTNAME; what is
// not printable ASCII becomes `_`, and the empty text `-`.
std::string FormatSyslog(const store::AlertRecord& alert, absl::string_view host,
                         absl::string_view json);

// `LENGTH MESSAGE`.
std::string FrameSyslog(absl::string_view message);

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_SYSLOG_FORMAT_H_

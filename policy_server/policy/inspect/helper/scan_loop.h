// The scanner process: answers whether compiled YARA files match payloads.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_SCAN_LOOP_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_SCAN_LOOP_H_

#include "policy_server/policy/inspect/jail_spec.h"

namespace rips::inspect {

// Gives up its rights, loads the files of kRulesFd, closes kReportFd and answers until its standard
// input ends. It starts no process, so killing it is all. Messages that it cannot understand end
// it.
[[noreturn]] void RunScanner(const JailSpec& spec);

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_SCAN_LOOP_H_

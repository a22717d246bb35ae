// rips-scan: looks for YARA rules in payloads for rips-policy-server and ripsctl, in a process that
// can do nothing else and may be killed at any time.
#include "policy_server/policy/inspect/helper/scan_loop.h"
#include "policy_server/policy/inspect/jail_spec.h"

int main(int argc, char** argv) {
  rips::inspect::JailSpec spec;
  rips::inspect::BeginJail(argc, argv, &spec);
  rips::inspect::RunScanner(spec);
}

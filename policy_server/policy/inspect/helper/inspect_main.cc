// rips-inspect: runs a plugin for rips-policy-server and ripsctl so that it can do nothing but look
// at payloads, and that nothing of it outlives it.
#include "policy_server/policy/inspect/helper/jail.h"
#include "policy_server/policy/inspect/jail_spec.h"

int main(int argc, char** argv) {
  rips::inspect::JailSpec spec;
  rips::inspect::BeginJail(argc, argv, &spec);
  rips::inspect::RunJailed(spec);
}

// The commands of ripsctl, file by file.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_COMMANDS_H_
#define RIPS_POLICY_SERVER_RIPSCTL_COMMANDS_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

Commands RobotCommands();        // list, watch, show, graph
Commands ConfigCommands();       // robot config
Commands CoverageCommands();     // robot interest, robot coverage
Commands ActuatorCommands();     // robot receipts, robot drill
Commands MaintenanceCommands();  // robot maintenance
Commands TopCommand();
Commands LevelCommands();           // show, history, raise, lower
Commands ApproveCommands();         // level approve
Commands AlertCommands();           // list, watch, ack
Commands AlertRecordingCommands();  // alert recording
Commands ExplainCommands();
Commands CheckRules();
Commands FormatRules();
Commands RulesBuiltins();
Commands TestRules();
Commands ReplayRules();
Commands SignRules();
Commands PushRules();      // push, list
Commands ActivateRules();  // activate, rollback, stop
Commands RulesStatus();
Commands ShadowRules();
Commands ResumeRules();
Commands SignalCommands();
Commands AuditCommands();  // verify, tail, export
Commands AgentCommands();  // list, ban, unban, reset-term
Commands EnrolCommands();  // create-token, revoke-token, list
Commands RecordCommands();
Commands ContextCommands();    // list, use
Commands ReferenceCommands();  // completion bash, man

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_COMMANDS_H_

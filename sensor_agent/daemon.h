// The process around the agent: configuration, certificate, metrics, signals.
#ifndef RIPS_SENSOR_AGENT_DAEMON_H_
#define RIPS_SENSOR_AGENT_DAEMON_H_

#include "services/runtime/daemon_flags.h"

namespace rips::sensor {

// Runs until SIGTERM or SIGINT. Signals must be blocked. The exit code: 0, kExitConfig if the
// configuration or the certificate is wrong or they contradict each other, kExitFailed otherwise.
int RunDaemon(const DaemonFlags& flags);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_DAEMON_H_

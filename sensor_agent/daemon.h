// The process around the agent: configuration, certificate, metrics, signals.
#ifndef RIPS_SENSOR_AGENT_DAEMON_H_
#define RIPS_SENSOR_AGENT_DAEMON_H_

#include "services/runtime/daemon_flags.h"

namespace rips::sensor {

// Runs until SIGTERM or SIGINT. Signals must be blocked. The exit code: 0, kExitConfig if the
// configuration is wrong or the certificate is of another, kExitFailed otherwise. A certificate
// that is missing or not valid now is waited for, and what is seen is kept meanwhile; a DDS
// keystore is waited for with nothing seen.
int RunDaemon(const DaemonFlags& flags);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_DAEMON_H_

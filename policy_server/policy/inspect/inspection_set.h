// All inspections of one policy, and what a thread needs to make them.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_INSPECTION_SET_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_INSPECTION_SET_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "policy_server/policy/engine/state/verdict.h"
#include "policy_server/policy/inspect/checked_files.h"
#include "policy_server/policy/inspect/message.h"
#include "policy_server/policy/inspect/plugin.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "services/base/clock.h"
#include "services/base/payload_limits.h"

namespace rips::inspect {

// Different inspections of one policy.
inline constexpr size_t kInspectionsMax = 256;

// Scanners and plugin processes of one thread. One thread only.
class Session {
 public:
  virtual ~Session() = default;
  // Asks inspection `index` (from 0, as given to LoadInspections). kUnscanned if `message` has no
  // payload or there is no such inspection, and instead of kNo if not all of the payload was seen:
  // it may hold elsewhere what was not found. Blocks for its time limit at most.
  virtual engine::Verdict Inspect(uint32_t index, const Message& message) = 0;
  // Time of Inspect since the last call that went into starting processes, which is nobody's cost:
  // a process is started anew because it failed on another robot's message.
  virtual int64_t TakeStartNs() { return 0; }
};

// Immutable; any thread.
class InspectionSet {
 public:
  virtual ~InspectionSet() = default;
  virtual size_t size() const = 0;
  // Starts the scanner and the plugins that are kept running, and waits until they are ready. They
  // live as long as the session and the calling thread. The session needs neither the set nor the
  // thread that made the set.
  virtual std::unique_ptr<Session> NewSession() const = 0;
};

struct InspectOptions {
  // YARA sees this many bytes from the beginning. Plugins see all that was received.
  size_t payload_bytes_max = kPayloadBytesHard;
  // One scan; one that does not stop by itself then is killed (ScannerProcess).
  absl::Duration scan_time = absl::Milliseconds(100);
  ChildLimits scanner;
  PluginOptions plugin;
};

// Compiles what `files` has not compiled, starts a scanner once, and probes the plugins: their
// programs are run once (ProbePlugins), so this takes up to a second if there are any.
// InvalidArgument with every problem of every file; ResourceExhausted beyond kInspectionsMax; else
// as ProbePlugins and ChildProcess::StartScanner. `clock` is not owned, outlives the set and its
// sessions, and its boottime must really pass.
absl::StatusOr<std::shared_ptr<const InspectionSet>> LoadInspections(
    const std::vector<lang::Inspection>& inspections, CheckedFiles& files,
    const InspectOptions& options, const Clock* clock);

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_INSPECTION_SET_H_

// What rips-fw does: brings our table into the state a step asks for, reads it back, and says what
// is no longer as it was loaded.
//
// The kernel holds the state (rules, timers, since when a target is isolated), so that neither a
// restart of this process nor its death opens or closes anything. Kept here is only how the kernel
// printed the rules right after they were loaded: what differs from that later was changed by
// somebody else.
//
// | step        | entered                                    | checked                        |
// |-------------|--------------------------------------------|--------------------------------|
// | rules       | level rules replaced, time set             | table, rules, time; renewed    |
// | isolate ... | added; time set, never shortened           | table, each target; renewed    |
// | release     | level rules and isolations end; those      | nothing                        |
// |             | younger than `hold` at that age            |                                |
#ifndef RIPS_MODE_ACTUATOR_HELPERS_FW_FIREWALL_H_
#define RIPS_MODE_ACTUATOR_HELPERS_FW_FIREWALL_H_

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "mode_actuator/helpers/fw/nft.h"
#include "mode_actuator/helpers/fw/ruleset.h"
#include "mode_actuator/steps/firewall/fw_message.h"
#include "mode_actuator/steps/firewall/host_view.h"
#include "mode_actuator/steps/firewall/nft_script.h"
#include "services/base/clock.h"

namespace rips::actuator {

struct FirewallOptions {
  // The only files whose rules may be loaded: those that actuator.yaml names.
  std::vector<std::string> files;
  // No target is released earlier: by then the DDS lease has ended here and the nodes of the
  // robot know that the writer is gone, instead of taking its old samples for new ones in a row.
  // The isolated go on hearing our multicast, so their leases on us do not end: reliable writers
  // keep what they could not deliver, and send it when they are released, however late.
  absl::Duration hold = absl::Seconds(12);
};

// One thread at a time.
class Firewall {
 public:
  // Nothing is owned; all outlive this.
  Firewall(FirewallOptions options, Nft* nft, HostView* host, const Clock* clock)
      : options_(std::move(options)), nft_(nft), host_(host), clock_(clock) {}

  // Reads every file and lets nft judge it without loading it. What is wrong with the first one
  // that is wrong.
  absl::Status CheckFiles();

  FwResponse Handle(const FwRequest& request);

 private:
  FwResponse Enter(const FirewallStep& step);
  // What was read back.
  absl::StatusOr<std::string> EnterRules(const FirewallStep& step);
  absl::StatusOr<std::string> EnterIsolation(const FirewallStep& step);
  absl::StatusOr<FwResponse> Check(const FirewallStep& step);
  FwResponse EnterRelease();
  // What Enter would load.
  absl::StatusOr<std::string> ScriptOf(const FirewallStep& step);
  FwResponse Status();

  absl::StatusOr<Ruleset> List();
  // As List; a table that cannot be read because it is switched off is switched on first.
  absl::StatusOr<Ruleset> ListOrMend(const std::string& table_script);
  // Dry run, transaction, read back.
  absl::StatusOr<Ruleset> Load(const std::string& script);
  // Keeps how the kernel prints what `script` has loaded, if it is all there.
  absl::Status Learn(const std::string& script, const Ruleset& now);

  absl::Status CompareTable(const Ruleset& now);
  absl::Status CompareRules(const FirewallStep& step, const Ruleset& now) const;
  absl::Status CompareTargets(const std::vector<Target>& targets, const Ruleset& now) const;
  absl::StatusOr<std::vector<Target>> Targets(const FirewallStep& step);
  // The same, if all of them may be isolated.
  absl::StatusOr<std::vector<Target>> AllowedTargets(const FirewallStep& step);
  absl::StatusOr<std::string> RulesScript(const FirewallStep& step);
  // Without the table. `before`: what is in force.
  absl::StatusOr<std::string> IsolationScript(const FirewallStep& step,
                                              const std::vector<Target>& targets,
                                              const Ruleset& before);

  const FirewallOptions options_;
  Nft* const nft_;            // Not owned; outlives this.
  HostView* const host_;      // Not owned; outlives this.
  const Clock* const clock_;  // Not owned; outlives this.

  // As printed after our last transaction; empty: none since our start.
  absl::btree_map<std::string, ChainView> table_;
  absl::btree_map<std::string, ChainView> level_;
  std::string file_;  // of `level_`
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_HELPERS_FW_FIREWALL_H_

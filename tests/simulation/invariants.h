// The reference model: what the parties were seen to do, and which of it the invariants of the
// architecture (I1, I2, I3, I5, I7) forbid.
//
// Each On... states a fact at the moment when it happens; the first violation is kept. The model
// knows nothing of how the parties decide, only of what they send, record and hold.
#ifndef RIPS_TESTS_SIMULATION_INVARIANTS_H_
#define RIPS_TESTS_SIMULATION_INVARIANTS_H_

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/decide/level_controller.h"
#include "policy_server/server/robot/links.h"
#include "policy_server/server/store/store.h"
#include "tests/simulation/counts.h"
#include "tests/simulation/level_names.h"

namespace rips::simulation {

inline constexpr int kFailSafe = 1;
// How long evidence must have been complete before a rule lowers the level.
inline constexpr int64_t kSoftHoldNs = 1 * kNanosPerSecond;
// The lease counts as ended for the actuator's next tick after this.
inline constexpr int64_t kTickNs = 100 * kNanosPerMilli;

struct Violation {
  std::string invariant;
  std::string what;
};

// Between the reasons of the two operators who lowered a robot.
inline constexpr char kApproved[] = "; approved: ";

class Checker {
 public:
  // --- the server and its store
  void OnServerStart(int64_t now_ns);
  void OnRecord(const store::WriteBatch& batch, int64_t now_ns);
  // `record`: what the store holds with `batch`.
  void OnDurable(const store::WriteBatch& batch, const store::RobotRecord& record);
  // The store gave `term` to this server.
  void OnTermDrawn(uint64_t term) { drawn_terms_.insert(term); }
  void OnAlertTold(const std::string& id);
  void OnCommandSent(const pipeline::Command& command);
  void OnOrderAnswered(const DecisionId& decision_id);
  void OnServerHolds(const DecisionId& decision_id, absl::string_view level, int64_t now_ns);
  // --- observations: `id` names one for good, whatever number it travels under
  void OnSensorAccepted(int64_t now_ns) { began_ns_.push_back(now_ns); }
  void OnNumbered(const store::LaneKey& lane, uint64_t sequence, uint64_t id);
  void OnJudged(uint64_t id);
  void OnAcknowledged(const store::LaneKey& lane, uint64_t sequence);
  void OnRefused(absl::string_view why) { Fail("I3", "the server refuses an honest sensor", why); }
  // --- operators
  void OnLoweringOrdered(const std::string& reason) { ordered_.insert(reason); }
  // --- the actuator
  void OnActuatorStart(const actuator::ExecutorReport& report, int64_t now_ns);
  // `term` is the one that the server sent.
  void OnCommandDelivered(const std::string& id, uint64_t term);
  void OnLeaseDelivered(const model::LeaseGrant& lease, int64_t now_ns);
  void OnReadBack(int level) { read_back_ = level; }
  void OnReceipt(const actuator::Receipt& receipt);
  void OnActuatorHolds(const actuator::ExecutorReport& report, int64_t now_ns);
  void OnActuatorGone() { held_.reset(); }

  const std::optional<Violation>& violation() const { return violation_; }
  const Counts& counts() const { return counts_; }

 private:
  struct Decision {
    store::DecisionRecord record;
    bool lowers = false;
    bool durable = false;
    int64_t made_ns = 0;  // may be long before it is recorded
  };
  void Fail(absl::string_view invariant, absl::string_view what, absl::string_view detail = "");
  void CheckLowering(const Decision& lowering);
  // A durable decision after `from`, up to `to`, lowers the level.
  bool LoweredBetween(const DecisionId& from, const DecisionId& to) const;

  std::optional<Violation> violation_;
  Counts counts_;
  std::map<DecisionId, Decision> decisions_;
  DecisionId durable_decision_id_;
  int durable_level_ = -1;
  absl::flat_hash_set<std::string> durable_alerts_;
  absl::flat_hash_set<uint64_t> drawn_terms_;
  store::HighWater high_water_;
  int64_t durable_judged_ = 0;
  std::map<store::LaneKey, std::vector<uint64_t>> numbered_;  // from sequence 1; 0 = not counted
  absl::flat_hash_set<uint64_t> judged_;                      // by this server or durably
  absl::flat_hash_set<uint64_t> judged_durably_;
  std::set<std::string> ordered_;
  std::set<DecisionId> commanded_;
  std::map<DecisionId, int64_t> held_since_ns_;  // by a server
  // When the server, or a stream of its sensor, began: evidence starts anew.
  std::vector<int64_t> began_ns_;
  int64_t server_began_ns_ = 0;

  std::optional<actuator::ExecutorReport> held_;  // of the process that runs
  absl::flat_hash_map<std::string, uint64_t> sent_terms_;
  absl::flat_hash_set<std::string> stale_;  // ids that were stale when they came
  uint64_t newest_term_ = 0;                // that this process has seen
  int64_t newest_echo_ns_ = 0;
  int64_t lease_end_ns_ = 0;
  bool evidence_complete_ = false;
  int read_back_ = -1;
  std::set<DecisionId> verified_;
};

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_INVARIANTS_H_

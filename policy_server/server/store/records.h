// What is stored of robots: what is known of one, and what is written and read back.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_RECORDS_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_RECORDS_H_

#include <compare>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/state/trace.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/server/store/ack_records.h"
#include "policy_server/server/store/maintenance.h"
#include "services/base/decision_id.h"
#include "services/model/receipt.h"

namespace rips::store {

// Terms, epochs, counts and sequences above this are refused: they are stored as signed numbers.
inline constexpr uint64_t kNumberMax = std::numeric_limits<int64_t>::max();
// High-water keys kept per robot and host; beyond, those first seen longest ago are forgotten.
inline constexpr size_t kHighWaterPerHostMax = 64;

// One ordered line of observations.
struct LaneKey {
  std::string host;
  // 32 hex digits.
  std::string incarnation;
  enum class Lane { kControl = 1, kMessages = 2 };
  Lane lane = Lane::kControl;

  friend auto operator<=>(const LaneKey&, const LaneKey&) = default;
};

using HighWater = absl::btree_map<LaneKey, uint64_t>;
using Variables = absl::btree_map<std::string, lang::Value>;

// Decisions of rules that Load returns. A rule lowers by one level, and there are 64 levels: the
// three newest lowerings are among them unless operators went up and down in between.
inline constexpr size_t kRuleDecisionsMax = 256;

// A decision that a rule made.
struct RuleDecision {
  DecisionId decision_id;
  std::string from;
  std::string to;
  int64_t time_unix_ns = 0;

  friend bool operator==(const RuleDecision&, const RuleDecision&) = default;
};

// What is known of one robot.
struct RobotRecord {
  // Name of the decided level; empty if nothing was ever decided.
  std::string level;
  // The decision that led to it; none if nothing was ever decided.
  DecisionId decision_id;
  // Highest term handed out or seen in a decision; 0 = none.
  uint64_t highest_term = 0;
  Variables variables;
  // Sequence up to which observations are judged and their effects durable, inclusive.
  HighWater high_water;
  // Rules may not lower soft levels until an operator resumes them.
  bool soft_suspended = false;
  // A rule has called `crash`: no rule runs until an operator resumes them.
  bool rules_halted = false;
  // The decision that stood when an operator let rules lower soft levels again; none = never.
  DecisionId resumed_at;
  // Those after `resumed_at`, oldest first; of more than kRuleDecisionsMax the newest.
  std::vector<RuleDecision> rule_decisions;
  // Id of the bundle that was in force last; empty = none yet.
  std::string bundle;
  // As written last, whether it is over by now or not.
  Maintenance maintenance;

  friend bool operator==(const RobotRecord&, const RobotRecord&) = default;
};

// A robot that a server owns from now on.
struct Acquired {
  RobotRecord record;
  // A term above all that the robot ever had: decisions may be made in it, and batches name it.
  uint64_t tenure = 0;

  friend bool operator==(const Acquired&, const Acquired&) = default;
};

// A level decision. Levels are stored by name.
struct DecisionRecord {
  // 32 hex digits.
  std::string id;
  DecisionId decision_id;
  DecisionId based_on;
  std::string from;
  std::string to;
  // `rule NAME`, `operator NAME`, `adopted`
  std::string cause;
  // The operator's words; may be empty.
  std::string reason;
  int64_t time_unix_ns = 0;
  // Why the rule fired that made it; none for others.
  engine::Trace trace;

  friend bool operator==(const DecisionRecord&, const DecisionRecord&) = default;
};

// A level change that was refused. Written again under the same id when it is repeated: the newest
// time and count replace the older.
struct RefusalRecord {
  std::string id;
  std::string from;
  std::string to;
  std::string cause;
  // Why it was refused.
  std::string reason;
  uint64_t count = 1;
  int64_t time_unix_ns = 0;
  // Why the rule fired that asked for it, for the first time.
  engine::Trace trace;

  friend bool operator==(const RefusalRecord&, const RefusalRecord&) = default;
};

// What the actuators have reported of a decision. Of an unknown decision id: ignored. One that was
// verified does not become superseded: the robot was there.
struct StageUpdate {
  DecisionId decision_id;
  // requested | acknowledged | verified | contradicted | failed | superseded
  std::string stage;
  // For people; may be empty.
  std::string detail;

  friend bool operator==(const StageUpdate&, const StageUpdate&) = default;
};

struct AlertRecord {
  // 32 hex digits. Written twice under one id: the first stays.
  std::string id;
  int64_t time_unix_ns = 0;
  // In a WriteBatch, the robot of the batch.
  std::string robot;
  // Rule name; `(rips)` for RIPS's own.
  std::string rule;
  // info | low | medium | high | critical
  std::string severity;
  // Text from a robot: any bytes.
  std::string text;
  // Name of the level when it was raised.
  std::string level;
  // What was being judged, for people.
  std::string event;
  DecisionId decision_id;
  // What a maintenance of the robot at that time says of itself; empty = there was none.
  std::string maintenance;
  // Why its rule fired; none for RIPS's own.
  engine::Trace trace;
  // Its place in the order of writing, from 1, never given twice; 0 = not told. Set by AlertsAfter.
  uint64_t sequence = 0;

  friend bool operator==(const AlertRecord&, const AlertRecord&) = default;
};

// The newest answer of an actuator to a command. Written again for the same host and command: the
// newer one takes the place of the older.
struct ReceiptRecord {
  // When it came.
  int64_t unix_ns = 0;
  std::string host;
  // `level ALERT`, `exec usb_alarm`, `drill ALERT`; `unknown command`.
  std::string command;
  model::Receipt receipt;

  friend bool operator==(const ReceiptRecord&, const ReceiptRecord&) = default;
};

// Receipts kept per robot; beyond, those written longest ago are forgotten.
inline constexpr size_t kReceiptsPerRobotMax = 256;

// Stands for the server itself where a record names a robot; no robot can be called so.
inline constexpr absl::string_view kServerRobot = "(server)";

// Variables and judged sequences of one robot, of one instant.
struct Checkpoint {
  // All of the robot's variables; absent = as before.
  std::optional<Variables> variables;
  // Replaces what is stored for these keys; other keys stay. A sequence never goes back.
  HighWater high_water;
  // Absent = as before.
  std::optional<bool> soft_suspended;
  std::optional<bool> rules_halted;
  std::optional<DecisionId> resumed_at;
  std::optional<std::string> bundle;
  // none() = there is none from now on.
  std::optional<Maintenance> maintenance;

  bool empty() const { return *this == Checkpoint(); }

  friend bool operator==(const Checkpoint&, const Checkpoint&) = default;
};

// Records of one robot. Written together or not at all; in the order of the members, then of the
// elements.
struct WriteBatch {
  // kServerRobot for alerts of the server itself.
  std::string robot;
  // As Store::Acquire drew it: the fence. 0 = of no owner, which is for alerts and their
  // acknowledgements alone: nothing fences them.
  uint64_t tenure = 0;
  std::vector<DecisionRecord> decisions;
  std::vector<RefusalRecord> refusals;
  std::vector<StageUpdate> stages;
  std::vector<AlertRecord> alerts;
  std::vector<ReceiptRecord> receipts;
  // Of alerts of any robot. Of an alert that has one, the first stays.
  std::vector<AckRecord> acks;
  Checkpoint checkpoint;
  // On a full disk the store gives up a piece of its reserve for this: only decisions, and no
  // lowering among them.
  bool uses_reserve = false;

  bool empty() const {
    return decisions.empty() && refusals.empty() && stages.empty() && alerts.empty() &&
           receipts.empty() && acks.empty() && checkpoint.empty();
  }
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_RECORDS_H_

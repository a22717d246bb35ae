// Durable state of robots: level decisions named by marks, refusals, alerts, rule variables and how
// far each sensor lane has been judged.
//
// What this port promises, and every implementation is tested for:
//   - A commit that returned OK survives a crash of the process and of the machine.
//   - A commit is all or nothing.
//   - A decision, once written, never changes and its mark never names another decision. The level
//     that Load returns is that of the highest mark, whatever the order of writing, so a repeated
//     or late write cannot lower it.
//   - A term, once handed out, is never handed out again.
// Methods block on the disk and may be called from any thread. Errors: Unavailable (a retry may
// help: busy, disk error), ResourceExhausted (disk full), DataLoss (what is stored is corrupt),
// InvalidArgument (the caller's data will never do), AlreadyExists (the mark or id is taken).
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_STORE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_STORE_H_

#include <compare>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/server/store/generations.h"
#include "services/base/mark.h"

namespace rips::store {

// A query returns at most this many records; a higher limit is cut, 0 means kListDefault.
inline constexpr uint32_t kListMax = 1'000;
inline constexpr uint32_t kListDefault = 100;
// Terms, epochs, counts and sequences above this are refused: they are stored as signed numbers.
inline constexpr uint64_t kNumberMax = std::numeric_limits<int64_t>::max();
// NextTerm believes `above` up to here, so that no agent can use up a robot's terms.
inline constexpr uint64_t kTermAboveMax = uint64_t{1} << 62;
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
  Mark mark;
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
  Mark mark;
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
  Mark resumed_at;
  // Those after `resumed_at`, oldest first; of more than kRuleDecisionsMax the newest.
  std::vector<RuleDecision> rule_decisions;
  // Id of the bundle that was in force last; empty = none yet.
  std::string bundle;

  friend bool operator==(const RobotRecord&, const RobotRecord&) = default;
};

// A level decision. Levels are stored by name.
struct DecisionRecord {
  // 32 hex digits.
  std::string id;
  std::string robot;
  Mark mark;
  Mark based_on;
  std::string from;
  std::string to;
  // `rule NAME`, `operator NAME`, `adopted`
  std::string cause;
  // The operator's words; may be empty.
  std::string reason;
  int64_t time_unix_ns = 0;

  friend bool operator==(const DecisionRecord&, const DecisionRecord&) = default;
};

// A level change that was refused. Written again under the same id when it is repeated: the newest
// time and count replace the older.
struct RefusalRecord {
  std::string id;
  std::string robot;
  std::string from;
  std::string to;
  std::string cause;
  // Why it was refused.
  std::string reason;
  uint64_t count = 1;
  int64_t time_unix_ns = 0;

  friend bool operator==(const RefusalRecord&, const RefusalRecord&) = default;
};

// What the actuators have reported of a decision. Of an unknown mark: ignored.
struct StageUpdate {
  std::string robot;
  Mark mark;
  // requested | acknowledged | verified | failed | superseded
  std::string stage;
  // For people; may be empty.
  std::string detail;

  friend bool operator==(const StageUpdate&, const StageUpdate&) = default;
};

struct AlertRecord {
  // 32 hex digits. Written twice under one id: the first stays.
  std::string id;
  int64_t time_unix_ns = 0;
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
  Mark mark;
  // Its place in the order of writing, from 1, never given twice; 0 = not told. Set by AlertsAfter.
  uint64_t sequence = 0;

  friend bool operator==(const AlertRecord&, const AlertRecord&) = default;
};

// A run of alerts, in the order of writing.
struct AlertPage {
  // With their sequences.
  std::vector<AlertRecord> alerts;
  // Alerts between the one asked for and the first of these were forgotten by the limit.
  bool forgotten = false;

  friend bool operator==(const AlertPage&, const AlertPage&) = default;
};

// Stands for the server itself where a record names a robot; no robot can be called so.
inline constexpr absl::string_view kServerRobot = "(server)";
// Bytes of a note's value.
inline constexpr size_t kNoteBytesMax = 1'000;

// Variables and judged sequences of one robot, of one instant.
struct Checkpoint {
  std::string robot;
  // All of the robot's variables; absent = as before.
  std::optional<Variables> variables;
  // Replaces what is stored for these keys; other keys stay. A sequence never goes back.
  HighWater high_water;
  // Absent = as before.
  std::optional<bool> soft_suspended;
  std::optional<bool> rules_halted;
  std::optional<Mark> resumed_at;
  std::optional<std::string> bundle;

  friend bool operator==(const Checkpoint&, const Checkpoint&) = default;
};

// Written together or not at all; in the order of the members, then of the elements.
struct WriteBatch {
  std::vector<DecisionRecord> decisions;
  std::vector<RefusalRecord> refusals;
  std::vector<StageUpdate> stages;
  std::vector<AlertRecord> alerts;
  std::vector<Checkpoint> checkpoints;
  // On a full disk the store gives up a piece of its reserve for this: only decisions, and no
  // lowering among them.
  bool uses_reserve = false;

  bool empty() const {
    return decisions.empty() && refusals.empty() && stages.empty() && alerts.empty() &&
           checkpoints.empty();
  }
};

// A decision or a refusal, as read back.
struct TransitionRecord {
  std::string id;
  std::string robot;
  int64_t time_unix_ns = 0;
  std::string from;
  std::string to;
  std::string cause;
  std::string reason;
  // None when refused.
  Mark mark;
  Mark based_on;
  bool refused = false;
  // How often this refusal was seen; 1 for a decision.
  uint64_t count = 1;
  // `requested` until the actuators report; empty when refused.
  std::string stage;
  std::string detail;

  friend bool operator==(const TransitionRecord&, const TransitionRecord&) = default;
};

class Store {
 public:
  virtual ~Store() = default;

  // An unknown robot gives an empty record.
  virtual absl::StatusOr<RobotRecord> Load(absl::string_view robot) = 0;

  // A term above all that this robot ever had, and above `above` (cut to kTermAboveMax);
  // durable when it returns.
  virtual absl::StatusOr<uint64_t> NextTerm(absl::string_view robot, uint64_t above) = 0;
  absl::StatusOr<uint64_t> NextTerm(absl::string_view robot) { return NextTerm(robot, 0); }

  // The level that this robot's decision of that mark leads to, by name; nullopt if no decision has
  // that mark.
  virtual absl::StatusOr<std::optional<std::string>> FindDecision(absl::string_view robot,
                                                                  const Mark& mark) = 0;

  // Begins a generation under `id`, which is durable when it returns; commits are counted in it
  // from now on. The newest kGenerationsMax are kept. InvalidArgument unless `id` has
  // kGenerationBytes, AlreadyExists if the store has it.
  virtual absl::Status BeginGeneration(absl::string_view id) = 0;
  // Oldest first; empty = none was ever begun.
  virtual absl::StatusOr<std::vector<Generation>> Generations() = 0;
  // The newest that is durable, 0 before BeginGeneration. Never blocks.
  virtual uint64_t newest_commit() const = 0;

  // One transaction of all batches, applied in order; one commit. A decision whose mark exists: OK
  // if it is the same in every field, else AlreadyExists and nothing is written. InvalidArgument:
  // see Validate.
  virtual absl::Status CommitAll(std::span<const WriteBatch> batches) = 0;
  absl::Status Commit(const WriteBatch& batch) { return CommitAll({&batch, 1}); }

  // Decisions and refusals of the robot, the one written last first.
  virtual absl::StatusOr<std::vector<TransitionRecord>> ListTransitions(absl::string_view robot,
                                                                        uint32_t limit) = 0;
  // Of one robot, or of all if `robot` is empty; the one written last first.
  virtual absl::StatusOr<std::vector<AlertRecord>> ListAlerts(absl::string_view robot,
                                                              uint32_t limit) = 0;
  // Of one robot, or of all if `robot` is empty: those written after the one of that sequence, the
  // one written first first.
  virtual absl::StatusOr<AlertPage> AlertsAfter(absl::string_view robot, uint64_t sequence,
                                                uint32_t limit) = 0;
  // The sequence of the alert with that id; 0 = there is none (any more).
  virtual absl::StatusOr<uint64_t> FindAlert(absl::string_view id) = 0;
  // The alert written last, sequence and id alone matter; sequence 0 = there is none.
  virtual absl::StatusOr<AlertRecord> NewestAlert() = 0;

  // A small text under a name, for whoever must remember where it was; empty = none.
  virtual absl::StatusOr<std::string> Note(absl::string_view name) = 0;
  // InvalidArgument for an empty name or a value beyond kNoteBytesMax.
  virtual absl::Status SetNote(absl::string_view name, absl::string_view value) = 0;
};

// A certificate identity that is not served any more.
struct BanRecord {
  // As rpc::ToString gives it.
  std::string uri;
  // Lower-case hex; empty = whatever certificate the identity shows.
  std::string serial;
  std::string reason;
  // Who banned it, as rpc::Describe gives it.
  std::string by;
  int64_t time_unix_ns = 0;

  friend bool operator==(const BanRecord&, const BanRecord&) = default;
};

// Deny list. Durable when a method returns OK; errors as for Store.
class BanStore {
 public:
  virtual ~BanStore() = default;
  // In place of one of the same URI and serial. InvalidArgument without a URI.
  virtual absl::Status PutBan(const BanRecord& ban) = 0;
  // False if there was none.
  virtual absl::StatusOr<bool> RemoveBan(absl::string_view uri, absl::string_view serial) = 0;
  // Sorted by URI and serial.
  virtual absl::StatusOr<std::vector<BanRecord>> ListBans() = 0;
};

// InvalidArgument if CommitAll must refuse the batch whatever is stored: an empty robot or id, a
// decision without mark or level, a number above kNumberMax. Shared by implementations.
absl::Status Validate(const WriteBatch& batch);

// InvalidArgument if BeginGeneration must refuse it. Shared by implementations.
absl::Status CheckGeneration(absl::string_view id);

// InvalidArgument if SetNote must refuse it. Shared by implementations.
absl::Status CheckNote(absl::string_view name, absl::string_view value);

// `limit` as queries apply it.
inline uint32_t ListLimit(uint32_t limit) {
  if (limit == 0) return kListDefault;
  return limit < kListMax ? limit : kListMax;
}

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_STORE_H_

// Durable state of robots: level decisions named by decision ids, refusals, alerts, rule variables
// and how far each sensor lane has been judged.
//
// What this port promises, and every implementation is tested for:
//   - A batch whose status is OK survives a crash of the process and of the machine.
//   - A batch is all or nothing, and spoils no other of its group.
//   - A robot has one owner, the server that acquired it last. What a former owner still writes is
//     refused, for ever: also after the robot was acquired again by the same server.
//   - A decision, once written, never changes and its decision id never names another decision. The
//     level that Load returns is that of the highest decision id, whatever the order of writing, so
//     a repeated or late write cannot lower it.
//   - A term, once handed out, is never handed out again.
// Methods block on the disk and may be called from any thread. Errors:
//   of the store   Unavailable (nothing was written; a retry may help: busy, disk error), Unknown
//                  (in doubt: it may have been written, and a restart may find it),
//                  ResourceExhausted (disk full), DataLoss (what is stored is corrupt)
//   of the caller  InvalidArgument (the data will never do), AlreadyExists (the decision id or id
//                  is taken), Aborted (fenced: the robot was acquired anew since), NotFound (the
//                  alert that it acknowledges is not kept)
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_STORE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_STORE_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/store/found_records.h"
#include "policy_server/server/store/generations.h"
#include "policy_server/server/store/records.h"
#include "services/base/decision_id.h"

namespace rips::store {

// A query returns at most this many records; a higher limit is cut, 0 means kListDefault.
inline constexpr uint32_t kListMax = 1'000;
inline constexpr uint32_t kListDefault = 100;
// NextTerm believes `above` up to here, so that no agent can use up a robot's terms.
inline constexpr uint64_t kTermAboveMax = uint64_t{1} << 62;
// Bytes of a note's value.
inline constexpr size_t kNoteBytesMax = 1'000;

class Store {
 public:
  virtual ~Store() = default;

  // An unknown robot gives an empty record.
  virtual absl::StatusOr<RobotRecord> Load(absl::string_view robot) = 0;

  // Makes the caller the owner of the robots, in their order; durable when it returns. From now on
  // batches of an earlier tenure are refused, the caller's own too, and nothing can be written but
  // by the new one.
  virtual absl::StatusOr<std::vector<Acquired>> Acquire(std::span<const std::string> robots) = 0;
  absl::StatusOr<Acquired> Acquire(const std::string& robot);

  // A term above all that this robot ever had, and above `above` (cut to kTermAboveMax);
  // durable when it returns. The tenure stays. Aborted if `tenure` is not the robot's.
  virtual absl::StatusOr<uint64_t> NextTerm(absl::string_view robot, uint64_t tenure,
                                            uint64_t above) = 0;

  // The level that this robot's decision of that decision id leads to, by name; nullopt if no
  // decision has that decision id.
  virtual absl::StatusOr<std::optional<std::string>> FindDecision(
      absl::string_view robot, const DecisionId& decision_id) = 0;

  // Begins a generation under `id`, which is durable when it returns; commits are counted in it
  // from now on. The newest kGenerationsMax are kept. InvalidArgument unless `id` has
  // kGenerationBytes, AlreadyExists if the store has it.
  virtual absl::Status BeginGeneration(absl::string_view id) = 0;
  // Oldest first; empty = none was ever begun.
  virtual absl::StatusOr<std::vector<Generation>> Generations() = 0;
  // The newest that is durable, 0 before BeginGeneration. Never blocks.
  virtual uint64_t newest_commit() const = 0;

  // One transaction of all batches, applied in order; one commit. What became of each: OK, or why
  // nothing of it was written: InvalidArgument (see Validate), AlreadyExists, Aborted if the batch
  // names a tenure that is not the robot's, NotFound if it acknowledges an alert that is not kept.
  // An error is of the store, and of all batches. A decision whose decision id exists: OK if it is
  // the same in every field, else AlreadyExists.
  virtual absl::StatusOr<std::vector<absl::Status>> CommitAll(
      std::span<const WriteBatch> batches) = 0;
  absl::Status Commit(const WriteBatch& batch);

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
  // Of the robot, the one written last first.
  virtual absl::StatusOr<std::vector<ReceiptRecord>> ListReceipts(absl::string_view robot,
                                                                  uint32_t limit) = 0;
  // Those whose id begins with `prefix`, which is not empty.
  virtual absl::StatusOr<FoundRecords> FindRecords(absl::string_view prefix) = 0;
  // The sequence of the alert with that id; 0 = there is none (any more).
  virtual absl::StatusOr<uint64_t> FindAlert(absl::string_view id) = 0;
  // The alert written last, sequence and id alone matter; sequence 0 = there is none.
  virtual absl::StatusOr<AlertRecord> NewestAlert() = 0;

  // A small text under a name; empty = none.
  virtual absl::StatusOr<std::string> Note(absl::string_view name) = 0;
  // InvalidArgument for an empty name or a value beyond kNoteBytesMax.
  virtual absl::Status SetNote(absl::string_view name, absl::string_view value) = 0;
};

// InvalidArgument if CommitAll must refuse the batch whatever is stored: an empty robot or id, a
// decision without decision id or level, a number above kNumberMax, an acknowledgement
// without operator or time, or with a longer note than kAckNoteBytesMax, a maintenance without
// operator, that ends before it begins, or with a longer reason than kMaintenanceReasonBytesMax,
// other than alerts and acknowledgements without a tenure. Shared by implementations.
absl::Status Validate(const WriteBatch& batch);

// NotFound, naming the alert. Shared by implementations.
absl::Status NoSuchAlert(absl::string_view alert_id);

// True of what CommitAll says of one batch, not of the store.
bool IsOfBatch(const absl::Status& status);

// What a batch or a question of `tenure` is told when another one is stored. Shared by
// implementations.
absl::Status Fenced(absl::string_view robot, uint64_t tenure, uint64_t stored);

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

// A Store in memory that fails when told. Test code only; any thread.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_FAKE_STORE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_FAKE_STORE_H_

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "policy_server/server/store/ack_store.h"
#include "policy_server/server/store/ban_store.h"
#include "policy_server/server/store/store.h"
#include "services/runtime/mutex.h"

namespace rips::store {

class FakeStore final : public Store, public BanStore, public AckStore {
 public:
  // From now on commits, acquisitions and terms fail with `status`, writing nothing; OK ends that.
  void FailWrites(absl::Status status) ABSL_LOCKS_EXCLUDED(mutex_);
  // From now on, as on a full disk, commits fail with ResourceExhausted unless all their batches
  // may use the reserve; false ends that.
  void FillDisk(bool full) ABSL_LOCKS_EXCLUDED(mutex_);
  // From now on Load, FindDecision and lists fail with `status`; OK ends that.
  void FailReads(absl::Status status) ABSL_LOCKS_EXCLUDED(mutex_);
  // Called at the start of each commit, without lock: a test may block there, as a slow disk does.
  void OnCommit(std::function<void()> hook) ABSL_LOCKS_EXCLUDED(mutex_);
  // The same at the start of each FindDecision and NextTerm.
  void OnQuestion(std::function<void()> hook) ABSL_LOCKS_EXCLUDED(mutex_);
  // Successful transactions so far, and how many batches each had.
  std::vector<size_t> commit_sizes() const ABSL_LOCKS_EXCLUDED(mutex_);

  using Store::Acquire;
  absl::StatusOr<RobotRecord> Load(absl::string_view robot) override ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<std::vector<Acquired>> Acquire(std::span<const std::string> robots) override
      ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<uint64_t> NextTerm(absl::string_view robot, uint64_t tenure,
                                    uint64_t above) override ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<std::optional<std::string>> FindDecision(absl::string_view robot,
                                                          const DecisionId& decision_id) override
      ABSL_LOCKS_EXCLUDED(mutex_);
  absl::Status BeginGeneration(absl::string_view id) override ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<std::vector<Generation>> Generations() override ABSL_LOCKS_EXCLUDED(mutex_);
  uint64_t newest_commit() const override ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<std::vector<absl::Status>> CommitAll(std::span<const WriteBatch> batches) override
      ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<std::vector<TransitionRecord>> ListTransitions(absl::string_view robot,
                                                                uint32_t limit) override
      ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<std::vector<AlertRecord>> ListAlerts(absl::string_view robot,
                                                      uint32_t limit) override
      ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<AlertPage> AlertsAfter(absl::string_view robot, uint64_t sequence,
                                        uint32_t limit) override ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<FoundRecords> FindRecords(absl::string_view prefix) override
      ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<uint64_t> FindAlert(absl::string_view id) override ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<std::vector<ReceiptRecord>> ListReceipts(absl::string_view robot,
                                                          uint32_t limit) override
      ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<AlertRecord> NewestAlert() override ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<std::string> Note(absl::string_view name) override ABSL_LOCKS_EXCLUDED(mutex_);
  absl::Status SetNote(absl::string_view name, absl::string_view value) override
      ABSL_LOCKS_EXCLUDED(mutex_);
  absl::Status PutBan(const BanRecord& ban) override ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<bool> RemoveBan(absl::string_view uri, absl::string_view serial) override
      ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<std::vector<BanRecord>> ListBans() override ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<std::vector<AckRecord>> FindAcks(std::span<const std::string> alert_ids) override
      ABSL_LOCKS_EXCLUDED(mutex_);
  absl::StatusOr<AlertList> SearchAlerts(const AlertQuery& query) override
      ABSL_LOCKS_EXCLUDED(mutex_);

 private:
  struct State {
    absl::btree_map<std::string, RobotRecord> robots;
    absl::btree_map<std::string, uint64_t> tenures;
    // Of each robot, in the order they were first seen.
    absl::btree_map<std::string, std::vector<LaneKey>> lanes;
    // In the order of writing.
    std::vector<TransitionRecord> transitions;
    std::vector<AlertRecord> alerts;
    // By id of the alert.
    absl::btree_map<std::string, Ack> acks;
    // By robot, in the order of writing.
    absl::btree_map<std::string, std::vector<ReceiptRecord>> receipts;
    absl::btree_map<std::string, std::string> notes;
    std::vector<Generation> generations;

    RobotRecord Record(absl::string_view robot) const;
    absl::Status CheckTenure(absl::string_view robot, uint64_t tenure) const;
    absl::Status Apply(const WriteBatch& batch);
    absl::Status Apply(const std::string& robot, const DecisionRecord& decision);
    absl::Status Apply(const std::string& robot, const RefusalRecord& refusal);
    void Apply(const std::string& robot, const StageUpdate& update);
    void Apply(const AlertRecord& alert);
    absl::Status Apply(const AckRecord& record);
    void Apply(const std::string& robot, const ReceiptRecord& receipt);
    void Apply(const std::string& robot, const Checkpoint& checkpoint);
  };

  mutable Mutex mutex_;
  // By URI and serial.
  std::map<std::pair<std::string, std::string>, BanRecord> bans_ ABSL_GUARDED_BY(mutex_);
  State state_ ABSL_GUARDED_BY(mutex_);
  absl::Status write_status_ ABSL_GUARDED_BY(mutex_);
  bool full_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status read_status_ ABSL_GUARDED_BY(mutex_);
  void Question() ABSL_LOCKS_EXCLUDED(mutex_);

  std::function<void()> on_commit_ ABSL_GUARDED_BY(mutex_);
  std::function<void()> on_question_ ABSL_GUARDED_BY(mutex_);
  std::vector<size_t> commit_sizes_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_FAKE_STORE_H_

// Makes what many threads write durable with as few disk flushes as can be: whatever was submitted
// while the last transaction was flushed goes into the next one, and a batch that holds only
// progress (how far the observations of a robot are judged) waits a little for others.
//
// One thread of its own. Order: batches are applied, and their callbacks called, in the order of
// Submit. A batch that the store refuses spoils no other of its group. Nothing is tried twice: the
// caller decides; only raises of levels, which have the store's reserve, are written by themselves
// on a full disk. PutFirst alone is kept until it is written, before everything else.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_COMMITTER_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_COMMITTER_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <span>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/functional/any_invocable.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "policy_server/server/store/store.h"
#include "services/base/clock.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/mutex.h"

namespace rips::store {

struct CommitterOptions {
  // Batches waiting; one more is refused. At the group size below, 16 flushes of waiting.
  size_t waiting_max = 4'096;
  // Batches in one transaction; bounds how long the first of them waits for its callback.
  size_t group_max = 256;
  // How long batches that hold only progress of robots wait for others.
  absl::Duration gather = absl::Milliseconds(20);
  // A transaction that takes longer is an outage: no call of a disk that hangs returns an error.
  int64_t hang_ns = 5 * kNanosPerSecond;
  // Of PutFirst; the oldest go first, and are counted.
  size_t first_max = 1'000;
  // Called before a group of batches is stored, on the committer's thread; an error becomes that
  // of the transaction, and nothing is stored. May block on the disk; may be empty.
  std::function<absl::Status(std::span<const WriteBatch>)> before_commit = {};
  // Called after each transaction, stored or not, on the committer's thread: how long it took,
  // before_commit included. Needs a clock; must not block; may be empty.
  std::function<void(int64_t took_ns)> on_commit = {};
};

class Committer {
 public:
  // Called once, on the committer's thread, with the status of the batch. Must not block, must not
  // call Submit in a loop that waits for itself, must not destroy the Committer.
  using Done = absl::AnyInvocable<void(const absl::Status&) &&>;

  // Starts the thread. `store` and `clock` are not owned and outlive this. Without a clock no
  // write counts as hanging.
  explicit Committer(Store* store, CommitterOptions options = {}, const Clock* clock = nullptr);
  // As Stop.
  ~Committer();
  Committer(const Committer&) = delete;
  Committer& operator=(const Committer&) = delete;

  // Any thread; never blocks on the disk. If this is not OK, `done` is not called:
  // ResourceExhausted when too many batches wait (counted in refused()), FailedPrecondition after
  // Stop.
  absl::Status Submit(WriteBatch batch, Done done);

  // The batch is written before all that waits, and again until it has been: then `done` is called,
  // with OK, or with why the store refuses it (IsOfBatch). For what must not be lost in an outage.
  // Any thread; never blocks on the disk.
  void PutFirst(WriteBatch batch, Done done) ABSL_LOCKS_EXCLUDED(mu_);

  // Commits what waits, calls the callbacks, ends the thread. Any thread but the committer's; later
  // calls do nothing.
  void Stop();

  // Not OK, with the reason, from a transaction that the store could not write until the next one
  // that it could, and while one takes longer than hang_ns. Batches that the store refuses do not
  // count, nor does a write from the reserve alone.
  absl::Status health() const ABSL_LOCKS_EXCLUDED(mu_);
  bool healthy() const { return health().ok(); }
  // Transactions that the store could not write.
  uint64_t failures() const { return failures_.load(); }
  // Batches of PutFirst that were dropped because too many waited.
  uint64_t first_dropped() const { return first_dropped_.load(); }
  // Batches refused because too many waited.
  uint64_t refused() const { return queue_.dropped(); }
  size_t waiting() const { return queue_.size(); }

 private:
  struct Item {
    WriteBatch batch;
    Done done;
  };

  void Run();
  // Of PutFirst.
  void CommitFirst() ABSL_LOCKS_EXCLUDED(mu_);
  void CommitGroup(std::vector<Item> items);
  // As of Store::CommitAll.
  using Statuses = absl::StatusOr<std::vector<absl::Status>>;
  Statuses Commit(const std::vector<WriteBatch>& batches) ABSL_LOCKS_EXCLUDED(mu_);
  // What Commit returned says of the disk.
  void UpdateHealth(const std::vector<WriteBatch>& batches, const Statuses& statuses)
      ABSL_LOCKS_EXCLUDED(mu_);

  Store* store_;  // Not owned; outlives this.
  const CommitterOptions options_;
  BoundedQueue<Item> queue_;
  const Clock* clock_;  // Not owned; may be null.
  mutable Mutex mu_;
  // The status of the last transaction.
  absl::Status health_ ABSL_GUARDED_BY(mu_);
  // When the one that runs began; 0 = none runs.
  int64_t began_ns_ ABSL_GUARDED_BY(mu_) = 0;
  std::deque<Item> first_ ABSL_GUARDED_BY(mu_);
  std::atomic<uint64_t> failures_ = 0;
  std::atomic<uint64_t> first_dropped_ = 0;
  std::atomic<bool> stopped_ = false;
  std::thread thread_;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_COMMITTER_H_

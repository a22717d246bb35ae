// Makes what many threads write durable with as few disk flushes as can be: whatever was submitted
// while the last transaction was flushed goes into the next one.
//
// One thread of its own. Order: batches are applied, and their callbacks called, in the order of
// Submit. Nothing is tried twice: the caller is told and decides.
#ifndef RIPS_POLICY_SERVER_STORE_COMMITTER_H_
#define RIPS_POLICY_SERVER_STORE_COMMITTER_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <thread>
#include <vector>

#include "absl/functional/any_invocable.h"
#include "absl/status/status.h"
#include "policy_server/store/store.h"
#include "services/runtime/bounded_queue.h"

namespace rips::store {

struct CommitterLimits {
  // Batches waiting; one more is refused. At the group size below, 16 flushes of waiting.
  size_t waiting_max = 4'096;
  // Batches in one transaction; bounds how long the first of them waits for its callback.
  size_t group_max = 256;
};

class Committer {
 public:
  // Called once, on the committer's thread, with what became of the batch. Must not block, must not
  // call Submit in a loop that waits for itself, must not destroy the Committer.
  using Done = absl::AnyInvocable<void(const absl::Status&) &&>;

  // Starts the thread. `store` is not owned and outlives this.
  explicit Committer(Store* store, CommitterLimits limits = {});
  // As Stop.
  ~Committer();
  Committer(const Committer&) = delete;
  Committer& operator=(const Committer&) = delete;

  // Any thread; never blocks on the disk. If this is not OK, `done` is not called:
  // ResourceExhausted when too many batches wait (counted in refused()), FailedPrecondition after
  // Stop.
  absl::Status Submit(WriteBatch batch, Done done);

  // Commits what waits, calls the callbacks, ends the thread. Any thread but the committer's; later
  // calls do nothing.
  void Stop();

  // False from a transaction that the store could not write until the next one that it could. A
  // batch refused for what it says (InvalidArgument, AlreadyExists) does not count.
  bool healthy() const { return healthy_.load(); }
  // Batches refused because too many waited.
  uint64_t refused() const { return queue_.dropped(); }
  size_t waiting() const { return queue_.size(); }

 private:
  struct Item {
    WriteBatch batch;
    Done done;
  };

  void Run();
  void CommitGroup(std::vector<Item> items);

  Store* store_;  // Not owned; outlives this.
  const CommitterLimits limits_;
  BoundedQueue<Item> queue_;
  std::atomic<bool> healthy_ = true;
  std::atomic<bool> stopped_ = false;
  std::thread thread_;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_STORE_COMMITTER_H_

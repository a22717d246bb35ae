// Threads that make inspections, so that no stream and no shard ever waits for one. Whatever cannot
// be inspected in time is told so: unscanned is a verdict.
#ifndef RIPS_POLICY_SERVER_INSPECT_INSPECTION_POOL_H_
#define RIPS_POLICY_SERVER_INSPECT_INSPECTION_POOL_H_

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/flat_hash_map.h"
#include "absl/functional/any_invocable.h"
#include "absl/time/time.h"
#include "policy_server/engine/verdict.h"
#include "policy_server/inspect/inspection_set.h"
#include "policy_server/inspect/message.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::inspect {

struct PoolOptions {
  // 1 to kPoolThreadsMax; others are taken as the nearest.
  int threads = 1;
  // When every thread has been in one inspection for this long, Submit starts one more, up to
  // kPoolThreadsMax: a scan that cannot be stopped holds up its own robot, not the others.
  absl::Duration stuck_after = absl::Milliseconds(500);
  // Requests waiting, and their bytes, in all and of one robot.
  size_t waiting_max = 1'024;
  size_t waiting_per_robot_max = 64;
  size_t waiting_bytes_max = size_t{128} << 20;
  size_t waiting_bytes_per_robot_max = size_t{16} << 20;
  // From Submit to the start of the work.
  absl::Duration queue_time_max = absl::Milliseconds(250);
  // Inspection time of one robot per second of wall time; also what it may save up. What an
  // inspection takes beyond it is a debt.
  absl::Duration work_per_second = absl::Milliseconds(200);
  // Robots remembered for the above. Those that owe and wait for nothing are forgotten first.
  size_t robots_max = 4'096;
};

// Below the 32 scanners that libyara allows for the same rules.
inline constexpr int kPoolThreadsMax = 16;

// Why a request, or the rest of it, was answered without work.
enum class Skipped {
  kNot,        // it was not
  kFull,       // too much waits, or too many robots are known
  kRobotFull,  // too much of this robot waits
  kLate,       // it waited longer than queue_time_max
  kBudget,     // its robot has used up its time
  kStopped,    // Stop was called
};
inline constexpr size_t kSkippedKinds = 6;

struct InspectionStats {
  Skipped skipped = Skipped::kNot;
  int64_t waited_ns = 0;
  int64_t worked_ns = 0;
};

struct InspectionRequest {
  std::shared_ptr<const InspectionSet> set;
  // Of `set`; asked in this order.
  std::vector<uint32_t> indices;
  // `message.robot` is who waits in line, and whose time is used.
  OwnedMessage message;
};

// Order: requests of one robot are answered one after another, in the order of Submit. Robots take
// turns, one request each.
class InspectionPool {
 public:
  // Called once, on a thread of the pool, with one verdict per index. Must not block and must not
  // call Stop or destroy the pool; Submit is allowed.
  using Done = absl::AnyInvocable<void(std::vector<engine::Verdict>, const InspectionStats&) &&>;

  // Starts the threads. `clock` is not owned and outlives this.
  InspectionPool(PoolOptions options, const Clock* clock);
  // As Stop.
  ~InspectionPool();
  InspectionPool(const InspectionPool&) = delete;
  InspectionPool& operator=(const InspectionPool&) = delete;

  // Any thread; never blocks. kNot: `done` will be called. kFull, kRobotFull, kStopped: it will
  // not, and every verdict is kUnscanned. A late request is answered when a thread is free: after
  // the inspection that runs (at most `scan_time` or `answer_time`) and those in turn before it.
  Skipped Submit(InspectionRequest request, Done done) ABSL_LOCKS_EXCLUDED(mu_);

  // Waits for what is being inspected, answers what waits with kUnscanned, ends the threads and
  // with them their plugin processes. Any thread but the pool's; later calls do nothing.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  // Requests since the start: by how they were answered, kNot being the inspected ones.
  uint64_t answered(Skipped how) const { return answered_[static_cast<size_t>(how)].load(); }
  // Verdicts given by inspections that were made.
  uint64_t verdicts(engine::Verdict verdict) const {
    return verdicts_[static_cast<size_t>(verdict)].load();
  }
  // Time spent in inspections.
  int64_t worked_ns() const { return worked_ns_.load(); }
  size_t waiting() const ABSL_LOCKS_EXCLUDED(mu_);
  // Threads that run; more than `threads` if some were stuck.
  size_t threads() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Item {
    InspectionRequest request;
    Done done;
    int64_t submitted_ns = 0;
    size_t bytes = 0;
  };
  struct Robot {
    std::deque<Item> items;
    size_t bytes = 0;
    // Time it may still use; negative when it owes.
    double budget_ns = 0;
    int64_t refilled_ns = 0;
    // A thread works for it: its next request waits for that.
    bool served = false;
  };
  struct Turn {
    Robot* robot = nullptr;
    Item item;
    Skipped skipped = Skipped::kNot;
  };
  class Sessions;

  // Of one thread.
  struct Slot {
    // When its inspection began; 0: it is in none.
    std::atomic<int64_t> busy_since_ns = 0;
    std::thread thread;
  };

  void Run(Slot& slot);
  void StartThreadLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool AllStuckLocked(int64_t now_ns) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The next request. nullopt after Stop when nothing waits, and now and then so that sessions that
  // nobody needs any more can be dropped.
  std::optional<Turn> TakeTurn() ABSL_LOCKS_EXCLUDED(mu_);
  void Answer(Turn turn, Sessions& sessions, Slot& slot);
  std::vector<engine::Verdict> Inspect(const Turn& turn, Session& session, Slot& slot,
                                       InspectionStats& stats);
  void EndTurn(Robot* robot) ABSL_LOCKS_EXCLUDED(mu_);
  // False once the robot has no time left.
  bool Charge(Robot* robot, int64_t worked_ns) ABSL_LOCKS_EXCLUDED(mu_);
  void RefillLocked(Robot& robot, int64_t now_ns) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Robot* FindRobotLocked(const std::string& id, int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Skipped AdmitLocked(const Robot* robot, size_t bytes) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Skipped Count(Skipped how);

  const PoolOptions options_;
  const Clock* const clock_;  // Not owned; outlives this.
  mutable Mutex mu_;
  CondVar changed_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  size_t waiting_ ABSL_GUARDED_BY(mu_) = 0;
  size_t waiting_bytes_ ABSL_GUARDED_BY(mu_) = 0;
  // Those served are not erased.
  absl::flat_hash_map<std::string, std::unique_ptr<Robot>> robots_ ABSL_GUARDED_BY(mu_);
  // Each robot with requests that is not served, once, in turn.
  std::deque<Robot*> line_ ABSL_GUARDED_BY(mu_);
  std::array<std::atomic<uint64_t>, kSkippedKinds> answered_ = {};
  std::array<std::atomic<uint64_t>, 3> verdicts_ = {};
  std::atomic<int64_t> worked_ns_ = 0;
  std::atomic<bool> stopped_ = false;
  std::vector<std::unique_ptr<Slot>> slots_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_INSPECT_INSPECTION_POOL_H_

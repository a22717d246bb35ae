// Threads that make inspections, so that no stream and no shard ever waits for one. What its own
// robot leaves no time for is unscanned, which is a verdict; what waits for others is not judged.
//
//   a request whose turn has come                                     answer
//   its robot owes nothing and is in time                             inspected
//   its robot's own inspections since Submit took > queue_time_max    kLate, unscanned
//   its robot has used up its time (work_per_second)                  kBudget, unscanned
//   others kept the threads busy, however long                        inspected
//
// It always comes: robots take turns, one request each, and an inspection is bounded, since what
// makes it can be killed (YARA: scan_time; plugins: answer_time, and greeting_time to start anew).
// While others keep all threads busy, requests wait here, their batches in the robots' message
// lanes, and their sensors run out of credit: the robot's backlog and loss tell, no verdict does.
//
// A robot is *slow* for slow_for after one of its inspections took slow_after or more. All slow
// robots together get all threads but one:
//
//   threads   busy with slow robots   next in line is     its turn
//   1         0                       slow or not         comes
//   n > 1     fewer than n - 1        slow or not         comes
//   n > 1     n - 1                   not slow            comes
//   n > 1     n - 1                   slow                waits for one of the slow, others pass it
//
// So whoever is stuck again and again holds up the others at most once, for one inspection.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_INSPECTION_POOL_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_INSPECTION_POOL_H_

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
#include "policy_server/policy/engine/state/verdict.h"
#include "policy_server/policy/inspect/inspection_set.h"
#include "policy_server/policy/inspect/message.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::inspect {

struct PoolOptions {
  // 1 to kPoolThreadsMax; others are taken as the nearest.
  int threads = 1;
  // When every thread has been in one inspection for this long, Submit starts one more, up to
  // kPoolThreadsMax. Longer than what can be killed takes: only for a process that the kernel does
  // not let go.
  absl::Duration stuck_after = absl::Seconds(3);
  absl::Duration slow_after = absl::Milliseconds(50);
  absl::Duration slow_for = absl::Seconds(10);
  // Requests of one robot waiting. There is no limit in all: others' requests must not make this
  // robot's unscanned, and payloads stay in the robots' lanes, which are bounded by credit.
  size_t waiting_per_robot_max = 64;
  // Inspection time of the same robot between Submit and the start of the work.
  absl::Duration queue_time_max = absl::Milliseconds(250);
  // Inspection time of one robot per second of wall time; also what it may save up. What an
  // inspection takes beyond it is a debt. 30 pictures of 0.9 MB a second take a plugin and a YARA
  // file 100 to 200 ms of it (tests/bench/README.md).
  absl::Duration work_per_second = absl::Milliseconds(400);
  // Robots remembered for the above, more than a server has. Those that owe nothing and wait for
  // nothing are forgotten.
  size_t robots_max = 4'096;
};

// Below the 32 scanners that libyara allows for the same rules.
inline constexpr int kPoolThreadsMax = 16;

// Why a request, or the rest of it, was answered without work.
enum class Skipped {
  kNot,        // it was not
  kFull,       // more robots than robots_max
  kRobotFull,  // too much of this robot waits
  kLate,       // it waited longer than queue_time_max for its own robot's inspections
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
  // not, and every verdict is kUnscanned.
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
    // `worked_ns` of its robot then.
    int64_t worked_before_ns = 0;
  };
  struct Robot {
    std::deque<Item> items;
    // In all inspections so far.
    int64_t worked_ns = 0;
    int64_t slow_until_ns = 0;
    // Time it may still use; negative when it owes.
    double budget_ns = 0;
    int64_t refilled_ns = 0;
    // A thread works for it: its next request waits for that. As a slow one, if it was then.
    bool served = false;
    bool served_as_slow = false;
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
  // Taken from the line; nullptr if all in it must wait (see above).
  Robot* NextRobotLocked(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Skipped AdmitLocked(const Robot* robot) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Skipped Count(Skipped how);

  const PoolOptions options_;
  const Clock* const clock_;  // Not owned; outlives this.
  mutable Mutex mu_;
  CondVar changed_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  size_t waiting_ ABSL_GUARDED_BY(mu_) = 0;
  // Threads that work for slow robots.
  size_t slow_served_ ABSL_GUARDED_BY(mu_) = 0;
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

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_INSPECTION_POOL_H_

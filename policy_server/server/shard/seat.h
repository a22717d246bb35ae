// Where a robot sits: its queues, and what fairness remembers of it. A robot's thread changes when
// its seat moves to another shard; tasks are in the seat and move with it.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_SEAT_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_SEAT_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "policy_server/server/robot/robot.h"
#include "policy_server/server/shard/fair_turns.h"
#include "services/base/cpu_budget.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {

class Shard;

// Queues of one robot; an earlier one is emptied before a later one.
enum class Queue {
  // Operators and the server itself, which are not charged to the robot's budget (operators have
  // quotas), and what completes the robot's own work. Never deferred.
  kOrders,
  kActuators,
  kControl,
  kMessages,
};
inline constexpr size_t kQueueCount = 4;

inline Queue QueueOf(Lane lane) {
  return lane == Lane::kControl ? Queue::kControl : Queue::kMessages;
}

// The graph in force, for readers off the shard. Null until the robot has run.
struct GraphView {
  std::shared_ptr<const ros2::RosGraph> graph;
  // As Robot::graph_changed_unix_ns.
  int64_t changed_unix_ns = 0;
};

struct SeatTask {
  // Empty: Robot::Advance.
  std::function<void(Robot&)> run;
  // CLOCK_BOOTTIME.
  int64_t posted_ns = 0;
  // To the robot's budget.
  bool charged = true;
};

struct Seat {
  Seat(std::string name, Shard* own_shard, const CpuBudget& allowance)
      : robot_name(std::move(name)), home(own_shard), budget(allowance), shard(own_shard) {}

  const std::string robot_name;
  // Where it returns to from the thread of slow robots.
  Shard* const home;

  // ---- once it has been handed over, touched by the thread of `shard` alone
  std::unique_ptr<Robot> robot;
  CpuBudget budget;
  bool leaving = false;
  // Its work costs too much for the others of a shared shard.
  bool slow = false;
  // When a piece of its work last cost more than PipelineLimits::long_task_ns.
  int64_t long_task_at_ns = 0;
  // As of TimeRounds.
  size_t joined = 0;
  // CPU time in round `used_in_round` of its shard.
  int64_t used_ns = 0;
  uint64_t used_in_round = 0;
  // Since its tasks wait for its budget; 0 = they do not. It was reported.
  int64_t deferred_since_ns = 0;
  int64_t deferred_last_ns = 0;
  bool deferral_reported = false;
  // Longest wait of a task since it was last reported, what was reported, and when it is due again.
  int64_t longest_wait_ns = 0;
  int64_t wait_due_ns = 0;
  int64_t reported_wait_ns = -1;
  uint64_t view_revision = 0;

  // ---- any thread
  enum class State { kIdle, kReady, kDeferred };
  // Locked before a shard's.
  Mutex mu;
  // Whose thread runs the tasks.
  Shard* shard ABSL_GUARDED_BY(mu);
  // kReady: it waits for its turn at `shard`, or has it.
  State state ABSL_GUARDED_BY(mu) = State::kIdle;
  std::array<std::deque<SeatTask>, kQueueCount> queues ABSL_GUARDED_BY(mu);
  // Nothing runs any more.
  bool closed ABSL_GUARDED_BY(mu) = false;
  GraphView view ABSL_GUARDED_BY(mu);
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_SEAT_H_

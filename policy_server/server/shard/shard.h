// One thread that judges robots, in fair turns.
//
// Between any two tasks the thread looks at the time: every 50 ms (PipelineLimits::time_step_ns) it
// calls OnTime of each of its robots (leases, heartbeats, deadlines), whatever waits. It tells many
// robots in parts, so that no task waits for all of them, and what they send and store comes in no
// bursts. Otherwise the next turn belongs to the robot that has used the least time (FairTurns); it
// lasts one task, or several short ones up to PipelineLimits::turn_ns. A robot without budget
// (CpuBudget) has no turns, except for orders.
//
// A robot delays the others of its thread by one task at most, and only once: one whose task was
// long moves to the thread of slow robots. Leases are sent by the thread that judges, on purpose: a
// lease says that the robot is guarded, so a thread that hangs must let the leases of its robots
// run out.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_SHARD_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_SHARD_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "policy_server/server/shard/fair_turns.h"
#include "policy_server/server/shard/pipeline_options.h"
#include "policy_server/server/shard/seat.h"
#include "policy_server/server/shard/time_rounds.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {

class Shard {
 public:
  // How long a robot's tasks must not have waited for its budget until that is news again.
  static constexpr int64_t kDeferralOverNs = 60 * kNanosPerSecond;

  struct Options {
    const Clock* clock = nullptr;
    // CPU time of the calling thread.
    std::function<int64_t()> cpu_ns;
    PipelineLimits limits;
    const PipelineReports* reports = nullptr;
    // Called on the shard's thread when a robot that left has been destroyed.
    std::function<void(const std::string&)> on_gone;
    // Where robots go whose tasks are long; null: this is that shard.
    Shard* slow = nullptr;
  };
  struct Lateness {
    int64_t late_ns = 0;
    // Used the most of that time; empty = none did anything.
    std::string robot;
  };

  explicit Shard(Options options);

  // A new robot's seat, whose home this is.
  void Own(std::shared_ptr<Seat> seat) ABSL_LOCKS_EXCLUDED(mu_);
  void Start();
  // Ends the thread; waits for the task that runs.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  // Both any thread. False: too many tasks wait, or the seat is closed.
  static bool Push(const std::shared_ptr<Seat>& seat, Queue queue, SeatTask task, size_t max);
  // A closed seat drops what waits and what comes.
  static void Close(Seat& seat);
  // After all that waits in its control queue: ends its sessions with `why`.
  static void Leave(const std::shared_ptr<Seat>& seat, absl::Status why, int64_t now_ns);

  // How late this thread was, or is, at most since the last call.
  Lateness TakeLateness(int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  // How often the thread has called OnTime of all its robots; grows while it does not hang.
  uint64_t rounds() const { return rounds_; }

 private:
  using Seated = std::shared_ptr<Seat>;

  void Run();
  void MakeReady(const Seated& seat) ABSL_LOCKS_EXCLUDED(mu_);
  // One turn, from `now_ns`; returns when it ended.
  int64_t Serve(const Seated& seat, int64_t now_ns);
  // The seat's next task; without a function: what is left of a batch. Nullopt: it has no turn now.
  static std::optional<SeatTask> Pop(Seat& seat, int64_t now_ns);
  static std::optional<SeatTask> PopFrom(Seat& seat, Queue queue)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(seat.mu);
  int64_t Account(Seat& seat, int64_t wall_ns, int64_t now_ns, bool charged);
  void EndTurn(const Seated& seat, int64_t used_ns, bool again) ABSL_LOCKS_EXCLUDED(mu_);
  void RunTime(int64_t now_ns);
  void UpdateDeferral(const Seated& seat, int64_t now_ns);
  void PublishGraph(Seat& seat);
  // True if the robot has left.
  bool LetGo(const Seated& seat);
  // To the thread where its costs belong, if that is another.
  void Move(const Seated& seat);
  void SetRunning(const Seated& seat, int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  int64_t NowNs() const { return options_.clock->Now().boottime_ns; }

  const Options options_;
  // The shard's thread alone.
  std::vector<Seated> seats_;
  TimeRounds time_;
  CostMeter meter_;
  int64_t time_at_ns_ = 0;
  std::atomic<uint64_t> rounds_ = 0;
  std::thread thread_;

  Mutex mu_;
  CondVar changed_;
  // From the server itself: seats that come.
  std::vector<Seated> arrivals_ ABSL_GUARDED_BY(mu_);
  FairTurns<Seated> turns_ ABSL_GUARDED_BY(mu_);
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  // For TakeLateness: when OnTime is due, what runs since when, who used the most time since then.
  int64_t due_ns_ ABSL_GUARDED_BY(mu_) = 0;
  Seated running_ ABSL_GUARDED_BY(mu_);
  int64_t running_since_ns_ ABSL_GUARDED_BY(mu_) = 0;
  Seated most_by_ ABSL_GUARDED_BY(mu_);
  int64_t most_ns_ ABSL_GUARDED_BY(mu_) = 0;
  Lateness latest_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_SHARD_H_

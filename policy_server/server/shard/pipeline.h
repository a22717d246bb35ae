// The robots of this server, distributed over threads. A robot is judged by one thread at a time,
// that of its shard, and only that thread touches it; everything else crosses by Post. Robots of a
// shard take fair turns (shard.h), and one whose tasks are long moves to a thread of its kind.
//
// Robots come and go while the shards run. What a robot's name is to this server:
//   judged    Add     Post runs the task on the robot's thread
//   held      Hold    Post answers with the status given: nothing judges it, its level stands
//   leaving   Remove  Post answers NotFound; the robot stays, deaf, until all that it decided is
//                     durable, and is destroyed on its own thread. Add answers Unavailable till
//                     then
//   unknown           Post answers NotFound
// A task that was posted before Remove runs before it (all but messages) or not at all (messages);
// no task and no callback of a robot runs once it is destroyed.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_PIPELINE_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_PIPELINE_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "policy_server/server/robot/robot.h"
#include "policy_server/server/shard/pipeline_options.h"
#include "policy_server/server/shard/seat.h"
#include "services/base/clock.h"
#include "services/runtime/log_limiter.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {

class Shard;

// What robots answered to a question of all of them.
template <typename T>
struct Gathered {
  // By robot.
  absl::btree_map<std::string, T> answers;
  // Robots that have not answered in time; sorted.
  std::vector<std::string> silent;
};

class Pipeline {
 public:
  // How long a question of all robots waits for their answers, in all.
  static constexpr absl::Duration kPatience = absl::Seconds(5);

  // `shards` >= 1; slow robots have one more. `clock` is not owned and outlives this. `cpu_ns` is
  // the CPU time of the calling thread; null: its CLOCK_THREAD_CPUTIME_ID.
  Pipeline(int shards, const Clock* clock, PipelineLimits limits = {}, PipelineReports reports = {},
           std::function<int64_t()> cpu_ns = nullptr);
  ~Pipeline();

  // Any time, any thread. `ports.post` is filled in here. Ends a Hold. Errors of Robot::Create,
  // AlreadyExists, Unavailable while an earlier robot of that name is leaving.
  absl::Status Add(RobotConfig config, Policy policy, Timing timing,
                   const store::RobotRecord& record, uint64_t term, Ports ports)
      ABSL_LOCKS_EXCLUDED(mu_);
  // A robot that nothing judges: `status` is what operators see of it, `why` what all others hear.
  // Replaces an earlier Hold; AlreadyExists if the robot is judged.
  absl::Status Hold(RobotStatus status, absl::Status why) ABSL_LOCKS_EXCLUDED(mu_);
  // Ends the robot's sessions with `why`; see above. NotFound.
  absl::Status Remove(absl::string_view robot, absl::Status why) ABSL_LOCKS_EXCLUDED(mu_);
  // True when no robot of that name is leaving; waits at most `patience` for it.
  bool WaitGone(absl::string_view robot, absl::Duration patience) ABSL_LOCKS_EXCLUDED(mu_);
  void Start();
  // Ends the threads; tasks still waiting are dropped. Idempotent.
  void Stop();

  // Runs `task` on the robot's thread. An earlier Queue goes first; each keeps its order. NotFound
  // for an unknown robot, ResourceExhausted if too many tasks of it wait in that queue. Any thread.
  absl::Status Post(absl::string_view robot, Queue queue, std::function<void(Robot&)> task)
      ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Post(absl::string_view robot, Lane lane, std::function<void(Robot&)> task) {
    return Post(robot, QueueOf(lane), std::move(task));
  }
  // Tasks of the robot were refused, here or on their way, because too many wait.
  void ReportRefused(const std::string& robot) const {
    if (reports_.refused) reports_.refused(robot);
  }
  // The graph in force, without a turn on the robot's thread. Errors of Post.
  absl::StatusOr<GraphView> Graph(absl::string_view robot) const ABSL_LOCKS_EXCLUDED(mu_);
  // Runs `task` as an order on every robot that is judged, in no order; waits until all have run,
  // at most `patience`, and returns those that have not, sorted. Their task may still run later, so
  // it must own all that it touches. Not from a shard's thread.
  std::vector<std::string> ForEach(std::function<void(Robot&)> task,
                                   absl::Duration patience = kPatience) ABSL_LOCKS_EXCLUDED(mu_);
  // What `ask` returns of every robot, in the same way: an answer that comes too late is dropped.
  template <typename T>
  Gathered<T> Gather(std::function<T(Robot&)> ask, absl::Duration patience = kPatience) {
    struct Box {
      Mutex mu;
      absl::btree_map<std::string, T> answers ABSL_GUARDED_BY(mu);
    };
    auto box = std::make_shared<Box>();
    Gathered<T> gathered;
    gathered.silent = ForEach(
        [box, ask = std::move(ask)](Robot& robot) {
          T answer = ask(robot);
          MutexLock lock(&box->mu);
          box->answers.insert_or_assign(robot.id(), std::move(answer));
        },
        patience);
    MutexLock lock(&box->mu);
    gathered.answers = box->answers;
    // One that answered between the two is told once.
    for (const std::string& robot : gathered.silent) gathered.answers.erase(robot);
    return gathered;
  }

  // For what is logged of one robot's agents.
  LogLimiter& logs() { return logs_; }
  // Those that are judged; sorted.
  std::vector<std::string> robots() const ABSL_LOCKS_EXCLUDED(mu_);
  // Tasks that wait now, by robot and by Queue: of those that are judged. Any thread.
  using Waiting = absl::btree_map<std::string, std::array<size_t, kQueueCount>>;
  Waiting waiting() const ABSL_LOCKS_EXCLUDED(mu_);
  // Those that are held; sorted by name.
  std::vector<RobotStatus> held() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Held {
    RobotStatus status;
    absl::Status why;
  };
  using Seats = absl::btree_map<std::string, std::shared_ptr<Seat>>;
  // How late a thread was, and the alert about it.
  struct Watched {
    std::string name;
    Shard* shard = nullptr;
    int64_t longest_ns[2] = {0, 0};
    int64_t reported_ns = -1;
    // When it was late by more than late_ns; 0 = not in this episode.
    int64_t late_at_ns = 0;
    // Of the shard, when all of them were last seen to advance.
    uint64_t rounds = 0;
  };
  // On the shard's thread, when the robot has been destroyed.
  void OnGone(const std::string& robot) ABSL_LOCKS_EXCLUDED(mu_);
  Shard* Emptiest() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Why nothing can be posted to that robot.
  absl::Status Unseated(absl::string_view robot) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Looks after the threads, on one of its own.
  void Watch() ABSL_LOCKS_EXCLUDED(watch_mu_);
  // `next`: the next half of what a longest lateness is shown for begins.
  void Look(Watched& watched, int64_t now_ns, bool next);

  const Clock* clock_;
  const PipelineLimits limits_;
  const PipelineReports reports_;
  LogLimiter logs_;
  std::unique_ptr<Shard> slow_;
  std::vector<std::unique_ptr<Shard>> shards_;
  std::thread watch_;
  Mutex watch_mu_;
  CondVar watch_ends_;
  bool watch_over_ ABSL_GUARDED_BY(watch_mu_) = false;
  mutable Mutex mu_;
  CondVar gone_;
  bool stopped_ ABSL_GUARDED_BY(mu_) = false;
  Seats robots_ ABSL_GUARDED_BY(mu_);
  Seats leaving_ ABSL_GUARDED_BY(mu_);
  absl::btree_map<std::string, Held> held_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_PIPELINE_H_

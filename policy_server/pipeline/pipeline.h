// The robots of this server, distributed over threads. A robot belongs to one shard, a shard is one
// thread, and only that thread touches its robots; everything else crosses by Post.
//
// Robots come and go while the shards run. What a robot's name is to this server:
//   judged    Add     Post runs the task on the robot's thread
//   held      Hold    Post answers with the status given: nothing judges it, its level stands
//   leaving   Remove  Post answers NotFound; the robot stays, deaf, until all that it decided is
//                     durable, and is destroyed on its own thread. Add answers Unavailable till
//                     then
//   unknown           Post answers NotFound
// A task that was posted before Remove runs before it (control) or not at all (messages); no task
// and no callback of a robot runs once it is destroyed.
#ifndef RIPS_POLICY_SERVER_PIPELINE_PIPELINE_H_
#define RIPS_POLICY_SERVER_PIPELINE_PIPELINE_H_

#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "policy_server/pipeline/log_limiter.h"
#include "policy_server/pipeline/robot.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {

class Shard;
struct Seat;

struct PipelineLimits {
  // Tasks waiting in one shard, per lane. Credit keeps sensors far below; a peer that does not keep
  // to it is refused.
  size_t control_max = 65'536;
  size_t messages_max = 16'384;
};

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

  // `shards` >= 1. `clock` is not owned and outlives this.
  Pipeline(int shards, const Clock* clock, PipelineLimits limits = {});
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

  // Runs `task` on the robot's thread. Control tasks run before message tasks; each lane in order.
  // NotFound for an unknown robot, ResourceExhausted if the shard is overloaded. Any thread.
  absl::Status Post(absl::string_view robot, Lane lane, std::function<void(Robot&)> task)
      ABSL_LOCKS_EXCLUDED(mu_);
  // The same on every robot that is judged, in no order; waits until all have run, at most
  // `patience`, and returns those that have not, sorted. Their task may still run later, so it must
  // own all that it touches. Not from a shard's thread.
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
  // Those that are held; sorted by name.
  std::vector<RobotStatus> held() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Held {
    RobotStatus status;
    absl::Status why;
  };
  struct Place {
    Shard* shard = nullptr;
    std::shared_ptr<Seat> seat;
  };
  // On the shard's thread, when the robot has been destroyed.
  void OnGone(const std::string& robot) ABSL_LOCKS_EXCLUDED(mu_);
  Shard* Emptiest() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const Clock* clock_;
  LogLimiter logs_;
  std::vector<std::unique_ptr<Shard>> shards_;
  mutable Mutex mu_;
  CondVar gone_;
  absl::btree_map<std::string, Place> robots_ ABSL_GUARDED_BY(mu_);
  absl::btree_map<std::string, Place> leaving_ ABSL_GUARDED_BY(mu_);
  absl::btree_map<std::string, Held> held_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_PIPELINE_PIPELINE_H_

#include "policy_server/pipeline/pipeline.h"

#include <algorithm>
#include <deque>
#include <thread>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {
namespace {

// How often robots are told the time: a tenth of a heartbeat.
constexpr int64_t kTimeStepNs = 50 * kNanosPerMilli;

}  // namespace

class Shard {
 public:
  Shard(const Clock* clock, PipelineLimits limits) : clock_(clock), limits_(limits) {}

  Robot* Own(std::unique_ptr<Robot> robot) {
    robots_.push_back(std::move(robot));
    return robots_.back().get();
  }

  void Start() {
    thread_ = std::thread([this] { Run(); });
  }

  void Stop() ABSL_LOCKS_EXCLUDED(mu_) {
    {
      MutexLock lock(&mu_);
      stopping_ = true;
      changed_.NotifyAll();
    }
    if (thread_.joinable()) thread_.join();
  }

  bool Push(Lane lane, std::function<void()> task) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (stopping_) return false;
    std::deque<std::function<void()>>& queue = lane == Lane::kControl ? control_ : messages_;
    if (queue.size() >= (lane == Lane::kControl ? limits_.control_max : limits_.messages_max)) {
      return false;
    }
    queue.push_back(std::move(task));
    changed_.NotifyOne();
    return true;
  }

  // From the server itself, for work that was admitted before: never refused.
  void PushOwn(std::function<void()> task) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (stopping_) return;
    control_.push_back(std::move(task));
    changed_.NotifyOne();
  }

 private:
  void Run() {
    int64_t time_at_ns = 0;
    while (true) {
      std::deque<std::function<void()>> control;
      std::function<void()> message;
      {
        MutexLock lock(&mu_);
        while (!stopping_ && control_.empty() && messages_.empty()) {
          if (!changed_.WaitUntil(lock, time_at_ns)) break;
        }
        if (stopping_) return;
        control.swap(control_);
        if (control.empty() && !messages_.empty()) {
          message = std::move(messages_.front());
          messages_.pop_front();
        }
      }
      for (const auto& task : control) task();
      if (message) message();
      if (clock_->Now().boottime_ns < time_at_ns) continue;
      for (const auto& robot : robots_) robot->OnTime();
      time_at_ns = clock_->Now().boottime_ns + kTimeStepNs;
    }
  }

  const Clock* clock_;
  const PipelineLimits limits_;
  std::vector<std::unique_ptr<Robot>> robots_;
  std::thread thread_;
  Mutex mu_;
  CondVar changed_;
  std::deque<std::function<void()>> control_ ABSL_GUARDED_BY(mu_);
  std::deque<std::function<void()>> messages_ ABSL_GUARDED_BY(mu_);
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
};

Pipeline::Pipeline(int shards, const Clock* clock, PipelineLimits limits) : clock_(clock) {
  for (int i = 0; i < shards; ++i) shards_.push_back(std::make_unique<Shard>(clock, limits));
}

Pipeline::~Pipeline() { Stop(); }

absl::Status Pipeline::Add(RobotConfig config, Policy policy, Timing timing,
                           const store::RobotRecord& record, uint64_t term, Ports ports) {
  Shard* shard = shards_[names_.size() % shards_.size()].get();
  ports.clock = clock_;
  ports.post = [shard](std::function<void()> task) { shard->PushOwn(std::move(task)); };
  RIPS_ASSIGN_OR_RETURN(
      std::unique_ptr<Robot> robot,
      Robot::Create(std::move(config), std::move(policy), timing, record, term, std::move(ports)));
  const std::string id = robot->id();
  robots_[id] = {shard, shard->Own(std::move(robot))};
  names_.push_back(id);
  std::sort(names_.begin(), names_.end());
  return absl::OkStatus();
}

void Pipeline::Start() {
  for (const auto& shard : shards_) shard->Start();
}

void Pipeline::Stop() {
  for (const auto& shard : shards_) shard->Stop();
}

absl::Status Pipeline::Post(absl::string_view robot, Lane lane, std::function<void(Robot&)> task) {
  const auto it = robots_.find(robot);
  if (it == robots_.end()) {
    return absl::NotFoundError(
        absl::StrCat("robot `", absl::CHexEscape(robot), "` is not in the inventory"));
  }
  auto [shard, owned] = it->second;
  if (!shard->Push(lane, [owned = owned, task = std::move(task)] { task(*owned); })) {
    return absl::ResourceExhaustedError("the server is overloaded; try again later");
  }
  return absl::OkStatus();
}

void Pipeline::ForEach(const std::function<void(Robot&)>& task) {
  struct Countdown {
    Mutex mu;
    CondVar done;
    size_t left ABSL_GUARDED_BY(mu) = 0;
  };
  auto countdown = std::make_shared<Countdown>();
  {
    MutexLock lock(&countdown->mu);
    countdown->left = robots_.size();
  }
  for (auto& [name, place] : robots_) {
    place.first->PushOwn([countdown, task, robot = place.second] {
      task(*robot);
      MutexLock lock(&countdown->mu);
      --countdown->left;
      countdown->done.NotifyAll();
    });
  }
  MutexLock lock(&countdown->mu);
  // A shard that is stopping drops its tasks: do not wait for ever.
  while (countdown->left > 0 && countdown->done.WaitFor(lock, absl::Seconds(5))) {
  }
}

}  // namespace rips::pipeline

#include "policy_server/pipeline/pipeline.h"

#include <algorithm>
#include <chrono>
#include <deque>
#include <thread>

#include "absl/container/btree_set.h"
#include "absl/container/flat_hash_map.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {
namespace {

// How often robots are told the time: a tenth of a heartbeat.
constexpr int64_t kTimeStepNs = 50 * kNanosPerMilli;

// What is left of a wait, whatever the wall clock does.
class Patience {
 public:
  explicit Patience(absl::Duration length)
      : end_(std::chrono::steady_clock::now() + absl::ToChronoNanoseconds(length)) {}
  absl::Duration left() const { return absl::FromChrono(end_ - std::chrono::steady_clock::now()); }
  bool over() const { return left() <= absl::ZeroDuration(); }

 private:
  std::chrono::steady_clock::time_point end_;
};

}  // namespace

// Where a robot sits. Tasks hold the seat, not the robot: an empty one drops them.
struct Seat {
  // Once it has been handed over, touched by its shard's thread alone.
  std::unique_ptr<Robot> robot;
};

class Shard {
 public:
  // `on_gone` is called on the shard's thread.
  Shard(const Clock* clock, PipelineLimits limits, std::function<void(const std::string&)> on_gone)
      : clock_(clock), limits_(limits), on_gone_(std::move(on_gone)) {}

  void Own(std::shared_ptr<Seat> seat) {
    PushOwn([this, seat = std::move(seat)] { seats_.push_back(seat); });
  }

  // After all that was posted before.
  void Leave(std::shared_ptr<Seat> seat, absl::Status why) {
    PushOwn([this, seat = std::move(seat), why = std::move(why)] {
      ++leaving_;
      seat->robot->Retire(why);
    });
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
    // Whoever waits for one of these learns that it will not run.
    std::deque<std::function<void()>> control, messages;
    MutexLock lock(&mu_);
    control.swap(control_);
    messages.swap(messages_);
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
      if (leaving_ > 0) LetGo();
      if (clock_->Now().boottime_ns < time_at_ns) continue;
      for (const auto& seat : seats_) seat->robot->OnTime();
      if (leaving_ > 0) LetGo();
      time_at_ns = clock_->Now().boottime_ns + kTimeStepNs;
    }
  }

  // Of those that leave, whoever has nothing left to record.
  void LetGo() {
    for (auto it = seats_.begin(); it != seats_.end();) {
      if (!(*it)->robot->gone()) {
        ++it;
        continue;
      }
      const std::string id = (*it)->robot->id();
      (*it)->robot.reset();
      it = seats_.erase(it);
      --leaving_;
      on_gone_(id);
    }
  }

  const Clock* clock_;
  const PipelineLimits limits_;
  const std::function<void(const std::string&)> on_gone_;
  // The shard's thread alone.
  std::vector<std::shared_ptr<Seat>> seats_;
  size_t leaving_ = 0;
  std::thread thread_;
  Mutex mu_;
  CondVar changed_;
  std::deque<std::function<void()>> control_ ABSL_GUARDED_BY(mu_);
  std::deque<std::function<void()>> messages_ ABSL_GUARDED_BY(mu_);
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
};

Pipeline::Pipeline(int shards, const Clock* clock, PipelineLimits limits) : clock_(clock) {
  for (int i = 0; i < shards; ++i) {
    shards_.push_back(std::make_unique<Shard>(clock, limits,
                                              [this](const std::string& robot) { OnGone(robot); }));
  }
}

Pipeline::~Pipeline() { Stop(); }

Shard* Pipeline::Emptiest() {
  absl::flat_hash_map<Shard*, size_t> robots;
  for (const auto& [name, place] : robots_) ++robots[place.shard];
  for (const auto& [name, place] : leaving_) ++robots[place.shard];
  return std::min_element(
             shards_.begin(), shards_.end(),
             [&](const auto& a, const auto& b) { return robots[a.get()] < robots[b.get()]; })
      ->get();
}

absl::Status Pipeline::Add(RobotConfig config, Policy policy, Timing timing,
                           const store::RobotRecord& record, uint64_t term, Ports ports) {
  const std::string id = config.id;
  MutexLock lock(&mu_);
  if (robots_.contains(id)) {
    return absl::AlreadyExistsError(absl::StrCat("robot `", id, "` is there already"));
  }
  if (leaving_.contains(id)) {
    return absl::UnavailableError(
        absl::StrCat("robot `", id, "` was removed, and what it decided is not recorded yet"));
  }
  Shard* shard = Emptiest();
  auto seat = std::make_shared<Seat>();
  ports.clock = clock_;
  // Held weakly: the seat owns the robot, and the robot this.
  ports.post = [shard, weak = std::weak_ptr<Seat>(seat)](std::function<void()> task) {
    std::shared_ptr<Seat> taken = weak.lock();
    if (taken == nullptr) return;
    shard->PushOwn([taken = std::move(taken), task = std::move(task)] {
      if (taken->robot != nullptr) task();
    });
  };
  RIPS_ASSIGN_OR_RETURN(seat->robot, Robot::Create(std::move(config), std::move(policy), timing,
                                                   record, term, std::move(ports)));
  shard->Own(seat);
  robots_[id] = {.shard = shard, .seat = std::move(seat)};
  held_.erase(id);
  return absl::OkStatus();
}

absl::Status Pipeline::Hold(RobotStatus status, absl::Status why) {
  MutexLock lock(&mu_);
  if (robots_.contains(status.robot)) {
    return absl::AlreadyExistsError(absl::StrCat("robot `", status.robot, "` is judged"));
  }
  std::string id = status.robot;
  held_.insert_or_assign(std::move(id), Held{.status = std::move(status), .why = std::move(why)});
  return absl::OkStatus();
}

absl::Status Pipeline::Remove(absl::string_view robot, absl::Status why) {
  MutexLock lock(&mu_);
  if (held_.erase(robot) > 0) return absl::OkStatus();
  const auto it = robots_.find(robot);
  if (it == robots_.end()) return absl::NotFoundError(absl::StrCat("no robot `", robot, "`"));
  // Nothing is posted to it from now on.
  it->second.shard->Leave(it->second.seat, std::move(why));
  leaving_[it->first] = std::move(it->second);
  robots_.erase(it);
  return absl::OkStatus();
}

void Pipeline::OnGone(const std::string& robot) {
  MutexLock lock(&mu_);
  leaving_.erase(robot);
  gone_.NotifyAll();
}

bool Pipeline::WaitGone(absl::string_view robot, absl::Duration patience) {
  const Patience rest(patience);
  MutexLock lock(&mu_);
  while (leaving_.contains(robot)) {
    if (rest.over()) return false;
    gone_.WaitFor(lock, rest.left());
  }
  return true;
}

void Pipeline::Start() {
  for (const auto& shard : shards_) shard->Start();
}

void Pipeline::Stop() {
  for (const auto& shard : shards_) shard->Stop();
}

absl::Status Pipeline::Post(absl::string_view robot, Lane lane, std::function<void(Robot&)> task) {
  MutexLock lock(&mu_);
  const auto it = robots_.find(robot);
  if (it == robots_.end()) {
    if (const auto held = held_.find(robot); held != held_.end()) return held->second.why;
    return absl::NotFoundError(
        absl::StrCat("robot `", absl::CHexEscape(robot), "` is not in the inventory"));
  }
  if (!it->second.shard->Push(lane, [seat = it->second.seat, task = std::move(task)] {
        if (seat->robot != nullptr) task(*seat->robot);
      })) {
    return absl::ResourceExhaustedError("the server is overloaded; try again later");
  }
  return absl::OkStatus();
}

std::vector<std::string> Pipeline::ForEach(std::function<void(Robot&)> task,
                                           absl::Duration patience) {
  struct Round {
    Mutex mu;
    CondVar changed;
    // Robots whose task has not run.
    absl::btree_set<std::string> waiting ABSL_GUARDED_BY(mu);
    // Tasks that may still run.
    size_t pending ABSL_GUARDED_BY(mu) = 0;
  };
  // One task, which runs or is dropped: either way it no longer is pending.
  struct Ticket {
    explicit Ticket(std::shared_ptr<Round> of) : round(std::move(of)) {}
    ~Ticket() {
      MutexLock lock(&round->mu);
      --round->pending;
      round->changed.NotifyAll();
    }
    std::shared_ptr<Round> round;
  };
  auto round = std::make_shared<Round>();
  auto shared = std::make_shared<std::function<void(Robot&)>>(std::move(task));
  {
    MutexLock lock(&mu_);
    for (const auto& [name, place] : robots_) {
      {
        MutexLock round_lock(&round->mu);
        round->waiting.insert(name);
        ++round->pending;
      }
      auto ticket = std::make_shared<Ticket>(round);
      place.shard->PushOwn([ticket, shared, name = name, seat = place.seat] {
        if (seat->robot != nullptr) (*shared)(*seat->robot);
        MutexLock round_lock(&ticket->round->mu);
        ticket->round->waiting.erase(name);
      });
    }
  }
  const Patience rest(patience);
  MutexLock lock(&round->mu);
  while (!round->waiting.empty() && round->pending > 0 && !rest.over()) {
    round->changed.WaitFor(lock, rest.left());
  }
  return {round->waiting.begin(), round->waiting.end()};
}

std::vector<std::string> Pipeline::robots() const {
  std::vector<std::string> names;
  MutexLock lock(&mu_);
  for (const auto& [name, place] : robots_) names.push_back(name);
  return names;
}

std::vector<RobotStatus> Pipeline::held() const {
  std::vector<RobotStatus> out;
  MutexLock lock(&mu_);
  for (const auto& [name, held] : held_) out.push_back(held.status);
  return out;
}

}  // namespace rips::pipeline

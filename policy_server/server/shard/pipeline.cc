#include "policy_server/server/shard/pipeline.h"

#include <time.h>

#include <algorithm>
#include <chrono>

#include "absl/container/btree_set.h"
#include "absl/container/flat_hash_map.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/shard/shard.h"
#include "services/base/status_macros.h"

namespace rips::pipeline {
namespace {

constexpr absl::Duration kWatchEvery = absl::Milliseconds(100);
// A thread that was in time for so long begins a new episode.
constexpr int64_t kLateOverNs = 10 * kNanosPerSecond;
// Between two looks: the machine was suspended, or the process stopped.
constexpr int64_t kSuspendedNs = 5 * kNanosPerSecond;
// Half of the time for which a longest lateness is shown.
constexpr int64_t kLatenessShownNs = 10 * kNanosPerSecond;

int64_t ThreadCpuNs() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return now.tv_sec * kNanosPerSecond + now.tv_nsec;
}

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

Pipeline::Pipeline(int shards, const Clock* clock, PipelineLimits limits, PipelineReports reports,
                   std::function<int64_t()> cpu_ns)
    : clock_(clock), limits_(limits), reports_(std::move(reports)) {
  Shard::Options options{.clock = clock,
                         .cpu_ns = cpu_ns ? std::move(cpu_ns) : ThreadCpuNs,
                         .limits = limits,
                         .reports = &reports_,
                         .on_gone = [this](const std::string& robot) { OnGone(robot); }};
  slow_ = std::make_unique<Shard>(options);
  options.slow = slow_.get();
  for (int i = 0; i < shards; ++i) shards_.push_back(std::make_unique<Shard>(options));
}

Pipeline::~Pipeline() { Stop(); }

Shard* Pipeline::Emptiest() {
  absl::flat_hash_map<const Shard*, size_t> robots;
  for (const auto& [name, seat] : robots_) ++robots[seat->home];
  for (const auto& [name, seat] : leaving_) ++robots[seat->home];
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
  auto seat = std::make_shared<Seat>(
      id, shard,
      CpuBudget(limits_.cpu_per_second_ns, limits_.cpu_burst_ns, clock_->Now().boottime_ns));
  ports.clock = clock_;
  // Held weakly: the seat owns the robot, and the robot this.
  const auto post_to = [clock = clock_, weak = std::weak_ptr<Seat>(seat)](Queue queue) {
    return [clock, weak, queue](std::function<void()> task) {
      const std::shared_ptr<Seat> taken = weak.lock();
      if (taken == nullptr) return;
      Shard::Push(taken, queue,
                  {.run = [task = std::move(task)](Robot&) { task(); },
                   .posted_ns = clock->Now().boottime_ns},
                  SIZE_MAX);
    };
  };
  ports.post = post_to(Queue::kOrders);
  ports.post_work = post_to(Queue::kControl);
  RIPS_ASSIGN_OR_RETURN(seat->robot, Robot::Create(std::move(config), std::move(policy), timing,
                                                   record, term, std::move(ports)));
  if (stopped_) Shard::Close(*seat);
  shard->Own(seat);
  robots_[id] = std::move(seat);
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
  Shard::Leave(it->second, std::move(why), clock_->Now().boottime_ns);
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
  slow_->Start();
  for (const auto& shard : shards_) shard->Start();
  watch_ = std::thread([this] { Watch(); });
}

void Pipeline::Stop() {
  {
    MutexLock lock(&watch_mu_);
    watch_over_ = true;
    watch_ends_.NotifyAll();
  }
  if (watch_.joinable()) watch_.join();
  for (const auto& shard : shards_) shard->Stop();
  slow_->Stop();
  std::vector<std::shared_ptr<Seat>> seats;
  {
    MutexLock lock(&mu_);
    stopped_ = true;
    for (const auto& [name, seat] : robots_) seats.push_back(seat);
    for (const auto& [name, seat] : leaving_) seats.push_back(seat);
  }
  for (const auto& seat : seats) Shard::Close(*seat);
}

void Pipeline::Watch() {
  std::vector<Watched> threads = {{.name = "slow", .shard = slow_.get()}};
  for (size_t i = 0; i < shards_.size(); ++i) {
    threads.push_back({.name = absl::StrCat(i), .shard = shards_[i].get()});
  }
  int64_t looked_ns = clock_->Now().boottime_ns;
  int64_t shown_at_ns = looked_ns;
  while (true) {
    {
      MutexLock lock(&watch_mu_);
      if (watch_over_) return;
      watch_ends_.WaitFor(lock, kWatchEvery);
      if (watch_over_) return;
    }
    const int64_t now_ns = clock_->Now().boottime_ns;
    const bool next = now_ns - shown_at_ns >= kLatenessShownNs;
    if (next) shown_at_ns = now_ns;
    const bool stood_still = now_ns - std::exchange(looked_ns, now_ns) >= kSuspendedNs;
    for (Watched& watched : threads) {
      if (stood_still) {
        watched.shard->TakeLateness(now_ns);
      } else {
        Look(watched, now_ns, next);
      }
    }
    const bool advanced = std::all_of(threads.begin(), threads.end(), [](const Watched& each) {
      return each.shard->rounds() != each.rounds;
    });
    if (!advanced) continue;
    for (Watched& watched : threads) watched.rounds = watched.shard->rounds();
    if (reports_.advanced) reports_.advanced();
  }
}

void Pipeline::Look(Watched& watched, int64_t now_ns, bool next) {
  const Shard::Lateness late = watched.shard->TakeLateness(now_ns);
  int64_t& newest_ns = watched.longest_ns[0];
  if (next) watched.longest_ns[1] = std::exchange(newest_ns, 0);
  newest_ns = std::max(newest_ns, late.late_ns);
  const int64_t longest_ns = std::max(newest_ns, watched.longest_ns[1]);
  if (longest_ns != watched.reported_ns && reports_.lateness) {
    watched.reported_ns = longest_ns;
    reports_.lateness(watched.name, longest_ns);
  }
  if (late.late_ns < limits_.late_ns) {
    if (now_ns - watched.late_at_ns >= kLateOverNs) watched.late_at_ns = 0;
    return;
  }
  if (std::exchange(watched.late_at_ns, now_ns) == 0 && reports_.late) {
    reports_.late(late.robot, late.late_ns);
  }
}

absl::Status Pipeline::Unseated(absl::string_view robot) const {
  if (const auto held = held_.find(robot); held != held_.end()) return held->second.why;
  return absl::NotFoundError(
      absl::StrCat("robot `", absl::CHexEscape(robot), "` is not in the inventory"));
}

absl::Status Pipeline::Post(absl::string_view robot, Queue queue,
                            std::function<void(Robot&)> task) {
  const size_t max = queue == Queue::kOrders     ? limits_.orders_max
                     : queue == Queue::kMessages ? limits_.messages_max
                                                 : limits_.control_max;
  SeatTask work{.run = std::move(task),
                .posted_ns = clock_->Now().boottime_ns,
                .charged = queue != Queue::kOrders};
  MutexLock lock(&mu_);
  const auto it = robots_.find(robot);
  if (it == robots_.end()) return Unseated(robot);
  if (!Shard::Push(it->second, queue, std::move(work), max)) {
    ReportRefused(it->first);
    return absl::ResourceExhaustedError(
        absl::StrCat("more than ", max, " tasks of robot `", it->first, "` wait; try again later"));
  }
  return absl::OkStatus();
}

absl::StatusOr<GraphView> Pipeline::Graph(absl::string_view robot) const {
  MutexLock lock(&mu_);
  const auto it = robots_.find(robot);
  if (it == robots_.end()) return Unseated(robot);
  MutexLock seat_lock(&it->second->mu);
  return it->second->view;
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
    for (const auto& [name, seat] : robots_) {
      {
        MutexLock round_lock(&round->mu);
        round->waiting.insert(name);
        ++round->pending;
      }
      auto ticket = std::make_shared<Ticket>(round);
      const auto run = [ticket, shared, name = name](Robot& robot) {
        (*shared)(robot);
        MutexLock round_lock(&ticket->round->mu);
        ticket->round->waiting.erase(name);
      };
      Shard::Push(seat, Queue::kOrders,
                  {.run = run, .posted_ns = clock_->Now().boottime_ns, .charged = false}, SIZE_MAX);
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
  for (const auto& [name, seat] : robots_) names.push_back(name);
  return names;
}

Pipeline::Waiting Pipeline::waiting() const {
  Waiting tasks;
  MutexLock lock(&mu_);
  for (const auto& [name, seat] : robots_) {
    auto& counts = tasks[name];
    MutexLock seat_lock(&seat->mu);
    for (size_t i = 0; i < kQueueCount; ++i) counts[i] = seat->queues[i].size();
  }
  return tasks;
}

std::vector<RobotStatus> Pipeline::held() const {
  std::vector<RobotStatus> out;
  MutexLock lock(&mu_);
  for (const auto& [name, held] : held_) out.push_back(held.status);
  return out;
}

}  // namespace rips::pipeline

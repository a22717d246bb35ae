#include "policy_server/server/shard/shard.h"

#include <algorithm>
#include <thread>
#include <utility>

namespace rips::pipeline {
namespace {

// Once a second.
void ReportWait(const PipelineReports& reports, Seat& seat, int64_t now_ns) {
  if (now_ns < seat.wait_due_ns) return;
  seat.wait_due_ns = now_ns + kNanosPerSecond;
  const int64_t longest_ns = std::exchange(seat.longest_wait_ns, 0);
  if (longest_ns == seat.reported_wait_ns || !reports.waited) return;
  seat.reported_wait_ns = longest_ns;
  reports.waited(seat.robot_name, longest_ns);
}

}  // namespace

Shard::Shard(Options options)
    : options_(std::move(options)), time_(options_.limits.time_step_ns), meter_(options_.cpu_ns) {}

void Shard::Own(std::shared_ptr<Seat> seat) {
  MutexLock lock(&mu_);
  arrivals_.push_back(std::move(seat));
  changed_.NotifyOne();
}

void Shard::Start() {
  thread_ = std::thread([this] { Run(); });
}

void Shard::Stop() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    changed_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

bool Shard::Push(const Seated& seat, Queue queue, SeatTask task, size_t max) {
  MutexLock lock(&seat->mu);
  std::deque<SeatTask>& tasks = seat->queues[static_cast<size_t>(queue)];
  if (seat->closed || tasks.size() >= max) return false;
  tasks.push_back(std::move(task));
  const bool wakes = seat->state == Seat::State::kIdle ||
                     (seat->state == Seat::State::kDeferred && queue == Queue::kOrders);
  if (!wakes) return true;
  seat->state = Seat::State::kReady;
  seat->shard->MakeReady(seat);
  return true;
}

void Shard::Close(Seat& seat) {
  // Destroyed outside the lock: a caller that waits for one of these learns that it will not run.
  std::array<std::deque<SeatTask>, kQueueCount> dropped;
  MutexLock lock(&seat.mu);
  seat.closed = true;
  dropped.swap(seat.queues);
}

void Shard::Leave(const Seated& seat, absl::Status why, int64_t now_ns) {
  const auto leave = [seat = seat.get(), why = std::move(why)](Robot& robot) {
    seat->leaving = true;
    robot.Retire(why);
  };
  Push(seat, Queue::kControl, {.run = leave, .posted_ns = now_ns}, SIZE_MAX);
}

void Shard::MakeReady(const Seated& seat) {
  MutexLock lock(&mu_);
  turns_.Ready(seat);
  changed_.NotifyOne();
}

Shard::Lateness Shard::TakeLateness(int64_t now_ns) {
  MutexLock lock(&mu_);
  Lateness taken = std::exchange(latest_, {});
  // What is late now, and perhaps for ever.
  if (due_ns_ == 0 || now_ns - due_ns_ <= taken.late_ns) return taken;
  taken.late_ns = now_ns - due_ns_;
  const bool runs_on = running_ != nullptr && now_ns - running_since_ns_ > most_ns_;
  const Seated& by = runs_on ? running_ : most_by_;
  if (by != nullptr) taken.robot = by->robot_name;
  return taken;
}

void Shard::SetRunning(const Seated& seat, int64_t now_ns) {
  MutexLock lock(&mu_);
  running_ = seat;
  running_since_ns_ = now_ns;
}

void Shard::Run() {
  meter_.Sync();
  {
    // The first task may hang, too.
    MutexLock lock(&mu_);
    due_ns_ = NowNs();
  }
  while (true) {
    std::vector<Seated> arrived;
    Seated seat;
    int64_t now_ns = 0;
    {
      MutexLock lock(&mu_);
      while (!stopping_ && arrivals_.empty() && turns_.empty()) {
        if (!changed_.WaitUntil(lock, time_at_ns_)) break;
      }
      if (stopping_) return;
      arrived.swap(arrivals_);
      seat = turns_.Next().value_or(nullptr);
      now_ns = NowNs();
      running_ = seat;
      running_since_ns_ = now_ns;
    }
    for (const Seated& each : arrived) each->joined = time_.Join();
    seats_.insert(seats_.end(), arrived.begin(), arrived.end());
    if (seat != nullptr) now_ns = Serve(seat, now_ns);
    if (now_ns >= time_at_ns_) {
      RunTime(now_ns);
    } else if (seat == nullptr) {
      // Woken for nothing, as all the time under a clock that is not CLOCK_BOOTTIME.
      std::this_thread::yield();
    }
  }
}

std::optional<SeatTask> Shard::PopFrom(Seat& seat, Queue queue) {
  std::deque<SeatTask>& tasks = seat.queues[static_cast<size_t>(queue)];
  if (tasks.empty()) return std::nullopt;
  SeatTask task = std::move(tasks.front());
  tasks.pop_front();
  return task;
}

std::optional<SeatTask> Shard::Pop(Seat& seat, int64_t now_ns) {
  const bool may = seat.leaving || !seat.budget.Spent(now_ns);
  const bool control = seat.robot != nullptr && seat.robot->HasControl();
  const bool messages = seat.robot != nullptr && seat.robot->HasMessages();
  MutexLock lock(&seat.mu);
  std::optional<SeatTask> task = PopFrom(seat, Queue::kOrders);
  if (!task && may) task = PopFrom(seat, Queue::kActuators);
  if (!task && may && control) task = SeatTask{.run = nullptr, .posted_ns = now_ns};
  if (!task && may) task = PopFrom(seat, Queue::kControl);
  if (!task && may && messages) task = SeatTask{.run = nullptr, .posted_ns = now_ns};
  if (!task && may) task = PopFrom(seat, Queue::kMessages);
  if (task) return task;
  const bool waits = control || messages ||
                     std::any_of(seat.queues.begin(), seat.queues.end(),
                                 [](const auto& tasks) { return !tasks.empty(); });
  seat.state = waits ? Seat::State::kDeferred : Seat::State::kIdle;
  return std::nullopt;
}

int64_t Shard::Serve(const Seated& seat, int64_t now_ns) {
  const int64_t end_ns = now_ns + options_.limits.turn_ns;
  int64_t used_ns = 0;
  bool again = false;
  while (!again) {
    const std::optional<SeatTask> task = Pop(*seat, now_ns);
    if (!task) break;
    seat->longest_wait_ns = std::max(seat->longest_wait_ns, now_ns - task->posted_ns);
    if (seat->robot != nullptr) {
      if (task->run) {
        task->run(*seat->robot);
      } else {
        seat->robot->Advance();
      }
    }
    const int64_t ended_ns = NowNs();
    if (seat->robot != nullptr) PublishGraph(*seat);
    used_ns += Account(*seat, ended_ns - now_ns, ended_ns, task->charged);
    now_ns = ended_ns;
    again = now_ns >= end_ns || now_ns >= time_at_ns_;
  }
  EndTurn(seat, used_ns, again);
  if (seat->leaving && LetGo(seat)) return now_ns;
  if (seat->slow == (options_.slow != nullptr)) Move(seat);
  return now_ns;
}

int64_t Shard::Account(Seat& seat, int64_t wall_ns, int64_t now_ns, bool charged) {
  const int64_t cost_ns = meter_.Cost(wall_ns);
  if (charged) seat.budget.Charge(cost_ns);
  const uint64_t round = rounds_;
  if (std::exchange(seat.used_in_round, round) != round) seat.used_ns = 0;
  seat.used_ns += cost_ns;
  if (cost_ns < options_.limits.long_task_ns) return cost_ns;
  seat.long_task_at_ns = now_ns;
  if (!std::exchange(seat.slow, true) && options_.reports->moved) {
    options_.reports->moved(seat.robot_name, true);
  }
  return cost_ns;
}

void Shard::EndTurn(const Seated& seat, int64_t used_ns, bool again) {
  MutexLock lock(&mu_);
  turns_.Charge(seat, used_ns);
  if (again) turns_.Ready(seat);
  running_ = nullptr;
  if (seat->used_ns <= most_ns_) return;
  most_ns_ = seat->used_ns;
  most_by_ = seat;
}

void Shard::RunTime(int64_t now_ns) {
  time_.Next(seats_.size(), now_ns - time_at_ns_);
  if (time_at_ns_ != 0 && time_.round_over()) {
    MutexLock lock(&mu_);
    if (now_ns - due_ns_ > latest_.late_ns) {
      latest_ = {now_ns - due_ns_, most_by_ == nullptr ? "" : most_by_->robot_name};
    }
    most_by_ = nullptr;
    most_ns_ = 0;
  }
  meter_.Sync();
  // OnTime adds and removes no seats.
  std::vector<Seated> due;
  for (const Seated& seat : seats_) {
    if (time_.Contains(seat->joined)) due.push_back(seat);
  }
  for (const Seated& seat : due) {
    UpdateDeferral(seat, now_ns);
    SetRunning(seat, now_ns);
    seat->robot->OnTime();
    const int64_t ended_ns = NowNs();
    Account(*seat, ended_ns - now_ns, ended_ns, /*charged=*/true);
    now_ns = ended_ns;
    ReportWait(*options_.reports, *seat, now_ns);
  }
  for (const Seated& seat : due) {
    if (seat->leaving && LetGo(seat)) continue;
    PublishGraph(*seat);
    const bool behaved = now_ns - seat->long_task_at_ns >= options_.limits.slow_stay_ns;
    if (seat->slow && behaved) {
      seat->slow = false;
      if (options_.reports->moved) options_.reports->moved(seat->robot_name, false);
    }
    if (seat->slow == (options_.slow != nullptr)) Move(seat);
  }
  now_ns = NowNs();
  time_at_ns_ = now_ns + time_.part_ns();
  if (time_.round_over()) ++rounds_;
  MutexLock lock(&mu_);
  running_ = nullptr;
  // When the next round should be over: a thread may be late without any part of it being so.
  if (time_.round_over()) due_ns_ = now_ns + options_.limits.time_step_ns;
}

void Shard::UpdateDeferral(const Seated& seat, int64_t now_ns) {
  const bool spent = !seat->leaving && seat->budget.Spent(now_ns);
  int64_t oldest_ns = now_ns;
  bool waits = seat->robot->HasControl() || seat->robot->HasMessages();
  {
    MutexLock lock(&seat->mu);
    for (size_t i = static_cast<size_t>(Queue::kActuators); i < kQueueCount; ++i) {
      if (seat->queues[i].empty()) continue;
      waits = true;
      oldest_ns = std::min(oldest_ns, seat->queues[i].front().posted_ns);
    }
    // A robot that OnTime gave work to is idle until then.
    const bool rests =
        seat->state == Seat::State::kDeferred || (seat->state == Seat::State::kIdle && waits);
    if (rests && !spent) {
      seat->state = Seat::State::kReady;
      MakeReady(seat);
    }
  }
  const bool late = now_ns - oldest_ns >= options_.limits.late_ns;
  seat->robot->SetBacklog(waits && (spent || late));
  if (spent && waits) {
    if (seat->deferred_since_ns == 0) seat->deferred_since_ns = now_ns;
    seat->deferred_last_ns = now_ns;
    if (late && !std::exchange(seat->deferral_reported, true) && options_.reports->deferred) {
      options_.reports->deferred(seat->robot_name);
    }
  } else if (seat->deferred_since_ns != 0 && now_ns - seat->deferred_last_ns >= kDeferralOverNs) {
    seat->deferred_since_ns = 0;
    seat->deferral_reported = false;
  }
}

void Shard::PublishGraph(Seat& seat) {
  const GraphHistory::Version& version = seat.robot->core().graph_version();
  if (version.revision == seat.view_revision) return;
  seat.view_revision = version.revision;
  GraphView view{version.graph, seat.robot->core().judge().graph_changed_unix_ns()};
  MutexLock lock(&seat.mu);
  std::swap(seat.view, view);
}

bool Shard::LetGo(const Seated& seat) {
  if (!seat->robot->gone()) return false;
  std::erase(seats_, seat);
  Close(*seat);
  {
    MutexLock lock(&mu_);
    turns_.Forget(seat);
  }
  seat->robot.reset();
  options_.on_gone(seat->robot_name);
  return true;
}

void Shard::Move(const Seated& seat) {
  std::erase(seats_, seat);
  MutexLock lock(&seat->mu);
  Shard* to = seat->slow ? options_.slow : seat->home;
  {
    MutexLock own_lock(&mu_);
    turns_.Forget(seat);
  }
  seat->shard = to;
  // Its new thread finds out whether there is anything to do.
  seat->state = Seat::State::kReady;
  to->Own(seat);
  to->MakeReady(seat);
}

}  // namespace rips::pipeline

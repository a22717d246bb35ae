#include "policy_server/policy/inspect/inspection_pool.h"

#include <algorithm>
#include <utility>

namespace rips::inspect {
namespace {

using engine::Verdict;

// How long sessions of a policy that is gone may be kept by an idle thread.
constexpr absl::Duration kIdleMax = absl::Seconds(10);
// Policies whose sessions a thread keeps; the longest unused goes first.
constexpr size_t kSessionsMax = 16;

}  // namespace

// One thread's sessions, the one used last at the end.
class InspectionPool::Sessions {
 public:
  Session& For(const std::shared_ptr<const InspectionSet>& set) {
    const auto known =
        std::find_if(kept_.begin(), kept_.end(), [&](const Kept& each) { return each.set == set; });
    if (known != kept_.end()) {
      std::rotate(known, known + 1, kept_.end());
    } else {
      if (kept_.size() >= kSessionsMax) kept_.erase(kept_.begin());
      kept_.push_back({.set = set, .session = set->NewSession()});
    }
    return *kept_.back().session;
  }
  // Sets that only sessions hold are those of policies that are gone.
  void DropUnused() {
    std::erase_if(kept_, [](const Kept& each) { return each.set.use_count() == 1; });
  }

 private:
  struct Kept {
    std::shared_ptr<const InspectionSet> set;
    std::unique_ptr<Session> session;
  };
  std::vector<Kept> kept_;
};

InspectionPool::InspectionPool(PoolOptions options, const Clock* clock)
    : options_(options), clock_(clock) {
  const int threads = std::clamp(options_.threads, 1, kPoolThreadsMax);
  MutexLock lock(&mu_);
  for (int i = 0; i < threads; ++i) StartThreadLocked();
}

InspectionPool::~InspectionPool() { Stop(); }

void InspectionPool::Stop() {
  if (stopped_.exchange(true)) return;
  std::vector<std::unique_ptr<Slot>> slots;
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    changed_.NotifyAll();
    slots.swap(slots_);
  }
  for (const auto& slot : slots) slot->thread.join();
}

void InspectionPool::StartThreadLocked() {
  Slot& slot = *slots_.emplace_back(std::make_unique<Slot>());
  slot.thread = std::thread([this, &slot] { Run(slot); });
}

bool InspectionPool::AllStuckLocked(int64_t now_ns) const {
  const int64_t stuck_ns = absl::ToInt64Nanoseconds(options_.stuck_after);
  return std::all_of(slots_.begin(), slots_.end(), [&](const auto& slot) {
    const int64_t since_ns = slot->busy_since_ns.load();
    return since_ns != 0 && now_ns - since_ns > stuck_ns;
  });
}

Skipped InspectionPool::Count(Skipped how) {
  ++answered_[static_cast<size_t>(how)];
  return how;
}

size_t InspectionPool::waiting() const {
  MutexLock lock(&mu_);
  return waiting_;
}

size_t InspectionPool::threads() const {
  MutexLock lock(&mu_);
  return slots_.size();
}

Skipped InspectionPool::Submit(InspectionRequest request, Done done) {
  const int64_t now_ns = clock_->Now().boottime_ns;
  MutexLock lock(&mu_);
  if (!stopping_ && slots_.size() < kPoolThreadsMax && AllStuckLocked(now_ns)) StartThreadLocked();
  Robot* robot = stopping_ ? nullptr : FindRobotLocked(request.message.robot, now_ns);
  const Skipped refused = AdmitLocked(robot);
  if (refused != Skipped::kNot) return Count(refused);

  robot->items.push_back({.request = std::move(request),
                          .done = std::move(done),
                          .submitted_ns = now_ns,
                          .worked_before_ns = robot->worked_ns});
  ++waiting_;
  if (robot->items.size() == 1 && !robot->served) {
    line_.push_back(robot);
    changed_.NotifyOne();
  }
  return Skipped::kNot;
}

Skipped InspectionPool::AdmitLocked(const Robot* robot) const {
  if (stopping_) return Skipped::kStopped;
  if (robot == nullptr) return Skipped::kFull;
  if (robot->items.size() >= options_.waiting_per_robot_max) return Skipped::kRobotFull;
  return Skipped::kNot;
}

InspectionPool::Robot* InspectionPool::FindRobotLocked(const std::string& id, int64_t now_ns) {
  const auto known = robots_.find(id);
  if (known != robots_.end()) return known->second.get();
  const double budget_max_ns = absl::ToDoubleNanoseconds(options_.work_per_second);
  if (robots_.size() >= options_.robots_max) {
    for (auto& [other_id, other] : robots_) RefillLocked(*other, now_ns);
    absl::erase_if(robots_, [&](const auto& each) {
      const Robot& other = *each.second;
      return !other.served && other.items.empty() && other.budget_ns >= budget_max_ns;
    });
    if (robots_.size() >= options_.robots_max) return nullptr;
  }
  auto robot = std::make_unique<Robot>();
  robot->budget_ns = budget_max_ns;
  robot->refilled_ns = now_ns;
  return robots_.emplace(id, std::move(robot)).first->second.get();
}

void InspectionPool::RefillLocked(Robot& robot, int64_t now_ns) const {
  const double per_second_ns = absl::ToDoubleNanoseconds(options_.work_per_second);
  const auto passed_ns = static_cast<double>(now_ns - robot.refilled_ns);
  robot.budget_ns =
      std::min(per_second_ns, robot.budget_ns + passed_ns / kNanosPerSecond * per_second_ns);
  robot.refilled_ns = now_ns;
}

void InspectionPool::Run(Slot& slot) {
  Sessions sessions;
  while (true) {
    sessions.DropUnused();
    std::optional<Turn> turn = TakeTurn();
    if (turn) {
      Answer(*std::move(turn), sessions, slot);
      continue;
    }
    MutexLock lock(&mu_);
    if (stopping_ && line_.empty()) return;
  }
}

InspectionPool::Robot* InspectionPool::NextRobotLocked(int64_t now_ns) {
  const size_t slow_max = std::max<size_t>(slots_.size(), 2) - 1;
  for (auto each = line_.begin(); each != line_.end(); ++each) {
    Robot* robot = *each;
    const bool slow = now_ns < robot->slow_until_ns;
    if (slow && slow_served_ >= slow_max && !stopping_) continue;
    line_.erase(each);
    robot->served = true;
    robot->served_as_slow = slow;
    slow_served_ += slow ? 1 : 0;
    return robot;
  }
  return nullptr;
}

std::optional<InspectionPool::Turn> InspectionPool::TakeTurn() {
  MutexLock lock(&mu_);
  Robot* robot = nullptr;
  while ((robot = NextRobotLocked(clock_->Now().boottime_ns)) == nullptr) {
    if ((stopping_ && line_.empty()) || !changed_.WaitFor(lock, kIdleMax)) return std::nullopt;
  }
  Turn turn{.robot = robot, .item = std::move(robot->items.front())};
  robot->items.pop_front();
  --waiting_;

  const int64_t now_ns = clock_->Now().boottime_ns;
  RefillLocked(*robot, now_ns);
  const int64_t queue_ns_max = absl::ToInt64Nanoseconds(options_.queue_time_max);
  if (stopping_) {
    turn.skipped = Skipped::kStopped;
  } else if (robot->worked_ns - turn.item.worked_before_ns > queue_ns_max) {
    turn.skipped = Skipped::kLate;
  } else if (robot->budget_ns <= 0) {
    turn.skipped = Skipped::kBudget;
  }
  return turn;
}

void InspectionPool::Answer(Turn turn, Sessions& sessions, Slot& slot) {
  const InspectionRequest& request = turn.item.request;
  InspectionStats stats{.skipped = turn.skipped,
                        .waited_ns = clock_->Now().boottime_ns - turn.item.submitted_ns};
  std::vector<Verdict> verdicts(request.indices.size(), Verdict::kUnscanned);
  if (turn.skipped == Skipped::kNot) {
    verdicts = Inspect(turn, sessions.For(request.set), slot, stats);
  }
  Count(stats.skipped);
  worked_ns_ += stats.worked_ns;
  std::move(turn.item.done)(std::move(verdicts), stats);
  EndTurn(turn.robot);
}

std::vector<Verdict> InspectionPool::Inspect(const Turn& turn, Session& session, Slot& slot,
                                             InspectionStats& stats) {
  const InspectionRequest& request = turn.item.request;
  std::vector<Verdict> verdicts(request.indices.size(), Verdict::kUnscanned);
  const Message message = request.message.View();
  for (size_t i = 0; i < verdicts.size(); ++i) {
    const int64_t before_ns = clock_->Now().boottime_ns;
    slot.busy_since_ns = before_ns;
    verdicts[i] = session.Inspect(request.indices[i], message);
    slot.busy_since_ns = 0;
    const int64_t took_ns =
        std::max<int64_t>(0, clock_->Now().boottime_ns - before_ns - session.TakeStartNs());
    ++verdicts_[static_cast<size_t>(verdicts[i])];
    stats.worked_ns += took_ns;
    if (!Charge(turn.robot, took_ns) && i + 1 < verdicts.size()) {
      stats.skipped = Skipped::kBudget;
      break;
    }
  }
  return verdicts;
}

bool InspectionPool::Charge(Robot* robot, int64_t worked_ns) {
  MutexLock lock(&mu_);
  robot->budget_ns -= static_cast<double>(worked_ns);
  robot->worked_ns += worked_ns;
  if (worked_ns >= absl::ToInt64Nanoseconds(options_.slow_after)) {
    robot->slow_until_ns = clock_->Now().boottime_ns + absl::ToInt64Nanoseconds(options_.slow_for);
  }
  return robot->budget_ns > 0;
}

void InspectionPool::EndTurn(Robot* robot) {
  MutexLock lock(&mu_);
  robot->served = false;
  if (!robot->items.empty()) line_.push_back(robot);
  if (robot->served_as_slow) {
    --slow_served_;
    // Those that were passed over may come now.
    changed_.NotifyAll();
  } else if (!robot->items.empty()) {
    changed_.NotifyOne();
  }
}

}  // namespace rips::inspect

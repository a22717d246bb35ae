#include "mode_actuator/steps/alarm/alarm_board.h"

#include <algorithm>
#include <deque>
#include <set>
#include <thread>
#include <tuple>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "services/runtime/log.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {
namespace {

using Answer = AlarmReading::Answer;

AlarmResult Failed(absl::Status status) { return {.status = std::move(status)}; }

AlarmResult TooSlow(absl::Duration budget) {
  return Failed(absl::DeadlineExceededError(
      absl::StrCat("the device did not answer within ", absl::FormatDuration(budget))));
}

// The device is as usable as before.
bool IsHarmless(const absl::Status& status) {
  return absl::IsInvalidArgument(status) || absl::IsOutOfRange(status);
}

}  // namespace

// Owned by the board and by its own thread, whichever lives longer. Locks: mu_, then the gate's.
class AlarmBoard::Line : public std::enable_shared_from_this<AlarmBoard::Line> {
 public:
  Line(AlarmSpec spec, OpenAlarm open, const Clock* clock, absl::Duration io_budget)
      : spec_(std::move(spec)), open_(std::move(open)), io_budget_(io_budget), gate_(clock) {}

  void Start() {
    thread_ = std::thread([self = shared_from_this()] { self->Loop(); });
  }
  void AskToStop() ABSL_LOCKS_EXCLUDED(mu_);
  void Join() ABSL_LOCKS_EXCLUDED(mu_);

  bool IsOf(const AlarmSpec& spec) const {
    return std::tie(spec.kind, spec.serial, spec.path) ==
           std::tie(spec_.kind, spec_.serial, spec_.path);
  }
  bool Submit(uint64_t id, int channel, AlarmOrder what, const AlarmState& state)
      ABSL_LOCKS_EXCLUDED(mu_);
  std::optional<AlarmResult> Poll(uint64_t id) ABSL_LOCKS_EXCLUDED(mu_);
  void Drop(uint64_t id) ABSL_LOCKS_EXCLUDED(mu_);
  void Leave(uint64_t id) ABSL_LOCKS_EXCLUDED(mu_);
  bool missing() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return missing_;
  }

 private:
  struct Order {
    uint64_t id = 0;
    int channel = 1;
    AlarmOrder what = AlarmOrder::kSet;
    AlarmState state;
  };

  void DropLocked(uint64_t id) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  // The thread's.
  void Loop() ABSL_LOCKS_EXCLUDED(mu_);
  AlarmResult Run(const Order& order);
  AlarmResult Judge(const Order& order, const AlarmReading& reading) const;
  absl::Status Connect() ABSL_LOCKS_EXCLUDED(mu_);
  AlarmResult Fault(absl::Status status) ABSL_LOCKS_EXCLUDED(mu_);
  void Note(const absl::Status& status) ABSL_LOCKS_EXCLUDED(mu_);

  const AlarmSpec spec_;
  const OpenAlarm open_;
  const absl::Duration io_budget_;
  IoGate gate_;
  std::thread thread_;

  // Of the thread.
  std::unique_ptr<AlarmDevice> device_;
  std::map<int, AlarmState> told_;  // by channel, since the device was opened

  mutable Mutex mu_;
  CondVar changed_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  bool ended_ ABSL_GUARDED_BY(mu_) = false;
  bool missing_ ABSL_GUARDED_BY(mu_) = false;
  std::deque<Order> waiting_ ABSL_GUARDED_BY(mu_);
  uint64_t running_ ABSL_GUARDED_BY(mu_) = 0;  // 0 = none, or one without a caller
  bool busy_ ABSL_GUARDED_BY(mu_) = false;     // with an order, waited for or not
  std::map<uint64_t, AlarmResult> results_ ABSL_GUARDED_BY(mu_);
  std::set<uint64_t> left_ ABSL_GUARDED_BY(mu_);  // orders without a caller
};

// --- those who wait

bool AlarmBoard::Line::Submit(uint64_t id, int channel, AlarmOrder what, const AlarmState& state) {
  MutexLock lock(&mu_);
  if (waiting_.size() + results_.size() + (busy_ ? 1 : 0) >= kAlarmOrdersMax) return false;
  waiting_.push_back({id, channel, what, state});
  changed_.NotifyAll();
  return true;
}

std::optional<AlarmResult> AlarmBoard::Line::Poll(uint64_t id) {
  {
    MutexLock lock(&mu_);
    const auto result = results_.find(id);
    if (result != results_.end()) {
      AlarmResult taken = std::move(result->second);
      results_.erase(result);
      return taken;
    }
    if (gate_.Busy() <= io_budget_) return std::nullopt;
    DropLocked(id);
  }
  AlarmResult slow = TooSlow(io_budget_);
  Note(slow.status);
  return slow;
}

void AlarmBoard::Line::Drop(uint64_t id) {
  MutexLock lock(&mu_);
  DropLocked(id);
}

void AlarmBoard::Line::DropLocked(uint64_t id) {
  std::erase_if(waiting_, [id](const Order& order) { return order.id == id; });
  results_.erase(id);
  if (running_ != id) return;
  running_ = 0;
  gate_.Close();
}

void AlarmBoard::Line::Leave(uint64_t id) {
  MutexLock lock(&mu_);
  if (results_.erase(id) == 0) left_.insert(id);
}

void AlarmBoard::Line::AskToStop() {
  MutexLock lock(&mu_);
  stopping_ = true;
  gate_.Close();
  changed_.NotifyAll();
}

void AlarmBoard::Line::Join() {
  bool ended = false;
  {
    MutexLock lock(&mu_);
    const absl::Time end = absl::Now() + kAlarmStopWait;
    while (!ended_ && absl::Now() < end) changed_.WaitFor(lock, end - absl::Now());
    ended = ended_;
  }
  if (ended) {
    thread_.join();
  } else {
    LogWarning("alarm device still busy at shutdown; abandoning its thread",
               {{"device", spec_.name}});
    thread_.detach();
  }
}

// --- the thread

void AlarmBoard::Line::Loop() {
  Connect().IgnoreError();  // only to say early that it is not there
  while (true) {
    Order order;
    {
      MutexLock lock(&mu_);
      while (waiting_.empty() && !stopping_) changed_.Wait(lock);
      if (stopping_) break;
      order = waiting_.front();
      waiting_.pop_front();
      running_ = order.id;
      busy_ = true;
      gate_.Open();
    }
    AlarmResult result = Run(order);
    MutexLock lock(&mu_);
    busy_ = false;
    if (left_.erase(order.id) != 0) {
      if (!result.status.ok()) {
        LogWarning("alarm order failed",
                   {{"device", spec_.name}, {"why", result.status.message()}});
      }
    } else if (running_ == order.id) {
      results_.emplace(order.id, std::move(result));
    }
    running_ = 0;
  }
  device_.reset();
  MutexLock lock(&mu_);
  ended_ = true;
  changed_.NotifyAll();
}

absl::Status AlarmBoard::Line::Connect() {
  if (device_ != nullptr) return absl::OkStatus();
  absl::StatusOr<std::unique_ptr<AlarmDevice>> device = open_(spec_, &gate_);
  if (device.ok()) {
    device_ = *std::move(device);
    told_.clear();
  }
  if (!absl::IsAborted(device.status())) Note(device.status());
  return device.status();
}

// Says once that the device is gone or there.
void AlarmBoard::Line::Note(const absl::Status& status) {
  {
    MutexLock lock(&mu_);
    if (stopping_) return;
    if (missing_ == !status.ok()) return;
    missing_ = !status.ok();
  }
  if (status.ok()) {
    LogInfo("alarm device found", {{"device", spec_.name}});
  } else {
    LogWarning("alarm device degraded", {{"device", spec_.name}, {"why", status.message()}});
  }
}

AlarmResult AlarmBoard::Line::Fault(absl::Status status) {
  if (!IsHarmless(status)) {
    device_.reset();
    if (!absl::IsAborted(status)) Note(status);
  }
  return Failed(std::move(status));
}

AlarmResult AlarmBoard::Line::Run(const Order& order) {
  if (absl::Status status = Connect(); !status.ok()) return Failed(std::move(status));
  if (order.what == AlarmOrder::kSet) {
    told_.erase(order.channel);
    if (absl::Status status = device_->Set(order.channel, order.state); !status.ok()) {
      return Fault(std::move(status));
    }
    told_[order.channel] = order.state;
  }
  const absl::StatusOr<AlarmReading> reading = device_->Read(order.channel, order.state);
  if (!reading.ok()) return Fault(reading.status());
  return Judge(order, *reading);
}

AlarmResult AlarmBoard::Line::Judge(const Order& order, const AlarmReading& reading) const {
  const std::string wanted = ToString(order.state);
  AlarmResult result;
  switch (reading.answer) {
    case Answer::kAsWanted:
      result.detail = absl::StrCat(reading.subject, " is ", reading.observed, " (read back)");
      result.observed = reading.observed;
      break;
    case Answer::kOther:
      result.status = absl::FailedPreconditionError(
          absl::StrCat(reading.subject, " is ", reading.observed, " (read back), not ", wanted));
      result.observed = reading.observed;
      break;
    case Answer::kUnreadable: {
      const auto told = told_.find(order.channel);
      if (order.what == AlarmOrder::kSet) {
        result.detail = "sent; this device cannot be read back";
      } else if (told != told_.end() && told->second == order.state) {
        result.detail = "plugged in; this device cannot be read back";
      } else {
        result.status = absl::FailedPreconditionError(
            absl::StrCat("it was plugged in again, and not set to ", wanted, " since"));
      }
      break;
    }
  }
  return result;
}

// --- AlarmBoard

AlarmBoard::AlarmBoard(const std::vector<AlarmSpec>& alarms, const OpenAlarm& open,
                       const Clock* clock, absl::Duration io_budget) {
  for (const AlarmSpec& spec : alarms) {
    auto line = std::find_if(lines_.begin(), lines_.end(),
                             [&](const std::shared_ptr<Line>& each) { return each->IsOf(spec); });
    if (line == lines_.end()) {
      lines_.push_back(std::make_shared<Line>(spec, open, clock, io_budget));
      line = lines_.end() - 1;
    }
    alarms_.emplace(spec.name, Alarm{spec, *line});
  }
  for (const std::shared_ptr<Line>& line : lines_) line->Start();
}

AlarmBoard::~AlarmBoard() {
  for (const std::shared_ptr<Line>& line : lines_) line->AskToStop();
  for (const std::shared_ptr<Line>& line : lines_) line->Join();
}

absl::StatusOr<uint64_t> AlarmBoard::Begin(absl::string_view alarm, AlarmOrder order,
                                           const AlarmState& state) {
  const auto found = alarms_.find(alarm);
  if (found == alarms_.end()) {
    return absl::NotFoundError(absl::StrCat("no device `", alarm, "` in `devices`"));
  }
  const uint64_t id = next_order_++;
  if (!found->second.line->Submit(id, found->second.spec.channel, order, state)) {
    return absl::ResourceExhaustedError(
        absl::StrCat("orders waiting for the device exceed limit ", kAlarmOrdersMax));
  }
  orders_.emplace(id, found->second.line);
  return id;
}

std::optional<AlarmResult> AlarmBoard::Poll(uint64_t order) {
  const auto found = orders_.find(order);
  if (found == orders_.end()) return Failed(absl::InternalError("no such order"));
  std::optional<AlarmResult> result = found->second->Poll(order);
  if (result.has_value()) orders_.erase(found);
  return result;
}

void AlarmBoard::Drop(uint64_t order) {
  const auto found = orders_.find(order);
  if (found == orders_.end()) return;
  found->second->Drop(order);
  orders_.erase(found);
}

void AlarmBoard::Leave(uint64_t order) {
  const auto found = orders_.find(order);
  if (found == orders_.end()) return;
  found->second->Leave(order);
  orders_.erase(found);
}

size_t AlarmBoard::missing() const {
  return static_cast<size_t>(
      std::count_if(lines_.begin(), lines_.end(),
                    [](const std::shared_ptr<Line>& line) { return line->missing(); }));
}

}  // namespace rips::actuator

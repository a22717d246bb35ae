#include "tests/simulation/actuator_model.h"

#include <algorithm>
#include <utility>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "services/base/check.h"
#include "tests/simulation/level_names.h"

namespace rips::simulation {
namespace {

using actuator::JobKind;

constexpr uint64_t kLateIds = uint64_t{1} << 60;

actuator::ExecutorOptions Options() {
  return {.levels = {std::begin(kLevels), std::end(kLevels)},
          .fail_safe = std::string(kLevels[kFailSafe]),
          .floor_hold_ns = 200 * kMs,
          .survey = true};
}

}  // namespace

struct ActuatorModel::Stream {
  explicit Stream(Scheduler* scheduler) : up(scheduler), down(scheduler) {}
  Line up;
  Line down;
  uint64_t server_life = 0;
  std::shared_ptr<pipeline::ActuatorLink> link;
  std::deque<pipeline::Command> newest;
};

class ActuatorModel::ServerEnd final : public pipeline::ActuatorLink {
 public:
  ServerEnd(ActuatorModel* actuator, const std::shared_ptr<Stream>& stream)
      : actuator_(*actuator), stream_(stream) {}

  void Grant(const pipeline::LeaseGrant& lease) override {
    Send([lease](ActuatorModel& actuator) { actuator.OnLease(lease); });
  }
  void Send(const pipeline::Command& command) override {
    const auto& set = std::get<pipeline::SetLevel>(command.what);
    actuator_.context_.trace.Add(
        "server",
        absl::StrCat("sends ", set.to, " ", ToString(set.decision_id), " in term ", command.term,
                     set.based_on.none() ? "" : " on " + ToString(set.based_on)));
    actuator_.context_.checker.OnCommandSent(command);
    const auto stream = stream_.lock();
    if (stream == nullptr) return;
    stream->newest.push_back(command);
    if (stream->newest.size() > 3) stream->newest.pop_front();
    Send([command](ActuatorModel& actuator) { actuator.OnCommand(command); });
  }
  void Close(const absl::Status& status) override {
    const auto stream = stream_.lock();
    if (stream == nullptr) return;
    stream->down.Send([this_actuator = &actuator_, stream, text = std::string(status.message())] {
      this_actuator->context_.trace.Add("actuator", absl::StrCat("stream closed: ", text));
      this_actuator->server_.Call(stream->server_life, [&](pipeline::Robot& robot) {
        robot.OnActuatorGone(kHost, stream->link.get());
      });
      this_actuator->Disconnected(stream);
    });
  }

 private:
  void Send(std::function<void(ActuatorModel&)> deliver) {
    const auto stream = stream_.lock();
    if (stream == nullptr) return;
    stream->down.Send([this_actuator = &actuator_, weak = stream_, deliver = std::move(deliver)] {
      if (this_actuator->stream_ != nullptr && weak.lock() == this_actuator->stream_) {
        deliver(*this_actuator);
      }
    });
  }

  ActuatorModel& actuator_;
  std::weak_ptr<Stream> stream_;
};

// --- the process and its streams

void ActuatorModel::Start() {
  ++life_;
  absl::StatusOr<actuator::ActuatorState> state = absl::NotFoundError("no state file");
  if (disk_.has_value()) state = actuator::DecodeState(*disk_);
  auto controller = actuator::LevelController::Create(Options(), state, now_ns());
  RIPS_CHECK(controller.ok(), "the simulation's levels are refused");
  controller_.emplace(*std::move(controller));
  receipts_ = actuator::ReceiptQueue();
  published_ = controller_->Report(now_ns());
  context_.trace.Add("actuator", absl::StrCat("starts, decided ", published_.decided, " (",
                                              ToString(published_.decision_id), "), effective ",
                                              published_.effective));
  context_.checker.OnActuatorStart(published_, now_ns());
  Do(controller_->Start(now_ns()));
  Later(context_.scheduler.Between(1, 300) * kMs, [this] { Connect(); });
  Later(kTickNs, [this] { Tick(); });
}

void ActuatorModel::Crash() {
  context_.trace.Add("actuator", "crashes");
  Break(false);
  ++life_;
  controller_.reset();
  context_.checker.OnActuatorGone();
  // Writes are in order; what was not answered may stand on the disk or not.
  auto torn = context_.scheduler.Between(0, static_cast<int64_t>(writes_.size()));
  for (; torn > 0 && !disk_fails_; --torn, writes_.pop_front()) {
    disk_ = actuator::EncodeState(writes_.front().state);
  }
  writes_.clear();
}

void ActuatorModel::Break(bool half_open) {
  if (stream_ == nullptr) return;
  context_.trace.Add("actuator", half_open ? "stream breaks, half open" : "stream breaks");
  const std::shared_ptr<Stream> stream = stream_;
  stream->up.Cut();
  stream->down.Cut();
  Disconnected(stream);
  for (pipeline::Command& late : stream->newest) {
    if (!context_.scheduler.Chance(50)) continue;
    late.id = absl::StrFormat("%032x", kLateIds + ++late_);  // tried again, under its own id
    context_.checker.OnCommandSent(late);
    Later(context_.scheduler.Between(300, 9'000) * kMs, [this, late] { OnCommand(late); });
  }
  if (half_open) return;
  context_.scheduler.After(context_.scheduler.Between(0, 200) * kMs, [this, stream] {
    server_.Call(stream->server_life,
                 [&](pipeline::Robot& robot) { robot.OnActuatorGone(kHost, stream->link.get()); });
  });
}

void ActuatorModel::Later(int64_t delay_ns, Task task) {
  context_.scheduler.After(delay_ns, [this, life = life_, task = std::move(task)] {
    if (life == life_) task();
  });
}

void ActuatorModel::Disconnected(const std::shared_ptr<Stream>& stream) {
  if (stream_ != stream) return;
  stream_ = nullptr;
  Later(context_.scheduler.Between(50, 1'500) * kMs, [this] { Connect(); });
}

void ActuatorModel::Connect() {
  if (stream_ != nullptr) return;
  if (!server_.up() || context_.scheduler.now_ns() < isolated_until_ns_) {
    return Later(context_.scheduler.Between(100, 800) * kMs, [this] { Connect(); });
  }
  stream_ = std::make_shared<Stream>(&context_.scheduler);
  stream_->server_life = server_.life();
  stream_->link = std::make_shared<ServerEnd>(this, stream_);
  receipts_.NewSession();
  context_.trace.Add("actuator", "connects");
  Send([hello = MakeHello(), link = stream_->link](pipeline::Robot& robot, const auto*) {
    robot.OnActuatorHello(kHost, link, hello);
  });
}

pipeline::ActuatorHello ActuatorModel::MakeHello() {
  const actuator::ExecutorReport report = controller_->Report(now_ns());
  return {.levels = Options().levels,
          .decision_id = report.decision_id,
          .decided_level = report.decided,
          .effective_level = report.effective,
          .highest_term = report.highest_term,
          .state_lost = report.state_lost,
          .fail_safe_level = std::string(kLevels[kFailSafe]),
          .clock = Clock()};
}

void ActuatorModel::Send(
    std::function<void(pipeline::Robot&, const pipeline::ActuatorLink*)> call) {
  if (stream_ == nullptr) return;
  stream_->up.Send(
      [this, life = stream_->server_life, link = stream_->link, call = std::move(call)] {
        server_.Call(life, [&](pipeline::Robot& robot) { call(robot, link.get()); });
      });
}

// --- what the server says

void ActuatorModel::OnCommand(const pipeline::Command& command) {
  if (!up()) return;
  const auto& set = std::get<pipeline::SetLevel>(command.what);
  const actuator::ExecutorReport held = controller_->Report(now_ns());
  context_.trace.Add(
      "actuator",
      absl::StrCat("receives ", set.to, " ", ToString(set.decision_id), " of term ", command.term,
                   "; holds ", ToString(held.decision_id), ", term ", held.highest_term));
  context_.checker.OnCommandDelivered(command.id, command.term);
  pipeline::Command to = command;
  if (context_.fault == Fault::kStaleTerm && command.term < held.highest_term) {
    to.term = held.highest_term;
    std::get<pipeline::SetLevel>(to.what).decision_id = {.term = held.highest_term,
                                                         .epoch = held.decision_id.epoch + 1};
  }
  Do(controller_->OnSetLevel(to, now_ns()));
  Turn();
}

void ActuatorModel::OnLease(const pipeline::LeaseGrant& lease) {
  if (!up()) return;
  context_.checker.OnLeaseDelivered(lease, now_ns());
  controller_->OnLease(lease, now_ns());
  Turn();
}

// --- the agent's thread

void ActuatorModel::Tick() {
  Turn();
  Later(kTickNs, [this] { Tick(); });
}

// The agent ends each turn with this, whatever the turn began with.
void ActuatorModel::Turn() {
  const bool withheld =
      context_.fault == Fault::kIgnoredLease && !controller_->Report(now_ns()).lease_live;
  if (!withheld) Do(controller_->OnTick(now_ns()));
  Publish();
}

void ActuatorModel::Publish() {
  const actuator::ExecutorReport report = controller_->Report(now_ns());
  if (stream_ != nullptr) {
    receipts_.Flush(now_ns(), [this](const actuator::Receipt& receipt) {
      Send([receipt](pipeline::Robot& robot, const pipeline::ActuatorLink* link) {
        robot.OnReceipt(kHost, link, receipt);
      });
      return true;
    });
  }
  if (report == published_ && now_ns() < next_heartbeat_ns_) return;
  published_ = report;
  next_heartbeat_ns_ = now_ns() + 500 * kMs;
  Send([report, now = now_ns()](pipeline::Robot& robot, const pipeline::ActuatorLink* link) {
    robot.OnActuatorHeartbeat(kHost, link,
                              {.boottime_ns = now,
                               .effective_level = report.effective,
                               .observed = report.observed,
                               .verified = report.verified,
                               .floor_reason = report.floor_reason,
                               .degraded = report.degraded,
                               .drifts = report.drifts});
  });
}

void ActuatorModel::Do(const actuator::Actions& actions) {
  for (const actuator::Action& action : actions) {
    if (const auto* job = std::get_if<actuator::ApplyLevel>(&action)) {
      RunJob(*job);
    } else if (const auto* write = std::get_if<actuator::PersistState>(&action)) {
      writes_.push_back(*write);
      const bool slow = context_.scheduler.Chance(5);
      const int64_t delay_ns = context_.scheduler.Between(1, slow ? 2'000 : 20) * kMs;
      if (writes_.size() == 1) Later(delay_ns, [this] { EndWrite(); });
    } else {
      const actuator::Receipt& receipt = std::get<actuator::SendReceipt>(action).receipt;
      context_.trace.Add("actuator",
                         absl::StrCat("receipt ", static_cast<int>(receipt.stage), " of ",
                                      ToString(receipt.decision_id), " ", receipt.detail));
      context_.checker.OnReceipt(receipt);
      receipts_.Add(receipt);
    }
  }
}

void ActuatorModel::EndWrite() {
  const actuator::PersistState write = std::move(writes_.front());
  writes_.pop_front();
  absl::Status status;
  if (disk_fails_) status = absl::UnavailableError("disk error");
  // A failed write may have reached the disk all the same.
  if (status.ok() || context_.scheduler.Chance(50)) disk_ = actuator::EncodeState(write.state);
  if (!writes_.empty()) {
    Later(context_.scheduler.Between(1, 20) * kMs, [this] { EndWrite(); });
  }
  Do(controller_->OnPersisted(write.sequence, status, now_ns()));
  Turn();
}

// --- the robot

void ActuatorModel::RunJob(const actuator::ApplyLevel& job) {
  const bool looks = job.kind == JobKind::kCheck || job.kind == JobKind::kSurvey;
  const bool reaches = context_.scheduler.Chance(90);
  if (job.kind != JobKind::kSurvey) attempt_ = job.attempt;
  if (job.kind != JobKind::kCheck) {
    context_.trace.Add("actuator",
                       job.kind == JobKind::kSurvey ? "surveys" : absl::StrCat("enters ", job.to));
  }
  Later(context_.scheduler.Between(5, looks ? 200 : 900) * kMs,
        [this, job, reaches] { EndJob(job, reaches); });
}

void ActuatorModel::EndJob(const actuator::ApplyLevel& job, bool reaches) {
  actuator::LevelOutcome outcome{.attempt = job.attempt, .kind = job.kind};
  if (job.kind == JobKind::kSurvey) {
    outcome.reached = reaches;
    if (reaches) outcome.shown = std::string(kLevels[robot_]);
  } else {
    if (job.attempt != attempt_) return;  // replaced
    const int to = LevelIndex(job.to);
    if (job.kind != JobKind::kCheck && reaches) robot_ = to;
    outcome.reached = robot_ == to;
    if (!outcome.reached) outcome.detail = "not there";
    context_.checker.OnReadBack(robot_);
  }
  outcome.observed = absl::StrCat("/safety=", kLevels[robot_]);
  Do(controller_->OnOutcome(outcome, now_ns()));
  Turn();
}

void ActuatorModel::Drift() {
  robot_ = static_cast<int>(context_.scheduler.Between(0, 3));
  context_.trace.Add("robot", absl::StrCat("drifts to ", kLevels[robot_]));
}

void ActuatorModel::Check() {
  if (up()) context_.checker.OnActuatorHolds(controller_->Report(now_ns()), now_ns());
}

}  // namespace rips::simulation

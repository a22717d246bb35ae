#include "policy_server/server/robot/robot.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::pipeline {
namespace {

// A turn ends after the piece during which it has lasted so long; of messages, from the second on.
constexpr int64_t kTurnNs = 2 * kNanosPerMilli;

}  // namespace

absl::StatusOr<std::unique_ptr<Robot>> Robot::Create(RobotConfig config, Policy policy,
                                                     Timing timing,
                                                     const store::RobotRecord& record,
                                                     uint64_t tenure, Ports ports) {
  std::unique_ptr<Robot> robot(new Robot(std::move(ports), config.id));
  const Ports& outside = robot->performer_.ports();
  RIPS_ASSIGN_OR_RETURN(robot->core_, RobotCore::Create({.config = std::move(config),
                                                         .policy = std::move(policy),
                                                         .timing = timing,
                                                         .record = record,
                                                         .store = outside.recorder->point(),
                                                         .tenure = tenure,
                                                         .id_seed = outside.new_id(),
                                                         .moment = robot->Now()}));
  robot->BeginPiece();
  return robot;
}

Robot::Robot(Ports ports, std::string id)
    : performer_(std::move(id), std::move(ports), [this](Input input) {
        const bool inspected = std::holds_alternative<input::Inspected>(input);
        Do(std::move(input));
        if (inspected) AdvanceMessages();
      }) {}

Moment Robot::Now() const {
  return {.now = performer_.ports().clock->Now(),
          .store_writable = performer_.ports().recorder->healthy(),
          .recorded = performer_.recorded(),
          .backlog = backlog_};
}

void Robot::Do(Input input) {
  Actions actions = core_->On(input, Now());
  performer_.Perform(actions);
  core_->Recycle(std::move(actions));
  for (Input& answer : performer_.PopAnswers()) Do(std::move(answer));
  FlightRecorder* flight = performer_.flight();
  if (flight != nullptr && flight->wants_piece(performer_.ports().clock->Now())) BeginPiece();
}

void Robot::BeginPiece() {
  if (performer_.flight() == nullptr) return;
  const Instant now = performer_.ports().clock->Now();
  performer_.flight()->BeginPiece(core_->At(Now()).rules(), now);
}

// -------------------------------------------------------------------------------------- agents

void Robot::OnSensorHello(const std::string& host, std::shared_ptr<SensorLink> link,
                          const SensorHello& hello) {
  const Recorder& recorder = *performer_.ports().recorder;
  Do(input::SensorHello{.host = host,
                        .session = performer_.Open(std::move(link)),
                        .hello = hello,
                        .store = recorder.point(),
                        .store_goes_on = recorder.GoesOnFrom(hello.store)});
}

void Robot::OnSensorHeartbeat(const std::string& host, const SensorLink* link,
                              const SensorHeartbeat& heartbeat) {
  Do(input::SensorHeartbeat{
      .host = host, .session = performer_.Find(link), .heartbeat = heartbeat});
}

void Robot::OnInterestAnswer(const std::string& host, const SensorLink* link,
                             const InterestAnswer& answer) {
  Do(input::InterestAnswer{.host = host, .session = performer_.Find(link), .answer = answer});
}

void Robot::OnBatch(const std::string& host, const SensorLink* link,
                    std::shared_ptr<const Batch> batch) {
  const bool control = batch->lane == Lane::kControl;
  Do(input::SensorBatch{.host = host, .session = performer_.Find(link), .batch = std::move(batch)});
  if (control) AdvanceControl();
  AdvanceMessages();
}

void Robot::Advance() {
  AdvanceControl();
  AdvanceMessages();
}

void Robot::AdvanceControl() {
  const int64_t end_ns = Now().now.boottime_ns + kTurnNs;
  while (core_->has_control()) {
    Do(input::Advance{});
    if (Now().now.boottime_ns >= end_ns) return;
  }
}

void Robot::AdvanceMessages() {
  int64_t end_ns = 0;
  while (!core_->has_control() && core_->has_messages()) {
    Do(input::Advance{});
    const int64_t now_ns = Now().now.boottime_ns;
    if (end_ns == 0) end_ns = now_ns + kTurnNs;
    if (now_ns >= end_ns) return;
  }
}

void Robot::OnSensorGone(const std::string& host, const SensorLink* link) {
  const SessionId session = performer_.Find(link);
  Do(input::SensorGone{.host = host, .session = session});
  performer_.Forget(session);
}

void Robot::OnActuatorHello(const std::string& host, std::shared_ptr<ActuatorLink> link,
                            const ActuatorHello& hello) {
  Do(input::ActuatorHello{
      .host = host, .session = performer_.Open(std::move(link)), .hello = hello});
}

void Robot::OnActuatorHeartbeat(const std::string& host, const ActuatorLink* link,
                                const ActuatorHeartbeat& heartbeat) {
  Do(input::ActuatorHeartbeat{
      .host = host, .session = performer_.Find(link), .heartbeat = heartbeat});
}

void Robot::OnReceipt(const std::string& host, const ActuatorLink* link, const Receipt& receipt) {
  Do(input::Receipt{.host = host, .session = performer_.Find(link), .receipt = receipt});
}

void Robot::OnActuatorGone(const std::string& host, const ActuatorLink* link) {
  const SessionId session = performer_.Find(link);
  Do(input::ActuatorGone{.host = host, .session = session});
  performer_.Forget(session);
}

// ----------------------------------------------------------------------------------- operators

void Robot::Raise(const LevelOrder& order, LevelReply reply) {
  Do(input::Raise{.order = order, .token = performer_.Await(std::move(reply))});
}

void Robot::DeEscalate(const LevelOrder& order, LevelReply reply) {
  Do(input::DeEscalate{.order = order, .token = performer_.Await(std::move(reply))});
}

void Robot::Approve(const ApprovalOrder& order, LevelReply reply) {
  Do(input::Approve{.order = order, .token = performer_.Await(std::move(reply))});
}

void Robot::ResetTerm(const TermResetOrder& order, LevelReply reply) {
  Do(input::ResetTerm{.order = order, .token = performer_.Await(std::move(reply))});
}

absl::Status Robot::ResumeRules(const std::string& operator_name, const std::string& reason) {
  absl::Status status;
  const ReplyToken token =
      performer_.Await(LevelReply([&](const LevelAnswer& answer) { status = answer.status; }));
  Do(input::ResumeRules{.operator_name = operator_name, .reason = reason, .token = token});
  return status;
}

absl::Status Robot::SetMaintenance(const MaintenanceOrder& order) {
  absl::Status status;
  const ReplyToken token =
      performer_.Await(LevelReply([&](const LevelAnswer& answer) { status = answer.status; }));
  Do(input::SetMaintenance{.order = order, .token = token});
  return status;
}

LevelAnswer Robot::SendSignal(const SignalOrder& order) {
  LevelAnswer answer;
  const ReplyToken token =
      performer_.Await(LevelReply([&](const LevelAnswer& given) { answer = given; }));
  Do(input::SendSignal{.order = order, .token = token});
  return answer;
}

void Robot::RecordRefusedOrder(const LevelOrder& order, const absl::Status& why) {
  Do(input::RefusedOrder{.order = order, .why = why});
}

void Robot::Report(engine::Severity severity, const std::string& text, std::source_location where) {
  Do(input::Report{.severity = severity,
                   .text = text,
                   .kind = absl::StrCat(where.file_name(), ":", where.line())});
}

void Robot::StartDrill(const DrillOrder& order, DrillReply reply) {
  Do(input::StartDrill{.order = order, .token = performer_.Await(std::move(reply))});
}

absl::Status Robot::AddTap(std::shared_ptr<EventRecorder> tap) {
  return performer_.AddRecorder(std::move(tap), kTapsMax);
}

void Robot::SetShadow(std::shared_ptr<ShadowRecorder> shadow,
                      std::shared_ptr<const AlsoWatched> also) {
  if (shadow != nullptr) shadow->OnBegin(core_->At(Now()).rules());
  performer_.SetShadow(std::move(shadow));
  Do(input::WatchAlso{std::move(also)});
}

// ---------------------------------------------------------------------------- time, inventory

void Robot::OnTime() {
  Do(input::Time{});
  AdvanceMessages();
}

absl::Status Robot::SwapPolicy(Policy policy) {
  absl::Status status;
  const ReplyToken token =
      performer_.Await(LevelReply([&](const LevelAnswer& answer) { status = answer.status; }));
  Do(input::SwapPolicy{.policy = std::move(policy), .token = token});
  if (status.ok()) BeginPiece();
  AdvanceMessages();
  return status;
}

}  // namespace rips::pipeline

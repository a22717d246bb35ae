#include "policy_server/server/robot/core/robot_core.h"

#include <algorithm>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/robot/decide/soft_lowerings.h"
#include "services/base/overloaded.h"

namespace rips::pipeline {
namespace {

// What a robot that has retired still takes: until it is gone, its shard has older tasks for it.
bool StillHeard(const Input& input) {
  return std::visit(
      [](const auto& in) {
        using In = std::decay_t<decltype(in)>;
        return std::is_same_v<In, input::Retire> || std::is_same_v<In, input::Recorded> ||
               std::is_same_v<In, input::RaisesSaved> || std::is_same_v<In, input::Time>;
      },
      input);
}

// Closes a new session, answers an order; all else is of sessions that are closed.
void Refuse(const Input& input, const absl::Status& why, Context& context) {
  std::visit(
      [&](const auto& in) {
        if constexpr (requires { in.hello; }) {
          context.Do(action::Close{in.session, why});
        } else if constexpr (std::is_same_v<std::decay_t<decltype(in)>, input::StartDrill>) {
          context.Do(action::AnswerDrill{in.token, {.status = why, .drills = {}}});
        } else if constexpr (requires { in.token; }) {
          context.Do(action::AnswerOrder{in.token, {.status = why}});
        }
      },
      input);
}

}  // namespace

absl::StatusOr<std::unique_ptr<RobotCore>> RobotCore::Create(CoreStart start) {
  const levels::LevelTable& table = start.policy.program->rules().levels;
  const store::RobotRecord& record = start.record;
  levels::LevelIndex level = start.policy.start_level;
  if (!record.level.empty()) {
    const auto found = table.Find(record.level);
    if (!found) {
      return absl::InvalidArgumentError(absl::StrCat(
          "robot `", start.config.id, "` is recorded at level `", record.level,
          "`, which its bundle does not declare (", absl::StrJoin(table.names(), ", "), ")"));
    }
    level = *found;
  }
  levels::LevelMachine machine(table, level, record.decision_id, start.tenure);
  machine.RestoreBudget(SoftLowerings(record, table, start.moment.now), record.resumed_at);
  if (record.soft_suspended) machine.Suspend();
  CompletePolicy(start.policy);
  return std::unique_ptr<RobotCore>(new RobotCore(std::move(start), std::move(machine)));
}

RobotCore::RobotCore(CoreStart start, levels::LevelMachine level)
    : context_{.config = std::move(start.config),
               .policy = std::move(start.policy),
               .timing = start.timing,
               .tenure = start.tenure,
               .ids = IdSource(start.id_seed),
               .moment = start.moment,
               .store = std::move(start.store),
               .actions = {},
               .events = {}},
      state_(context_.policy.program, std::move(level), start.moment.now),
      gate_(context_.policy.soft_hold_ns, start.moment.now),
      outbox_(context_.config.id, context_.tenure),
      alerts_(&context_, &outbox_, &state_.level, &window_),
      own_agents_(&context_, &alerts_, &state_.graph),
      losses_(&context_, &alerts_, &gate_),
      sensors_(&context_, &alerts_, &gate_, &own_agents_, &losses_, start.record),
      sight_(&context_, &alerts_, &own_agents_, &sensors_, &state_.graph),
      findings_(&context_, &alerts_, &sensors_, &sight_, &state_, &gate_),
      actuators_(&context_, &alerts_, &outbox_, &own_agents_, &state_.level),
      drills_(&context_, &alerts_, &actuators_, &state_.level),
      maintenance_(&context_, &window_, &alerts_, &outbox_, &sensors_, &actuators_),
      evidence_(&context_, &gate_, &sensors_, &sight_, &actuators_),
      decider_(&context_, &state_, &alerts_, &gate_, &outbox_, &actuators_),
      orders_(&context_, &state_, &alerts_, &outbox_, &decider_, &evidence_),
      admission_(&context_, &state_, &alerts_, &own_agents_, &actuators_, &decider_, &orders_),
      judge_({.context = context_,
              .state = state_,
              .gate = gate_,
              .evidence = evidence_,
              .outbox = outbox_,
              .sensors = sensors_,
              .losses = losses_,
              .findings = findings_,
              .sight = sight_,
              .actuators = actuators_,
              .decider = decider_}) {
  const store::RobotRecord& record = start.record;
  state_.RestoreVariables(record.variables);
  state_.robot_id = context_.config.id;
  if (record.rules_halted) state_.Halt();
  window_.Restore(record.maintenance, context_.now());
  if (record.decision_id.none()) {
    decider_.Adopt(state_.level.level(), DecisionId{}, "first start");
  } else {
    actuators_.Restore(record.decision_id, record.level);
  }
}

Actions RobotCore::On(const Input& input, const Moment& moment) {
  context_.moment = moment;
  const bool heard = retired_.ok() || StillHeard(input);
  if (!heard) Refuse(input, retired_, context_);
  Epilogue(heard ? Handle(input) : After::kRoutine);
  return std::exchange(context_.actions, {});
}

void RobotCore::Recycle(Actions actions) {
  actions.clear();
  context_.actions = std::move(actions);
}

RobotCore::After RobotCore::Handle(const Input& input) {
  constexpr auto kAll = After::kFlushAndPublish;
  return std::visit(
      Overloaded{
          [&](const input::Advance&) { return judge_.Advance(), After::kRoutine; },
          [&](const input::SensorBatch& in) { return judge_.OnBatch(in), After::kRoutine; },
          [&](const input::Inspected& in) { return judge_.OnInspected(in), After::kRoutine; },
          [&](const input::SensorHello& in) { return OnSensorHello(in); },
          [&](const input::SensorHeartbeat& in) {
            return sensors_.OnHeartbeat(in), After::kRoutine;
          },
          [&](const input::InterestSent& in) {
            return sensors_.OnInterestSent(in), After::kRoutine;
          },
          [&](const input::InterestAnswer& in) { return sensors_.OnInterestAnswer(in), kAll; },
          [&](const input::SensorGone& in) {
            sensors_.OnGone(in.host, in.session);
            findings_.Update();
            judge_.Wake();
            return After::kPublish;
          },
          [&](const input::ActuatorHello& in) { return OnArmed(admission_.OnHello(in)); },
          [&](const input::DecisionFound& in) { return OnArmed(admission_.OnDecisionFound(in)); },
          [&](const input::TermDrawn& in) {
            if (!absl::IsAborted(in.term.status())) return OnArmed(admission_.OnTermDrawn(in));
            return OnRetire(in.term.status()), After::kFlush;
          },
          [&](const input::ActuatorHeartbeat& in) {
            if (const auto found = actuators_.OnHeartbeat(in)) {
              decider_.Adopt(found->level, state_.level.decision_id(), found->why);
            }
            return After::kRoutine;
          },
          [&](const input::Receipt& in) { return OnReceipt(in); },
          [&](const input::ActuatorGone& in) {
            admission_.OnGone(in.host, in.session);
            if (!actuators_.OnGone(in.host, in.session)) return After::kRoutine;
            drills_.OnGone(in.host);
            sensors_.SendSetups();
            return After::kPublish;
          },
          [&](const input::Raise& in) { return orders_.OnRaise(in), kAll; },
          [&](const input::DeEscalate& in) { return orders_.OnDeEscalate(in), kAll; },
          [&](const input::Approve& in) { return orders_.OnApprove(in), kAll; },
          [&](const input::OperatorBanned& in) {
            return orders_.approvals().EndOf(in.identity), kAll;
          },
          [&](const input::ResetTerm& in) { return admission_.OnResetTerm(in), kAll; },
          [&](const input::ResumeRules& in) { return orders_.OnResume(in), kAll; },
          [&](const input::SetMaintenance& in) { return maintenance_.OnSet(in), kAll; },
          [&](const input::SendSignal& in) { return orders_.OnSignal(in), kAll; },
          [&](const input::StartDrill& in) { return drills_.Start(in), kAll; },
          [&](const input::RefusedOrder& in) { return orders_.OnRefused(in), kAll; },
          [&](const input::Report& in) {
            alerts_.RaiseOfKind(in.kind, in.severity, in.text);
            return kAll;
          },
          [&](const input::KeyMisused& in) {
            if (in.sensor ? sensors_.Listed(in.host) != nullptr : actuators_.Lists(in.host)) {
              own_agents_.OnMisused(absl::StrCat(in.sensor ? "sensor " : "actuator ", in.host),
                                    in.peer);
            }
            return kAll;
          },
          [&](const input::SwapPolicy& in) { return OnSwapPolicy(in), kAll; },
          [&](const input::WatchAlso& in) {
            context_.watch.SetAlso(in.also, context_.policy);
            sensors_.AskInterest();
            return After::kRoutine;
          },
          [&](const input::SetHosts& in) { return OnSetHosts(in), kAll; },
          [&](const input::PolicyProblem& in) {
            policy_problem_ = in.problem;
            return After::kPublish;
          },
          [&](const input::Drain&) { return OnDrain(), kAll; },
          [&](const input::Retire& in) { return OnRetire(in.why), After::kFlush; },
          [&](const input::Recorded& in) { return OnRecorded(in); },
          [&](const input::RaisesSaved& in) {
            for (const DecisionId& decision_id : in.decisions) OnDurable(decision_id);
            return After::kRoutine;
          },
          [&](const input::Time&) { return OnTime(); },
      },
      input);
}

void RobotCore::Epilogue(After after) {
  if (retired_.ok()) {
    UpdateActuation();
    actuators_.SendCommands();
  }
  const bool flush = after == After::kFlush || after == After::kFlushAndPublish;
  if (flush || outbox_.due()) Flush();
  if (!retired_.ok() || after == After::kRoutine || after == After::kFlush) return;
  RobotStatus status = Status();
  if (status == published_) return;
  published_ = status;
  context_.Do(action::PublishStatus{std::move(status)});
}

void RobotCore::UpdateDoubt() {
  std::vector<ros2::Guid> trusted = own_agents_.participants();
  for (const std::string& part : own_agents_.parts()) {
    const auto& nodes = state_.graph->nodes();
    for (auto node = nodes.lower_bound({.full_name = part, .participant = {}});
         node != nodes.end() && node->full_name == part; ++node) {
      trusted.push_back(node->participant);
    }
  }
  actuators_.witness().SetDoubt(findings_.known().ForgeryOf(trusted));
}

void RobotCore::UpdateActuation() {
  findings_.Update();
  decider_.RunEvents();
  engine::Actuation actuation = actuators_.UpdateStage();
  if (!context_.events.empty()) {
    // The level may be another one now.
    decider_.RunEvents();
    actuation = actuators_.UpdateStage();
  }
  evidence_.Update();
  decider_.OnActuation(actuation);
}

void RobotCore::Flush() {
  if (!outbox_.CanSeal()) return;
  store::Checkpoint checkpoint{.soft_suspended = state_.level.soft_suspended(),
                               .rules_halted = state_.halted(),
                               .resumed_at = state_.level.resumed_at()};
  if (outbox_.unsaved().variables) checkpoint.variables = state_.Variables();
  if (outbox_.unsaved().bundle) checkpoint.bundle = context_.policy.bundle_id;
  if (outbox_.unsaved().maintenance) {
    checkpoint.maintenance = window_.At(context_.now()).value_or(store::Maintenance());
  }
  sensors_.AddHighWater(checkpoint.high_water);
  next_checkpoint_ns_ = context_.now_ns() + context_.timing.checkpoint_ns;
  context_.Do(action::Record{outbox_.Seal(std::move(checkpoint))});
}

// ------------------------------------------------------------------------------------- agents

RobotCore::After RobotCore::OnSensorHello(const input::SensorHello& in) {
  context_.store = in.store;
  if (!sensors_.OnHello(in)) return After::kRoutine;
  findings_.OnHello(*sensors_.Listed(in.host));
  if (in.host == context_.config.primary_sensor) {
    actuators_.witness().BeginAgain(context_.now_ns());
  }
  sight_.OnState(*sensors_.Listed(in.host));
  judge_.Wake();
  return After::kFlushAndPublish;
}

RobotCore::After RobotCore::OnArmed(const std::string& host) {
  if (host.empty()) return After::kRoutine;
  drills_.OnGone(host);
  sight_.Update();
  actuators_.SendLease(host, evidence_.complete());
  actuators_.SendCommands();
  sensors_.SendSetups();
  decider_.RunEvents();
  actuators_.ReportMissingPrograms();
  return After::kFlushAndPublish;
}

RobotCore::After RobotCore::OnReceipt(const input::Receipt& in) {
  if (!actuators_.Hear(in)) return After::kRoutine;
  if (drills_.OnReceipt(in.host, in.receipt)) return After::kFlush;
  if (const auto result = actuators_.OnReceipt(in)) decider_.OnProgramResult(*result);
  return After::kPublish;
}

// ----------------------------------------------------------------------------------- the store

void RobotCore::OnDurable(const DecisionId& decision_id) {
  if (auto answer = decider_.orders().OnDurable(decision_id)) context_.Do(*std::move(answer));
}

RobotCore::After RobotCore::OnRecorded(const input::Recorded& in) {
  context_.store = in.store;
  const DurableOutbox::Settled settled = outbox_.OnRecorded(in.status.ok());
  if (absl::IsAborted(in.status)) return OnRetire(in.status), After::kFlush;
  if (!in.status.ok()) {
    // Written again with the rest when that can be written, which changes nothing.
    if (absl::IsResourceExhausted(in.status)) {
      store::WriteBatch raises = outbox_.Raises(state_.level.table());
      if (!raises.empty()) context_.Do(action::SaveRaises{std::move(raises)});
    }
    for (const levels::Transition& lowering : settled.lowerings) {
      decider_.TakeBack(
          lowering, engine::Severity::kCritical,
          absl::StrCat(absl::IsUnknown(in.status) ? "it is not known whether it was recorded: "
                                                  : "it could not be recorded: ",
                       in.status.message()));
    }
    return After::kPublish;
  }
  if (settled.alerts_dropped > 0) {
    alerts_.Raise(engine::Severity::kHigh,
                  absl::StrCat(settled.alerts_dropped,
                               " alerts were dropped while the store could not be written"));
  }
  sensors_.Acknowledge(settled.judged);
  for (const levels::Transition& lowering : settled.lowerings) {
    evidence_.Update();
    decider_.OnDurable(lowering);
  }
  for (const store::DecisionRecord& decision : settled.decisions) OnDurable(decision.decision_id);
  return After::kFlushAndPublish;
}

// ------------------------------------------------------------------------- time and inventory

RobotCore::After RobotCore::OnTime() {
  const bool checkpoint = context_.now_ns() >= next_checkpoint_ns_;
  if (!retired_.ok()) return checkpoint ? After::kFlush : After::kRoutine;
  maintenance_.Expire();
  sensors_.CheckLost();
  findings_.Update();
  for (const std::string& host : actuators_.CheckLost()) {
    drills_.OnGone(host);
    sensors_.SendSetups();
  }
  decider_.RunEvents();
  findings_.Expire();
  actuators_.witness().OnTime(sensors_.complete() && sight_.blind().empty(), context_.now_ns());
  UpdateDoubt();
  for (const std::string& host : findings_.ToAsk()) sensors_.AskFindings(host);
  if (own_agents_.Expire()) sensors_.SendSetups();
  orders_.approvals().Expire();
  sight_.Update();
  judge_.Wake();
  evidence_.Update();
  judge_.OnTime();
  const bool heartbeat = context_.now_ns() >= next_heartbeat_ns_;
  if (heartbeat) {
    next_heartbeat_ns_ = context_.now_ns() + context_.timing.heartbeat_ns;
    sensors_.EchoHeartbeats();
    actuators_.SendLeases(evidence_.complete());
  }
  if (context_.now_ns() >= next_tick_ns_) OnTick();
  for (const ProgramResult& result : actuators_.ExpiredPrograms()) {
    decider_.OnProgramResult(result);
  }
  drills_.Advance();
  if (heartbeat) return checkpoint ? After::kFlushAndPublish : After::kPublish;
  return checkpoint ? After::kFlush : After::kRoutine;
}

void RobotCore::OnTick() {
  next_tick_ns_ = context_.now_ns() + context_.timing.tick_ns;
  context_.events.push_back(engine::TickEvent{});
  decider_.RunEvents();
  sight_.Report(actuators_.PartsVerified());
  decider_.Expire();
  losses_.Report();
  findings_.Summarize();
  alerts_.Summarize();
}

void RobotCore::OnSwapPolicy(const input::SwapPolicy& in) {
  if (in.policy.bundle_id == context_.policy.bundle_id) {
    return context_.Do(action::AnswerOrder{in.token, {.status = absl::OkStatus()}});
  }
  absl::Status status = absl::OkStatus();
  if (!actuators_.attached().empty() &&
      in.policy.program->rules().levels.names() != state_.level.table().names()) {
    status =
        absl::FailedPreconditionError("its levels differ from those of the attached actuators");
  } else {
    status = state_.SwapProgram(in.policy.program);
  }
  if (status.ok()) {
    std::vector<std::string> dropped = context_.policy.two_person;
    std::erase_if(dropped, [&](const std::string& level) {
      const std::vector<std::string>& kept = in.policy.two_person;
      return std::find(kept.begin(), kept.end(), level) != kept.end();
    });
    context_.policy = in.policy;
    CompletePolicy(context_.policy);
    context_.watch.OnPolicy(context_.policy);
    outbox_.Touch(&DurableOutbox::Unsaved::bundle);
    policy_problem_.clear();
    gate_.set_hold_ns(in.policy.soft_hold_ns);
    alerts_.Raise(
        dropped.empty() ? engine::Severity::kInfo : engine::Severity::kMedium,
        absl::StrCat("bundle ", in.policy.bundle_id, " is in force",
                     dropped.empty() ? "" : "; one operator alone lowers from now on from ",
                     absl::StrJoin(dropped, ", "),
                     in.policy.two_person.empty() ? "" : "; two operators lower from ",
                     absl::StrJoin(in.policy.two_person, ", ")));
    sensors_.AskInterest();
    actuators_.ReportMissingPrograms();
    judge_.Wake();
  } else {
    alerts_.Raise(engine::Severity::kHigh, absl::StrCat("bundle ", in.policy.bundle_id,
                                                        " was not taken: ", status.message()));
  }
  context_.Do(action::AnswerOrder{in.token, {.status = std::move(status)}});
}

void RobotCore::OnSetHosts(const input::SetHosts& in) {
  // Sensors that are to follow other settings begin anew, which disturbs by itself.
  const bool other_hosts = !SameHosts(in.config, context_.config);
  sensors_.SetHosts(in.config);
  const std::vector<std::string> before = std::exchange(context_.config, in.config).actuator_hosts;
  actuators_.SetHosts(in.config.actuator_hosts);
  findings_.OnHosts();
  for (const std::string& host : before) {
    if (!actuators_.Lists(host)) drills_.OnGone(host);
  }
  admission_.CloseUnlisted();
  sensors_.SendSetups();
  actuators_.ReportMissingPrograms();
  judge_.Wake();
  // Nothing was seen or held by those who are new.
  if (other_hosts) gate_.Disturb("the inventory lists other hosts", context_.now());
}

void RobotCore::OnDrain() {
  context_.draining = true;
  // Who waits for a disk that does not answer would keep the server from ending.
  orders_.RefuseAll(absl::UnavailableError(
      "the server is stopping; the order may be in force and recorded, or not: ask for the level"));
  drills_.Advance();
  actuators_.SendLeases(evidence_.complete());
  outbox_.Touch(&DurableOutbox::Unsaved::sequences);
}

void RobotCore::OnRetire(const absl::Status& why) {
  if (absl::IsAborted(why)) outbox_.Abandon();
  if (retired_.ok()) context_.Do(action::ReportRetired{why});
  retired_ = why;
  sensors_.CloseAll(why);
  actuators_.CloseAll(why);
  admission_.CloseAll(why);
  judge_.Clear();
  drills_.Refuse(why);
  orders_.RefuseAll(why);
  outbox_.Touch(&DurableOutbox::Unsaved::sequences);
}

// --------------------------------------------------------------------------------------- status

RulesState RobotCore::rules() const {
  return {.bundle_id = context_.policy.bundle_id,
          .level = state_.level.table().name(state_.level.level()),
          .variables = state_.Variables(),
          .graph = state_.graph.version().graph,
          .settled = judge_.graph_changed_unix_ns() != 0,
          .time_unix_ns = context_.now().unix_ns,
          .uptime_ns = context_.now_ns() - state_.started().boottime_ns};
}

std::optional<std::string> RobotCore::WhyRulesCannotLower() const {
  const levels::LevelIndex level = state_.level.level();
  if (level == 0) return std::nullopt;
  // All that is in the way: an operator must not learn of one only after waiting for another.
  std::vector<std::string> reasons;
  const std::string resume =
      absl::StrCat(" (`ripsctl rules resume ", context_.config.id, " --reason TEXT`)");
  if (state_.halted()) {
    reasons.push_back(absl::StrCat(
        "a rule has called `crash`: no rule runs until an operator resumes them", resume));
  }
  levels::LevelMachine tried = state_.level;
  const levels::Transition asked =
      tried.Request(level - 1, {}, context_.now(), {}, levels::Lateness::kTimely);
  if (asked.refusal == levels::Refusal::kNeedsOperator) {
    reasons.push_back(absl::StrCat(asked.detail, ", so only a person may lower it"));
  } else if (asked.refused()) {
    reasons.push_back(absl::StrCat(asked.detail, resume));
  }
  if (levels().at(level).soft) {
    const levels::Evidence evidence = gate_.Assess(context_.now());
    reasons.insert(reasons.end(), evidence.blind_because.begin(), evidence.blind_because.end());
  }
  return absl::StrJoin(reasons, "; ");
}

RobotStatus RobotCore::Status() const {
  RobotStatus status{.robot = context_.config.id,
                     .decided_level = state_.level.table().name(state_.level.level()),
                     .decision_id = state_.level.decision_id(),
                     .bundle_version = context_.policy.bundle_id,
                     .degraded = evidence_.Problems(),
                     .pending_approvals = orders_.approvals().pending(),
                     .policy_problem = policy_problem_,
                     .watched = sensors_.connected(),
                     .maintenance = window_.At(context_.now())};
  actuators_.AddStatus(status);
  if (!policy_problem_.empty()) status.degraded.push_back(policy_problem_);
  if (std::string skipped = losses_.SkippedText(); !skipped.empty()) {
    status.degraded.push_back(std::move(skipped));
  }
  if (const std::string failure = actuators_.reconciler().failure(); !failure.empty()) {
    status.degraded.push_back(absl::StrCat("level not reached: ", failure));
  }
  if (state_.level.soft_suspended()) {
    status.degraded.push_back("rules may not lower levels until an operator resumes them");
  }
  if (state_.halted()) {
    status.degraded.push_back(
        "a rule has called `crash`: no rule runs until an operator resumes them");
  }
  return status;
}

}  // namespace rips::pipeline

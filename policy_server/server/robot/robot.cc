#include "policy_server/server/robot/robot.h"

#include <algorithm>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/robot/parts/soft_lowerings.h"
#include "services/base/cut_text.h"

namespace rips::pipeline {
namespace {

std::string CauseText(const levels::Cause& cause) {
  switch (cause.kind) {
    case levels::Cause::Kind::kRule:
      return absl::StrCat("rule ", cause.name);
    case levels::Cause::Kind::kOperator:
      return absl::StrCat("operator ", cause.name);
    case levels::Cause::Kind::kCrash:
      return absl::StrCat("crash in rule ", cause.name);
    case levels::Cause::Kind::kAdopted:
      return "adopted";
  }
  return "";
}

absl::Status RefusalStatus(const levels::Transition& transition, const levels::LevelTable& table) {
  return absl::FailedPreconditionError(absl::StrCat(
      "the level stays ", table.name(transition.from), ": ", levels::ToString(transition.refusal),
      transition.detail.empty() ? "" : absl::StrCat("; ", transition.detail)));
}

}  // namespace

absl::StatusOr<std::unique_ptr<Robot>> Robot::Create(RobotConfig config, Policy policy,
                                                     Timing timing,
                                                     const store::RobotRecord& record,
                                                     uint64_t term, Ports ports) {
  const levels::LevelTable& table = policy.program->rules().levels;
  levels::LevelIndex level = policy.start_level;
  if (!record.level.empty()) {
    const auto found = table.Find(record.level);
    if (!found) {
      return absl::InvalidArgumentError(absl::StrCat(
          "robot `", config.id, "` is recorded at level `", record.level,
          "`, which its bundle does not declare (", absl::StrJoin(table.names(), ", "), ")"));
    }
    level = *found;
  }
  levels::LevelMachine machine(table, level, record.decision_id, term);
  machine.RestoreBudget(SoftLowerings(record, table, ports.clock->Now()), record.resumed_at);
  if (record.soft_suspended) machine.Suspend();
  return std::unique_ptr<Robot>(new Robot(std::move(config), std::move(policy), timing, record,
                                          std::move(machine), std::move(ports)));
}

Robot::Robot(RobotConfig config, Policy policy, Timing timing, const store::RobotRecord& record,
             levels::LevelMachine level, Ports ports)
    : config_(std::move(config)),
      policy_(std::move(policy)),
      timing_(timing),
      ports_(std::move(ports)),
      state_(policy_.program, std::move(level), ports_.clock->Now()),
      evidence_(policy_.soft_hold_ns, ports_.clock->Now()),
      ledger_(config_.actuator_hosts, ports_.new_id),
      started_ns_(ports_.clock->Now().boottime_ns) {
  state_.RestoreVariables(record.variables);
  state_.set_robot_id(config_.id);
  if (record.rules_halted) state_.Halt();
  told_.budget_spent = record.soft_suspended;
  UseInterest();
  for (const std::string& host : config_.sensor_hosts) {
    sensors_[host].name = host;
    sensors_[host].BeginGraph(config_.graph_limits, kept_topics_);
    sensors_[host].gone_since_ns = started_ns_;
  }
  for (const std::string& host : config_.actuator_hosts) {
    actuators_[host].gone_since_ns = started_ns_;
  }
  for (const auto& [key, sequence] : record.high_water) {
    const auto it = sensors_.find(key.host);
    if (it == sensors_.end()) continue;
    const Lane lane = key.lane == store::LaneKey::Lane::kControl ? Lane::kControl : Lane::kMessages;
    it->second.sequences.Load(absl::HexStringToBytes(key.incarnation), lane, sequence);
    it->second.durable.Load(absl::HexStringToBytes(key.incarnation), lane, sequence);
  }
  if (record.decision_id.none()) {
    Adopt(state_.level.level(), DecisionId{}, "first start");
  } else {
    ledger_.Order(record.decision_id, state_.level.level(), record.level, "restored",
                  /*lowers=*/false);
  }
}

absl::Status Robot::AddTap(std::shared_ptr<EventRecorder> tap) {
  if (taps_.size() >= kTapsMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat(kTapsMax, " recordings of `", config_.id, "` run already, the limit"));
  }
  taps_.push_back(std::move(tap));
  return absl::OkStatus();
}

void Robot::Run(const engine::Event& event, const MessageSeen* message, absl::string_view remark) {
  const Instant now = ports_.clock->Now();
  taps_.erase(std::remove_if(taps_.begin(), taps_.end(),
                             [&](const std::shared_ptr<EventRecorder>& tap) {
                               return !tap->OnEvent(event, state_.graph.version().graph, message);
                             }),
              taps_.end());
  state_.evidence = evidence_.Assess(now);
  const engine::Outcome outcome = engine::Evaluate(event, now, state_);
  if (!outcome.effects.empty() || !outcome.refused_programs.empty() ||
      !outcome.cut_strings.empty()) {
    Perform(outcome, absl::StrCat(engine::Describe(event), remark));
  } else if (outcome.variables_changed) {
    outbox_.TouchVariables();
  }
}

void Robot::External(engine::ExternalEvent event) {
  Run({.what = std::move(event), .time_unix_ns = ports_.clock->Now().unix_ns});
}

void Robot::Perform(const engine::Outcome& outcome, const std::string& event) {
  if (outcome.variables_changed) outbox_.TouchVariables();
  for (const auto& refused : outcome.refused_programs) {
    OwnAlert(engine::Severity::kMedium,
             absl::StrCat("program `", refused.program, "` of rule ", refused.rule,
                          " was not run: ", refused.reason));
  }
  for (const std::string& rule : outcome.cut_strings) {
    OwnAlert(engine::Severity::kLow,
             absl::StrCat("rule ", rule, " made a string that is too long; it was cut"));
  }
  for (const engine::Effect& effect : outcome.effects) {
    if (const auto* alert = std::get_if<engine::AlertEffect>(&effect)) {
      const Instant now = ports_.clock->Now();
      if (!alert_limiter_.Admit(*alert, now)) continue;
      Alert(*alert, alert->graph_truncated ? absl::StrCat(event, " (graph truncated)") : event);
    } else if (const auto* transition = std::get_if<engine::TransitionEffect>(&effect)) {
      TakeTransition(*transition);
    } else if (const auto* run = std::get_if<engine::RunProgramEffect>(&effect)) {
      const Instant now = ports_.clock->Now();
      ProgramResult refused{.run_id = run->run_id};
      if (!ports_.recorder->healthy()) {
        refused.detail = "cannot write the store";
      } else if (!ledger_.Run(run->run_id, run->program, run->args, now)) {
        refused.detail = "no attached actuator offers it";
      } else {
        SendCommands(now);
        continue;
      }
      OwnAlert(engine::Severity::kHigh, absl::StrCat("program `", run->program, "` of rule ",
                                                     run->rule, " was not run: ", refused.detail));
      HandleProgramResult(refused, now);
    } else if (const auto* log = std::get_if<engine::LogEffect>(&effect)) {
      ports_.audience->OnRuleLog(config_.id, log->rule, log->text);
    }
  }
}

void Robot::HandleProgramResult(const ProgramResult& result, Instant now) {
  Perform(engine::OnProgramResult(result.run_id, result.ok, now, state_), "program result");
}

void Robot::TakeTransition(const engine::TransitionEffect& effect) {
  const levels::Transition& transition = effect.transition;
  const levels::LevelTable& table = state_.level.table();
  if (transition.refusal == levels::Refusal::kBudget && !std::exchange(told_.budget_spent, true)) {
    constexpr levels::SoftBudget kBudget;
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat("rules have lowered the level ", kBudget.lowerings_max, " times in ",
                          kBudget.window_ns / (60 * kNanosPerSecond),
                          " minutes: they lower it no more until an operator says `ripsctl rules ",
                          "resume ", config_.id, "`"));
  }
  if (transition.refused()) {
    // One record per kind of refusal; its count moves on.
    const std::string key = absl::StrCat(CauseText(transition.cause), "\n", transition.from, "\n",
                                         transition.to, "\n", levels::ToString(transition.refusal));
    auto [it, fresh] = refusal_ids_.try_emplace(key);
    if (fresh || effect.count == 1) it->second = ports_.new_id();
    const bool round = (effect.count & (effect.count - 1)) == 0;
    if (!round) return;  // counts are written at 1, 2, 4, 8, ...
    std::string reason(levels::ToString(transition.refusal));
    if (!transition.detail.empty()) absl::StrAppend(&reason, ": ", transition.detail);
    outbox_.AddRefusal({.id = it->second,
                        .robot = config_.id,
                        .from = table.name(transition.from),
                        .to = table.name(transition.to),
                        .cause = CauseText(transition.cause),
                        .reason = std::move(reason),
                        .count = effect.count,
                        .time_unix_ns = transition.at.unix_ns,
                        .trace = CopyOf(effect.trace)});
    return;
  }
  if (!transition.decided()) return;
  RecordDecision(transition, effect.trace);
  evidence_.Restart(ports_.clock->Now());
  failure_alerted_ = false;
  // A raise from a lowering that is not durable yet lowers the robot, too, unless it leads at least
  // to where the robot was ordered.
  const bool after_lowering = !outbox_.held_back().none() && transition.to < ledger_.level();
  if (transition.lowers() || after_lowering) {
    outbox_.AddLowering(transition);
  } else {
    Order(transition);
  }
}

void Robot::Adopt(levels::LevelIndex level, const DecisionId& seen, const std::string& why) {
  levels::Transition transition = state_.level.Adopt(level, seen, ports_.clock->Now());
  transition.cause.reason = why;
  TakeTransition({.transition = std::move(transition)});
}

void Robot::RecordDecision(const levels::Transition& transition, const engine::SharedTrace& trace) {
  const levels::LevelTable& table = state_.level.table();
  outbox_.AddDecision({.id = ports_.new_id(),
                       .robot = config_.id,
                       .decision_id = transition.decision_id,
                       .based_on = transition.based_on,
                       .from = table.name(transition.from),
                       .to = table.name(transition.to),
                       .cause = CauseText(transition.cause),
                       .reason = transition.cause.reason,
                       .time_unix_ns = transition.at.unix_ns,
                       .trace = CopyOf(trace)});
}

void Robot::Order(const levels::Transition& transition) {
  if (!ledger_.decision_id().none() && reported_stage_ != Stage::kVerified) {
    outbox_.AddStage(
        {.robot = config_.id, .decision_id = ledger_.decision_id(), .stage = "superseded"});
  }
  ledger_.Order(transition.decision_id, transition.to, state_.level.table().name(transition.to),
                CauseText(transition.cause), transition.lowers());
  reported_stage_ = Stage::kRequested;
  for (auto& [name, host] : actuators_) {
    if (!host.session) continue;
    host.session->ordered_most = std::max(host.session->ordered_most, transition.to);
  }
  SendCommands(ports_.clock->Now());
}

void Robot::Alert(engine::AlertEffect alert, const std::string& event) {
  const bool kept = outbox_.AddAlert({.id = ports_.new_id(),
                                      .time_unix_ns = ports_.clock->Now().unix_ns,
                                      .robot = config_.id,
                                      .rule = std::move(alert.rule),
                                      .severity = std::string(engine::ToString(alert.severity)),
                                      .text = Shortened(alert.text, kAlertTextBytesMax),
                                      .level = state_.level.table().name(alert.level),
                                      .event = Shortened(event, kAlertEventBytesMax),
                                      .decision_id = alert.decision_id,
                                      .trace = CopyOf(alert.trace)});
  if (!kept && ports_.counts.alerts_lost) ports_.counts.alerts_lost(1);
  if (ports_.counts.alerts) ports_.counts.alerts(1);
}

void Robot::OwnAlert(engine::Severity severity, const std::string& text,
                     std::source_location where) {
  engine::AlertEffect alert{.rule = std::string(kOwnRule),
                            .severity = severity,
                            .text = Shortened(text, kOwnAlertBytesMax),
                            .level = state_.level.level(),
                            .decision_id = state_.level.decision_id()};
  const std::string kind = absl::StrCat(where.file_name(), ":", where.line());
  if (own_alert_limiter_.Admit(kind, alert, ports_.clock->Now())) Alert(std::move(alert), "");
}

void Robot::RefuseSecond(SecondHolder& second, const std::string& peer) {
  second.Refused(peer, ports_.clock->Now().boottime_ns);
  if (ports_.counts.sessions_refused) ports_.counts.sessions_refused(1);
}

void Robot::BeginSession(absl::string_view agent, const std::string& host, SecondHolder& second,
                         const std::string& peer) {
  const std::string before = second.Begin(peer);
  if (before.empty()) return;
  OwnAlert(
      engine::Severity::kMedium,
      absl::StrCat(agent, " ", config_.id, "/", host, " now comes from ", peer, ", before from ",
                   before, "; if it was not moved, its key may be in other hands"));
}

void Robot::TellSecond(absl::string_view agent, const std::string& host, SecondHolder& second) {
  const auto report = second.Heard(ports_.clock->Now().boottime_ns);
  if (!report) return;
  OwnAlert(engine::Severity::kCritical,
           absl::StrCat("a second process uses the key of ", agent, " ", config_.id, "/", host,
                        ": refused ", report->refused, " times, last from ", report->peer,
                        "; the session in use is from ", report->holder,
                        "; find out which of them is the robot, and replace the key"));
}

// ----------------------------------------------------------------------------------- evidence

std::vector<std::string> Robot::EvidenceProblems(Instant now) const {
  std::vector<std::string> problems;
  for (const auto& [name, host] : sensors_) {
    if (!host.session) {
      problems.push_back(absl::StrCat("sensor ", name, " is not connected"));
      continue;
    }
    if (now.boottime_ns - host.session->heard_ns > timing_.stale_ns) {
      problems.push_back(absl::StrCat("sensor ", name, " is silent"));
    }
    if (host.second.Contested(now.boottime_ns)) {
      problems.push_back(absl::StrCat("a second process uses the key of sensor ", name));
    }
    if (std::string problem = InterestProblem(host); !problem.empty()) {
      problems.push_back(std::move(problem));
    }
    if (name == config_.primary_sensor && !host.settled) {
      problems.push_back(absl::StrCat("the graph of sensor ", name, " has not settled"));
    }
    if (host.HasBacklog()) {
      problems.push_back(absl::StrCat("observations of sensor ", name, " are not judged yet"));
    }
  }
  if (control_line_.backlog) {
    problems.push_back("what its agents sent waits: the robot costs more than its share");
  }
  if (sensors_.empty()) problems.push_back("no sensor is listed in the inventory");
  problems.insert(problems.end(), sight_.blind.begin(), sight_.blind.end());
  for (const auto& [name, host] : actuators_) {
    if (!ActuatorLive(host, now)) {
      problems.push_back(absl::StrCat("actuator ", name, " holds no live lease"));
    } else if (host.second.Contested(now.boottime_ns)) {
      problems.push_back(absl::StrCat("a second process uses the key of actuator ", name));
    }
  }
  if (!ports_.recorder->healthy()) problems.push_back("cannot write the store");
  return problems;
}

bool Robot::HasBacklog() const {
  return std::any_of(sensors_.begin(), sensors_.end(),
                     [](const auto& sensor) { return sensor.second.HasBacklog(); });
}

void Robot::UpdateEvidence(Instant now) {
  const bool newest_ordered = ledger_.decision_id() == state_.level.decision_id();
  const bool verified =
      actuators_.empty() || (ledger_.stage() == Stage::kVerified && newest_ordered);
  evidence_.Update(EvidenceProblems(now), verified, now);
}

// ----------------------------------------------------------------------------------- operators

void Robot::Raise(const LevelOrder& order, LevelReply reply) {
  if (const auto repeated = orders_.Repeated(order.request_id)) return reply(*repeated);
  LevelAnswer answer;
  if (draining_) {
    answer.status = absl::UnavailableError("the server is stopping");
    return reply(answer);
  }
  const auto to = levels().Find(order.to);
  const levels::Cause cause{
      .kind = levels::Cause::Kind::kOperator, .name = order.operator_name, .reason = order.reason};
  if (!to) {
    answer.status = absl::InvalidArgumentError(
        absl::StrCat("`", absl::CHexEscape(order.to), "` is not a level of ", config_.id, " (",
                     absl::StrJoin(levels().names(), ", "), ")"));
    return reply(answer);
  }
  if (order.reason.empty() || order.reason.size() > kReasonBytesMax) {
    answer.status = absl::InvalidArgumentError(
        absl::StrCat("a reason of 1 to ", kReasonBytesMax, " bytes is required"));
    return reply(answer);
  }
  levels::LevelMachine trial = state_.level;
  const Instant now = ports_.clock->Now();
  const levels::Transition transition =
      order.dry_run ? trial.Raise(*to, cause, now) : state_.level.Raise(*to, cause, now);
  Decide(transition, order, std::move(reply), std::move(answer));
}

void Robot::DeEscalate(const LevelOrder& order, LevelReply reply) {
  if (const auto repeated = orders_.Repeated(order.request_id)) return reply(*repeated);
  const Instant now = ports_.clock->Now();
  LevelAnswer answer;
  if (draining_) {
    answer.status = absl::UnavailableError("the server is stopping");
    return reply(answer);
  }
  const auto to = levels().Find(order.to);
  const auto expected = levels().Find(order.expected_level);
  if (!to || !expected) {
    answer.status = absl::InvalidArgumentError(absl::StrCat(
        "`", absl::CHexEscape(to ? order.expected_level : order.to), "` is not a level of ",
        config_.id, " (", absl::StrJoin(levels().names(), ", "), ")"));
  } else if (order.reason.empty() || order.reason.size() > kReasonBytesMax) {
    answer.status = absl::InvalidArgumentError(
        absl::StrCat("a reason of 1 to ", kReasonBytesMax, " bytes is required"));
  } else {
    if (!ports_.recorder->healthy()) {
      answer.status = absl::FailedPreconditionError(
          "the server's store cannot be written, and a lowering must be recorded first; raising "
          "works");
      return reply(answer);
    }
    answer.blind_because = EvidenceProblems(now);
    answer.would_raise_again = engine::WouldRaise(*to, now, state_);
    if (!answer.blind_because.empty() && !order.accept_blind && !order.dry_run) {
      answer.status = absl::FailedPreconditionError(absl::StrCat(
          "RIPS does not see all of ", config_.id, " now: ",
          absl::StrJoin(answer.blind_because, "; "), "; --accept-blind lowers it all the same"));
    }
  }
  if (!answer.status.ok()) return reply(answer);

  const levels::Cause cause{
      .kind = levels::Cause::Kind::kOperator, .name = order.operator_name, .reason = order.reason};
  levels::LevelMachine trial = state_.level;
  levels::LevelMachine& machine = order.dry_run ? trial : state_.level;
  const levels::Transition transition =
      machine.DeEscalate(*to, cause, now, *expected, order.expected_decision_id);
  Decide(transition, order, std::move(reply), std::move(answer));
}

void Robot::Decide(const levels::Transition& transition, const LevelOrder& order, LevelReply reply,
                   LevelAnswer answer) {
  answer.decision_id = transition.decided() ? transition.decision_id : state_.level.decision_id();
  const levels::LevelIndex level = transition.refused() ? transition.from : transition.to;
  answer.decided_level = levels().name(level);
  answer.soft = levels().at(level).soft;
  if (transition.refused()) {
    answer.status = RefusalStatus(transition, levels());
    if (!order.dry_run) TakeTransition({.transition = transition});
  } else if (transition.decided() && !order.dry_run) {
    TakeTransition({.transition = transition});
    // Told when it is durable (OnRecorded), or taken back.
    orders_.Wait(transition.decision_id, order.request_id, answer, std::exchange(reply, nullptr));
  }
  UpdateActuation(ports_.clock->Now());
  Flush();
  PublishStatus();
  if (reply) reply(answer);
}

absl::Status Robot::ResumeRules(const std::string& operator_name, const std::string& reason) {
  if (reason.empty() || reason.size() > kReasonBytesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat("a reason of 1 to ", kReasonBytesMax, " bytes is required"));
  }
  state_.level.Resume();
  told_.budget_spent = false;
  const bool halted = state_.halted();
  state_.Resume();
  OwnAlert(engine::Severity::kInfo,
           absl::StrCat("operator ", operator_name,
                        halted ? " lets rules run again, and lower soft levels: "
                               : " lets rules lower soft levels again: ",
                        reason));
  Flush();
  PublishStatus();
  return absl::OkStatus();
}

void Robot::RecordRefusedOrder(const LevelOrder& order, const absl::Status& why) {
  constexpr size_t kRefusedOrdersMax = 256;
  const std::string cause = absl::StrCat("operator ", order.operator_name);
  const std::string key = absl::StrCat(cause, "\n", order.to);
  if (!levels().Find(order.to)) return;
  if (refused_orders_.size() >= kRefusedOrdersMax && !refused_orders_.contains(key)) return;
  auto [it, fresh] = refused_orders_.try_emplace(key);
  if (fresh) it->second.first = ports_.new_id();
  const uint64_t count = ++it->second.second;
  if ((count & (count - 1)) != 0) return;  // written at 1, 2, 4, 8, ...
  outbox_.AddRefusal({.id = it->second.first,
                      .robot = config_.id,
                      .from = levels().name(state_.level.level()),
                      .to = order.to,
                      .cause = cause,
                      .reason = std::string(why.message()),
                      .count = count,
                      .time_unix_ns = ports_.clock->Now().unix_ns});
  Flush();
}

void Robot::Report(engine::Severity severity, const std::string& text, std::source_location where) {
  OwnAlert(severity, text, where);
  Flush();
}

RobotStatus Robot::Status() const {
  const Instant now = ports_.clock->Now();
  RobotStatus status{.robot = config_.id,
                     .decided_level = levels().name(state_.level.level()),
                     // A lowering that is not durable yet is no command yet.
                     .stage = std::string(ToString(
                         ledger_.decision_id() == state_.level.decision_id() ? ledger_.stage()
                                                                             : Stage::kRequested)),
                     .decision_id = state_.level.decision_id(),
                     .bundle_version = policy_.bundle_id,
                     .degraded = EvidenceProblems(now)};
  levels::LevelIndex effective = -1;
  for (const auto& [name, host] : actuators_) {
    if (!host.session) continue;
    if (const auto level = levels().Find(host.session->heartbeat.effective_level)) {
      effective = std::max(effective, *level);
    }
    if (!host.session->heartbeat.floor_reason.empty()) {
      status.degraded.push_back(absl::StrCat(
          "actuator ", name, " holds a floor: ", host.session->heartbeat.floor_reason));
    }
    for (const std::string& text : host.session->heartbeat.degraded) {
      status.degraded.push_back(absl::StrCat("actuator ", name, ": ", text));
    }
  }
  status.effective_level = levels().name(effective);
  if (!told_.missing_programs.empty()) status.degraded.push_back(told_.missing_programs);
  if (!policy_problem_.empty()) status.degraded.push_back(policy_problem_);
  if (std::string skipped = SkippedText(now); !skipped.empty()) {
    status.degraded.push_back(std::move(skipped));
  }
  if (!ledger_.failure().empty()) {
    status.degraded.push_back(absl::StrCat("level not reached: ", ledger_.failure()));
  }
  if (state_.level.soft_suspended()) {
    status.degraded.push_back("rules may not lower levels until an operator resumes them");
  }
  if (state_.halted()) {
    status.degraded.push_back(
        "a rule has called `crash`: no rule runs until an operator resumes "
        "them");
  }
  return status;
}

void Robot::PublishStatus() {
  RobotStatus status = Status();
  if (status == published_) return;
  published_ = status;
  ports_.audience->OnStatus(status);
}

// ---------------------------------------------------------------------------------------- time

void Robot::OnTime() {
  const Instant now = ports_.clock->Now();
  if (retired_) {
    if (now.boottime_ns >= next_.checkpoint_ns) Flush();
    return;
  }
  CheckSensors(now);
  CheckActuators(now);
  ExpireFindings(now);
  ExpireParticipants(now);
  UpdateBlind(now);
  AdvanceMessages();
  graph_history_.Expire(now.boottime_ns, HasBacklog());
  UpdateEvidence(now);
  if (now.boottime_ns >= next_.heartbeat_ns) {
    next_.heartbeat_ns = now.boottime_ns + timing_.heartbeat_ns;
    for (auto& [name, host] : sensors_) {
      if (host.session) host.session->link->Heartbeat(host.session->peer_boottime_ns);
    }
    for (auto& [name, host] : actuators_) {
      if (host.session) SendLease(*host.session);
    }
    PublishStatus();
  }
  if (now.boottime_ns >= next_.tick_ns) {
    next_.tick_ns = now.boottime_ns + timing_.tick_ns;
    External(engine::TickEvent{});
    UpdateCoverage(now);
    TellBlind(now);
    Perform(engine::Expire(now, state_), "deadline");
    TellLosses(now);
    for (engine::AlertEffect& summary : alert_limiter_.Due(now)) Alert(std::move(summary), "");
    for (engine::AlertEffect& summary : own_alert_limiter_.Due(now)) Alert(std::move(summary), "");
  }
  for (const ProgramResult& result : ledger_.ExpiredPrograms(now)) {
    HandleProgramResult(result, now);
  }
  UpdateActuation(now);
  SendCommands(now);
  AdvanceDrill(now);
  const bool due = now.boottime_ns >= next_.checkpoint_ns;
  if (due || outbox_.due()) Flush();
}

absl::Status Robot::SwapPolicy(Policy policy) {
  if (policy.bundle_id == policy_.bundle_id) return absl::OkStatus();
  const bool attached = std::any_of(actuators_.begin(), actuators_.end(), [](const auto& actuator) {
    return actuator.second.session.has_value();
  });
  absl::Status status = absl::OkStatus();
  if (attached && policy.program->rules().levels.names() != levels().names()) {
    status =
        absl::FailedPreconditionError("its levels differ from those of the attached actuators");
  } else {
    status = state_.SwapProgram(policy.program);
  }
  if (!status.ok()) {
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat("bundle ", policy.bundle_id, " was not taken: ", status.message()));
  } else {
    policy_ = std::move(policy);
    outbox_.TouchBundle();
    policy_problem_.clear();
    evidence_.set_hold_ns(policy_.soft_hold_ns);
    OwnAlert(engine::Severity::kInfo, absl::StrCat("bundle ", policy_.bundle_id, " is in force"));
    UseInterest();
    TellMissingPrograms();
    AdvanceMessages();
  }
  Flush();
  PublishStatus();
  return status;
}

void Robot::Drain() {
  draining_ = true;
  // Who waits for a disk that does not answer would keep the server from ending.
  orders_.RefuseAll(absl::UnavailableError(
      "the server is stopping; the order may be in force and recorded, or not: ask for the level"));
  AdvanceDrill(ports_.clock->Now());
  for (auto& [name, host] : actuators_) {
    if (host.session) SendLease(*host.session);
  }
  outbox_.TouchSequences();
  Flush();
}

}  // namespace rips::pipeline

// Robot: what actuators are told and what they answer.
#include <algorithm>
#include <utility>

#include "absl/container/btree_set.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/robot/robot.h"
#include "services/base/cut_text.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {
namespace {

// What an actuator without a state of its own says of its floor.
constexpr char kStateLostFloor[] = "state lost";
// Events of drifts that one heartbeat makes.
constexpr uint64_t kDriftsToldMax = 8;

// Of a list of levels in an alert and in the status of a stream, which gRPC sends as a header.
constexpr size_t kLevelsTextBytesMax = 1'024;

// What is said of a mode or a node may change its numbers; the part before the colon names it.
absl::string_view Subject(absl::string_view text) { return text.substr(0, text.find(": ")); }

bool TellsOf(const std::vector<std::string>& texts, absl::string_view subject) {
  return std::any_of(texts.begin(), texts.end(),
                     [&](const std::string& text) { return Subject(text) == subject; });
}

// New ones. A count that went down is of an actuator that started anew; the first that this server
// hears says nothing of when they were.
uint64_t TakeDrifts(std::optional<uint64_t>& last, uint64_t drifts) {
  const uint64_t known = last.value_or(drifts);
  last = drifts;
  return drifts >= known ? drifts - known : drifts;
}

}  // namespace

bool Robot::ActuatorLive(const ActuatorHost& host, Instant now) const {
  return host.session && now.boottime_ns - host.session->heard_ns <= timing_.lost_ns;
}

std::vector<ros2::Guid> Robot::Participants() const {
  std::vector<ros2::Guid> own;
  for (const auto& [name, host] : actuators_) host.participants.AppendTo(own);
  for (const auto& [name, host] : sensors_) host.participants.AppendTo(own);
  return own;
}

void Robot::TakeParticipant(const std::string& agent, const ros2::Guid& participant,
                            OwnParticipants& known) {
  if (participant.none()) return;
  if (const auto node = ForeignNodeOf(graph(), participant)) {
    return OwnAlert(
        engine::Severity::kCritical,
        absl::StrCat(agent, " calls the DDS participant of node ", ros2::Printable(*node),
                     " its own; that is not believed, and its key may be in other "
                     "hands"));
  }
  known.Add(participant, ports_.clock->Now().boottime_ns);
}

void Robot::ExpireParticipants(Instant now) {
  bool gone = false;
  for (auto& [name, host] : actuators_) gone |= host.participants.Expire(now.boottime_ns);
  for (auto& [name, host] : sensors_) gone |= host.participants.Expire(now.boottime_ns);
  if (gone) SendSetups();
}

// What sensors must know of agents has changed.
void Robot::SendSetups() {
  for (auto& [name, sensor] : sensors_) {
    if (sensor.session) SendSetup(name, sensor, *sensor.session);
  }
}

std::vector<std::string> Robot::ProtectedParts() const {
  absl::btree_set<std::string> parts;
  for (const auto& [name, host] : actuators_) {
    parts.insert(host.protected_parts.begin(), host.protected_parts.end());
  }
  return {parts.begin(), parts.end()};
}

void Robot::TellMissingPrograms() {
  const std::vector<std::string> missing = ledger_.NotOffered(policy_.program->rules().programs);
  std::string text;
  if (!missing.empty()) {
    text = absl::StrCat("rules run programs that no actuator offers, so they will fail: `",
                        absl::StrJoin(missing, "`, `"), "`");
  }
  if (text == told_.missing_programs) return;
  told_.missing_programs = text;
  if (!text.empty()) OwnAlert(engine::Severity::kHigh, text);
}

void Robot::OnActuatorHello(const std::string& host_name, std::shared_ptr<ActuatorLink> link,
                            const ActuatorHello& hello) {
  const auto it = actuators_.find(host_name);
  if (it == actuators_.end()) {
    return link->Close(absl::PermissionDeniedError(absl::StrCat(
        "the inventory lists no actuator `", host_name, "` of robot `", config_.id, "`")));
  }
  ActuatorHost& host = it->second;
  const Instant now = ports_.clock->Now();
  if (host.session && now.boottime_ns - host.session->heard_ns < timing_.stale_ns) {
    RefuseSecond(host.second, hello.peer);
    return link->Close(absl::AlreadyExistsError(
        absl::StrCat("actuator ", config_.id, "/", host_name, " has a live session")));
  }
  BeginSession("actuator", host_name, host.second, hello.peer);
  if (hello.levels != levels().names()) {
    const std::string text =
        absl::StrCat("actuator ", host_name, " is not armed: its levels (",
                     Shortened(absl::StrJoin(hello.levels, ", "), kLevelsTextBytesMax),
                     ") are not those of the bundle (",
                     Shortened(absl::StrJoin(levels().names(), ", "), kLevelsTextBytesMax), ")");
    OwnAlert(engine::Severity::kCritical, text);
    Flush();
    return link->Close(absl::FailedPreconditionError(text));
  }
  const ShownTerm shown = {.decision_id = hello.decision_id, .highest_term = hello.highest_term};
  const TermJump jump =
      JudgeTerm(shown, {.term = state_.level.term(), .epoch = state_.level.decision_id().epoch},
                host.pardoned_term);
  if (jump != TermJump::kNear) {
    host.refused_term = shown;
    const std::string text = absl::StrCat(
        "actuator ", host_name, hello.peer.empty() ? "" : " at ", hello.peer, " names decision ",
        ToString(hello.decision_id), " and term ", hello.highest_term, ", far beyond ours (",
        ToString(state_.level.decision_id()), "): not armed; ",
        TermRemedy(jump, config_.id, host_name), "; otherwise its key may be in other hands");
    OwnAlert(engine::Severity::kCritical, text);
    Flush();
    return link->Close(absl::FailedPreconditionError(text));
  }
  host.refused_term.reset();
  if (!hello.decision_id.none() && hello.decision_id < host.verified) {
    OwnAlert(engine::Severity::kCritical,
             absl::StrCat("actuator ", host_name, " holds decision ", ToString(hello.decision_id),
                          " although it has verified ", ToString(host.verified),
                          ": its state was deleted or went back"));
  }
  if (host.arming) host.arming->Close(absl::AbortedError("replaced by a newer session"));
  host.arming = link;
  AskAndArm({.host = host_name, .link = std::move(link), .hello = hello});
}

// The store is asked for what must be known first, if anything.
void Robot::AskAndArm(const Arming& arming) {
  ActuatorHost& host = actuators_.at(arming.host);
  const ActuatorHello& hello = arming.hello;
  // On another thread this robot may be gone by then; what is posted is dropped if it is.
  const auto go_on = [this, post = ports_.post](const absl::Status& status, const Arming& next) {
    post([=, this] { OnStoreAnswer(status, next); });
  };
  // A term that an actuator has obeyed is never used for other decisions. Ours was drawn at this
  // start: an actuator that this process has not met yet cannot know it.
  const uint64_t obeyed = std::max(hello.highest_term, hello.decision_id.term);
  const uint64_t ours = state_.level.term();
  if (obeyed >= (host.met ? ours + 1 : ours)) {
    if (!arming.term) {
      return ports_.recorder->NextTerm(
          config_.id, obeyed, [go_on, next = arming](const absl::StatusOr<uint64_t>& term) mutable {
            if (term.ok()) next.term = *term;
            go_on(term.status(), next);
          });
    }
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat("actuator ", arming.host, " has obeyed term ", obeyed, ", our term is ",
                          ours, "; commands now carry term ", *arming.term));
    state_.level.RaiseTerm(*arming.term);
  }
  if (!hello.decision_id.none()) {
    const std::optional<std::string> known = KnownLevel(hello.decision_id);
    if (!known && !arming.level) {
      return ports_.recorder->FindDecision(
          config_.id, hello.decision_id,
          [go_on, next = arming](const FoundDecision& found) mutable {
            if (found.ok()) next.level = *found;
            go_on(found.status(), next);
          });
    }
    Reconcile(arming, known ? known : *arming.level);
  }
  host.arming.reset();
  Arm(host, arming);
}

void Robot::OnStoreAnswer(const absl::Status& status, const Arming& arming) {
  const auto it = actuators_.find(arming.host);
  // It has left, or came anew.
  if (it == actuators_.end() || it->second.arming != arming.link) return;
  if (status.ok()) return AskAndArm(arming);
  it->second.arming.reset();
  arming.link->Close(absl::UnavailableError(status.message()));
}

void Robot::Arm(ActuatorHost& host, const Arming& arming) {
  const auto& [host_name, link, hello, term, level] = arming;
  const Instant now = ports_.clock->Now();
  host.met = true;
  if (host.session) host.session->link->Close(absl::AbortedError("replaced by a newer session"));
  if (drill_) drill_->run.OnGone(host_name);
  host.session = ActuatorSession{.link = link,
                                 .heard_ns = now.boottime_ns,
                                 .peer_boottime_ns = hello.clock.boottime_ns,
                                 .heartbeat = {.effective_level = hello.effective_level}};
  TakeParticipant(absl::StrCat("actuator ", host_name), hello.participant, host.participants);
  host.protected_parts = hello.protected_parts;
  ++sight_.actuator_hellos;
  UpdateBlind(now);
  const levels::LevelIndex held = levels().Find(hello.decided_level).value_or(levels().size() - 1);
  ledger_.Attach(host_name, hello.decision_id, held, levels().name(held), hello.programs, now);
  if (host.lost) {
    OwnAlert(engine::Severity::kInfo, absl::StrCat("actuator ", host_name, " is back"));
  }
  host.lost = false;
  SendLease(*host.session);
  SendCommands(now);
  SendSetups();
  External(engine::AgentEvent{.agent = "actuator", .state = "connected"});
  if (hello.state_lost) {
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat(
                 "actuator ", host_name, " has no state of its own (first start, or it was ",
                 "deleted); it holds its fail-safe level, or the one its robot shows if that is ",
                 "higher"));
    External(engine::AgentEvent{.agent = "actuator", .state = "state_lost"});
    host.floor_told = kStateLostFloor;  // by the alert above
    host.session->found_above = levels().Find(hello.fail_safe_level).value_or(levels().size() - 1);
  }
  TellMissingPrograms();
  UpdateActuation(now);
  Flush();
  PublishStatus();
}

// Truth table of a Hello, by the decision that the actuator holds:
//   none                            it has no history; the newest decision goes out
//   in our history, same level      it is behind or even: the newest decision goes out
//   in our history, another level   our history is not the one it obeyed, as after a backup was
//                                   restored: the more restrictive level, as a new decision
//   unknown                         our history is incomplete: the same
void Robot::Reconcile(const Arming& arming, const std::optional<std::string>& known) {
  const ActuatorHello& hello = arming.hello;
  if (known == hello.decided_level) return;
  const levels::LevelIndex held = levels().Find(hello.decided_level).value_or(levels().size() - 1);
  const std::string ours = known ? absl::StrCat("which is ", *known, " in this server's history")
                                 : std::string("which this server does not know");
  OwnAlert(engine::Severity::kCritical,
           absl::StrCat("actuator ", arming.host, " holds decision ", ToString(hello.decision_id),
                        " (", levels().name(held), "), ", ours, ": the more restrictive level is ",
                        "adopted; was the store restored from a backup?"));
  // A pardoned epoch would use up all others, and the term is above its own.
  const DecisionId above = hello.decision_id.epoch > kEpochMax
                               ? DecisionId{.term = hello.decision_id.term}
                               : hello.decision_id;
  Adopt(held, above,
        absl::StrCat("actuator ", arming.host, " holds ", ToString(hello.decision_id), " (",
                     levels().name(held), ")"));
}

// As far as it is known without the store.
std::optional<std::string> Robot::KnownLevel(const DecisionId& decision_id) const {
  if (decision_id == state_.level.decision_id()) return levels().name(state_.level.level());
  // Perhaps not recorded yet.
  return ledger_.OrderedLevel(decision_id);
}

void Robot::SendLease(ActuatorSession& session) {
  const Instant now = ports_.clock->Now();
  // What a sensor that sees nothing has sent is judged, and says nothing: a floor stays.
  bool evidence_complete = sight_.blind.empty() && !control_line_.backlog;
  for (const auto& [name, host] : sensors_) {
    if (!host.session || now.boottime_ns - host.session->heard_ns > timing_.stale_ns ||
        (name == config_.primary_sensor && !host.settled)) {
      evidence_complete = false;
      break;
    }
    evidence_complete &= !host.HasBacklog();
  }
  const int64_t ttl_ns = draining_ ? timing_.drain_lease_ns : timing_.lease_ns;
  // A lowering that is not durable yet is not announced.
  const bool held_back = !outbox_.held_back().none();
  session.link->Grant(
      {.echo_boottime_ns = session.peer_boottime_ns,
       .term = state_.level.term(),
       .decision_id = held_back ? ledger_.decision_id() : state_.level.decision_id(),
       .level = held_back ? ledger_.level_name() : levels().name(state_.level.level()),
       .ttl_ms = static_cast<uint32_t>(ttl_ns / kNanosPerMilli),
       .evidence_complete = evidence_complete});
}

void Robot::SendCommands(Instant now) {
  for (const Outgoing& outgoing : ledger_.Due(state_.level.term(), now)) {
    const auto it = actuators_.find(outgoing.host);
    if (it != actuators_.end() && it->second.session) {
      receipts_.Sent(outgoing.host, outgoing.command);
      it->second.session->link->Send(outgoing.command);
    }
  }
}

void Robot::OnActuatorHeartbeat(const std::string& host_name, const ActuatorLink* link,
                                const ActuatorHeartbeat& heartbeat) {
  const auto it = actuators_.find(host_name);
  if (it == actuators_.end() || !it->second.session || it->second.session->link.get() != link) {
    return;
  }
  const Instant now = ports_.clock->Now();
  ActuatorSession& session = *it->second.session;
  // On its way because a floor was raised or lifted: not drift.
  const bool moving = session.heartbeat.effective_level != heartbeat.effective_level ||
                      session.heartbeat.floor_reason != heartbeat.floor_reason;
  session.heard_ns = now.boottime_ns;
  session.peer_boottime_ns = heartbeat.boottime_ns;
  TellSecond("actuator", host_name, it->second.second);
  session.heartbeat = heartbeat;
  const auto effective = levels().Find(heartbeat.effective_level);
  AdoptFound(host_name, session, effective);
  const bool left =
      effective && ledger_.OnHeartbeat(host_name, *effective, heartbeat.verified, now) && !moving;
  const uint64_t drifts = TakeDrifts(it->second.drifts, heartbeat.drifts);
  if (left || drifts > 0) {
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat("the robot no longer is at ", heartbeat.effective_level, " (",
                          heartbeat.observed, "); actuator ", host_name, " puts it back",
                          drifts > 1 ? absl::StrCat(", ", drifts, " times by now") : ""));
    for (uint64_t i = 0; i < std::clamp<uint64_t>(drifts, 1, kDriftsToldMax); ++i) {
      External(engine::AgentEvent{.agent = "actuator", .state = "drift"});
    }
  }
  TellFloor(host_name, it->second);
  TellDegraded(host_name, it->second, heartbeat.degraded);
  UpdateActuation(now);
}

// Without its state, an actuator holds the level at which it finds the robot. If that is above what
// we decided, our history lacks the decision.
void Robot::AdoptFound(const std::string& host_name, ActuatorSession& session,
                       std::optional<levels::LevelIndex> effective) {
  if (!session.found_above || !effective || session.heartbeat.floor_reason.empty()) return;
  if (*effective <= *session.found_above || *effective <= state_.level.level() ||
      *effective <= session.ordered_most) {
    return;
  }
  session.found_above.reset();
  const std::string found = absl::StrCat("actuator ", host_name, " has lost its state and finds ",
                                         config_.id, " at ", levels().name(*effective));
  OwnAlert(engine::Severity::kCritical,
           absl::StrCat(found, ", above what this server decided: adopted; was the store restored ",
                        "from a backup?"));
  Adopt(*effective, state_.level.decision_id(), found);
}

void Robot::TellFloor(const std::string& host_name, ActuatorHost& host) {
  const ActuatorHeartbeat& heartbeat = host.session->heartbeat;
  if (host.floor_told == heartbeat.floor_reason) return;
  if (heartbeat.floor_reason.empty()) {
    OwnAlert(engine::Severity::kInfo, absl::StrCat("actuator ", host_name, " no longer holds ",
                                                   config_.id, " at a level of its own"));
  } else if (heartbeat.effective_level == levels().name(state_.level.level())) {
    OwnAlert(
        engine::Severity::kHigh,
        absl::StrCat("actuator ", host_name, " has a floor of its own: ", heartbeat.floor_reason,
                     "; ", config_.id, " is at ", heartbeat.effective_level, " as decided"));
  } else {
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat("actuator ", host_name, " holds ", config_.id, " at ",
                          heartbeat.effective_level, " by itself: ", heartbeat.floor_reason));
  }
  host.floor_told = heartbeat.floor_reason;
}

void Robot::TellDegraded(const std::string& host_name, ActuatorHost& host,
                         const std::vector<std::string>& degraded) {
  if (degraded == host.degraded) return;
  for (const std::string& text : degraded) {
    if (TellsOf(host.degraded, Subject(text))) continue;
    OwnAlert(engine::Severity::kHigh, absl::StrCat("actuator ", host_name, ": ", text));
  }
  if (degraded.empty()) {
    OwnAlert(engine::Severity::kInfo,
             absl::StrCat("actuator ", host_name, " is no longer degraded"));
  }
  host.degraded = degraded;
  PublishStatus();
}

void Robot::OnReceipt(const std::string& host_name, const ActuatorLink* link,
                      const Receipt& receipt) {
  const auto it = actuators_.find(host_name);
  if (it == actuators_.end() || !it->second.session || it->second.session->link.get() != link) {
    return;
  }
  const Instant now = ports_.clock->Now();
  it->second.session->heard_ns = now.boottime_ns;
  receipts_.Received(host_name, receipt, now.unix_ns);
  if (drill_ && drill_->run.OnReceipt(host_name, receipt)) {
    AdvanceDrill(now);
    return Flush();
  }
  if (receipt.stage == Receipt::Stage::kVerified &&
      receipt.decision_id <= state_.level.decision_id()) {
    it->second.verified = std::max(it->second.verified, receipt.decision_id);
  }
  const ReceiptResult result = ledger_.OnReceipt(host_name, receipt, now);
  if (result.stale_term) {
    OwnAlert(engine::Severity::kCritical,
             absl::StrCat("actuator ", host_name, " refused term ", state_.level.term(),
                          ": another server has commanded it"));
  }
  if (result.program) {
    if (!result.program->ok && !result.program->detail.empty()) {
      OwnAlert(engine::Severity::kLow,
               absl::StrCat("a program failed on ", host_name, ": ", result.program->detail));
    }
    HandleProgramResult(*result.program, now);
  }
  UpdateActuation(now);
  SendCommands(now);
  if (outbox_.due()) Flush();
  PublishStatus();
}

void Robot::UpdateActuation(Instant now) {
  const Stage stage = ledger_.stage();
  if (stage != reported_stage_) {
    reported_stage_ = stage;
    std::string detail = ledger_.failure();
    outbox_.AddStage({.robot = config_.id,
                      .decision_id = ledger_.decision_id(),
                      .stage = std::string(ToString(stage)),
                      .detail = detail});
    if (stage == Stage::kFailed && !failure_alerted_) {
      failure_alerted_ = true;
      OwnAlert(engine::Severity::kCritical,
               absl::StrCat("level ", ledger_.level_name(), " was not reached: ", detail,
                            "; the decision stands and is tried again"));
      External(engine::AgentEvent{.agent = "actuator", .state = "failed"});
    }
  }
  const bool leased = std::any_of(actuators_.begin(), actuators_.end(), [&](const auto& actuator) {
    return ActuatorLive(actuator.second, now);
  });
  engine::Actuation actuation = engine::Actuation::kPending;
  if (!leased) {
    actuation = engine::Actuation::kNoLease;
  } else if (ledger_.decision_id() == state_.level.decision_id()) {
    if (stage == Stage::kVerified) actuation = engine::Actuation::kVerified;
    if (stage == Stage::kFailed) actuation = engine::Actuation::kFailed;
  }
  UpdateEvidence(now);
  if (actuation == state_.actuation) return;
  state_.actuation = actuation;
  Perform(engine::OnActuation(now, state_), "level report");
}

void Robot::OnActuatorGone(const std::string& host_name, const ActuatorLink* link) {
  const auto it = actuators_.find(host_name);
  if (it == actuators_.end()) return;
  if (it->second.arming.get() == link) it->second.arming.reset();
  if (!it->second.session || it->second.session->link.get() != link) return;
  const Instant now = ports_.clock->Now();
  it->second.session.reset();
  it->second.gone_since_ns = now.boottime_ns;
  ledger_.Detach(host_name);
  if (drill_) drill_->run.OnGone(host_name);
  SendSetups();
  UpdateActuation(now);
  PublishStatus();
}

void Robot::CheckActuators(Instant now) {
  for (auto& [name, host] : actuators_) {
    if (host.session && now.boottime_ns - host.session->heard_ns > timing_.lost_ns) {
      const std::shared_ptr<ActuatorLink> link = host.session->link;
      link->Close(absl::DeadlineExceededError("no heartbeat"));
      OnActuatorGone(name, link.get());
    }
    if (host.session || host.lost || now.boottime_ns - host.gone_since_ns < timing_.lost_ns) {
      continue;
    }
    host.lost = true;
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat("actuator ", name, " is lost: when its lease ends, ", config_.id,
                          " goes to its fail-safe level, unless it is at a higher one"));
    External(engine::AgentEvent{.agent = "actuator", .state = "lost"});
  }
}

}  // namespace rips::pipeline

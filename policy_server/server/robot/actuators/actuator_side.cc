#include "policy_server/server/robot/actuators/actuator_side.h"

#include <algorithm>
#include <utility>

#include "absl/container/inlined_vector.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace rips::pipeline {
namespace {

// What an actuator without a state of its own says of its floor.
constexpr char kStateLostFloor[] = "state lost";
// Events of drifts that one heartbeat makes.
constexpr uint64_t kDriftEventsMax = 8;

std::string Named(const std::string& host) { return absl::StrCat("actuator ", host); }

// What is said of a mode or a node may change its numbers; the part before the colon names it.
absl::string_view Subject(absl::string_view text) { return text.substr(0, text.find(": ")); }

bool Mentions(const std::vector<std::string>& texts, absl::string_view subject) {
  return std::any_of(texts.begin(), texts.end(),
                     [&](const std::string& text) { return Subject(text) == subject; });
}

// New ones. A count that went down is of an actuator that started anew; the first that this server
// hears says nothing of when they were.
uint64_t NewDrifts(std::optional<uint64_t>& last, uint64_t drifts) {
  const uint64_t known = last.value_or(drifts);
  last = drifts;
  return drifts >= known ? drifts - known : drifts;
}

}  // namespace

ActuatorSide::ActuatorSide(Context* context, Alerts* alerts, DurableOutbox* outbox,
                           OwnAgents* own_agents, const levels::LevelMachine* level)
    : context_(*context),
      alerts_(*alerts),
      outbox_(*outbox),
      own_agents_(*own_agents),
      level_(*level),
      reconciler_(context->config.actuator_hosts, &context->ids) {
  for (const std::string& host : context_.config.actuator_hosts) {
    hosts_[host].gone_since_ns = context_.now_ns();
  }
}

void ActuatorSide::Restore(const DecisionId& decision_id, const std::string& level_name) {
  reconciler_.Order(decision_id, level_.level(), level_name, "restored", /*lowers=*/false);
}

// ------------------------------------------------------------------------------------ sessions

bool ActuatorSide::Live(const Host& host) const {
  return host.session && context_.now_ns() - host.session->heard_ns <= context_.timing.lost_ns;
}

bool ActuatorSide::HasLiveSession(const std::string& host) const {
  const std::optional<Session>& session = hosts_.at(host).session;
  return session && context_.now_ns() - session->heard_ns < context_.timing.stale_ns;
}

void ActuatorSide::Arm(const input::ActuatorHello& in) {
  Host& host = hosts_.at(in.host);
  const ActuatorHello& hello = in.hello;
  host.met = true;
  if (host.session) {
    context_.Do(action::Close{host.session->id, absl::AbortedError("replaced by a newer session")});
  }
  host.session = Session{.id = in.session,
                         .found_above = std::nullopt,
                         .heard_ns = context_.now_ns(),
                         .peer_boottime_ns = hello.clock.boottime_ns,
                         .heartbeat = {.effective_level = hello.effective_level}};
  own_agents_.AddParticipant(Named(in.host), hello.participant);
  own_agents_.SetParts(Named(in.host), hello.protected_parts);
  if (!witness_.SetParts(in.host, hello) && !hello.protected_parts.empty() &&
      !std::exchange(host.silence_reported, true)) {
    alerts_.Raise(engine::Severity::kInfo,
                  absl::StrCat("actuator ", in.host,
                               " does not say which nodes its levels have inactive, as older "
                               "versions do not: whether they go on publishing is not checked"));
  }
  const levels::LevelIndex held = levels().Find(hello.decided_level).value_or(levels().size() - 1);
  reconciler_.Attach(in.host, hello.decision_id, held, levels().name(held), hello.programs,
                     context_.now());
  if (std::exchange(host.lost, false)) {
    alerts_.Raise(engine::Severity::kInfo, absl::StrCat("actuator ", in.host, " is back"));
  }
  context_.events.push_back(engine::AgentEvent{.agent = "actuator", .state = "connected"});
  if (hello.state_lost) OnStateLost(in.host, host, hello);
}

void ActuatorSide::OnStateLost(const std::string& name, Host& host, const ActuatorHello& hello) {
  alerts_.Raise(engine::Severity::kHigh,
                absl::StrCat("actuator ", name,
                             " has no state of its own (first start, or it was deleted); it holds ",
                             "its fail-safe level, or the one its robot shows if that is higher"));
  context_.events.push_back(engine::AgentEvent{.agent = "actuator", .state = "state_lost"});
  host.floor = kStateLostFloor;  // the alert above has reported it
  host.session->found_above = levels().Find(hello.fail_safe_level).value_or(levels().size() - 1);
}

void ActuatorSide::End(const std::string& name, Host& host) {
  host.session.reset();
  host.gone_since_ns = context_.now_ns();
  reconciler_.Detach(name);
}

bool ActuatorSide::OnGone(const std::string& host, SessionId session) {
  const auto it = hosts_.find(host);
  if (it == hosts_.end() || !it->second.session || it->second.session->id != session) return false;
  End(host, it->second);
  return true;
}

std::vector<std::string> ActuatorSide::CheckLost() {
  std::vector<std::string> ended;
  for (auto& [name, host] : hosts_) {
    if (host.session && !Live(host)) {
      context_.Do(action::Close{host.session->id, absl::DeadlineExceededError("no heartbeat")});
      End(name, host);
      ended.push_back(name);
    }
    if (host.session || host.lost ||
        context_.now_ns() - host.gone_since_ns < context_.timing.lost_ns) {
      continue;
    }
    host.lost = true;
    alerts_.RaiseAbsence(absl::StrCat(
        "actuator ", name, host.met ? " is lost" : " has not connected since this server started",
        ": if it runs without a connection, ", context_.config.id,
        " goes to its fail-safe level when its lease ends, unless it is at a higher "
        "one; if it has ended, ",
        context_.config.id, " stays as it is and nothing can stop it from here"));
    context_.events.push_back(engine::AgentEvent{.agent = "actuator", .state = "lost"});
  }
  ReportAbsence();
  return ended;
}

void ActuatorSide::ReportAbsence() {
  if (!newest_.raises || newest_.reached || newest_.absence_reported) return;
  if (context_.now_ns() - newest_.ordered_ns < context_.timing.lost_ns) return;
  std::vector<std::string> absent;
  for (const auto& [name, host] : hosts_) {
    if (!Live(host)) absent.push_back(Named(name));
  }
  if (absent.empty()) return;
  newest_.absence_reported = true;
  alerts_.Raise(engine::Severity::kCritical,
                absl::StrCat("level ", reconciler_.level_name(), " is not in force on ",
                             absl::StrJoin(absent, ", "),
                             ", which is not connected: what it guards may go on moving; the level "
                             "is ordered as soon as it connects"));
}

void ActuatorSide::SetHosts(const std::vector<std::string>& hosts) {
  for (auto it = hosts_.begin(); it != hosts_.end();) {
    auto& [name, host] = *it;
    if (std::find(hosts.begin(), hosts.end(), name) != hosts.end()) {
      ++it;
      continue;
    }
    if (host.session) {
      context_.Do(action::Close{
          host.session->id,
          absl::PermissionDeniedError(absl::StrCat("the inventory no longer lists actuator `", name,
                                                   "` of robot `", context_.config.id, "`"))});
    }
    own_agents_.Forget(Named(name));
    it = hosts_.erase(it);
  }
  for (const std::string& name : hosts) {
    const auto [it, fresh] = hosts_.try_emplace(name);
    if (fresh) it->second.gone_since_ns = context_.now_ns();
  }
  reconciler_.SetHosts(hosts);
}

void ActuatorSide::CloseAll(const absl::Status& why) {
  for (auto& [name, host] : hosts_) {
    if (host.session) context_.Do(action::Close{host.session->id, why});
    host.session.reset();
  }
}

// --------------------------------------------------------------------------- what they report

std::optional<FoundLevel> ActuatorSide::OnHeartbeat(const input::ActuatorHeartbeat& in) {
  const auto it = hosts_.find(in.host);
  if (it == hosts_.end() || !it->second.session || it->second.session->id != in.session) {
    return std::nullopt;
  }
  const ActuatorHeartbeat& heartbeat = in.heartbeat;
  Host& host = it->second;
  Session& session = *host.session;
  // At a floor, or on its way because one was raised or lifted: not drift.
  const bool moving = !heartbeat.floor_reason.empty() ||
                      session.heartbeat.effective_level != heartbeat.effective_level ||
                      session.heartbeat.floor_reason != heartbeat.floor_reason;
  session.heard_ns = context_.now_ns();
  session.peer_boottime_ns = heartbeat.boottime_ns;
  own_agents_.OnHeard(Named(in.host));
  session.heartbeat = heartbeat;
  const auto effective = levels().Find(heartbeat.effective_level);
  std::optional<FoundLevel> found = Found(in.host, session, effective);
  const bool left =
      effective &&
      reconciler_.OnHeartbeat(in.host, *effective, heartbeat.verified, context_.now()) && !moving;
  const uint64_t drifts = NewDrifts(host.drifts, heartbeat.drifts);
  if (left || drifts > 0) {
    alerts_.Raise(engine::Severity::kHigh,
                  absl::StrCat("the robot no longer is at ", heartbeat.effective_level, " (",
                               heartbeat.observed, "); actuator ", in.host, " puts it back",
                               drifts > 1 ? absl::StrCat(", ", drifts, " times by now") : ""));
    for (uint64_t i = 0; i < std::clamp<uint64_t>(drifts, 1, kDriftEventsMax); ++i) {
      context_.events.push_back(engine::AgentEvent{.agent = "actuator", .state = "drift"});
    }
  }
  if (!found) ReportFloor(in.host, host);
  ReportDegraded(in.host, host);
  return found;
}

// Without its state, an actuator holds the level at which it finds the robot. If that is above what
// we decided, our history lacks the decision.
std::optional<FoundLevel> ActuatorSide::Found(const std::string& name, Session& session,
                                              std::optional<levels::LevelIndex> effective) const {
  if (!session.found_above || !effective || session.heartbeat.floor_reason.empty()) {
    return std::nullopt;
  }
  if (*effective <= *session.found_above || *effective <= level_.level() ||
      *effective <= session.ordered_most) {
    return std::nullopt;
  }
  session.found_above.reset();
  std::string found = absl::StrCat("actuator ", name, " has lost its state and finds ",
                                   context_.config.id, " at ", levels().name(*effective));
  alerts_.Raise(engine::Severity::kCritical,
                absl::StrCat(found, ", above what this server decided: adopted; was the store ",
                             "restored from a backup?"));
  return FoundLevel{.level = *effective, .why = std::move(found)};
}

void ActuatorSide::ReportFloor(const std::string& name, Host& host) {
  const ActuatorHeartbeat& heartbeat = host.session->heartbeat;
  if (host.floor == heartbeat.floor_reason) return;
  host.floor = heartbeat.floor_reason;
  const std::string& robot = context_.config.id;
  if (heartbeat.floor_reason.empty()) {
    alerts_.Raise(engine::Severity::kInfo, absl::StrCat("actuator ", name, " no longer holds ",
                                                        robot, " at a level of its own"));
  } else if (heartbeat.effective_level == levels().name(level_.level())) {
    alerts_.Raise(
        engine::Severity::kHigh,
        absl::StrCat("actuator ", name, " has a floor of its own: ", heartbeat.floor_reason, "; ",
                     robot, " is at ", heartbeat.effective_level, " as decided"));
  } else {
    alerts_.Raise(engine::Severity::kHigh,
                  absl::StrCat("actuator ", name, " holds ", robot, " at ",
                               heartbeat.effective_level, " by itself: ", heartbeat.floor_reason));
  }
}

void ActuatorSide::ReportDegraded(const std::string& name, Host& host) {
  const std::vector<std::string>& degraded = host.session->heartbeat.degraded;
  if (degraded == host.degraded) return;
  for (const std::string& text : degraded) {
    if (Mentions(host.degraded, Subject(text))) continue;
    alerts_.Raise(engine::Severity::kHigh, absl::StrCat("actuator ", name, ": ", text));
  }
  if (degraded.empty()) {
    alerts_.Raise(engine::Severity::kInfo,
                  absl::StrCat("actuator ", name, " is no longer degraded"));
  }
  host.degraded = degraded;
}

bool ActuatorSide::Hear(const input::Receipt& in) {
  const auto it = hosts_.find(in.host);
  if (it == hosts_.end() || !it->second.session || it->second.session->id != in.session) {
    return false;
  }
  it->second.session->heard_ns = context_.now_ns();
  const LoggedReceipt* logged = receipts_.Received(in.host, in.receipt, context_.now().unix_ns);
  if (logged != nullptr) outbox_.AddReceipt(*logged);
  return true;
}

std::optional<ProgramResult> ActuatorSide::OnReceipt(const input::Receipt& in) {
  const Receipt& receipt = in.receipt;
  if (receipt.stage == Receipt::Stage::kVerified && receipt.decision_id <= level_.decision_id()) {
    DecisionId& verified = hosts_.at(in.host).verified;
    verified = std::max(verified, receipt.decision_id);
  }
  ReceiptResult result = reconciler_.OnReceipt(in.host, receipt, context_.now());
  if (result.stale_term) {
    alerts_.Raise(engine::Severity::kCritical,
                  absl::StrCat("actuator ", in.host, " refused term ", level_.term(),
                               ": another server has commanded it"));
  }
  if (result.program && !result.program->ok && !result.program->detail.empty()) {
    alerts_.Raise(engine::Severity::kLow,
                  absl::StrCat("a program failed on ", in.host, ": ", result.program->detail));
  }
  return std::move(result.program);
}

// --------------------------------------------------------------------------- what they are sent

void ActuatorSide::Order(const levels::Transition& transition, const std::string& cause) {
  if (!reconciler_.decision_id().none() && !newest_.reached) {
    outbox_.AddStage({.decision_id = reconciler_.decision_id(), .stage = "superseded"});
  }
  newest_ = {.ordered_ns = context_.now_ns(), .raises = transition.to > transition.from};
  reconciler_.Order(transition.decision_id, transition.to, levels().name(transition.to), cause,
                    transition.lowers());
  reported_stage_ = Stage::kRequested;
  for (auto& [name, host] : hosts_) {
    if (!host.session) continue;
    host.session->ordered_most = std::max(host.session->ordered_most, transition.to);
  }
  SendCommands();
}

std::string ActuatorSide::Run(const engine::RunProgramEffect& run) {
  if (!context_.moment.store_writable) return "cannot write the store";
  if (!reconciler_.Run(run.run_id, run.program, run.args, context_.now())) {
    return "no attached actuator offers it";
  }
  SendCommands();
  return "";
}

void ActuatorSide::SendCommands() {
  for (const Outgoing& outgoing : reconciler_.Due(level_.term(), context_.now())) Send(outgoing);
}

void ActuatorSide::Send(const Outgoing& outgoing) {
  const auto it = hosts_.find(outgoing.host);
  if (it == hosts_.end() || !it->second.session) return;
  receipts_.Sent(outgoing.host, outgoing.command);
  context_.Do(action::SendCommand{.session = it->second.session->id, .command = outgoing.command});
}

void ActuatorSide::SendLeases(bool evidence_complete) {
  for (const auto& [name, host] : hosts_) {
    if (host.session) SendLease(name, evidence_complete);
  }
}

void ActuatorSide::SendLease(const std::string& host, bool evidence_complete) {
  const Session& session = *hosts_.at(host).session;
  const int64_t ttl_ns =
      context_.draining ? context_.timing.drain_lease_ns : context_.timing.lease_ns;
  // A lowering that is not durable yet is not announced.
  const bool held_back = !outbox_.held_back().none();
  context_.Do(action::GrantLease{
      .session = session.id,
      .lease = {
          .echo_boottime_ns = session.peer_boottime_ns,
          .term = level_.term(),
          .decision_id = held_back ? reconciler_.decision_id() : level_.decision_id(),
          .level = held_back ? reconciler_.level_name() : levels().name(level_.level()),
          .ttl_ms = static_cast<uint32_t>(ttl_ns / kNanosPerMilli),
          .heartbeat_ms = static_cast<uint32_t>(context_.timing.heartbeat_ns / kNanosPerMilli),
          .evidence_complete = evidence_complete}});
}

void ActuatorSide::ReportMissingPrograms() {
  const std::vector<std::string> missing =
      reconciler_.NotOffered(context_.policy.program->rules().programs);
  std::string text;
  if (!missing.empty()) {
    text = absl::StrCat("rules run programs that no actuator offers, so they will fail: `",
                        absl::StrJoin(missing, "`, `"), "`");
  }
  if (text == missing_programs_) return;
  missing_programs_ = text;
  if (!text.empty()) alerts_.Raise(engine::Severity::kHigh, text);
}

// --------------------------------------------------------------------------- what is known

Stage ActuatorSide::stage() const {
  const Stage stage = reconciler_.stage();
  return stage == Stage::kVerified && !witness_.contradiction().empty() ? Stage::kContradicted
                                                                        : stage;
}

void ActuatorSide::UpdateWitness() {
  if (reconciler_.stage() != Stage::kVerified) return witness_.End();
  absl::InlinedVector<LevelWitness::Holder, 2> holders;
  for (const auto& [name, host] : hosts_) {
    // Until the next heartbeat it may say where it was before.
    absl::string_view held = reconciler_.level_name();
    if (host.session) {
      const std::string& effective = host.session->heartbeat.effective_level;
      if (levels().Find(effective).value_or(0) > reconciler_.level()) held = effective;
    }
    holders.push_back({.host = name, .level = held});
  }
  witness_.Update(reconciler_.decision_id(), reconciler_.level_name(), holders, context_.now_ns());
}

void ActuatorSide::ReportStage(Stage before, Stage stage) {
  newest_.reached |= stage == Stage::kVerified;
  // That an actuator is away does not undo that the level was reached.
  if (!newest_.reached || stage == Stage::kVerified || stage == Stage::kFailed ||
      stage == Stage::kContradicted) {
    outbox_.AddStage({.decision_id = reconciler_.decision_id(),
                      .stage = std::string(ToString(stage)),
                      .detail = stage == Stage::kContradicted ? witness_.contradiction()
                                                              : reconciler_.failure()});
  }
  const std::string level = absl::StrCat("level ", reconciler_.level_name());
  if (stage == Stage::kVerified && newest_.failure_reported &&
      !std::exchange(newest_.recovery_reported, true)) {
    alerts_.Raise(engine::Severity::kInfo, absl::StrCat(level, " is reached now, and verified"));
  } else if (stage == Stage::kVerified && before == Stage::kContradicted) {
    alerts_.Raise(engine::Severity::kInfo,
                  absl::StrCat(level, " is verified again: nothing contradicts it any more"));
  }
  if (stage == Stage::kContradicted) {
    alerts_.Raise(
        engine::Severity::kCritical,
        absl::StrCat(level, " was verified, and is contradicted: ", witness_.contradiction(),
                     "; the part goes on and what its services answer is forged, or "
                     "something uses its name: do not rely on the level"));
  }
  if (stage == Stage::kFailed && !std::exchange(newest_.failure_reported, true)) {
    alerts_.Raise(engine::Severity::kCritical,
                  absl::StrCat(level, " was not reached: ", reconciler_.failure(),
                               "; the decision stands and is tried again"));
    context_.events.push_back(engine::AgentEvent{.agent = "actuator", .state = "failed"});
  }
}

engine::Actuation ActuatorSide::UpdateStage() {
  UpdateWitness();
  const Stage stage = this->stage();
  if (stage != reported_stage_) ReportStage(std::exchange(reported_stage_, stage), stage);
  const bool leased = std::any_of(hosts_.begin(), hosts_.end(),
                                  [&](const auto& host) { return Live(host.second); });
  if (!leased) return engine::Actuation::kNoLease;
  if (reconciler_.decision_id() != level_.decision_id()) return engine::Actuation::kPending;
  if (stage == Stage::kVerified) return engine::Actuation::kVerified;
  return stage == Stage::kFailed || stage == Stage::kContradicted ? engine::Actuation::kFailed
                                                                  : engine::Actuation::kPending;
}

bool ActuatorSide::verified() const {
  return hosts_.empty() ||
         (stage() == Stage::kVerified && reconciler_.decision_id() == level_.decision_id());
}

std::vector<std::string> ActuatorSide::attached() const {
  std::vector<std::string> names;
  for (const auto& [name, host] : hosts_) {
    if (host.session) names.push_back(name);
  }
  return names;
}

std::vector<std::string> ActuatorSide::lost() const {
  std::vector<std::string> names;
  for (const auto& [name, host] : hosts_) {
    if (host.lost) names.push_back(name);
  }
  return names;
}

bool ActuatorSide::PartsVerified() const {
  return std::any_of(hosts_.begin(), hosts_.end(), [&](const auto& entry) {
    const auto& [name, host] = entry;
    return Live(host) && own_agents_.HasParts(Named(name)) && host.session->heartbeat.verified;
  });
}

void ActuatorSide::AddProblems(std::vector<std::string>& problems) const {
  for (const auto& [name, host] : hosts_) {
    if (!Live(host)) {
      problems.push_back(absl::StrCat("actuator ", name, " holds no live lease"));
    } else if (std::string doubt = own_agents_.DoubtOf(Named(name)); !doubt.empty()) {
      problems.push_back(std::move(doubt));
    }
  }
  if (stage() == Stage::kContradicted) {
    problems.push_back(absl::StrCat("level ", reconciler_.level_name(),
                                    " is contradicted: ", witness_.contradiction()));
  }
}

void ActuatorSide::AddStatus(RobotStatus& status) const {
  // A lowering that is not durable yet is no command yet.
  const bool ordered = reconciler_.decision_id() == level_.decision_id();
  status.stage = std::string(ToString(ordered ? stage() : Stage::kRequested));
  levels::LevelIndex effective = -1;
  for (const auto& [name, host] : hosts_) {
    if (!host.session) continue;
    const ActuatorHeartbeat& heartbeat = host.session->heartbeat;
    if (const auto level = levels().Find(heartbeat.effective_level)) {
      effective = std::max(effective, *level);
    }
    if (!heartbeat.floor_reason.empty()) {
      status.degraded.push_back(
          absl::StrCat("actuator ", name, " holds a floor: ", heartbeat.floor_reason));
    }
    for (const std::string& text : heartbeat.degraded) {
      status.degraded.push_back(absl::StrCat("actuator ", name, ": ", text));
    }
  }
  status.effective_level = levels().name(effective);
  if (!missing_programs_.empty()) status.degraded.push_back(missing_programs_);
}

std::map<std::string, model::FirewallDrops> ActuatorSide::FirewallDrops() const {
  std::map<std::string, model::FirewallDrops> drops;
  for (const auto& [name, host] : hosts_) {
    if (!host.session || !host.session->heartbeat.firewall_drops.has_value()) continue;
    drops[name] = *host.session->heartbeat.firewall_drops;
  }
  return drops;
}

}  // namespace rips::pipeline

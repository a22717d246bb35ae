#include "policy_server/server/robot/performer.h"

#include <algorithm>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"

namespace rips::pipeline {

Performer::Performer(std::string robot, Ports ports, std::function<void(Input)> deliver)
    : robot_(std::move(robot)),
      ports_(std::move(ports)),
      deliver_(std::move(deliver)),
      flight_(ports_.flight_recorder ? ports_.flight_recorder(robot_) : nullptr) {}

void Performer::Perform(const Actions& actions) {
  for (const Action& each : actions) {
    std::visit([this](const auto& what) { Do(what); }, each);
  }
}

// ------------------------------------------------------------------------------------ sessions

SessionId Performer::Open(std::shared_ptr<SensorLink> link) {
  sessions_.push_back({.id = ++last_session_, .sensor = std::move(link), .actuator = nullptr});
  return last_session_;
}

SessionId Performer::Open(std::shared_ptr<ActuatorLink> link) {
  sessions_.push_back({.id = ++last_session_, .sensor = nullptr, .actuator = std::move(link)});
  return last_session_;
}

SessionId Performer::Find(const void* link) const {
  if (link == nullptr) return 0;
  for (const Session& session : sessions_) {
    if (session.sensor.get() == link || session.actuator.get() == link) return session.id;
  }
  return 0;
}

void Performer::Forget(SessionId session) {
  std::erase_if(sessions_, [&](const Session& each) { return each.id == session; });
}

SensorLink* Performer::SensorOf(SessionId session) const {
  for (const Session& each : sessions_) {
    if (each.id == session) return each.sensor.get();
  }
  return nullptr;
}

ActuatorLink* Performer::ActuatorOf(SessionId session) const {
  for (const Session& each : sessions_) {
    if (each.id == session) return each.actuator.get();
  }
  return nullptr;
}

ReplyToken Performer::Await(LevelReply reply) {
  orders_.emplace(++last_token_, std::move(reply));
  return last_token_;
}

ReplyToken Performer::Await(DrillReply reply) {
  drills_.emplace(++last_token_, std::move(reply));
  return last_token_;
}

absl::Status Performer::AddRecorder(std::shared_ptr<EventRecorder> recorder, size_t max) {
  if (recorders_.size() >= max) {
    return absl::ResourceExhaustedError(
        absl::StrCat(max, " recordings of `", robot_, "` run already, the limit"));
  }
  recorders_.push_back(std::move(recorder));
  return absl::OkStatus();
}

// -------------------------------------------------------------------------------------- agents

void Performer::Do(const action::Setup& what) {
  if (SensorLink* link = SensorOf(what.session)) link->Setup(what.setup);
}

void Performer::Do(const action::Acknowledge& what) {
  if (SensorLink* link = SensorOf(what.session)) {
    link->Acknowledge(what.incarnation, what.lane, what.sequence, what.commit);
  }
}

void Performer::Do(const action::GrantCredit& what) {
  if (SensorLink* link = SensorOf(what.session)) {
    link->Grant(what.message_bytes, what.payload_bytes);
  }
}

void Performer::Do(const action::EchoHeartbeat& what) {
  if (SensorLink* link = SensorOf(what.session)) link->Heartbeat(what.echo_boottime_ns);
}

void Performer::Do(const action::SetInterest& what) {
  SensorLink* link = SensorOf(what.session);
  if (link == nullptr) return;
  answers_.push_back(
      input::InterestSent{.host = what.host,
                          .session = what.session,
                          .id = link->SetInterest(*what.plan, what.limits, *what.kept_topics)});
}

void Performer::Do(const action::GrantLease& what) {
  if (ActuatorLink* link = ActuatorOf(what.session)) link->Grant(what.lease);
}

void Performer::Do(const action::SendCommand& what) {
  if (ActuatorLink* link = ActuatorOf(what.session)) link->Send(what.command);
}

void Performer::Do(const action::Close& what) {
  if (SensorLink* link = SensorOf(what.session)) link->Close(what.status);
  if (ActuatorLink* link = ActuatorOf(what.session)) link->Close(what.status);
  Forget(what.session);
}

// ----------------------------------------------------------------------------------- the store

// What is posted is dropped if the robot has gone by then.
void Performer::Do(const action::Record& what) {
  ports_.recorder->Record(*what.batch, [this, batch = what.batch, audience = ports_.audience,
                                        post = ports_.post](const absl::Status& status) {
    if (status.ok()) {
      for (const store::AlertRecord& alert : batch->alerts) audience->OnAlert(alert);
    }
    post([this, status] {
      deliver_(input::Recorded{.status = status, .store = ports_.recorder->point()});
    });
  });
}

void Performer::Do(const action::SaveRaises& what) {
  input::RaisesSaved saved;
  for (const store::DecisionRecord& raise : what.raises.decisions) {
    saved.decisions.push_back(raise.decision_id);
  }
  ports_.recorder->Record(what.raises,
                          [this, saved, post = ports_.post](const absl::Status& status) {
                            if (status.ok()) post([this, saved] { deliver_(saved); });
                          });
}

void Performer::Do(const action::FindDecision& what) {
  ports_.recorder->FindDecision(
      robot_, what.decision_id,
      [this, question = what.question, post = ports_.post](const FoundDecision& found) {
        post([=, this] { deliver_(input::DecisionFound{.question = question, .level = found}); });
      });
}

void Performer::Do(const action::DrawTerm& what) {
  ports_.recorder->NextTerm(
      robot_, what.tenure, what.above,
      [this, question = what.question, post = ports_.post](const absl::StatusOr<uint64_t>& term) {
        post([=, this] { deliver_(input::TermDrawn{.question = question, .term = term}); });
      });
}

// -------------------------------------------------------------------------------------- others

void Performer::Do(const action::Inspect& what) {
  what.inspector->Inspect(
      robot_, what.inspections, what.message,
      [this, post = ports_.post_work, ticket = what.ticket, index = what.index,
       asked = what.inspections](std::vector<engine::Verdict> verdicts) {
        post([this, ticket, index, asked, verdicts = std::move(verdicts)] {
          deliver_(input::Inspected{
              .ticket = ticket, .index = index, .asked = asked, .verdicts = verdicts});
        });
      });
}

void Performer::Do(const action::AnswerOrder& what) {
  if (auto reply = orders_.extract(what.token); !reply.empty()) reply.mapped()(what.answer);
}

void Performer::Do(const action::AnswerDrill& what) {
  if (auto reply = drills_.extract(what.token); !reply.empty()) reply.mapped()(what.answer);
}

void Performer::Do(const action::PublishStatus& what) {
  ports_.audience->OnStatus(what.status);
  if (ports_.on_status) ports_.on_status(what.status);
}

void Performer::Do(const action::ReportRetired& what) {
  recorders_.clear();
  if (shadow_ != nullptr) std::exchange(shadow_, nullptr)->OnRetired();
  if (absl::IsAborted(what.why) && ports_.fenced) ports_.fenced(robot_, what.why);
}

void Performer::Do(const action::LogRule& what) {
  ports_.audience->OnRuleLog(robot_, what.rule, what.text);
}

void Performer::KeepShadow(bool wants_more) {
  if (wants_more) return;
  shadow_.reset();
  answers_.push_back(input::WatchAlso{});
}

void Performer::Do(const action::RecordEvent& what) {
  if (shadow_ != nullptr) KeepShadow(shadow_->OnEvent(what.event));
  if (what.event.muted) return;
  if (flight_ != nullptr) flight_->OnEvent(what.event);
  std::erase_if(recorders_, [&](const std::shared_ptr<EventRecorder>& recorder) {
    return !recorder->OnEvent(what.event);
  });
}

void Performer::Do(const action::RecordLevel& what) {
  if (shadow_ != nullptr) KeepShadow(shadow_->OnLevel(what.level));
  if (flight_ != nullptr) flight_->OnLevel(what.level);
  std::erase_if(recorders_, [&](const std::shared_ptr<EventRecorder>& recorder) {
    return !recorder->OnLevel(what.level);
  });
}

void Performer::Do(const action::RecordOutcome& what) {
  if (shadow_ != nullptr) KeepShadow(shadow_->OnOutcome(what.outcome));
}

void Performer::Do(const action::KeepRecording& what) {
  if (flight_ != nullptr) flight_->Keep(what.alert);
}

// ------------------------------------------------------------------------------------- metrics

void Performer::Do(const action::Count& what) {
  const Counts& counts = ports_.counts;
  const std::function<void(uint64_t)>* counter = nullptr;
  switch (what.counter) {
    case Counter::kObservationsJudged:
      counter = &counts.observations_judged;
      break;
    case Counter::kObservationsLost:
      counter = &counts.observations_lost;
      break;
    case Counter::kObservationsDuplicate:
      counter = &counts.observations_duplicate;
      break;
    case Counter::kMessagesUnattributed:
      counter = &counts.messages_unattributed;
      break;
    case Counter::kGraphsMerged:
      counter = &counts.graphs_merged;
      break;
    case Counter::kSessionsRefused:
      counter = &counts.sessions_refused;
      break;
    case Counter::kPayloadsCut:
      counter = &counts.payloads_cut;
      break;
    case Counter::kAlerts:
      counter = &counts.alerts;
      break;
    case Counter::kAlertsLost:
      counter = &counts.alerts_lost;
      break;
  }
  if (counter != nullptr && *counter) (*counter)(what.by);
}

void Performer::Do(const action::CountEndpoints& what) {
  if (ports_.counts.endpoints) ports_.counts.endpoints(robot_, what.counts);
}

void Performer::Do(const action::CountBlind& what) {
  if (ports_.counts.blind) ports_.counts.blind(robot_, what.reasons);
}

void Performer::Do(const action::CountLeftOut& what) {
  if (ports_.counts.graph_left_out) {
    ports_.counts.graph_left_out(robot_, what.left_out, what.began);
  }
}

void Performer::Do(const action::ShowClockSkew& what) {
  if (ports_.counts.clock_skew) ports_.counts.clock_skew(robot_, what.host, what.skew_ns);
}

void Performer::Do(const action::CountSkipped& what) {
  if (ports_.counts.inspections_skipped) {
    ports_.counts.inspections_skipped(what.reason, what.inspections);
  }
}

}  // namespace rips::pipeline

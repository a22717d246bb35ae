// Performs what the core of a robot wants done, through its ports. Decides nothing.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_PERFORMER_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_PERFORMER_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/status/status.h"
#include "policy_server/server/robot/context/action.h"
#include "policy_server/server/robot/context/input.h"
#include "policy_server/server/robot/links.h"
#include "policy_server/server/robot/ports.h"

namespace rips::pipeline {

// One per robot, on its thread.
class Performer {
 public:
  // `deliver` takes what ports answer, later, on the robot's thread.
  Performer(std::string robot, Ports ports, std::function<void(Input)> deliver);

  void Perform(const Actions& actions);
  // What the actions have been answered at once; to be judged next.
  std::vector<Input> PopAnswers() { return std::exchange(answers_, {}); }

  // Sessions: a link has a number until it is closed here or forgotten. 0 = it has none.
  SessionId Open(std::shared_ptr<SensorLink> link);
  SessionId Open(std::shared_ptr<ActuatorLink> link);
  SessionId Find(const void* link) const;
  void Forget(SessionId session);
  // Orders: called once.
  ReplyToken Await(LevelReply reply);
  ReplyToken Await(DrillReply reply);
  // Recordings, until the robot retires: as Robot::AddTap.
  absl::Status AddRecorder(std::shared_ptr<EventRecorder> recorder, size_t max);
  // Null = none any more.
  void SetShadow(std::shared_ptr<ShadowRecorder> shadow) { shadow_ = std::move(shadow); }
  bool recorded() const { return !recorders_.empty() || flight_ != nullptr || shadow_ != nullptr; }
  // Null if there is none.
  FlightRecorder* flight() const { return flight_.get(); }

  const Ports& ports() const { return ports_; }

 private:
  struct Session {
    SessionId id = 0;
    // One of both.
    std::shared_ptr<SensorLink> sensor;
    std::shared_ptr<ActuatorLink> actuator;
  };
  SensorLink* SensorOf(SessionId session) const;
  ActuatorLink* ActuatorOf(SessionId session) const;

  void Do(const action::Setup& what);
  void Do(const action::Acknowledge& what);
  void Do(const action::GrantCredit& what);
  void Do(const action::EchoHeartbeat& what);
  void Do(const action::SetInterest& what);
  void Do(const action::GrantLease& what);
  void Do(const action::SendCommand& what);
  void Do(const action::Close& what);
  void Do(const action::Record& what);
  void Do(const action::SaveRaises& what);
  void Do(const action::FindDecision& what);
  void Do(const action::DrawTerm& what);
  void Do(const action::Inspect& what);
  void Do(const action::AnswerOrder& what);
  void Do(const action::AnswerDrill& what);
  void Do(const action::PublishStatus& what);
  void Do(const action::ReportRetired& what);
  void Do(const action::LogRule& what);
  void Do(const action::RecordEvent& what);
  void Do(const action::RecordLevel& what);
  void Do(const action::RecordOutcome& what);
  void Do(const action::KeepRecording& what);
  void Do(const action::Count& what);
  void Do(const action::CountEndpoints& what);
  void Do(const action::CountBlind& what);
  void Do(const action::CountLeftOut& what);
  void Do(const action::ShowClockSkew& what);
  void Do(const action::CountSkipped& what);

  // Ends the shadow if it wants no more.
  void KeepShadow(bool wants_more);

  const std::string robot_;
  const Ports ports_;
  const std::function<void(Input)> deliver_;
  std::vector<Session> sessions_;
  SessionId last_session_ = 0;
  ReplyToken last_token_ = 0;
  absl::flat_hash_map<ReplyToken, LevelReply> orders_;
  absl::flat_hash_map<ReplyToken, DrillReply> drills_;
  std::vector<std::shared_ptr<EventRecorder>> recorders_;
  const std::unique_ptr<FlightRecorder> flight_;
  std::shared_ptr<ShadowRecorder> shadow_;
  std::vector<Input> answers_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_PERFORMER_H_

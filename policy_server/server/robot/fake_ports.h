// The outside of a robot, for tests: those who watch, its agents, and whoever inspects messages.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_FAKE_PORTS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_FAKE_PORTS_H_

#include <deque>
#include <functional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/links.h"
#include "policy_server/server/robot/ports.h"

namespace rips::pipeline {

class FakeObserver final : public RobotObserver {
 public:
  void OnAlert(const store::AlertRecord& alert) override { alerts.push_back(alert); }
  void OnNotice(const std::string&) override {}
  void OnStatus(const RobotStatus& status) override { statuses.push_back(status); }
  void OnRuleLog(const std::string&, const std::string& rule, const std::string& text) override {
    rule_logs.push_back(absl::StrCat(rule, ": ", text));
  }
  int Count(absl::string_view part) const {
    int count = 0;
    for (const auto& alert : alerts) count += absl::StrContains(alert.text, part) ? 1 : 0;
    return count;
  }
  std::vector<store::AlertRecord> alerts;
  std::vector<RobotStatus> statuses;
  std::vector<std::string> rule_logs;
};

// Any thread.
class SilentObserver final : public RobotObserver {
 public:
  void OnAlert(const store::AlertRecord&) override {}
  void OnNotice(const std::string&) override {}
  void OnStatus(const RobotStatus&) override {}
  void OnRuleLog(const std::string&, const std::string&, const std::string&) override {}
};

struct FakeSensor final : SensorLink {
  void Setup(const SensorSetup& s) override { setup = s; }
  void Acknowledge(const std::string&, Lane lane, uint64_t sequence, uint64_t commit) override {
    acknowledged[static_cast<int>(lane)] = sequence;
    acknowledged_commit = commit;
  }
  void Grant(uint64_t message_bytes, uint64_t payload_bytes) override {
    granted = message_bytes;
    payload_granted = payload_bytes;
  }
  void Heartbeat(int64_t echo) override { echoed = echo; }
  std::string SetInterest(const engine::InterestPlan& plan, const engine::PayloadLimits& limits,
                          const ros2::TopicNames& kept) override {
    if (plan != interest || limits != payload_limits || kept != kept_topics) ++interests;
    interest = plan;
    kept_topics = kept;
    payload_limits = limits;
    return interest_id();
  }
  std::string interest_id() const { return absl::StrCat("interest ", interests); }
  void Close(const absl::Status& status) override { closed = status; }
  SensorSetup setup;
  engine::InterestPlan interest;
  engine::PayloadLimits payload_limits;
  ros2::TopicNames kept_topics;
  int interests = 0;
  uint64_t acknowledged[kLaneCount] = {0, 0};
  uint64_t acknowledged_commit = 0;
  uint64_t granted = 0;
  uint64_t payload_granted = 0;
  int64_t echoed = 0;
  absl::Status closed;
};

struct FakeActuator final : ActuatorLink {
  void Grant(const LeaseGrant& lease) override { leases.push_back(lease); }
  void Send(const pipeline::Command& command) override { commands.push_back(command); }
  void Close(const absl::Status& status) override { closed = status; }
  // The newest level command.
  const SetLevel* level() const {
    for (auto it = commands.rbegin(); it != commands.rend(); ++it) {
      if (const auto* set = std::get_if<SetLevel>(&it->what)) return set;
    }
    return nullptr;
  }
  std::vector<LeaseGrant> leases;
  std::vector<pipeline::Command> commands;
  absl::Status closed;
};

// Keeps questions until the test answers.
class FakeInspector final : public Inspector {
 public:
  struct Question {
    std::vector<uint32_t> inspections;
    std::string topic;
    std::string sender;
    std::string payload;
    std::function<void(std::vector<engine::Verdict>)> done;
  };
  void Inspect(const std::string&, const std::vector<uint32_t>& inspections,
               const InspectedMessage& message,
               std::function<void(std::vector<engine::Verdict>)> done) override {
    ++asked;
    questions.push_back({.inspections = inspections,
                         .topic = std::string(message.topic),
                         .sender = std::string(message.sender),
                         .payload = std::string(message.payload),
                         .done = std::move(done)});
  }
  // Answers the oldest.
  void Answer(engine::Verdict verdict) {
    const Question question = std::move(questions.front());
    questions.pop_front();
    question.done(std::vector<engine::Verdict>(question.inspections.size(), verdict));
  }
  std::deque<Question> questions;
  size_t asked = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_FAKE_PORTS_H_

#include "policy_server/server/robot/actuators/drills.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace rips::pipeline {

absl::Status Drills::Check(const DrillOrder& order) const {
  const levels::LevelTable& levels = level_.table();
  const std::string& robot = context_.config.id;
  if (!order.level.empty() && !levels.Find(order.level)) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", absl::CHexEscape(order.level.substr(0, 100)), "` is not a level of ",
                     robot, " (", absl::StrJoin(levels.names(), ", "), ")"));
  }
  if (context_.draining) return absl::UnavailableError("the server is stopping");
  if (running_) {
    return absl::FailedPreconditionError(
        absl::StrCat("a drill of ", robot, " by ", running_->order.operator_name,
                     " is under way; it is over within ", kDrillAnswerNs / kNanosPerSecond, " s"));
  }
  if (actuators_.attached().empty()) {
    return absl::FailedPreconditionError(absl::StrCat("no actuator of ", robot, " is attached"));
  }
  return absl::OkStatus();
}

void Drills::Start(const input::StartDrill& in) {
  if (absl::Status status = Check(in.order); !status.ok()) {
    return context_.Do(action::AnswerDrill{in.token, {.status = std::move(status), .drills = {}}});
  }
  const std::vector<std::string> attached = actuators_.attached();
  std::vector<DrillRun::Host> hosts;
  for (const std::string& name : context_.config.actuator_hosts) {
    hosts.push_back(
        {.name = name,
         .attached = std::find(attached.begin(), attached.end(), name) != attached.end()});
  }
  std::sort(hosts.begin(), hosts.end(),
            [](const auto& a, const auto& b) { return a.name < b.name; });
  const std::vector<std::string> wanted =
      in.order.level.empty() ? level_.table().names() : std::vector<std::string>{in.order.level};
  alerts_.Raise(engine::Severity::kInfo, absl::StrCat("drill by ", in.order.operator_name,
                                                      " begins: ", absl::StrJoin(wanted, ", ")));
  running_.emplace(Running{.order = in.order,
                           .token = in.token,
                           .run = DrillRun(wanted, hosts, context_.ids, context_.now())});
  Advance();
}

void Drills::Advance() {
  if (!running_) return;
  for (const Outgoing& outgoing : running_->run.Due(level_.term(), context_.now())) {
    actuators_.Send(outgoing);
  }
  if (context_.draining || running_->run.Over(context_.now())) End();
}

bool Drills::OnReceipt(const std::string& host, const Receipt& receipt) {
  if (!running_ || !running_->run.OnReceipt(host, receipt)) return false;
  Advance();
  return true;
}

void Drills::OnGone(const std::string& host) {
  if (running_) running_->run.OnGone(host);
}

void Drills::Refuse(const absl::Status& why) {
  if (!running_) return;
  context_.Do(action::AnswerDrill{running_->token, {.status = why, .drills = {}}});
  running_.reset();
}

void Drills::End() {
  Running ended = *std::exchange(running_, std::nullopt);
  DrillAnswer answer;
  answer.drills = ended.run.PopEntries();
  if (context_.draining) answer.status = absl::UnavailableError("the server is stopping");
  alerts_.Raise(
      AllWork(answer.drills) ? engine::Severity::kInfo : engine::Severity::kMedium,
      absl::StrCat("drill by ", ended.order.operator_name, " is over: ", Summary(answer.drills)));
  context_.Do(action::AnswerDrill{ended.token, std::move(answer)});
}

}  // namespace rips::pipeline

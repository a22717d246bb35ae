#include "policy_server/server/rollout/rollout.h"

#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "services/base/check.h"

namespace rips::rollout {
namespace {

constexpr int64_t kElapsedNsMax = 5 * kNanosPerSecond;

// By the table that is in force now: the bundle may have brought another one.
bool HasRisen(const std::string& before, const RobotHealth& is) {
  if (before.empty()) return false;
  const auto rank = [&is](const std::string& level) {
    const auto found = std::find(is.levels.begin(), is.levels.end(), level);
    return found == is.levels.end() ? 0 : found - is.levels.begin();
  };
  return rank(is.level) > rank(before);
}

}  // namespace

absl::string_view ToString(RolloutState state) {
  switch (state) {
    case RolloutState::kRunning:
      return "running";
    case RolloutState::kDone:
      return "done";
    case RolloutState::kStopped:
      return "stopped";
  }
  return "";
}

std::string Normalized(absl::string_view degraded) {
  std::string out(degraded);
  std::erase_if(out, [](char each) { return absl::ascii_isdigit(each); });
  return out;
}

Rollout::Rollout(RolloutRecord record, Instant now, bool restarted)
    : record_(std::move(record)),
      patient_until_ns_(now.boottime_ns + (restarted ? kRestartGraceNs : 0)),
      looked_ns_(now.boottime_ns) {
  RIPS_CHECK(record_.stage < record_.plan.stages.size(), "a roll-out has stages");
}

RolloutStep Rollout::Begin(const FleetHealth& health, Instant now) {
  record_.began_unix_ns = now.unix_ns;
  return BeginStage(health, now);
}

RolloutStep Rollout::BeginStage(const FleetHealth& health, Instant now) {
  healthy_since_.reset();
  RolloutStep step{.activate = record_.plan.stages[record_.stage]};
  for (const std::string& robot : step.activate) {
    Baseline& before = record_.before[robot];
    // Of one that does not answer nothing is known; it has to come back as healthy as any.
    const auto found = health.find(robot);
    if (found == health.end()) continue;
    for (const std::string& each : found->second.degraded) before.degraded.insert(Normalized(each));
    before.level = found->second.level;
    before.bundle_id = found->second.bundle_id;
  }
  bad_ns_.clear();
  patient_until_ns_ = std::max(patient_until_ns_, now.boottime_ns);
  return step;
}

std::string Rollout::Bad(const std::string& robot, std::string what, int64_t patience_ns,
                         Instant now) {
  if (not_healthy_because_.empty()) not_healthy_because_ = absl::StrCat(robot, ": ", what);
  if (now.boottime_ns < patient_until_ns_) return "";
  int64_t& bad_ns = bad_ns_[robot][patience_ns];
  bad_ns += elapsed_ns_;
  return bad_ns > patience_ns ? what : "";
}

void Rollout::Forgive(const std::string& robot) {
  const auto found = bad_ns_.find(robot);
  if (found == bad_ns_.end()) return;
  for (auto& [patience_ns, bad_ns] : found->second) {
    bad_ns = std::max<int64_t>(0, bad_ns - elapsed_ns_ / 4);
  }
}

std::string Rollout::Harm(const std::string& robot, const FleetHealth& health, Instant now) {
  const auto found = health.find(robot);
  if (found == health.end()) return Bad(robot, "it does not answer", kTakeNs, now);
  const RobotHealth& is = found->second;
  if (is.gone) return "";
  const Baseline& before = record_.before[robot];
  if (HasRisen(before.level, is)) {
    return absl::StrCat("its level rose to ", is.level, " (`ripsctl explain ", robot, "`)");
  }
  const bool patient = now.boottime_ns < patient_until_ns_;
  if (!patient && is.alerts > record_.plan.alerts_per_minute_max) {
    return absl::StrCat("its rules raised ", is.alerts, " alerts within a minute, more than ",
                        record_.plan.alerts_per_minute_max);
  }
  if (is.bundle_id != record_.plan.bundle_id) {
    return Bad(robot,
               absl::StrCat("it has not taken the bundle",
                            is.problem.empty() ? "" : absl::StrCat(": ", is.problem)),
               kTakeNs, now);
  }
  for (const std::string& each : is.degraded) {
    if (before.degraded.contains(Normalized(each))) continue;
    return Bad(robot, absl::StrCat("it is degraded: ", each), kGraceNs, now);
  }
  Forgive(robot);
  return "";
}

RolloutStep Rollout::Look(const FleetHealth& health, Instant now) {
  if (!running()) return {};
  // A machine that slept has not seen its robots meanwhile.
  elapsed_ns_ = std::clamp<int64_t>(now.boottime_ns - looked_ns_, 0, kElapsedNsMax);
  looked_ns_ = now.boottime_ns;
  not_healthy_because_.clear();
  if (now.boottime_ns < patient_until_ns_) {
    not_healthy_because_ = "the server has just started, and sensors have a minute to come back";
  }
  for (const std::string& robot : Begun()) {
    const std::string harm = Harm(robot, health, now);
    if (!harm.empty()) return StopByItself(absl::StrCat(robot, ": ", harm), now);
  }
  if (not_healthy_because_.empty() && !Watches(health)) {
    not_healthy_because_ = "no sensor of a robot of this stage is connected, so it proves nothing";
  }
  if (!not_healthy_because_.empty()) {
    healthy_since_.reset();
    return {};
  }
  if (!healthy_since_) healthy_since_ = now;
  if (now.boottime_ns - healthy_since_->boottime_ns < record_.plan.soak_ns) return {};
  if (record_.stage + 1 < record_.plan.stages.size()) {
    ++record_.stage;
    return BeginStage(health, now);
  }
  record_.state = RolloutState::kDone;
  record_.ended_unix_ns = now.unix_ns;
  return {.over = true};
}

bool Rollout::Watches(const FleetHealth& health) const {
  bool all_gone = true;
  for (const std::string& robot : record_.plan.stages[record_.stage]) {
    const auto found = health.find(robot);
    if (found == health.end()) continue;
    if (found->second.watched) return true;
    all_gone &= found->second.gone;
  }
  return all_gone;
}

RolloutStep Rollout::StopByItself(const std::string& why, Instant now) {
  RolloutStep step = Stop(why, now);
  step.by_itself = true;
  if (record_.plan.roll_back_when_stopped) step.roll_back = Begun();
  return step;
}

RolloutStep Rollout::Stop(absl::string_view why, Instant now) {
  if (!running()) return {};
  record_.state = RolloutState::kStopped;
  record_.why = std::string(why);
  record_.ended_unix_ns = now.unix_ns;
  healthy_since_.reset();
  not_healthy_because_.clear();
  return {.over = true};
}

std::optional<int64_t> Rollout::healthy_since_unix_ns() const {
  if (!running() || !healthy_since_) return std::nullopt;
  return healthy_since_->unix_ns;
}

std::vector<std::string> Rollout::Begun() const {
  std::vector<std::string> robots;
  for (size_t i = 0; i <= record_.stage; ++i) {
    const std::vector<std::string>& stage = record_.plan.stages[i];
    robots.insert(robots.end(), stage.begin(), stage.end());
  }
  return robots;
}

}  // namespace rips::rollout

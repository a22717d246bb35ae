#include "policy_server/server/rollout/bundle_control.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/robot/model/robot_config.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::rollout {
namespace {

using pipeline::Robot;
using pipeline::RobotStatus;

// `sha256:` and the digits that tell bundles apart.
constexpr size_t kIdShown = 15;
constexpr size_t kRobotsNamed = 8;

std::string Named(const std::vector<std::string>& robots) {
  if (robots.size() <= kRobotsNamed) return absl::StrJoin(robots, ", ");
  return absl::StrCat(absl::StrJoin(robots.begin(), robots.begin() + kRobotsNamed, ", "), " and ",
                      robots.size() - kRobotsNamed, " more");
}

std::string Described(const RolloutPlan& plan) {
  return absl::StrCat("roll-out of `", plan.name, "` ", plan.bundle_id.substr(0, kIdShown), " by ",
                      plan.operator_name);
}

RobotHealth HealthOf(const RobotStatus& status, std::vector<std::string> levels) {
  return {.bundle_id = status.bundle_version,
          .degraded = status.degraded,
          .problem = status.policy_problem,
          .watched = status.watched,
          .level = status.decided_level,
          .levels = std::move(levels)};
}

}  // namespace

BundleControl::BundleControl(Parts parts)
    : parts_(std::move(parts)),
      shadows_(parts_.activations, parts_.library, parts_.shadows, parts_.pipeline,
               parts_.load_shadow),
      thread_(parts_.clock),
      pushes_(parts_.clock) {
  if (const std::optional<RolloutRecord>& record = parts_.activations->now().rollout; record) {
    rollout_.emplace(*record, parts_.clock->Now(), /*restarted=*/true);
  }
  if (rollout_ && rollout_->running()) {
    const RolloutRecord& record = rollout_->record();
    for (const auto& [robot, before] : record.before) parts_.rates->Watch(robot);
    LogInfo("a roll-out goes on", {{"bundle", record.plan.bundle_id},
                                   {"stage", static_cast<uint64_t>(record.stage + 1)}});
  }
  shadows_.Restore();
  Publish();
}

void BundleControl::Start() {
  thread_.Start([this] { Look(); });
  pushes_.Start([] {});
}

void BundleControl::Stop() {
  pushes_.Stop();
  thread_.Stop();
}

bool BundleControl::Reload(std::function<void()> before) {
  return thread_.Await([this, before = std::move(before)] {
    before();
    parts_.fleet->Reload();
    Publish();
  });
}

// --------------------------------------------------------------------------------------- orders

absl::StatusOr<BundleLibrary::Added> BundleControl::Push(absl::string_view archive) {
  absl::StatusOr<BundleLibrary::Added> added = parts_.library->Add(archive);
  if (added.ok()) {
    thread_.Post([this] { parts_.fleet->ForgetUnused(); });
  }
  return added;
}

absl::StatusOr<BundleControl::Chosen> BundleControl::Choose(const ActivateOrder& order) {
  if (order.bundle != kDirectory) {
    RIPS_ASSIGN_OR_RETURN(const KeptBundle kept, parts_.library->Find(order.bundle));
    if (!kept.problem.empty()) {
      return absl::FailedPreconditionError(absl::StrCat(kept.id, ": ", kept.problem));
    }
    RIPS_ASSIGN_OR_RETURN(pipeline::Policy policy, parts_.policies->Find(kept.name, kept.id));
    return Chosen{.id = kept.id, .name = kept.name, .policy = std::move(policy)};
  }
  RIPS_ASSIGN_OR_RETURN(const auto robots,
                        Select(parts_.fleet->inventory(), order.robots, std::nullopt));
  const std::string& name = robots.front()->bundle;
  for (const bundle::InventoryRobot* robot : robots) {
    if (robot->bundle == name) continue;
    return absl::FailedPreconditionError(
        absl::StrCat("the inventory has policy `", name, "` for ", robots.front()->id, " and `",
                     robot->bundle, "` for ", robot->id, "; choose robots of one policy"));
  }
  RIPS_ASSIGN_OR_RETURN(pipeline::Policy policy, parts_.policies->Find(name, ""));
  return Chosen{
      .id = policy.bundle_id, .name = name, .from_directory = true, .policy = std::move(policy)};
}

absl::StatusOr<RolloutAnswer> BundleControl::Activate(const ActivateOrder& order) {
  if (rollout_ && rollout_->running()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "a ", Described(rollout_->record().plan),
        " runs; wait for its end, or end it with `ripsctl rules stop` or `rules rollback`"));
  }
  RIPS_ASSIGN_OR_RETURN(const Chosen chosen, Choose(order));
  RIPS_ASSIGN_OR_RETURN(auto robots, Select(parts_.fleet->inventory(), order.robots, chosen.name));
  RIPS_ASSIGN_OR_RETURN(PlannedStages planned, PlanStages(robots, order.stages));
  RolloutAnswer answer{.notes = std::move(planned.notes)};
  const std::string wanted = chosen.from_directory ? "" : chosen.id;
  std::set<std::string> left_out;
  std::erase_if(robots, [&](const bundle::InventoryRobot* robot) {
    // One of the directory may hold another version by now.
    if (chosen.from_directory || parts_.activations->For(*robot) != wanted) return false;
    answer.left_out.push_back(absl::StrCat(robot->id, ": is to be judged by it already"));
    return left_out.insert(robot->id).second;
  });
  if (robots.empty()) {
    answer.rollout = parts_.activations->now().rollout;
    return answer;
  }
  for (std::vector<std::string>& stage : planned.stages) {
    std::erase_if(stage, [&](const std::string& robot) { return left_out.contains(robot); });
  }
  std::erase_if(planned.stages, [](const auto& stage) { return stage.empty(); });
  for (std::string& note : Forecast(robots, chosen.policy)) answer.notes.push_back(std::move(note));
  RolloutPlan plan{.id = parts_.new_id(),
                   .bundle_id = chosen.id,
                   .from_directory = chosen.from_directory,
                   .name = chosen.name,
                   .operator_name = order.operator_name,
                   .reason = order.reason,
                   .roll_back_when_stopped = order.roll_back_when_stopped};
  if (order.soak_ns > 0) plan.soak_ns = std::min(order.soak_ns, kSoakNsMax);
  if (order.alerts_per_minute_max > 0) {
    plan.alerts_per_minute_max = std::min(order.alerts_per_minute_max, kAlertsPerMinuteMax);
  }
  plan.stages = std::move(planned.stages);
  if (!order.dry_run) return Begin(std::move(plan), std::move(answer));
  answer.changed = plan.stages.front();
  answer.rollout = RolloutRecord{.plan = std::move(plan)};
  return answer;
}

std::vector<std::string> BundleControl::Forecast(
    const std::vector<const bundle::InventoryRobot*>& robots,
    const pipeline::Policy& policy) const {
  struct Is {
    RobotStatus status;
    std::vector<std::string> levels;
    std::vector<std::string> two_person;
  };
  const auto gathered = parts_.pipeline->Gather<Is>([](Robot& each) {
    return Is{.status = each.Status(),
              .levels = each.core().levels().names(),
              .two_person = each.core().policy().two_person};
  });
  const levels::LevelTable& levels = policy.program->rules().levels;
  std::vector<std::string> notes;
  for (const bundle::InventoryRobot* robot : robots) {
    const auto found = gathered.answers.find(robot->id);
    if (found == gathered.answers.end()) continue;
    const Is& is = found->second;
    const auto note = [&](const auto&... text) {
      notes.push_back(absl::StrCat(robot->id, ": ", text...));
    };
    if (!levels.Find(is.status.decided_level)) {
      note("will not take it: it is at ", is.status.decided_level,
           ", which the bundle does not have");
    } else if (!is.status.effective_level.empty() && levels.names() != is.levels) {
      note("will not take it: the bundle's levels differ from those of its attached actuators");
    }
    if (!is.status.watched) note("sends nothing now, so it cannot show what the bundle does");
    std::vector<std::string> dropped = is.two_person;
    std::erase_if(dropped, [&](const std::string& level) {
      return std::count(policy.two_person.begin(), policy.two_person.end(), level) > 0;
    });
    if (!dropped.empty()) {
      note("one operator alone will lower it from ", absl::StrJoin(dropped, ", "),
           "; the bundle in force wants two");
    }
  }
  return notes;
}

absl::StatusOr<RolloutAnswer> BundleControl::Begin(RolloutPlan plan, RolloutAnswer answer) {
  const Instant now = parts_.clock->Now();
  Rollout rollout({.plan = std::move(plan)}, now, /*restarted=*/false);
  const RolloutStep step = rollout.Begin(Health(), now);
  RIPS_RETURN_IF_ERROR(Perform(rollout, step));
  rollout_ = std::move(rollout);
  Publish();
  answer.changed = step.activate;
  answer.rollout = rollout_->record();
  return answer;
}

absl::StatusOr<RolloutAnswer> BundleControl::RollBack(const RollBackOrder& order) {
  RIPS_ASSIGN_OR_RETURN(const auto robots,
                        Select(parts_.fleet->inventory(), order.robots, std::nullopt));
  RolloutAnswer answer;
  ActivatedBundles next = parts_.activations->now();
  for (const bundle::InventoryRobot* robot : robots) {
    const auto found = next.robots.find(robot->id);
    if (found == next.robots.end() || !found->second.before) {
      answer.left_out.push_back(absl::StrCat(robot->id, ": has nothing to go back to"));
      continue;
    }
    const auto named = [](const std::string& id) {
      return id.empty() ? absl::StrCat("what the ", kDirectory, " holds") : id.substr(0, kIdShown);
    };
    answer.notes.push_back(absl::StrCat(robot->id, ": ", named(found->second.bundle_id), " -> ",
                                        named(*found->second.before)));
    found->second = {.bundle_id = *found->second.before,
                     .name = found->second.name,
                     .operator_name = order.operator_name,
                     .reason = order.reason,
                     .time_unix_ns = parts_.clock->Now().unix_ns};
    answer.changed.push_back(robot->id);
  }
  answer.rollout = next.rollout;
  if (order.dry_run || answer.changed.empty()) return answer;
  std::optional<Rollout> ended;
  const bool concerns = rollout_ && std::any_of(answer.changed.begin(), answer.changed.end(),
                                                [this](const std::string& robot) {
                                                  return rollout_->record().before.contains(robot);
                                                });
  if (concerns) {
    ended = rollout_;
    ended->Stop(absl::StrCat(order.operator_name, " rolled back ", Named(answer.changed)),
                parts_.clock->Now());
    next.rollout = ended->record();
    next.rollout->rolled_back =
        absl::StrCat(Named(answer.changed), " by ", order.operator_name, ": ", order.reason);
    answer.rollout = next.rollout;
    ended.emplace(*next.rollout, parts_.clock->Now(), /*restarted=*/false);
  }
  RIPS_RETURN_IF_ERROR(parts_.activations->Set(std::move(next)));
  if (ended) {
    rollout_ = std::move(ended);
    parts_.rates->Clear();
  }
  parts_.fleet->Apply({answer.changed.begin(), answer.changed.end()});
  Publish();
  parts_.alerts->Raise(std::string(store::kServerRobot), engine::Severity::kInfo,
                       absl::StrCat(order.operator_name, " rolled back the bundle of ",
                                    Named(answer.changed), ": ", order.reason));
  return answer;
}

absl::StatusOr<RolloutAnswer> BundleControl::StopRollout(const std::string& operator_name,
                                                         const std::string& reason) {
  if (!rollout_ || !rollout_->running()) return absl::NotFoundError("no roll-out runs");
  Rollout stopped = *rollout_;
  const RolloutStep step =
      stopped.Stop(absl::StrCat(operator_name, ": ", reason), parts_.clock->Now());
  RIPS_RETURN_IF_ERROR(Perform(stopped, step));
  rollout_ = std::move(stopped);
  Publish();
  return Answer();
}

absl::StatusOr<ShadowAnswer> BundleControl::Shadow(const ShadowWish& wish) {
  RIPS_ASSIGN_OR_RETURN(ShadowAnswer answer, shadows_.Set(wish, parts_.fleet->inventory()));
  if (wish.bundle.empty()) return answer;
  const FleetHealth health = Health();
  for (const std::string& robot : answer.changed) {
    const auto found = health.find(robot);
    if (found != health.end() && found->second.watched) continue;
    answer.notes.push_back(absl::StrCat(robot, ": sends nothing now, so its shadow shows nothing"));
  }
  return answer;
}

// --------------------------------------------------------------------------------------- status

RolloutAnswer BundleControl::Answer() const {
  RolloutAnswer answer{.rollout = parts_.activations->now().rollout};
  if (rollout_) answer.healthy_since_unix_ns = rollout_->healthy_since_unix_ns();
  return answer;
}

void BundleControl::Publish() {
  const RolloutAnswer newest = Answer();
  auto status = std::make_shared<RulesStatus>();
  status->rollout = newest.rollout;
  status->healthy_since_unix_ns = newest.healthy_since_unix_ns;
  if (rollout_) status->not_healthy_because = rollout_->not_healthy_because();
  if (rollout_ && rollout_->running() && !unrecorded_.empty()) {
    status->not_healthy_because = unrecorded_;
  }
  const absl::btree_map<std::string, Activation>& activated = parts_.activations->now().robots;
  for (const bundle::InventoryRobot& listed : parts_.fleet->inventory().robots) {
    RobotRules& rules = status->robots.emplace_back(RobotRules{
        .robot = listed.id, .name = listed.bundle, .problem = parts_.fleet->Problem(listed.id)});
    const auto found = activated.find(listed.id);
    if (found != activated.end() && found->second.name == listed.bundle) {
      rules.activation = found->second;
    }
  }
  MutexLock lock(&mu_);
  published_ = std::move(status);
}

absl::StatusOr<RulesStatus> BundleControl::Status(const std::string& robot) const {
  RulesStatus out;
  {
    MutexLock lock(&mu_);
    out = *published_;
  }
  if (!robot.empty()) {
    std::erase_if(out.robots, [&](const RobotRules& each) { return each.robot != robot; });
    if (out.robots.empty()) {
      return absl::NotFoundError(
          absl::StrCat("robot `", absl::CHexEscape(robot), "` is not in the inventory"));
    }
  }
  auto gathered = parts_.pipeline->Gather<RobotStatus>([](Robot& each) { return each.Status(); });
  for (const RobotStatus& held : parts_.pipeline->held()) {
    gathered.answers.insert_or_assign(held.robot, held);
  }
  out.no_answer = std::move(gathered.silent);
  for (RobotRules& rules : out.robots) {
    rules.shadow = parts_.shadows->Report(rules.robot, /*with_examples=*/!robot.empty());
    const auto is = gathered.answers.find(rules.robot);
    if (is == gathered.answers.end()) continue;
    rules.bundle_in_use = is->second.bundle_version;
    const bool other = rules.activation && !rules.activation->bundle_id.empty() &&
                       !rules.bundle_in_use.empty() &&
                       rules.bundle_in_use != rules.activation->bundle_id;
    if (!rules.problem.empty() || !other) continue;
    rules.problem = "it has not taken what was activated";
    if (const std::string& why = is->second.policy_problem; !why.empty()) {
      absl::StrAppend(&rules.problem, ": ", why);
    }
  }
  return out;
}

FleetHealth BundleControl::Health() const {
  const auto gathered = parts_.pipeline->Gather<RobotHealth>(
      [](Robot& each) { return HealthOf(each.Status(), each.core().levels().names()); });
  FleetHealth health;
  for (const auto& [robot, answer] : gathered.answers) {
    health[robot] = answer;
    health[robot].alerts = parts_.rates->Count(robot);
  }
  for (const RobotStatus& held : parts_.pipeline->held()) health[held.robot] = HealthOf(held, {});
  if (!rollout_) return health;
  const RolloutPlan& plan = rollout_->record().plan;
  for (const std::vector<std::string>& stage : plan.stages) {
    for (const std::string& robot : stage) {
      const bundle::InventoryRobot* listed = parts_.fleet->inventory().Find(robot);
      if (listed == nullptr || listed->bundle != plan.name) health[robot].gone = true;
    }
  }
  return health;
}

// ------------------------------------------------------------------------------------- roll-out

void BundleControl::Look() {
  if (!rollout_ || !rollout_->running()) return;
  Rollout looked = *rollout_;
  const RolloutStep step = looked.Look(Health(), parts_.clock->Now());
  if (!step.empty()) {
    if (const absl::Status done = Perform(looked, step); !done.ok()) {
      return OnUnrecorded(looked.record(), done);  // looked at again
    }
  }
  unrecorded_.clear();
  rollout_ = std::move(looked);
  Publish();
}

void BundleControl::OnUnrecorded(const RolloutRecord& next, const absl::Status& status) {
  const std::string before =
      std::exchange(unrecorded_, absl::StrCat("what follows cannot be recorded, and is not done: ",
                                              next.why.empty() ? "" : absl::StrCat(next.why, "; "),
                                              status.message()));
  Publish();
  if (!before.empty()) return;
  const std::string text = absl::StrCat(Described(next.plan), ": ", unrecorded_);
  LogError("the roll-out does not go on", {{"reason", text}});
  parts_.alerts->Raise(std::string(store::kServerRobot), engine::Severity::kHigh, text);
}

absl::Status BundleControl::Perform(Rollout& rollout, RolloutStep step) {
  const RolloutRecord& record = rollout.record();
  const RolloutPlan& plan = record.plan;
  ActivatedBundles next = parts_.activations->now();
  next.rollout = record;
  const std::string activated = plan.from_directory ? "" : plan.bundle_id;
  std::set<std::string> changed(step.activate.begin(), step.activate.end());
  for (const std::string& robot : step.activate) {
    const bundle::InventoryRobot* listed = parts_.fleet->inventory().Find(robot);
    if (listed == nullptr || listed->bundle != plan.name) continue;  // stops it later
    std::string before = parts_.activations->For(*listed);
    // The directory does not hold any more what it has been judged by.
    if (before.empty() && plan.from_directory) before = record.before.at(robot).bundle_id;
    next.robots[robot] = {.bundle_id = activated,
                          .name = plan.name,
                          .operator_name = plan.operator_name,
                          .reason = plan.reason,
                          .time_unix_ns = parts_.clock->Now().unix_ns,
                          .before = std::move(before)};
  }
  std::erase_if(step.roll_back, [&](const std::string& robot) {
    const auto found = next.robots.find(robot);
    return found == next.robots.end() || !found->second.before ||
           found->second.bundle_id != activated || found->second.name != plan.name;
  });
  for (const std::string& robot : step.roll_back) {
    const auto found = next.robots.find(robot);
    found->second.bundle_id = *std::exchange(found->second.before, std::nullopt);
    found->second.operator_name = std::string(pipeline::kOwnRule);
    found->second.time_unix_ns = parts_.clock->Now().unix_ns;
    found->second.reason = absl::StrCat("the roll-out stopped: ", record.why);
    changed.insert(robot);
  }
  if (!step.roll_back.empty())
    next.rollout->rolled_back = absl::StrCat(Named(step.roll_back), " at once");
  RIPS_RETURN_IF_ERROR(parts_.activations->Set(std::move(next)));
  unrecorded_.clear();
  if (step.over) parts_.rates->Clear();
  for (const std::string& robot : step.activate) parts_.rates->Watch(robot);
  if (!changed.empty()) parts_.fleet->Apply(changed);
  Report(record, step);
  return absl::OkStatus();
}

void BundleControl::Report(const RolloutRecord& record, const RolloutStep& step) {
  const std::string what = Described(record.plan);
  const auto raise = [&](engine::Severity severity, const std::string& text) {
    LogInfo("roll-out", {{"what", text}});
    parts_.alerts->Raise(std::string(store::kServerRobot), severity, text);
  };
  if (record.state == RolloutState::kDone)
    return raise(engine::Severity::kInfo, absl::StrCat(what, " is done"));
  if (record.state == RolloutState::kStopped) {
    return raise(step.by_itself ? engine::Severity::kHigh : engine::Severity::kInfo,
                 absl::StrCat(what, " stopped at stage ", record.stage + 1, " of ",
                              record.plan.stages.size(), ": ", record.why,
                              step.roll_back.empty()
                                  ? "; robots stay as they are, `ripsctl rules rollback` takes "
                                    "them back"
                                  : absl::StrCat("; rolled back ", Named(step.roll_back))));
  }
  raise(engine::Severity::kInfo,
        absl::StrCat(what, ": stage ", record.stage + 1, " of ", record.plan.stages.size(), ", ",
                     Named(step.activate), ": ", record.plan.reason));
}

}  // namespace rips::rollout

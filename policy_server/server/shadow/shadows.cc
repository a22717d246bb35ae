#include "policy_server/server/shadow/shadows.h"

#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"

namespace rips::shadow {
namespace {

constexpr int kLowestPriority = 19;

// Of the calling thread, on Linux, and of the processes that it starts.
void LowerPriority() {
  const auto thread = static_cast<id_t>(syscall(SYS_gettid));
  if (setpriority(PRIO_PROCESS, thread, kLowestPriority) != 0) {
    LogWarning("cannot lower the priority of the shadows' thread");
  }
}

int64_t NowNs() { return RealClock().Now().boottime_ns; }

}  // namespace

struct Shadows::Shadow {
  std::string robot;
  ShadowPolicy policy;
  std::shared_ptr<ShadowTap> tap;

  // Of the thread; the run uses the session.
  std::unique_ptr<inspect::Session> session;
  std::unique_ptr<ShadowRun> run;
  bool unpublished = false;
  int64_t published_ns = 0;

  // What a report begins with.
  ShadowReport blank;
  // Under Shadows::mu_.
  ShadowReport report;
};

Shadows::Shadows() : thread_([this] { Run(); }) {}

Shadows::~Shadows() { Stop(); }

absl::Status Shadows::Begin(const std::string& robot, ShadowStart start, const AddTap& add_tap) {
  auto shadow = std::make_shared<Shadow>();
  shadow->robot = robot;
  shadow->tap = std::make_shared<ShadowTap>([this] { Wake(); });
  shadow->blank = {.bundle_id = start.policy.bundle_id,
                   .name = start.policy.name,
                   .operator_name = std::move(start.operator_name),
                   .reason = std::move(start.reason),
                   .began_unix_ns = RealClock().Now().unix_ns};
  shadow->report = shadow->blank;
  shadow->policy = std::move(start.policy);
  {
    MutexLock lock(&mu_);
    if (stopping_) return absl::UnavailableError("the server is stopping");
    const auto it = shadows_.find(robot);
    if (it != shadows_.end() && it->second->report.problem.empty()) {
      return absl::AlreadyExistsError(
          absl::StrCat("robot `", robot, "` has a shadow already; end it first"));
    }
    if (it == shadows_.end() && shadows_.size() >= kRobotsMax) {
      return absl::ResourceExhaustedError(
          absl::StrCat(kRobotsMax, " robots have shadows already, the limit"));
    }
    Drop(robot);
    shadows_[robot] = shadow;
  }
  const absl::Status added = add_tap(shadow->tap, shadow->policy.watched);
  if (added.ok()) return added;
  MutexLock lock(&mu_);
  const auto it = shadows_.find(robot);
  if (it != shadows_.end() && it->second == shadow) Drop(robot);
  return added;
}

void Shadows::Drop(const std::string& robot) {
  const auto it = shadows_.find(robot);
  if (it == shadows_.end()) return;
  it->second->tap->Close();
  dropped_.push_back(std::move(it->second));
  shadows_.erase(it);
  work_ = true;
  changed_.NotifyAll();
}

bool Shadows::End(const std::string& robot) {
  MutexLock lock(&mu_);
  const bool had = shadows_.contains(robot);
  Drop(robot);
  return had;
}

ShadowReport Shadows::ReportOf(const Shadow& shadow, bool with_examples) const {
  ShadowReport report = shadow.report;
  const ShadowTap::Live live = shadow.tap->live();
  report.missed = live.missed;
  report.live = live.counts;
  report.live_level = live.level;
  if (!with_examples) report.examples.clear();
  return report;
}

std::optional<ShadowReport> Shadows::Report(const std::string& robot, bool with_examples) const {
  MutexLock lock(&mu_);
  const auto it = shadows_.find(robot);
  if (it == shadows_.end()) return std::nullopt;
  return ReportOf(*it->second, with_examples);
}

absl::btree_map<std::string, ShadowReport> Shadows::Reports() const {
  absl::btree_map<std::string, ShadowReport> reports;
  MutexLock lock(&mu_);
  for (const auto& [robot, shadow] : shadows_) {
    reports.emplace(robot, ReportOf(*shadow, /*with_examples=*/false));
  }
  return reports;
}

void Shadows::Stop() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    for (const auto& [robot, shadow] : shadows_) shadow->tap->Close();
    changed_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

void Shadows::Wake() {
  MutexLock lock(&mu_);
  work_ = true;
  changed_.NotifyAll();
}

// ---------------------------------------------------------------------------------- the thread

void Shadows::Run() {
  LowerPriority();
  std::vector<ShadowPtr> turns;
  while (Next(turns)) {
    bool more = false;
    unpublished_ = false;
    for (const ShadowPtr& shadow : turns) {
      more |= Turn(*shadow);
      unpublished_ |= shadow->unpublished;
    }
    turns.clear();
    if (more) Wake();
  }
}

bool Shadows::Next(std::vector<ShadowPtr>& turns) {
  MutexLock lock(&mu_);
  const int64_t due_ns = NowNs() + kReportNs;
  while (!work_ && !stopping_) {
    if (!unpublished_) {
      changed_.Wait(lock);
    } else if (!changed_.WaitUntil(lock, due_ns)) {
      break;
    }
  }
  work_ = false;
  turns.swap(dropped_);
  for (const auto& [robot, shadow] : shadows_) turns.push_back(shadow);
  if (stopping_) shadows_.clear();
  return !stopping_;
}

bool Shadows::Turn(Shadow& shadow) {
  if (shadow.tap->closed()) {
    shadow.tap->Pop();  // drops what it has taken
    shadow.run.reset();
    shadow.session.reset();
    return false;
  }
  const int64_t end_ns = NowNs() + kTurnNs;
  bool more = true;
  while (more && NowNs() < end_ns) {
    const std::optional<ShadowTap::Item> item = shadow.tap->Pop();
    if ((more = item.has_value())) Judge(shadow, *item);
  }
  Publish(shadow, NowNs());
  return more && !shadow.tap->closed();
}

void Shadows::Judge(Shadow& shadow, const ShadowTap::Item& item) {
  shadow.unpublished = true;
  if (const auto* start = std::get_if<pipeline::RulesState>(&item)) {
    const ShadowPolicy& policy = shadow.policy;
    if (policy.inspections != nullptr) shadow.session = policy.inspections->NewSession();
    shadow.run = std::make_unique<ShadowRun>(policy, shadow.robot, *start, shadow.session.get());
    return;
  }
  if (shadow.run == nullptr) return;
  if (const auto* event = std::get_if<pipeline::JudgedEvent>(&item)) {
    shadow.run->Judge(*event);
  } else {
    shadow.run->Judge(std::get<pipeline::LevelChange>(item));
  }
}

void Shadows::Publish(Shadow& shadow, int64_t now_ns) {
  const bool stopped = shadow.run != nullptr && shadow.run->stopped();
  const bool retired = shadow.tap->retired_and_empty();
  if (!stopped && !retired && (!shadow.unpublished || now_ns - shadow.published_ns < kReportNs)) {
    return;
  }
  shadow.unpublished = false;
  shadow.published_ns = now_ns;
  ShadowReport report = shadow.blank;
  if (shadow.run != nullptr) shadow.run->Report(report);
  if (retired && report.problem.empty()) {
    report.problem =
        "its robot is no longer judged by this server; order it anew when the robot is back";
  }
  if (stopped || retired) {
    shadow.tap->Close();
    shadow.tap->Pop();  // drops what it has taken
    shadow.run.reset();
    shadow.session.reset();
    LogWarning(
        "a shadow has stopped",
        {{"robot", shadow.robot}, {"bundle", report.bundle_id}, {"problem", report.problem}});
  }
  MutexLock lock(&mu_);
  std::swap(shadow.report, report);
}

}  // namespace rips::shadow

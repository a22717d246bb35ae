#include "policy_server/ripsctl/top/fleet_watch.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "policy_server/ripsctl/cli/command.h"
#include "policy_server/ripsctl/cli/keep_watching.h"
#include "policy_server/ripsctl/cli/server_expiry.h"

namespace rips::ripsctl {
namespace {

// The order of levels is worth no long wait: statuses come in behind it.
constexpr absl::Duration kLevelsTimeout = absl::Seconds(2);
constexpr absl::Duration kLevelsRetry = absl::Seconds(5);
// What a server that means well does not exceed: bundles in force at a time, and of each its id and
// its levels.
constexpr size_t kBundlesMax = 1'000;
constexpr size_t kBundleBytesMax = 256;
constexpr size_t kLevelsBytesMax = 64 << 10;

std::string ServerName(const RawSettings& settings) {
  if (settings.context.empty()) return settings.server;
  return absl::StrCat(settings.context, " (", settings.server, ")");
}

}  // namespace

FleetWatch::FleetWatch(Env* env, std::vector<std::string> robots)
    : env_(env), robots_(std::move(robots)), view_(ServerName(env->settings)) {
  thread_ = std::thread([this] { Run(); });
}

FleetWatch::~FleetWatch() {
  {
    MutexLock lock(&mu_);
    stopped_ = true;
    for (grpc::ClientContext* call : calls_) call->TryCancel();
    stop_cond_.NotifyAll();
  }
  thread_.join();
}

std::vector<ScreenLine> FleetWatch::Render(TerminalSize size, absl::Time now) const {
  MutexLock lock(&mu_);
  return view_.Render(size, now);
}

std::optional<absl::Status> FleetWatch::ended() const {
  MutexLock lock(&mu_);
  return ended_;
}

void FleetWatch::Run() {
  const auto lost = [this](const grpc::Status& status) {
    MutexLock lock(&mu_);
    view_.Lost(status.error_message(), absl::Now());
    changed_.Wake();
  };
  // The view learns of it with the first status.
  const auto connected_again = [] {};
  const auto pause = [this](absl::Duration duration) { return Pause(duration); };
  const absl::Status status = KeepWatching(
      {lost, connected_again, pause},
      [this](bool again, const std::function<void()>& heard) { return WatchOnce(again, heard); });
  MutexLock lock(&mu_);
  ended_ = status;
  changed_.Wake();
}

bool FleetWatch::Begin(grpc::ClientContext* context) {
  MutexLock lock(&mu_);
  if (stopped_) return false;
  calls_.insert(context);
  return true;
}

void FleetWatch::End(grpc::ClientContext* context) {
  MutexLock lock(&mu_);
  calls_.erase(context);
}

grpc::Status FleetWatch::WatchOnce(bool again, const std::function<void()>& heard) {
  grpc::ClientContext context;
  context.set_wait_for_ready(again);
  if (!Begin(&context)) return {grpc::StatusCode::CANCELLED, "the watch was ended"};
  v1::WatchRobotsRequest request;
  for (const std::string& robot : robots_) request.add_robots(robot);
  const auto reader = env_->server->WatchRobots(&context, request);
  ServerExpiry expiry(&context);
  v1::RobotStatus status;
  bool first = true;
  bool kept = true;
  while (kept && reader->Read(&status)) {
    heard();
    expiry.Received();
    if (std::exchange(first, false)) {
      MutexLock lock(&mu_);
      view_.Connected();
    }
    kept = Received(status);
    if (!kept) context.TryCancel();
  }
  const grpc::Status end = expiry.End(reader->Finish());
  End(&context);
  if (kept) return end;
  return {grpc::StatusCode::OUT_OF_RANGE,
          absl::StrCat("the server sent robots of more than ", FleetView::kBytesMax >> 20, " MiB")};
}

bool FleetWatch::Received(const v1::RobotStatus& status) {
  {
    MutexLock lock(&mu_);
    if (!view_.Update(status)) return false;
    changed_.Wake();
  }
  LearnLevels(status);
  return true;
}

void FleetWatch::LearnLevels(const v1::RobotStatus& status) {
  const std::string& bundle = status.bundle_version();
  if (bundle.empty() || bundle.size() > kBundleBytesMax) return;
  {
    MutexLock lock(&mu_);
    if (stopped_ || view_.HasLevels(bundle)) return;
  }
  const absl::Time now = absl::Now();
  if (ask_levels_at_.size() >= kBundlesMax && !ask_levels_at_.contains(bundle)) return;
  absl::Time& at = ask_levels_at_.try_emplace(bundle, absl::InfinitePast()).first->second;
  if (now < at) return;
  at = now + kLevelsRetry;
  v1::GetLevelRequest request;
  request.set_robot(status.robot());
  grpc::ClientContext context;
  context.set_deadline(absl::ToChronoTime(now + std::min(env_->timeout, kLevelsTimeout)));
  v1::GetLevelResponse response;
  if (!Begin(&context)) return;
  const bool answered = env_->server->GetLevel(&context, request, &response).ok();
  End(&context);
  if (!answered || response.ByteSizeLong() > kLevelsBytesMax) return;
  // The robot may have got another bundle meanwhile.
  const std::string& now_bundle = response.status().bundle_version();
  if (now_bundle.size() > kBundleBytesMax) return;
  ask_levels_at_.try_emplace(now_bundle, now + kLevelsRetry);  // so that it is counted
  MutexLock lock(&mu_);
  view_.SetLevels(now_bundle, {response.levels().begin(), response.levels().end()});
  changed_.Wake();
}

bool FleetWatch::Pause(absl::Duration duration) {
  const absl::Time end = absl::Now() + duration;
  MutexLock lock(&mu_);
  while (!stopped_ && absl::Now() < end) {
    if (!stop_cond_.WaitFor(lock, end - absl::Now())) break;
  }
  return !stopped_;
}

}  // namespace rips::ripsctl

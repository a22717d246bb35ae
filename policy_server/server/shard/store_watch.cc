#include "policy_server/server/shard/store_watch.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/runtime/log.h"

namespace rips::pipeline {

StoreWatch::StoreWatch(const store::Committer* committer, ServerAlerts* alerts, const Clock* clock,
                       std::string path, StoreCounts counts, absl::Duration interval)
    : committer_(committer),
      alerts_(alerts),
      clock_(clock),
      path_(std::move(path)),
      counts_(std::move(counts)),
      interval_(interval) {
  if (counts_.healthy) counts_.healthy(true);
  if (interval_ != absl::InfiniteDuration()) thread_ = std::thread([this] { Run(); });
}

StoreWatch::~StoreWatch() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    stop_cond_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

void StoreWatch::Run() {
  while (true) {
    Look();
    MutexLock lock(&mu_);
    if (!stopping_) stop_cond_.WaitFor(lock, interval_);
    if (stopping_) return;
  }
}

void StoreWatch::Look() {
  const Instant now = clock_->Now();
  const absl::Status health = committer_->health();
  const uint64_t failures = committer_->failures();
  const bool failed = !health.ok() || failures != failures_;
  if (counts_.failures && failures != failures_) counts_.failures(failures - failures_);
  if (health.ok() != healthy_ && counts_.healthy) counts_.healthy(health.ok());
  healthy_ = health.ok();
  if (failed) failed_ns_ = now.boottime_ns;
  if (failed && !outage_) Begin(health, now);
  failures_ = failures;
  if (outage_ && !failed && now.boottime_ns - failed_ns_ >= kCalmNs) End();
}

void StoreWatch::Begin(const absl::Status& health, Instant now) {
  outage_ = true;
  began_ns_ = now.boottime_ns;
  failures_before_ = failures_;
  const std::string reason(health.ok() ? "it can be written again by now" : health.message());
  LogError("cannot write the store", {{"store", path_}, {"reason", reason}});
  const std::string text =
      absl::StrCat("the store ", path_, " cannot be written: ", reason,
                   "; raises are commanded, lowerings and programs are refused, alerts wait in "
                   "memory");
  alerts_->Announce(text);
  alerts_->Raise(std::string(store::kServerRobot), engine::Severity::kCritical, text);
}

void StoreWatch::End() {
  outage_ = false;
  const int64_t seconds = (failed_ns_ - began_ns_ + kNanosPerSecond - 1) / kNanosPerSecond;
  const uint64_t failures = failures_ - failures_before_;
  LogInfo("store is writable again",
          {{"store", path_}, {"seconds", seconds}, {"failed_writes", failures}});
  alerts_->Raise(std::string(store::kServerRobot), engine::Severity::kInfo,
                 absl::StrCat("store is writable again after ", seconds, " s and ", failures,
                              " failed writes"));
}

}  // namespace rips::pipeline

#include "policy_server/server/outputs/output.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "services/runtime/log.h"

namespace rips::outputs {
namespace {

bool Wants(const server::OutputConfig& config, const store::AlertRecord& alert) {
  if (server::SeverityRank(alert.severity) < server::SeverityRank(config.severity)) return false;
  return config.robots.empty() ||
         std::find(config.robots.begin(), config.robots.end(), alert.robot) != config.robots.end();
}

}  // namespace

Output::Output(const server::OutputConfig& config, store::Store* store,
               std::unique_ptr<Receiver> receiver, OutputReports reports, const Clock* clock,
               rpc::Random random, absl::Duration interval)
    : config_(config),
      store_(store),
      receiver_(std::move(receiver)),
      reports_(std::move(reports)),
      clock_(clock),
      interval_(interval),
      place_(store, config.name),
      health_(absl::StrCat("output `", config.name, "` (", server::ToString(config.kind), ")"),
              reports_.alert),
      backoff_(kBackoff, std::move(random)) {
  reports_.healthy(true);
  // Before there can be new alerts: a new output begins with the first of them.
  if (const absl::StatusOr<store::AlertRecord> newest = store_->NewestAlert(); newest.ok()) {
    place_.Find(*newest).IgnoreError();  // tried again at the first look
  }
  if (interval_ != absl::InfiniteDuration()) thread_ = std::thread([this] { Run(); });
}

Output::~Output() { Stop(); }

void Output::Cancel() {
  receiver_->Cancel();
  MutexLock lock(&mu_);
  stopping_ = true;
  stop_cond_.NotifyAll();
}

void Output::Stop() {
  Cancel();
  if (thread_.joinable()) thread_.join();
  place_.Remember(clock_->Now().boottime_ns, true);
}

bool Output::stopping() {
  MutexLock lock(&mu_);
  return stopping_;
}

void Output::Run() {
  while (!stopping()) {
    Look();
    MutexLock lock(&mu_);
    if (!stopping_) stop_cond_.WaitFor(lock, interval_);
  }
}

void Output::Look() {
  // Trouble of the store is the store's (pipeline::StoreWatch).
  const absl::StatusOr<store::AlertRecord> newest = store_->NewestAlert();
  if (!newest.ok() || !place_.Find(*newest).ok()) return;
  while (!stopping() && clock_->Now().boottime_ns >= attempts_.retry_at_ns && Follow(*newest)) {
    place_.Remember(clock_->Now().boottime_ns, false);
  }
  const int64_t now_ns = clock_->Now().boottime_ns;
  place_.Remember(now_ns, false);
  const uint64_t behind = newest->sequence - std::min(newest->sequence, place_.sequence());
  reports_.behind(behind);
  reports_.healthy(health_.working());
  health_.Poll(now_ns, behind);
}

bool Output::Follow(const store::AlertRecord& newest) {
  if (place_.lost()) {
    if (!ReportGap({.after = place_.sequence(), .up_to = place_.sequence()})) return false;
    place_.Accept();
  }
  if (place_.sequence() >= newest.sequence) return false;
  const bool singly = place_.sequence() < attempts_.singly_up_to;
  const auto limit = static_cast<uint32_t>(singly ? 1 : receiver_->batch_max());
  const absl::StatusOr<store::AlertPage> page = store_->AlertsAfter("", place_.sequence(), limit);
  if (!page.ok() || page->alerts.empty()) return false;
  const uint64_t forgotten = CountForgotten(*page, place_.sequence());
  if (!ReportForgotten(*page, forgotten)) return false;
  std::vector<store::AlertRecord> wanted;
  for (const store::AlertRecord& alert : page->alerts) {
    if (Wants(config_, alert)) wanted.push_back(alert);
  }
  const store::AlertRecord& last = page->alerts.back();
  if (!wanted.empty() && !Deliver(wanted, last.sequence)) {
    // Refused together: one by one, at once.
    return clock_->Now().boottime_ns >= attempts_.retry_at_ns;
  }
  place_.Advance(last);
  attempts_.forgotten_told -= std::min(attempts_.forgotten_told, forgotten);
  return true;
}

bool Output::ReportGap(const Gap& gap) {
  if (!attempts_.gap) {
    attempts_.gap = MakeGapEvent(config_.name, gap, clock_->Now().unix_ns);
    attempts_.gap_count = gap.count;
  }
  if (!Deliver({&*attempts_.gap, 1}, 0)) return false;
  attempts_.gap.reset();
  return true;
}

bool Output::ReportForgotten(const store::AlertPage& page, uint64_t forgotten) {
  // The receiver knows of those of a page that it did not accept. The store may forget more while
  // the receiver accepts the first count.
  while (forgotten > attempts_.forgotten_told) {
    if (!ReportGap({.after = place_.sequence(),
                    .up_to = page.alerts.back().sequence,
                    .count = forgotten - attempts_.forgotten_told})) {
      return false;
    }
    // A receiver that refuses the gap gets no second one for what was forgotten meanwhile.
    const uint64_t told =
        attempts_.skipped ? forgotten - attempts_.forgotten_told : attempts_.gap_count;
    reports_.forgotten(told);
    attempts_.forgotten_told += told;
  }
  return true;
}

bool Output::Deliver(std::span<const store::AlertRecord> alerts, uint64_t up_to) {
  const absl::Status status = receiver_->Send(alerts);
  if (status.ok()) {
    if (up_to != 0) reports_.sent(alerts.size());
    health_.OnAccepted(clock_->Now().boottime_ns);
    backoff_.Reset();
    attempts_.refused = 0;
    attempts_.skipped = false;
    return true;
  }
  if (absl::IsCancelled(status)) return false;
  reports_.failed();
  OnFailed(status, alerts, up_to);
  if (!absl::IsInvalidArgument(status) || alerts.size() > 1) return false;
  const std::string& id = alerts.front().id;
  if (std::exchange(attempts_.refused_id, id) != id) attempts_.refused = 0;
  if (++attempts_.refused < kTriesMax) return false;
  LogError("the receiver of an output has refused an alert three times; skipping it",
           {{"output", config_.name}, {"alert", id}, {"reason", status.message()}});
  reports_.skipped(1);
  attempts_.refused = 0;
  attempts_.skipped = true;
  attempts_.retry_at_ns = 0;
  return true;
}

void Output::OnFailed(const absl::Status& status, std::span<const store::AlertRecord> alerts,
                      uint64_t up_to) {
  const int64_t now_ns = clock_->Now().boottime_ns;
  health_.OnFailed(now_ns, status.message());
  const bool several = alerts.size() > 1;
  if (several && (absl::IsInvalidArgument(status) || absl::IsDeadlineExceeded(status))) {
    attempts_.singly_up_to = up_to;
  }
  if (several && absl::IsInvalidArgument(status)) return;
  attempts_.retry_at_ns = now_ns + absl::ToInt64Nanoseconds(backoff_.Next());
}

}  // namespace rips::outputs

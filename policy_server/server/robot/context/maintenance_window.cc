#include "policy_server/server/robot/context/maintenance_window.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "services/base/cut_text.h"

namespace rips::pipeline {

namespace {

// Each alert of the robot carries the mark; the alert of the beginning has the whole reason.
constexpr size_t kReasonInMarkBytesMax = 120;

}  // namespace

std::string UtcText(int64_t unix_ns) {
  return absl::FormatTime("%Y-%m-%d %H:%M:%S UTC", absl::FromUnixNanos(unix_ns),
                          absl::UTCTimeZone());
}

std::string ShortName(const std::string& operator_name) {
  return operator_name.substr(0, operator_name.find(' '));
}

std::string MaintenanceMark(const store::Maintenance& maintenance) {
  return absl::StrCat("in maintenance until ", UtcText(maintenance.until_unix_ns), " (asked by ",
                      ShortName(maintenance.by), ": ",
                      Shortened(maintenance.reason, kReasonInMarkBytesMax), ")");
}

void MaintenanceWindow::Restore(const store::Maintenance& stored, const Instant& now) {
  window_.reset();
  if (stored.none()) return;
  window_ = stored;
  end_ns_ = now.boottime_ns;
  // In this order, so that no stored number overflows.
  if (stored.until_unix_ns <= now.unix_ns) return;
  const int64_t left_ns = stored.until_unix_ns - now.unix_ns;
  if (left_ns <= kMaintenanceNsMax) end_ns_ += left_ns;
}

absl::Status MaintenanceWindow::Begin(int64_t for_ns, std::string by, std::string reason,
                                      const Instant& now) {
  if (for_ns < kMaintenanceNsMin || for_ns > kMaintenanceNsMax) {
    return absl::InvalidArgumentError("a maintenance takes 1 minute to 24 hours");
  }
  window_ = {.began_unix_ns = now.unix_ns,
             .until_unix_ns = now.unix_ns + for_ns,
             .by = std::move(by),
             .reason = std::move(reason)};
  end_ns_ = now.boottime_ns + for_ns;
  return absl::OkStatus();
}

bool MaintenanceWindow::Holds(const Instant& now) const {
  return window_ && now.boottime_ns < end_ns_ && now.unix_ns < window_->until_unix_ns;
}

std::optional<store::Maintenance> MaintenanceWindow::PopOver(const Instant& now) {
  if (!window_ || Holds(now)) return std::nullopt;
  return std::exchange(window_, std::nullopt);
}

std::optional<store::Maintenance> MaintenanceWindow::At(const Instant& now) const {
  return Holds(now) ? window_ : std::nullopt;
}

std::string MaintenanceWindow::MarkAt(const Instant& now) const {
  return Holds(now) ? MaintenanceMark(*window_) : "";
}

}  // namespace rips::pipeline

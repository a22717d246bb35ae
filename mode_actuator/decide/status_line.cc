#include "mode_actuator/decide/status_line.h"

#include "absl/strings/str_cat.h"

namespace rips::actuator {

std::string StatusLine(const ExecutorReport& report, bool connected,
                       const absl::Status& disconnected) {
  std::string text =
      absl::StrCat("level ", report.effective.empty() ? "not known" : report.effective,
                   report.verified ? ", verified" : ", not verified");
  if (!report.floor.empty()) {
    absl::StrAppend(&text, "; floor ", report.floor, ": ", report.floor_reason);
  }
  absl::StrAppend(&text, connected ? "; connected" : "; not connected to a policy server");
  if (!connected && !disconnected.ok()) absl::StrAppend(&text, ": ", disconnected.message());
  if (!report.degraded.empty()) absl::StrAppend(&text, "; degraded: ", report.degraded.front());
  if (report.degraded.size() > 1) absl::StrAppend(&text, ", ", report.degraded.size() - 1, " more");
  return text;
}

}  // namespace rips::actuator

#include "policy_server/server/outputs/syslog_receiver.h"

#include <unistd.h>

#include "absl/strings/str_cat.h"
#include "policy_server/server/outputs/syslog_format.h"
#include "policy_server/server/store/alert_log.h"
#include "services/base/status_macros.h"

namespace rips::outputs {
namespace {

std::string HostName() {
  char name[256] = {};
  return gethostname(name, sizeof(name) - 1) == 0 ? name : "";
}

}  // namespace

SyslogReceiver::SyslogReceiver(const server::OutputConfig& config, const Timeouts& timeouts)
    : config_(config), timeouts_(timeouts), host_(HostName()) {}

absl::Status SyslogReceiver::Send(std::span<const store::AlertRecord> alerts) {
  std::string frames;
  for (const store::AlertRecord& alert : alerts) {
    const std::string json = config_.format == server::OutputConfig::Format::kJson
                                 ? store::FormatAlertLine(alert)
                                 : std::string();
    absl::StrAppend(&frames, FrameSyslog(FormatSyslog(alert, host_, json)));
  }
  const absl::Status status = Write(frames);
  if (!status.ok()) connection_.reset();
  return status;
}

absl::Status SyslogReceiver::Write(absl::string_view frames) {
  // A receiver may close a connection on which nothing comes.
  if (connection_ != nullptr && !connection_->StaysUp(absl::ZeroDuration()).ok()) {
    connection_.reset();
  }
  if (connection_ == nullptr) {
    RIPS_ASSIGN_OR_RETURN(connection_,
                          Connection::Open(config_.endpoint, timeouts_.connect, &stop_));
  }
  RIPS_RETURN_IF_ERROR(connection_->Write(frames, timeouts_.send));
  return connection_->StaysUp(timeouts_.settle);
}

}  // namespace rips::outputs

#include "sensor_agent/wire/report_sender.h"

#include <sys/socket.h>

#include <cerrno>
#include <utility>

#include "sensor_agent/wire/report_codec.h"
#include "sensor_agent/wire/socket_address.h"

namespace rips::wire {

bool ReportSender::Ready(int64_t now_ns) {
  if (!connected()) {
    if (now_ns < next_try_ns_) return false;
    absl::StatusOr<UniqueFd> fd = ConnectLocal(path_);
    status_ = fd.status();
    if (!fd.ok()) {
      next_try_ns_ = now_ns + kRetryNs;
      return false;
    }
    fd_ = *std::move(fd);
  }
  Flush(now_ns);
  return connected() && pending_.empty();
}

void ReportSender::Send(const TapReport& report, int64_t now_ns) {
  for (std::string& each : EncodeReports(report)) pending_.push_back(std::move(each));
  Flush(now_ns);
}

void ReportSender::Flush(int64_t now_ns) {
  while (!pending_.empty()) {
    const std::string& next = pending_.front();
    if (send(fd_.get(), next.data(), next.size(), MSG_NOSIGNAL) < 0) {
      if (errno == EAGAIN || errno == EINTR) return;
      status_ = absl::ErrnoToStatus(errno, "sending a report");
      fd_.Reset();
      pending_.clear();
      next_try_ns_ = now_ns + kRetryNs;
      return;
    }
    pending_.pop_front();
  }
}

}  // namespace rips::wire

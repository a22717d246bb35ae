// The tap's end of the local socket: reports go to the sensor in order, each once.
#ifndef RIPS_SENSOR_AGENT_WIRE_REPORT_SENDER_H_
#define RIPS_SENSOR_AGENT_WIRE_REPORT_SENDER_H_

#include <cstdint>
#include <deque>
#include <string>

#include "absl/status/status.h"
#include "sensor_agent/wire/traffic.h"
#include "services/runtime/unique_fd.h"

namespace rips::wire {

// One thread. Never blocks.
class ReportSender {
 public:
  // Waits so long after a connection that failed.
  static constexpr int64_t kRetryNs = 1'000'000'000;

  explicit ReportSender(std::string path) : path_(std::move(path)) {}

  // Connects if it is not, and time for it has come. True when everything given so far has been
  // sent, and another report may be given.
  bool Ready(int64_t now_ns);
  // Only when Ready. What cannot be sent at once is sent by the next Ready; what the end of a
  // connection leaves over is lost.
  void Send(const TapReport& report, int64_t now_ns);

  bool connected() const { return fd_.get() >= 0; }
  // Why not, when Ready last tried.
  const absl::Status& status() const { return status_; }

 private:
  void Flush(int64_t now_ns);

  const std::string path_;
  UniqueFd fd_;
  absl::Status status_;
  int64_t next_try_ns_ = 0;
  std::deque<std::string> pending_;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_REPORT_SENDER_H_

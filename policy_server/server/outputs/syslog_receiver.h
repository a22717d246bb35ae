// A syslog server over TLS (RFC 5425) or TCP (RFC 6587). The connection is kept between deliveries.
//
// Syslog has no acknowledgement. Alerts count as accepted when the kernel has taken them and the
// connection is still up after Timeouts::settle; those that a receiver has read and then loses are
// lost, and those of a connection that breaks in that time are sent again.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_SYSLOG_RECEIVER_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_SYSLOG_RECEIVER_H_

#include <memory>
#include <string>

#include "absl/strings/string_view.h"
#include "policy_server/server/config/output_config.h"
#include "policy_server/server/outputs/connection.h"
#include "policy_server/server/outputs/receiver.h"
#include "services/runtime/wake_fd.h"

namespace rips::outputs {

class SyslogReceiver final : public Receiver {
 public:
  SyslogReceiver(const server::OutputConfig& config, const Timeouts& timeouts);

  absl::Status Send(std::span<const store::AlertRecord> alerts) override;
  size_t batch_max() const override { return 256; }
  void Cancel() override { stop_.Wake(); }

 private:
  absl::Status Write(absl::string_view frames);

  const server::OutputConfig config_;
  const Timeouts timeouts_;
  const std::string host_;
  WakeFd stop_;
  std::unique_ptr<Connection> connection_;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_SYSLOG_RECEIVER_H_

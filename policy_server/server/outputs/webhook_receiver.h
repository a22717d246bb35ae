// A webhook: one POST a delivery, on a connection of its own, with a JSON array of alerts or of
// OCSF findings. Headers of a signed one:
//   X-Rips-Timestamp: 1767225600                 Unix time in seconds
//   X-Rips-Signature: sha256=HEX                 HMAC-SHA256(secret, TIMESTAMP "." BODY)
// The secret is the content of `secret_file` without the line break at its end, read for each POST.
//
// | answer                      | result of Send                                   |
// |-----------------------------|--------------------------------------------------|
// | 2xx                         | OK                                               |
// | 400, 413, 415, 422          | InvalidArgument: the body is refused             |
// | others, 3xx among them      | Unavailable: redirects are not followed          |
// | none, or none that is HTTP  | Unavailable, DeadlineExceeded, DataLoss          |
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_WEBHOOK_RECEIVER_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_WEBHOOK_RECEIVER_H_

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/config/output_config.h"
#include "policy_server/server/outputs/http.h"
#include "policy_server/server/outputs/receiver.h"
#include "services/base/clock.h"
#include "services/runtime/wake_fd.h"

namespace rips::outputs {

// `sha256=HEX` as above.
std::string SignBody(absl::string_view secret, absl::string_view timestamp, absl::string_view body);

class WebhookReceiver final : public Receiver {
 public:
  // `clock` is not owned and outlives this.
  WebhookReceiver(const server::OutputConfig& config, const Timeouts& timeouts, const Clock* clock)
      : config_(config), timeouts_(timeouts), clock_(clock) {}

  absl::Status Send(std::span<const store::AlertRecord> alerts) override;
  size_t batch_max() const override { return 100; }
  void Cancel() override { stop_.Wake(); }

 private:
  std::string FormatBody(std::span<const store::AlertRecord> alerts) const;
  // Those that sign the body; none without a secret.
  absl::StatusOr<HttpHeaders> Sign(absl::string_view body) const;
  // Sends the request and reads the answer.
  absl::StatusOr<HttpAnswer> Post(absl::string_view request);

  const server::OutputConfig config_;
  const Timeouts timeouts_;
  const Clock* clock_;
  WakeFd stop_;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_WEBHOOK_RECEIVER_H_

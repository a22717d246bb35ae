// Where one output delivers to.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_RECEIVER_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_RECEIVER_H_

#include <cstddef>
#include <span>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "policy_server/server/store/records.h"

namespace rips::outputs {

// How long a receiver may take for each step of a delivery.
struct Timeouts {
  // Name resolution, TCP and TLS together.
  absl::Duration connect = absl::Seconds(10);
  absl::Duration send = absl::Seconds(10);
  // Of a webhook.
  absl::Duration answer = absl::Seconds(10);
  // Of syslog: how long the connection must stay up after the alerts were written.
  absl::Duration settle = absl::Milliseconds(500);
};

class Receiver {
 public:
  virtual ~Receiver() = default;

  // Delivers the alerts, which are not empty, in their order. Blocks for the timeouts at most.
  //   OK                all are accepted
  //   InvalidArgument   refused, and will be refused again
  //   others            not accepted, or it is not known; a retry may help. Cancelled: by Cancel
  virtual absl::Status Send(std::span<const store::AlertRecord> alerts) = 0;
  // The most alerts of one Send.
  virtual size_t batch_max() const = 0;
  // Ends Send on another thread, now and for ever. Any thread.
  virtual void Cancel() = 0;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_RECEIVER_H_

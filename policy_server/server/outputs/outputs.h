// All outputs of the configuration: each with its receiver, thread and metrics.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_OUTPUTS_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_OUTPUTS_H_

#include <memory>
#include <vector>

#include "policy_server/server/config/output_config.h"
#include "policy_server/server/outputs/output.h"
#include "policy_server/server/store/store.h"
#include "services/base/clock.h"
#include "services/runtime/metrics.h"

namespace rips::outputs {

class Outputs {
 public:
  // Starts them. Nothing is owned; all outlive this. `alert` is called on any thread and must not
  // block. Nothing of a receiver is needed at the start: what is missing is tried again.
  Outputs(const std::vector<server::OutputConfig>& configs, store::Store* store, Metrics* metrics,
          const Clock* clock, const DeliveryHealth::Alert& alert);
  ~Outputs();

  // Ends all deliveries and threads; what was not delivered is after the next start. Idempotent.
  void Stop();

 private:
  std::vector<std::unique_ptr<Output>> outputs_;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_OUTPUTS_H_

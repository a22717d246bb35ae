// Bounds the memory of payloads from their reception until they are acknowledged.
#ifndef RIPS_SENSOR_AGENT_MESSAGES_PAYLOAD_POOL_H_
#define RIPS_SENSOR_AGENT_MESSAGES_PAYLOAD_POOL_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "absl/strings/string_view.h"
#include "sensor_agent/outbox/observation.h"

namespace rips::sensor {

// Any thread. What it handed out may outlive it.
class PayloadPool {
 public:
  // Estimated bytes of all payloads that are held, kPayloadOverheadBytes for each included.
  explicit PayloadPool(size_t bytes_max) : bytes_max_(bytes_max) {}

  // A copy of `bytes`; null, and counted, if it does not fit.
  Payload Keep(absl::string_view bytes);

  size_t bytes() const { return *held_; }
  // Payloads refused since the last call.
  uint64_t TakeRefused() { return refused_.exchange(0); }

 private:
  const size_t bytes_max_;
  const std::shared_ptr<std::atomic<size_t>> held_ = std::make_shared<std::atomic<size_t>>(0);
  std::atomic<uint64_t> refused_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_MESSAGES_PAYLOAD_POOL_H_

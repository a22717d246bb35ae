#include "sensor_agent/messages/payload_pool.h"

#include <string>

namespace rips::sensor {

Payload PayloadPool::Keep(absl::string_view bytes) {
  const size_t cost = bytes.size() + kPayloadOverheadBytes;
  if (held_->fetch_add(cost) + cost > bytes_max_) {
    *held_ -= cost;
    ++refused_;
    return nullptr;
  }
  return Payload(new std::string(bytes), [held = held_, cost](const std::string* payload) {
    delete payload;
    *held -= cost;
  });
}

}  // namespace rips::sensor

// Whatever packet comes through the socket of rips-fw is decoded only if it is exactly what the
// other end encodes.
#include <cstddef>
#include <cstdint>
#include <string>

#include "mode_actuator/steps/firewall/fw_message.h"
#include "services/base/check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace rips::actuator;  // One translation unit, nothing else in it.
  const std::string input(reinterpret_cast<const char*>(data), size);
  if (const auto request = DecodeFwRequest(input); request.ok()) {
    RIPS_CHECK(EncodeFwRequest(*request) == input, "a request that is encoded otherwise");
    RIPS_CHECK(request->step.hold_for <= kFirewallForMax, "held for too long");
  }
  if (const auto response = DecodeFwResponse(input); response.ok()) {
    RIPS_CHECK(EncodeFwResponse(*response) == input, "a response that is encoded otherwise");
  }
  return 0;
}

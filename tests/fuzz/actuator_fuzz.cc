// Whatever an actuator sends: its hello, receipts and heartbeats are refused or decoded within
// their limits, and what is decoded of them is printable where people read it.
#include <cstddef>
#include <cstdint>
#include <string>

#include "policy_server/server/dispatch/actuator_codec.h"
#include "services/base/check.h"
#include "services/wire_limits/field_limits.h"

namespace rips::dispatch {
namespace {

void Hello(const rips::v1::ActuatorHello& wire) {
  const auto hello = DecodeHello(wire);
  if (!hello.ok()) return;
  RIPS_CHECK(hello->levels.size() <= 64 && hello->programs.size() <= 1'000 &&
                 hello->protected_parts.size() <= 256,
             "past a limit");
}

void Receipt(const rips::v1::Receipt& wire) {
  const auto receipt = DecodeReceipt(wire);
  if (!receipt.ok()) return;
  RIPS_CHECK(receipt->command_id.size() <= 32, "longer than any id");
  RIPS_CHECK(receipt->output_tail.size() <= 64 << 10 && receipt->steps.size() <= 256,
             "past a limit");
  for (const pipeline::StepReport& step : receipt->steps) {
    RIPS_CHECK(step.output_tail.size() <= 4 << 10, "past the limit of a step");
  }
  RIPS_CHECK(DecodeReceipt(wire).value() == *receipt, "the same receipt is decoded otherwise");
}

void Heartbeat(const rips::v1::ActuatorHeartbeat& wire) {
  const pipeline::ActuatorHeartbeat heartbeat = DecodeHeartbeat(wire);
  RIPS_CHECK(heartbeat.boottime_ns >= 0, "a negative time");
  RIPS_CHECK(heartbeat.degraded.size() <= pipeline::kActuatorDegradedMax, "past a limit");
  for (const std::string& line : heartbeat.degraded) {
    RIPS_CHECK(line.size() <= pipeline::kActuatorDegradedBytesMax, "past the limit of a line");
    for (const char c : line) {
      RIPS_CHECK(static_cast<unsigned char>(c) >= 0x20 && c != 0x7f, "not printable");
    }
  }
}

}  // namespace
}  // namespace rips::dispatch

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  rips::v1::ActuatorMessage message;
  if (!message.ParseFromArray(data, static_cast<int>(size))) return 0;
  if (rips::wire_limits::Check(message)) return 0;
  if (message.has_hello()) rips::dispatch::Hello(message.hello());
  if (message.has_receipt()) rips::dispatch::Receipt(message.receipt());
  if (message.has_heartbeat()) rips::dispatch::Heartbeat(message.heartbeat());
  return 0;
}

// Whatever an actuator sends: its hello, receipts and heartbeats are refused or decoded within
// their limits, and what is decoded of them is printable where people read it.
#include <cstddef>
#include <cstdint>
#include <string>

#include "services/base/check.h"
#include "services/model_proto/actuator_codec.h"
#include "services/wire_limits/field_limits.h"

namespace rips::model_proto {
namespace {

void Hello(const rips::v1::ActuatorHello& wire) {
  const auto hello = Decode(wire);
  if (!hello.ok()) return;
  RIPS_CHECK(hello->levels.size() <= 64 && hello->programs.size() <= 1'000 &&
                 hello->protected_parts.size() <= 256 && hello->inactive_parts.size() <= 64 &&
                 hello->published_while_inactive.size() <= model::kTopicsWhileInactiveMax,
             "past a limit");
  for (const model::InactiveParts& inactive : hello->inactive_parts) {
    RIPS_CHECK(inactive.parts.size() <= 256, "past a limit");
  }
}

void Receipt(const rips::v1::Receipt& wire) {
  const auto receipt = Decode(wire);
  if (!receipt.ok()) return;
  RIPS_CHECK(receipt->command_id.size() <= 32, "longer than any id");
  RIPS_CHECK(receipt->output_tail.size() <= 64 << 10 && receipt->steps.size() <= 256,
             "past a limit");
  for (const model::StepResult& step : receipt->steps) {
    RIPS_CHECK(step.output_tail.size() <= 4 << 10, "past the limit of a step");
  }
  RIPS_CHECK(Decode(Encode(*receipt)).value() == *receipt, "not what was encoded");
}

void Heartbeat(const rips::v1::ActuatorHeartbeat& wire) {
  const model::ActuatorHeartbeat heartbeat = Decode(wire);
  RIPS_CHECK(heartbeat.boottime_ns >= 0, "a negative time");
  RIPS_CHECK(heartbeat.degraded.size() <= model::kActuatorDegradedMax, "past a limit");
  for (const std::string& line : heartbeat.degraded) {
    RIPS_CHECK(line.size() <= model::kActuatorDegradedBytesMax, "past the limit of a line");
    for (const char c : line) {
      RIPS_CHECK(static_cast<unsigned char>(c) >= 0x20 && c != 0x7f, "not printable");
    }
  }
}

}  // namespace
}  // namespace rips::model_proto

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  rips::v1::ActuatorMessage message;
  if (!message.ParseFromArray(data, static_cast<int>(size))) return 0;
  if (rips::wire_limits::Check(message)) return 0;
  if (message.has_hello()) rips::model_proto::Hello(message.hello());
  if (message.has_receipt()) rips::model_proto::Receipt(message.receipt());
  if (message.has_heartbeat()) rips::model_proto::Heartbeat(message.heartbeat());
  return 0;
}

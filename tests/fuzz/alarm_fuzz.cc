// Whatever an alarm device answers: it is refused, or understood as something that a device can be,
// and twice the same.
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "absl/strings/string_view.h"
#include "mode_actuator/steps/alarm/frames.h"
#include "services/base/check.h"

namespace rips::actuator {
namespace {

constexpr size_t kInputBytesMax = 4096;  // a longer answer is cut before it is decoded

void TryAll(std::span<const uint8_t> bytes) {
  const absl::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (const auto status = DecodeUsbRelayStatus(bytes); status.ok()) {
    RIPS_CHECK(!status->id.empty() && status->id.size() <= 5, status->id.c_str());
    for (const char c : status->id) RIPS_CHECK(c > 0x20 && c < 0x7f, "an id is printable");
  }
  if (const auto relays = DecodeLcusStatus(text); relays.ok()) {
    RIPS_CHECK(!relays->empty() && relays->size() <= size_t{kAlarmChannelsMax}, "relays");
    RIPS_CHECK(*relays == *DecodeLcusStatus(text), "twice the same");
  }
  if (const auto count = UsbRelayCount(text)) RIPS_CHECK(*count >= 1 && *count <= 8, "relays");
  const auto playing = DecodeBlink1Playing(bytes);
  const auto colour = DecodeBlink1Colour(Blink1AskColour(), bytes);
  const auto line = DecodeBlink1Colour(Blink1AskLine(0), bytes);
  RIPS_CHECK(playing.ok() + colour.ok() + line.ok() <= 1, "one answer fits one question");
  // What is read as a state is written the same.
  for (const AlarmKind kind : {AlarmKind::kUsbRelay, AlarmKind::kBlink1}) {
    if (const auto state = ParseAlarmState(kind, text); state.ok()) {
      RIPS_CHECK(ToString(*state) == text, "written as read");
    }
  }
}

}  // namespace
}  // namespace rips::actuator

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > rips::actuator::kInputBytesMax) return 0;
  rips::actuator::TryAll({data, size});
  return 0;
}

// HID devices through hidapi on hidraw: no driver is detached, and permission is that of the node.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_HID_CHANNEL_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_HID_CHANNEL_H_

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/decide/alarm_state.h"
#include "mode_actuator/steps/alarm/frames.h"
#include "mode_actuator/steps/alarm/io_gate.h"
#include "services/runtime/mutex.h"

struct hid_device_;

namespace rips::actuator {

// Devices of one vendor and product; with more, none of them is identified.
inline constexpr size_t kHidCandidatesMax = 32;

// One opened device. One thread at a time. Unavailable, with the system's words, if the device does
// not take part (unplugged, stalled, ...); Aborted if the gate is closed.
class HidChannel {
 public:
  // Takes `device`. `gate` is not owned and outlives this.
  HidChannel(hid_device_* device, std::string node, IoGate* gate);
  ~HidChannel();
  HidChannel(const HidChannel&) = delete;
  HidChannel& operator=(const HidChannel&) = delete;

  // Frames begin with the report id.
  absl::Status SendFeature(const Frame& frame);
  // `bytes` is the longest answer, report id included; shorter ones are possible.
  absl::StatusOr<Frame> GetFeature(uint8_t report, size_t bytes);
  absl::Status SendOutput(const Frame& frame);
  // OK as long as the device is plugged in.
  absl::Status Probe();

 private:
  absl::Status Finish(absl::string_view what, int result, size_t expected) const;

  hid_device_* const device_;
  const std::string node_;
  IoGate* const gate_;  // Not owned; outlives this.
};

// What is plugged in. Strings come from the device: not trusted.
struct HidCandidate {
  std::string node;  // `/dev/hidraw3`
  std::string product;
  std::string serial;
};

// hidapi itself, whose finding and opening of devices is not thread-safe. At most one at a time in
// a process, shared by its users. Any thread.
class HidLibrary {
 public:
  HidLibrary();
  ~HidLibrary();
  HidLibrary(const HidLibrary&) = delete;
  HidLibrary& operator=(const HidLibrary&) = delete;

  // In the order of the nodes' names. One device that has several interfaces is listed once for
  // each. Aborted if the gate is closed, ResourceExhausted above kHidCandidatesMax.
  absl::StatusOr<std::vector<HidCandidate>> List(const UsbId& id, IoGate* gate)
      ABSL_LOCKS_EXCLUDED(mu_);
  // Unavailable if it cannot be opened.
  absl::StatusOr<std::unique_ptr<HidChannel>> Open(const std::string& node, IoGate* gate)
      ABSL_LOCKS_EXCLUDED(mu_);

 private:
  Mutex mu_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_HID_CHANNEL_H_

#include "mode_actuator/steps/alarm/hid_channel.h"

#include <hidapi.h>
#include <unistd.h>

#include <algorithm>
#include <cwchar>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::actuator {
namespace {

constexpr size_t kDeviceTextMax =
    126;  // USB 2.0 §9.6.7: a string descriptor has no more characters

// Narrowed; what is not ASCII becomes `?`.
std::string Narrow(const wchar_t* text) {
  std::string narrow;
  for (; text != nullptr && *text != 0 && narrow.size() < kDeviceTextMax; ++text) {
    narrow.push_back(*text > 0 && *text < 0x7f ? static_cast<char>(*text) : '?');
  }
  return narrow;
}

}  // namespace

HidChannel::HidChannel(hid_device_* device, std::string node, IoGate* gate)
    : device_(device), node_(std::move(node)), gate_(gate) {}

HidChannel::~HidChannel() { hid_close(device_); }

absl::Status HidChannel::Finish(absl::string_view what, int result, size_t expected) const {
  if (result < 0) {
    return absl::UnavailableError(absl::StrCat(what, " failed on ", node_, ": ",
                                               ros2::Printable(Narrow(hid_error(device_)))));
  }
  if (static_cast<size_t>(result) < expected) {
    return absl::UnavailableError(
        absl::StrCat(what, " on ", node_, ": ", result, " of ", expected, " bytes were taken"));
  }
  return absl::OkStatus();
}

absl::Status HidChannel::SendFeature(const Frame& frame) {
  const IoGate::Exchange exchange(gate_);
  RIPS_RETURN_IF_ERROR(exchange.status());
  return Finish("writing a feature report",
                hid_send_feature_report(device_, frame.data(), frame.size()), frame.size());
}

absl::StatusOr<Frame> HidChannel::GetFeature(uint8_t report, size_t bytes) {
  const IoGate::Exchange exchange(gate_);
  RIPS_RETURN_IF_ERROR(exchange.status());
  Frame frame(bytes);
  frame[0] = report;
  const int result = hid_get_feature_report(device_, frame.data(), frame.size());
  RIPS_RETURN_IF_ERROR(Finish("reading a feature report", result, 0));
  frame.resize(std::min(static_cast<size_t>(result), bytes));
  return frame;
}

absl::Status HidChannel::SendOutput(const Frame& frame) {
  const IoGate::Exchange exchange(gate_);
  RIPS_RETURN_IF_ERROR(exchange.status());
  return Finish("writing", hid_write(device_, frame.data(), frame.size()), frame.size());
}

absl::Status HidChannel::Probe() {
  const IoGate::Exchange exchange(gate_);
  RIPS_RETURN_IF_ERROR(exchange.status());
  Frame ignored(64);
  const int result = hid_read_timeout(device_, ignored.data(), ignored.size(), 0);
  RIPS_RETURN_IF_ERROR(Finish("polling", result, 0));
  if (access(node_.c_str(), F_OK) != 0) {
    return absl::UnavailableError(absl::StrCat(node_, " is gone"));
  }
  return absl::OkStatus();
}

HidLibrary::HidLibrary() { hid_init(); }
HidLibrary::~HidLibrary() { hid_exit(); }

absl::StatusOr<std::vector<HidCandidate>> HidLibrary::List(const UsbId& id, IoGate* gate) {
  const IoGate::Exchange exchange(gate);
  RIPS_RETURN_IF_ERROR(exchange.status());
  MutexLock lock(&mu_);
  std::vector<HidCandidate> candidates;
  hid_device_info* const found = hid_enumerate(id.vendor, id.product);
  for (const hid_device_info* each = found;
       each != nullptr && candidates.size() <= kHidCandidatesMax; each = each->next) {
    if (each->path == nullptr) continue;
    candidates.push_back({each->path, Narrow(each->product_string), Narrow(each->serial_number)});
  }
  hid_free_enumeration(found);
  if (candidates.size() > kHidCandidatesMax) {
    return absl::ResourceExhaustedError(absl::StrFormat(
        "devices with USB id %04x:%04x exceed limit %d", id.vendor, id.product, kHidCandidatesMax));
  }
  std::sort(candidates.begin(), candidates.end(),
            [](const HidCandidate& a, const HidCandidate& b) { return a.node < b.node; });
  return candidates;
}

absl::StatusOr<std::unique_ptr<HidChannel>> HidLibrary::Open(const std::string& node,
                                                             IoGate* gate) {
  const IoGate::Exchange exchange(gate);
  RIPS_RETURN_IF_ERROR(exchange.status());
  MutexLock lock(&mu_);
  hid_device* const device = hid_open_path(node.c_str());
  if (device == nullptr) {
    return absl::UnavailableError(absl::StrCat("cannot open ", node, ": ",
                                               ros2::Printable(Narrow(hid_error(nullptr))),
                                               "; may the group rips-alarm use it?"));
  }
  return std::make_unique<HidChannel>(device, node, gate);
}

}  // namespace rips::actuator

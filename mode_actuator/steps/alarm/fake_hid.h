// HID devices that are not there, for a process that runs under umockdev's preloaded library: the
// real hidapi finds and opens them, its ioctls and writes arrive here. Test code only.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_FAKE_HID_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_FAKE_HID_H_

#include <umockdev.h>

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "mode_actuator/decide/alarm_state.h"
#include "mode_actuator/steps/alarm/frames.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {

// The firmware of one device. Called on the emulation's thread.
class FakeFirmware {
 public:
  virtual ~FakeFirmware() = default;
  // Frames with the report id first, as the kernel takes them.
  virtual void SetFeature(const Frame&) {}
  virtual Frame GetFeature(uint8_t) { return {}; }
  virtual void Output(const Frame&) {}
};

// One device and its troubles. Any thread.
class FakeHid {
 public:
  explicit FakeHid(std::unique_ptr<FakeFirmware> firmware) : firmware_(std::move(firmware)) {}

  // Every exchange fails with this errno; 0 = none does.
  void FailWith(int error);
  // Exchanges do not return until Release().
  void Stick();
  void Release();
  // Answers are `frame` instead of the firmware's; empty = as the firmware says.
  void AnswerWith(Frame frame);
  // Exchanges that did not fail.
  int exchanges() const;
  // The firmware, while no exchange is under way.
  template <typename F>
  auto With(F&& look) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return look(*firmware_);
  }

 private:
  friend class FakeUsb;
  // `request` of hidraw; the result as the system call gives it, and errno in `*error`.
  long Ioctl(unsigned long request, UMockdevIoctlClient* client, int* error);
  long Write(const Frame& frame, int* error);
  // Waits if stuck; the errno to fail with.
  int Admit(MutexLock& lock) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  mutable Mutex mu_;
  CondVar changed_;
  const std::unique_ptr<FakeFirmware> firmware_ ABSL_GUARDED_BY(mu_);
  int error_ ABSL_GUARDED_BY(mu_) = 0;
  bool stuck_ ABSL_GUARDED_BY(mu_) = false;
  Frame answer_ ABSL_GUARDED_BY(mu_);
  int exchanges_ ABSL_GUARDED_BY(mu_) = 0;
};

// Where they are plugged in.
class FakeUsb {
 public:
  struct Port {
    UsbId id;
    std::string product;
    std::string serial;
    int hidraw = 0;  // number of the node
  };

  FakeUsb();
  ~FakeUsb();
  FakeUsb(const FakeUsb&) = delete;
  FakeUsb& operator=(const FakeUsb&) = delete;

  // `device` is not owned and outlives this.
  void Plug(const Port& port, FakeHid* device);
  void Unplug(int hidraw);
  // The directory that stands for `/`.
  std::string root() const;

 private:
  struct Plugged {
    std::string usb_path;
    UMockdevIoctlBase* handler = nullptr;
  };

  UMockdevTestbed* const testbed_;
  std::map<int, Plugged> plugged_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_FAKE_HID_H_

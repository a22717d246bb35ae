#include "mode_actuator/steps/alarm/fake_hid.h"

#include <linux/hidraw.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "gtest/gtest.h"

namespace rips::actuator {
namespace {

// Vendor page, feature and output reports; what is in it does not matter here.
constexpr char kDescriptor[] = "0600FF0901A101150026FF00750895080900B1020900910209008102C0";

// The kernel cuts HID_NAME to this, and hidapi reads no more than 1,023 bytes of a uevent file.
constexpr size_t kHidNameMax = 127;

unsigned Number(unsigned long request) { return _IOC_NR(request); }

}  // namespace

void FakeHid::FailWith(int error) {
  MutexLock lock(&mu_);
  error_ = error;
}

void FakeHid::Stick() {
  MutexLock lock(&mu_);
  stuck_ = true;
}

void FakeHid::Release() {
  MutexLock lock(&mu_);
  stuck_ = false;
  changed_.NotifyAll();
}

void FakeHid::AnswerWith(Frame frame) {
  MutexLock lock(&mu_);
  answer_ = std::move(frame);
}

int FakeHid::exchanges() const {
  MutexLock lock(&mu_);
  return exchanges_;
}

int FakeHid::Admit(MutexLock& lock) {
  while (stuck_) changed_.Wait(lock);
  if (error_ == 0) ++exchanges_;
  return error_;
}

long FakeHid::Ioctl(unsigned long request, UMockdevIoctlClient* client, int* error) {
  const size_t size = _IOC_SIZE(request);
  UMockdevIoctlData* const argument = umockdev_ioctl_client_get_arg(client);
  UMockdevIoctlData* const data = umockdev_ioctl_data_resolve(argument, 0, size, nullptr);
  if (data == nullptr) {
    *error = EFAULT;
    return -1;
  }
  MutexLock lock(&mu_);
  long result = -1;
  if (Number(request) == Number(HIDIOCGRDESCSIZE)) {
    int bytes = static_cast<int>((sizeof(kDescriptor) - 1) / 2);
    umockdev_ioctl_data_update(data, 0, reinterpret_cast<guint8*>(&bytes), sizeof(bytes));
    result = 0;
  } else if (const int refused = Admit(lock); refused != 0) {
    *error = refused;
  } else if (Number(request) == Number(HIDIOCSFEATURE(0))) {
    firmware_->SetFeature(Frame(data->data, data->data + size));
    result = static_cast<long>(size);
  } else if (Number(request) == Number(HIDIOCGFEATURE(0))) {
    Frame answer = answer_.empty() ? firmware_->GetFeature(data->data[0]) : answer_;
    answer.resize(std::min(answer.size(), size));
    umockdev_ioctl_data_update(data, 0, answer.data(), static_cast<gint>(answer.size()));
    result = static_cast<long>(answer.size());
  } else {
    *error = ENOTTY;
  }
  g_object_unref(data);
  return result;
}

long FakeHid::Write(const Frame& frame, int* error) {
  MutexLock lock(&mu_);
  *error = Admit(lock);
  if (*error != 0) return -1;
  firmware_->Output(frame);
  return static_cast<long>(frame.size());
}

FakeUsb::FakeUsb() : testbed_(umockdev_testbed_new()) {}

FakeUsb::~FakeUsb() {
  while (!plugged_.empty()) Unplug(plugged_.begin()->first);
  g_object_unref(testbed_);
}

std::string FakeUsb::root() const {
  gchar* const directory = umockdev_testbed_get_root_dir(testbed_);
  std::string copy = directory;
  g_free(directory);
  return copy;
}

void FakeUsb::Plug(const Port& port, FakeHid* device) {
  const std::string node = absl::StrCat("hidraw", port.hidraw);
  const std::string usb = absl::StrCat("/devices/usb1/1-", port.hidraw + 1);
  const std::string interface = absl::StrCat(usb, "/1-", port.hidraw + 1, ":1.0");
  const std::string hid_name =
      absl::StrFormat("0003:%04X:%04X.%04X", port.id.vendor, port.id.product, port.hidraw + 1);
  const std::string hid = absl::StrCat(interface, "/", hid_name);
  const std::string text = absl::StrCat(
      "P: ", usb, "\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\nA: idVendor=",
      absl::StrFormat("%04x", port.id.vendor),
      "\nA: idProduct=", absl::StrFormat("%04x", port.id.product),
      "\nA: manufacturer=www.dcttech.com\nA: product=", port.product,
      "\nA: bcdDevice=0100\n\nP: ", interface,
      "\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_interface\nA: bInterfaceNumber=00\n\nP: ", hid,
      "\nE: SUBSYSTEM=hid\nE: HID_ID=",
      absl::StrFormat("0003:%08X:%08X", port.id.vendor, port.id.product),
      "\nE: HID_NAME=", port.product.substr(0, kHidNameMax), "\nE: HID_UNIQ=", port.serial,
      "\nH: report_descriptor=", kDescriptor, "\n\nP: ", hid, "/hidraw/", node, "\nN: ", node,
      "\nL: device=../../../", hid_name, "\nE: SUBSYSTEM=hidraw\nE: DEVNAME=/dev/", node, "\n");
  GError* error = nullptr;
  ASSERT_TRUE(umockdev_testbed_add_from_string(testbed_, text.c_str(), &error)) << error->message;

  Plugged plugged = {usb, umockdev_ioctl_base_new()};
  g_signal_connect(
      plugged.handler, "handle-ioctl",
      G_CALLBACK(+[](UMockdevIoctlBase*, UMockdevIoctlClient* client, gpointer fake) -> gboolean {
        int failed = 0;
        const long result = static_cast<FakeHid*>(fake)->Ioctl(
            umockdev_ioctl_client_get_request(client), client, &failed);
        umockdev_ioctl_client_complete(client, result, failed);
        return TRUE;
      }),
      device);
  g_signal_connect(
      plugged.handler, "handle-write",
      G_CALLBACK(+[](UMockdevIoctlBase*, UMockdevIoctlClient* client, gpointer fake) -> gboolean {
        const UMockdevIoctlData* data = umockdev_ioctl_client_get_arg(client);
        int failed = 0;
        const long result = static_cast<FakeHid*>(fake)->Write(
            Frame(data->data, data->data + data->data_len), &failed);
        umockdev_ioctl_client_complete(client, result, failed);
        return TRUE;
      }),
      device);
  const std::string path = absl::StrCat("/dev/", node);
  ASSERT_TRUE(umockdev_testbed_attach_ioctl(testbed_, path.c_str(), plugged.handler, &error))
      << error->message;
  plugged_.emplace(port.hidraw, plugged);
}

void FakeUsb::Unplug(int hidraw) {
  const Plugged plugged = plugged_.at(hidraw);
  const std::string path = absl::StrCat("/dev/hidraw", hidraw);
  umockdev_testbed_detach_ioctl(testbed_, path.c_str(), nullptr);
  umockdev_testbed_remove_device(testbed_, absl::StrCat("/sys", plugged.usb_path).c_str());
  // The kernel takes the node away as well.
  std::filesystem::remove(root() + path);
  g_object_unref(plugged.handler);
  plugged_.erase(hidraw);
}

}  // namespace rips::actuator

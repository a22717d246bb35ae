#include "mode_actuator/steps/alarm/drivers.h"

#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "mode_actuator/steps/alarm/frames.h"
#include "mode_actuator/steps/alarm/hid_channel.h"
#include "mode_actuator/steps/alarm/tty_channel.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::actuator {
namespace {

using Answer = AlarmReading::Answer;

// A board on a serial line has answered by then, if it answers at all.
constexpr absl::Duration kLcusFirstWait = absl::Milliseconds(300);
// A blink(1) needs a moment before its answer is in place.
constexpr absl::Duration kBlink1Pause = absl::Milliseconds(10);
constexpr int kBlink1Reads = 10;
constexpr size_t kNamedMax = 8;  // devices listed in one message

AlarmReading Compared(std::string subject, const AlarmState& is, const AlarmState& wanted) {
  return {is == wanted ? Answer::kAsWanted : Answer::kOther, std::move(subject), ToString(is)};
}

AlarmReading RelayReading(int channel, bool on, const AlarmState& wanted) {
  const AlarmState is = {on ? AlarmPattern::kOn : AlarmPattern::kOff, {}};
  return Compared(absl::StrCat("relay ", channel), is, wanted);
}

absl::Status NoSuchRelay(int channel, size_t count) {
  return absl::OutOfRangeError(
      absl::StrCat("the board has no relay ", channel, ": it has ", count));
}

// A device keeps the library alive.
struct HidDevice {
  std::shared_ptr<HidLibrary> library;
  HidCandidate candidate;
  std::unique_ptr<HidChannel> channel;  // goes before the library
};

class UsbRelay final : public AlarmDevice {
 public:
  UsbRelay(HidDevice hid, int count) : hid_(std::move(hid)), count_(count) {}

  absl::Status Set(int channel, const AlarmState& state) override {
    if (channel > count_) return NoSuchRelay(channel, static_cast<size_t>(count_));
    return hid_.channel->SendFeature(UsbRelayFrame(channel, state.pattern == AlarmPattern::kOn));
  }
  absl::StatusOr<AlarmReading> Read(int channel, const AlarmState& wanted) override {
    if (channel > count_) return NoSuchRelay(channel, static_cast<size_t>(count_));
    RIPS_ASSIGN_OR_RETURN(const Frame report, hid_.channel->GetFeature(0, kUsbRelayFrameBytes));
    RIPS_ASSIGN_OR_RETURN(const UsbRelayStatus status, DecodeUsbRelayStatus(report));
    return RelayReading(channel, ((status.relays >> (channel - 1)) & 1) != 0, wanted);
  }

 private:
  const HidDevice hid_;
  const int count_;
};

Frame LcusReport(int channel, const AlarmState& state) {
  Frame frame = LcusFrame(channel, state.pattern == AlarmPattern::kOn);
  frame.insert(frame.begin(), 0);
  return frame;
}

// A device that takes output reports and cannot be read back.
class OutputOnly final : public AlarmDevice {
 public:
  using FrameOf = Frame (*)(int channel, const AlarmState& state);
  OutputOnly(HidDevice hid, FrameOf frame_of) : hid_(std::move(hid)), frame_of_(frame_of) {}
  absl::Status Set(int channel, const AlarmState& state) override {
    return hid_.channel->SendOutput(frame_of_(channel, state));
  }
  absl::StatusOr<AlarmReading> Read(int, const AlarmState&) override {
    RIPS_RETURN_IF_ERROR(hid_.channel->Probe());
    return AlarmReading{};
  }

 private:
  const HidDevice hid_;
  const FrameOf frame_of_;
};

class LcusSerial final : public AlarmDevice {
 public:
  explicit LcusSerial(std::unique_ptr<TtyChannel> line) : line_(std::move(line)) {}

  absl::Status Set(int channel, const AlarmState& state) override {
    return line_->Write(LcusFrame(channel, state.pattern == AlarmPattern::kOn));
  }
  absl::StatusOr<AlarmReading> Read(int channel, const AlarmState& wanted) override {
    if (answers_ == false) {
      RIPS_RETURN_IF_ERROR(line_->Probe());
      return AlarmReading{};
    }
    RIPS_ASSIGN_OR_RETURN(const std::string answer, line_->Ask({kLcusQuery}, kLcusFirstWait));
    if (answer.empty()) {
      // Many boards do not know the query; one that did and is silent now is in trouble.
      if (answers_ == true) return absl::DeadlineExceededError("the board no longer answers");
      answers_ = false;
      return AlarmReading{};
    }
    RIPS_ASSIGN_OR_RETURN(const std::vector<bool> relays, DecodeLcusStatus(answer));
    answers_ = true;
    const auto index = static_cast<size_t>(channel - 1);
    if (index >= relays.size()) return NoSuchRelay(channel, relays.size());
    return RelayReading(channel, relays[index], wanted);
  }

 private:
  const std::unique_ptr<TtyChannel> line_;
  std::optional<bool> answers_;  // nullopt: not asked yet
};

class Blink1 final : public AlarmDevice {
 public:
  explicit Blink1(HidDevice hid) : hid_(std::move(hid)) {}

  absl::Status Set(int, const AlarmState& state) override {
    for (const Frame& frame : Blink1Frames(state)) {
      RIPS_RETURN_IF_ERROR(hid_.channel->SendFeature(frame));
    }
    return absl::OkStatus();
  }
  absl::StatusOr<AlarmReading> Read(int, const AlarmState& wanted) override {
    RIPS_ASSIGN_OR_RETURN(const Frame report, Ask(Blink1AskPlaying()));
    RIPS_ASSIGN_OR_RETURN(const Blink1Playing playing, DecodeBlink1Playing(report));
    Colour now;
    std::vector<Colour> lines;
    if (playing.playing) {
      for (const uint8_t line : {0, 1}) {
        RIPS_ASSIGN_OR_RETURN(const Colour colour, AskColour(Blink1AskLine(line)));
        lines.push_back(colour);
      }
    } else {
      RIPS_ASSIGN_OR_RETURN(now, AskColour(Blink1AskColour()));
    }
    const std::optional<AlarmState> is = Blink1State(playing, now, lines);
    if (is.has_value()) return Compared("the light", *is, wanted);
    return AlarmReading{Answer::kOther, "the light", "in a pattern of its own"};
  }

 private:
  // Until the answer is to this question, and kBlink1Reads times at most.
  absl::StatusOr<Frame> Ask(const Frame& question) {
    RIPS_RETURN_IF_ERROR(hid_.channel->SendFeature(question));
    Frame answer;
    for (int i = 0; i < kBlink1Reads; ++i) {
      RIPS_ASSIGN_OR_RETURN(answer, hid_.channel->GetFeature(kBlink1Report, kBlink1FrameBytes));
      if (answer.size() > 1 && answer[1] == question[1]) break;
      usleep(static_cast<useconds_t>(absl::ToInt64Microseconds(kBlink1Pause)));
    }
    return answer;
  }
  absl::StatusOr<Colour> AskColour(const Frame& question) {
    RIPS_ASSIGN_OR_RETURN(const Frame answer, Ask(question));
    return DecodeBlink1Colour(question, answer);
  }

  const HidDevice hid_;
};

// --- finding

std::string Wanted(const AlarmSpec& spec) {
  const absl::string_view kind = AlarmKindName(spec.kind);
  if (!spec.path.empty()) return absl::StrCat(kind, " at `", spec.path, "`");
  return absl::StrCat(kind, " with serial `", spec.serial, "`");
}

std::string OfShown(const std::vector<std::string>& names) {
  if (names.empty()) return "none is plugged in";
  std::vector<std::string> shown;
  for (const std::string& name : names) {
    if (shown.size() == kNamedMax) break;
    shown.push_back(absl::StrCat("`", ros2::Printable(name), "`"));
  }
  const bool all = shown.size() == names.size();
  return absl::StrCat("plugged in: ", absl::StrJoin(shown, ", "), all ? "" : ", ...");
}

// True if `path`, a link, leads to `node` now.
absl::StatusOr<bool> LeadsTo(const std::string& path, const std::string& node) {
  struct stat there;
  if (stat(path.c_str(), &there) != 0) {
    if (errno == ENOENT) {
      return absl::NotFoundError(absl::StrCat("no `", path, "`; is the device plugged in?"));
    }
    return absl::UnavailableError(absl::StrCat("`", path, "`: ", std::strerror(errno)));
  }
  struct stat here;
  if (stat(node.c_str(), &here) != 0) return false;
  return there.st_dev == here.st_dev && there.st_ino == here.st_ino;
}

// Takes one device by node from `candidates`, or the one whose serial is that of `spec`.
class Finder {
 public:
  Finder(const AlarmSpec& spec, std::shared_ptr<HidLibrary> library, IoGate* gate)
      : spec_(spec), library_(std::move(library)), gate_(gate) {}

  absl::StatusOr<HidDevice> Find() {
    RIPS_ASSIGN_OR_RETURN(std::vector<HidCandidate> candidates,
                          library_->List(UsbIdOf(spec_.kind), gate_));
    if (spec_.kind == AlarmKind::kUsbRelay) {
      std::erase_if(candidates, [this](const HidCandidate& each) { return IsForeign(each); });
    }
    if (!spec_.path.empty()) return ByPath(candidates);
    return BySerial(candidates);
  }

 private:
  // The vendor and product id of the relay boards is that of many devices.
  bool IsForeign(const HidCandidate& candidate) {
    if (UsbRelayCount(candidate.product).has_value()) return false;
    foreign_.push_back(candidate.product);
    return true;
  }

  absl::StatusOr<HidDevice> Open(const HidCandidate& candidate) {
    RIPS_ASSIGN_OR_RETURN(auto channel, library_->Open(candidate.node, gate_));
    return HidDevice{library_, candidate, std::move(channel)};
  }

  absl::StatusOr<HidDevice> ByPath(const std::vector<HidCandidate>& candidates) {
    // The path is checked first, so that a missing one is reported as missing.
    RIPS_RETURN_IF_ERROR(LeadsTo(spec_.path, spec_.path).status());
    for (const HidCandidate& candidate : candidates) {
      RIPS_ASSIGN_OR_RETURN(const bool is_it, LeadsTo(spec_.path, candidate.node));
      if (is_it) return Open(candidate);
    }
    return absl::NotFoundError(
        absl::StrCat("`", spec_.path, "` is no ", AlarmKindName(spec_.kind), Foreign()));
  }

  absl::StatusOr<HidDevice> BySerial(const std::vector<HidCandidate>& candidates) {
    std::optional<HidDevice> found;
    std::vector<std::string> others;
    absl::Status trouble;  // of a device that may have been the one
    std::string last_node;
    for (const HidCandidate& candidate : candidates) {
      if (candidate.node == std::exchange(last_node, candidate.node)) continue;
      absl::StatusOr<HidDevice> device = Identify(candidate, &others);
      if (device.ok()) {
        if (found.has_value()) {
          return absl::UnavailableError(
              absl::StrCat("there are two: ", Wanted(spec_), "; name it by `path`"));
        }
        found = *std::move(device);
      } else if (absl::IsAborted(device.status())) {
        return device.status();
      } else if (!absl::IsNotFound(device.status())) {
        trouble = device.status();
      }
    }
    if (found.has_value()) return *std::move(found);
    if (!trouble.ok()) return trouble;
    return absl::NotFoundError(
        absl::StrCat("no ", Wanted(spec_), "; ", OfShown(others), Foreign()));
  }

  // NotFound if it is another one; then its serial is added to `others`.
  absl::StatusOr<HidDevice> Identify(const HidCandidate& candidate,
                                     std::vector<std::string>* others) {
    if (spec_.kind != AlarmKind::kUsbRelay) {
      if (candidate.serial == spec_.serial) return Open(candidate);
      others->push_back(candidate.serial);
      return absl::NotFoundError("another one");
    }
    // These boards have no USB serial number, only an id that they answer.
    RIPS_ASSIGN_OR_RETURN(HidDevice device, Open(candidate));
    RIPS_ASSIGN_OR_RETURN(const Frame report, device.channel->GetFeature(0, kUsbRelayFrameBytes));
    RIPS_ASSIGN_OR_RETURN(const UsbRelayStatus status, DecodeUsbRelayStatus(report));
    if (status.id == spec_.serial) return device;
    others->push_back(status.id);
    return absl::NotFoundError("another one");
  }

  std::string Foreign() const {
    if (foreign_.empty()) return "";
    return absl::StrCat("; not a relay board, though of the same USB id: `",
                        ros2::Printable(foreign_.front()), "`");
  }

  const AlarmSpec& spec_;
  const std::shared_ptr<HidLibrary> library_;
  IoGate* const gate_;  // Not owned; outlives this.
  std::vector<std::string> foreign_;
};

absl::StatusOr<std::unique_ptr<AlarmDevice>> OpenReal(const std::shared_ptr<HidLibrary>& library,
                                                      const AlarmSpec& spec, IoGate* gate) {
  std::optional<HidDevice> hid;
  if (BusOf(spec.kind) == AlarmBus::kHidraw) {
    RIPS_ASSIGN_OR_RETURN(hid, Finder(spec, library, gate).Find());
  }
  switch (spec.kind) {
    case AlarmKind::kUsbRelay: {
      const int count = UsbRelayCount(hid->candidate.product).value_or(0);
      return std::make_unique<UsbRelay>(*std::move(hid), count);
    }
    case AlarmKind::kLcus:
      return std::make_unique<OutputOnly>(*std::move(hid), LcusReport);
    case AlarmKind::kLcusSerial: {
      RIPS_ASSIGN_OR_RETURN(auto line, TtyChannel::Open(spec.path, gate));
      return std::make_unique<LcusSerial>(std::move(line));
    }
    case AlarmKind::kLuxafor:
      return std::make_unique<OutputOnly>(
          *std::move(hid), [](int, const AlarmState& state) { return LuxaforFrame(state); });
    case AlarmKind::kBlink1:
      return std::make_unique<Blink1>(*std::move(hid));
  }
  return absl::InternalError("no driver of this kind");
}

}  // namespace

OpenAlarm RealAlarms() {
  return [library = std::make_shared<HidLibrary>()](const AlarmSpec& spec, IoGate* gate) {
    return OpenReal(library, spec, gate);
  };
}

}  // namespace rips::actuator

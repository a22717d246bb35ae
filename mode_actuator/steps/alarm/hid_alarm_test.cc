// HID alarms through the real hidapi, on devices emulated by umockdev.
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/alarm/alarm_board.h"
#include "mode_actuator/steps/alarm/alarm_test_order.h"
#include "mode_actuator/steps/alarm/drivers.h"
#include "mode_actuator/steps/alarm/fake_hid.h"
#include "mode_actuator/steps/alarm/hid_channel.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

using absl::StatusCode;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr AlarmState kSteadyGreen = {AlarmPattern::kSteady, {0, 0xff, 0}};
constexpr AlarmState kStrobeRed = {AlarmPattern::kStrobe, {0xff, 0, 0}};
constexpr AlarmState kPolice = {AlarmPattern::kPolice, {}};

// A V-USB relay board.
class RelayBoard final : public FakeFirmware {
 public:
  explicit RelayBoard(std::string serial) : id(std::move(serial)) {}
  void SetFeature(const Frame& frame) override {
    ASSERT_EQ(frame.size(), 9u);
    if (dead) return;
    const auto bit = static_cast<uint8_t>(1 << (frame[2] - 1));
    if (frame[1] == 0xff) relays |= bit;
    if (frame[1] == 0xfd) relays &= static_cast<uint8_t>(~bit);
  }
  Frame GetFeature(uint8_t report) override {
    Frame frame(9);
    frame[0] = report;
    std::copy(id.begin(), id.end(), frame.begin() + 1);
    frame[8] = relays;
    return frame;
  }
  const std::string id;
  uint8_t relays = 0;
  bool dead = false;  // takes orders and does nothing
};

class BlinkLight final : public FakeFirmware {
 public:
  void SetFeature(const Frame& frame) override {
    ASSERT_EQ(frame.size(), kBlink1FrameBytes);
    ASSERT_EQ(frame[0], kBlink1Report);
    answer = frame;
    switch (frame[1]) {
      case 'n':
        colour = {frame[2], frame[3], frame[4]};
        break;
      case 'P':
        lines[frame[7] % 32] = {frame[2], frame[3], frame[4]};
        break;
      case 'p':
        playing = frame[2];
        first = frame[3];
        last = frame[4];
        break;
      case 'S':
        answer = {1, 'S', playing, first, last, 0, 0, 0, 0};
        break;
      case 'r':
        answer = {1, 'r', colour.red, colour.green, colour.blue, 0, 0, 0, 0};
        break;
      case 'R': {
        const Colour& line = lines[frame[7] % 32];
        answer = {1, 'R', line.red, line.green, line.blue, 0, 25, frame[7], 0};
        break;
      }
      default:
        ADD_FAILURE() << "unknown order " << frame[1];
    }
  }
  Frame GetFeature(uint8_t) override { return answer; }

  Colour colour;
  Colour lines[32];
  uint8_t playing = 0, first = 0, last = 0;
  Frame answer;
};

// Takes whatever is written.
class Listener final : public FakeFirmware {
 public:
  void Output(const Frame& frame) override { heard = frame; }
  Frame heard;
};

class HidAlarmTest : public ::testing::Test {
 protected:
  void SetUp() override {
    // First: what the emulation does inside is not for sanitizers, either.
    const char* preloaded = std::getenv("LD_PRELOAD");
    if (preloaded == nullptr || std::strstr(preloaded, "umockdev") == nullptr) {
      GTEST_SKIP() << "no emulated devices: umockdev's library is not preloaded (it cannot be "
                      "under sanitizers; otherwise use ctest, or umockdev-wrapper)";
    }
    usb_ = std::make_unique<FakeUsb>();
    ASSERT_TRUE(umockdev_in_mock_environment());
  }
  void TearDown() override {
    for (const auto& device : devices_) device->Release();
    alarms_.reset();
    usb_.reset();
  }

  template <typename F, typename... Args>
  FakeHid* Make(Args&&... args) {
    devices_.push_back(std::make_unique<FakeHid>(std::make_unique<F>(std::forward<Args>(args)...)));
    return devices_.back().get();
  }
  FakeHid* PlugRelay(int hidraw, const std::string& id, const std::string& product = "USBRelay2") {
    FakeHid* board = Make<RelayBoard>(id);
    usb_->Plug({UsbIdOf(AlarmKind::kUsbRelay), product, "", hidraw}, board);
    return board;
  }
  static uint8_t Relays(FakeHid* board) {
    return board->With([](FakeFirmware& each) { return static_cast<RelayBoard&>(each).relays; });
  }
  static Frame Heard(FakeHid* listener) {
    return listener->With([](FakeFirmware& each) { return static_cast<Listener&>(each).heard; });
  }
  void Start(std::vector<AlarmSpec> specs, absl::Duration io_budget = kTestIoBudget) {
    alarms_ = std::make_unique<AlarmBoard>(specs, RealAlarms(), &clock_, io_budget);
  }
  static AlarmSpec Relay(const std::string& name, const std::string& serial, int channel = 1) {
    return {name, AlarmKind::kUsbRelay, serial, "", channel};
  }

  RealClock clock_;
  std::unique_ptr<FakeUsb> usb_;
  std::vector<std::unique_ptr<FakeHid>> devices_;
  std::unique_ptr<AlarmBoard> alarms_;
};

// --- relay boards

TEST_F(HidAlarmTest, SwitchesARelayAndReadsItBack) {
  FakeHid* board = PlugRelay(0, "A1B2C");
  Start({Relay("a1", "A1B2C", 1), Relay("a2", "A1B2C", 2)});
  const AlarmResult on = SetAlarm(*alarms_, "a2", kTestOn);
  EXPECT_THAT(on.status, IsOk());
  EXPECT_EQ(on.detail, "relay 2 is on (read back)");
  EXPECT_EQ(Relays(board), 2);
  EXPECT_THAT(SetAlarm(*alarms_, "a1", kTestOn).status, IsOk());
  EXPECT_EQ(Relays(board), 3);
  EXPECT_THAT(SetAlarm(*alarms_, "a2", kTestOff).status, IsOk());
  EXPECT_EQ(Relays(board), 1);
}

TEST_F(HidAlarmTest, TellsEqualBoardsApartByTheirId) {
  FakeHid* left = PlugRelay(0, "LEFT1");
  FakeHid* right = PlugRelay(1, "RIGHT");
  Start({Relay("right", "RIGHT"), Relay("left", "LEFT1"), Relay("third", "THIRD")});
  EXPECT_THAT(SetAlarm(*alarms_, "right", kTestOn).status, IsOk());
  EXPECT_EQ(Relays(left), 0);
  EXPECT_EQ(Relays(right), 1);
  EXPECT_THAT(
      SetAlarm(*alarms_, "third", kTestOn).status,
      StatusIs(StatusCode::kNotFound,
               HasSubstr("no usb_relay with serial `THIRD`; plugged in: `LEFT1`, `RIGHT`")));
}

TEST_F(HidAlarmTest, TwoBoardsWithOneIdAreNotGuessedAt) {
  FakeHid* one = PlugRelay(0, "TWINS");
  FakeHid* two = PlugRelay(1, "TWINS");
  Start({Relay("a", "TWINS")});
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status,
              StatusIs(StatusCode::kUnavailable, HasSubstr("name it by `path`")));
  EXPECT_EQ(Relays(one) | Relays(two), 0);
}

TEST_F(HidAlarmTest, AForeignDeviceWithTheSharedIdIsNeverTouched) {
  FakeHid* keyboard = PlugRelay(0, "A1B2C", "Key\x1b[2Jboard");
  Start({Relay("a", "A1B2C")});
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status,
              StatusIs(StatusCode::kNotFound,
                       AllOf(HasSubstr("not a relay board, though of the same USB id"),
                             Not(HasSubstr("\x1b")))));
  EXPECT_EQ(keyboard->exchanges(), 0);
}

TEST_F(HidAlarmTest, ALongProductStringIsCut) {
  PlugRelay(0, "A1B2C", "USBRelay2" + std::string(1000, 'x'));
  Start({Relay("a", "A1B2C")});
  const AlarmResult result = SetAlarm(*alarms_, "a", kTestOn);
  EXPECT_THAT(result.status, StatusIs(StatusCode::kNotFound, HasSubstr("USBRelay2xxx")));
  EXPECT_LT(result.status.message().size(), 300u);
}

TEST_F(HidAlarmTest, DevicesOfOneIdHaveALimit) {
  const UsbId id = UsbIdOf(AlarmKind::kLuxafor);
  FakeHid* light = Make<Listener>();
  int plugged = 0;
  for (; plugged < static_cast<int>(kHidCandidatesMax); ++plugged) {
    usb_->Plug({id, "LUXAFOR FLAG", absl::StrCat("LX", plugged), plugged}, light);
  }
  Start({{"flag", AlarmKind::kLuxafor, "LX31", "", 1}, {"none", AlarmKind::kLuxafor, "LX", "", 1}});
  EXPECT_THAT(SetAlarm(*alarms_, "flag", kPolice).status, IsOk());
  EXPECT_THAT(SetAlarm(*alarms_, "none", kPolice).status,
              StatusIs(StatusCode::kNotFound, AllOf(HasSubstr("`LX0`, "), HasSubstr(", ..."))));
  usb_->Plug({id, "LUXAFOR FLAG", "LX", plugged}, light);
  EXPECT_THAT(SetAlarm(*alarms_, "none", kPolice).status,
              StatusIs(StatusCode::kResourceExhausted,
                       HasSubstr("devices with USB id 04d8:f372 exceed limit 32")));
}

TEST_F(HidAlarmTest, ARelayThatTheBoardDoesNotHave) {
  FakeHid* board = PlugRelay(0, "A1B2C", "USBRelay1");
  Start({Relay("a", "A1B2C", 2)});
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status,
              StatusIs(StatusCode::kOutOfRange, HasSubstr("no relay 2: it has 1")));
  EXPECT_EQ(Relays(board), 0);
}

TEST_F(HidAlarmTest, ABoardThatDoesNotSwitchIsFoundOut) {
  FakeHid* board = PlugRelay(0, "A1B2C");
  board->With([](FakeFirmware& each) { static_cast<RelayBoard&>(each).dead = true; });
  Start({Relay("a", "A1B2C")});
  const AlarmResult on = SetAlarm(*alarms_, "a", kTestOn);
  EXPECT_THAT(on.status, StatusIs(StatusCode::kFailedPrecondition,
                                  HasSubstr("relay 1 is off (read back), not on")));
  EXPECT_EQ(on.observed, "off");
}

TEST_F(HidAlarmTest, AnInputOutputErrorFailsAndTheNextTryWorks) {
  FakeHid* board = PlugRelay(0, "A1B2C");
  Start({Relay("a", "A1B2C")});
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOff).status, IsOk());
  for (const int error : {EIO, ENODEV, EPIPE}) {
    board->FailWith(error);
    EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status, StatusIs(StatusCode::kUnavailable))
        << error;
    EXPECT_EQ(Relays(board), 0);
    board->FailWith(0);
    EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOff).status, IsOk());
  }
}

TEST_F(HidAlarmTest, AnswersThatMakeNoSenseAreFailures) {
  FakeHid* board = PlugRelay(0, "A1B2C");
  Start({Relay("a", "A1B2C")});
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOff).status, IsOk());
  for (const Frame& answer : {Frame{0}, Frame{0, 'A', '1', 'B', '2', 'C', 0, 0},
                              Frame{7, 'A', '1', 'B', '2', 'C', 0, 0, 1},
                              Frame{0, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff}}) {
    board->AnswerWith(answer);
    EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status, StatusIs(StatusCode::kDataLoss));
    board->AnswerWith({});
    EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status, IsOk());
  }
}

TEST_F(HidAlarmTest, AnotherBoardsGarbageDoesNotHideOurs) {
  PlugRelay(0, "BROKE")->AnswerWith({0, 1, 2, 3});
  FakeHid* board = PlugRelay(1, "A1B2C");
  Start({Relay("a", "A1B2C"), Relay("b", "BROKE")});
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status, IsOk());
  EXPECT_EQ(Relays(board), 1);
  EXPECT_THAT(SetAlarm(*alarms_, "b", kTestOn).status, StatusIs(StatusCode::kDataLoss));
}

TEST_F(HidAlarmTest, UnpluggedAndPluggedInElsewhere) {
  Start({Relay("a", "A1B2C")});
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status,
              StatusIs(StatusCode::kNotFound, HasSubstr("none is plugged in")));
  FakeHid* first = PlugRelay(3, "A1B2C");
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status, IsOk());

  first->FailWith(ENODEV);
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOff).status, StatusIs(StatusCode::kUnavailable));
  usb_->Unplug(3);
  EXPECT_THAT(ReadAlarm(*alarms_, "a", kTestOn).status, StatusIs(StatusCode::kNotFound));
  EXPECT_EQ(alarms_->missing(), 1u);

  // Another number, and its relay is off again, as it loses power.
  FakeHid* second = PlugRelay(5, "A1B2C");
  EXPECT_THAT(ReadAlarm(*alarms_, "a", kTestOn).status, StatusIs(StatusCode::kFailedPrecondition));
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status, IsOk());
  EXPECT_EQ(Relays(second), 1);
  EXPECT_EQ(alarms_->missing(), 0u);
}

TEST_F(HidAlarmTest, AStuckBoardFailsInTimeAndRecovers) {
  FakeHid* board = PlugRelay(0, "A1B2C");
  Start({Relay("a", "A1B2C")}, kAlarmIoBudget);
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOff).status, IsOk());
  board->Stick();
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status,
              StatusIs(StatusCode::kDeadlineExceeded, HasSubstr("within 500ms")));
  board->Release();
  AlarmResult result;
  for (int i = 0; i < 4000 && result.observed != "off"; ++i) {
    result = SetAlarm(*alarms_, "a", kTestOff);
    absl::SleepFor(absl::Milliseconds(5));
  }
  EXPECT_THAT(result.status, IsOk());
  EXPECT_EQ(Relays(board), 0);
}

TEST_F(HidAlarmTest, ALinkNamesABoardWhereItIsPluggedIn) {
  PlugRelay(0, "TWINS");
  FakeHid* two = PlugRelay(1, "TWINS");
  const std::string directory = usb_->root() + "/dev/rips-alarm";
  ASSERT_TRUE(std::filesystem::create_directories(directory));
  std::filesystem::create_symlink("../hidraw1", directory + "/port2");
  std::filesystem::create_symlink("../null", directory + "/other");
  Start({{"a", AlarmKind::kUsbRelay, "", "/dev/rips-alarm/port2", 1},
         {"b", AlarmKind::kUsbRelay, "", "/dev/rips-alarm/port7", 1},
         {"c", AlarmKind::kLuxafor, "", "/dev/rips-alarm/port2", 1}});
  EXPECT_THAT(SetAlarm(*alarms_, "a", kTestOn).status, IsOk());
  EXPECT_EQ(Relays(two), 1);
  EXPECT_THAT(SetAlarm(*alarms_, "b", kTestOn).status,
              StatusIs(StatusCode::kNotFound, HasSubstr("no `/dev/rips-alarm/port7`")));
  EXPECT_THAT(SetAlarm(*alarms_, "c", kSteadyGreen).status,
              StatusIs(StatusCode::kNotFound, HasSubstr("is no luxafor")));
}

// --- devices that are only told

TEST_F(HidAlarmTest, TellsALuxaforAndSaysThatItCannotBeReadBack) {
  FakeHid* light = Make<Listener>();
  usb_->Plug({UsbIdOf(AlarmKind::kLuxafor), "LUXAFOR FLAG", "LX1", 0}, light);
  Start({{"flag", AlarmKind::kLuxafor, "LX1", "", 1}});
  const AlarmResult strobe = SetAlarm(*alarms_, "flag", kStrobeRed);
  EXPECT_THAT(strobe.status, IsOk());
  EXPECT_EQ(strobe.detail, "sent; this device cannot be read back");
  EXPECT_EQ(Heard(light), LuxaforFrame(kStrobeRed));
  EXPECT_THAT(ReadAlarm(*alarms_, "flag", kStrobeRed).status, IsOk());
  EXPECT_THAT(ReadAlarm(*alarms_, "flag", kTestOff).status,
              StatusIs(StatusCode::kFailedPrecondition));

  light->FailWith(EIO);
  EXPECT_THAT(SetAlarm(*alarms_, "flag", kTestOff).status, StatusIs(StatusCode::kUnavailable));
  light->FailWith(0);
  EXPECT_THAT(ReadAlarm(*alarms_, "flag", kStrobeRed).status,
              StatusIs(StatusCode::kFailedPrecondition, HasSubstr("plugged in again")));
}

TEST_F(HidAlarmTest, ALookSeesThatALightWasPulledOut) {
  FakeHid* light = Make<Listener>();
  usb_->Plug({UsbIdOf(AlarmKind::kLuxafor), "LUXAFOR FLAG", "LX1", 0}, light);
  Start({{"flag", AlarmKind::kLuxafor, "LX1", "", 1}});
  EXPECT_THAT(SetAlarm(*alarms_, "flag", kStrobeRed).status, IsOk());
  usb_->Unplug(0);
  EXPECT_THAT(ReadAlarm(*alarms_, "flag", kStrobeRed).status, Not(IsOk()));
  EXPECT_THAT(ReadAlarm(*alarms_, "flag", kStrobeRed).status, StatusIs(StatusCode::kNotFound));
}

TEST_F(HidAlarmTest, TellsAnLcusBoard) {
  FakeHid* board = Make<Listener>();
  usb_->Plug({UsbIdOf(AlarmKind::kLcus), "HIDRelay", "L2", 0}, board);
  Start({{"siren", AlarmKind::kLcus, "L2", "", 2}});
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status, IsOk());
  EXPECT_THAT(Heard(board), ElementsAre(0, 0xa0, 2, 1, 0xa3));
}

// --- blink(1)

TEST_F(HidAlarmTest, BringsABlink1IntoEachPatternAndReadsItBack) {
  FakeHid* light = Make<BlinkLight>();
  usb_->Plug({UsbIdOf(AlarmKind::kBlink1), "blink(1) mk2", "20001234", 0}, light);
  Start({{"lamp", AlarmKind::kBlink1, "20001234", "", 1}});
  for (const AlarmState& state : {kStrobeRed, kSteadyGreen, kPolice, kTestOff}) {
    const AlarmResult result = SetAlarm(*alarms_, "lamp", state);
    EXPECT_THAT(result.status, IsOk());
    EXPECT_EQ(result.detail, "the light is " + ToString(state) + " (read back)");
    EXPECT_THAT(ReadAlarm(*alarms_, "lamp", state).status, IsOk());
  }
  light->With([](FakeFirmware& each) {
    auto& firmware = static_cast<BlinkLight&>(each);
    EXPECT_EQ(firmware.playing, 0);
    EXPECT_EQ(firmware.colour, Colour{});
    firmware.playing = 1;
    firmware.last = 31;
  });
  EXPECT_THAT(ReadAlarm(*alarms_, "lamp", kTestOff).status,
              StatusIs(StatusCode::kFailedPrecondition, HasSubstr("in a pattern of its own")));
}

TEST_F(HidAlarmTest, ABlink1ThatAnswersAnotherQuestionIsAFailure) {
  FakeHid* light = Make<BlinkLight>();
  usb_->Plug({UsbIdOf(AlarmKind::kBlink1), "blink(1) mk2", "20001234", 0}, light);
  Start({{"lamp", AlarmKind::kBlink1, "20001234", "", 1}});
  light->AnswerWith({1, 'v', 0, '2', '0', 0, 0, 0, 0});
  EXPECT_THAT(SetAlarm(*alarms_, "lamp", kSteadyGreen).status, StatusIs(StatusCode::kDataLoss));
  light->AnswerWith({1, 'S'});
  EXPECT_THAT(SetAlarm(*alarms_, "lamp", kSteadyGreen).status, StatusIs(StatusCode::kDataLoss));
  light->AnswerWith({});
  EXPECT_THAT(SetAlarm(*alarms_, "lamp", kSteadyGreen).status, IsOk());
}

}  // namespace
}  // namespace rips::actuator

// LCUS boards on a serial line, emulated by the other end of a pseudo terminal.
#include <fcntl.h>
#include <pty.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

#include <filesystem>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/alarm/alarm_board.h"
#include "mode_actuator/steps/alarm/alarm_test_order.h"
#include "mode_actuator/steps/alarm/drivers.h"
#include "mode_actuator/steps/alarm/fake_lcus.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {
namespace {

using absl::StatusCode;
using ::testing::HasSubstr;

class TtyAlarmTest : public ::testing::Test {
 protected:
  TtyAlarmTest() {
    std::string directory = ::testing::TempDir() + "/tty_alarm_XXXXXX";
    EXPECT_NE(mkdtemp(directory.data()), nullptr);
    directory_ = directory;
  }
  ~TtyAlarmTest() override {
    alarms_.reset();
    std::filesystem::remove_all(directory_);
  }

  // As udev does: a link that leads to whatever the board is now.
  std::string link() const { return directory_ + "/siren"; }
  void Plug(const std::string& target) {
    std::filesystem::remove(link());
    std::filesystem::create_symlink(target, link());
  }
  void Start() {
    const std::vector<AlarmSpec> specs = {{"siren", AlarmKind::kLcusSerial, "", link(), 1},
                                          {"lamp", AlarmKind::kLcusSerial, "", link(), 2},
                                          {"none", AlarmKind::kLcusSerial, "", link(), 3}};
    alarms_ = std::make_unique<AlarmBoard>(specs, RealAlarms(), &clock_, kTestIoBudget);
  }

  std::string directory_;
  RealClock clock_;
  std::unique_ptr<AlarmBoard> alarms_;
};

TEST_F(TtyAlarmTest, SwitchesAndReadsBackBothForms) {
  for (const FakeLcus::Answer answer : {FakeLcus::Answer::kText, FakeLcus::Answer::kBytes}) {
    FakeLcus board(answer);
    Plug(board.path());
    Start();
    const AlarmResult on = SetAlarm(*alarms_, "lamp", kTestOn);
    EXPECT_THAT(on.status, IsOk());
    EXPECT_EQ(on.detail, "relay 2 is on (read back)");
    EXPECT_TRUE(board.is_on(2));
    EXPECT_FALSE(board.is_on(1));
    EXPECT_THAT(SetAlarm(*alarms_, "lamp", kTestOff).status, IsOk());
    EXPECT_FALSE(board.is_on(2));
  }
}

TEST_F(TtyAlarmTest, SetsTheLineUp) {
  FakeLcus board(FakeLcus::Answer::kText);
  Plug(board.path());
  Start();
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status, IsOk());
  const termios mode = board.mode();
  EXPECT_EQ(cfgetospeed(&mode), static_cast<speed_t>(B9600));
  EXPECT_NE(mode.c_cflag & CLOCAL, 0u);
  EXPECT_EQ(mode.c_cflag & HUPCL, 0u) << "closing must not drop the lines";
  EXPECT_EQ(mode.c_lflag & (ICANON | ECHO), 0u);
}

TEST_F(TtyAlarmTest, SeesThatSomebodyElseSwitched) {
  FakeLcus board(FakeLcus::Answer::kText);
  Plug(board.path());
  Start();
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status, IsOk());
  board.Force(1, false);
  EXPECT_THAT(ReadAlarm(*alarms_, "siren", kTestOn).status,
              StatusIs(StatusCode::kFailedPrecondition, HasSubstr("relay 1 is off")));
}

TEST_F(TtyAlarmTest, ABoardWithoutTheQueryIsOnlyTold) {
  FakeLcus board(FakeLcus::Answer::kNothing);
  Plug(board.path());
  Start();
  const AlarmResult on = SetAlarm(*alarms_, "siren", kTestOn);
  EXPECT_THAT(on.status, IsOk());
  EXPECT_EQ(on.detail, "sent; this device cannot be read back");
  EXPECT_THAT(ReadAlarm(*alarms_, "siren", kTestOn).status, IsOk());
  // The frame may still be on its way.
  for (int i = 0; i < 4000 && !board.is_on(1); ++i) absl::SleepFor(absl::Milliseconds(5));
  EXPECT_TRUE(board.is_on(1));
}

TEST_F(TtyAlarmTest, ABoardThatFallsSilentIsAFailure) {
  FakeLcus board(FakeLcus::Answer::kText);
  Plug(board.path());
  Start();
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status, IsOk());
  board.set_answer(FakeLcus::Answer::kNothing);
  EXPECT_THAT(ReadAlarm(*alarms_, "siren", kTestOn).status,
              StatusIs(StatusCode::kDeadlineExceeded, HasSubstr("no longer answers")));
}

TEST_F(TtyAlarmTest, ARelayThatTheBoardDoesNotHave) {
  FakeLcus board(FakeLcus::Answer::kText);
  Plug(board.path());
  Start();
  EXPECT_THAT(SetAlarm(*alarms_, "none", kTestOn).status,
              StatusIs(StatusCode::kOutOfRange, HasSubstr("no relay 3: it has 2")));
}

TEST_F(TtyAlarmTest, AnswersThatMakeNoSenseAreFailures) {
  const struct {
    FakeLcus::Answer answer;
    StatusCode code;
    const char* message;
  } kCases[] = {
      {FakeLcus::Answer::kGarbage, StatusCode::kDataLoss, "1b5b324a"},
      {FakeLcus::Answer::kCut, StatusCode::kDataLoss, "4 bytes `4348313a`"},
      {FakeLcus::Answer::kFlood, StatusCode::kResourceExhausted, "exceeds limit 256 bytes"},
  };
  for (const auto& test : kCases) {
    FakeLcus board(test.answer);
    Plug(board.path());
    Start();
    EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status,
                StatusIs(test.code, HasSubstr(test.message)));
    alarms_.reset();
  }
}

TEST_F(TtyAlarmTest, UnpluggedAndPluggedInAgain) {
  Start();
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status,
              StatusIs(StatusCode::kNotFound, HasSubstr("is the device plugged in")));
  FakeLcus first(FakeLcus::Answer::kNothing);
  Plug(first.path());
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status, IsOk());
  EXPECT_EQ(alarms_->missing(), 0u);

  first.Unplug();
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status, StatusIs(StatusCode::kUnavailable));
  EXPECT_EQ(alarms_->missing(), 1u);
  std::filesystem::remove(link());
  EXPECT_THAT(ReadAlarm(*alarms_, "siren", kTestOn).status, StatusIs(StatusCode::kNotFound));

  FakeLcus second(FakeLcus::Answer::kText);
  Plug(second.path());
  EXPECT_THAT(ReadAlarm(*alarms_, "siren", kTestOn).status,
              StatusIs(StatusCode::kFailedPrecondition));
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status, IsOk());
  EXPECT_TRUE(second.is_on(1));
}

TEST_F(TtyAlarmTest, ALookSeesThatAToldBoardIsGone) {
  FakeLcus board(FakeLcus::Answer::kNothing);
  Plug(board.path());
  Start();
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status, IsOk());
  board.Unplug();
  EXPECT_THAT(ReadAlarm(*alarms_, "siren", kTestOn).status, StatusIs(StatusCode::kUnavailable));
}

TEST_F(TtyAlarmTest, ALineThatTakesNothingIsGivenUp) {
  int master = -1;
  int slave = -1;
  char name[64];
  ASSERT_EQ(openpty(&master, &slave, name, nullptr, nullptr), 0);
  const UniqueFd owned_master(master);
  const UniqueFd owned_slave(slave);
  ASSERT_EQ(tcflow(slave, TCOOFF), 0) << "as if nobody took what is written";
  Plug(name);
  Start();
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status, StatusIs(StatusCode::kDeadlineExceeded));
}

TEST_F(TtyAlarmTest, AFileIsNoSerialLine) {
  const std::string file = directory_ + "/file";
  ASSERT_EQ(close(open(file.c_str(), O_CREAT | O_WRONLY | O_CLOEXEC, 0600)), 0);
  Plug(file);
  Start();
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status,
              StatusIs(StatusCode::kNotFound, HasSubstr("is no serial line")));
  Plug(directory_ + "/nothing");
  EXPECT_THAT(SetAlarm(*alarms_, "siren", kTestOn).status, StatusIs(StatusCode::kNotFound));
}

}  // namespace
}  // namespace rips::actuator

// SystemModes over real DDS, against a scripted robot in another participant. What follows when the
// manager fails is in tests/integration/modes_test.cc.
#include "mode_actuator/steps/system_mode/system_modes.h"

#include <functional>
#include <map>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"
#include "tests/support/ros2/server_messages.h"
#include "tests/support/ros2/service_server.h"
#include "tests/support/ros2/test_world.h"

namespace rips::actuator {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr absl::string_view kSmh = R"(safety:
  ros__parameters:
    type: system
    modes:
      __DEFAULT__: {camera: active, motors: active}
      ALERT: {camera: inactive, motors: active.SLOW}
camera:
  ros__parameters:
    type: node
    modes: {__DEFAULT__: {ros__parameters: {use_sim_time: false}}}
motors:
  ros__parameters:
    type: node
    modes:
      __DEFAULT__: {ros__parameters: {speed: 1.0}}
      SLOW: {ros__parameters: {speed: 0.2}}
)";

constexpr absl::Duration kLong = absl::Seconds(20);
constexpr uint8_t kInactive = 2;
constexpr uint8_t kActive = 3;

// A mode manager and its two nodes; each answers what the test set, and moves when ordered.
class FakeRobot {
 public:
  explicit FakeRobot(const dds::Participant* participant) : participant_(participant) {
    StartNodes();
    StartManager();
  }

  void StartManager() {
    Serve(manager_, "/safety/change_mode", ros2::kChangeModeType, [this](absl::string_view r) {
      const auto mode = ros2::DecodeChangeModeRequest(r);
      MutexLock lock(&mu_);
      ++orders_;
      const bool known = mode.ok() && (*mode == "ALERT" || *mode == "__DEFAULT__");
      if (known && orders_ > ignore_orders_) MoveLocked(*mode);
      return ros2::EncodeSuccessReply(known && !refuse_);
    });
    Serve(manager_, "/safety/get_mode", ros2::kGetModeType, [this](absl::string_view) {
      MutexLock lock(&mu_);
      return ros2::EncodeGetModeReply(mode_);
    });
    Serve(manager_, "/safety/get_state", ros2::kGetStateType, [this](absl::string_view) {
      MutexLock lock(&mu_);
      return ros2::EncodeGetStateReply({state_, ""});
    });
    Serve(manager_, "/safety/get_available_modes", ros2::kGetAvailableModesType,
          [this](absl::string_view) {
            MutexLock lock(&mu_);
            return ros2::EncodeGetAvailableModesReply(available_);
          });
  }
  void StopManager() { manager_.clear(); }
  void StopNodes() { nodes_.clear(); }

  template <typename T>
  void Set(T FakeRobot::*field, T value) {
    MutexLock lock(&mu_);
    this->*field = std::move(value);
  }
  int orders() {
    MutexLock lock(&mu_);
    return orders_;
  }

  // What the test turns.
  int ignore_orders_ = 0;        // so many orders get `success` and nothing happens
  bool refuse_ = false;          // `success` is false
  std::string forced_mode_;      // what get_mode says, whatever is ordered
  uint8_t forced_state_ = 0xff;  // likewise
  bool camera_sticks_ = false;   // the camera never moves
  bool speed_sticks_ = false;    // the parameter never changes
  bool speed_is_text_ = false;   // the parameter has another type
  bool motors_hang_ = false;     // they get questions and do not answer
  std::string mode_ = "__DEFAULT__";
  double speed_ = 1.0;
  std::vector<std::string> available_ = {"ALERT", "__DEFAULT__"};

 private:
  using Handler = std::function<std::optional<std::string>(absl::string_view)>;

  void Serve(std::vector<std::unique_ptr<dds::ServiceServer>>& servers, const std::string& service,
             const std::string& type, Handler handler) {
    auto server = dds::ServiceServer::Create(
        *participant_, {.service = service, .type = type},
        [handler = std::move(handler)](absl::string_view request) -> std::optional<std::string> {
          return handler(request);
        });
    ASSERT_THAT(server, IsOk());
    servers.push_back(*std::move(server));
  }

  void StartNodes() {
    for (const std::string node : {"/camera", "/motors"}) {
      Serve(nodes_, node + "/get_state", ros2::kGetStateType,
            [this, node](absl::string_view) -> std::optional<std::string> {
              MutexLock lock(&mu_);
              if (motors_hang_ && node == "/motors") return std::nullopt;
              return ros2::EncodeGetStateReply({node_state_[node], ""});
            });
      Serve(nodes_, node + "/get_parameters", ros2::kGetParametersType,
            [this, node](absl::string_view) {
              MutexLock lock(&mu_);
              if (node == "/camera") return ros2::EncodeGetParametersReply({false});
              if (speed_is_text_) return ros2::EncodeGetParametersReply({std::string("0.2")});
              return ros2::EncodeGetParametersReply({speed_});
            });
    }
  }

  void MoveLocked(const std::string& mode) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    mode_ = forced_mode_.empty() ? mode : forced_mode_;
    if (forced_mode_ == "(empty)") mode_.clear();
    state_ = forced_state_ == 0xff ? kActive : forced_state_;
    if (!camera_sticks_) node_state_["/camera"] = mode == "ALERT" ? kInactive : kActive;
    if (!speed_sticks_) speed_ = mode == "ALERT" ? 0.2 : 1.0;
  }

  const dds::Participant* const participant_;  // Not owned; outlives this.
  Mutex mu_;
  int orders_ = 0;
  uint8_t state_ = kActive;
  std::map<std::string, uint8_t> node_state_ = {{"/camera", kActive}, {"/motors", kActive}};
  std::vector<std::unique_ptr<dds::ServiceServer>> nodes_;
  std::vector<std::unique_ptr<dds::ServiceServer>> manager_;
};

class SystemModesTest : public dds::TestWorld {
 protected:
  SystemModes& Modes(Verify verify = Verify::kParts) {
    modes_ = *SystemModes::Create(&near(), smh_, {.verify = verify, .fallback = Fallback::kNone},
                                  {{"/safety", "ALERT"}, {"/safety", "__DEFAULT__"}}, &clock_);
    return *modes_;
  }
  FakeRobot& Robot() {
    robot_ = std::make_unique<FakeRobot>(&far());
    return *robot_;
  }
  // Enters once, so that everything is matched.
  void Warm(SystemModes& modes) {
    ASSERT_THAT(modes.Enter("/safety", "__DEFAULT__", absl::Seconds(20), 0, cancel_).status,
                IsOk());
  }
  // The first reading of /safety that `enough` accepts, or the last one: endpoints match, and
  // vanish, one after the other.
  PartReading ReadUntil(SystemModes& modes, const std::function<bool(const PartReading&)>& enough) {
    PartReading reading;
    dds::Eventually([&] {
      reading = modes.Read("/safety", kLong, cancel_);
      return enough(reading);
    });
    EXPECT_TRUE(enough(reading)) << reading.answers;
    return reading;
  }
  ModeReading Alert(SystemModes& modes, absl::Duration timeout = absl::Seconds(20),
                    int retries = 0) {
    return modes.Enter("/safety", "ALERT", timeout, retries, cancel_);
  }

  RealClock clock_;
  CancelFlag cancel_;
  const Smh smh_ = *ParseSmh(kSmh);
  std::unique_ptr<FakeRobot> robot_;
  std::unique_ptr<SystemModes> modes_;
};

TEST_F(SystemModesTest, OrdersAndReadsBack) {
  Robot();
  SystemModes& modes = Modes();
  const ModeReading reading = Alert(modes);
  EXPECT_THAT(reading.status, IsOk());
  EXPECT_EQ(reading.observed, "ALERT");
  EXPECT_THAT(modes.Check("/safety", "ALERT", cancel_).status, IsOk());
  EXPECT_THAT(modes.CheckAvailable(), IsOk());

  const ModeReading other = modes.Check("/safety", "__DEFAULT__", cancel_);
  EXPECT_THAT(other.status, StatusIs(absl::StatusCode::kFailedPrecondition,
                                     "/camera is inactive, expected active, /motors has `speed` = "
                                     "0.2, expected 1"));
  EXPECT_EQ(other.observed, "ALERT");
}

TEST_F(SystemModesTest, AManagerThatSaysSuccessAndDoesNothingFails) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  Warm(modes);
  robot.Set(&FakeRobot::ignore_orders_, 1'000);

  const ModeReading reading = Alert(modes, absl::Milliseconds(400), /*retries=*/2);

  EXPECT_THAT(reading.status, StatusIs(absl::StatusCode::kDeadlineExceeded,
                                       AllOf(HasSubstr("ordered, but not reached"),
                                             HasSubstr("/camera is active, expected inactive"),
                                             HasSubstr("/motors has `speed` = 1, expected 0.2"))));
  EXPECT_EQ(reading.observed, "__DEFAULT__");
  EXPECT_EQ(robot.orders(), 4);  // one to warm, three attempts
}

TEST_F(SystemModesTest, ALostOrderIsRepairedByAskingAgain) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  Warm(modes);
  robot.Set(&FakeRobot::ignore_orders_, 2);
  EXPECT_THAT(Alert(modes, absl::Milliseconds(500), 2).status, IsOk());
}

TEST_F(SystemModesTest, APartThatDoesNotMoveFailsThoughTheManagerIsContent) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  Warm(modes);
  robot.Set(&FakeRobot::camera_sticks_, true);
  EXPECT_THAT(Alert(modes, absl::Milliseconds(400)).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded,
                       "ordered, but not reached: /camera is active, expected inactive"));
  robot.Set(&FakeRobot::camera_sticks_, false);
  robot.Set(&FakeRobot::speed_is_text_, true);
  EXPECT_THAT(Alert(modes, absl::Milliseconds(400)).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded,
                       HasSubstr("/motors has `speed` = 0.2 of another type, expected 0.2")));
}

TEST_F(SystemModesTest, VerifyManagerBelievesTheManager) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes(Verify::kManager);
  Warm(modes);
  robot.Set(&FakeRobot::camera_sticks_, true);
  EXPECT_THAT(Alert(modes).status, IsOk());
  robot.Set(&FakeRobot::forced_mode_, std::string("(empty)"));
  EXPECT_THAT(Alert(modes, absl::Milliseconds(800)).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded));
}

TEST_F(SystemModesTest, ThePartsDecideWhenTheManagerDoesNotKnow) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  Warm(modes);
  robot.Set(&FakeRobot::forced_state_, uint8_t{0});
  robot.Set(&FakeRobot::forced_mode_, std::string("unknown"));
  EXPECT_THAT(Alert(modes, absl::Milliseconds(300)).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded));  // not before 500 ms of silence
  EXPECT_THAT(Alert(modes).status, IsOk());
}

TEST_F(SystemModesTest, AManagerThatNamesAnotherModeIsContradiction) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  Warm(modes);
  robot.Set(&FakeRobot::forced_mode_, std::string("HALT"));
  EXPECT_THAT(Alert(modes, absl::Milliseconds(900)).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded,
                       HasSubstr("the mode manager says `HALT`, active")));
}

TEST_F(SystemModesTest, ARefusalIsFinal) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  Warm(modes);
  robot.Set(&FakeRobot::refuse_, true);
  EXPECT_THAT(Alert(modes, absl::Seconds(5), 5).status,
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("refuses `ALERT`")));
  EXPECT_EQ(robot.orders(), 2);
}

TEST_F(SystemModesTest, WithoutAManagerNothingIsReached) {
  SystemModes& modes = Modes();
  EXPECT_THAT(Alert(modes, absl::Milliseconds(300)).status,
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("the order failed")));
  EXPECT_THAT(modes.CheckAvailable(),
              StatusIs(absl::StatusCode::kUnavailable, "no mode manager of `/safety` answers"));
  Robot();  // comes late
  EXPECT_THAT(Alert(modes).status, IsOk());
}

TEST_F(SystemModesTest, AManagerMayRestart) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  Warm(modes);
  robot.StopManager();
  robot.StartManager();
  EXPECT_THAT(Alert(modes).status, IsOk());
  robot.StopManager();
  EXPECT_THAT(modes.Check("/safety", "ALERT", cancel_).status, IsOk());  // the parts are there
  robot.StopNodes();
  EXPECT_THAT(modes.Check("/safety", "ALERT", cancel_).status,
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       "/camera does not answer, /motors does not answer"));
}

TEST_F(SystemModesTest, FindsAManagerWithAnotherFile) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  Warm(modes);
  robot.Set(&FakeRobot::available_, std::vector<std::string>{"__DEFAULT__"});
  absl::Status status = absl::UnavailableError("");
  for (int i = 0; i < 100 && absl::IsUnavailable(status); ++i) {
    status = modes.CheckAvailable();
    cancel_.WaitFor(absl::Milliseconds(50));
  }
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kFailedPrecondition,
                               HasSubstr("has no mode `ALERT`; it runs with another SMH file")));
}

TEST_F(SystemModesTest, AProbeLooksAndOrdersNothing) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  Warm(modes);
  const int orders = robot.orders();
  // Clients match one after the other.
  ModeReading probe;
  for (int i = 0; i < 100 && (i == 0 || !probe.status.ok()); ++i) {
    probe = modes.Probe("/safety", "ALERT", cancel_);
    cancel_.WaitFor(absl::Milliseconds(50));
  }
  EXPECT_THAT(probe.status, IsOk());
  EXPECT_EQ(probe.observed, "__DEFAULT__");
  EXPECT_EQ(robot.orders(), orders);

  robot.Set(&FakeRobot::available_, std::vector<std::string>{"__DEFAULT__"});
  EXPECT_THAT(modes.Probe("/safety", "ALERT", cancel_).status,
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("has no mode `ALERT`; it runs with another SMH file")));
  robot.StopNodes();
  EXPECT_THAT(
      modes.Probe("/safety", "ALERT", cancel_).status,
      StatusIs(absl::StatusCode::kFailedPrecondition,
               AllOf(HasSubstr("/camera does not answer"), HasSubstr("/motors does not answer"))));
  robot.StopManager();
  probe = modes.Probe("/safety", "ALERT", cancel_);
  EXPECT_THAT(probe.status, StatusIs(absl::StatusCode::kUnavailable,
                                     HasSubstr("no mode manager of `/safety` answers")));
  EXPECT_EQ(probe.observed, "?");
  EXPECT_EQ(modes.Probe("/safety", "none", cancel_).status.code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(robot.orders(), orders);
  cancel_.Cancel();
  EXPECT_TRUE(absl::IsCancelled(modes.Probe("/safety", "ALERT", cancel_).status));
}

TEST_F(SystemModesTest, ReadsTheModeThatNodesAndManagerShowAndOrdersNothing) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  ASSERT_THAT(Alert(modes).status, IsOk());
  const int orders = robot.orders();
  PartReading reading = ReadUntil(modes, [](const PartReading& r) { return r.answers == 3; });
  EXPECT_TRUE(reading.complete);
  EXPECT_THAT(reading.agreeing, ElementsAre("ALERT"));
  EXPECT_EQ(reading.named, "ALERT");

  // A manager that has forgotten adds nothing; a mode of no level agrees with none.
  robot.Set(&FakeRobot::mode_, std::string("unknown"));
  reading = ReadUntil(modes, [](const PartReading& r) { return r.answers == 3; });
  EXPECT_EQ(reading.named, "");
  EXPECT_THAT(reading.agreeing, ElementsAre("ALERT"));
  robot.Set(&FakeRobot::speed_, 0.7);
  reading = ReadUntil(modes, [](const PartReading& r) { return r.answers == 3; });
  EXPECT_THAT(reading.agreeing, IsEmpty());
  EXPECT_FALSE(reading.complete);
  EXPECT_EQ(robot.orders(), orders);
  EXPECT_TRUE(modes.Read("/other", kLong, cancel_).complete);
}

TEST_F(SystemModesTest, NodesThatAnswerShowTheModeOfAPartWhoseOthersAreSilent) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  ASSERT_THAT(Alert(modes).status, IsOk());
  robot.Set(&FakeRobot::mode_, std::string("unknown"));
  robot.Set(&FakeRobot::motors_hang_, true);
  const auto two_answer = [](const PartReading& r) { return r.answers == 2; };
  PartReading reading = ReadUntil(modes, two_answer);
  EXPECT_THAT(reading.agreeing, ElementsAre("ALERT"));
  EXPECT_FALSE(reading.complete);

  robot.StopManager();
  robot.StopNodes();
  reading = ReadUntil(modes, [](const PartReading& r) { return r.answers == 0; });
  EXPECT_THAT(reading.agreeing, IsEmpty());
  EXPECT_FALSE(reading.complete);
}

TEST_F(SystemModesTest, ReadingEndsWhenItIsCancelledOrItsTimeIsOver) {
  Robot();
  SystemModes& modes = Modes();
  ASSERT_THAT(Alert(modes).status, IsOk());
  ReadUntil(modes, [](const PartReading& r) { return r.answers == 3; });
  EXPECT_LE(modes.Read("/safety", absl::ZeroDuration(), cancel_).answers, 1u);
  cancel_.Cancel();
  const PartReading reading = modes.Read("/safety", kLong, cancel_);
  EXPECT_LE(reading.answers, 1u);
  EXPECT_FALSE(reading.complete);
}

TEST_F(SystemModesTest, WithVerifyManagerOnlyTheManagerIsRead) {
  Robot();
  SystemModes& modes = Modes(Verify::kManager);
  ASSERT_THAT(Alert(modes).status, IsOk());
  const PartReading reading = ReadUntil(modes, [](const PartReading& r) { return r.complete; });
  EXPECT_EQ(reading.named, "ALERT");
  EXPECT_THAT(reading.agreeing, IsEmpty());
}

TEST_F(SystemModesTest, NothingIsReadOfAPartThatTwoParticipantsServe) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes();
  ASSERT_THAT(Alert(modes).status, IsOk());
  ReadUntil(modes, [](const PartReading& r) { return r.answers == 3; });
  // The rival says of everything what a level wants to hear.
  auto rival = std::make_unique<FakeRobot>(&third());
  rival->Set(&FakeRobot::mode_, std::string("ALERT"));
  PartReading reading = ReadUntil(modes, [](const PartReading& r) { return r.answers == 0; });
  EXPECT_EQ(reading.named, "");
  EXPECT_THAT(reading.agreeing, IsEmpty());
  EXPECT_FALSE(reading.complete);

  EXPECT_THAT(modes.Check("/safety", "ALERT", cancel_).status,
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("2 servers offer `/camera/get_state`, of participants "),
                             HasSubstr("2 servers offer `/motors/get_state`"),
                             HasSubstr(ToString(third().guid())))));
  const auto several = StatusIs(absl::StatusCode::kFailedPrecondition,
                                AllOf(HasSubstr("2 servers offer `/safety/get_available_modes`"),
                                      HasSubstr("2 servers offer `/camera/get_state`")));
  EXPECT_THAT(modes.Probe("/safety", "ALERT", cancel_).status, several);
  EXPECT_THAT(modes.CheckAvailable(), StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(modes.Degraded(), Contains(HasSubstr("2 servers offer `/camera/get_state`")));
  const int orders = robot.orders();
  EXPECT_THAT(Alert(modes, absl::Milliseconds(300)).status,
              StatusIs(absl::StatusCode::kUnavailable,
                       HasSubstr("the order failed: 2 servers offer `/safety/change_mode`")));
  EXPECT_TRUE(dds::Eventually([&] { return robot.orders() > orders; })) << "it is ordered";

  rival.reset();
  EXPECT_TRUE(dds::Eventually([&] { return Alert(modes).status.ok(); }));
}

TEST_F(SystemModesTest, OfTwoManagersNoneAnswers) {
  FakeRobot& robot = Robot();
  SystemModes& modes = Modes(Verify::kManager);
  Warm(modes);
  auto rival = std::make_unique<FakeRobot>(&third());
  rival->StopNodes();
  rival->Set(&FakeRobot::mode_, std::string("ALERT"));
  const auto several =
      StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("2 servers offer `/safety/get_"));
  EXPECT_TRUE(dds::Eventually([&] {
    const absl::Status status = modes.Check("/safety", "__DEFAULT__", cancel_).status;
    return ::testing::Matches(several)(status);
  }));
  EXPECT_THAT(modes.Check("/safety", "ALERT", cancel_).status, several);
  robot.StopManager();
  EXPECT_TRUE(dds::Eventually([&] { return modes.Check("/safety", "ALERT", cancel_).status.ok(); }))
      << "the only one there is, is believed";
}

TEST_F(SystemModesTest, CancelEndsAnOrder) {
  SystemModes& modes = Modes();
  cancel_.Cancel();
  EXPECT_THAT(Alert(modes, absl::Seconds(20), 5).status, StatusIs(absl::StatusCode::kCancelled));
}

TEST_F(SystemModesTest, RefusesTargetsTheFileDoesNotHave) {
  EXPECT_THAT(SystemModes::Create(&near(), smh_, {}, {{"/safety", "X"}}, &clock_),
              StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(Modes().Check("/other", "ALERT", cancel_).status,
              StatusIs(absl::StatusCode::kInvalidArgument));
}

}  // namespace
}  // namespace rips::actuator

// SystemModes against a simulated robot whose mode manager or nodes fail, over real DDS.
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/system_mode/system_modes.h"
#include "services/base/status_matchers.h"
#include "services/dds/discovery.h"
#include "services/dds/service_client.h"
#include "services/ros2/system_modes_messages.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/living_robot.h"
#include "tests/support/ros2/forged_heartbeat.h"
#include "tests/support/ros2/server_messages.h"
#include "tests/support/ros2/service_server.h"
#include "tests/support/ros2/test_world.h"

namespace rips::actuator {
namespace {

using robot_sim::LivingRobot;
using robot_sim::ManagerConduct;
using robot_sim::ModeMachine;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// An order that is carried out takes far less. One that has to give up first uses `kBrief`.
constexpr absl::Duration kLong = absl::Seconds(15);
constexpr absl::Duration kBrief = absl::Milliseconds(1'500);
const char kEye[] = "/eye";
const char kWheels[] = "/wheels";

class ModesOnRobotTest : public dds::TestWorld {
 protected:
  LivingRobot& Robot(ManagerConduct conduct = ManagerConduct::kHonest,
                     absl::Duration answer_delay = absl::ZeroDuration()) {
    robot_ = std::make_unique<LivingRobot>(far(), smh_, conduct, answer_delay);
    return *robot_;
  }
  SystemModes& Modes(const ModesOptions& options = {}) {
    modes_ = *SystemModes::Create(
        &near(), smh_, options,
        {{"/safety", "__DEFAULT__"}, {"/safety", "ALERT"}, {"/safety", "HALT"}}, &clock_);
    if (options.backend == Backend::kManager && manager_expected_) {
      // Everything is matched then.
      EXPECT_TRUE(
          dds::Eventually([this] { return !absl::IsUnavailable(modes_->CheckAvailable()); }));
    }
    return *modes_;
  }
  ModeReading Enter(const std::string& mode, absl::Duration timeout = kLong, int retries = 0) {
    return modes_->Enter("/safety", mode, timeout, retries, cancel_);
  }
  absl::Status Check(const std::string& mode) {
    return modes_->Check("/safety", mode, cancel_).status;
  }
  // Looks as often as it takes, as the reconcile does.
  bool EventuallyDegraded(const std::string& mode, ::testing::Matcher<std::vector<std::string>> m) {
    return dds::Eventually([&] {
      Check(mode).IgnoreError();
      return m.Matches(modes_->Degraded());
    });
  }
  // As any node on the bus may.
  absl::StatusOr<std::string> CallAsStranger(const std::string& service, const char* type,
                                             const std::string& request) {
    auto client = dds::ServiceClient::Create(far(), {.service = service, .type = type});
    EXPECT_THAT(client, IsOk());
    return (*client)->Call(request, absl::Seconds(10));
  }

  RealClock clock_;
  CancelFlag cancel_;
  bool manager_expected_ = true;
  const Smh smh_ = *ParseSmh(robot_sim::kLivingRobotSmh);
  std::unique_ptr<LivingRobot> robot_;
  std::unique_ptr<SystemModes> modes_;
};

// --- directly

TEST_F(ModesOnRobotTest, OrdersTheNodesWithoutAManager) {
  LivingRobot& robot = Robot(ManagerConduct::kAbsent);
  Modes({.backend = Backend::kDirect});
  const ModeReading reading = Enter("ALERT");
  EXPECT_THAT(reading.status, IsOk());
  EXPECT_EQ(reading.observed, "ALERT");
  EXPECT_EQ(reading.note, "");  // as configured
  EXPECT_EQ(robot->Mode(), "ALERT");
  EXPECT_THAT(Check("ALERT"), IsOk());
  EXPECT_THAT(modes_->Degraded(), IsEmpty());
  const int orders = robot->direct_orders();
  EXPECT_EQ(orders, 2);  // the eye's state, the speed
  EXPECT_THAT(Enter("ALERT").status, IsOk());
  EXPECT_EQ(robot->direct_orders(), orders);  // what is right is left alone
  EXPECT_THAT(Enter("HALT").status, IsOk());
  EXPECT_THAT(Enter("__DEFAULT__").status, IsOk());
  EXPECT_EQ(robot->Mode(), "__DEFAULT__");
}

TEST_F(ModesOnRobotTest, UnconfiguredNodesAreConfigured) {
  LivingRobot& robot = Robot();
  Modes();
  robot->With([](ModeMachine& machine) {
    machine.Unconfigure(kEye);
    machine.Unconfigure(kWheels);
  });
  EXPECT_THAT(modes_->CheckAvailable(),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       "/eye is unconfigured: the mode manager will never configure it"));
  EXPECT_THAT(modes_->Degraded(),
              Contains("/wheels is unconfigured: the mode manager will never configure it"));
  const ModeReading reading = Enter("ALERT", kBrief, 1);
  EXPECT_THAT(reading.status, IsOk());
  EXPECT_THAT(reading.note, AllOf(HasSubstr("held without the mode manager"),
                                  HasSubstr("/eye is unconfigured, expected inactive")));
  EXPECT_EQ(robot->Mode(), "ALERT");
  EXPECT_THAT(modes_->CheckAvailable(), IsOk());
}

TEST_F(ModesOnRobotTest, ANodeThatRefusesIsNamedAndTheOthersAreOrdered) {
  LivingRobot& robot = Robot();
  Modes({.backend = Backend::kDirect});
  ASSERT_THAT(Enter("__DEFAULT__").status, IsOk());
  robot.Stick(kEye);
  EXPECT_THAT(Enter("ALERT", kBrief).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded,
                       "ordered from the nodes, but not reached: /eye is active, expected inactive "
                       "(/eye failed to deactivate)"));
  EXPECT_THAT(Check("ALERT"),
              StatusIs(absl::StatusCode::kFailedPrecondition, "/eye is active, expected inactive"));
  robot.Stick(kEye, false);
  robot.Stick(kWheels);
  EXPECT_THAT(Enter("__DEFAULT__", kBrief).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded,
                       HasSubstr("/wheels refuses parameters: not now")));
  robot.Stick(kWheels, false);
  EXPECT_THAT(Enter("__DEFAULT__").status, IsOk());
}

TEST_F(ModesOnRobotTest, OrdersToNodesEndWhenCancelled) {
  Modes({.backend = Backend::kDirect});
  cancel_.Cancel();
  EXPECT_THAT(Enter("ALERT").status, StatusIs(absl::StatusCode::kCancelled));
}

// --- a manager that fails

TEST_F(ModesOnRobotTest, AManagerThatLiesIsGoneWithout) {
  LivingRobot& robot = Robot();
  Modes();
  ASSERT_THAT(Enter("__DEFAULT__").status, IsOk());
  robot->With([](ModeMachine& machine) { machine.SetConduct(ManagerConduct::kLie); });

  const ModeReading reading = Enter("ALERT", kBrief, 1);

  EXPECT_THAT(reading.status, IsOk());
  EXPECT_THAT(reading.note, HasSubstr("held without the mode manager: ordered, but not reached"));
  EXPECT_EQ(robot->Mode(), "ALERT");
  EXPECT_THAT(modes_->Degraded(),
              ElementsAre(HasSubstr("/safety=ALERT is held without the mode manager")));
  // The next level does not wait for it.
  const int orders = robot->orders();
  EXPECT_THAT(Enter("HALT", kLong, 5).status, IsOk());
  EXPECT_EQ(robot->Mode(), "HALT");
  EXPECT_EQ(robot->orders(), orders + 1);
}

TEST_F(ModesOnRobotTest, OneAttemptLeavesHalfOfItsTime) {
  LivingRobot& robot = Robot();
  Modes();
  ASSERT_THAT(Enter("__DEFAULT__").status, IsOk());
  robot->With([](ModeMachine& machine) { machine.SetConduct(ManagerConduct::kLie); });
  EXPECT_THAT(Enter("ALERT", absl::Seconds(4)).status, IsOk());
  EXPECT_EQ(robot->Mode(), "ALERT");
}

TEST_F(ModesOnRobotTest, AManagerThatDeceivesIsFoundOut) {
  LivingRobot& robot = Robot(ManagerConduct::kDeceive);
  Modes();
  EXPECT_THAT(Enter("ALERT", kBrief, 1).status, IsOk());
  EXPECT_EQ(robot->Mode(), "ALERT");
  // It claims the mode, the parts are in it: nothing is wrong any more.
  EXPECT_TRUE(EventuallyDegraded("ALERT", IsEmpty()));
}

TEST_F(ModesOnRobotTest, AManagerThatRefusesIsGoneWithoutAtOnce) {
  LivingRobot& robot = Robot(ManagerConduct::kRefuse);
  Modes();
  const ModeReading reading = Enter("ALERT", kLong, 5);
  EXPECT_THAT(reading.status, IsOk());
  EXPECT_THAT(reading.note, HasSubstr("the mode manager refuses `ALERT`"));
  EXPECT_EQ(robot->orders(), 1);
  // The parts are right, whatever it says of them.
  EXPECT_THAT(Check("ALERT"), IsOk());
}

TEST_F(ModesOnRobotTest, AManagerWhoseFileChangedIsGoneWithout) {
  LivingRobot& robot = Robot();
  Modes();
  robot->With([](ModeMachine& machine) { machine.RemoveMode("ALERT"); });
  EXPECT_THAT(modes_->CheckAvailable(),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("has no mode `ALERT`")));
  EXPECT_THAT(Enter("ALERT").status, IsOk());
  EXPECT_EQ(robot->Mode(), "ALERT");
}

TEST_F(ModesOnRobotTest, AnAbsentManagerIsToldWhenItComes) {
  LivingRobot& robot = Robot(ManagerConduct::kAbsent);
  manager_expected_ = false;
  Modes();
  const ModeReading reading = Enter("ALERT");
  EXPECT_THAT(reading.status, IsOk());
  EXPECT_THAT(reading.note, HasSubstr("no server for `/safety/change_mode`"));
  EXPECT_THAT(Check("ALERT"), IsOk());
  EXPECT_EQ(robot->orders(), 0);

  robot->With([](ModeMachine& machine) { machine.SetConduct(ManagerConduct::kHonest); });
  robot.StartManager();
  EXPECT_TRUE(EventuallyDegraded("ALERT", Not(Contains(HasSubstr("held without")))));
  EXPECT_EQ(robot->Mode(), "ALERT");
}

TEST_F(ModesOnRobotTest, ASilentManagerIsGoneWithout) {
  LivingRobot& robot = Robot(ManagerConduct::kLie, absl::Seconds(3));
  Modes();
  const ModeReading reading = Enter("ALERT");
  EXPECT_THAT(reading.status, IsOk());
  EXPECT_THAT(reading.note, HasSubstr("no reply from `/safety/change_mode`"));
  EXPECT_EQ(robot->Mode(), "ALERT");
}

TEST_F(ModesOnRobotTest, FallbackNoneFails) {
  LivingRobot& robot = Robot(ManagerConduct::kLie);
  Modes({.fallback = Fallback::kNone});
  EXPECT_THAT(Enter("ALERT", kBrief).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded,
                       HasSubstr("ordered, but not reached: /eye is active, expected inactive")));
  EXPECT_EQ(robot->Mode(), "__DEFAULT__");
  EXPECT_EQ(robot->direct_orders(), 0);
}

TEST_F(ModesOnRobotTest, BothMayFail) {
  LivingRobot& robot = Robot();
  Modes();
  ASSERT_THAT(Enter("__DEFAULT__").status, IsOk());
  robot.Stick(kEye);
  EXPECT_THAT(Enter("ALERT", kBrief, 1).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded,
                       AllOf(HasSubstr("ordered, but not reached: /eye is active"),
                             HasSubstr("(/eye failed to deactivate)"))));
  EXPECT_EQ(robot->With([](ModeMachine& machine) { return machine.Mode(kWheels); }), "SLOW");
  EXPECT_THAT(Check("ALERT"), StatusIs(absl::StatusCode::kFailedPrecondition,
                                       HasSubstr("/eye is active, expected inactive")));
}

// --- a manager that restarts

TEST_F(ModesOnRobotTest, ARestartedManagerIsToldTheModeAgain) {
  LivingRobot& robot = Robot();
  Modes();
  ASSERT_THAT(Enter("ALERT").status, IsOk());
  const int orders = robot->orders();
  robot.StopManager();
  EXPECT_THAT(Check("ALERT"), IsOk());  // silence is no drift
  robot.StartManager();
  EXPECT_TRUE(dds::Eventually([&] {
    EXPECT_THAT(Check("ALERT"), IsOk());
    return robot->orders() > orders;
  }));
  for (int i = 0; i < 3; ++i) EXPECT_THAT(Check("ALERT"), IsOk());
  EXPECT_EQ(robot->orders(), orders + 1);  // once in its life
  EXPECT_EQ(robot->Mode(), "ALERT");
}

TEST_F(ModesOnRobotTest, AManagerMayRestartInTheMiddleOfAnOrder) {
  LivingRobot& robot = Robot();
  Modes();
  ASSERT_THAT(Enter("__DEFAULT__").status, IsOk());
  const int orders = robot->orders();
  ModeReading reading;
  std::thread order([&] { reading = Enter("ALERT", kLong, 2); });
  // What it took is forgotten before it takes effect (150 ms).
  EXPECT_TRUE(dds::Eventually([&] { return robot->orders() > orders; }));
  robot.StopManager();
  robot.StartManager();
  order.join();
  EXPECT_THAT(reading.status, IsOk());
  EXPECT_EQ(robot->Mode(), "ALERT");
}

// --- a manager that leaves the mode, and strangers

TEST_F(ModesOnRobotTest, AManagerWithRulesIsGoneWithoutTheSecondTime) {
  LivingRobot& robot = Robot();
  Modes();
  robot->With([](ModeMachine& machine) { machine.SetPull("ALERT", "__DEFAULT__"); });
  const auto left = [&] { return dds::Eventually([&] { return !Check("ALERT").ok(); }); };
  ASSERT_THAT(Enter("ALERT").status, IsOk());
  ASSERT_TRUE(left());
  const ModeReading again = Enter("ALERT");
  ASSERT_THAT(again.status, IsOk());
  EXPECT_EQ(again.note, "");  // through the manager
  ASSERT_TRUE(left());

  const ModeReading third = Enter("ALERT");

  EXPECT_THAT(third.status, IsOk());
  EXPECT_EQ(third.note,
            "held without the mode manager: the mode manager left ALERT for __DEFAULT__ 2 times in "
            "60 s; does its SMH file have rules, or does another node order it?");
  EXPECT_EQ(robot->Mode(), "ALERT");
  EXPECT_THAT(modes_->Degraded(), ElementsAre(HasSubstr("left ALERT for __DEFAULT__ 2 times")));
}

TEST_F(ModesOnRobotTest, AStrangersOrderIsDrift) {
  LivingRobot& robot = Robot();
  Modes();
  ASSERT_THAT(Enter("ALERT").status, IsOk());
  ASSERT_THAT(CallAsStranger("/safety/change_mode", ros2::kChangeModeType,
                             ros2::EncodeChangeModeRequest("__DEFAULT__")),
              IsOk());
  ASSERT_TRUE(dds::Eventually([&] { return !Check("ALERT").ok(); }));
  EXPECT_THAT(Enter("ALERT").status, IsOk());
  EXPECT_EQ(robot->Mode(), "ALERT");

  ASSERT_THAT(CallAsStranger("/eye/change_state", ros2::kChangeStateType,
                             ros2::EncodeChangeStateRequest({.id = kTransitionActivate})),
              IsOk());
  EXPECT_THAT(Check("ALERT"), StatusIs(absl::StatusCode::kFailedPrecondition,
                                       HasSubstr("/eye is active, expected inactive")));
  EXPECT_THAT(Enter("ALERT").status, IsOk());
  EXPECT_EQ(robot->Mode(), "ALERT");
}

// --- a rival, and servers that were made deaf

TEST_F(ModesOnRobotTest, WhatARivalServesIsNeverReachedAndTheRobotIsOrdered) {
  LivingRobot& robot = Robot();
  Modes();
  ASSERT_THAT(Enter("__DEFAULT__").status, IsOk());
  auto rival = std::make_unique<LivingRobot>(third(), smh_);
  ASSERT_TRUE(dds::Eventually([&] {
    const absl::Status status = Check("__DEFAULT__");
    return absl::StrContains(status.message(), "2 servers offer `/eye/get_state`") &&
           absl::StrContains(status.message(), "2 servers offer `/wheels/get_state`");
  }));
  const ModeReading reading = Enter("ALERT", kBrief, 1);
  EXPECT_THAT(reading.status,
              StatusIs(absl::StatusCode::kDeadlineExceeded,
                       AllOf(HasSubstr("the order failed: 2 servers offer `/safety/change_mode`"),
                             HasSubstr("2 servers offer `/eye/get_state`"))));
  EXPECT_EQ(robot->Mode(), "ALERT") << "all have the order";
  // Without a manager the nodes have it, but none is activated that cannot be read.
  robot->With([](ModeMachine& machine) { machine.SetConduct(ManagerConduct::kLie); });
  EXPECT_FALSE(Enter("HALT", kBrief, 1).status.ok());
  EXPECT_EQ(robot->Mode(), "HALT");
  EXPECT_FALSE(Enter("__DEFAULT__", kBrief, 1).status.ok());
  EXPECT_TRUE(robot->With([](ModeMachine& machine) {
    return !machine.nodes().at(kEye).active && !machine.nodes().at(kWheels).active;
  }));

  rival.reset();
  EXPECT_TRUE(dds::Eventually([&] { return Enter("__DEFAULT__").status.ok(); }));
  EXPECT_EQ(robot->Mode(), "__DEFAULT__");
}

TEST_F(ModesOnRobotTest, OfTwoManagersNoneIsNeeded) {
  LivingRobot& robot = Robot();
  Modes();
  ASSERT_THAT(Enter("__DEFAULT__").status, IsOk());
  const auto rival = dds::ServiceServer::Create(
      third(), {.service = "/safety/change_mode", .type = ros2::kChangeModeType},
      [](absl::string_view) { return ros2::EncodeSuccessReply(true); });
  ASSERT_THAT(rival, IsOk());
  const std::string several = "the order failed: 2 servers offer `/safety/change_mode`";
  ModeReading reading;
  EXPECT_TRUE(dds::Eventually([&] {
    for (const char* mode : {"__DEFAULT__", "ALERT"}) {
      reading = Enter(mode);
      EXPECT_THAT(reading.status, IsOk());
      EXPECT_EQ(robot->Mode(), mode);
    }
    return absl::StrContains(reading.note, several);
  }));
  EXPECT_THAT(Check("ALERT"), IsOk());
}

TEST_F(ModesOnRobotTest, ServersThatWereMadeDeafHearTheNextOrder) {
  LivingRobot& robot = Robot();
  Modes();
  ASSERT_THAT(Enter("__DEFAULT__").status, IsOk());
  Mutex mu;
  std::set<ros2::Guid> clients;
  const auto discovery = dds::Discovery::Create(
      third(), {.on_endpoint = [&](const dds::EndpointSeen& seen) {
        if (!seen.alive || !seen.writer || !absl::StartsWith(seen.topic, "rq/")) return;
        if (seen.participant != near().guid()) return;
        MutexLock lock(&mu);
        clients.insert(seen.guid);
      }});
  ASSERT_THAT(discovery, IsOk());
  const auto forge = [&] {
    MutexLock lock(&mu);
    for (const ros2::Guid& client : clients) {
      for (const ros2::Guid& victim : robot->Participants()) {
        ASSERT_THAT(dds::SendToDomain(dds::RandomDomain(), dds::ForgedHeartbeat(client, victim)),
                    IsOk());
      }
    }
  };
  // 4 of the manager, 4 of each node. The datagrams and what is asked next race.
  ASSERT_TRUE(dds::Eventually([&] {
    MutexLock lock(&mu);
    return clients.size() == 12;
  }));
  forge();
  ASSERT_TRUE(dds::Eventually([&] { return !Check("__DEFAULT__").ok(); }));
  EXPECT_THAT(Enter("ALERT").status, IsOk());
  EXPECT_EQ(robot->Mode(), "ALERT");
  EXPECT_THAT(Check("ALERT"), IsOk());
}

// --- two orders at once: the second is for the mode the manager is just leaving

class FlipTest : public ModesOnRobotTest {
 protected:
  // Orders `first`, gives it up after 10 ms, and orders `second`.
  void Flip(const std::string& from, const std::string& first, const std::string& second) {
    LivingRobot& robot = Robot();
    Modes();
    ASSERT_THAT(Enter(from).status, IsOk());
    const int orders = robot->orders();
    CancelFlag given_up;
    std::thread order([&] {
      EXPECT_THAT(modes_->Enter("/safety", first, kLong, 2, given_up).status,
                  StatusIs(absl::StatusCode::kCancelled));
    });
    EXPECT_TRUE(dds::Eventually([&] { return robot->orders() > orders; }));
    CancelFlag().WaitFor(absl::Milliseconds(10));
    given_up.Cancel();
    order.join();
    EXPECT_THAT(Enter(second, kLong, 2).status, IsOk());
    EXPECT_EQ(robot->Mode(), second);
    // And stays there: what was ordered first has taken effect before the second was believed.
    EXPECT_THAT(Check(second), IsOk());
  }
};

TEST_F(FlipTest, RaiseThenLower) { Flip("__DEFAULT__", "ALERT", "__DEFAULT__"); }
TEST_F(FlipTest, LowerThenRaise) { Flip("ALERT", "__DEFAULT__", "ALERT"); }
TEST_F(FlipTest, RaiseThenRaiseFurther) { Flip("__DEFAULT__", "ALERT", "HALT"); }

}  // namespace
}  // namespace rips::actuator

// Changes of a level by hand reach those who watch alerts.
#include <string>

#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::Not;

class OrderAlertsTest : public RobotTest {
 protected:
  OrderAlertsTest() {
    Start(R"(
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
rules External:
  up: signal("SIGUSR1") ? alert("stopped by hand"), trigger(COMPROMISED);
  last: false ? trigger(ALERT), trigger(HALT);
)");
    Arm();
  }
  LevelAnswer Raise(const std::string& to, bool dry_run = false) {
    LevelAnswer answer;
    robot_->Raise(
        {.operator_name = "alice", .to = to, .reason = "a person fell", .dry_run = dry_run},
        [&](const LevelAnswer& got) { answer = got; });
    Drain();
    Obey();
    return answer;
  }
  LevelAnswer Lower(const std::string& to, bool accept_blind = false) {
    LevelAnswer answer;
    robot_->DeEscalate({.operator_name = "bob",
                        .to = to,
                        .reason = "the aisle is clear",
                        .expected_level = Level(),
                        .expected_decision_id = robot_->Status().decision_id,
                        .accept_blind = accept_blind},
                       [&](const LevelAnswer& got) { answer = got; });
    Drain();
    return answer;
  }
  static auto Alert(const std::string& severity, const std::string& text) {
    return Contains(AllOf(Field(&store::AlertRecord::severity, severity),
                          Field(&store::AlertRecord::text, HasSubstr(text))));
  }
};

TEST_F(OrderAlertsTest, ARaiseAndALoweringByHandAreToldWithTheirReasons) {
  ASSERT_THAT(Raise("COMPROMISED").status, IsOk());
  EXPECT_THAT(audience_.alerts, Alert("low",
                                      "operator alice raises r1 from DEFAULT to COMPROMISED: "
                                      "a person fell"));
  ASSERT_THAT(Lower("DEFAULT").status, IsOk());
  EXPECT_THAT(audience_.alerts, Alert("medium",
                                      "operator bob lowers r1 from COMPROMISED to "
                                      "DEFAULT: the aisle is clear"));
}

TEST_F(OrderAlertsTest, ALoweringOfARobotThatIsNotSeenIsHigh) {
  ASSERT_THAT(Raise("COMPROMISED").status, IsOk());
  robot_->OnSensorGone("base", sensor_.get());
  Drain();
  EXPECT_THAT(Lower("DEFAULT").status, StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(audience_.alerts, Not(Alert("high", "operator bob lowers")));
  ASSERT_THAT(Lower("DEFAULT", true).status, IsOk());
  EXPECT_THAT(audience_.alerts,
              Alert("high",
                    "operator bob lowers r1 from COMPROMISED to DEFAULT, though RIPS does "
                    "not see all of it ("));
}

TEST_F(OrderAlertsTest, WhatChangesNothingIsNotTold) {
  Raise("COMPROMISED", true);
  Raise("NOWHERE");
  EXPECT_THAT(audience_.alerts, Not(Alert("low", "operator alice")));
  Raise("COMPROMISED");
  const size_t told = audience_.alerts.size();
  Raise("COMPROMISED");
  EXPECT_EQ(audience_.alerts.size(), told) << "it is there already";
}

TEST_F(OrderAlertsTest, OneLoweringIsNotHiddenAmongOtherChanges) {
  for (int i = 0; i < 40; ++i) {
    Raise("ALERT");
    Lower("DEFAULT");
  }
  EXPECT_LT(audience_.Count("operator bob lowers"), 40) << "folded";
  Raise("HALT");
  Lower("DEFAULT");
  EXPECT_THAT(audience_.alerts, Alert("medium", "operator bob lowers r1 from HALT to DEFAULT"));
  Raise("ALERT");
  EXPECT_EQ(audience_.Count("from HALT to DEFAULT"), 1);
}

TEST_F(OrderAlertsTest, AnOrderWithoutTheRightToItIsToldAtPowersOfTwo) {
  const size_t before = audience_.alerts.size();
  for (int i = 0; i < 5; ++i) {
    robot_->RecordRefusedOrder({.operator_name = "vera", .to = "DEFAULT"},
                               absl::PermissionDeniedError("needs the role `operator`"));
  }
  Drain();
  EXPECT_THAT(audience_.alerts, Alert("medium",
                                      "operator vera was refused to move r1 to DEFAULT, "
                                      "1 time: needs the role `operator`"));
  EXPECT_LE(audience_.alerts.size(), before + 3);
}

TEST_F(OrderAlertsTest, ASignalIsJudgedAtOnceAndSaysWhoSentIt) {
  const LevelAnswer answer =
      robot_->SendSignal({.operator_name = "alice", .signal = "SIGUSR1", .reason = "fire drill"});
  Drain();

  EXPECT_THAT(answer.status, IsOk());
  EXPECT_EQ(answer.level_before, "DEFAULT");
  EXPECT_EQ(answer.decided_level, "COMPROMISED");
  EXPECT_EQ(Level(), "COMPROMISED");
  EXPECT_THAT(audience_.alerts, Alert("info", "operator alice sends SIGUSR1 to r1: fire drill"));
  EXPECT_THAT(audience_.alerts,
              Contains(Field(&store::AlertRecord::event, "signal SIGUSR1 sent by operator alice")));
}

TEST_F(OrderAlertsTest, ASignalThatNoRuleAsksForChangesNothing) {
  const LevelAnswer answer =
      robot_->SendSignal({.operator_name = "alice", .signal = "SIGUSR2", .reason = "a test"});
  EXPECT_THAT(answer.status, IsOk());
  EXPECT_EQ(answer.level_before, "DEFAULT");
  EXPECT_EQ(answer.decided_level, "DEFAULT");
}

TEST_F(OrderAlertsTest, ASignalOfAnotherNameOrWithoutReasonIsRefused) {
  for (const char* name : {"", "SIGKILL", "USR1", "SIGUSR1\n", "\x1b[2J"}) {
    const LevelAnswer answer =
        robot_->SendSignal({.operator_name = "alice", .signal = name, .reason = "a test"});
    EXPECT_THAT(answer.status, StatusIs(absl::StatusCode::kInvalidArgument,
                                        HasSubstr("is neither SIGUSR1 nor SIGUSR2")));
    EXPECT_THAT(std::string(answer.status.message()), Not(HasSubstr("\x1b")));
  }
  for (const std::string& reason : {std::string(), std::string(kReasonBytesMax + 1, 'r')}) {
    const LevelAnswer answer =
        robot_->SendSignal({.operator_name = "alice", .signal = "SIGUSR1", .reason = reason});
    EXPECT_THAT(answer.status, StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("reason")));
  }
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_THAT(audience_.alerts, Not(Alert("info", "sends")));
}

}  // namespace
}  // namespace rips::pipeline

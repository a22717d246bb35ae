#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/robot/sight/finding_registry.h"

namespace rips::pipeline {
namespace {

using News = FindingRegistry::News;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

FindingSeen Impostor(uint8_t number, const std::string& node = "/rips") {
  FindingSeen seen{.kind = "impostor", .node = node, .detail = "why"};
  seen.guid.bytes[11] = number;
  return seen;
}
FindingSeen Over(FindingSeen seen) {
  seen.over = true;
  return seen;
}

TEST(FindingsBookTest, IsNewsOnceUntilNobodySaysSo) {
  FindingRegistry book;
  book.OnIncarnation("base", "i1", 0);
  book.OnIncarnation("laptop", "j1", 0);
  EXPECT_EQ(book.Apply("base", "i1", Impostor(1), 0), News::kBegins);
  EXPECT_EQ(book.Apply("base", "i1", Impostor(1), 0), News::kKnown);
  EXPECT_EQ(book.Apply("laptop", "j1", Impostor(1), 0), News::kKnown);
  EXPECT_EQ(book.Apply("base", "i1", Impostor(2), 0), News::kBegins) << "another GUID";
  EXPECT_EQ(book.Apply("base", "i1", Impostor(1, "/ns/rips"), 0), News::kBegins) << "another node";
  EXPECT_THAT(book.standing(), SizeIs(3));
  EXPECT_EQ(book.standing()[1].guid, Impostor(2).guid) << "oldest first";

  EXPECT_EQ(book.Apply("base", "i1", Over(Impostor(1)), 0), News::kKnown) << "laptop says so";
  EXPECT_EQ(book.Apply("laptop", "j1", Over(Impostor(1)), 0), News::kEnds);
  EXPECT_EQ(book.Apply("laptop", "j1", Over(Impostor(1)), 0), News::kKnown);
  EXPECT_THAT(book.standing(), SizeIs(2));
}

TEST(FindingsBookTest, SensorThatWasStartedAgainMustTellItAgain) {
  FindingRegistry book({.confirm_ns = 100});
  book.OnIncarnation("base", "i1", 0);
  book.Apply("base", "i1", Impostor(1), 0);
  book.Apply("base", "i1", Impostor(2), 0);
  book.OnIncarnation("base", "i1", 5);
  EXPECT_THAT(book.Expire(1'000), IsEmpty()) << "a reconnect is no restart";

  book.OnIncarnation("base", "i2", 1'000);
  EXPECT_EQ(book.Apply("base", "i2", Impostor(2), 1'050), News::kKnown);
  EXPECT_THAT(book.Expire(1'099), IsEmpty());
  const std::vector<FindingSeen> gone = book.Expire(1'100);
  ASSERT_THAT(gone, SizeIs(1));
  EXPECT_EQ(gone[0].guid, Impostor(1).guid);
  EXPECT_THAT(book.standing(), SizeIs(1));
  // What the dead incarnation saw comes late from a spool.
  EXPECT_EQ(book.Apply("base", "i1", Impostor(3), 2'000), News::kBegins);
  EXPECT_EQ(book.Apply("base", "i1", Impostor(2), 2'000), News::kKnown);
  EXPECT_THAT(book.Expire(2'100), SizeIs(1));
  EXPECT_THAT(book.standing(), SizeIs(1)) << "the live one tells of the other";
}

TEST(FindingsBookTest, PastTheLimitFindingsAreNotKept) {
  FindingRegistry book({.standing = 2});
  EXPECT_EQ(book.Apply("base", "i", Impostor(1), 0), News::kBegins);
  EXPECT_EQ(book.Apply("base", "i", Impostor(2), 0), News::kBegins);
  EXPECT_EQ(book.Apply("base", "i", Impostor(3), 0), News::kTooMany);
  EXPECT_THAT(book.standing(), SizeIs(2));
  EXPECT_EQ(book.Apply("base", "i", Over(Impostor(3)), 0), News::kKnown);
  book.Apply("base", "i", Over(Impostor(1)), 0);
  EXPECT_EQ(book.Apply("base", "i", Impostor(3), 0), News::kBegins);
}

constexpr char kRules[] = R"(
levels:
  DEFAULT;
  ALERT;
  COMPROMISED;
  HALT;
rules External:
  rips_played: finding("impostor") ? alert("somebody plays RIPS", "low") => trigger(ALERT);
  never: false ? trigger(COMPROMISED);
  never_either: false ? trigger(HALT);
)";

class RobotFindingsTest : public RobotTest {
 protected:
  void Tell(FindingSeen finding) { SendBatch(Lane::kControl, {{.what = std::move(finding)}}); }
};

TEST_F(RobotFindingsTest, IsAnAlertAndAnEventOnceAndARecordWhenItIsOver) {
  Start(kRules);
  Arm();
  FindingSeen finding = Impostor(1);
  finding.topic = "/cmd_vel";
  Tell(finding);
  Pass(100);
  EXPECT_EQ(Level(), "ALERT");
  ASSERT_EQ(audience_.Count("finding impostor"), 1);
  for (const store::AlertRecord& alert : audience_.alerts) {
    if (alert.rule != "(rips)" || alert.event != "finding impostor") continue;
    EXPECT_EQ(alert.severity, "high");
    EXPECT_EQ(alert.text,
              "sensor base: finding impostor, node /rips, topic /cmd_vel, GUID "
              "00000000.00000000.00000001.00000000: why");
  }
  EXPECT_EQ(audience_.Count("somebody plays RIPS"), 1);
  ASSERT_THAT(robot_->core().findings().standing(), SizeIs(1));
  EXPECT_EQ(robot_->core().findings().standing()[0].node, "/rips");

  Tell(finding);
  Pass(100);
  EXPECT_EQ(audience_.Count("somebody plays RIPS"), 1);
  EXPECT_EQ(audience_.Count("finding impostor"), 1);
  const size_t alerts = audience_.alerts.size();
  Tell(Over(finding));
  Pass(100);
  EXPECT_THAT(robot_->core().findings().standing(), IsEmpty());
  EXPECT_EQ(audience_.alerts.size(), alerts);
  EXPECT_THAT(audience_.rule_logs,
              Contains(HasSubstr("(rips): no longer: finding impostor, node /rips")));
}

TEST_F(RobotFindingsTest, KindThatRulesDoNotKnowIsAnAlertAndNoEvent) {
  Start(kRules);
  Arm();
  Tell({.kind = "of_a_later_version", .detail = "x"});
  Tell(Over({.kind = "impostor", .node = "/never_told"}));
  Pass(100);
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(audience_.Count("finding of_a_later_version: x"), 1);
  EXPECT_EQ(audience_.Count("impostor"), 0);
}

TEST_F(RobotFindingsTest, FloodOfFindingsIsFoldedAndBounded) {
  Start(kRules);
  Arm();
  for (int i = 0; i < 60; ++i) {
    std::vector<Observation> batch;
    for (int j = 0; j < 100; ++j) {
      batch.push_back(
          {.what = FindingSeen{.kind = "non_ros_writer", .topic = absl::StrCat("/t", i, "_", j)}});
    }
    SendBatch(Lane::kControl, std::move(batch));
  }
  Pass(2'000);
  EXPECT_LE(audience_.Count("finding non_ros_writer"), 20) << "as RIPS's own alerts";
  Pass(60'000);
  EXPECT_EQ(audience_.Count("more alerts of this kind"), 1);
  EXPECT_THAT(robot_->core().findings().standing(), SizeIs(4'096));
}

TEST_F(RobotFindingsTest, RestartedSensorThatDoesNotTellThemAgainEndsThem) {
  Start(kRules);
  Arm();
  Tell(Impostor(1));
  sensor_heartbeats_ = false;
  Pass(2'000);
  sensor_ = std::make_shared<FakeSensor>();
  robot_->OnSensorHello("base", sensor_,
                        {.incarnation = "fedcba9876543210", .clock = clock_.Now()});
  sensor_heartbeats_ = true;
  Pass(59'000);
  EXPECT_THAT(robot_->core().findings().standing(), SizeIs(1));
  Pass(2'000);
  EXPECT_THAT(robot_->core().findings().standing(), IsEmpty());
  EXPECT_THAT(audience_.rule_logs, Contains(HasSubstr("not told again by a restarted sensor")));
}

TEST_F(RobotFindingsTest, SensorsAreToldWhichPartsToWatchOverAlsoWhileTheActuatorIsAway) {
  Start(kRules);
  ConnectSensor();
  EXPECT_THAT(sensor_->setup.protected_parts, IsEmpty());
  ConnectActuator({.effective_level = "DEFAULT",
                   .participant = Participant(7),
                   .protected_parts = {"/safety", "/camera", "/safety"}});
  EXPECT_THAT(sensor_->setup.protected_parts, ElementsAre("/camera", "/safety"));
  EXPECT_THAT(sensor_->setup.own_participants, ElementsAre(Participant(7)));
  robot_->OnActuatorGone("base", actuator_.get());
  EXPECT_THAT(sensor_->setup.protected_parts, ElementsAre("/camera", "/safety"));
  EXPECT_THAT(sensor_->setup.own_participants, ElementsAre(Participant(7))) << "it may be there";
  ConnectActuator({.effective_level = "DEFAULT",
                   .participant = Participant(8),
                   .protected_parts = {"/safety"}});
  EXPECT_THAT(sensor_->setup.protected_parts, ElementsAre("/safety"));
  EXPECT_THAT(sensor_->setup.own_participants, ElementsAre(Participant(7), Participant(8)))
      << "what was killed stays on the bus for a while";
  for (uint8_t i = 9; i < 30; ++i) {
    robot_->OnActuatorGone("base", actuator_.get());
    ConnectActuator({.effective_level = "DEFAULT", .participant = Participant(i)});
  }
  EXPECT_THAT(sensor_->setup.own_participants, SizeIs(8));
  EXPECT_EQ(sensor_->setup.own_participants.back(), Participant(29));
}

TEST_F(RobotFindingsTest, SensorsAreToldOfEachOther) {
  sensor_hosts_ = {"base", "laptop"};
  Start(kRules);
  robot_->OnSensorHello(
      "base", sensor_ = std::make_shared<FakeSensor>(),
      {.incarnation = kIncarnation, .clock = clock_.Now(), .participant = Participant(1)});
  EXPECT_THAT(sensor_->setup.own_participants, ElementsAre(Participant(1)));
  const auto laptop = std::make_shared<FakeSensor>();
  robot_->OnSensorHello(
      "laptop", laptop,
      {.incarnation = "fedcba9876543210", .clock = clock_.Now(), .participant = Participant(2)});
  EXPECT_THAT(sensor_->setup.own_participants, ElementsAre(Participant(1), Participant(2)));
  EXPECT_THAT(laptop->setup.own_participants, ElementsAre(Participant(1), Participant(2)));
  EXPECT_TRUE(sensor_->setup.primary);
  EXPECT_FALSE(laptop->setup.primary);
}

}  // namespace
}  // namespace rips::pipeline

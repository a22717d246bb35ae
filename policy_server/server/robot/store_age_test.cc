// A store that was restored from a backup: told once, not counted as loss, and no cover for losses.
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"

namespace rips::pipeline {
namespace {

// What a flood would do, and a loss.
constexpr char kFloodRules[] = R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules Msg:
  flood: msgcount(2000, 100, 1000000) ? alert("flood") => trigger(COMPROMISED);
rules External:
  lost: lostevents(1) ? alert("lost") => trigger(ALERT);
  last: false ? trigger(HALT);
)";

class StoreAgeTest : public RobotTest {
 protected:
  static constexpr char kFormer[] = "fedcba9876543210";
  static constexpr char kOlder[] = "a backup was restored";

  // The store that the server has, and a point of the one that the sensor has worked with.
  StoreAgeTest() {
    recorder_.generations = {{std::string(16, 'a'), 200}, {std::string(16, 'g'), 200}};
  }
  static store::StorePoint Point(char generation, uint64_t commit) {
    return {.generation = std::string(16, generation), .commit = commit};
  }
  // A process of the sensor that has just started: of the one before, messages from 391 on are left.
  SensorHello Restarted(const store::StorePoint& point, uint64_t first = 391) {
    return {.incarnation = kIncarnation,
            .clock = clock_.Now(),
            .spooled = {{.incarnation = kFormer,
                         .lane = Lane::kMessages,
                         .first_sequence = first,
                         .last_sequence = first + 9}},
            .store = point};
  }
  void Connect(const SensorHello& hello) {
    if (sensor_) robot_->OnSensorGone("base", sensor_.get());
    sensor_ = std::make_shared<FakeSensor>();
    robot_->OnSensorHello("base", sensor_, hello);
    AnswerInterest();
    Drain();
    Pass(1'000);
  }
  uint64_t Lost() const { return robot_->core().sight().Coverage()[0].lost; }
};

TEST_F(StoreAgeTest, ARestartedSensorsGapIsToldOnceAndIsNoLossNorFloodNorRaise) {
  Start(kFloodRules);
  ConnectActuator({.effective_level = "DEFAULT"});
  Obey();
  Connect(Restarted(Point('a', 390)));
  SendSnapshot();
  SendMessage(2);
  Pass(1'000);
  EXPECT_EQ(audience_.Count(kOlder), 1);
  EXPECT_EQ(audience_.Count("sensor base was told is durable, or another one (generation "
                            "61616161, commit 390; the store holds generation 67676767, commit "),
            1);
  EXPECT_EQ(audience_.Count("are lost"), 0);
  EXPECT_EQ(audience_.Count("flood"), 0);
  EXPECT_EQ(Lost(), 0u);
  EXPECT_EQ(Level(), "DEFAULT");
  for (const store::AlertRecord& alert : audience_.alerts) {
    EXPECT_EQ(absl::StrContains(alert.text, kOlder), alert.severity == "critical") << alert.text;
  }
}

TEST_F(StoreAgeTest, AStoreThatIsAnotherOneIsToldToo) {
  Start(kFloodRules);
  Connect(Restarted(Point('x', 5)));
  EXPECT_EQ(audience_.Count(kOlder), 1);
  EXPECT_EQ(Lost(), 0u);
}

TEST_F(StoreAgeTest, AStoreThatGoesOnExcusesNothing) {
  Start(kFloodRules);
  Connect(Restarted(Point('a', 200)));
  EXPECT_EQ(audience_.Count(kOlder), 0);
  EXPECT_EQ(Lost(), 390u);
  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(StoreAgeTest, ASensorThatDoesNotKnowTheStoreIsBelievedToHaveLost) {
  Start(kFloodRules);
  Connect(Restarted({}));
  EXPECT_EQ(audience_.Count(kOlder), 0);
  EXPECT_EQ(Lost(), 390u);
}

TEST_F(StoreAgeTest, ASensorThatNamesAnOlderStoreAgainAndAgainHidesNoLossByThat) {
  Start(kFloodRules);
  Connect(Restarted(Point('x', 1)));
  EXPECT_EQ(Lost(), 0u);
  for (uint64_t i = 1; i <= 3; ++i) {
    Connect(Restarted(Point('x', i), 391 + i * 100));
    EXPECT_EQ(Lost(), i * 100) << "excused once for each start of the server";
  }
  EXPECT_EQ(audience_.Count(kOlder), 1) << "told once";
}

TEST_F(StoreAgeTest, OfItsOwnProcessASensorKnowsWhatItWasTold) {
  Start(kFloodRules);
  SensorHello hello = Restarted(Point('x', 1));
  hello.spooled[0].incarnation = kIncarnation;
  Connect(hello);
  EXPECT_EQ(Lost(), 390u) << "nothing was acknowledged: they were shed";
}

TEST_F(StoreAgeTest, WhatWasShedAboveWhatWasAcknowledgedIsLostAllTheSame) {
  Start(kFloodRules);
  SensorHello hello = Restarted(Point('x', 1));
  hello.spooled[0].acknowledged = 380;
  Connect(hello);
  EXPECT_EQ(Lost(), 10u);
  EXPECT_EQ(audience_.Count(kOlder), 1);
}

TEST_F(StoreAgeTest, WhatASensorCallsAcknowledgedHidesOneGapAtMost) {
  Start(kFloodRules);
  for (uint64_t i = 0; i <= 3; ++i) {
    SensorHello hello = Restarted({}, 391 + i * 100);
    hello.spooled[0].acknowledged = hello.spooled[0].first_sequence - 1;
    Connect(hello);
    EXPECT_EQ(Lost(), i * 100);
  }
  EXPECT_EQ(audience_.Count(kOlder), 1);
}

TEST_F(StoreAgeTest, SensorsAreToldWhatTheStoreHolds) {
  Start();
  Arm();
  EXPECT_EQ(sensor_->setup.store.generation, std::string(16, 'g'));
  const uint64_t at_hello = sensor_->setup.store.commit;
  EXPECT_GE(at_hello, 200u);
  SendMessage(2);
  Pass(2'000);
  EXPECT_EQ(sensor_->acknowledged[static_cast<int>(Lane::kMessages)], 1u);
  EXPECT_GT(sensor_->acknowledged_commit, at_hello);
  EXPECT_EQ(sensor_->acknowledged_commit, recorder_.point().commit);
}

}  // namespace
}  // namespace rips::pipeline

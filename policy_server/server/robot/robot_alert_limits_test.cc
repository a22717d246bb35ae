// What an agent's stolen key can make RIPS write: each way for an agent to cause alerts, used as
// often and as fully as its streams allow for a minute, is bounded in number and in bytes.
#include <functional>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"

namespace rips::pipeline {
namespace {

using ::testing::EndsWith;
using ::testing::Le;
using ::testing::SizeIs;

constexpr size_t kKindBytes = 21 * kOwnAlertBytesMax;
// As in services/wire_limits, which needs protobuf.
constexpr uint64_t kTimeMax = (uint64_t{1} << 62) - 1;
constexpr uint64_t kSequenceMax = uint64_t{1} << 62;
constexpr uint64_t kLossCountMax = uint64_t{1} << 40;

// As long as a field may be, and never twice the same.
std::string Text(size_t bytes, uint64_t number) {
  std::string text = absl::StrCat(number, ": ");
  text.resize(bytes, 'x');
  return text;
}

class AlertFloodTest : public RobotTest {
 protected:
  void SetUp() override {
    Start();
    Arm();
  }

  size_t Written() const {
    size_t bytes = 0;
    for (const store::AlertRecord& alert : audience_.alerts) {
      bytes += alert.text.size() + alert.event.size();
    }
    return bytes;
  }
  // Bytes of alerts while `attack` is made twenty times a second for a minute.
  size_t Flood(const std::function<void(uint64_t)>& attack) {
    const size_t before = Written();
    for (uint64_t i = 1; i <= 1'200; ++i) {
      attack(i);
      clock_.Advance(50 * kNanosPerMilli);
      robot_->OnTime();
      Drain();
    }
    for (const store::AlertRecord& alert : audience_.alerts) {
      EXPECT_THAT(alert.text, SizeIs(Le(kOwnAlertBytesMax)));
    }
    return Written() - before;
  }
  ActuatorHello Hello() const {
    return {.levels = {"DEFAULT", "ALERT", "COMPROMISED", "HALT"}, .effective_level = "DEFAULT"};
  }
  // Its session is stale: the next hello is taken.
  void Attach(const ActuatorHello& hello) {
    if (actuator_) robot_->OnActuatorGone("base", actuator_.get());
    actuator_ = std::make_shared<FakeActuator>();
    robot_->OnActuatorHello("base", actuator_, hello);
  }
};

TEST_F(AlertFloodTest, ByReasonsForAFloor) {
  EXPECT_LE(Flood([&](uint64_t i) {
              floor_ = i % 2 == 0 ? "" : Text(1'024, i);
              Heartbeat();
            }),
            3 * kKindBytes);
}

TEST_F(AlertFloodTest, ByWhatIsDegraded) {
  EXPECT_LE(Flood([&](uint64_t i) {
              degraded_.clear();
              for (uint64_t k = 0; i % 2 == 0 && k < 8; ++k)
                degraded_.push_back(Text(256, 8 * i + k));
              Heartbeat();
            }),
            3 * kKindBytes);
}

TEST_F(AlertFloodTest, ByDriftsAndWhatIsObserved) {
  EXPECT_LE(Flood([&](uint64_t i) {
              drifts_ = i;
              robot_->OnActuatorHeartbeat("base", actuator_.get(),
                                          {.boottime_ns = Boottime(),
                                           .effective_level = "DEFAULT",
                                           .observed = Text(4'096, i),
                                           .drifts = drifts_});
            }),
            3 * kKindBytes);
}

TEST_F(AlertFloodTest, ByHellosWithLevelsThatAreNotTheBundles) {
  EXPECT_LE(Flood([&](uint64_t i) {
              ActuatorHello hello = Hello();
              hello.levels.clear();
              for (uint64_t k = 0; k < 64; ++k) hello.levels.push_back(Text(255, 64 * i + k));
              Attach(hello);
            }),
            4 * kKindBytes);
}

TEST_F(AlertFloodTest, ByTheStatusOfAStreamThatIsClosed) {
  ActuatorHello hello = Hello();
  hello.levels.assign(64, std::string(255, 'x'));
  Attach(hello);
  EXPECT_LE(actuator_->closed.message().size(), 4'096u) << "gRPC sends it as a header";
}

TEST_F(AlertFloodTest, ByHellosWithDecisionIdsAndTermsOfAllKinds) {
  EXPECT_LE(Flood([&](uint64_t i) {
              ActuatorHello hello = Hello();
              hello.state_lost = i % 2 == 0;
              hello.decision_id = {.term = i % 3 == 0 ? uint64_t{1} << 50 : i, .epoch = i};
              hello.decided_level = "DEFAULT";
              hello.peer = absl::StrCat("ipv4:10.0.0.", i % 250, ":1");
              hello.participant = Participant(2);
              Attach(hello);
            }),
            12 * kKindBytes);
}

TEST_F(AlertFloodTest, BySecondSessions) {
  EXPECT_LE(Flood([&](uint64_t i) {
              ActuatorHello hello = Hello();
              hello.peer = absl::StrCat("ipv4:10.0.0.", i % 250, ":1");
              robot_->OnActuatorHello("base", std::make_shared<FakeActuator>(), hello);
              robot_->OnSensorHello("base", std::make_shared<FakeSensor>(),
                                    {.incarnation = kIncarnation, .peer = hello.peer});
              Heartbeat();
              SendSensorHeartbeat();
            }),
            4 * kKindBytes);
}

TEST_F(AlertFloodTest, ByReceiptsOfEachStage) {
  EXPECT_LE(Flood([&](uint64_t i) {
              robot_->OnReceipt("base", actuator_.get(),
                                {.command_id = actuator_->commands.back().id,
                                 .decision_id = robot_->Status().decision_id,
                                 .stage = static_cast<Receipt::Stage>(i % 7),
                                 .output_tail = Text(65'536, i),
                                 .detail = Text(4'096, i),
                                 .effective_level = "DEFAULT"});
              Heartbeat();
            }),
            6 * kKindBytes);
}

// Each kind of finding is a kind of RIPS's own alerts.
TEST_F(AlertFloodTest, ByFindings) {
  EXPECT_LE(Flood([&](uint64_t i) {
              std::vector<Observation> findings;
              for (uint64_t k = 0; k < 4; ++k) {
                findings.push_back({.what = FindingSeen{.kind = "impostor",
                                                        .node = Text(512, 4 * i + k),
                                                        .topic = Text(512, 4 * i + k),
                                                        .detail = Text(512, i)}});
              }
              SendBatch(Lane::kControl, std::move(findings));
              Heartbeat();
            }),
            kKindBytes);
}

TEST_F(AlertFloodTest, ByFindingsOfKindsThatAreMadeUp) {
  EXPECT_LE(Flood([&](uint64_t i) {
              SendBatch(
                  Lane::kControl,
                  {{.what = FindingSeen{.kind = absl::StrCat("k", i), .detail = Text(512, i)}}});
              Heartbeat();
            }),
            kKindBytes);
}

// Each end of one that had an alert is an alert, too.
TEST_F(AlertFloodTest, ByFindingsThatComeAndGo) {
  EXPECT_LE(Flood([&](uint64_t i) {
              std::vector<Observation> findings;
              for (uint64_t k = 0; k < 4; ++k) {
                FindingSeen finding{.kind = "impostor",
                                    .node = Text(512, 4 * i + k),
                                    .topic = Text(512, 4 * i + k),
                                    .detail = Text(512, i)};
                findings.push_back({.what = finding});
                finding.over = true;
                findings.push_back({.what = std::move(finding)});
              }
              SendBatch(Lane::kControl, std::move(findings));
              Heartbeat();
            }),
            2 * kKindBytes);
}

TEST_F(AlertFloodTest, ByWhatASensorCannotSee) {
  EXPECT_LE(Flood([&](uint64_t i) {
              SensorStateSeen state{.overloaded = i % 2 == 0};
              for (uint64_t k = 0; k < 32; ++k) state.blind.push_back(Text(1'024, 32 * i + k));
              for (uint64_t k = 0; k < 64; ++k) {
                state.not_visible.push_back(Text(1'024, 64 * i + k));
              }
              SendBatch(Lane::kControl, {{.what = state}});
              Heartbeat();
            }),
            4 * kKindBytes);
}

TEST_F(AlertFloodTest, ByLossesThatAddUpToMoreThanANumberHolds) {
  EXPECT_LE(
      Flood([&](uint64_t) {
        SendBatch(Lane::kControl, {{.what = LossSeen{.count = UINT64_MAX, .cause = "queue"}}});
        SendBatch(Lane::kControl, {{.what = LossSeen{.count = UINT64_MAX, .cause = "queue"}}});
        Heartbeat();
      }),
      3 * kKindBytes);
  const std::vector<SensorCoverage> coverage = robot_->core().sight().Coverage();
  EXPECT_EQ(coverage[0].lost, UINT64_MAX) << "not what is left of it after an overflow";
}

TEST_F(AlertFloodTest, ByGapsInManyAnnouncedRanges) {
  EXPECT_LE(Flood([&](uint64_t i) {
              std::vector<SpooledRange> ranges;
              for (uint64_t k = 0; k < 64; ++k) {
                ranges.push_back(
                    {.incarnation = absl::StrCat(i, "-", k), .first_sequence = kSequenceMax});
              }
              robot_->OnSensorGone("base", sensor_.get());
              ConnectSensor(ranges);
              Heartbeat();
            }),
            8 * kKindBytes);
  EXPECT_EQ(robot_->core().sight().Coverage()[0].lost, UINT64_MAX);
}

TEST_F(AlertFloodTest, ByReportsOfOthersWhichDoNotPushEachOtherOut) {
  EXPECT_LE(Flood([&](uint64_t i) { robot_->Report(engine::Severity::kHigh, Text(1 << 20, i)); }),
            2 * kKindBytes);
  const int before = audience_.Count("its certificate is revoked");
  robot_->Report(engine::Severity::kHigh, "its certificate is revoked");
  Drain();
  EXPECT_EQ(audience_.Count("its certificate is revoked"), before + 1)
      << "another place in the code is another kind";
}

// All clocks that the wire lets through, in each place that takes one.
TEST_F(AlertFloodTest, ClocksAtTheirLimitsOverflowNothing) {
  constexpr auto kMost = static_cast<int64_t>(kTimeMax);
  for (const int64_t hello_ns : {int64_t{0}, int64_t{1}, kMost}) {
    for (const int64_t seen_ns : {int64_t{1}, kMost}) {
      robot_->OnSensorGone("base", sensor_.get());
      sensor_ = std::make_shared<FakeSensor>();
      robot_->OnSensorHello(
          "base", sensor_,
          {.incarnation = kIncarnation, .clock = {.boottime_ns = hello_ns, .unix_ns = hello_ns}});
      robot_->OnSensorHeartbeat(
          "base", sensor_.get(),
          {.clock = {.boottime_ns = seen_ns, .unix_ns = seen_ns}, .echo_boottime_ns = seen_ns});
      SendBatch(Lane::kControl, {{.boottime_ns = seen_ns,
                                  .what = LossSeen{.count = kLossCountMax,
                                                   .topic = "/cmd_vel",
                                                   .first_ns = 1,
                                                   .last_ns = seen_ns}},
                                 {.boottime_ns = seen_ns, .what = SignalSeen{.name = "SIGUSR1"}}});
      SendBatch(Lane::kControl, {{.boottime_ns = seen_ns, .what = SensorStateSeen{}}});
      SendMessage(2);
      clock_.Advance(300 * kNanosPerMilli);
      robot_->OnTime();
      Drain();
    }
  }
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(AlertFloodTest, AnEventInAnAlertIsCut) {
  Start(R"(
levels:
  DEFAULT;
  HALT;
rules External:
  R: idsalert("m") ? alert("seen", "high");
  last: false ? trigger(HALT);
)");
  next_sequence_[static_cast<int>(Lane::kControl)] = 1;
  ConnectSensor();
  SendSnapshot();
  SendBatch(Lane::kControl, {{.what = IdsAlert{.message = std::string(4'096, 'm')}}});
  ASSERT_EQ(audience_.Count("seen"), 1);
  EXPECT_THAT(audience_.alerts.back().event, SizeIs(Le(kAlertEventBytesMax)));
  EXPECT_THAT(audience_.alerts.back().event, EndsWith("..."));
}

}  // namespace
}  // namespace rips::pipeline

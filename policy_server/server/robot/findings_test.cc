#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/robot/sight/finding_samples.h"
#include "policy_server/server/robot/told_findings.h"
#include "services/model/finding_digest.h"

namespace rips::pipeline {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Pair;
using ::testing::SizeIs;

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
  void SayFindings(bool all_told = true) {
    SendBatch(Lane::kControl, {{.what = ToldFindings(*robot_, all_told)}});
  }
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
  ASSERT_THAT(robot_->core().findings().known().standing(), SizeIs(1));
  EXPECT_EQ(robot_->core().findings().known().standing()[0].node, "/rips");

  Tell(finding);
  Pass(100);
  EXPECT_EQ(audience_.Count("somebody plays RIPS"), 1);
  EXPECT_EQ(audience_.Count("finding impostor"), 1);
  const size_t alerts = audience_.alerts.size();
  Tell(Over(finding));
  Pass(100);
  EXPECT_THAT(robot_->core().findings().known().standing(), IsEmpty());
  ASSERT_EQ(audience_.alerts.size(), alerts + 1);
  const store::AlertRecord& end = audience_.alerts.back();
  EXPECT_EQ(end.severity, "info");
  EXPECT_EQ(end.event, "finding impostor ended");
  EXPECT_THAT(end.text, HasSubstr("finding ended: impostor, node /rips, topic /cmd_vel"));
  EXPECT_TRUE(end.trace.finding.over);
  EXPECT_EQ(end.trace.finding.topic, "/cmd_vel");
  EXPECT_THAT(audience_.rule_logs,
              Contains(HasSubstr("(rips): no longer: finding impostor, node /rips")));
}

TEST_F(RobotFindingsTest, AlertNamesTheParticipantsAsTheGraphShowsThem) {
  Start(kRules);
  Arm();
  ros2::GraphDelta delta;
  delta.upsert_participants = {
      {.guid = Participant(7), .host = "lab-pc", .pid = 4'711, .address = "10.0.0.66"},
      {.guid = Participant(8), .host = "base", .pid = 12}};
  delta.upsert_nodes = {{.full_name = "/camera", .participant = Participant(7)},
                        {.full_name = "/camera", .participant = Participant(8)}};
  SendDelta(std::move(delta));
  Tell({.kind = "non_ros_writer", .guid = Writer(7), .topic = "/cmd_vel", .detail = "why"});
  Pass(100);
  const store::AlertRecord& alert = audience_.alerts.back();
  EXPECT_EQ(alert.event, "finding non_ros_writer");
  EXPECT_EQ(alert.trace.finding,
            (FindingSeen{.kind = "non_ros_writer", .guid = Writer(7), .topic = "/cmd_vel"}));
  EXPECT_THAT(alert.trace.subjects,
              ElementsAre(engine::TracedSubject{.name = "/cmd_vel",
                                                .role = "finding non_ros_writer",
                                                .guid = Writer(7),
                                                .host = "lab-pc",
                                                .pid = 4'711,
                                                .address = "10.0.0.66"}));

  Tell({.kind = "duplicate_node", .guid = Participant(7), .node = "/camera"});
  Pass(100);
  const auto& both = audience_.alerts.back().trace.subjects;
  EXPECT_THAT(both, SizeIs(3)) << "the first /camera, too";
  EXPECT_EQ(both[0].role, "finding duplicate_node, is a node");
  EXPECT_EQ(both[0].pid, 4'711u);

  Tell({.kind = "foreign_mode_writer",
        .guid = Writer(50),
        .node = "/evil",
        .topic = "/safety/change_mode"});
  Pass(100);
  ASSERT_THAT(audience_.alerts.back().trace.subjects, SizeIs(1));
  EXPECT_EQ(audience_.alerts.back().trace.subjects[0].role,
            "finding foreign_mode_writer on /safety/change_mode");
  EXPECT_EQ(audience_.alerts.back().trace.subjects[0].host, "") << "it has left the graph";

  Tell({.kind = "non_ros_reader", .detail = "7 more came and went within a minute"});
  Pass(100);
  EXPECT_FALSE(audience_.alerts.back().trace.has_finding()) << "it names nothing";
  const size_t alerts = audience_.alerts.size();
  Tell(Over({.kind = "non_ros_reader"}));
  Pass(100);
  EXPECT_EQ(audience_.alerts.size(), alerts);
}

TEST_F(RobotFindingsTest, SummaryNamesOneThatStandsAmongThoseThatHaveGone) {
  Start(kRules);
  Arm();
  Pass(60'000);
  const auto reader = [](int i) {
    return FindingSeen{.kind = "non_ros_reader", .topic = absl::StrCat("/t", i), .detail = "reads"};
  };
  for (int i = 0; i < 20; ++i) Tell(reader(i));
  for (int i = 20; i < 60; ++i) {
    Tell(reader(i));
    if (i != 33) Tell(Over(reader(i)));
  }
  SayFindings();
  Pass(2'000);
  EXPECT_EQ(audience_.Count("finding non_ros_reader, topic /t33"), 0) << "folded away";
  EXPECT_EQ(audience_.Count("finding ended: "), 0) << "of those that no alert names";
  Pass(59'000);
  EXPECT_EQ(audience_.Count("40 more findings non_ros_reader began within 1 s, merged into this "
                            "alert; 1 of them stand now; all that stand: ripsctl robot coverage "
                            "r1; the newest of them: finding non_ros_reader, topic /t33: reads"),
            1);
  const store::AlertRecord& summary = audience_.alerts.back();
  EXPECT_EQ(summary.severity, "high");
  EXPECT_EQ(summary.event, "finding non_ros_reader");
  EXPECT_EQ(summary.trace.finding.topic, "/t33");
  EXPECT_EQ(audience_.Count("more alerts of this kind"), 0) << "no second summary of the same";
  Tell(Over(reader(33)));
  Pass(100);
  EXPECT_EQ(audience_.Count("finding ended: non_ros_reader, topic /t33"), 1) << "it has a name";
}

TEST_F(RobotFindingsTest, SummaryClaimsNothingThatIsNotKnown) {
  Start(kRules);
  Arm();
  Pass(60'000);
  for (int i = 0; i < 30; ++i) {
    const FindingSeen finding{.kind = "non_ros_reader", .topic = absl::StrCat("/t", i)};
    Tell(finding);
    if (i % 2 == 1) Tell(Over(finding));
  }
  const FindingSeen made_up{.kind = "odd"};
  for (int i = 0; i < 30; ++i) {
    Tell(made_up);
    Tell(Over(made_up));
  }
  robot_->OnSensorGone("base", sensor_.get());
  sensor_.reset();
  Pass(61'000);
  EXPECT_EQ(audience_.Count("10 more findings non_ros_reader began within 1 s, merged into this "
                            "alert; 5 of them stood as reported last (sensor base is not "
                            "connected); all that stand: ripsctl robot coverage r1; "),
            1);
  EXPECT_EQ(audience_.Count("10 more findings of kinds that rules cannot name began within 1 s, "
                            "merged into this alert; whether they stand is not known (sensor base "
                            "is not connected); "),
            1);
}

TEST_F(RobotFindingsTest, SummarySaysThatNoneStands) {
  Start(kRules);
  Arm();
  Pass(60'000);
  for (int i = 0; i < 50; ++i) {
    const FindingSeen finding{.kind = "non_ros_reader", .topic = absl::StrCat("/t", i)};
    Tell(finding);
    Tell(Over(finding));
  }
  SayFindings();
  Pass(61'000);
  EXPECT_EQ(audience_.Count("30 more findings non_ros_reader began within 1 s, merged into this "
                            "alert; none of them stands now; "),
            1);
  EXPECT_EQ(audience_.Count("finding ended: non_ros_reader"), 20) << "as many as began";
}

TEST_F(RobotFindingsTest, EndsThatExceedTheLimitAreFoldedToo) {
  Start(kRules);
  Arm();
  const auto reader = [](int i) {
    return FindingSeen{.kind = "non_ros_reader", .topic = absl::StrCat("/t", i)};
  };
  // As slowly as each has an alert of its own.
  for (int i = 0; i < 30; ++i) {
    Tell(reader(i));
    Pass(60'000);
  }
  for (int i = 0; i < 30; ++i) Tell(Over(reader(i)));
  Pass(100);
  EXPECT_EQ(audience_.Count("finding ended: "), 20);
  Pass(61'000);
  EXPECT_EQ(audience_.Count("10 more findings non_ros_reader ended within 1 s, merged into this "
                            "alert; last: finding ended: non_ros_reader, topic /t29"),
            1);
}

TEST_F(RobotFindingsTest, StateOfAFindingIsToldOnlyAsFarAsItIsKnown) {
  using State = FindingState::State;
  Start(kRules);
  const FindingsKnown& findings = robot_->core().findings().known();
  const auto reasons = [&](const FindingSeen& of) { return findings.StateOf(of).not_known; };
  EXPECT_THAT(findings.NotKnown(), ElementsAre("sensor base is not connected"));
  EXPECT_EQ(findings.StateOf(Impostor(1)).state, State::kNotKnown);
  Arm();
  EXPECT_THAT(findings.NotKnown(),
              ElementsAre("sensor base has not said yet which findings stand"));
  EXPECT_EQ(findings.StateOf(Impostor(1)).state, State::kNotKnown);
  Tell(Impostor(1));
  EXPECT_EQ(findings.StateOf(Impostor(1)).state, State::kStands);
  EXPECT_EQ(findings.StateOf(Impostor(1)).since_unix_ns, clock_.Now().unix_ns);
  EXPECT_EQ(findings.StateOf(Impostor(2)).state, State::kNotKnown);
  SayFindings();
  EXPECT_THAT(findings.NotKnown(), IsEmpty());
  EXPECT_EQ(findings.StateOf(Impostor(2)).state, State::kEnded);
  EXPECT_EQ(findings.StateOf(Impostor(2)).ended_unix_ns, 0) << "not seen";

  const int64_t ended = clock_.Now().unix_ns;
  Tell(Over(Impostor(1)));
  Pass(1'000);
  SayFindings();
  EXPECT_EQ(findings.StateOf(Impostor(1)).state, State::kEnded);
  EXPECT_EQ(findings.StateOf(Impostor(1)).ended_unix_ns, ended);
  EXPECT_THAT(reasons(Impostor(1)), IsEmpty());

  Tell(Impostor(3));
  robot_->OnSensorGone("base", sensor_.get());
  EXPECT_EQ(findings.StateOf(Impostor(3)).state, State::kNotKnown);
  EXPECT_GT(findings.StateOf(Impostor(3)).since_unix_ns, 0) << "it stood";
  EXPECT_THAT(reasons(Impostor(3)), ElementsAre("sensor base is not connected"));
  EXPECT_EQ(findings.StateOf(Impostor(1)).state, State::kEnded);
  EXPECT_THAT(reasons(Impostor(1)), ElementsAre("sensor base is not connected"))
      << "it may have begun anew";

  sensor_ = std::make_shared<FakeSensor>();
  robot_->OnSensorHello("base", sensor_,
                        {.incarnation = "fedcba9876543210", .clock = clock_.Now()});
  EXPECT_THAT(reasons(Impostor(3)),
              ElementsAre("sensor base was restarted and has not reported it again yet"));
  sensor_heartbeats_ = true;
  Pass(61'000);
  EXPECT_EQ(findings.StateOf(Impostor(3)).state, State::kEnded);
  EXPECT_GT(findings.StateOf(Impostor(3)).ended_unix_ns, 0);
  EXPECT_THAT(reasons(Impostor(3)),
              ElementsAre("sensor base has not said yet which findings stand"));
  EXPECT_EQ(
      audience_.Count(
          "finding ended, as its sensor, restarted or asked to, did not report it again: impostor"),
      1);
}

TEST_F(RobotFindingsTest, ASilentSensorOrABacklogIsNotTheLatestWord) {
  Start(kRules);
  Arm();
  Pass(61'000);
  Tell(Impostor(1));
  sensor_heartbeats_ = false;
  Pass(2'000);
  const FindingsKnown& findings = robot_->core().findings().known();
  EXPECT_THAT(findings.NotKnown(), ElementsAre("sensor base is silent"));
  EXPECT_THAT(findings.StateOf(Impostor(1)).not_known, ElementsAre("sensor base is silent"));
  robot_->OnSensorGone("base", sensor_.get());
  ConnectSensor({{.incarnation = kIncarnation, .first_sequence = 1, .last_sequence = 1'000}});
  EXPECT_THAT(findings.NotKnown(), ElementsAre("observations of sensor base are not judged yet"));
}

TEST_F(RobotFindingsTest, OfAServerThatWasRestartedASensorIsAskedIfItHasToldMore) {
  sensor_hosts_ = {"base", "laptop"};
  Start(kRules);
  const auto laptop = std::make_shared<FakeSensor>();
  Arm();
  robot_->OnSensorHello("laptop", laptop, {.incarnation = kIncarnation, .clock = clock_.Now()});
  const auto say = [&](uint64_t digest, uint64_t sequence) {
    robot_->OnBatch("laptop", laptop.get(),
                    std::make_shared<Batch>(Batch{
                        .incarnation = kIncarnation,
                        .lane = Lane::kControl,
                        .first_sequence = sequence,
                        .observations = {{.what = SensorStateSeen{.findings_digest = digest,
                                                                  .findings_all_told = true}}}}));
    Drain();
  };
  const auto pass = [&](int seconds) {
    for (int i = 0; i < seconds; ++i) {
      robot_->OnSensorHeartbeat("laptop", laptop.get(), {.clock = clock_.Now()});
      Pass(1'000);
    }
  };
  SayFindings();
  say(model::DigestOf(Impostor(1)), 1);
  const FindingsKnown& findings = robot_->core().findings().known();
  EXPECT_THAT(findings.NotKnown(),
              ElementsAre("sensor laptop has not confirmed yet what it has reported last"));
  pass(4);
  EXPECT_FALSE(laptop->setup.want_findings);
  pass(2);
  EXPECT_TRUE(laptop->setup.want_findings);
  EXPECT_FALSE(laptop->setup.want_snapshot);
  EXPECT_FALSE(sensor_->setup.want_findings);
  pass(1);
  constexpr char kInVain[] = "sensor laptop says that it finds something else than it has reported";
  EXPECT_EQ(audience_.Count(kInVain), 0);
  pass(180);
  EXPECT_EQ(audience_.Count(kInVain), 1);
  say(0, 2);
  robot_->OnSensorHeartbeat("laptop", laptop.get(), {.clock = clock_.Now()});
  EXPECT_THAT(findings.NotKnown(), IsEmpty()) << "it is over by now";
}

constexpr char kSoftRules[] = R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules External:
  found: CurrLevel < ALERT && findingstands("impostor") ? trigger(ALERT);
  calm: CurrLevel == ALERT && !findingstands("any") ? trigger(DEFAULT);
  false ? trigger(COMPROMISED), trigger(HALT);
)";

TEST_F(RobotFindingsTest, RulesLowerWhenNoFindingStandsAndAllIsTold) {
  Start(kSoftRules);
  Arm();
  Tell(Impostor(1));
  Pass(300);
  EXPECT_EQ(Level(), "ALERT");
  Obey();
  Tell(Over(Impostor(1)));
  SayFindings(/*all_told=*/false);
  Pass(60'000);
  EXPECT_EQ(Level(), "ALERT") << "the sensor may have more to tell";
  SayFindings();
  Pass(10'000);
  EXPECT_EQ(Level(), "DEFAULT");
  Obey();
  Pass(10'000);

  Tell(Impostor(2));
  Tell({.kind = "of_a_later_version", .node = "/x"});
  Pass(300);
  EXPECT_EQ(Level(), "ALERT");
  Obey();
  Tell(Over(Impostor(2)));
  SayFindings();
  Pass(60'000);
  EXPECT_EQ(Level(), "ALERT") << "of any kind";
  Tell(Over({.kind = "of_a_later_version", .node = "/x"}));
  Pass(10'000);
  EXPECT_EQ(Level(), "ALERT") << "it has not said that this was all";
  SayFindings();
  Pass(20'000);
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(RobotFindingsTest, AFindingThatBeginsWhileALoweringIsRecordedTakesItBack) {
  Start(kSoftRules);
  Arm();
  Tell(Impostor(1));
  Pass(300);
  ASSERT_EQ(Level(), "ALERT");
  Obey();
  Tell(Over(Impostor(1)));
  SayFindings();
  recorder_.held = true;
  Pass(10'000);
  ASSERT_EQ(Level(), "DEFAULT") << "decided, not recorded";
  // Of a kind that no rule raises the level for.
  Tell({.kind = "non_ros_writer", .topic = "/t"});
  recorder_.held = false;
  recorder_.Release();
  Drain();
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(actuator_->level()->to, "ALERT");
  EXPECT_EQ(audience_.Count("a lowering was taken back: while it was recorded, sensor base "
                            "found non_ros_writer"),
            1);
}

TEST_F(RobotFindingsTest, RulesSeeAFindingOfASensorThatIsSilentAndNoEndOfOne) {
  Start(kSoftRules);
  Arm();
  SayFindings();
  const engine::StandingFindings& seen = robot_->core().findings().seen_by_rules();
  EXPECT_EQ(seen.Stands("any"), false);
  Tell(Impostor(1));
  EXPECT_EQ(seen.Stands("impostor"), true);
  EXPECT_EQ(seen.Stands("non_ros_reader"), std::nullopt) << "its next state comes later";
  SayFindings();
  EXPECT_EQ(seen.Stands("non_ros_reader"), false);
  sensor_heartbeats_ = false;
  Pass(2'000);
  EXPECT_EQ(seen.Stands("impostor"), true);
  EXPECT_EQ(seen.Stands("non_ros_reader"), std::nullopt);
  sensor_heartbeats_ = true;
  Pass(1'000);
  EXPECT_EQ(seen.Stands("non_ros_reader"), false);
  Tell(Over(Impostor(1)));
  EXPECT_EQ(seen.Stands("impostor"), std::nullopt);
  SayFindings();
  EXPECT_EQ(seen.Stands("impostor"), false);
  robot_->OnSensorGone("base", sensor_.get());
  EXPECT_EQ(seen.Stands("impostor"), std::nullopt);
}

TEST_F(RobotFindingsTest, WhileASecondProcessUsesASensorsKeyNothingIsKnown) {
  Start(kSoftRules);
  Arm();
  SayFindings();
  const Findings& findings = robot_->core().findings();
  ASSERT_THAT(findings.known().NotKnown(), IsEmpty());
  robot_->OnSensorHello(
      "base", std::make_shared<FakeSensor>(),
      {.incarnation = "fedcba9876543210", .clock = clock_.Now(), .peer = "ipv4:10.0.0.66:4711"});
  Pass(2'000);
  EXPECT_THAT(findings.known().NotKnown(),
              ElementsAre("a second process uses the key of sensor base"));
  EXPECT_EQ(findings.seen_by_rules().Stands("any"), std::nullopt);
  Pass(91'000);
  EXPECT_THAT(findings.known().NotKnown(), IsEmpty());
  EXPECT_EQ(findings.seen_by_rules().Stands("any"), false);
}

TEST_F(RobotFindingsTest, WhatAnOlderIncarnationSaysOfItsFindingsCountsForNothing) {
  Start(kSoftRules);
  Arm();
  SayFindings();
  const engine::StandingFindings& seen = robot_->core().findings().seen_by_rules();
  EXPECT_EQ(seen.Stands("any"), false);
  robot_->OnSensorGone("base", sensor_.get());
  sensor_ = std::make_shared<FakeSensor>();
  const std::string before = "fedcba9876543210";
  robot_->OnSensorHello("base", sensor_,
                        {.incarnation = kIncarnation,
                         .clock = clock_.Now(),
                         .spooled = {{.incarnation = before,
                                      .lane = Lane::kControl,
                                      .first_sequence = 1,
                                      .last_sequence = 1}}});
  robot_->OnBatch("base", sensor_.get(),
                  std::make_shared<Batch>(Batch{
                      .incarnation = before,
                      .lane = Lane::kControl,
                      .first_sequence = 1,
                      .observations = {{.what = SensorStateSeen{.findings_digest = 0,
                                                                .findings_all_told = true}}}}));
  Drain();
  Pass(500);
  EXPECT_EQ(seen.Stands("any"), std::nullopt);
  SayFindings();
  EXPECT_EQ(seen.Stands("any"), false);
}

TEST_F(RobotFindingsTest, WhatARemovedSensorFoundEnds) {
  sensor_hosts_ = {"base", "laptop"};
  Start(kSoftRules);
  const auto laptop = std::make_shared<FakeSensor>();
  Arm();
  robot_->OnSensorHello("laptop", laptop, {.incarnation = kIncarnation, .clock = clock_.Now()});
  robot_->OnBatch("laptop", laptop.get(),
                  std::make_shared<Batch>(Batch{.incarnation = kIncarnation,
                                                .lane = Lane::kControl,
                                                .first_sequence = 1,
                                                .observations = {{.what = Impostor(1)}}}));
  Drain();
  const engine::StandingFindings& seen = robot_->core().findings().seen_by_rules();
  EXPECT_EQ(seen.Stands("impostor"), true);
  robot_->SetHosts(
      {.id = "r1", .sensor_hosts = {"base"}, .primary_sensor = "base", .actuator_hosts = {"base"}});
  Drain();
  SayFindings();
  EXPECT_EQ(seen.Stands("impostor"), false);
}

TEST_F(RobotFindingsTest, InBriefThereAreCountsByKindAndTheNewest) {
  Start(kRules);
  Arm();
  SayFindings();
  const FindingsKnown& findings = robot_->core().findings().known();
  EXPECT_EQ(findings.Now().total, 0u);
  EXPECT_THAT(findings.Now().not_known, IsEmpty());
  ros2::GraphDelta delta;
  delta.upsert_participants = {{.guid = Participant(7), .host = "lab-pc", .pid = 4'711}};
  SendDelta(std::move(delta));
  for (int i = 0; i < 3; ++i) {
    Tell({.kind = "non_ros_reader", .guid = Participant(7), .topic = absl::StrCat("/t", i)});
  }
  for (int i = 0; i < 300; ++i) Tell({.kind = absl::StrCat("odd", i), .node = "/x"});
  for (uint8_t i = 0; i < 4; ++i) Tell(Impostor(i));
  const FindingsNow now = findings.Now();
  EXPECT_EQ(now.total, 307u);
  EXPECT_THAT(now.kinds,
              ElementsAre(Pair("other", 300), Pair("impostor", 4), Pair("non_ros_reader", 3)));
  ASSERT_THAT(now.newest, SizeIs(kNewestFindingsMax));
  EXPECT_EQ(now.newest[0].finding, Impostor(3));
  EXPECT_EQ(now.newest[4].finding.kind, "odd299");
  Tell({.kind = "non_ros_reader", .guid = Participant(7), .topic = "/new"});
  ASSERT_THAT(findings.Now().newest[0].subjects, SizeIs(1));
  EXPECT_EQ(findings.Now().newest[0].subjects[0].host, "lab-pc");
  EXPECT_EQ(findings.Now().newest[0].since_unix_ns, clock_.Now().unix_ns);
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
  SendBatch(Lane::kControl, {{.what = SensorStateSeen{.findings_digest = 1}}});
  Pass(60'000);
  EXPECT_EQ(audience_.Count("5980 more findings non_ros_writer began within 1 s, merged into this "
                            "alert; 4076 of them stood as reported last (sensor base has reported "
                            "more findings than the 4096 that are kept); "),
            1);
  EXPECT_THAT(robot_->core().findings().known().standing(), SizeIs(4'096));
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
  EXPECT_THAT(robot_->core().findings().known().standing(), SizeIs(1));
  Pass(2'000);
  EXPECT_THAT(robot_->core().findings().known().standing(), IsEmpty());
  EXPECT_THAT(audience_.rule_logs,
              Contains(HasSubstr("not told again by a sensor that was restarted")));
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

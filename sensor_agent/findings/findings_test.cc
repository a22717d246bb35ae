#include "sensor_agent/findings/findings.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/findings/findings_fixture.h"

namespace rips::sensor {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using ::testing::StartsWith;
using ::testing::UnorderedElementsAre;

TEST_F(FindingsTest, OneNodeNameInTwoParticipants) {
  Step(Process(1, "/camera"));
  EXPECT_THAT(Poll(), IsEmpty());
  now_ns_ += kSecond;
  Step(Process(2, "/camera"));

  const std::vector<Finding> told = Poll();
  ASSERT_THAT(told, ElementsAre(Begins("duplicate_node", ParticipantGuid(2)))) << "the later one";
  EXPECT_EQ(told[0].node, "/camera");
  EXPECT_THAT(told[0].detail, HasSubstr("2 participants"));
  EXPECT_THAT(told[0].detail, HasSubstr("host h, process 7"));
  Step(Process(3, "/camera"));
  EXPECT_THAT(Poll(), IsEmpty()) << "told already";
  EXPECT_THAT(findings_->Told(), SizeIs(1));
  Gone(ParticipantGuid(3));
  Gone(ParticipantGuid(1));
  EXPECT_THAT(Poll(), ElementsAre(Ends("duplicate_node", ParticipantGuid(2))));
  EXPECT_THAT(findings_->Told(), IsEmpty());
  Gone(ParticipantGuid(2));
  EXPECT_THAT(Poll(), IsEmpty());
}

TEST_F(FindingsTest, TakingTheNameBackEndsADuplicate) {
  Step(Process(1, "/camera"));
  Step(Process(2, "/camera"));
  EXPECT_THAT(Poll(), SizeIs(1));
  // As the graph tells it: all of that name go, the survivor comes again.
  Step({.upsert_nodes = {{.full_name = "/camera", .participant = ParticipantGuid(1)}},
        .gone_nodes = {"/camera"}});
  EXPECT_THAT(Poll(), ElementsAre(Ends("duplicate_node", testing::_)));
}

TEST_F(FindingsTest, TwoNodesOfOneNameInOneParticipantAreNotSeenAsTwo) {
  GraphDelta delta = Process(1, "/camera");
  delta.upsert_nodes.push_back({.full_name = "/camera", .participant = ParticipantGuid(1)});
  Step(std::move(delta));
  EXPECT_THAT(Poll(), IsEmpty());
}

TEST_F(FindingsTest, NodeThatCallsItselfRips) {
  Step(Process(1, "/rips"));
  Step(Process(2, "/ns/rips"));
  Step(Process(3, "/rips_viewer"));
  Step(Process(4, "/grips"));
  EXPECT_THAT(After(5 * kSecond - 1), IsEmpty()) << "the server may say that it is an agent";
  EXPECT_THAT(After(1), UnorderedElementsAre(Begins("impostor", ParticipantGuid(1)),
                                             Begins("impostor", ParticipantGuid(2))));
  Gone(ParticipantGuid(1));
  EXPECT_THAT(Poll(), ElementsAre(Ends("impostor", ParticipantGuid(1))));
}

TEST_F(FindingsTest, AgentsThatTheServerNamesInTimeAreNoImpostors) {
  // An actuator, and the sensor and the actuator of another host: all call themselves /rips.
  for (uint16_t participant : {2, 3, 4}) Step(Process(participant, "/rips"));
  EXPECT_THAT(After(4'900 * kMs), IsEmpty());
  findings_->SetOwnParticipants({ParticipantGuid(2), ParticipantGuid(3), ParticipantGuid(4)});
  EXPECT_THAT(After(60 * kSecond), IsEmpty()) << "nor are they duplicates of each other";
  // One is started again.
  Step(Process(5, "/rips"));
  EXPECT_THAT(After(3 * kSecond), IsEmpty());
  findings_->SetOwnParticipants({ParticipantGuid(2), ParticipantGuid(3), ParticipantGuid(5)});
  Gone(ParticipantGuid(4));
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
}

TEST_F(FindingsTest, ImpostorAmongAgentsIsFoundAlsoIfItWasThereFirst) {
  findings_->SetConnected(false, now_ns_);
  Step(Process(7, "/rips"));
  Step(Process(2, "/rips"));
  EXPECT_THAT(After(60 * kSecond), IsEmpty()) << "the server cannot say which is which";
  findings_->SetConnected(true, now_ns_);
  findings_->SetOwnParticipants({ParticipantGuid(2)});
  EXPECT_THAT(After(5 * kSecond), ElementsAre(Begins("impostor", ParticipantGuid(7))));
  // Another one comes beside it.
  Step(Process(8, "/rips"));
  EXPECT_THAT(After(5 * kSecond),
              UnorderedElementsAre(Begins("impostor", ParticipantGuid(8)),
                                   Begins("duplicate_node", ParticipantGuid(8))));
}

TEST_F(FindingsTest, ImpostorThatHasLeftIsToldAllTheSame) {
  Step(Process(1, "/rips"));
  EXPECT_THAT(After(kSecond), IsEmpty());
  Gone(ParticipantGuid(1));
  EXPECT_THAT(Poll(), IsEmpty());
  const std::vector<Finding> told = After(4 * kSecond);
  ASSERT_THAT(told, ElementsAre(Begins("impostor", ParticipantGuid(1)),
                                Ends("impostor", ParticipantGuid(1))));
  EXPECT_THAT(told[0].detail, StartsWith("it has left: "));
  EXPECT_EQ(findings_->NextDue(), kNever);
  // One that turns out to be an agent is none, though it has left, too.
  Step(Process(2, "/rips"));
  EXPECT_THAT(After(kSecond), IsEmpty());
  Gone(ParticipantGuid(2));
  findings_->SetOwnParticipants({ParticipantGuid(2)});
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
}

TEST_F(FindingsTest, ProcessesOfRipsAreNeverAFinding) {
  findings_->SetOwnParticipants({ParticipantGuid(kActuator)});
  findings_->SetProtectedParts({"/safety"});
  Step(Process(kOwn, "/rips"));
  GraphDelta actuator = Process(kActuator, "/rips");
  actuator.upsert_endpoints.push_back(Client(kActuator, 2, "/safety/change_mode"));
  actuator.upsert_endpoints.push_back(Publisher(kActuator, 3, ""));
  Step(std::move(actuator));
  EXPECT_THAT(After(kSecond), IsEmpty());
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
}

TEST_F(FindingsTest, ActuatorThatTheServerNamesInTimeIsNoFinding) {
  findings_->SetProtectedParts({"/safety"});
  GraphDelta actuator = Process(kActuator);
  actuator.upsert_endpoints.push_back(Client(kActuator, 2, "/safety/change_mode"));
  Step(std::move(actuator));
  EXPECT_THAT(After(4'900 * kMs), IsEmpty());
  findings_->SetOwnParticipants({ParticipantGuid(kActuator)});
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
  // It stops, and the server says so.
  Gone(ParticipantGuid(kActuator));
  findings_->SetOwnParticipants({});
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
}

TEST_F(FindingsTest, ClaimForAnotherParticipantUntilItIsTakenBack) {
  Step(Process(1, "/camera"));
  const absl::Status refused = absl::PermissionDeniedError("speaks for another");
  findings_->OnClaim(EndpointGuid(1, 1), refused, now_ns_);
  const std::vector<Finding> told = Poll();
  ASSERT_THAT(told, ElementsAre(Begins("false_claim", ParticipantGuid(1))));
  EXPECT_EQ(told[0].detail, "speaks for another");
  findings_->OnClaim(EndpointGuid(1, 1), refused, now_ns_);
  EXPECT_THAT(Poll(), IsEmpty());
  findings_->OnClaim(EndpointGuid(1, 1), absl::OkStatus(), now_ns_);
  EXPECT_THAT(Poll(), ElementsAre(Ends("false_claim", ParticipantGuid(1))));
  findings_->OnClaim(EndpointGuid(1, 1), refused, now_ns_);
  EXPECT_THAT(Poll(), SizeIs(1));
  Gone(ParticipantGuid(1));
  EXPECT_THAT(Poll(), ElementsAre(Ends("false_claim", ParticipantGuid(1))));
}

TEST_F(FindingsTest, ClaimOfAParticipantThatIsNotInTheGraphWaitsForIt) {
  const absl::Status refused = absl::PermissionDeniedError("x");
  findings_->OnClaim(EndpointGuid(1, 1), refused, now_ns_);
  EXPECT_THAT(Poll(), IsEmpty());
  Step(Process(1));
  EXPECT_THAT(Poll(), SizeIs(1));
  // One that left before its claim was read.
  findings_->OnClaim(EndpointGuid(2, 1), refused, now_ns_);
  Poll();
  now_ns_ += 31 * kSecond;
  Step({});
  EXPECT_THAT(Poll(), IsEmpty());
  Step(Process(2));
  EXPECT_THAT(Poll(), IsEmpty()) << "forgotten";
}

TEST_F(FindingsTest, ForeignClientOfAProtectedPart) {
  findings_->SetProtectedParts({"/safety", "/camera"});
  StartManager();
  GraphDelta tool = Process(2, "/tool");
  tool.upsert_endpoints.push_back(Client(2, 2, "/safety/change_mode"));
  tool.upsert_endpoints.push_back(Client(2, 3, "/camera/set_parameters"));
  tool.upsert_endpoints.push_back(Client(2, 4, "/camera/set_parameters_atomically"));
  tool.upsert_endpoints.push_back(Client(2, 5, "/camera/change_state"));
  // These steer nothing, or nothing that is protected.
  tool.upsert_endpoints.push_back(Client(2, 6, "/camera/get_mode"));
  tool.upsert_endpoints.push_back(Client(2, 7, "/lidar/change_state"));
  tool.upsert_endpoints.push_back(Client(2, 8, "/camera/describe_parameters"));
  for (Endpoint& each : tool.upsert_endpoints) {
    if (each.ros) each.node = "/tool";
  }
  Step(std::move(tool));

  EXPECT_THAT(Poll(), IsEmpty());
  EXPECT_EQ(findings_->NextDue(), now_ns_ + 5 * kSecond);
  const std::vector<Finding> told = After(5 * kSecond);
  EXPECT_THAT(told, UnorderedElementsAre(Begins("foreign_mode_writer", EndpointGuid(2, 2)),
                                         Begins("foreign_mode_writer", EndpointGuid(2, 3)),
                                         Begins("foreign_mode_writer", EndpointGuid(2, 4)),
                                         Begins("foreign_mode_writer", EndpointGuid(2, 5))));
  EXPECT_EQ(told[0].node, "/tool");
  EXPECT_EQ(told[0].topic, "/safety/change_mode");
  // One of them goes, then the part is no longer protected.
  Gone(EndpointGuid(2, 2));
  EXPECT_THAT(Poll(), ElementsAre(Ends("foreign_mode_writer", EndpointGuid(2, 2))));
  findings_->SetProtectedParts({"/safety"});
  EXPECT_THAT(Poll(), SizeIs(3));
  EXPECT_THAT(findings_->Told(), IsEmpty());
}

TEST_F(FindingsTest, NodeThatBecomesKnownDuringTheGraceIsNamed) {
  findings_->SetProtectedParts({"/safety"});
  StartManager();
  GraphDelta delta = Process(2);
  Endpoint client = Client(2, 2, "/safety/change_mode");
  delta.upsert_endpoints.push_back(client);
  Step(delta);
  EXPECT_THAT(Poll(), IsEmpty());
  client.node = "/late";
  Step({.upsert_nodes = {{.full_name = "/late", .participant = ParticipantGuid(2)}},
        .upsert_endpoints = {client}});
  const std::vector<Finding> told = After(6 * kSecond);
  ASSERT_THAT(told, ElementsAre(Begins("foreign_mode_writer", EndpointGuid(2, 2))));
  EXPECT_EQ(told[0].node, "/late");
}

TEST_F(FindingsTest, ForeignClientThatLeavesSoonIsToldAllTheSame) {
  findings_->SetProtectedParts({"/safety"});
  StartManager();
  GraphDelta tool = Process(2);
  tool.upsert_endpoints.push_back(Client(2, 2, "/safety/change_mode"));
  Step(std::move(tool));
  EXPECT_THAT(After(kSecond), IsEmpty());
  Gone(ParticipantGuid(2));
  EXPECT_THAT(Poll(), IsEmpty());

  const std::vector<Finding> told = After(4 * kSecond);
  ASSERT_THAT(told, ElementsAre(Begins("foreign_mode_writer", EndpointGuid(2, 2)),
                                Ends("foreign_mode_writer", EndpointGuid(2, 2))));
  EXPECT_THAT(told[0].detail, StartsWith("it has left: "));
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
  EXPECT_EQ(findings_->NextDue(), kNever);
}

TEST_F(FindingsTest, ForeignClientThatTheGraphNeverShowsIsToldAllTheSame) {
  findings_->SetProtectedParts({"/safety"});
  StartManager();
  findings_->SetOwnParticipants({ParticipantGuid(kActuator)});
  const auto call = [&](uint16_t participant, const std::string& topic) {
    const Guid guid = EndpointGuid(participant, 9);
    findings_->OnEndpointSeen({.guid = guid, .writer = true, .topic = topic}, now_ns_);
    findings_->OnEndpointGone(guid);
    findings_->OnEndpointGone(guid);
  };
  call(2, "rq/safety/change_modeRequest");
  call(3, "rq/safety/get_modeRequest");
  call(4, "rq/lidar/change_modeRequest");
  call(5, "rt/safety/change_mode");
  call(1, "rq/safety/change_modeRequest");          // the manager
  call(kActuator, "rq/safety/change_modeRequest");  // RIPS
  EXPECT_THAT(Poll(), IsEmpty());
  EXPECT_THAT(After(5 * kSecond), ElementsAre(Begins("foreign_mode_writer", EndpointGuid(2, 9)),
                                              Ends("foreign_mode_writer", EndpointGuid(2, 9))));
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
}

TEST_F(FindingsTest, WithoutAServerNobodyIsForeignYet) {
  findings_->SetConnected(false, now_ns_);
  findings_->SetProtectedParts({"/safety"});
  StartManager();
  for (uint16_t participant : {2, 3, 4}) {
    GraphDelta delta = Process(participant);
    delta.upsert_endpoints.push_back(Client(participant, 2, "/safety/change_mode"));
    Step(std::move(delta));
  }
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
  Gone(ParticipantGuid(4));
  EXPECT_THAT(After(60 * kSecond), IsEmpty());

  findings_->SetConnected(true, now_ns_);
  EXPECT_THAT(Poll(), IsEmpty());
  findings_->SetOwnParticipants({ParticipantGuid(2)});
  EXPECT_THAT(After(5 * kSecond),
              UnorderedElementsAre(Begins("foreign_mode_writer", EndpointGuid(3, 2)),
                                   Begins("foreign_mode_writer", EndpointGuid(4, 2)),
                                   Ends("foreign_mode_writer", EndpointGuid(4, 2))));
}

TEST_F(FindingsTest, OnlyTheFirstWhoServesChangeModeIsTrusted) {
  findings_->SetProtectedParts({"/camera"});
  StartManager(1);
  EXPECT_THAT(After(kSecond), IsEmpty());
  StartManager(2);
  EXPECT_THAT(findings_->Poll(now_ns_), ElementsAre(Begins("duplicate_node", testing::_)));
  EXPECT_THAT(After(14'900 * kMs), IsEmpty()) << "the manager may have been started again";
  const std::vector<Finding> told = After(200 * kMs);
  ASSERT_THAT(told, ElementsAre(Begins("foreign_mode_writer", EndpointGuid(2, 4))));
  EXPECT_THAT(told[0].detail, HasSubstr("beside its mode manager"));
}

TEST_F(FindingsTest, ManagerThatWasStartedAgainIsNoFinding) {
  findings_->SetProtectedParts({"/camera"});
  StartManager(1);
  now_ns_ += kSecond;
  StartManager(2);
  EXPECT_THAT(Poll(), SizeIs(1)) << "the duplicate";
  now_ns_ += 10 * kSecond;
  Gone(ParticipantGuid(1));
  EXPECT_THAT(Poll(), ElementsAre(Ends("duplicate_node", testing::_)));
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
}

TEST_F(FindingsTest, OfTwoManagersInTheFirstSnapshotNoneIsTrusted) {
  findings_->SetProtectedParts({"/camera"});
  StartManager(1);
  StartManager(2);
  Poll();
  EXPECT_THAT(After(15 * kSecond),
              UnorderedElementsAre(Begins("foreign_mode_writer", EndpointGuid(1, 4)),
                                   Begins("foreign_mode_writer", EndpointGuid(2, 4))));
}

TEST_F(FindingsTest, ServerOfASlowNodeIsNoRival) {
  findings_->SetProtectedParts({"/camera"});
  GraphDelta slow = Process(1);
  slow.upsert_endpoints.push_back(Service(1, 2, "/camera/get_state", ""));
  slow.upsert_endpoints.push_back(Service(1, 3, "/camera/get_parameters", ""));
  Step(slow);
  EXPECT_THAT(Poll(), IsEmpty());
  EXPECT_THAT(After(4'900 * kMs), IsEmpty());
  slow.upsert_nodes = {{.full_name = "/camera", .participant = ParticipantGuid(1)}};
  slow.upsert_endpoints[1].node = "/camera";
  Step(slow);
  EXPECT_THAT(After(200 * kMs), ElementsAre(Begins("rival_server", ParticipantGuid(1))))
      << "one of them is still without";
  slow.upsert_endpoints[2].node = "/camera";
  Step(slow);
  EXPECT_THAT(Poll(), ElementsAre(Ends("rival_server", ParticipantGuid(1))));
}

TEST_F(FindingsTest, WriterOfAProcessThatIsNotRos) {
  GraphDelta raw;
  raw.upsert_participants.push_back({.guid = ParticipantGuid(1)});
  raw.upsert_endpoints.push_back(Publisher(1, 2, "", /*pending=*/true));
  Step(raw);
  EXPECT_THAT(Poll(), IsEmpty()) << "within the attribution grace";
  raw.upsert_endpoints[0].pending = false;
  Step(raw);
  const std::vector<Finding> told = Poll();
  ASSERT_THAT(told, ElementsAre(Begins("non_ros_writer", EndpointGuid(1, 2))));
  EXPECT_EQ(told[0].topic, "/cmd_vel");
  EXPECT_THAT(told[0].detail, HasSubstr("is no ROS process"));
  raw.upsert_endpoints[0].node = "/late";
  Step(raw);
  EXPECT_THAT(Poll(), ElementsAre(Ends("non_ros_writer", EndpointGuid(1, 2))));
}

TEST_F(FindingsTest, SlowNodeIsNotAWriterWithoutOne) {
  GraphDelta slow = Process(1);
  slow.upsert_endpoints.push_back(Publisher(1, 2, ""));
  Step(slow);
  EXPECT_THAT(After(4'900 * kMs), IsEmpty());
  Step({.upsert_nodes = {{.full_name = "/slow", .participant = ParticipantGuid(1)}},
        .upsert_endpoints = {Publisher(1, 2, "/slow")}});
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
  // And one that its participant hides.
  Step({.upsert_endpoints = {Publisher(1, 3, "")}});
  EXPECT_THAT(After(4'900 * kMs), IsEmpty());
  const std::vector<Finding> told = After(200 * kMs);
  ASSERT_THAT(told, ElementsAre(Begins("non_ros_writer", EndpointGuid(1, 3))));
  EXPECT_THAT(told[0].detail, HasSubstr("does not claim this writer"));
}

// Of a process that announces no nodes.
GraphDelta RawReader(uint16_t number, const std::vector<std::string>& topics) {
  GraphDelta delta;
  delta.upsert_participants.push_back(
      {.guid = ParticipantGuid(number), .host = "h", .pid = 7, .address = "10.0.0.9"});
  for (size_t i = 0; i < topics.size(); ++i) {
    delta.upsert_endpoints.push_back(
        {.guid = EndpointGuid(number, static_cast<uint8_t>(2 + i), /*writer=*/false),
         .kind = EndpointKind::kSubscriber,
         .name = topics[i],
         .type = "t"});
  }
  return delta;
}

TEST_F(FindingsTest, ReaderWithoutNode) {
  GraphDelta raw = RawReader(3, {"/scan", "/image"});
  raw.upsert_endpoints[0].pending = true;
  raw.upsert_endpoints[1].pending = true;
  Step(raw);
  EXPECT_THAT(After(6 * kSecond), IsEmpty()) << "within the attribution grace";
  raw.upsert_endpoints[0].pending = false;
  raw.upsert_endpoints[1].pending = false;
  Step(raw);
  EXPECT_THAT(After(4'900 * kMs), IsEmpty()) << "the server may still name it";
  const std::vector<Finding> told = After(200 * kMs);
  ASSERT_THAT(told, ElementsAre(Begins("non_ros_reader", ParticipantGuid(3)),
                                Begins("non_ros_reader", ParticipantGuid(3))));
  EXPECT_EQ(told[0].topic, "/image");
  EXPECT_EQ(told[1].topic, "/scan");
  EXPECT_THAT(told[0].detail,
              HasSubstr("(says: host h, address 10.0.0.9, process 7) reads without a node"));
  // What it reads besides is a finding, too.
  Step(RawReader(3, {"/scan", "/image", "/odom"}));
  const std::vector<Finding> more = After(60 * kSecond);
  ASSERT_THAT(more, SizeIs(1));
  EXPECT_EQ(more[0].topic, "/odom");
  Step({.gone_guids = {EndpointGuid(3, 2, false)}});
  EXPECT_THAT(Poll(), ElementsAre(Ends("non_ros_reader", ParticipantGuid(3))));
  Gone(ParticipantGuid(3));
  EXPECT_THAT(Poll(), SizeIs(2));
}

TEST_F(FindingsTest, ReaderThatTakesTheNextOnesPlaceGainsNothing) {
  // It announces itself, as ROS processes do, and claims nothing.
  Step(Process(3));
  for (uint8_t visit = 0; visit < 3; ++visit) {
    GraphDelta next;
    next.upsert_endpoints.push_back(RawReader(3, {"/image"}).upsert_endpoints[0]);
    next.upsert_endpoints[0].guid = EndpointGuid(3, 10 + visit, false);
    next.upsert_endpoints[0].pending = true;
    Step(next);
    EXPECT_THAT(Poll(), IsEmpty());
    next.upsert_endpoints[0].pending = false;
    Step(next);
    if (visit > 0) Step({.gone_guids = {EndpointGuid(3, 9 + visit, false)}});
    EXPECT_THAT(Poll(), IsEmpty());
    now_ns_ += 2 * kSecond;
  }
  EXPECT_THAT(Poll(), ElementsAre(Begins("non_ros_reader", ParticipantGuid(3))));
  // Nor does a participant.
  Step(Process(4));
  Step({.upsert_endpoints = RawReader(4, {"/scan"}).upsert_endpoints});
  EXPECT_THAT(After(2 * kSecond), IsEmpty());
  Gone(ParticipantGuid(4));
  EXPECT_THAT(Poll(), IsEmpty());
  EXPECT_THAT(After(3 * kSecond), ElementsAre(Begins("non_ros_reader", ParticipantGuid(4)),
                                              Ends("non_ros_reader", ParticipantGuid(4))));
}

TEST_F(FindingsTest, WhatStandsIsToldBeforeWhatHasLeft) {
  Restart({.told_per_minute = 5});
  for (uint16_t i = 0; i < 40; ++i) Step(RawReader(300 + i, {"/image"}));
  EXPECT_THAT(Poll(), IsEmpty());
  now_ns_ += 1 * kSecond;
  for (uint16_t i = 0; i < 40; ++i) Gone(ParticipantGuid(300 + i));
  Step(RawReader(900, {"/scan"}));
  // Their time comes first; those beyond the rate are a number by then.
  EXPECT_THAT(After(4 * kSecond), SizeIs(10)) << "five began and ended";
  EXPECT_FALSE(findings_->told_all()) << "one reads, and its grace is not over";
  EXPECT_THAT(After(2 * kSecond), IsEmpty());
  EXPECT_FALSE(findings_->told_all()) << "the minute is full";
  const std::vector<Finding> told = After(59 * kSecond);
  EXPECT_TRUE(findings_->told_all());
  ASSERT_THAT(told, SizeIs(3));
  EXPECT_EQ(told[0].detail, "35 more came and went within a minute");
  EXPECT_THAT(told[2], Begins("non_ros_reader", ParticipantGuid(900)));
}

TEST_F(FindingsTest, GlimpsesOfModeWritersAreHeldUpToTheLimit) {
  Restart({.findings_max = 3});
  findings_->SetProtectedParts({"/safety"});
  for (uint8_t i = 1; i <= 5; ++i) {
    const Guid writer = EndpointGuid(5, i);
    findings_->OnEndpointSeen(
        {.guid = writer, .writer = true, .topic = "rq/safety/change_modeRequest", .type = "t"},
        now_ns_);
    findings_->OnEndpointGone(writer);
  }
  EXPECT_EQ(findings_->dropped(), 2);
  EXPECT_THAT(After(6 * kSecond), SizeIs(6)) << "three began and ended";
}

TEST_F(FindingsTest, OneKindLeavesRoomForOthers) {
  Restart({.findings_max = 3, .told_per_minute = 1'000});
  GraphDelta flood;
  flood.upsert_participants.push_back({.guid = ParticipantGuid(9)});
  for (uint8_t i = 2; i < 70; ++i) flood.upsert_endpoints.push_back(Publisher(9, i, ""));
  Step(std::move(flood));
  EXPECT_THAT(Poll(), SizeIs(3));
  Step(RawReader(3, {"/image"}));
  EXPECT_THAT(After(5 * kSecond), ElementsAre(Begins("non_ros_reader", ParticipantGuid(3))));
}

TEST_F(FindingsTest, ReaderThatClaimsNothingIsToldAlthoughItHasLeft) {
  Step(RawReader(3, {"/image"}));
  EXPECT_THAT(After(1 * kSecond), IsEmpty());
  Gone(ParticipantGuid(3));
  EXPECT_THAT(Poll(), IsEmpty());
  const std::vector<Finding> told = After(5 * kSecond);
  ASSERT_THAT(told, ElementsAre(Begins("non_ros_reader", ParticipantGuid(3)),
                                Ends("non_ros_reader", ParticipantGuid(3))));
  EXPECT_THAT(told[0].detail, StartsWith("it has left: "));
}

TEST_F(FindingsTest, ReaderOfASlowNodeIsNone) {
  GraphDelta slow = Process(1);
  slow.upsert_endpoints.push_back(RawReader(1, {"/image"}).upsert_endpoints[0]);
  Step(slow);
  EXPECT_THAT(After(4'900 * kMs), IsEmpty());
  slow.upsert_endpoints[1].node = "/slow";
  Step({.upsert_nodes = {{.full_name = "/slow", .participant = ParticipantGuid(1)}},
        .upsert_endpoints = {slow.upsert_endpoints[1]}});
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
  // A node that ends lets go of the claim first.
  Step({.upsert_endpoints = {RawReader(1, {"/image"}).upsert_endpoints[0]},
        .gone_nodes = {"/slow"}});
  EXPECT_THAT(After(1 * kSecond), IsEmpty());
  Gone(ParticipantGuid(1));
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
  // One that claims other nodes only: when the slow node cannot come any more.
  GraphDelta hides = Process(2, "/known");
  hides.upsert_endpoints.push_back(RawReader(2, {"/image"}).upsert_endpoints[0]);
  Step(hides);
  EXPECT_THAT(After(4'900 * kMs), IsEmpty());
  EXPECT_THAT(After(200 * kMs), ElementsAre(Begins("non_ros_reader", ParticipantGuid(2))));
}

TEST_F(FindingsTest, ReadersOfRipsAndOfOpenTopicsAreNone) {
  Restart({.raw_readers = {"/image"}});
  Step(RawReader(3, {"/image"}));
  Step(RawReader(kOwn, {"/scan"}));
  Step(RawReader(kActuator, {"/scan"}));  // another sensor, unannounced: as the server says
  EXPECT_THAT(After(4 * kSecond), IsEmpty());
  findings_->SetOwnParticipants({ParticipantGuid(kActuator)});
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
  Step(RawReader(3, {"/image", "/scan"}));
  const std::vector<Finding> told = After(6 * kSecond);
  ASSERT_THAT(told, ElementsAre(Begins("non_ros_reader", ParticipantGuid(3))));
  EXPECT_EQ(told[0].topic, "/scan");
}

TEST_F(FindingsTest, NoReaderIsToldWithoutTheServersWord) {
  findings_->SetConnected(false, now_ns_);
  Step(RawReader(3, {"/image"}));
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
  findings_->SetConnected(true, now_ns_);
  EXPECT_THAT(After(4'900 * kMs), IsEmpty());
  EXPECT_THAT(After(200 * kMs), ElementsAre(Begins("non_ros_reader", ParticipantGuid(3))));
}

TEST_F(FindingsTest, ParticipantThatNeverAuthenticates) {
  Restart({.secured = true});
  Step({.upsert_participants = {{.guid = ParticipantGuid(1), .host = "h", .pid = 3}}});
  Step(Process(2));
  EXPECT_THAT(After(14'900 * kMs), IsEmpty());
  EXPECT_THAT(After(200 * kMs), ElementsAre(Begins("unauthenticated", ParticipantGuid(1))));
  EXPECT_EQ(findings_->secured_strangers(), 0);
  Step(Process(1));
  EXPECT_THAT(Poll(), ElementsAre(Ends("unauthenticated", ParticipantGuid(1))));
}

TEST_F(FindingsTest, ParticipantThatLeftWithinTheHandshakeIsNoStranger) {
  Restart({.secured = true});
  Step({.upsert_participants = {{.guid = ParticipantGuid(1), .host = "h", .pid = 3}}});
  // It lived for two seconds, and its lease for ten more.
  EXPECT_THAT(After(12 * kSecond), IsEmpty());
  Gone(ParticipantGuid(1));
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
}

TEST_F(FindingsTest, WithoutSecurityThoseWhoUseItAreStrangers) {
  Step({.upsert_participants = {{.guid = ParticipantGuid(1, 0x81)}, {.guid = ParticipantGuid(2)}}});
  EXPECT_THAT(Poll(), IsEmpty());
  EXPECT_EQ(findings_->secured_strangers(), 0);
  EXPECT_EQ(findings_->NextDue(), now_ns_ + 15 * kSecond);
  EXPECT_THAT(After(15 * kSecond), IsEmpty());
  EXPECT_EQ(findings_->secured_strangers(), 1);
  Gone(ParticipantGuid(1, 0x81));
  Poll();
  EXPECT_EQ(findings_->secured_strangers(), 0);
}

TEST_F(FindingsTest, WhatFlapsIsToldAtMostThirtyTimesAMinute) {
  Step(Process(1, "/camera"));
  std::vector<Finding> all;
  for (int i = 0; i < 50; ++i) {
    Step(Process(2, "/camera"));
    for (Finding& each : Poll()) all.push_back(std::move(each));
    Gone(ParticipantGuid(2));
    for (Finding& each : Poll()) all.push_back(std::move(each));
    now_ns_ += 20 * kMs;
  }
  EXPECT_THAT(all, SizeIs(60)) << "thirty begins and their ends";
  // Another kind has a budget of its own.
  const Guid writer = EndpointGuid(3, 2);
  GraphDelta stranger = Process(3);
  stranger.upsert_endpoints.pop_back();  // it announces no nodes
  stranger.upsert_endpoints.push_back(Publisher(3, 2, ""));
  Step(std::move(stranger));
  EXPECT_THAT(Poll(), ElementsAre(Begins("non_ros_writer", writer)));
  // What stands when the minute is over is told then.
  Step(Process(2, "/camera"));
  EXPECT_THAT(Poll(), IsEmpty());
  EXPECT_EQ(findings_->NextDue(), 1'000 * kSecond + 60 * kSecond);
  const std::vector<Finding> told = After(59 * kSecond);
  ASSERT_THAT(told, ElementsAre(Begins("duplicate_node", Guid{}), Ends("duplicate_node", Guid{}),
                                Begins("duplicate_node", ParticipantGuid(2))));
  EXPECT_EQ(told[0].detail, "20 more came and went within a minute");
  EXPECT_THAT(After(120 * kSecond), IsEmpty());
}

TEST_F(FindingsTest, MoreThanTheLimitAreCountedAndComeInWhenThereIsRoom) {
  Restart({.findings_max = 3, .told_per_minute = 1'000});
  Step(Process(1));
  GraphDelta flood;
  flood.upsert_participants.push_back({.guid = ParticipantGuid(9)});
  for (uint8_t i = 2; i < 7; ++i) flood.upsert_endpoints.push_back(Publisher(9, i, ""));
  Step(std::move(flood));
  EXPECT_THAT(Poll(), SizeIs(3));
  EXPECT_EQ(findings_->dropped(), 2);
  Step({});
  EXPECT_THAT(Poll(), IsEmpty());
  EXPECT_EQ(findings_->dropped(), 2) << "the same ones";
  Gone(EndpointGuid(9, 2));
  EXPECT_THAT(Poll(), UnorderedElementsAre(Ends("non_ros_writer", EndpointGuid(9, 2)),
                                           Begins("non_ros_writer", EndpointGuid(9, 5))));
  for (uint16_t i = 20; i < 30; ++i) {
    findings_->OnClaim(EndpointGuid(i, 1), absl::PermissionDeniedError("x"), now_ns_);
  }
  EXPECT_EQ(findings_->dropped(), 2 + 7) << "claims, too";
}

TEST_F(FindingsTest, ThousandsOfHostileEndpointsAreBounded) {
  findings_->SetProtectedParts({"/safety"});
  GraphDelta flood;
  for (uint16_t participant = 300; participant < 364; ++participant) {
    flood.upsert_participants.push_back({.guid = ParticipantGuid(participant)});
    for (uint8_t i = 1; i < 81; ++i) {
      flood.upsert_endpoints.push_back(Publisher(participant, i, ""));
      flood.upsert_endpoints.push_back(Client(participant, 80 + i, "/safety/change_mode"));
      flood.upsert_endpoints.push_back(Service(participant, i, "/safety/change_mode"));
    }
  }
  Step(flood);
  EXPECT_THAT(Poll(), SizeIs(30)) << "writers without a node; the mode writers wait";
  EXPECT_EQ(findings_->dropped(), 2 * (64 * 80 - 256));
  EXPECT_THAT(After(15 * kSecond), SizeIs(30));
  GraphDelta gone;
  for (const ros2::Participant& each : flood.upsert_participants) {
    gone.gone_guids.push_back(each.guid);
  }
  Step(std::move(gone));
  EXPECT_THAT(Poll(), SizeIs(60)) << "their ends";
}

TEST_F(FindingsTest, SnapshotKeepsWhatStandsAndEndsWhatIsNotInIt) {
  findings_->SetProtectedParts({"/camera"});
  StartManager(1);
  GraphDelta second = Process(2, "/safety");
  Step(second);
  GraphDelta raw = Process(3);
  raw.upsert_endpoints.push_back(Publisher(3, 2, ""));
  Step(raw);
  EXPECT_THAT(Poll(), SizeIs(1)) << "the duplicate";
  now_ns_ += 4 * kSecond;
  // In two parts; the second participant is not in it.
  GraphDelta all = Process(1, "/safety");
  all.upsert_endpoints.push_back(Service(1, 2, "/safety/change_mode"));
  findings_->OnGraph({.from_version = 0, .to_version = 50, .delta = all}, now_ns_);
  findings_->OnGraph({.from_version = 50, .to_version = 51, .settled = true, .delta = raw},
                     now_ns_);
  EXPECT_THAT(Poll(), ElementsAre(Ends("duplicate_node", testing::_)));
  EXPECT_THAT(After(1'100 * kMs), ElementsAre(Begins("non_ros_writer", EndpointGuid(3, 2))))
      << "since it was first seen";
}

TEST_F(FindingsTest, AJumpOfNumbersStandsUntilItsWriterOrParticipantGoes) {
  Step(Process(1));
  for (const uint8_t number : {2, 3, 2}) {
    findings_->OnSequenceJump({.guid = EndpointGuid(1, number), .topic = "/scan"});
  }
  EXPECT_THAT(Poll(), ElementsAre(Begins("sequence_jump", EndpointGuid(1, 2)),
                                  Begins("sequence_jump", EndpointGuid(1, 3))));
  findings_->OnEndpointGone(EndpointGuid(1, 2));
  EXPECT_THAT(Poll(), ElementsAre(Ends("sequence_jump", EndpointGuid(1, 2))));
  findings_->OnParticipantGone(ParticipantGuid(1));
  EXPECT_THAT(Poll(), ElementsAre(Ends("sequence_jump", EndpointGuid(1, 3))));
}

TEST_F(FindingsTest, LongTextIsCut) {
  Step(Process(1));
  findings_->OnClaim(EndpointGuid(1, 1), absl::PermissionDeniedError(std::string(5'000, 'x')),
                     now_ns_);
  const std::vector<Finding> told = Poll();
  ASSERT_THAT(told, SizeIs(1));
  EXPECT_EQ(told[0].detail.size(), kFindingDetailBytesMax);
}

TEST_F(FindingsTest, UnknownGuidsAndNamesThatGoDoNothing) {
  Step({.gone_guids = {ParticipantGuid(77), EndpointGuid(78, 2)}, .gone_nodes = {"/nobody"}});
  Step({.upsert_nodes = {{.full_name = "/rips", .participant = ParticipantGuid(79)}},
        .upsert_endpoints = {Publisher(79, 2, "")}});
  EXPECT_THAT(Poll(), IsEmpty());
}

}  // namespace
}  // namespace rips::sensor

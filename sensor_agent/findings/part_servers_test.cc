#include "sensor_agent/findings/part_servers.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/findings/findings_fixture.h"

namespace rips::sensor {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using ::testing::UnorderedElementsAre;

class PartServersTest : public FindingsTest {};

TEST_F(PartServersTest, ServerOfAProtectedPartWithoutANode) {
  findings_->SetProtectedParts({"/safety", "/camera"});
  StartManager();
  GraphDelta raw;
  raw.upsert_participants.push_back({.guid = ParticipantGuid(2), .host = "h", .pid = 8});
  raw.upsert_endpoints.push_back(Service(2, 1, "/camera/get_state", ""));
  raw.upsert_endpoints.push_back(Service(2, 2, "/camera/change_state", ""));
  raw.upsert_endpoints.push_back(Service(2, 3, "/safety/get_mode", "", /*pending=*/true));
  // Of nothing that is protected, or that a level stands on.
  raw.upsert_endpoints.push_back(Service(2, 4, "/lidar/get_state", ""));
  raw.upsert_endpoints.push_back(Service(2, 5, "/camera/describe_parameters", ""));
  Step(raw);
  std::vector<Finding> told = Poll();
  ASSERT_THAT(told, ElementsAre(Begins("rival_server", ParticipantGuid(2))));
  EXPECT_EQ(told[0].topic, "/camera/change_state");
  EXPECT_THAT(told[0].detail,
              AllOf(HasSubstr("process 8"), HasSubstr("/camera/change_state, /camera/get_state"),
                    HasSubstr("without a node")));
  raw.upsert_endpoints[2].pending = false;
  Step({.upsert_endpoints = {raw.upsert_endpoints[2]}});
  told = Poll();
  ASSERT_THAT(told, ElementsAre(Begins("rival_server", ParticipantGuid(2))));
  EXPECT_EQ(told[0].topic, "/safety/get_mode");
  Gone(EndpointGuid(2, 3, /*writer=*/false));
  EXPECT_THAT(Poll(), SizeIs(1)) << "one part's ends, the other's stands";
  Gone(ParticipantGuid(2));
  EXPECT_THAT(Poll(), ElementsAre(Ends("rival_server", ParticipantGuid(2))));
  EXPECT_THAT(findings_->Told(), IsEmpty());
}

TEST_F(PartServersTest, SecondServerOfAProtectedPartThatStays) {
  findings_->SetProtectedParts({"/camera"});
  GraphDelta camera = Process(1, "/camera");
  camera.upsert_endpoints.push_back(Service(1, 2, "/camera/get_state", "/camera"));
  Step(camera);
  now_ns_ += kSecond;
  GraphDelta evil = Process(2, "/evil");
  evil.upsert_endpoints.push_back(Service(2, 2, "/camera/get_state", "/evil"));
  Step(evil);
  EXPECT_THAT(Poll(), IsEmpty());
  EXPECT_EQ(findings_->NextDue(), now_ns_ + 25 * kSecond);
  EXPECT_THAT(After(24'900 * kMs), IsEmpty()) << "the node may have been started again";
  std::vector<Finding> told = After(200 * kMs);
  ASSERT_THAT(told, ElementsAre(Begins("rival_server", ParticipantGuid(2))));
  EXPECT_EQ(told[0].node, "/evil");
  EXPECT_THAT(told[0].detail, HasSubstr("beside the part's own server"));

  // The camera's own server goes, and its node stays: the other is none of its own.
  Gone(EndpointGuid(1, 2, /*writer=*/false));
  EXPECT_THAT(Poll(), IsEmpty());
  EXPECT_THAT(findings_->Told(), SizeIs(1));
  // Its whole process goes: then the only one may be the camera's.
  Gone(ParticipantGuid(1));
  Step({.gone_nodes = {"/camera"}});
  EXPECT_THAT(Poll(), ElementsAre(Ends("rival_server", ParticipantGuid(2))));
}

TEST_F(PartServersTest, NodeThatDiedAndWasStartedAgainIsNoRival) {
  findings_->SetProtectedParts({"/camera"});
  GraphDelta camera = Process(1, "/camera");
  camera.upsert_endpoints.push_back(Service(1, 2, "/camera/get_state", "/camera"));
  Step(camera);
  now_ns_ += kSecond;
  GraphDelta again = Process(2, "/camera");
  again.upsert_endpoints.push_back(Service(2, 2, "/camera/get_state", "/camera"));
  Step(again);
  EXPECT_THAT(Poll(), ElementsAre(Begins("duplicate_node", testing::_)));
  EXPECT_THAT(After(20 * kSecond), IsEmpty()) << "the lease of Fast DDS";
  Gone(ParticipantGuid(1));
  EXPECT_THAT(Poll(), ElementsAre(Ends("duplicate_node", testing::_)));
  EXPECT_THAT(After(60 * kSecond), IsEmpty());
}

TEST_F(PartServersTest, OfTwoServersInOneSnapshotNoneIsTrustedAndRipsServesNoPart) {
  findings_->SetProtectedParts({"/camera"});
  findings_->SetOwnParticipants({ParticipantGuid(kActuator)});
  GraphDelta both = Process(1, "/camera");
  both.upsert_participants.push_back({.guid = ParticipantGuid(kActuator)});
  both.upsert_endpoints.push_back(Service(1, 2, "/camera/change_mode", "/camera"));
  both.upsert_endpoints.push_back(Service(kActuator, 2, "/camera/change_mode", "/rips"));
  Step(both);
  now_ns_ += 10 * kSecond;
  // The same once more as a snapshot: since when they are there does not begin anew.
  findings_->OnGraph({.from_version = 0, .to_version = 50, .settled = true, .delta = both},
                     now_ns_);
  EXPECT_THAT(Poll(), IsEmpty());
  EXPECT_THAT(After(15 * kSecond),
              UnorderedElementsAre(Begins("rival_server", ParticipantGuid(1)),
                                   Begins("rival_server", ParticipantGuid(kActuator))));
}

}  // namespace
}  // namespace rips::sensor

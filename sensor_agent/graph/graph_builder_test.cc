#include "sensor_agent/graph/graph_builder.h"

#include <algorithm>
#include <random>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/graph/graph_builder_fixture.h"
#include "sensor_agent/outbox/outbox.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rounds.h"

namespace rips::sensor {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

TEST_F(GraphBuilderTest, SettlesAfterTwoQuietSecondsWithOneSnapshot) {
  Talker(1, "talker", "rt/chatter");
  Pass(1'500);
  Talker(2, "late", "rt/late");
  Pass(1'999);
  EXPECT_FALSE(builder_->settled());
  EXPECT_THAT(builder_->Snapshot(now_ns_), IsEmpty());

  Pass(1);

  EXPECT_TRUE(builder_->settled());
  ASSERT_THAT(changes_, SizeIs(1));
  EXPECT_EQ(changes_[0].from_version, 0);
  EXPECT_EQ(changes_[0].to_version, 1);
  EXPECT_TRUE(changes_[0].settled);
  EXPECT_THAT(Nodes(), ElementsAre("/late", "/rips", "/talker"));
  EXPECT_THAT(Publishers("/chatter"), ElementsAre("/talker"));
  EXPECT_THAT(graph_.FindTopic("/chatter")->types, ElementsAre("std_msgs/msg/String"));
}

TEST_F(GraphBuilderTest, SettlesAfterTenSecondsOfEndlessDiscovery) {
  for (int i = 0; i < 10'000 / 20 - 1; ++i) {
    Participant(static_cast<uint8_t>(1 + i % 100));
    Writer(static_cast<uint8_t>(1 + i % 100), static_cast<uint16_t>(1 + i), "rt/x");
    Pass(20);
  }
  EXPECT_FALSE(builder_->settled());
  Pass(20);
  EXPECT_TRUE(builder_->settled());
}

TEST_F(GraphBuilderTest, EndpointBeforeItsNodeIsPendingThenAttributed) {
  Settle();
  Participant(1);
  Writer(1, 1, "rt/chatter");
  Pass(300);
  EXPECT_EQ(graph_.FindTopic("/chatter"), nullptr) << "a pending endpoint counted";
  EXPECT_TRUE(graph_.FindEndpoint(EndpointGuid(1, 1))->pending);

  ASSERT_THAT(Claim(1, "talker", {EndpointGuid(1, 1)}), IsOk());
  Pass(20);

  EXPECT_THAT(Publishers("/chatter"), ElementsAre("/talker"));
}

TEST_F(GraphBuilderTest, NodeBeforeItsEndpoint) {
  Settle();
  ASSERT_THAT(Claim(1, "talker", {EndpointGuid(1, 1)}), IsOk());
  Pass(100);
  EXPECT_THAT(Nodes(), ElementsAre("/rips")) << "a claim alone made a node";
  Participant(1);
  Writer(1, 1, "rt/chatter");
  Pass(20);
  EXPECT_THAT(Publishers("/chatter"), ElementsAre("/talker"));
}

TEST_F(GraphBuilderTest, ClaimWhoseParticipantNeverComesIsForgotten) {
  Settle();
  ASSERT_THAT(Claim(1, "ghost", {EndpointGuid(1, 1)}), IsOk());
  Pass(10'001);
  Participant(1);
  Pass(20);
  EXPECT_THAT(Nodes(), ElementsAre("/rips"));
}

TEST_F(GraphBuilderTest, NodeThatNeverComesLeavesTheEndpointUnattributedAfterTheGrace) {
  Settle();
  Participant(1);
  Writer(1, 1, "rt/chatter");
  Pass(499);
  EXPECT_EQ(graph_.FindTopic("/chatter"), nullptr);

  Pass(1);

  EXPECT_THAT(Publishers("/chatter"),
              ElementsAre(absl::StrCat("(unattributed ", ToString(EndpointGuid(1, 1)), ")")));
  ASSERT_THAT(Claim(1, "slow", {EndpointGuid(1, 1)}), IsOk());
  Pass(20);
  EXPECT_THAT(Publishers("/chatter"), ElementsAre("/slow")) << "a late claim must still count";
}

TEST_F(GraphBuilderTest, GraceIsRenewedOnceWhenAClaimIsTakenBack) {
  Talker(1, "talker", "rt/chatter");
  Settle();
  // As when a node deletes a publisher: first the claim goes, then the endpoint.
  ASSERT_THAT(Claim(1, "talker", {}), IsOk());
  Pass(499);
  EXPECT_EQ(graph_.FindTopic("/chatter"), nullptr);
  ASSERT_THAT(Claim(1, "talker", {EndpointGuid(1, 1)}), IsOk());
  Pass(100);

  ASSERT_THAT(Claim(1, "talker", {}), IsOk());
  Pass(20);

  EXPECT_THAT(Publishers("/chatter"),
              ElementsAre(absl::StrCat("(unattributed ", ToString(EndpointGuid(1, 1)), ")")))
      << "claiming and unclaiming keeps an endpoint out of sight";
}

TEST_F(GraphBuilderTest, ClaimForAnotherParticipantIsIgnoredAndCounted) {
  Talker(1, "talker", "rt/chatter");
  Participant(2);
  Settle();
  EXPECT_THAT(builder_->NodesClaimed(EndpointGuid(2, 999),
                                     {.participant = ParticipantGuid(1),
                                      .nodes = {{.node_namespace = "/", .node_name = "evil"}}},
                                     now_ns_),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("claims nodes for")));
  Pass(200);
  EXPECT_THAT(changes_, IsEmpty());
  EXPECT_EQ(builder_->counters().foreign_claims, 1);
}

TEST_F(GraphBuilderTest, EndpointOfAnotherParticipantInAClaimIsIgnoredAndCounted) {
  Settle();
  Participant(1);
  Writer(1, 1, "rt/cmd_vel");
  Participant(2);
  Writer(2, 1, "rt/other");
  EXPECT_THAT(Claim(2, "thief", {EndpointGuid(1, 1), EndpointGuid(2, 1)}),
              StatusIs(absl::StatusCode::kPermissionDenied,
                       HasSubstr("lists 1 endpoints of other participants")));
  Pass(600);
  EXPECT_THAT(Publishers("/other"), ElementsAre("/thief"));
  EXPECT_THAT(Publishers("/cmd_vel"), ElementsAre(HasSubstr("unattributed")));
  EXPECT_EQ(builder_->counters().foreign_claims, 1);
}

TEST_F(GraphBuilderTest, ParticipantDiesWithNodesAndEndpoints) {
  Talker(1, "talker", "rt/chatter");
  Talker(2, "other", "rt/other");
  Settle();
  builder_->ParticipantGone(ParticipantGuid(1), now_ns_);
  // As the middleware tells it: its endpoints go as well, and a queued claim may come after.
  builder_->EndpointGone(EndpointGuid(1, 1), now_ns_);
  Pass(20);
  ASSERT_THAT(changes_, SizeIs(1));
  EXPECT_THAT(Nodes(), ElementsAre("/other", "/rips"));
  EXPECT_EQ(graph_.FindTopic("/chatter"), nullptr) << "our own subscription outlived the topic";
  ASSERT_THAT(Claim(1, "talker", {EndpointGuid(1, 1)}), IsOk());
  Pass(11'000);
  EXPECT_THAT(Nodes(), ElementsAre("/other", "/rips"));
  EXPECT_FALSE(graph_.participants().contains(ParticipantGuid(1)));
}

TEST_F(GraphBuilderTest, ParticipantThatComesBackIsShownAgain) {
  Talker(1, "talker", "rt/chatter");
  Settle();
  builder_->ParticipantGone(ParticipantGuid(1), now_ns_);
  Pass(50);
  Talker(1, "talker", "rt/chatter");
  Pass(50);
  EXPECT_THAT(Publishers("/chatter"), ElementsAre("/talker"));
}

TEST_F(GraphBuilderTest, SecondNodeOfOneNameSurvivesTheFirst) {
  Talker(1, "twin", "rt/a");
  Talker(2, "twin", "rt/b");
  Settle();
  EXPECT_THAT(Nodes(), ElementsAre("/rips", "/twin", "/twin"));
  ASSERT_THAT(Claim(1, "renamed", {EndpointGuid(1, 1)}), IsOk());
  Pass(20);
  EXPECT_THAT(Nodes(), ElementsAre("/renamed", "/rips", "/twin"));
  EXPECT_THAT(Publishers("/b"), ElementsAre("/twin"));
  EXPECT_THAT(Publishers("/a"), ElementsAre("/renamed"));
}

TEST_F(GraphBuilderTest, BurstBecomesOneDeltaAfterTwentyQuietMilliseconds) {
  Settle();
  for (uint8_t i = 1; i <= 9; ++i) {
    Talker(i, absl::StrCat("n", i), "rt/chatter");
    Pass(10);
  }
  EXPECT_THAT(changes_, IsEmpty());
  Pass(9);
  EXPECT_THAT(changes_, IsEmpty());
  Pass(1);
  ASSERT_THAT(changes_, SizeIs(1));
  EXPECT_THAT(changes_[0].delta.upsert_nodes, SizeIs(9));
}

TEST_F(GraphBuilderTest, EndlessBurstIsCutAfterHundredMilliseconds) {
  Settle();
  for (uint8_t i = 1; i <= 30; ++i) {
    Talker(i, absl::StrCat("n", i), "rt/chatter");
    Pass(10);
  }
  EXPECT_THAT(changes_, SizeIs(testing::AllOf(testing::Ge(2), testing::Le(3))));
}

TEST_F(GraphBuilderTest, NothingChangedMeansNoDelta) {
  Talker(1, "talker", "rt/chatter");
  Settle();
  Talker(1, "talker", "rt/chatter");
  Pass(300);
  EXPECT_THAT(changes_, IsEmpty());
}

TEST_F(GraphBuilderTest, ObserverSubscribesToWatchedTopicsOnly) {
  Talker(1, "talker", "rt/chatter");
  Writer(1, 2, "rt/rosout");
  Seen(EndpointGuid(1, 3, false), false, "rt/only_read");
  ASSERT_THAT(
      Claim(1, "talker", {EndpointGuid(1, 1), EndpointGuid(1, 2)}, {EndpointGuid(1, 3, false)}),
      IsOk());
  Settle();
  EXPECT_THAT(Subscribers("/chatter"), ElementsAre("/rips"));
  EXPECT_THAT(Subscribers("/only_read"), ElementsAre("/rips", "/talker"));
  EXPECT_THAT(Subscribers("/rosout"), IsEmpty());
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 1))->visibility, Visibility::kWatched);
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 2))->visibility, Visibility::kNotNeeded);
  builder_->EndpointGone(EndpointGuid(1, 1), now_ns_);
  Pass(20);
  EXPECT_EQ(graph_.FindTopic("/chatter"), nullptr);
}

TEST_F(GraphBuilderTest, ObserverAddsNoTypeOfItsOwn) {
  Talker(1, "talker", "rt/t");
  Settle();
  Seen(EndpointGuid(1, 2), true, "rt/t", "a_msgs::msg::dds_::A_");
  ASSERT_THAT(Claim(1, "talker", {EndpointGuid(1, 1), EndpointGuid(1, 2)}), IsOk());
  Pass(20);
  EXPECT_THAT(graph_.FindTopic("/t")->types, ElementsAre("a_msgs/msg/A", "std_msgs/msg/String"));
  builder_->EndpointGone(EndpointGuid(1, 2), now_ns_);
  Pass(20);
  EXPECT_THAT(graph_.FindTopic("/t")->types, ElementsAre("std_msgs/msg/String"));
  EXPECT_THAT(Subscribers("/t"), ElementsAre("/rips"));
}

TEST_F(GraphBuilderTest, HiddenObserverAndItsProcessesLeaveNoTrace) {
  options_.observer_hidden = true;
  Restart();
  Talker(1, "talker", "rt/chatter");
  Participant(2);
  builder_->SetOwnParticipants({ParticipantGuid(2)}, now_ns_);
  Settle();
  EXPECT_THAT(Nodes(), ElementsAre("/talker"));
  EXPECT_THAT(Subscribers("/chatter"), IsEmpty());
  EXPECT_THAT(graph_.participants(), SizeIs(1));
}

TEST_F(GraphBuilderTest, OwnParticipantsAreTheNodeRips) {
  Talker(1, "manager", "rt/chatter");
  Participant(2);
  Seen(EndpointGuid(2, 1), true, "rq/safety/change_modeRequest",
       "system_modes_msgs::srv::dds_::ChangeMode_Request_");
  Settle();
  EXPECT_TRUE(graph_.FindEndpoint(EndpointGuid(2, 1))->node.empty());

  builder_->SetOwnParticipants({ParticipantGuid(2)}, now_ns_);
  Pass(20);

  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(2, 1))->node, "/rips");
  EXPECT_THAT(Nodes(), ElementsAre("/manager", "/rips", "/rips"));
  EXPECT_THAT(Claim(2, "disguise", {EndpointGuid(2, 1)}), IsOk());
  Pass(20);
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(2, 1))->node, "/rips");

  builder_->SetOwnParticipants({}, now_ns_);
  Pass(20);
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(2, 1))->node, "");
  EXPECT_THAT(Nodes(), ElementsAre("/manager", "/rips"));
}

TEST_F(GraphBuilderTest, AgentThatAnnouncesItselfIsTheSameNodeBeforeAndAfterTheServerNamesIt) {
  Talker(1, "manager", "rt/chatter");
  Participant(2);
  Seen(EndpointGuid(2, 1), true, "rq/safety/change_modeRequest",
       "system_modes_msgs::srv::dds_::ChangeMode_Request_");
  ASSERT_THAT(Claim(2, "rips", {EndpointGuid(2, 1)}), IsOk());
  Settle();
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(2, 1))->node, "/rips");
  EXPECT_THAT(Nodes(), ElementsAre("/manager", "/rips", "/rips"));
  const uint64_t nodes = graph_.nodes().size();

  builder_->SetOwnParticipants({ParticipantGuid(2)}, now_ns_);
  EXPECT_THAT(Claim(2, "rips", {EndpointGuid(2, 1)}), IsOk());
  Pass(20);

  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(2, 1))->node, "/rips");
  EXPECT_EQ(graph_.nodes().size(), nodes) << "announced, and counted once";
  // What this sensor announces does not count beside what it is anyway.
  EXPECT_THAT(Claim(kOwn, "rips", {EndpointGuid(kOwn, 1, false)}), IsOk());
  Pass(20);
  EXPECT_EQ(graph_.nodes().size(), nodes);
}

TEST_F(GraphBuilderTest, OwnRealEndpointsAreNotShown) {
  Settle();
  Writer(kOwn, 5, "rt/ours");
  Pass(600);
  EXPECT_THAT(changes_, IsEmpty());
  EXPECT_EQ(builder_->Find(EndpointGuid(kOwn, 5)), std::nullopt);
}

TEST_F(GraphBuilderTest, ServiceIsItsRequestReaderAndClientItsRequestWriter) {
  Participant(1);
  const std::string request = "std_srvs::srv::dds_::SetBool_Request_";
  const std::string reply = "std_srvs::srv::dds_::SetBool_Response_";
  Seen(EndpointGuid(1, 1, false), false, "rq/enableRequest", request);
  Seen(EndpointGuid(1, 2), true, "rr/enableReply", reply);
  ASSERT_THAT(Claim(1, "server", {EndpointGuid(1, 2)}, {EndpointGuid(1, 1, false)}), IsOk());
  Participant(2);
  Seen(EndpointGuid(2, 1), true, "rq/enableRequest", request);
  Seen(EndpointGuid(2, 2, false), false, "rr/enableReply", reply);
  ASSERT_THAT(Claim(2, "caller", {EndpointGuid(2, 1)}, {EndpointGuid(2, 2, false)}), IsOk());
  Settle();
  EXPECT_THAT(graph_.ServicesOf("/server"), ElementsAre("/enable"));
  EXPECT_THAT(graph_.topics(), IsEmpty());
  const Endpoint* client = graph_.FindEndpoint(EndpointGuid(2, 1));
  ASSERT_NE(client, nullptr);
  EXPECT_THAT(*client, AllOf(Field(&Endpoint::kind, EndpointKind::kClient),
                             Field(&Endpoint::name, "/enable"),
                             Field(&Endpoint::type, "std_srvs/srv/SetBool"),
                             Field(&Endpoint::visibility, Visibility::kNotVisible),
                             Field(&Endpoint::why, HasSubstr("requests are not read"))));
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 2)), nullptr);
}

TEST_F(GraphBuilderTest, RawNamesAreNoTopics) {
  Participant(1);
  Seen(EndpointGuid(1, 1), true, "Square\x01", "Shape");
  Seen(EndpointGuid(1, 2), true, "", "");
  Seen(EndpointGuid(1, 3), true, "ros_discovery_info",
       "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_");
  Settle();
  EXPECT_THAT(graph_.topics(), IsEmpty());
  const Endpoint* square = graph_.FindEndpoint(EndpointGuid(1, 1));
  ASSERT_NE(square, nullptr);
  EXPECT_FALSE(square->ros);
  EXPECT_FALSE(square->pending);
  EXPECT_EQ(square->name, "Square\\x01");
  EXPECT_EQ(square->visibility, Visibility::kNotNeeded);
  EXPECT_NE(graph_.FindEndpoint(EndpointGuid(1, 2)), nullptr);
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 3))->visibility, Visibility::kWatched);
}

TEST_F(GraphBuilderTest, UnreadableWriterSaysWhy) {
  Talker(1, "talker", "rt/chatter");
  Settle();
  builder_->SetNotVisible(EndpointGuid(1, 1), "no reader", now_ns_);
  Pass(20);
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 1))->visibility, Visibility::kNotVisible);
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 1))->why, "no reader");
  // What discovery says again does not make it visible; news does.
  Writer(1, 1, "rt/chatter");
  Pass(20);
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 1))->visibility, Visibility::kNotVisible);
  builder_->SetNotVisible(EndpointGuid(1, 1), "", now_ns_);
  Pass(20);
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 1))->visibility, Visibility::kWatched);
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 1))->why, "");
}

TEST_F(GraphBuilderTest, AVisitBetweenTwoStepsIsShownAndOver) {
  Settle();
  changes_.clear();
  // A writer, a whole process, and a process that tells its node, all gone before a step.
  Participant(1);
  Talker(2, "stays", "rt/stays");
  Writer(2, 9, "rt/a");
  builder_->EndpointGone(EndpointGuid(2, 9), now_ns_);
  Writer(1, 1, "rt/b");
  builder_->ParticipantGone(ParticipantGuid(1), now_ns_);
  Talker(3, "brief", "rt/c");
  builder_->ParticipantGone(ParticipantGuid(3), now_ns_);
  Pass(20);
  EXPECT_THAT(Publishers("/a"), ElementsAre(HasSubstr("unattributed")));
  EXPECT_THAT(Publishers("/b"), ElementsAre(HasSubstr("unattributed")));
  EXPECT_THAT(Publishers("/c"), ElementsAre("/brief"));
  EXPECT_THAT(Nodes(), ElementsAre("/brief", "/rips", "/stays"));
  Pass(20);
  for (const char* topic : {"/a", "/b", "/c"}) EXPECT_EQ(graph_.FindTopic(topic), nullptr) << topic;
  EXPECT_THAT(Nodes(), ElementsAre("/rips", "/stays"));
  EXPECT_THAT(changes_, SizeIs(2));
}

TEST_F(GraphBuilderTest, AVisitorThatWasPendingIsShownWhenItGoes) {
  Participant(1);
  Settle();
  Writer(1, 1, "rt/a");
  Pass(20);
  EXPECT_EQ(graph_.FindTopic("/a"), nullptr) << "within the grace";
  builder_->EndpointGone(EndpointGuid(1, 1), now_ns_);
  Pass(20);
  EXPECT_THAT(Publishers("/a"), ElementsAre(HasSubstr("unattributed")));
  Pass(20);
  EXPECT_EQ(graph_.FindTopic("/a"), nullptr);
  // One that comes back stays.
  Writer(1, 2, "rt/a");
  builder_->EndpointGone(EndpointGuid(1, 2), now_ns_);
  Writer(1, 2, "rt/a");
  Pass(20);
  Pass(1'000);
  EXPECT_THAT(Publishers("/a"), ElementsAre(HasSubstr("unattributed")));
}

TEST_F(GraphBuilderTest, AnHonestNodeThatLeavesIsNeverShownWithoutItsNode) {
  Talker(1, "talker", "rt/chatter");
  Settle();
  // As rmw does it: first the claim, then the endpoint.
  ASSERT_THAT(Claim(1, "talker", {}), IsOk());
  Pass(20);
  EXPECT_EQ(graph_.FindTopic("/chatter"), nullptr);
  builder_->EndpointGone(EndpointGuid(1, 1), now_ns_);
  Pass(20);
  EXPECT_EQ(graph_.FindTopic("/chatter"), nullptr);
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 1)), nullptr);
}

TEST_F(GraphBuilderTest, ANodeThatLeavesBeforeAStepShowedItIsShownWithItsNode) {
  Settle();
  Participant(1);
  Writer(1, 1, "rt/cmd_vel");
  Pass(20);
  EXPECT_EQ(graph_.FindTopic("/cmd_vel"), nullptr) << "no node claims it yet";
  ASSERT_THAT(Claim(1, "navigator", {EndpointGuid(1, 1)}), IsOk());
  EXPECT_EQ(builder_->VersionShowing(EndpointGuid(1, 1)), version_ + 1);
  // As rmw does it: first the claim, then the endpoint, then the participant.
  ASSERT_THAT(Claim(1, "navigator", {}), IsOk());
  ASSERT_THAT(
      builder_->NodesClaimed(EndpointGuid(1, 999), {.participant = ParticipantGuid(1)}, now_ns_),
      IsOk());
  builder_->EndpointGone(EndpointGuid(1, 1), now_ns_);
  builder_->ParticipantGone(ParticipantGuid(1), now_ns_);
  EXPECT_EQ(builder_->Find(EndpointGuid(1, 1))->node, "/navigator");
  Pass(20);
  EXPECT_THAT(Publishers("/cmd_vel"), ElementsAre("/navigator"));
  EXPECT_THAT(Nodes(), ElementsAre("/navigator", "/rips"));
  Pass(20);
  EXPECT_EQ(graph_.FindTopic("/cmd_vel"), nullptr);
  EXPECT_THAT(Nodes(), ElementsAre("/rips"));
}

TEST_F(GraphBuilderTest, AClaimTakenBackBetweenTwoStepsIsShownOnce) {
  Talker(1, "stays", "rt/a");
  Settle();
  // A name, and a second endpoint of a known one; what they belonged to stays.
  ASSERT_THAT(Claim(1, "brief", {EndpointGuid(1, 1)}), IsOk());
  Writer(1, 2, "rt/b");
  ASSERT_THAT(Claim(1, "stays", {EndpointGuid(1, 1), EndpointGuid(1, 2)}), IsOk());
  ASSERT_THAT(Claim(1, "stays", {EndpointGuid(1, 1)}), IsOk());
  Pass(20);
  EXPECT_THAT(Nodes(), ElementsAre("/brief", "/rips", "/stays"));
  EXPECT_THAT(Publishers("/b"), ElementsAre("/stays"));
  Pass(20);
  EXPECT_THAT(Nodes(), ElementsAre("/rips", "/stays"));
  EXPECT_EQ(graph_.FindTopic("/b"), nullptr) << "within the grace";
  // Not a second time: it was shown.
  ASSERT_THAT(Claim(1, "stays", {EndpointGuid(1, 1), EndpointGuid(1, 2)}), IsOk());
  ASSERT_THAT(Claim(1, "stays", {EndpointGuid(1, 1)}), IsOk());
  Pass(600);
  EXPECT_THAT(Publishers("/b"), ElementsAre(HasSubstr("unattributed")));
}

TEST_F(GraphBuilderTest, ANodeThatGoesWithItsVisitorIsInTheSameStep) {
  Talker(1, "stays", "rt/a");
  Settle();
  Writer(1, 2, "rt/b");
  ASSERT_THAT(Claim(1, "stays", {EndpointGuid(1, 1), EndpointGuid(1, 2)}), IsOk());
  ASSERT_THAT(Claim(1, "stays", {}), IsOk());
  ASSERT_THAT(
      builder_->NodesClaimed(EndpointGuid(1, 999), {.participant = ParticipantGuid(1)}, now_ns_),
      IsOk());
  Pass(20);
  EXPECT_THAT(Publishers("/b"), ElementsAre("/stays"));
  EXPECT_THAT(Nodes(), ElementsAre("/rips", "/stays"));
  Pass(20);
  EXPECT_THAT(Nodes(), ElementsAre("/rips"));
}

// Whatever comes and goes in whatever order, a server takes each step and each snapshot.
TEST_F(GraphBuilderTest, EveryStepAndSnapshotIsOneThatAServerTakes) {
  for (int seed = 0; seed < Rounds(200); ++seed) {
    options_.limits = {.nodes = 5, .endpoints = 12, .participants = 4, .nodes_per_participant = 3};
    Restart();
    std::mt19937 random(static_cast<uint32_t>(seed));
    const auto any = [&](int below) { return static_cast<int>(random() % below); };
    for (int i = 0; i < 200; ++i) {
      const auto participant = static_cast<uint8_t>(1 + any(3));
      const Guid endpoint = EndpointGuid(participant, static_cast<uint16_t>(1 + any(4)));
      switch (any(8)) {
        case 0:
          Participant(participant);
          break;
        case 1:
          if (any(4) == 0) builder_->ParticipantGone(ParticipantGuid(participant), now_ns_);
          break;
        case 2:
          builder_->EndpointGone(endpoint, now_ns_);
          break;
        case 3:
        case 4:
          Seen(endpoint, true, any(4) == 0 ? "rr/sReply" : absl::StrCat("rt/t", any(3)));
          break;
        case 5: {
          ros2::ParticipantEntities claim{.participant = ParticipantGuid(participant)};
          for (int node = any(3); node > 0; --node) {
            ros2::NodeEntities each{.node_namespace = "/", .node_name = absl::StrCat("n", any(4))};
            for (uint16_t e = 1; e <= 4; ++e) {
              if (any(2) == 0) each.writers.push_back(EndpointGuid(participant, e));
            }
            claim.nodes.push_back(std::move(each));
          }
          builder_->NodesClaimed(EndpointGuid(participant, 999), claim, now_ns_).IgnoreError();
          break;
        }
        case 6:
          Pass(any(4) == 0 ? 600 : any(30));
          break;
        default:
          if (any(8) == 0) Apply(builder_->Snapshot(now_ns_));
      }
    }
    Pass(3'000);
    ASSERT_FALSE(HasFailure()) << "seed " << seed;
  }
}

TEST_F(GraphBuilderTest, WhoCameAndWentBeforeDiscoveryHadSettledIsInTheFirstSnapshotOnly) {
  Talker(1, "navigator", "rt/cmd_vel");
  Pass(300);
  ASSERT_THAT(Claim(1, "navigator", {}), IsOk());
  builder_->EndpointGone(EndpointGuid(1, 1), now_ns_);
  builder_->ParticipantGone(ParticipantGuid(1), now_ns_);
  Pass(300);
  Talker(2, "navigator", "rt/cmd_vel");
  EXPECT_EQ(builder_->VersionShowing(EndpointGuid(1, 1)), 1);
  Pass(2'000);
  ASSERT_THAT(changes_, SizeIs(2)) << "both at once: the finding of a second `/navigator` is none";
  EXPECT_EQ(changes_[0].to_version, 1);
  EXPECT_THAT(changes_[0].delta.upsert_endpoints,
              Contains(Field(&Endpoint::guid, EndpointGuid(1, 1))));
  EXPECT_THAT(changes_[1].delta.gone_guids, ElementsAre(ParticipantGuid(1)));
  EXPECT_THAT(Publishers("/cmd_vel"), ElementsAre("/navigator"));
  EXPECT_EQ(graph_.FindEndpoint(EndpointGuid(1, 1)), nullptr);
}

TEST_F(GraphBuilderTest, WhoLeftUnclaimedBeforeDiscoveryHadSettledAccusesNobody) {
  // One whose claim never came, alone and with a process of which the node is known.
  Participant(1);
  Writer(1, 1, "rt/cmd_vel");
  builder_->EndpointGone(EndpointGuid(1, 1), now_ns_);
  Talker(2, "navigator", "rt/cmd_vel");
  Writer(2, 2, "rt/cmd_vel");
  builder_->ParticipantGone(ParticipantGuid(2), now_ns_);
  Pass(2'000);
  ASSERT_THAT(changes_, SizeIs(2));
  std::vector<std::string> shown;
  for (const Endpoint& each : changes_[0].delta.upsert_endpoints) {
    if (each.kind == EndpointKind::kPublisher) shown.push_back(each.node);
  }
  EXPECT_THAT(shown, ElementsAre("/navigator"));
}

TEST_F(GraphBuilderTest, AHundredThousandEndpointsStayWithinTheLimits) {
  constexpr int kEndpoints = Rounds(100'000);
  Settle();
  for (int i = 0; i < kEndpoints; ++i) {
    const Guid guid = EndpointGuid(static_cast<uint8_t>(1 + int64_t{i} * 6 / kEndpoints),
                                   static_cast<uint16_t>(i % 20'000));
    Seen(guid, i % 2 == 0, absl::StrCat("rt/t", i % 1'000), "std_msgs::msg::dds_::String_");
    builder_->EndpointGone(guid, now_ns_);
    Seen(guid, i % 2 == 0, absl::StrCat("rt/t", i % 1'000), "std_msgs::msg::dds_::String_");
  }
  EXPECT_EQ(builder_->counters().dropped % 2, 0u) << "each is refused twice";
  constexpr size_t kHeld = 6 * 2'048;
  EXPECT_EQ(builder_->counters().dropped / 2, kEndpoints - kHeld);
  Pass(20);
  for (const GraphChange& change : changes_) {
    EXPECT_LE(CostOf(change.delta), GraphOptions().step_bytes + 4'096);
  }
  EXPECT_GE(graph_.left_out(), builder_->counters().dropped);
  EXPECT_EQ(graph_.dropped(), 0u) << "the server has room for what the sensor holds";
  EXPECT_THAT(graph_.truncation().crowds, SizeIs(6));
}

TEST_F(GraphBuilderTest, ThePlanDecidesWhatIsWatchedAndNotWhatIsCounted) {
  Talker(1, "talker", "rt/chatter");
  Seen(EndpointGuid(1, 2), false, "rt/other", "std_msgs::msg::dds_::String_");
  Seen(EndpointGuid(1, 3), true, "rt/rosout", "rcl_interfaces::msg::dds_::Log_");
  Seen(EndpointGuid(1, 4), false, "rq/enableRequest", "std_srvs::srv::dds_::SetBool_Request_");
  Settle();
  const auto of = [this](uint8_t number) {
    return graph_.FindEndpoint(EndpointGuid(1, number))->visibility;
  };
  const auto follow = [this](std::vector<InterestRule> rules) {
    builder_->SetPlan(
        std::make_shared<WatchPlan>(WatchOptions{
            .unwatched = {"/rosout"},
            .interest = *Interest::Create(std::string(kInterestIdBytes, 'i'), std::move(rules))}),
        now_ns_);
    Pass(20);
  };
  EXPECT_EQ(of(1), Visibility::kWatched);
  EXPECT_EQ(of(2), Visibility::kWatched);
  EXPECT_EQ(of(3), Visibility::kNotNeeded);
  EXPECT_EQ(of(4), Visibility::kNotVisible);
  const std::vector<std::string> subscribers = graph_.FindTopic("/chatter")->subscribers;
  EXPECT_THAT(subscribers, ElementsAre("/rips"));

  follow({{.topic_regex = "^/(other|rosout)$"}, {.topic_regex = "^/rosout$"}});
  EXPECT_EQ(of(1), Visibility::kNotNeeded);
  EXPECT_EQ(of(2), Visibility::kWatched);
  EXPECT_EQ(of(3), Visibility::kWatched) << "named";
  EXPECT_EQ(of(4), Visibility::kNotVisible);
  EXPECT_EQ(graph_.FindTopic("/chatter")->subscribers, subscribers);
  EXPECT_THAT(graph_.FindTopic("/rosout")->subscribers, IsEmpty()) << "as without an interest";

  // What comes under the plan follows it, and an excuse does not outlive the need.
  builder_->SetNotVisible(EndpointGuid(1, 3), "no reader", now_ns_);
  Writer(1, 5, "rt/chatter");
  Pass(600);
  EXPECT_EQ(of(3), Visibility::kNotVisible);
  EXPECT_EQ(of(5), Visibility::kNotNeeded);
  follow({});
  EXPECT_EQ(of(3), Visibility::kNotNeeded);
  follow({{}, {.topic_regex = "^/rosout$"}});
  EXPECT_EQ(of(3), Visibility::kWatched);
  EXPECT_EQ(of(1), Visibility::kWatched);
}

TEST_F(GraphBuilderTest, APlanThatChangesNothingIsNoStep) {
  Talker(1, "talker", "rt/chatter");
  Settle();
  changes_.clear();
  builder_->SetPlan(std::make_shared<WatchPlan>(WatchOptions{}), now_ns_);
  Pass(20);
  EXPECT_THAT(changes_, IsEmpty());
}

TEST_F(GraphBuilderTest, SnapshotEqualsTheSumOfTheSteps) {
  Talker(1, "talker", "rt/chatter");
  Settle();
  Talker(2, "second", "rt/chatter");
  builder_->ParticipantGone(ParticipantGuid(1), now_ns_);
  Pass(20);
  Writer(2, 7, "rt/more");  // not yet sent: the snapshot has it
  const RosGraph before = graph_;

  Apply(builder_->Snapshot(now_ns_));

  EXPECT_THAT(graph_.endpoints(), SizeIs(before.endpoints().size() + 1));
  EXPECT_TRUE(graph_.FindEndpoint(EndpointGuid(2, 7))->pending);
  changes_.clear();
  Pass(600);
  ASSERT_THAT(changes_, SizeIs(1)) << "what the snapshot said is said again";
  EXPECT_THAT(Publishers("/more"), ElementsAre(HasSubstr("unattributed")));
}

TEST_F(GraphBuilderTest, ResyncRemovesWhatIsNotSeenAgain) {
  Talker(1, "talker", "rt/chatter");
  Writer(1, 2, "rt/stays");
  ASSERT_THAT(Claim(1, "talker", {EndpointGuid(1, 1), EndpointGuid(1, 2)}), IsOk());
  Talker(2, "gone", "rt/gone");
  Settle();
  builder_->BeginResync();
  Participant(1);
  Writer(1, 2, "rt/stays");
  Pass(100);
  builder_->EndResync(now_ns_);
  Pass(20);
  EXPECT_THAT(Nodes(), ElementsAre("/rips", "/talker"));
  EXPECT_EQ(graph_.FindTopic("/chatter"), nullptr);
  EXPECT_THAT(Publishers("/stays"), ElementsAre("/talker"));
}

TEST(SplitDeltaTest, SurvivorsOfAGoneNameComeBackInTheSamePiece) {
  ros2::GraphDelta delta;
  for (uint8_t i = 1; i <= 3; ++i) {
    delta.upsert_participants.push_back({.guid = ParticipantGuid(i)});
  }
  delta.upsert_nodes = {{"/twin", ParticipantGuid(1)}, {"/a", ParticipantGuid(2)}};
  delta.gone_nodes = {"/twin"};
  const std::vector<ros2::GraphDelta> pieces = SplitDelta(delta, 100);
  ASSERT_GT(pieces.size(), 2u);
  EXPECT_THAT(pieces.back().gone_nodes, ElementsAre("/twin"));
  EXPECT_THAT(pieces.back().upsert_nodes, ElementsAre(ros2::Node{"/twin", ParticipantGuid(1)}));
}

}  // namespace
}  // namespace rips::sensor

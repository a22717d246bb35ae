#include "services/model_proto/observation_codec.h"

#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/overloaded.h"
#include "services/base/status_matchers.h"

namespace rips::model_proto {
namespace {

const std::string kGuid = "PARTICIPANT1" + std::string("\0\0\1\xc1", 4);

// One of each kind, every field set.
const model::SignalSeen kSignal{.name = "SIGUSR1", .count = 2};
const model::IdsAlert kIds{.source = "snort",
                           .gid = 1,
                           .sid = 2,
                           .rev = 3,
                           .message = "m",
                           .severity = 4,
                           .src = "s",
                           .dst = "d",
                           .line = "l"};
const model::SensorState kState{.overloaded = true,
                                .outbox_bytes = 1,
                                .oldest_unacked_ns = 2,
                                .spool_bytes = 3,
                                .not_visible = {"a", "b"},
                                .blind = {"c"}};
model::Finding Finding() {
  return {.kind = "impostor",
          .guid = *ros2::GuidFromBytes(kGuid),
          .node = "/n",
          .topic = "/t",
          .detail = "d",
          .over = true};
}
model::Loss Loss() {
  return {.count = 1,
          .topic = "/t",
          .type = "a/msg/A",
          .writer = *ros2::GuidFromBytes(kGuid),
          .first_ns = 2,
          .last_ns = 3,
          .cause = "queue full"};
}

template <typename What>
What Again(const What& what) {
  rips::v1::Observation wire;
  Encode(what, wire);
  const auto decoded = Decode(wire);
  EXPECT_THAT(decoded, IsOk());
  return std::get<What>(*decoded);
}

TEST(ObservationCodecTest, GivesBackEveryFieldOfEveryKind) {
  EXPECT_EQ(Again(kSignal), kSignal);
  EXPECT_EQ(Again(kIds), kIds);
  EXPECT_EQ(Again(kState), kState);
  EXPECT_EQ(Again(Finding()), Finding());
  EXPECT_EQ(Again(model::Finding{.kind = "k"}), model::Finding{.kind = "k"});
  for (const uint64_t from : {0, 6}) {
    model::GraphChange change{.from_version = from, .to_version = 7, .settled = true};
    change.delta.upsert_nodes.push_back(
        {.full_name = "/n", .participant = *ros2::GuidFromBytes(kGuid)});
    const model::GraphChange again = Again(change);
    EXPECT_EQ(again.from_version, from);
    EXPECT_EQ(again.to_version, 7u);
    EXPECT_TRUE(again.settled);
    EXPECT_EQ(again.delta.upsert_nodes, change.delta.upsert_nodes);
  }
}

TEST(ObservationCodecTest, LeavesMessagesLossesAndUnknownKindsToTheCaller) {
  rips::v1::Observation wire;
  EXPECT_TRUE(std::holds_alternative<std::monostate>(*Decode(wire)));
  wire.mutable_loss();
  EXPECT_TRUE(std::holds_alternative<std::monostate>(*Decode(wire)));
  wire.mutable_message();
  EXPECT_TRUE(std::holds_alternative<std::monostate>(*Decode(wire)));
}

TEST(ObservationCodecTest, RefusesGuidsOfAWrongLength) {
  rips::v1::Observation wire;
  wire.mutable_finding()->set_guid("short");
  EXPECT_TRUE(absl::IsInvalidArgument(Decode(wire).status()));
  rips::v1::RecordedEvent recorded;
  recorded.mutable_finding()->set_guid("short");
  EXPECT_TRUE(absl::IsInvalidArgument(DecodeExternal(recorded).status()));
  recorded.mutable_loss()->set_writer_guid("short");
  EXPECT_TRUE(absl::IsInvalidArgument(DecodeExternal(recorded).status()));
}

TEST(ObservationCodecTest, RefusesGraphVersionsThatDoNotCountUpFromOne) {
  rips::v1::Observation wire;
  wire.mutable_snapshot();
  EXPECT_TRUE(absl::IsInvalidArgument(Decode(wire).status()));
  // From 0 is a snapshot.
  for (const auto& [from, to] :
       std::vector<std::pair<uint64_t, uint64_t>>{{0, 1}, {3, 3}, {3, 2}}) {
    wire.mutable_delta()->set_from_version(from);
    wire.mutable_delta()->set_to_version(to);
    EXPECT_TRUE(absl::IsInvalidArgument(Decode(wire).status())) << from << " " << to;
  }
}

TEST(EventCodecTest, GivesBackEveryExternalEventButTicks) {
  for (const model::ExternalEvent& event :
       std::vector<model::ExternalEvent>{kIds, kSignal, model::AgentEvent{"sensor", "lost"},
                                         Finding(), Loss(), model::TickEvent{}}) {
    rips::v1::RecordedEvent wire;
    const bool tick = std::holds_alternative<model::TickEvent>(event);
    EXPECT_EQ(Encode(event, wire), !tick);
    const auto again = DecodeExternal(wire);
    ASSERT_THAT(again, IsOk());
    EXPECT_EQ(again->has_value(), !tick);
    if (!tick) {
      EXPECT_EQ(**again, event);
    }
  }
}

TEST(EventCodecTest, LeavesMessagesAndGraphsToTheCaller) {
  rips::v1::RecordedEvent wire;
  wire.mutable_message();
  EXPECT_EQ(*DecodeExternal(wire), std::nullopt);
  wire.mutable_snapshot();
  EXPECT_EQ(*DecodeExternal(wire), std::nullopt);
}

}  // namespace
}  // namespace rips::model_proto

// A recording of a robot, event by event.
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/server/operator_api/record_tap.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::operator_api {
namespace {

using pipeline::Lane;
using rips::v1::RecordedEvent;

class RecordTest : public pipeline::RobotTest {
 protected:
  std::shared_ptr<RecordingWriter> MakeTap() {
    return std::make_shared<RecordingWriter>(
        [this](rips::v1::Recording piece) {
          pieces_.push_back(std::move(piece));
          return listening_;
        },
        [this] { return listening_; });
  }
  void Begin() {
    Start();
    ConnectSensor();
    SendSnapshot();
    auto tap = MakeTap();
    ASSERT_THAT(robot_->AddTap(tap), IsOk());
    rips::v1::RecordingHeader header;
    header.set_robot("r1");
    tap->Start(std::move(header), robot_->core().graph_version().graph, true);
  }
  const RecordedEvent& Last() const { return pieces_.back().event(); }

  std::vector<rips::v1::Recording> pieces_;
  bool listening_ = true;
};

TEST_F(RecordTest, BeginsWithTheGraphAndGoesOnWithEachEvent) {
  Begin();
  ASSERT_EQ(pieces_.size(), 2u);
  EXPECT_EQ(pieces_[0].header().robot(), "r1");
  EXPECT_EQ(pieces_[1].event().snapshot().nodes_size(), 2);

  SendBatch(Lane::kMessages, {{.what = pipeline::MessageSeen{.topic = "/cmd_vel",
                                                             .type = "geometry_msgs/msg/Twist",
                                                             .sender = "/claimed",
                                                             .writer = Writer(2),
                                                             .size_bytes = 5,
                                                             .payload = "abc"}}});
  EXPECT_EQ(Last().message().topic(), "/cmd_vel");
  EXPECT_EQ(Last().message().sender(), "/navigator") << "as the server attributes it";
  EXPECT_EQ(Last().message().payload(), "abc");
  EXPECT_TRUE(Last().message().truncated());

  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder", "/cmd_vel");
  SendDelta(delta);
  EXPECT_EQ(Last().delta().upsert_nodes_size(), 1);
  EXPECT_EQ(Last().delta().upsert_nodes(0).full_name(), "/intruder");

  SendBatch(Lane::kControl, {{.what = pipeline::SignalSeen{"SIGUSR2"}}});
  EXPECT_EQ(Last().signal().name(), "SIGUSR2");
  SendBatch(Lane::kControl, {{.what = pipeline::IdsAlert{.gid = 1,
                                                         .sid = 7,
                                                         .message = "scan",
                                                         .src = "10.0.0.1",
                                                         .dst = "10.0.0.2",
                                                         .line = "line"}}});
  EXPECT_EQ(Last().ids().sid(), 7u);
  EXPECT_EQ(Last().ids().src(), "10.0.0.1");
}

TEST_F(RecordTest, WhatIsLeftOutOfTheGraphIsRecorded) {
  Begin();
  EXPECT_FALSE(pieces_[1].event().snapshot().has_truncation());
  SendDelta({.truncation = ros2::Truncation{.left_out = 16, .crowds = {{Participant(2), 3, 16}}}});
  EXPECT_EQ(Last().delta().truncation().left_out(), 16u);
  EXPECT_EQ(Last().delta().truncation().crowds(0).participant_guid(), Participant(2).ToBytes());
  // A recording that begins now says so, too.
  pieces_.clear();
  auto tap = MakeTap();
  ASSERT_THAT(robot_->AddTap(tap), IsOk());
  tap->Start({}, robot_->core().graph_version().graph, true);
  EXPECT_EQ(Last().snapshot().truncation().left_out(), 16u);
  // What is cut here is recorded as what the sensor cut.
  ros2::GraphDelta flood;
  for (uint8_t n = 3; n < 200; ++n) {
    for (uint8_t i = 0; i < 100; ++i) {
      if (i == 0) AddNode(&flood, n, absl::StrCat("/n", n));
      ros2::Guid guid = Writer(n);
      guid.bytes[13] = i;
      flood.upsert_endpoints.push_back({.guid = guid, .name = "/t", .type = "a/msg/A"});
    }
  }
  SendDelta(flood);
  ASSERT_GT(robot_->core().graph().dropped(), 0u);
  EXPECT_EQ(Last().delta().truncation().left_out(), robot_->core().graph().left_out());
}

TEST_F(RecordTest, LossesSayOfWhatAndWhen) {
  Begin();
  const int64_t now = Boottime();
  SendBatch(Lane::kControl, {{.what = pipeline::LossSeen{.count = 7,
                                                         .topic = "/cmd_vel",
                                                         .type = "a/msg/A",
                                                         .writer = Writer(2),
                                                         .first_ns = now - 5,
                                                         .last_ns = now,
                                                         .cause = "queue full"}}});
  const rips::v1::RecordedLoss& loss = Last().loss();
  EXPECT_EQ(loss.count(), 7u);
  EXPECT_EQ(loss.topic(), "/cmd_vel");
  EXPECT_EQ(loss.type(), "a/msg/A");
  EXPECT_EQ(loss.writer_guid(), Writer(2).ToBytes());
  EXPECT_EQ(loss.last_unix_ns(), clock_.Now().unix_ns);
  EXPECT_EQ(loss.first_unix_ns(), clock_.Now().unix_ns - 5);
  EXPECT_EQ(loss.cause(), "queue full");

  SendBatch(Lane::kControl, {{.what = pipeline::LossSeen{.count = 1}}});
  EXPECT_EQ(Last().loss().writer_guid(), "");
  EXPECT_EQ(Last().loss().first_unix_ns(), 0);
}

TEST_F(RecordTest, AMessageOfAnEarlierGraphBringsThatGraphAndWhatFollowsTheNewest) {
  Begin();
  const auto drive = [this] {
    SendBatch(Lane::kMessages, {{.what = pipeline::MessageSeen{.topic = "/cmd_vel",
                                                               .type = "geometry_msgs/msg/Twist",
                                                               .writer = Writer(2),
                                                               .graph_version = 1}}});
  };
  drive();
  EXPECT_FALSE(Last().has_context()) << "it is the graph that the recording began with";
  ros2::GraphDelta gone;
  gone.gone_guids = {Participant(2)};
  SendDelta(gone);

  drive();
  EXPECT_EQ(Last().message().sender(), "/navigator");
  EXPECT_EQ(Last().context().nodes_size(), 2);
  drive();
  EXPECT_FALSE(Last().has_context()) << "said once";
  SendBatch(Lane::kControl, {{.what = pipeline::SignalSeen{"SIGUSR2"}}});
  EXPECT_EQ(Last().context().nodes_size(), 1);
}

TEST_F(RecordTest, TicksAreLeftOutAndWhoLeavesIsForgotten) {
  Begin();
  const size_t before = pieces_.size();
  Pass(1'000);
  EXPECT_EQ(pieces_.size(), before);
  listening_ = false;
  Pass(1'000);
  for (size_t i = 0; i < pipeline::Robot::kTapsMax; ++i) {
    EXPECT_THAT(robot_->AddTap(MakeTap()), IsOk());
  }
  EXPECT_THAT(robot_->AddTap(MakeTap()), StatusIs(absl::StatusCode::kResourceExhausted));
}

}  // namespace
}  // namespace rips::operator_api

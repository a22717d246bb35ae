#include "policy_server/server/robot/model/coverage.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::HasSubstr;
using ::testing::Optional;

ros2::Guid Participant(uint8_t n) {
  ros2::Guid guid;
  guid.bytes = {1, 0x10, n, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1};
  return guid;
}

// One endpoint of each visibility and kind, all of participant 1.
ros2::GraphDelta Endpoints(ros2::EndpointKind kind, uint8_t first) {
  ros2::GraphDelta delta;
  delta.upsert_participants.push_back({.guid = Participant(1)});
  uint8_t entity = first;
  for (const auto visibility : {ros2::Visibility::kWatched, ros2::Visibility::kNotNeeded,
                                ros2::Visibility::kNotVisible, ros2::Visibility::kUnspecified}) {
    ros2::Guid guid = Participant(1);
    guid.bytes[14] = ++entity;
    guid.bytes[15] = 3;
    delta.upsert_endpoints.push_back(
        {.guid = guid, .kind = kind, .name = "/a", .type = "a/msg/A", .visibility = visibility});
  }
  return delta;
}

TEST(CountEndpointsTest, ByVisibility) {
  ros2::RosGraph graph;
  ASSERT_THAT(graph.Apply(Endpoints(ros2::EndpointKind::kPublisher, 0)), IsOk());
  ASSERT_THAT(graph.Apply(Endpoints(ros2::EndpointKind::kSubscriber, 10)), IsOk());
  EXPECT_EQ(CountEndpoints(graph, {}),
            (EndpointCounts{.watched = 2, .not_needed = 2, .not_visible = 4}))
      << "who does not say is not seen";
  EXPECT_EQ(CountEndpoints(graph, {Participant(2)}).not_visible, 4u);
  EXPECT_EQ(CountEndpoints(graph, {Participant(2), Participant(1)}), EndpointCounts{});
}

TEST(CountEndpointsTest, ServicesAreNeverRead) {
  ros2::RosGraph graph;
  ASSERT_THAT(graph.Apply(Endpoints(ros2::EndpointKind::kService, 0)), IsOk());
  ASSERT_THAT(graph.Apply(Endpoints(ros2::EndpointKind::kClient, 10)), IsOk());
  EXPECT_EQ(CountEndpoints(graph, {}), EndpointCounts{});
}

TEST(CoverageAlarmTest, TellsWhenMoreEndpointsAreNotVisible) {
  CoverageAlarm alarm;
  int64_t now = 0;
  const auto due = [&] { return alarm.Due(now += CoverageAlarm::kEveryNs); };
  EXPECT_EQ(due(), std::nullopt);
  alarm.SetNotVisible(1);
  alarm.SetNotVisible(3);
  EXPECT_THAT(due(), Optional(std::string("3 endpoints are not visible, 0 were")));
  EXPECT_EQ(due(), std::nullopt) << "told once";
  alarm.SetNotVisible(2);
  EXPECT_EQ(due(), std::nullopt) << "more is seen";
  alarm.SetNotVisible(3);
  EXPECT_THAT(due(), Optional(HasSubstr("3 endpoints are not visible, 2 were")));
}

TEST(CoverageAlarmTest, TellsKindsThatASensorDidNotSayAtFirst) {
  CoverageAlarm alarm;
  int64_t now = 0;
  const auto due = [&] { return alarm.Due(now += CoverageAlarm::kEveryNs); };
  alarm.SetKinds("base", {"unicast-only writers"});
  alarm.SetKinds("arm", {});
  EXPECT_EQ(due(), std::nullopt);
  alarm.SetKinds("base", {"shared memory", "unicast-only writers"});
  alarm.SetKinds("arm", {"\x1b[2J"});
  EXPECT_THAT(due(), Optional(std::string("sensor arm does not see \\x1b[2J; "
                                          "sensor base does not see shared memory")));
  EXPECT_EQ(due(), std::nullopt);
  alarm.SetKinds("base", {});
  EXPECT_EQ(due(), std::nullopt);
  alarm.SetKinds("base", {"shared memory"});
  EXPECT_THAT(due(), Optional(HasSubstr("shared memory"))) << "it was seen meanwhile";
}

TEST(CoverageAlarmTest, WhatComesAndGoesIsToldOnceAMinute) {
  CoverageAlarm alarm;
  int told = 0;
  for (int64_t now = 0; now < 10 * CoverageAlarm::kEveryNs; now += CoverageAlarm::kEveryNs / 10) {
    alarm.SetNotVisible(1);
    told += alarm.Due(now).has_value();
    alarm.SetNotVisible(0);
    told += alarm.Due(now + 1).has_value();
  }
  EXPECT_EQ(told, 10);
}

TEST(CoverageAlarmTest, ManyAndLongKindsAreCut) {
  CoverageAlarm alarm;
  alarm.SetKinds("base", {});
  std::vector<std::string> kinds;
  for (size_t i = 0; i < 10 * CoverageAlarm::kKindsMax; ++i) {
    kinds.push_back(absl::StrCat(1'000 + i, std::string(10'000, 'x')));
  }
  alarm.SetKinds("base", kinds);
  const auto text = alarm.Due(0);
  ASSERT_TRUE(text.has_value());
  EXPECT_LT(text->size(), CoverageAlarm::kKindsMax * (CoverageAlarm::kKindBytesMax + 10));
}

TEST(CutPayloadsTest, ForgetsTopicsAfterAWhileAndHoldsFewOfThem) {
  CutPayloads cut;
  cut.Add("/a", 10, 20, 0);
  cut.Add("/b", 10, 30, CutPayloads::kKeptNs);
  EXPECT_EQ(cut.Recent(CutPayloads::kKeptNs).size(), 2u);
  ASSERT_EQ(cut.Recent(CutPayloads::kKeptNs + 1).size(), 1u);
  EXPECT_EQ(cut.Recent(CutPayloads::kKeptNs + 1)[0].topic, "/b");
  cut.Add("/a", 11, 15, CutPayloads::kKeptNs + 1);
  EXPECT_EQ(cut.Recent(CutPayloads::kKeptNs + 1)[0].longest_bytes, 15u) << "it begins anew";

  for (size_t i = 0; i < 10 * CutPayloads::kTopicsMax; ++i) {
    cut.Add("/made_up_" + std::to_string(i), 1, 2, CutPayloads::kKeptNs + 2);
  }
  EXPECT_EQ(cut.Recent(CutPayloads::kKeptNs + 2).size(), CutPayloads::kTopicsMax);
}

}  // namespace
}  // namespace rips::pipeline

// Floods and large samples on the bus, as the sensor's observer takes them: whatever is not seen is
// counted, and nothing is counted twice.
#include <algorithm>
#include <cstdio>
#include <optional>
#include <set>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/dds/domain_watch.h"
#include "sensor_agent/fake_robot.h"
#include "sensor_agent/graph/graph_builder.h"
#include "sensor_agent/messages/message_flow.h"
#include "services/base/status_matchers.h"
#include "services/ros2/discovery_info.h"
#include "services/runtime/real_clock.h"
#include "tests/integration/bus_world.h"
#include "tests/support/ros2/test_world.h"

namespace rips::sensor {
namespace {

using bus::Child;
using dds::Eventually;

class FloodTest : public testing::Test {
 protected:
  FloodTest() {
    // As much of a receive buffer as the sensor asks for by itself.
    setenv("CYCLONEDDS_URI",
           absl::StrCat("<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" "
                        "multicast=\"true\"/></Interfaces></General><Discovery><Tag>",
                        dds::Tag(),
                        "</Tag><ParticipantIndex>none</ParticipantIndex></Discovery><Internal>"
                        "<SocketReceiveBufferSize max=\"4MB\"/></Internal></Domain></CycloneDDS>")
               .c_str(),
           1);
  }
  ~FloodTest() override { unsetenv("CYCLONEDDS_URI"); }

  void Watch(TopicWatcherOptions topics = {}) {
    auto watch = DomainWatch::Create(
        {.domain = {.id = dds::RandomDomain(), .interface = "lo"}, .topics = topics}, [] {});
    ASSERT_THAT(watch, IsOk());
    watch_ = *std::move(watch);
    const int64_t now_ns = clock_.Now().boottime_ns;
    graph_.emplace(GraphOptions{.own = watch_->own()}, now_ns);
    flow_.emplace(FlowOptions{}, &*graph_);
  }
  // What the observer does at each look, but for what it tells.
  void Look() {
    const int64_t now_ns = clock_.Now().boottime_ns;
    for (const Discovered& each : watch_->TakeDiscovered()) {
      const auto* endpoint = std::get_if<EndpointFact>(&each.what);
      if (!each.alive) continue;
      if (endpoint == nullptr) {
        graph_->ParticipantSeen(std::get<ros2::Participant>(each.what), now_ns);
        continue;
      }
      graph_->EndpointSeen(*endpoint, now_ns);
      watch_->topics().Watch(*endpoint, now_ns).IgnoreError();
    }
    for (const Claim& claim : watch_->TakeClaims()) {
      const auto entities = ros2::DecodeParticipantEntities(claim.payload);
      if (entities.ok()) graph_->NodesClaimed(claim.writer, *entities, now_ns).IgnoreError();
    }
    for (GraphChange& change : graph_->Poll(now_ns)) {
      for (const ros2::Node& node : change.delta.upsert_nodes) nodes_.insert(node.full_name);
    }
    MessageFlow::Output output;
    flow_->Poll(now_ns, output);
    std::vector<Sample> samples = watch_->topics().Take(4'096);
    for (const QueueLoss& loss : watch_->topics().TakeLosses()) {
      flow_->QueueLost(loss.writer, loss.topic, loss.count, now_ns, output);
    }
    for (Sample& sample : samples) flow_->Take(std::move(sample), now_ns, output);
    for (const MessageSeen& message : output.messages) {
      if (first_ == 0) first_ = message.writer_sequence;
      newest_ = std::max(newest_, message.writer_sequence);
      largest_ = std::max(largest_, message.size_bytes);
    }
    received_ += output.messages.size();
    for (const Loss& loss : output.losses) {
      (loss.cause == LossCause::kDdsGap ? gaps_ : queue_lost_) += loss.count;
    }
  }
  bool LookUntil(const std::function<bool()>& done) {
    return Eventually(
        [&] {
          Look();
          return done();
        },
        absl::Seconds(60));
  }
  Child Peer(const std::string& publish, std::vector<std::string> more) {
    std::vector<std::string> arguments = {"--domain",  absl::StrCat(dds::RandomDomain()),
                                          "--node",    "/flooder",
                                          "--publish", publish,
                                          "--readers", "1",
                                          "--tail-ms", "5"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Child("dds_peer", arguments);
  }
  // All there is to say of `sent` samples, from the first that came.
  void ExpectAllAccountedFor() {
    EXPECT_EQ(received_ + gaps_ + queue_lost_, newest_ - first_ + 1);
    EXPECT_EQ(flow_->counters().duplicates, 0u);
    std::printf("received %zu, gaps %zu, lost by the queue %zu, of %zu\n",
                static_cast<size_t>(received_), static_cast<size_t>(gaps_),
                static_cast<size_t>(queue_lost_), static_cast<size_t>(newest_ - first_ + 1));
  }

  const RealClock clock_;
  std::unique_ptr<DomainWatch> watch_;
  std::optional<GraphBuilder> graph_;
  std::optional<MessageFlow> flow_;
  std::set<std::string> nodes_;  // of all steps
  uint64_t first_ = 0;
  uint64_t newest_ = 0;
  uint64_t received_ = 0;
  uint64_t gaps_ = 0;
  uint64_t queue_lost_ = 0;
  uint32_t largest_ = 0;
};

constexpr char kFlood[] = "rt/flood,std_msgs::msg::dds_::String_,depth=1";

TEST_F(FloodTest, OfAFloodEverySampleIsSeenOrCounted) {
  Watch();
  Child peer = Peer(kFlood, {"--count", "100000", "--period-us", "0", "--bytes", "100"});
  // The tail is slow: what is lost in the flood shows as a gap before it.
  ASSERT_TRUE(LookUntil([&] { return newest_ > 100'000; })) << newest_;
  std::printf("100000 %s\n", peer.Line("written").c_str());
  ExpectAllAccountedFor();
}

TEST_F(FloodTest, WhatTheNetworkLosesIsAGap) {
  Watch();
  const std::string uri = getenv("CYCLONEDDS_URI");
  setenv("CYCLONEDDS_URI",
         absl::StrReplaceAll(uri, {{"<Internal>",
                                    "<Internal><Test><XmitLossiness>100"
                                    "</XmitLossiness></Test>"}})
             .c_str(),
         1);
  Child peer = Peer(kFlood, {"--count", "5000", "--period-us", "100", "--bytes", "100"});
  setenv("CYCLONEDDS_URI", uri.c_str(), 1);
  ASSERT_TRUE(LookUntil([&] { return newest_ > 5'000; })) << newest_;
  ExpectAllAccountedFor();
  EXPECT_GT(gaps_, 0u);
}

TEST_F(FloodTest, AnObserverThatSleepsLosesByTheQueueAndCountsItOnce) {
  Watch({.queue = 1'000});
  Child peer = Peer(kFlood, {"--count", "50000", "--period-us", "0", "--bytes", "100"});
  ASSERT_TRUE(LookUntil([&] { return received_ > 0; }));
  // Not looking until the flood is over.
  ASSERT_TRUE(peer.WaitFor("written"));
  ASSERT_TRUE(LookUntil([&] { return newest_ > 50'000; })) << newest_;
  ExpectAllAccountedFor();
  EXPECT_GT(queue_lost_, 0u);
}

TEST_F(FloodTest, LargeSamplesComeWholeOrAreCounted) {
  Watch();
  Child peer = Peer("rt/images,sensor_msgs::msg::dds_::Image_,depth=1",
                    {"--count", "20", "--period-us", "20000", "--bytes", "4194304"});
  ASSERT_TRUE(LookUntil([&] { return newest_ > 20; })) << newest_;
  ExpectAllAccountedFor();
  EXPECT_GE(largest_, 4'194'300u);
}

// Prints how long it takes until a step with a new node leaves the graph builder.
TEST_F(FloodTest, EveryNewNodeIsInAStep) {
  FakeRobot robot;
  Watch();
  ASSERT_TRUE(LookUntil([&] { return graph_->settled(); }));
  std::vector<std::unique_ptr<FakeProcess>> processes;
  std::vector<double> milliseconds;
  for (int i = 0; i < 15; ++i) {
    const std::string name = absl::StrCat("n", i);
    const absl::Time start = absl::Now();
    processes.push_back(robot.AddProcess());
    processes.back()->AddWriter(absl::StrCat("rt/t", i));
    processes.back()->Announce(name);
    ASSERT_TRUE(LookUntil([&] { return nodes_.contains("/" + name); })) << name;
    milliseconds.push_back(absl::ToDoubleMilliseconds(absl::Now() - start));
  }
  std::sort(milliseconds.begin(), milliseconds.end());
  std::printf("from before the participant is made: p50 %.1f ms, p99 %.1f ms\n",
              milliseconds[milliseconds.size() / 2], milliseconds[milliseconds.size() * 99 / 100]);
}

}  // namespace
}  // namespace rips::sensor

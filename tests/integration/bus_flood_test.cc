// Floods and large samples on the bus, as the sensor's observer takes them: whatever is not seen is
// counted, and nothing is counted twice.
#include <cstdio>
#include <map>
#include <optional>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/dds/domain_watch.h"
#include "sensor_agent/graph_builder.h"
#include "sensor_agent/message_flow.h"
#include "services/base/status_matchers.h"
#include "services/dds/test_world.h"
#include "services/ros2/discovery_info.h"
#include "services/runtime/real_clock.h"
#include "tests/integration/bus_world.h"

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
      if (endpoint == nullptr || !each.alive) continue;
      graph_->EndpointSeen(*endpoint, now_ns);
      watch_->topics().Watch(*endpoint, now_ns).IgnoreError();
    }
    for (const Claim& claim : watch_->TakeClaims()) {
      const auto entities = ros2::DecodeParticipantEntities(claim.payload);
      if (entities.ok()) graph_->NodesClaimed(claim.writer, *entities, now_ns).IgnoreError();
    }
    graph_->Poll(now_ns);
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
    return Eventually([&] {
      Look();
      return done();
    });
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
  Child peer = Peer(kFlood, {"--count", "400000", "--period-us", "0", "--bytes", "100"});
  // The tail is slow: what is lost in the flood shows as a gap before it.
  ASSERT_TRUE(LookUntil([&] { return newest_ > 400'000; })) << newest_;
  std::printf("400000 %s\n", peer.Line("written").c_str());
  ExpectAllAccountedFor();
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

}  // namespace
}  // namespace rips::sensor

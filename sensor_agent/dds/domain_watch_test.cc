#include "sensor_agent/dds/domain_watch.h"

#include <map>
#include <optional>
#include <set>

#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/fake_robot.h"
#include "services/base/status_matchers.h"
#include "tests/support/ros2/test_world.h"

namespace rips::sensor {
namespace {

using dds::Eventually;
using ros2::Guid;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr int64_t kNowNs = 1'000'000;

class DomainWatchTest : public testing::Test {
 protected:
  void Watch(DomainWatchOptions options = {}) {
    options.domain = {.id = dds::RandomDomain(), .interface = "lo"};
    auto watch = DomainWatch::Create(options, [this] { ++wakes_; });
    ASSERT_THAT(watch, IsOk());
    watch_ = *std::move(watch);
  }
  // Takes everything there is.
  void Pump() {
    for (const Discovered& each : watch_->TakeDiscovered()) {
      if (const auto* endpoint = std::get_if<EndpointFact>(&each.what)) {
        if (each.alive) {
          endpoints_[endpoint->guid] = *endpoint;
        } else {
          endpoints_.erase(endpoint->guid);
        }
      } else if (each.alive) {
        participants_.insert(std::get<ros2::Participant>(each.what).guid);
      } else {
        participants_.erase(std::get<ros2::Participant>(each.what).guid);
      }
    }
    for (Claim& claim : watch_->TakeClaims()) claims_.push_back(std::move(claim));
    for (Sample& sample : watch_->topics().Take(SIZE_MAX)) samples_.push_back(std::move(sample));
  }
  bool PumpUntil(const std::function<bool()>& done) {
    return Eventually([&] {
      Pump();
      return done();
    });
  }
  // Discovers `writer` and has it read.
  void Read(FakeProcess& process, const std::string& topic, dds::RawWriter& writer) {
    ASSERT_TRUE(PumpUntil([&] { return endpoints_.contains(writer.guid()); }));
    ASSERT_THAT(watch_->topics().Watch(endpoints_.at(writer.guid()), kNowNs), IsOk());
    ASSERT_TRUE(Eventually([&] { return process.MatchedReaders(topic) > 0; }));
  }

  void Follow(std::shared_ptr<const Interest> interest) {
    watch_->topics().SetPlan(
        std::make_shared<WatchPlan>(WatchOptions{.interest = std::move(interest)}), kNowNs);
  }
  // Payloads of topics that match, metadata of the others.
  static std::shared_ptr<const Interest> Ask(const std::string& regex, uint32_t bytes) {
    auto interest = Interest::Create(std::string(kInterestIdBytes, 'i'),
                                     {{.topic_regex = regex, .payload_bytes_max = bytes}, {}});
    EXPECT_THAT(interest, IsOk());
    return *interest;
  }
  // Metadata of topics that match, and nothing else.
  static std::shared_ptr<const Interest> AskOnlyFor(const std::string& regex) {
    auto interest = Interest::Create(std::string(kInterestIdBytes, 'i'), {{.topic_regex = regex}});
    EXPECT_THAT(interest, IsOk());
    return *interest;
  }

  FakeRobot robot_;
  std::atomic<int> wakes_ = 0;
  std::unique_ptr<DomainWatch> watch_;
  std::map<Guid, EndpointFact> endpoints_;
  std::set<Guid> participants_;
  std::vector<Claim> claims_;
  std::vector<Sample> samples_;
};

TEST_F(DomainWatchTest, TellsParticipantsEndpointsAndClaimsThatComeAndGo) {
  auto process = robot_.AddProcess();
  dds::RawWriter& writer = process->AddWriter("rt/chatter");
  process->Announce("talker");
  Watch();
  ASSERT_TRUE(PumpUntil([&] {
    return participants_.contains(process->participant().guid()) &&
           endpoints_.contains(writer.guid()) && !claims_.empty();
  }));
  const EndpointFact fact = endpoints_.at(writer.guid());
  EXPECT_TRUE(fact.writer);
  EXPECT_EQ(fact.topic, "rt/chatter");
  EXPECT_EQ(fact.type, "std_msgs::msg::dds_::String_");
  EXPECT_TRUE(fact.qos.reliable);
  EXPECT_TRUE(claims_[0].writer.SamePrefix(process->participant().guid()));
  const auto claim = ros2::DecodeParticipantEntities(claims_[0].payload);
  ASSERT_THAT(claim, IsOk());
  EXPECT_EQ(claim->nodes[0].node_name, "talker");
  EXPECT_GT(wakes_, 0);

  const Guid gone = writer.guid();
  process->RemoveWriter("rt/chatter");
  EXPECT_TRUE(PumpUntil([&] { return !endpoints_.contains(gone); }));
  const Guid participant = process->participant().guid();
  process.reset();
  EXPECT_TRUE(PumpUntil([&] { return !participants_.contains(participant); }));
}

TEST_F(DomainWatchTest, SamplesCarryWriterSequenceAndSizeButNoPayload) {
  Watch();
  auto process = robot_.AddProcess();
  dds::RawWriter& writer = process->AddWriter("rt/chatter");
  Read(*process, "rt/chatter", writer);
  EXPECT_THAT(watch_->topics().Watch(endpoints_.at(writer.guid()), kNowNs), IsOk()) << "again";
  EXPECT_EQ(watch_->topics().readers(), 1u);
  process->Publish("rt/chatter", std::string(100'000, 'x'));
  process->Publish("rt/chatter");
  ASSERT_TRUE(PumpUntil([&] { return samples_.size() >= 2; }));
  EXPECT_EQ(samples_[0].writer, writer.guid());
  EXPECT_EQ(samples_[0].reader->topic, "/chatter");
  EXPECT_EQ(samples_[0].reader->type, "std_msgs/msg/String");
  EXPECT_GT(samples_[0].size_bytes, 100'000u);
  EXPECT_EQ(samples_[1].sequence, samples_[0].sequence + 1);
  EXPECT_GT(samples_[0].received_ns, 0);

  watch_->topics().EndpointGone(writer.guid());
  EXPECT_EQ(watch_->topics().readers(), 0u);
  EXPECT_TRUE(Eventually([&] { return process->MatchedReaders("rt/chatter") == 0; }));
}

TEST_F(DomainWatchTest, PayloadsAreKeptForTheTopicsOfTheInterestAsLongAsItHolds) {
  Watch();
  auto process = robot_.AddProcess();
  dds::RawWriter& chatter = process->AddWriter("rt/chatter");
  dds::RawWriter& other = process->AddWriter("rt/other");
  Read(*process, "rt/chatter", chatter);
  // One topic is read before it is asked for, the other after.
  Follow(Ask("^/(chatter|other)$", 10));
  Read(*process, "rt/other", other);
  for (const char* topic : {"rt/chatter", "rt/other"}) {
    samples_.clear();
    process->Publish(topic, std::string(100'000, 'x'));
    ASSERT_TRUE(PumpUntil([&] { return !samples_.empty(); }));
    ASSERT_NE(samples_[0].payload, nullptr) << topic;
    // Encapsulation header, length of the string, its first bytes.
    EXPECT_EQ(*samples_[0].payload, std::string("\0\1\0\0\xa1\x86\1\0xx", 10));
    EXPECT_GT(samples_[0].size_bytes, 100'000u);
  }
  const auto next = [&](std::shared_ptr<const Interest> interest) -> Payload {
    Follow(std::move(interest));
    samples_.clear();
    process->Publish("rt/chatter", std::string(100'000, 'x'));
    if (!PumpUntil([&] { return !samples_.empty(); })) return nullptr;
    return samples_[0].payload;
  };
  const Payload most = next(Ask("chatter", UINT32_MAX));
  ASSERT_NE(most, nullptr);
  EXPECT_EQ(most->size(), samples_[0].size_bytes) << "all of it: it is below the hard limit";
  EXPECT_EQ(next(Ask("^/other$", 10)), nullptr);
  const Payload least = next(Ask("chatter", 1));
  ASSERT_NE(least, nullptr);
  EXPECT_EQ(least->size(), 1u);
  EXPECT_EQ(next(nullptr), nullptr);
  EXPECT_EQ(watch_->topics().TakePayloadsRefused(), 0u);
}

TEST_F(DomainWatchTest, PayloadsPastTheLimitAreCountedAndTheirSamplesKept) {
  Watch({.topics = {.payload_bytes = 2'000}});
  Follow(Ask("", 1'000));
  auto process = robot_.AddProcess();
  dds::RawWriter& writer = process->AddWriter("rt/chatter");
  Read(*process, "rt/chatter", writer);
  process->Publish("rt/chatter", std::string(3'000, 'x'));
  process->Publish("rt/chatter", std::string(3'000, 'x'));
  ASSERT_TRUE(PumpUntil([&] { return samples_.size() == 2; }));
  EXPECT_NE(samples_[0].payload, nullptr);
  EXPECT_EQ(samples_[1].payload, nullptr);
  EXPECT_EQ(watch_->topics().TakePayloadsRefused(), 1u);
  samples_.clear();
  process->Publish("rt/chatter", std::string(3'000, 'x'));
  ASSERT_TRUE(PumpUntil([&] { return !samples_.empty(); }));
  EXPECT_NE(samples_[0].payload, nullptr) << "there is room again";
}

TEST_F(DomainWatchTest, LatchedWriterIsReadFromItsHistory) {
  auto process = robot_.AddProcess();
  dds::RawWriter& writer =
      process->AddWriter("rt/map", {.reliable = true, .transient_local = true, .depth = 3});
  for (int i = 0; i < 3; ++i) process->Publish("rt/map");
  Watch();
  Read(*process, "rt/map", writer);
  ASSERT_TRUE(PumpUntil([&] { return !samples_.empty(); }));
  EXPECT_TRUE(samples_[0].reader->latched);
  EXPECT_EQ(samples_.back().sequence, 3u);
}

TEST_F(DomainWatchTest, WritersInAnyPartitionAreRead) {
  Watch();
  auto process = robot_.AddProcess();
  dds::RawWriter& writer =
      process->AddWriter("rt/hidden", {.reliable = true, .depth = 1, .partitions = {"secret"}});
  Read(*process, "rt/hidden", writer);
  process->Publish("rt/hidden");
  EXPECT_TRUE(PumpUntil([&] { return !samples_.empty(); }));
}

TEST_F(DomainWatchTest, OnlyRosTopicsAreRead) {
  Watch();
  for (const char* topic : {"rq/enableRequest", "rr/enableReply", "Square", "ros_discovery_info"}) {
    EXPECT_THAT(watch_->topics().Watch({.writer = true, .topic = topic, .type = "T"}, kNowNs),
                StatusIs(absl::StatusCode::kInvalidArgument))
        << topic;
  }
  EXPECT_EQ(watch_->topics().readers(), 0u);
}

TEST_F(DomainWatchTest, ThereIsNoReaderForWhatNobodyNeeds) {
  Watch();
  auto process = robot_.AddProcess();
  dds::RawWriter& chatter = process->AddWriter("rt/chatter");
  dds::RawWriter& other = process->AddWriter("rt/other");
  Follow(AskOnlyFor("^/other$"));
  Read(*process, "rt/other", other);
  ASSERT_TRUE(PumpUntil([&] { return endpoints_.contains(chatter.guid()); }));
  ASSERT_THAT(watch_->topics().Watch(endpoints_.at(chatter.guid()), kNowNs), IsOk());
  EXPECT_EQ(watch_->topics().readers(), 1u);
  EXPECT_EQ(process->MatchedReaders("rt/chatter"), 0u);

  Follow(AskOnlyFor("^/chatter$"));
  EXPECT_EQ(watch_->topics().readers(), 1u);
  EXPECT_TRUE(Eventually([&] {
    return process->MatchedReaders("rt/chatter") == 1 && process->MatchedReaders("rt/other") == 0;
  }));
  process->Publish("rt/chatter");
  ASSERT_TRUE(PumpUntil([&] { return !samples_.empty(); }));
  EXPECT_EQ(samples_[0].reader->topic, "/chatter");
  EXPECT_TRUE(samples_[0].reader->resumed);

  watch_->topics().SetPlan(std::make_shared<WatchPlan>(WatchOptions{.idle = true}), kNowNs);
  EXPECT_EQ(watch_->topics().readers(), 0u);
  EXPECT_TRUE(Eventually([&] { return process->MatchedReaders("rt/chatter") == 0; }));
}

TEST_F(DomainWatchTest, ALatchedTopicReadAnewGivesItsHistoryUnderTheSameNumbers) {
  Watch();
  auto process = robot_.AddProcess();
  dds::RawWriter& writer =
      process->AddWriter("rt/map", {.reliable = true, .transient_local = true, .depth = 2});
  Read(*process, "rt/map", writer);
  for (int i = 0; i < 3; ++i) process->Publish("rt/map");
  ASSERT_TRUE(PumpUntil([&] { return !samples_.empty() && samples_.back().sequence == 3; }));
  Follow(AskOnlyFor("none"));
  ASSERT_TRUE(Eventually([&] { return process->MatchedReaders("rt/map") == 0; }));
  process->Publish("rt/map");
  samples_.clear();
  Follow(nullptr);
  ASSERT_TRUE(PumpUntil([&] { return samples_.size() == 2; }));
  EXPECT_EQ(samples_[0].sequence, 3u);
  EXPECT_EQ(samples_[1].sequence, 4u);
}

TEST_F(DomainWatchTest, AWriterThatCannotBeReadSaysWhy) {
  Watch();
  auto process = robot_.AddProcess();
  dds::RawWriter& good = process->AddWriter("rt/chatter");
  const auto exclusive = dds::RawWriter::Create(
      process->participant(),
      {.topic = "rt/chatter", .type = "std_msgs::msg::dds_::String_", .exclusive = true});
  ASSERT_THAT(exclusive, IsOk());
  const Guid guid = (*exclusive)->guid();
  Read(*process, "rt/chatter", good);
  ASSERT_TRUE(PumpUntil([&] { return endpoints_.contains(guid); }));
  ASSERT_THAT(watch_->topics().Watch(endpoints_.at(guid), kNowNs), IsOk());
  EndpointFact ghost = endpoints_.at(good.guid());
  ghost.guid.bytes[14] ^= 0x55;
  ASSERT_THAT(watch_->topics().Watch(ghost, kNowNs), IsOk());
  const int64_t grace_ns = TopicWatcherOptions().match_ns;
  EXPECT_THAT(watch_->topics().TakeCoverage(kNowNs + grace_ns - 1), IsEmpty());
  const int64_t due_ns = watch_->topics().NextDue();
  EXPECT_LT(due_ns, kNowNs + 2 * grace_ns);
  std::map<Guid, std::string> news;
  for (const Coverage& each : watch_->topics().TakeCoverage(due_ns)) {
    news[each.writer] = each.not_visible;
  }
  EXPECT_THAT(news, SizeIs(2));
  EXPECT_EQ(news[guid], "QoS: exclusive ownership");
  EXPECT_EQ(news[ghost.guid], "it has not matched our reader within 2s");
  EXPECT_THAT(watch_->topics().TakeCoverage(10 * grace_ns), IsEmpty()) << "told once";
  EXPECT_EQ(watch_->topics().NextDue(), kNever);
}

TEST_F(DomainWatchTest, AWriterWhoseNumbersJumpedIsNotVisibleUntilItIsDiscoveredAgain) {
  Watch();
  auto process = robot_.AddProcess();
  dds::RawWriter& writer = process->AddWriter("rt/chatter");
  const Guid guid = writer.guid();
  Read(*process, "rt/chatter", writer);
  ASSERT_TRUE(Eventually([&] { return watch_->NumbersOf(guid).has_value(); }));
  watch_->topics().TakeCoverage(kNowNs);
  const auto news = [&] {
    std::vector<std::string> all;
    for (const Coverage& each : watch_->topics().TakeCoverage(kNowNs)) {
      EXPECT_EQ(each.writer, guid);
      all.push_back(each.not_visible);
    }
    return all;
  };
  watch_->topics().SetJumped(guid);
  EXPECT_THAT(news(), ElementsAre("sequence numbers jumped"));
  EXPECT_FALSE(watch_->topics().Reads(guid));
  process->Publish("rt/chatter");
  EXPECT_TRUE(PumpUntil([&] { return !samples_.empty(); })) << "what comes is handed on";
  // A topic that is not needed for a while, and then is.
  Follow(AskOnlyFor("none"));
  news();
  Follow(nullptr);
  EXPECT_THAT(news(), ElementsAre("sequence numbers jumped"));
  watch_->topics().EndpointGone(guid);
  ASSERT_THAT(watch_->topics().Watch(endpoints_.at(guid), kNowNs), IsOk());
  EXPECT_TRUE(watch_->topics().Reads(guid));
}

TEST_F(DomainWatchTest, AWriterInPartitionPatternsIsReadThroughANameThatTheyMatch) {
  Watch();
  auto process = robot_.AddProcess();
  dds::RawWriter& writer = process->AddWriter(
      "rt/hidden", {.reliable = true, .depth = 1, .partitions = {"ev?l*", "o*"}});
  Read(*process, "rt/hidden", writer);
  process->Publish("rt/hidden");
  EXPECT_TRUE(PumpUntil([&] { return !samples_.empty(); }));
}

TEST_F(DomainWatchTest, AWriterIsReadBeforeItIsDiscoveredIfSomebodySubscribes) {
  Watch();
  auto base = robot_.AddProcess();
  const auto subscriber = *dds::RawReader::Create(
      base->participant(), {.topic = "rt/cmd_vel", .type = "std_msgs::msg::dds_::String_"},
      [](const dds::RawSample&) {});
  ASSERT_TRUE(PumpUntil([&] { return endpoints_.contains(subscriber->guid()); }));
  ASSERT_THAT(watch_->topics().Watch(endpoints_.at(subscriber->guid()), kNowNs), IsOk());
  EXPECT_EQ(watch_->topics().readers(), 1u) << "though nobody writes";

  auto intruder = robot_.AddProcess();
  dds::RawWriter& writer = intruder->AddWriter("rt/cmd_vel");
  const Guid guid = writer.guid();
  ASSERT_TRUE(Eventually([&] { return writer.MatchedReaders() == 2; }));
  // The reader may learn of the match after the writer. The watcher is not told at all.
  ASSERT_TRUE(Eventually([&] {
    intruder->Publish("rt/cmd_vel");
    samples_ = watch_->topics().Take(SIZE_MAX);
    return !samples_.empty();
  }));
  EXPECT_EQ(samples_[0].writer, guid);
  watch_->topics().EndpointGone(subscriber->guid());
  EXPECT_EQ(watch_->topics().readers(), 0u);
}

TEST_F(DomainWatchTest, PastTheLimitOnReadersAWriterWaitsForRoom) {
  Watch({.topics = {.readers = 1, .endpoints = 3}});
  const auto fact = [](uint8_t number, const std::string& topic) {
    EndpointFact made{.writer = true, .topic = topic, .type = "T"};
    made.guid.bytes[14] = number;
    made.guid.bytes[15] = 0x03;
    return made;
  };
  const auto exhausted = absl::StatusCode::kResourceExhausted;
  ASSERT_THAT(watch_->topics().Watch(fact(1, "rt/a"), kNowNs), IsOk());
  EXPECT_THAT(watch_->topics().Watch(fact(2, "rt/b"), kNowNs),
              StatusIs(exhausted, HasSubstr("more than 1 topics to read")));
  EXPECT_THAT(watch_->topics().Watch(fact(3, "rt/b"), kNowNs), StatusIs(exhausted));
  EXPECT_THAT(watch_->topics().Watch(fact(4, "rt/a"), kNowNs),
              StatusIs(exhausted, HasSubstr("more than 3 endpoints")));
  std::map<Guid, std::string> news;
  for (const Coverage& each : watch_->topics().TakeCoverage(kNowNs)) {
    news[each.writer] = each.not_visible;
  }
  EXPECT_EQ(news[fact(2, "").guid], "more than 1 topics to read");
  EXPECT_EQ(news[fact(3, "").guid], "more than 1 topics to read");
  EXPECT_EQ(news[fact(4, "").guid], "more than 3 endpoints of topics");
  EXPECT_EQ(news.size(), 3u);

  // Room comes when a topic goes, or is not needed any more.
  watch_->topics().EndpointGone(fact(1, "").guid);
  watch_->topics().TakeCoverage(kNowNs);
  EXPECT_EQ(watch_->topics().readers(), 1u);
  ASSERT_THAT(watch_->topics().Watch(fact(4, "rt/a"), kNowNs), StatusIs(exhausted));
  Follow(AskOnlyFor("^/a$"));
  EXPECT_EQ(watch_->topics().readers(), 1u);
  EXPECT_THAT(watch_->topics().Watch(fact(4, "rt/a"), kNowNs), IsOk());
}

TEST_F(DomainWatchTest, FullQueuesLoseWithACount) {
  Watch({.discovered = 2, .claims = 1, .topics = {.readers = 1, .queue = 5}});
  auto process = robot_.AddProcess();
  dds::RawWriter& writer = process->AddWriter("rt/chatter");
  EndpointFact fact{.guid = writer.guid(),
                    .writer = true,
                    .topic = "rt/chatter",
                    .type = "std_msgs::msg::dds_::String_",
                    .qos = {.reliable = true}};
  ASSERT_THAT(watch_->topics().Watch(fact, kNowNs), IsOk());
  fact.guid.bytes[14] ^= 1;
  fact.topic = "rt/one_more";
  EXPECT_THAT(watch_->topics().Watch(fact, kNowNs),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("more than 1 topics")));
  ASSERT_TRUE(Eventually([&] { return process->MatchedReaders("rt/chatter") > 0; }));
  // The reader may learn of the match after the writer: only when one has come do all come.
  ASSERT_TRUE(Eventually([&] {
    process->Publish("rt/chatter");
    return !watch_->topics().Take(SIZE_MAX).empty();
  }));
  absl::SleepFor(absl::Milliseconds(100));  // what is still on its way
  watch_->topics().Take(SIZE_MAX);
  watch_->topics().TakeLosses();

  for (int i = 0; i < 12; ++i) process->Publish("rt/chatter");
  uint64_t lost = 0;
  ASSERT_TRUE(Eventually([&] {
    for (const QueueLoss& loss : watch_->topics().TakeLosses()) {
      EXPECT_EQ(loss.topic, "/chatter");
      EXPECT_EQ(loss.writer, writer.guid());
      lost += loss.count;
    }
    return lost >= 7;
  }));
  EXPECT_EQ(lost, 7u);
  EXPECT_THAT(watch_->topics().Take(SIZE_MAX), SizeIs(5));

  for (int i = 0; i < 3; ++i) process->Announce("n");
  EXPECT_TRUE(Eventually([&] { return watch_->TakeLostClaims() > 0; }));
  EXPECT_TRUE(Eventually([&] { return watch_->TakeLostDiscovered() > 0; }));
  // All that is there is told again, in whatever pieces the queue allows.
  EXPECT_THAT(watch_->TakeDiscovered(), SizeIs(2));
  ASSERT_THAT(watch_->Rediscover(), IsOk());
  EXPECT_FALSE(watch_->TakeDiscovered().empty());
}

}  // namespace
}  // namespace rips::sensor

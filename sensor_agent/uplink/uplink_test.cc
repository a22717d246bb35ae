#include "sensor_agent/uplink/uplink.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "grpcpp/security/credentials.h"
#include "gtest/gtest.h"
#include "sensor_agent/uplink/fake_policy_server.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips::sensor {
namespace {

using rips::v1::CONTROL;
using rips::v1::MESSAGES;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Le;
using ::testing::SizeIs;

std::shared_ptr<const MessageSource> Source(const std::string& topic) {
  ros2::Endpoint writer{.name = topic, .type = "a/msg/A", .node = "/talker"};
  return std::make_shared<const MessageSource>(
      MessageSource{.topic = topic, .type = "a/msg/A", .writer = std::move(writer)});
}

class UplinkTest : public testing::Test {
 protected:
  ~UplinkTest() override {
    if (uplink_ != nullptr) uplink_->Stop();
    server_.Stop();
    EXPECT_THAT(server_.violations, IsEmpty());
  }

  void StartUplink(OutboxLimits limits = {}, EncoderLimits encoder = {}) {
    uplink_ = std::make_unique<Uplink>(
        UplinkOptions{
            .servers = {server_.address()},
            .credentials = grpc::InsecureChannelCredentials(),
            .host = "base",
            .domain = 7,
            .core = {.outbox = limits,
                     .backlog = {.memory_bytes = backlog_bytes_},
                     .live = live_,
                     .heartbeat = absl::Milliseconds(50)},
            .encoder = encoder,
            .backoff = {.initial = absl::Milliseconds(20), .max = absl::Milliseconds(50)}},
        Uplink::Hooks{
            .on_own_participants =
                [this](std::vector<ros2::Guid> own) {
                  MutexLock lock(&mu_);
                  own_ = std::move(own);
                },
            // As the observer would, with a graph of one version more.
            .on_snapshot_wanted = [this] { uplink_->ReplaceGraph({Snapshot(++version_)}); },
            .on_interest =
                [this](std::shared_ptr<const Interest> interest) {
                  const std::string id = interest->id();
                  {
                    MutexLock lock(&mu_);
                    interests_.push_back(std::move(interest));
                    if (slow_) return;
                  }
                  uplink_->InterestInUse(id);
                }},
        &clock_, &metrics_);
    uplink_->Start();
  }
  static GraphChange Snapshot(uint64_t version) {
    return {.from_version = 0, .to_version = version, .settled = true};
  }
  void AppendSnapshot() { uplink_->Append({.graph = {Snapshot(++version_)}, .settled = true}); }
  void AppendDelta() {
    const uint64_t from = version_++;
    uplink_->Append({.graph = {{.from_version = from, .to_version = from + 1, .settled = true}}});
  }
  // Messages told apart by their size.
  void AppendMessages(uint32_t first, uint32_t last) {
    Observations seen;
    for (uint32_t i = first; i <= last; ++i) {
      seen.messages.push_back({.boottime_ns = clock_.Now().boottime_ns,
                               .source = source_,
                               .size_bytes = i,
                               .urgent = i == first});
    }
    uplink_->Append(std::move(seen));
  }
  bool WaitForMessages(size_t count) {
    return server_.WaitUntil(
        [&](const FakePolicyServer& s) { return s.Distinct(MESSAGES).size() >= count; });
  }
  bool WaitForStreams(size_t count) {
    return server_.WaitUntil([&](const FakePolicyServer& s) { return s.hellos.size() >= count; });
  }
  void AppendPayload(uint32_t size, size_t bytes) {
    uplink_->Append({.messages = {{.boottime_ns = clock_.Now().boottime_ns,
                                   .source = source_,
                                   .size_bytes = size,
                                   .payload = std::make_shared<const std::string>(bytes, 'x')}}});
  }
  // Sends what Interests of `letter` ask for: that many bytes of /a.
  static std::string IdOf(char letter) { return std::string(kInterestIdBytes, letter); }
  void SendInterest(char letter, const std::string& regex, uint32_t bytes,
                    rips::v1::InterestRule::Depth depth = rips::v1::InterestRule::PAYLOAD) {
    rips::v1::SensorReply reply;
    reply.mutable_interest()->set_id(IdOf(letter));
    rips::v1::InterestRule* rule = reply.mutable_interest()->add_rules();
    rule->set_topic_regex(regex);
    rule->set_depth(depth);
    rule->set_payload_bytes_max(bytes);
    reply.mutable_interest()->add_rules()->set_depth(rips::v1::InterestRule::METADATA);
    server_.Send(reply);
  }
  static ptrdiff_t Snapshots(const FakePolicyServer& server) {
    return std::count_if(server.received.begin(), server.received.end(),
                         [](const Recorded& each) { return each.what.has_snapshot(); });
  }
  bool WaitForAnswers(size_t count) {
    return server_.WaitUntil([&](const auto& s) { return s.interests_applied.size() >= count; });
  }
  // Until the outbox is empty. The gauge is set at each heartbeat.
  bool WaitUntilAllIsAcknowledged() {
    const Gauge bytes = metrics_.AddGauge("rips_sensor_outbox_bytes",
                                          "Estimated memory of observations not acknowledged");
    std::optional<int> heartbeats;
    return server_.WaitUntil([&](const FakePolicyServer& s) {
      if (!heartbeats.has_value()) heartbeats = s.heartbeats;
      return s.heartbeats >= *heartbeats + 2 && bytes.Value() == 0;
    });
  }
  // Until the uplink knows that the server is gone.
  void StopServer() {
    server_.Stop();
    ASSERT_TRUE(server_.WaitUntil([&](const auto&) { return !uplink_->Ready().ok(); }));
  }
  // Sizes of the messages, each once, in the order of their sequences; exactly 1..count expected.
  void ExpectMessages(uint32_t count) {
    const std::vector<Recorded> distinct = server_.Distinct(MESSAGES);
    ASSERT_THAT(distinct, SizeIs(count));
    std::map<uint64_t, uint32_t> size_of;
    for (const Recorded& each : server_.received) {
      if (each.lane != MESSAGES) continue;
      const uint32_t size = each.what.message().size_bytes();
      const auto [it, is_new] = size_of.emplace(each.sequence, size);
      EXPECT_EQ(it->second, size) << "sequence " << each.sequence << " used for two messages";
    }
    for (uint32_t i = 0; i < count; ++i) {
      EXPECT_EQ(distinct[i].sequence, i + 1);
      EXPECT_EQ(distinct[i].what.message().size_bytes(), i + 1);
    }
  }

  const RealClock clock_;
  Metrics metrics_;
  size_t backlog_bytes_ = BacklogOptions().memory_bytes;
  absl::Duration live_ = UplinkOptions().core.live;
  FakePolicyServer server_;
  const std::shared_ptr<const MessageSource> source_ = Source("/chatter");
  std::atomic<uint64_t> version_ = 0;
  Mutex mu_;
  std::vector<ros2::Guid> own_ ABSL_GUARDED_BY(mu_);
  std::vector<std::shared_ptr<const Interest>> interests_ ABSL_GUARDED_BY(mu_);
  // Do not observe what was asked for, until told.
  bool slow_ ABSL_GUARDED_BY(mu_) = false;
  std::unique_ptr<Uplink> uplink_;  // last: its callbacks use the above
};

TEST_F(UplinkTest, SaysHelloThenSendsControlBeforeMessages) {
  server_.Start();
  StartUplink();
  AppendMessages(1, 3);
  AppendSnapshot();
  ASSERT_TRUE(WaitForMessages(3));
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.heartbeats >= 2; }));
  uplink_->Stop();

  ASSERT_THAT(server_.hellos, SizeIs(1));
  const rips::v1::SensorHello& hello = server_.hellos[0];
  EXPECT_EQ(hello.hello().protocol(), 1);
  EXPECT_EQ(hello.hello().host(), "base");
  EXPECT_EQ(hello.hello().incarnation().size(), 16u);
  EXPECT_EQ(hello.hello().incarnation(), uplink_->incarnation());
  EXPECT_GT(hello.hello().clock().boottime_ns(), 0u);
  EXPECT_EQ(hello.domain(), 7);
  ASSERT_THAT(hello.spooled(), SizeIs(2));
  EXPECT_EQ(hello.spooled(0).last_sequence() + 1, hello.spooled(0).first_sequence());
  ASSERT_FALSE(server_.received.empty());
  EXPECT_TRUE(server_.received[0].what.has_snapshot()) << "messages must be judged against a graph";
  ExpectMessages(3);
  EXPECT_EQ(server_.Distinct(MESSAGES)[0].topic, "/chatter");
  EXPECT_EQ(server_.Distinct(MESSAGES)[0].writer.node(), "/talker");
}

TEST_F(UplinkTest, MessagesWaitForTheSettledSnapshot) {
  server_.Start();
  StartUplink();
  AppendMessages(1, 3);
  uplink_->Append({.signals = {"SIGUSR1"}});
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.heartbeats >= 3; }));
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return !s.Distinct(CONTROL).empty(); }));
  EXPECT_TRUE(server_.WaitUntil([](const auto& s) { return s.Distinct(MESSAGES).empty(); }));
  AppendSnapshot();
  EXPECT_TRUE(WaitForMessages(3));
}

TEST_F(UplinkTest, ServerAbsentAtStartGetsEverythingLater) {
  server_.Start();
  server_.Stop();
  StartUplink();
  EXPECT_THAT(uplink_->Ready(), StatusIs(absl::StatusCode::kUnavailable));
  AppendSnapshot();
  AppendMessages(1, 100);
  AppendDelta();
  AppendMessages(101, 200);
  server_.Start();
  ASSERT_TRUE(WaitForMessages(200));
  EXPECT_THAT(uplink_->Ready(), IsOk());
  uplink_->Stop();
  ExpectMessages(200);
  EXPECT_EQ(server_.graph_version, version_);
}

TEST_F(UplinkTest, UntilTheServerAnswersOnlyHeartbeatsAreSent) {
  server_.Start();
  server_.Set([](auto& b) { b.silent = true; });
  StartUplink();
  AppendSnapshot();
  AppendMessages(1, 10);
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.heartbeats >= 3; }));
  EXPECT_THAT(uplink_->Ready(), StatusIs(absl::StatusCode::kUnavailable));
  uplink_->Stop();
  EXPECT_THAT(server_.batches, IsEmpty());
}

TEST_F(UplinkTest, DroppedStreamIsResumedWithoutLossOrNewSequences) {
  server_.Start();
  server_.Set([](auto& b) { b.acknowledge = false; });
  StartUplink();
  AppendSnapshot();
  uint32_t sent = 0;
  for (size_t streams = 1; streams <= 4; ++streams) {
    ASSERT_TRUE(WaitForStreams(streams));
    server_.Set([](auto& b) { b.batches_until_close = 5; });
    AppendMessages(sent + 1, sent + 100);
    AppendDelta();
    sent += 100;
    ASSERT_TRUE(WaitForStreams(streams + 1));
  }
  ASSERT_TRUE(WaitForMessages(sent));
  uplink_->Stop();

  ExpectMessages(sent);
  for (const rips::v1::SensorHello& hello : server_.hellos) {
    EXPECT_EQ(hello.hello().incarnation(), uplink_->incarnation());
  }
  int snapshots = 0;
  std::map<uint64_t, std::string> control;
  for (const Recorded& each : server_.received) {
    if (each.lane != CONTROL) continue;
    snapshots += each.what.has_snapshot() && each.sequence != 1;
    rips::v1::Observation what = each.what;
    what.clear_offset_ns();
    EXPECT_EQ(control.emplace(each.sequence, what.SerializeAsString()).first->second,
              what.SerializeAsString());
  }
  EXPECT_EQ(snapshots, 0) << "same incarnation, no gap: no snapshot";
  EXPECT_EQ(server_.graph_version, version_);
}

TEST_F(UplinkTest, WhatWasAcknowledgedIsNotSentAgain) {
  server_.Start();
  StartUplink();
  AppendSnapshot();
  AppendMessages(1, 50);
  ASSERT_TRUE(WaitForMessages(50));
  ASSERT_TRUE(WaitUntilAllIsAcknowledged());
  StopServer();
  AppendMessages(51, 60);
  server_.Start();
  ASSERT_TRUE(WaitForMessages(60));
  uplink_->Stop();
  size_t messages = 0;
  for (const Recorded& each : server_.received) messages += each.lane == MESSAGES;
  EXPECT_EQ(messages, 60u);
  ASSERT_THAT(server_.hellos, SizeIs(2));
  EXPECT_EQ(server_.hellos[1].spooled(1).first_sequence(), 51);
  EXPECT_EQ(server_.hellos[1].spooled(1).last_sequence(), 50) << "nothing in flight";
  EXPECT_EQ(server_.hellos[0].spooled(1).acknowledged_sequence(), 0u);
  EXPECT_EQ(server_.hellos[1].spooled(1).acknowledged_sequence(), 50u) << "as it was told";
}

TEST_F(UplinkTest, ServerThatForgotGetsASnapshotInstead) {
  server_.Start();
  StartUplink();
  AppendSnapshot();
  AppendDelta();
  AppendMessages(1, 10);
  ASSERT_TRUE(WaitForMessages(10));
  ASSERT_TRUE(WaitUntilAllIsAcknowledged());
  StopServer();
  server_.Set([](auto& b) { b.forget = true; });
  AppendDelta();
  AppendMessages(11, 20);
  server_.Start();
  ASSERT_TRUE(WaitForMessages(20));
  ASSERT_TRUE(server_.WaitUntil([&](const auto& s) { return s.graph_version == version_; }));
  uplink_->Stop();
  ExpectMessages(20);
  EXPECT_EQ(version_, 3u) << "no step is left out, and none is added";
  EXPECT_EQ(Snapshots(server_), 2);
}

TEST_F(UplinkTest, SnapshotIsGivenAlsoInTheMiddleOfAStream) {
  server_.Start();
  StartUplink();
  AppendSnapshot();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  ASSERT_TRUE(WaitUntilAllIsAcknowledged());
  rips::v1::SensorReply config;
  config.mutable_config()->set_primary(true);
  config.mutable_config()->set_want_snapshot(true);
  server_.Send(config);
  EXPECT_TRUE(server_.WaitUntil([&](const auto& s) { return Snapshots(s) == 2; }));
}

TEST_F(UplinkTest, LowerAcknowledgementThanBeforeMeansASnapshot) {
  server_.Start();
  StartUplink();
  AppendSnapshot();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  ASSERT_TRUE(WaitUntilAllIsAcknowledged());
  StopServer();
  // It does not ask, but its acknowledgement tells that it has lost what it knew.
  server_.Set([](auto& b) {
    b.ask_for_snapshot = false;
    b.acknowledge_zero_once = true;
  });
  server_.Start();
  EXPECT_TRUE(server_.WaitUntil([&](const auto& s) { return Snapshots(s) == 2; }));
}

TEST_F(UplinkTest, RefusedStreamIsFollowedByASnapshotAndThenByANewIncarnation) {
  server_.Start();
  server_.Set([](auto& b) {
    b.acknowledge = false;
    b.close_with = grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "makes no sense");
  });
  StartUplink();
  AppendSnapshot();
  AppendMessages(1, 5);
  ASSERT_TRUE(WaitForMessages(5));
  const std::string incarnation = uplink_->incarnation();
  server_.Set([](auto& b) { b.batches_until_close = 1; });
  AppendDelta();
  ASSERT_TRUE(WaitForStreams(2));
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.graph_version == 3; }))
      << "a snapshot in place of the steps";
  EXPECT_EQ(uplink_->incarnation(), incarnation);
  server_.Set([](auto& b) { b.batches_until_close = 1; });
  AppendDelta();
  ASSERT_TRUE(WaitForStreams(3));
  ASSERT_TRUE(server_.WaitUntil([&](const auto& s) {
    return s.hellos.back().hello().incarnation() != incarnation && s.graph_version >= 5;
  }));
  AppendMessages(6, 7);
  ASSERT_TRUE(WaitForMessages(7));
  uplink_->Stop();
  EXPECT_EQ(server_.received.back().sequence, 2) << "numbers count from 1 again";
}

TEST_F(UplinkTest, MessagesStayWithinCreditAndControlNeedsNone) {
  server_.Start();
  server_.Set([](auto& b) { b.credit = 2'000; });
  StartUplink();
  AppendSnapshot();
  AppendMessages(1, 500);
  AppendDelta();
  ASSERT_TRUE(server_.WaitUntil([&](const auto& s) { return s.graph_version == version_; }));
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.heartbeats > 5; }));
  const auto bytes_received = [](const FakePolicyServer& s) {
    uint64_t bytes = 0;
    for (const auto& batch : s.batches) {
      if (batch.lane() == MESSAGES) bytes += batch.ByteSizeLong();
    }
    return bytes;
  };
  EXPECT_TRUE(server_.WaitUntil(
      [&](const auto& s) { return bytes_received(s) <= 2'000 && bytes_received(s) > 1'500; }));
  rips::v1::SensorReply credit;
  credit.mutable_credit()->set_message_bytes(1 << 20);
  server_.Send(credit);
  EXPECT_TRUE(WaitForMessages(500));
}

TEST_F(UplinkTest, FullOutboxShedsWithALossAndNeverControl) {
  server_.Start();
  server_.Stop();
  StartUplink({.message_bytes = 100 * CostOf(MessageSeen{})});
  AppendSnapshot();
  for (int i = 0; i < 20; ++i) AppendDelta();
  AppendMessages(1, 1'000);
  server_.Start();
  const auto lost = [](const FakePolicyServer& s) {
    uint64_t count = 0;
    for (const Recorded& each : s.Distinct(CONTROL)) {
      if (each.what.loss().cause() == rips::v1::Loss::OUTBOX_SHED) {
        count += each.what.loss().count();
        EXPECT_EQ(each.topic, "/chatter");
      }
    }
    return count;
  };
  EXPECT_TRUE(server_.WaitUntil([&](const auto& s) {
    return s.Distinct(MESSAGES).size() + lost(s) == 1'000 && lost(s) > 800;
  })) << "taken = judged + counted as lost";
  EXPECT_TRUE(server_.WaitUntil([&](const auto& s) { return s.graph_version == version_; }));
  EXPECT_TRUE(server_.WaitUntil([](const auto& s) {
    for (const Recorded& each : s.Distinct(CONTROL)) {
      if (each.what.state().overloaded()) return true;
    }
    return false;
  }));
}

TEST_F(UplinkTest, SaysWhichInputsItDoesNotSee) {
  server_.Start();
  const auto last_state = [](const FakePolicyServer& s) {
    std::vector<std::string> blind;
    for (const Recorded& each : s.Distinct(CONTROL)) {
      if (!each.what.has_state()) continue;
      blind.assign(each.what.state().blind().begin(), each.what.state().blind().end());
    }
    return blind;
  };
  StartUplink();
  AppendSnapshot();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.graph_version == 1; }));
  EXPECT_TRUE(server_.WaitUntil([](const auto& s) { return s.hellos[0].blind().empty(); }));
  EXPECT_THAT(metrics_.Text(), HasSubstr("rips_sensor_blind_reasons 0")) << "from the start";
  uplink_->SetBlind("wire", {"no tap"});
  uplink_->SetBlind("ids", {"log 1: gone\x1b[2J", "log 2: gone"});
  EXPECT_TRUE(server_.WaitUntil([&](const auto& s) {
    return testing::Matches(ElementsAre("log 1: gone\\x1b[2J", "log 2: gone", "no tap"))(
        last_state(s));
  }));
  EXPECT_THAT(metrics_.Text(), HasSubstr("rips_sensor_blind_reasons 3"));
  uplink_->SetBlind("ids", {});
  EXPECT_TRUE(server_.WaitUntil(
      [&](const auto& s) { return last_state(s) == std::vector<std::string>{"no tap"}; }));
  server_.Stop();
  server_.Start();
  ASSERT_TRUE(WaitForStreams(2));
  EXPECT_TRUE(server_.WaitUntil([](const auto& s) {
    return testing::Matches(ElementsAre("no tap"))(s.hellos.back().blind());
  })) << "a new stream begins with what stands";
  uplink_->SetBlind("wire", {});
  EXPECT_TRUE(server_.WaitUntil([&](const auto& s) { return last_state(s).empty(); }));
}

TEST_F(UplinkTest, AcknowledgementOfTheFutureReopensTheStream) {
  server_.Start();
  StartUplink();
  AppendSnapshot();
  AppendMessages(1, 3);
  ASSERT_TRUE(WaitForMessages(3));
  rips::v1::SensorReply ack;
  ack.mutable_ack()->set_incarnation(uplink_->incarnation());
  ack.mutable_ack()->set_lane(MESSAGES);
  ack.mutable_ack()->set_durable_sequence(4);
  server_.Send(ack);
  ASSERT_TRUE(WaitForStreams(2));
  AppendMessages(4, 5);
  ASSERT_TRUE(WaitForMessages(5));
  uplink_->Stop();
  ExpectMessages(5);
}

TEST_F(UplinkTest, StreamWithoutNumbersForNamesIsReopened) {
  // On a busy machine nothing is set aside: one batch of it has more names than these streams.
  live_ = absl::Minutes(5);
  server_.Start();
  StartUplink({}, {.names = 10});
  AppendSnapshot();
  Observations seen;
  for (uint32_t i = 1; i <= 20; ++i) {
    seen.messages.push_back({.boottime_ns = clock_.Now().boottime_ns,
                             .source = Source(absl::StrCat("/t", i)),
                             .size_bytes = i});
  }
  uplink_->Append(std::move(seen));
  ASSERT_TRUE(WaitForMessages(20));
  uplink_->Stop();
  ExpectMessages(20);
  EXPECT_GT(server_.hellos.size(), 3u);
}

TEST_F(UplinkTest, SecondarySensorSendsNeitherGraphNorMessages) {
  server_.Start();
  server_.Set([](auto& b) { b.primary = false; });
  StartUplink();
  AppendSnapshot();
  AppendMessages(1, 3);
  uplink_->Append({.signals = {"SIGUSR1", "SIGUSR1"}});
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return !s.Distinct(CONTROL).empty(); }));
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.heartbeats > 3; }));
  uplink_->Stop();
  ASSERT_THAT(server_.received, SizeIs(1));
  EXPECT_EQ(server_.received[0].what.signal().name(), "SIGUSR1");
  EXPECT_EQ(server_.received[0].what.signal().count(), 2);
}

TEST_F(UplinkTest, OwnParticipantsAreHandedOn) {
  ros2::Guid guid;
  guid.bytes[3] = 4;
  server_.Start();
  server_.Set([&](auto& b) { b.own_participants = {guid.ToBytes(), "short"}; });
  StartUplink();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.heartbeats > 2; }));
  uplink_->Stop();
  MutexLock lock(&mu_);
  EXPECT_THAT(own_, ElementsAre(guid));
}

TEST_F(UplinkTest, AnInterestIsHandedOnAndAnsweredOnceItIsInUse) {
  server_.Start();
  StartUplink();
  AppendSnapshot();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  {
    MutexLock lock(&mu_);
    slow_ = true;
  }
  SendInterest('a', "^/a$", 10);
  SendInterest('a', "^/a$", 10);
  ASSERT_TRUE(server_.WaitUntil([&](const auto&) {
    MutexLock lock(&mu_);
    return !interests_.empty();
  }));
  uplink_->InterestInUse(IdOf('a'));
  ASSERT_TRUE(WaitForAnswers(1));
  SendInterest('a', "^/a$", 10);
  ASSERT_TRUE(WaitForAnswers(2)) << "told again: in use already";
  uplink_->Stop();
  for (const auto& answer : server_.interests_applied) {
    EXPECT_EQ(answer.interest(), IdOf('a'));
    EXPECT_EQ(answer.problem(), "");
  }
  EXPECT_EQ(server_.hellos[0].interest_in_use(), "");
  MutexLock lock(&mu_);
  ASSERT_THAT(interests_, SizeIs(1)) << "the same is not handed on again";
  EXPECT_EQ(interests_[0]->Of("/a", "a/msg/A").payload_bytes, 10u);
  EXPECT_EQ(interests_[0]->Of("/b", "a/msg/A").payload_bytes, 0u);
}

TEST_F(UplinkTest, AnInterestThatMakesNoSenseIsRefusedAndTheOneBeforeStays) {
  server_.Start();
  StartUplink();
  AppendSnapshot();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  SendInterest('a', "^/a$", 10);
  SendInterest('b', "(", 10);
  SendInterest('c', "x", 10, rips::v1::InterestRule::DEPTH_UNSPECIFIED);
  SendInterest('d', "x", 10, static_cast<rips::v1::InterestRule::Depth>(9));
  rips::v1::SensorReply unnamed;
  unnamed.mutable_interest()->set_id("short");
  server_.Send(unnamed);
  ASSERT_TRUE(WaitForAnswers(5));
  AppendMessages(1, 3);
  EXPECT_TRUE(WaitForMessages(3)) << "the stream goes on";
  EXPECT_THAT(server_.hellos, SizeIs(1));
  StopServer();
  server_.Start();
  ASSERT_TRUE(WaitForStreams(2));
  uplink_->Stop();

  const auto& answers = server_.interests_applied;
  EXPECT_EQ(answers[0].problem(), "");
  EXPECT_EQ(answers[1].interest(), IdOf('b'));
  EXPECT_THAT(answers[1].problem(), HasSubstr("rule 1: bad pattern: RE2 error 6"));
  EXPECT_THAT(answers[2].problem(), HasSubstr("rule 1: depth 0 is not known"));
  EXPECT_THAT(answers[3].problem(), HasSubstr("rule 1: depth 9 is not known"));
  EXPECT_THAT(answers[4].problem(), HasSubstr("5 bytes, not 32"));
  EXPECT_EQ(server_.hellos[1].interest_in_use(), IdOf('a')) << "it outlives the stream";
  MutexLock lock(&mu_);
  EXPECT_THAT(interests_, SizeIs(1));
}

TEST_F(UplinkTest, AnInterestThatComesIntoUseWithoutAStreamIsInTheNextHello) {
  server_.Start();
  StartUplink();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.heartbeats > 0; }));
  StopServer();
  uplink_->InterestInUse(IdOf('a'));
  server_.Start();
  ASSERT_TRUE(WaitForStreams(2));
  uplink_->Stop();
  EXPECT_EQ(server_.hellos[1].interest_in_use(), IdOf('a'));
  EXPECT_THAT(server_.interests_applied, IsEmpty());
}

TEST_F(UplinkTest, PayloadsComeWithTheirMessagesWithinTheCredit) {
  server_.Start();
  StartUplink();
  AppendSnapshot();
  // 1 MiB of credit: the sixteenth does not fit.
  for (int i = 0; i < 20; ++i) AppendPayload(70'000, 64 * 1024);
  ASSERT_TRUE(WaitForMessages(15));
  rips::v1::SensorReply credit;
  credit.mutable_credit()->set_message_bytes(2 << 20);
  server_.Send(credit);
  ASSERT_TRUE(WaitForMessages(20));
  AppendPayload(3, 3);
  ASSERT_TRUE(WaitForMessages(21));
  uplink_->Stop();
  const std::vector<Recorded> distinct = server_.Distinct(MESSAGES);
  EXPECT_EQ(distinct[19].what.message().payload().size(), 64u * 1024);
  EXPECT_TRUE(distinct[19].what.message().truncated());
  EXPECT_EQ(distinct[20].what.message().payload(), "xxx");
  EXPECT_FALSE(distinct[20].what.message().truncated());
}

TEST_F(UplinkTest, AFullOutboxShedsPayloadsFirstAndCountsThem) {
  backlog_bytes_ = 0;  // nothing can be set aside
  server_.Start();
  server_.Stop();
  StartUplink({.message_bytes = 100'000});
  AppendSnapshot();
  for (uint32_t i = 1; i <= 50; ++i) AppendPayload(10'000 + i, 10'000);
  server_.Start();
  ASSERT_TRUE(WaitForMessages(50)) << "none is lost";
  const Counter shed = metrics_.AddCounter(
      "rips_sensor_payloads_shed_total",
      "Payloads that were asked for and not kept; their messages were, as metadata");
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    size_t without = 0;
    for (const Recorded& each : s.Distinct(MESSAGES)) {
      without += each.what.message().payload().empty();
    }
    return without == shed.Value() && without >= 41;
  }));
  EXPECT_TRUE(server_.WaitUntil([](const auto& s) {
    for (const Recorded& each : s.Distinct(CONTROL)) {
      if (each.what.state().overloaded()) return true;
    }
    return false;
  })) << "shedding is overload";
  uplink_->Stop();
  for (const Recorded& each : server_.Distinct(CONTROL)) EXPECT_FALSE(each.what.has_loss());
}

TEST_F(UplinkTest, ABusyLineSendsBatchesNotSingleMessages) {
  server_.Start();
  StartUplink();
  AppendSnapshot();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  for (uint32_t i = 1; i <= 400; ++i) {
    AppendMessages(i, i);
    if (i % 20 == 0) absl::SleepFor(absl::Milliseconds(1));  // a pace, not a wait for something
  }
  ASSERT_TRUE(WaitForMessages(400));
  uplink_->Stop();
  ExpectMessages(400);
  for (const auto& batch : server_.batches) {
    EXPECT_THAT(batch.observations_size(), Le(16)) << "what the server set";
  }
}

}  // namespace
}  // namespace rips::sensor

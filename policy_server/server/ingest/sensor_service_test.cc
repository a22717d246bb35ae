// What a sensor is asked to watch, over real gRPC: sent once, not again if it is in use, and heard
// if it cannot be.
#include "policy_server/server/ingest/sensor_service.h"

#include <chrono>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/ids.h"
#include "services/base/status_matchers.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/real_clock.h"

namespace rips::ingest {
namespace {

using rips::v1::SensorMessage;
using rips::v1::SensorReply;

using ::testing::HasSubstr;

constexpr char kRules[] = R"(
levels: DEFAULT;
rules Msg:
  r: topicin("/image", "/map") && payload("bad.yar") ? alert("bad");
)";

struct Sensor {
  explicit Sensor(const std::shared_ptr<grpc::Channel>& channel)
      : stub(rips::v1::SensorService::NewStub(channel)) {
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
    stream = stub->Observe(&context);
  }
  void Hello(const std::string& in_use = "", const std::string& version = "") {
    SensorMessage message;
    auto* hello = message.mutable_hello()->mutable_hello();
    hello->set_protocol(1);
    hello->set_incarnation(std::string(16, 'i'));
    hello->set_host("base");
    hello->set_version(version);
    hello->mutable_clock()->set_boottime_ns(static_cast<uint64_t>(BoottimeNow()));
    message.mutable_hello()->set_interest_in_use(in_use);
    *hello->mutable_configuration() = configuration;
    stream->Write(message);
  }
  // The server has answered the hello: it has sent the configuration.
  bool Greeted() {
    SensorReply reply;
    if (!stream->Read(&reply) || !reply.has_config()) return false;
    config = reply.config();
    return true;
  }
  // Until the control lane is acknowledged up to there; 0 = the stream ended before.
  uint64_t CommitOfAcknowledgement(uint64_t sequence) {
    SensorReply reply;
    while (stream->Read(&reply)) {
      if (reply.ack().durable_sequence() >= sequence) return reply.ack().commit();
    }
    return 0;
  }
  void Answer(const std::string& problem) {
    SensorMessage message;
    message.mutable_interest_applied()->set_interest("whatever");
    message.mutable_interest_applied()->set_problem(problem);
    stream->Write(message);
  }
  // Interests that have come when the server answers a heartbeat of now.
  std::vector<rips::v1::Interest> InterestsUntilNow() {
    const auto now_ns = static_cast<uint64_t>(BoottimeNow());
    SensorMessage heartbeat;
    heartbeat.mutable_heartbeat()->mutable_clock()->set_boottime_ns(now_ns);
    EXPECT_TRUE(stream->Write(heartbeat));
    std::vector<rips::v1::Interest> interests;
    SensorReply reply;
    while (stream->Read(&reply)) {
      if (reply.has_interest()) interests.push_back(reply.interest());
      if (reply.heartbeat().echo_boottime_ns() == now_ns) return interests;
    }
    ADD_FAILURE() << "the stream ended: " << stream->Finish().error_message();
    return interests;
  }
  void Snapshot() {
    SensorMessage message;
    rips::v1::ObservationBatch* batch = message.mutable_batch();
    batch->set_incarnation(std::string(16, 'i'));
    batch->set_first_sequence(1);
    batch->set_lane(rips::v1::CONTROL);
    batch->add_observations()->mutable_snapshot()->set_graph_version(1);
    batch->mutable_observations(0)->mutable_snapshot()->set_settled(true);
    stream->Write(message);
  }
  void Chunk(uint64_t id, size_t offset, size_t bytes) {
    SensorMessage message;
    message.mutable_chunk()->set_chunked_payload_id(id);
    message.mutable_chunk()->set_offset(static_cast<uint32_t>(offset));
    message.mutable_chunk()->set_data(std::string(bytes, 'x'));
    stream->Write(message);
  }
  // Payload bytes granted, once there are some.
  uint64_t AwaitPayloadCredit() {
    SensorReply reply;
    while (stream->Read(&reply)) {
      if (reply.credit().payload_bytes() > 0) return reply.credit().payload_bytes();
    }
    return 0;
  }
  // How the server ended the stream.
  grpc::Status Ended() {
    SensorReply reply;
    while (stream->Read(&reply)) {
    }
    return stream->Finish();
  }
  void End() {
    context.TryCancel();
    EXPECT_EQ(Ended().error_code(), grpc::StatusCode::CANCELLED);
  }

  std::unique_ptr<rips::v1::SensorService::Stub> stub;
  grpc::ClientContext context;
  std::unique_ptr<grpc::ClientReaderWriter<SensorMessage, SensorReply>> stream;
  rips::v1::SensorConfig config;
  rips::v1::Configuration configuration;  // of the hello
};

class SensorServiceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    lang::CompileResult compiled = lang::Compile({{.path = "test.rul", .text = kRules}});
    ASSERT_TRUE(compiled.rules);
    auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules));
    ASSERT_THAT(program, IsOk());
    ASSERT_THAT(pipeline_.Add({.id = "r1", .sensor_hosts = {"base"}, .primary_sensor = "base"},
                              {.program = *program, .bundle_id = "sha256:0"}, {}, {}, 1,
                              {.recorder = &recorder_, .audience = &audience_, .new_id = NewId}),
                IsOk());
    pipeline_.Start();
    const auto server_ids = rpc::Credentials::Load(pki_.Server());
    const auto sensor_ids = rpc::Credentials::Load(pki_.Sensor());
    ASSERT_THAT(server_ids, IsOk());
    ASSERT_THAT(sensor_ids, IsOk());
    auto server = rpc::RpcServer::Start(
        {.listen = "127.0.0.1:0", .credentials = (*server_ids)->ForServer()}, {&service_});
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
    channel_ = rpc::MakeChannel(server_->address(), (*sensor_ids)->ForClient());
  }
  void TearDown() override {
    server_.reset();
    pipeline_.Stop();
  }

  // A sensor that was greeted. While the server has not noticed the end of the stream before, it
  // refuses a second one.
  std::unique_ptr<Sensor> Connect(const std::string& in_use = "") {
    const int64_t deadline_ns = BoottimeAfter(absl::Seconds(60));
    while (BoottimeNow() < deadline_ns) {
      auto sensor = std::make_unique<Sensor>(channel_);
      sensor->Hello(in_use);
      if (sensor->Greeted()) return sensor;
      EXPECT_EQ(sensor->stream->Finish().error_code(), grpc::StatusCode::ALREADY_EXISTS);
    }
    ADD_FAILURE() << "no sensor was greeted";
    return nullptr;
  }

  rpc::TestPki pki_;
  RealClock clock_;
  Metrics metrics_;
  Counter refused_ = metrics_.AddCounter("interests_refused_total", "Interests refused.");
  pipeline::FakeRecorder recorder_;
  pipeline::FakeObserver audience_;
  pipeline::Pipeline pipeline_{1, &clock_};
  rpc::SessionWatch watch_{&clock_};
  pipeline::AgentContacts contacts_{&clock_};
  Counter malformed_ = metrics_.AddCounter("malformed_total", "Refused as malformed.");
  SensorService service_{&pipeline_,
                         &watch_,
                         {.malformed = malformed_,
                          .interests_refused = refused_,
                          .fields_refused = wire_limits::LimitCounters(&metrics_)},
                         &contacts_};
  std::unique_ptr<rpc::RpcServer> server_;
  std::shared_ptr<grpc::Channel> channel_;
};

TEST_F(SensorServiceTest, ASensorIsAskedForThePayloadsThatRulesNeedUnlessItKnows) {
  const auto sensor = Connect();
  ASSERT_NE(sensor, nullptr);
  const std::vector<rips::v1::Interest> asked = sensor->InterestsUntilNow();
  ASSERT_EQ(asked.size(), 1u);
  EXPECT_EQ(asked[0].id().size(), 32u);
  ASSERT_EQ(asked[0].rules_size(), 3);
  EXPECT_EQ(asked[0].rules(0).topic_regex(), "^\\/image$");
  EXPECT_EQ(asked[0].rules(0).depth(), rips::v1::InterestRule::PAYLOAD);
  EXPECT_EQ(asked[0].rules(1).topic_regex(), "^\\/map$");
  EXPECT_EQ(asked[0].rules(2).depth(), rips::v1::InterestRule::NOTHING);
  sensor->End();

  const auto again = Connect(asked[0].id());
  ASSERT_NE(again, nullptr);
  EXPECT_TRUE(again->InterestsUntilNow().empty()) << "it is in use";
  again->End();

  const auto other = Connect(std::string(31, 'x'));
  ASSERT_NE(other, nullptr);
  EXPECT_EQ(other->InterestsUntilNow().size(), 1u) << "no interest of ours";
  other->End();
}

TEST_F(SensorServiceTest, AStreamIsReadOneMessageAtATimeUntilItsRobotAdmitsIt) {
  BoundedQueue<int> admit{{.capacity = 1}};
  ASSERT_THAT(pipeline_.Post("r1", pipeline::Lane::kControl,
                             [&](pipeline::Robot&) { admit.Pop(absl::Seconds(60)); }),
              IsOk());
  Sensor sensor(channel_);
  sensor.Hello();
  for (int i = 0; i < 200; ++i) {
    SensorMessage heartbeat;
    heartbeat.mutable_heartbeat()->mutable_clock()->set_boottime_ns(
        static_cast<uint64_t>(BoottimeNow()));
    ASSERT_TRUE(sensor.stream->Write(heartbeat));
  }
  absl::SleepFor(absl::Milliseconds(700));
  const auto waiting = pipeline_.waiting().at("r1");
  EXPECT_GE(waiting[static_cast<size_t>(pipeline::Queue::kControl)], 1u) << "its hello";
  EXPECT_LE(waiting[static_cast<size_t>(pipeline::Queue::kControl)], 4u);
  admit.Push(1);
  ASSERT_TRUE(sensor.Greeted());
  EXPECT_EQ(sensor.InterestsUntilNow().size(), 1u) << "all that came before is read";
  sensor.End();
}

TEST_F(SensorServiceTest, ASensorIsToldWhatTheStoreHoldsInAnswerAndWithAcknowledgements) {
  const auto sensor = Connect();
  ASSERT_NE(sensor, nullptr);
  EXPECT_EQ(sensor->config.store().generation(), std::string(16, 'g'));
  sensor->Snapshot();
  EXPECT_GT(sensor->CommitOfAcknowledgement(1), sensor->config.store().commit());
  sensor->End();
}

TEST_F(SensorServiceTest, AnInterestThatASensorCannotApplyIsCountedAndTheStreamGoesOn) {
  const auto sensor = Connect();
  ASSERT_NE(sensor, nullptr);
  sensor->Answer("");
  sensor->Answer("rule 1: bad pattern\x1b[2J\n" + std::string(900, 'x'));
  sensor->Answer("rule 2");
  EXPECT_EQ(sensor->InterestsUntilNow().size(), 1u);
  EXPECT_EQ(refused_.Value(), 2);
  sensor->End();
}

TEST_F(SensorServiceTest, ChunksWithoutCreditEndTheStream) {
  const auto early = Connect();
  ASSERT_NE(early, nullptr);
  early->Chunk(1, 0, 1);
  const grpc::Status before_the_graph = early->Ended();
  EXPECT_EQ(before_the_graph.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(before_the_graph.error_message(), "1 bytes of payloads exceed the credit of 0");
  EXPECT_EQ(malformed_.Value(), 1);

  // Payloads that no batch names: their bytes are never granted again.
  const auto hoarder = Connect();
  ASSERT_NE(hoarder, nullptr);
  hoarder->Snapshot();
  const uint64_t credit = hoarder->AwaitPayloadCredit();
  ASSERT_EQ(credit, 8u << 20);
  for (uint64_t sent = 0; sent <= credit; sent += 65'536) {
    hoarder->Chunk(sent / (4 << 20) + 1, sent % (4 << 20), 65'536);
  }
  const grpc::Status too_much = hoarder->Ended();
  EXPECT_EQ(too_much.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(too_much.error_message(), "8454144 bytes of payloads exceed the credit of 8388608");
  EXPECT_EQ(malformed_.Value(), 2);
}

TEST_F(SensorServiceTest, AMalformedChunkEndsTheStreamAndIsCounted) {
  const auto sensor = Connect();
  ASSERT_NE(sensor, nullptr);
  sensor->Snapshot();
  ASSERT_GT(sensor->AwaitPayloadCredit(), 0u);
  sensor->Chunk(1, 0, 65'536);
  sensor->Chunk(1, 65'535, 10);
  const grpc::Status status = sensor->Ended();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(status.error_message(), "payload 1: chunk at offset 65535; 65536 bytes came before it");
  EXPECT_EQ(malformed_.Value(), 1);
}

TEST_F(SensorServiceTest, AFieldPastItsLimitEndsTheStreamIsCountedAndTold) {
  const auto sensor = Connect();
  ASSERT_NE(sensor, nullptr);
  sensor->Answer(std::string(1'025, 'S'));
  const grpc::Status status = sensor->Ended();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(status.error_message(), "InterestApplied.problem has 1025 bytes; at most 1024");
  EXPECT_EQ(malformed_.Value(), 1);
  EXPECT_EQ(refused_.Value(), 0) << "nothing of the message was used";
  EXPECT_THAT(metrics_.Text(),
              HasSubstr("rips_fields_refused_total{field=\"InterestApplied.problem\"} 1"));
  const auto told = [this] {
    BoundedQueue<int> done{{.capacity = 1}};
    int count = 0;
    EXPECT_THAT(pipeline_.Post("r1", pipeline::Lane::kControl,
                               [&](pipeline::Robot&) {
                                 count = audience_.Count(
                                     "sent a message past a limit: InterestApplied.problem has "
                                     "1025 bytes; at most 1024");
                                 done.Push(1);
                               }),
                IsOk());
    done.Pop(absl::Seconds(60));
    return count;
  };
  EXPECT_EQ(told(), 1);
}

TEST_F(SensorServiceTest, AMessageThatWouldTakeTooMuchMemoryIsNotParsed) {
  const auto sensor = Connect();
  ASSERT_NE(sensor, nullptr);
  SensorMessage message;
  for (int i = 0; i < 1'000'000; ++i) message.mutable_batch()->add_observations();
  sensor->stream->Write(message);
  const grpc::Status status = sensor->Ended();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(status.error_message(),
            "a message of 2000004 bytes takes more than 64 MiB once it is parsed");
  EXPECT_EQ(malformed_.Value(), 1);
  EXPECT_THAT(metrics_.Text(), HasSubstr("rips_fields_refused_total{field=\"(parsed size)\"} 1"));
}

TEST_F(SensorServiceTest, AVersionAndTheLastContactOutliveTheStream) {
  contacts_.SetListed({{"r1", pipeline::AgentKind::kSensor, "base"}});
  Sensor sensor(channel_);
  sensor.Hello("", "9.9\x1b[2J\n");
  ASSERT_TRUE(sensor.Greeted());
  const int64_t sent_ns = BoottimeNow();
  sensor.InterestsUntilNow();
  sensor.End();
  const pipeline::AgentContacts::Contact contact = contacts_.Of("r1")[0];
  EXPECT_EQ(contact.version, "9.9\x1b[2J\n") << "as it said; who shows it escapes it";
  EXPECT_LE(contact.heard_ago_ns, BoottimeNow() - sent_ns) << "the heartbeat counts, too";
}

TEST_F(SensorServiceTest, KeepsOfAConfigurationWhatItsLimitsAllow) {
  contacts_.SetListed({{"r1", pipeline::AgentKind::kSensor, "base"}});
  Sensor sensor(channel_);
  for (int i = 0; i < 100; ++i) {
    sensor.configuration.add_settings()->set_value(std::string(1'000, 'v'));
  }
  sensor.configuration.set_left_out(7);
  sensor.Hello();
  ASSERT_TRUE(sensor.Greeted());
  const auto found = contacts_.ConfigurationsOf("r1");
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].configuration.settings_size(), 16);
  EXPECT_EQ(found[0].configuration.left_out(), 84u + 7u);
  sensor.End();
  Sensor wrong(channel_);
  wrong.configuration.add_settings()->set_path(std::string(257, 'p'));
  wrong.Hello();
  EXPECT_EQ(wrong.Ended().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
}

TEST_F(SensorServiceTest, WhatARefusedAgentSaysIsNoContact) {
  contacts_.SetListed({{"r1", pipeline::AgentKind::kSensor, "base"}});
  const auto sensor = Connect();
  ASSERT_NE(sensor, nullptr);
  const std::string version = contacts_.Of("r1")[0].version;
  Sensor second(channel_);
  second.Hello("", "of another");
  EXPECT_EQ(second.Ended().error_code(), grpc::StatusCode::ALREADY_EXISTS);
  EXPECT_EQ(contacts_.Of("r1")[0].version, version);
  sensor->End();
}

TEST_F(SensorServiceTest, AHugeOrMalformedVersionEndsTheStreamAndIsNotKept) {
  contacts_.SetListed({{"r1", pipeline::AgentKind::kSensor, "base"}});
  Sensor huge(channel_);
  huge.Hello("", std::string(129, 'v'));
  EXPECT_EQ(huge.Ended().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  Sensor malformed(channel_);
  malformed.Hello("", "\xff\xfe");
  // gRPC cannot decode it, which the service sees as the end of the stream.
  EXPECT_EQ(malformed.Ended().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  // The service counts it when the stream is over, which its peer may know before.
  const int64_t deadline_ns = BoottimeAfter(absl::Seconds(60));
  while (malformed_.Value() < 2 && BoottimeNow() < deadline_ns) std::this_thread::yield();
  EXPECT_EQ(malformed_.Value(), 2);
  EXPECT_EQ(contacts_.Of("r1")[0].version, "");
  EXPECT_EQ(contacts_.Of("r1")[0].heard_unix_ns, 0);
}

// Those that came before the peer heard that it is refused are not looked at.
TEST_F(SensorServiceTest, OneRefusalIsToldOnceHoweverMuchFollows) {
  const auto sensor = Connect();
  ASSERT_NE(sensor, nullptr);
  for (int i = 0; i < 50; ++i) sensor->Answer(std::string(100'000, 'S'));
  EXPECT_EQ(sensor->Ended().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(malformed_.Value(), 1);
}

}  // namespace
}  // namespace rips::ingest

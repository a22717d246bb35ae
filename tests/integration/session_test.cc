// How long the policy server keeps agents' streams: real gRPC and certificates, a stepped clock.
#include <atomic>
#include <memory>
#include <string>
#include <thread>

#include "absl/strings/string_view.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/dispatch/actuator_service.h"
#include "policy_server/server/ingest/sensor_service.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/fake_clock.h"
#include "services/base/ids.h"
#include "services/base/status_matchers.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/session_watch.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"

namespace rips {
namespace {

constexpr char kIncarnation[] = "0123456789abcdef";
constexpr int64_t kHelloNs = 5 * kNanosPerSecond;

size_t CountOf(absl::string_view words, absl::string_view text) {
  size_t count = 0;
  for (size_t at = text.find(words); at != text.npos; at = text.find(words, at + 1)) ++count;
  return count;
}

// One agent's stream, as far as the test drives it.
template <typename Service, typename In, typename Out>
struct Agent {
  explicit Agent(const std::shared_ptr<grpc::Channel>& channel) : stub(Service::NewStub(channel)) {
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
  }
  void Hello() {
    Out message;
    auto* hello = message.mutable_hello()->mutable_hello();
    hello->set_protocol(1);
    hello->set_incarnation(kIncarnation);
    hello->set_host("base");
    hello->mutable_clock()->set_boottime_ns(static_cast<uint64_t>(RealClock().Now().boottime_ns));
    Fill(*message.mutable_hello());
    stream->Write(message);
  }
  static void Fill(v1::SensorHello&) {}
  static void Fill(v1::ActuatorHello& hello) {
    for (const char* level : {"DEFAULT", "ALERT", "COMPROMISED", "HALT"}) hello.add_levels(level);
    hello.set_effective_level("DEFAULT");
  }
  // The server has answered the hello.
  bool Answered() {
    In reply;
    return stream->Read(&reply);
  }
  grpc::Status End() {
    while (Answered()) {
    }
    return stream->Finish();
  }

  std::unique_ptr<typename Service::Stub> stub;
  grpc::ClientContext context;
  std::unique_ptr<grpc::ClientReaderWriter<Out, In>> stream;
};

struct Sensor : Agent<v1::SensorService, v1::SensorReply, v1::SensorMessage> {
  explicit Sensor(const std::shared_ptr<grpc::Channel>& channel) : Agent(channel) {
    stream = stub->Observe(&context);
  }
  // The stream is in use both ways.
  bool Lives() {
    const auto now_ns = static_cast<uint64_t>(RealClock().Now().boottime_ns);
    v1::SensorMessage heartbeat;
    heartbeat.mutable_heartbeat()->mutable_clock()->set_boottime_ns(now_ns);
    if (!stream->Write(heartbeat)) return false;
    v1::SensorReply reply;
    while (stream->Read(&reply)) {
      if (reply.heartbeat().echo_boottime_ns() == now_ns) return true;
    }
    return false;
  }
};
struct Actuator : Agent<v1::ActuatorService, v1::ActuatorReply, v1::ActuatorMessage> {
  explicit Actuator(const std::shared_ptr<grpc::Channel>& channel) : Agent(channel) {
    stream = stub->Attach(&context);
  }
};

class SessionTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    pki_ = new rpc::TestPki();
    server_ids_ = new auto(*rpc::Credentials::Load(pki_->Server()));
    sensor_ids_ = new auto(*rpc::Credentials::Load(pki_->Sensor()));
    actuator_ids_ = new auto(*rpc::Credentials::Load(pki_->Actuator()));
  }
  static void TearDownTestSuite() {
    delete actuator_ids_;
    delete sensor_ids_;
    delete server_ids_;
    delete pki_;
  }

  void SetUp() override {
    // Certificates are of today.
    watch_clock_.JumpUnix(absl::ToUnixNanos(absl::Now()) - watch_clock_.Now().unix_ns);
    lang::CompileResult compiled =
        lang::Compile({{.path = "test.rul", .text = pipeline::kPaperRules}});
    ASSERT_TRUE(compiled.rules);
    auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules));
    ASSERT_THAT(program, IsOk());
    ASSERT_THAT(
        pipeline_.Add({.id = "r1",
                       .sensor_hosts = {"base"},
                       .primary_sensor = "base",
                       .actuator_hosts = {"base"}},
                      {.program = *program, .bundle_id = "sha256:0"}, {}, {}, 1,
                      {.recorder = &recorder_,
                       .audience = &audience_,
                       .counts = {.sessions_refused = [this](uint64_t by) { second_ += by; }},
                       .new_id = NewId}),
        IsOk());
    // Its clock jumps.
    watch_.set_silence(absl::InfiniteDuration());
    pipeline_.Start();
    auto server =
        rpc::RpcServer::Start({.listen = "127.0.0.1:0", .credentials = (*server_ids_)->ForServer()},
                              {&sensors_, &actuators_});
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
  }
  void TearDown() override {
    server_.reset();
    pipeline_.Stop();
  }

  std::shared_ptr<grpc::Channel> Connect(const std::shared_ptr<const rpc::Credentials>* ids) {
    return rpc::MakeChannel(server_->address(), (*ids)->ForClient());
  }
  // Until the server has opened as many streams in all; a stream without hello is not answered.
  void WaitForStreams(double count) const {
    const int64_t deadline_ns = BoottimeAfter(absl::Seconds(60));
    while (opened_.Value() < count && BoottimeNow() < deadline_ns) std::this_thread::yield();
    ASSERT_EQ(opened_.Value(), count);
  }

  static rpc::TestPki* pki_;
  static std::shared_ptr<const rpc::Credentials>* server_ids_;
  static std::shared_ptr<const rpc::Credentials>* sensor_ids_;
  static std::shared_ptr<const rpc::Credentials>* actuator_ids_;
  RealClock clock_;
  FakeClock watch_clock_;
  Metrics metrics_;
  Counter opened_ = metrics_.AddCounter("opened_total", "Streams of both kinds.");
  std::atomic<uint64_t> second_ = 0;
  pipeline::FakeRecorder recorder_;
  pipeline::FakeObserver audience_;
  pipeline::Pipeline pipeline_{1, &clock_};
  rpc::SessionWatch watch_{&watch_clock_, absl::InfiniteDuration()};
  ingest::SensorService sensors_{&pipeline_, &watch_, {.streams = opened_}};
  dispatch::ActuatorService actuators_{&pipeline_, &watch_, {.streams = opened_}};
  std::unique_ptr<rpc::RpcServer> server_;
};
rpc::TestPki* SessionTest::pki_ = nullptr;
std::shared_ptr<const rpc::Credentials>* SessionTest::server_ids_ = nullptr;
std::shared_ptr<const rpc::Credentials>* SessionTest::sensor_ids_ = nullptr;
std::shared_ptr<const rpc::Credentials>* SessionTest::actuator_ids_ = nullptr;

TEST_F(SessionTest, StreamsThatNeverSayHelloAreClosedAndOthersStay) {
  Sensor silent_sensor(Connect(sensor_ids_));
  Actuator silent_actuator(Connect(actuator_ids_));
  Sensor sensor(Connect(sensor_ids_));
  Actuator actuator(Connect(actuator_ids_));
  sensor.Hello();
  actuator.Hello();
  ASSERT_TRUE(sensor.Answered());
  ASSERT_TRUE(actuator.Answered());
  ASSERT_NO_FATAL_FAILURE(WaitForStreams(4));

  watch_clock_.Advance(kHelloNs + 1);
  watch_.CheckSessions();

  for (const grpc::Status& end : {silent_sensor.End(), silent_actuator.End()}) {
    EXPECT_EQ(end.error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
    EXPECT_EQ(end.error_message(), "no hello within 5s");
  }
  EXPECT_TRUE(sensor.Lives());
}

TEST_F(SessionTest, AStreamWithoutHelloMayStillSayItAtTheLastMoment) {
  Sensor sensor(Connect(sensor_ids_));
  ASSERT_NO_FATAL_FAILURE(WaitForStreams(1));
  watch_clock_.Advance(kHelloNs);
  watch_.CheckSessions();

  sensor.Hello();

  EXPECT_TRUE(sensor.Answered());
}

TEST_F(SessionTest, StreamsAreCutWhenTheirCertificateExpires) {
  Sensor sensor(Connect(sensor_ids_));
  Actuator actuator(Connect(actuator_ids_));
  sensor.Hello();
  actuator.Hello();
  ASSERT_TRUE(sensor.Answered());
  ASSERT_TRUE(actuator.Answered());

  watch_clock_.Advance(absl::ToInt64Nanoseconds(absl::Hours(24 * 29)));  // of 30 days
  watch_.CheckSessions();
  EXPECT_TRUE(sensor.Lives());
  watch_clock_.Advance(absl::ToInt64Nanoseconds(absl::Hours(24 * 2)));
  watch_.CheckSessions();

  for (const grpc::Status& end : {sensor.End(), actuator.End()}) {
    EXPECT_EQ(end.error_code(), grpc::StatusCode::UNAUTHENTICATED);
    EXPECT_EQ(end.error_message(), "the certificate has expired");
  }
}

TEST_F(SessionTest, ASecondLiveSessionIsCountedAndLoggedAsARefusal) {
  ::testing::internal::CaptureStderr();
  Sensor sensor(Connect(sensor_ids_));
  Actuator actuator(Connect(actuator_ids_));
  sensor.Hello();
  actuator.Hello();
  ASSERT_TRUE(sensor.Answered());
  ASSERT_TRUE(actuator.Answered());
  Sensor second_sensor(Connect(sensor_ids_));
  Actuator second_actuator(Connect(actuator_ids_));
  second_sensor.Hello();
  second_actuator.Hello();
  EXPECT_EQ(second_sensor.End().error_code(), grpc::StatusCode::ALREADY_EXISTS);
  EXPECT_EQ(second_actuator.End().error_code(), grpc::StatusCode::ALREADY_EXISTS);
  const std::string log = ::testing::internal::GetCapturedStderr();

  EXPECT_EQ(second_, 2u);
  for (const char* agent : {"sensor", "actuator"}) {
    const std::string name(agent);
    EXPECT_EQ(CountOf(" info " + name + " connected ", log), 1u) << log;
    EXPECT_EQ(CountOf(" warning " + name + " refused ", log), 1u) << log;
    EXPECT_THAT(log, ::testing::ContainsRegex(" warning " + name +
                                              " refused robot=r1 host=base peer=ipv4:127.0.0.1:"
                                              "[0-9]+ reason=\"" +
                                              name + " r1/base has a live session\""));
  }
}

}  // namespace
}  // namespace rips

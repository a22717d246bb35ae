#include "services/rpc/server_stream.h"

#include <memory>
#include <string>

#include "absl/time/clock.h"
#include "gtest/gtest.h"
#include "services/rpc/test_pki.h"
#include "services/rpc/test_service.h"

namespace rips::rpc {
namespace {

using Stream = ServerStream<v1::SensorMessage, v1::SensorReply>;
using Outbound = Stream::Outbound;

// Hands the test the sending half of each stream; answers heartbeats with their own time.
class StreamService final
    : public v1::SensorService::WithRawCallbackMethod_Observe<v1::SensorService::Service> {
 public:
  grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>* Observe(
      grpc::CallbackServerContext*) override {
    return new Echo(this);
  }

  BoundedQueue<std::shared_ptr<Outbound>> opened{{.capacity = 100}};
  BoundedQueue<int> ended{{.capacity = 100}};
  std::atomic<int> messages = 0;
  std::atomic<int> unreadable = 0;
  std::atomic<size_t> bytes_max = SIZE_MAX;  // of a message that is decoded
  std::atomic<bool> refuse = false;          // the first message, once `gate` is closed
  BoundedQueue<int> gate{{.capacity = 1}};
  std::atomic<bool> pause = false;  // after each message
  std::atomic<bool> resumed_meanwhile = false;

 private:
  class Echo final : public Stream {
   public:
    explicit Echo(StreamService* service) : service_(service) {
      service_->opened.Push(outbound());
      Begin();
    }

   private:
    bool OnBytes(size_t bytes, google::protobuf::io::ZeroCopyInputStream&) override {
      return bytes <= service_->bytes_max;
    }
    void OnMessage(v1::SensorMessage& message) override {
      ++service_->messages;
      if (service_->refuse) {
        service_->gate.Pop(kPatience);
        return outbound()->Close(grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "refused"));
      }
      v1::SensorReply reply;
      reply.mutable_heartbeat()->set_echo_boottime_ns(message.heartbeat().clock().boottime_ns());
      outbound()->Send(std::move(reply));
    }
    bool OnRead(int64_t) override { return !service_->pause; }
    bool MayRead() override { return service_->resumed_meanwhile; }
    void OnUnreadable() override { ++service_->unreadable; }
    void OnEnded() override { service_->ended.Push(1); }

    StreamService* service_;
  };
};

// A client that reads only when the test does.
struct Caller {
  explicit Caller(const std::shared_ptr<grpc::Channel>& channel)
      : stub(v1::SensorService::NewStub(channel)) {
    context.set_deadline(std::chrono::system_clock::now() + absl::ToChronoSeconds(2 * kPatience));
    stream = stub->Observe(&context);
  }
  bool Heartbeat(uint64_t boottime_ns) { return stream->Write(TestClient::Heartbeat(boottime_ns)); }
  // Reads to the end.
  grpc::Status End() {
    v1::SensorReply reply;
    while (stream->Read(&reply)) ++replies;
    return stream->Finish();
  }

  std::unique_ptr<v1::SensorService::Stub> stub;
  grpc::ClientContext context;
  std::unique_ptr<grpc::ClientReaderWriter<v1::SensorMessage, v1::SensorReply>> stream;
  size_t replies = 0;
};

class ServerStreamTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    pki_ = new TestPki();
    server_credentials_ = new auto(LoadOrDie(pki_->Server()));
    client_credentials_ = new auto(LoadOrDie(pki_->Sensor()));
  }
  static void TearDownTestSuite() {
    delete client_credentials_;
    delete server_credentials_;
    delete pki_;
  }

  void SetUp() override {
    auto server = RpcServer::Start(
        {.listen = "127.0.0.1:0", .credentials = (*server_credentials_)->ForServer()}, {&service_});
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
  }
  std::shared_ptr<grpc::Channel> Connect() {
    return MakeChannel(server_->address(), (*client_credentials_)->ForClient());
  }
  // Sends 4 KiB at a time until it is refused; how many were taken.
  static size_t Flood(Outbound& outbound) {
    v1::SensorReply reply;
    reply.mutable_ack()->set_incarnation(std::string(4096, 'x'));
    size_t taken = 0;
    while (taken < 3 * OutboundLimits().messages && outbound.Send(reply)) ++taken;
    return taken;
  }

  static TestPki* pki_;
  static std::shared_ptr<const Credentials>* server_credentials_;
  static std::shared_ptr<const Credentials>* client_credentials_;
  StreamService service_;
  std::unique_ptr<RpcServer> server_;
};
TestPki* ServerStreamTest::pki_ = nullptr;
std::shared_ptr<const Credentials>* ServerStreamTest::server_credentials_ = nullptr;
std::shared_ptr<const Credentials>* ServerStreamTest::client_credentials_ = nullptr;

TEST_F(ServerStreamTest, ReadsNoMoreUntilItIsResumedAndCanBeEndedMeanwhile) {
  service_.pause = true;
  Caller caller(Connect());
  const auto outbound = service_.opened.Pop(kPatience);
  ASSERT_TRUE(outbound);
  v1::SensorReply reply;
  ASSERT_TRUE(caller.Heartbeat(1));
  ASSERT_TRUE(caller.stream->Read(&reply));
  ASSERT_TRUE(caller.Heartbeat(2));
  absl::SleepFor(absl::Milliseconds(50));
  EXPECT_EQ(service_.messages, 1);
  // It may not pause yet at the first of these.
  while (service_.messages < 2) {
    (*outbound)->Resume();
    absl::SleepFor(absl::Milliseconds(1));
  }
  ASSERT_TRUE(caller.stream->Read(&reply));
  EXPECT_EQ(reply.heartbeat().echo_boottime_ns(), 2u);

  (*outbound)->Close(grpc::Status(grpc::StatusCode::UNAVAILABLE, "the end"));

  EXPECT_EQ(caller.End().error_message(), "the end");
  EXPECT_TRUE(service_.ended.Pop(kPatience).has_value());
  (*outbound)->Resume();
}

TEST_F(ServerStreamTest, WhatItWaitsForMayComeBeforeItPauses) {
  service_.pause = true;
  service_.resumed_meanwhile = true;
  Caller caller(Connect());
  v1::SensorReply reply;
  for (const uint64_t each : {1, 2, 3}) {
    ASSERT_TRUE(caller.Heartbeat(each));
    ASSERT_TRUE(caller.stream->Read(&reply));
  }
}

TEST_F(ServerStreamTest, CutsOffAPeerThatDoesNotReadAndServesOthers) {
  Caller other(Connect());
  const auto other_outbound = service_.opened.Pop(kPatience);
  Caller deaf(Connect());
  const auto outbound = service_.opened.Pop(kPatience);
  ASSERT_TRUE(other_outbound && outbound);

  const size_t taken = Flood(**outbound);

  // A message takes more memory than its 4 KiB. The network holds less than 16 MiB of them.
  const size_t waiting = OutboundLimits().bytes / 5'000;
  EXPECT_GE(taken, waiting);
  EXPECT_LT(taken, (OutboundLimits().bytes + (16 << 20)) / 4'096);
  EXPECT_FALSE((*outbound)->open());
  EXPECT_FALSE((*outbound)->Send({}));
  EXPECT_TRUE((*other_outbound)->open());
  ASSERT_TRUE(other.Heartbeat(7));
  v1::SensorReply reply;
  ASSERT_TRUE(other.stream->Read(&reply));
  EXPECT_EQ(reply.heartbeat().echo_boottime_ns(), 7u);

  const grpc::Status end = deaf.End();

  EXPECT_EQ(end.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(end.error_message(), "the peer does not read what it is sent: more than 8192 KiB wait");
  EXPECT_LE(deaf.replies, taken - waiting + 1);  // what waited was let go
  EXPECT_TRUE(service_.ended.Pop(kPatience).has_value());
}

TEST_F(ServerStreamTest, AMessageThatCannotBeDecodedAndAHalfClosedStreamEndItAndAreTold) {
  Caller garbled(Connect());
  v1::SensorMessage message;
  message.mutable_hello()->mutable_hello()->set_host("\xff\xfe");
  ASSERT_TRUE(garbled.stream->Write(message));
  const grpc::Status end = garbled.End();
  EXPECT_EQ(end.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(end.error_message(), "a message cannot be decoded (is a text not UTF-8?)");
  EXPECT_TRUE(service_.ended.Pop(kPatience).has_value());
  EXPECT_EQ(service_.unreadable, 1);

  Caller half(Connect());
  ASSERT_TRUE(half.Heartbeat(1));
  half.stream->WritesDone();
  const grpc::Status closed = half.End();
  EXPECT_EQ(closed.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(closed.error_message(), "the stream was half-closed, or a message was too large");
  EXPECT_TRUE(service_.ended.Pop(kPatience).has_value());
  EXPECT_EQ(service_.unreadable, 2);
}

TEST_F(ServerStreamTest, WhatIsNotWorthDecodingIsPassedOverAndTheStreamGoesOn) {
  service_.bytes_max = 1'000;
  Caller peer(Connect());
  v1::SensorMessage large;
  large.mutable_hello()->mutable_hello()->set_host(std::string(1'000, '\xff'));
  ASSERT_TRUE(peer.stream->Write(large));
  ASSERT_TRUE(peer.Heartbeat(7));
  v1::SensorReply reply;
  ASSERT_TRUE(peer.stream->Read(&reply));
  EXPECT_EQ(reply.heartbeat().echo_boottime_ns(), 7u);
  EXPECT_EQ(service_.messages, 1);
}

TEST_F(ServerStreamTest, AStreamThatIsCancelledOrClosedHereIsNotToldAsUnreadable) {
  {
    Caller leaving(Connect());
    ASSERT_TRUE(leaving.Heartbeat(1));
    ASSERT_TRUE(service_.opened.Pop(kPatience).has_value());
    leaving.context.TryCancel();
    leaving.End();
  }
  ASSERT_TRUE(service_.ended.Pop(kPatience).has_value());
  Caller closed(Connect());
  const auto outbound = service_.opened.Pop(kPatience);
  ASSERT_TRUE(outbound.has_value());
  (*outbound)->Close(grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping"));
  EXPECT_EQ(closed.End().error_message(), "stopping");
  ASSERT_TRUE(service_.ended.Pop(kPatience).has_value());
  EXPECT_EQ(service_.unreadable, 0);
}

TEST_F(ServerStreamTest, APeerThatWasCutOffAndNeverReadsMayLeave) {
  Caller deaf(Connect());
  const auto outbound = service_.opened.Pop(kPatience);
  ASSERT_TRUE(outbound.has_value());
  Flood(**outbound);

  deaf.context.TryCancel();

  EXPECT_TRUE(service_.ended.Pop(kPatience).has_value());
}

TEST_F(ServerStreamTest, TheServerStopsAlthoughAPeerNeverReads) {
  Caller deaf(Connect());
  const auto outbound = service_.opened.Pop(kPatience);
  ASSERT_TRUE(outbound.has_value());
  Flood(**outbound);

  server_->Shutdown(absl::ZeroDuration());

  EXPECT_TRUE(service_.ended.Pop(absl::ZeroDuration()).has_value());
  EXPECT_FALSE(deaf.End().ok());
}

TEST_F(ServerStreamTest, CloseWhenSentLosesNothingThatWaited) {
  Caller peer(Connect());
  const auto outbound = service_.opened.Pop(kPatience);
  ASSERT_TRUE(outbound.has_value());
  v1::SensorReply reply;
  reply.mutable_ack()->set_incarnation(std::string(4096, 'x'));
  for (int i = 0; i < 500; ++i) ASSERT_TRUE((*outbound)->Send(reply));

  (*outbound)->CloseWhenSent(grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping"));

  EXPECT_EQ(peer.End().error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_EQ(peer.replies, 500u);
  EXPECT_TRUE(service_.ended.Pop(kPatience).has_value());
}

TEST_F(ServerStreamTest, TheServerStopsAlthoughAPeerNeverReadsItsLastWords) {
  Caller deaf(Connect());
  const auto outbound = service_.opened.Pop(kPatience);
  ASSERT_TRUE(outbound.has_value());
  v1::SensorReply reply;
  reply.mutable_ack()->set_incarnation(std::string(1 << 20, 'x'));
  for (int i = 0; i < 7; ++i) ASSERT_TRUE((*outbound)->Send(reply));
  (*outbound)->CloseWhenSent(grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping"));

  server_->Shutdown(absl::Milliseconds(100));

  EXPECT_TRUE(service_.ended.Pop(absl::ZeroDuration()).has_value());
}

TEST_F(ServerStreamTest, NothingIsHandledAfterTheEnd) {
  service_.refuse = true;
  Caller peer(Connect());
  for (uint64_t i = 1; i <= 1'000; ++i) ASSERT_TRUE(peer.Heartbeat(i));

  service_.gate.Close();

  EXPECT_EQ(peer.End().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_TRUE(service_.ended.Pop(kPatience).has_value());
  EXPECT_EQ(service_.messages, 1);
}

TEST_F(ServerStreamTest, NothingIsHandledAfterTheEndOfAPeerThatDoesNotRead) {
  Caller deaf(Connect());
  const auto outbound = service_.opened.Pop(kPatience);
  ASSERT_TRUE(outbound.has_value());
  Flood(**outbound);

  for (uint64_t i = 1; i <= 1'000 && deaf.Heartbeat(i); ++i) {
  }

  EXPECT_EQ(deaf.End().error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_TRUE(service_.ended.Pop(kPatience).has_value());
  EXPECT_EQ(service_.messages, 0);
}

}  // namespace
}  // namespace rips::rpc

#include "services/rpc/bidi_client.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "grpcpp/generic/generic_stub.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/rpc/test_pki.h"
#include "services/rpc/test_service.h"
#include "services/runtime/atomic_file.h"

namespace rips::rpc {
namespace {

using ::testing::HasSubstr;

class BidiClientTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() { pki_ = new TestPki(); }
  static void TearDownTestSuite() {
    delete pki_;
    pki_ = nullptr;
  }

  static std::unique_ptr<RpcServer> StartServer(TestService* service,
                                                const std::string& listen = "127.0.0.1:0") {
    return StartOrDie(listen, pki_->Server(), service);
  }
  static BidiClientOptions Options(const std::string& server) {
    return ClientOptions(server, pki_->Sensor());
  }
  // A port where nobody listens, at least when it was looked for.
  static std::string DeadAddress() {
    TestService service;
    return StartServer(&service)->address();
  }

  static TestPki* pki_;
};
TestPki* BidiClientTest::pki_ = nullptr;

// A TCP server that never says a word.
class SilentServer {
 public:
  SilentServer() : fd_(socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in at{};
    at.sin_family = AF_INET;
    at.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof at;
    RIPS_CHECK(bind(fd_, reinterpret_cast<sockaddr*>(&at), size) == 0, "bind");
    RIPS_CHECK(listen(fd_, 16) == 0, "listen");
    RIPS_CHECK(getsockname(fd_, reinterpret_cast<sockaddr*>(&at), &size) == 0, "getsockname");
    address_ = absl::StrCat("127.0.0.1:", ntohs(at.sin_port));
  }
  ~SilentServer() { close(fd_); }
  const std::string& address() const { return address_; }

 private:
  int fd_;
  std::string address_;
};

TEST_F(BidiClientTest, SaysHelloFirstAndThenWhatItIsGiven) {
  TestService service;
  const auto server = StartServer(&service);
  TestClient client(Options(server->address()));
  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());

  constexpr uint64_t kMessages = 500;
  for (uint64_t i = 1; i <= kMessages; ++i)
    ASSERT_TRUE(client.client.Send(TestClient::Heartbeat(i)));

  ASSERT_TRUE(service.received.Pop(kPatience)->message.has_hello());
  for (uint64_t i = 1; i <= kMessages; ++i) {
    EXPECT_EQ(service.received.Pop(kPatience)->message.heartbeat().clock().boottime_ns(), i);
    EXPECT_EQ(client.replies.Pop(kPatience)->heartbeat().echo_boottime_ns(), i);
  }
  EXPECT_TRUE(client.client.connected());
}

TEST_F(BidiClientTest, ReconnectsAfterAServerRestart) {
  TestService service;
  auto server = StartServer(&service);
  const std::string address = server->address();
  TestClient client(Options(address));
  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());

  server->Shutdown(absl::ZeroDuration());
  const auto end = client.ends.Pop(kPatience);
  ASSERT_TRUE(end.has_value());
  EXPECT_EQ(end->close_class, CloseClass::kRetry);
  EXPECT_FALSE(client.client.Send(TestClient::Heartbeat(1)));
  ASSERT_TRUE(client.ends.Pop(kPatience).has_value());  // an attempt while nobody listens
  server = StartServer(&service, address);

  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());
  EXPECT_EQ(client.connected, 2u);
  EXPECT_EQ(service.received.Pop(kPatience)->message.hello().domain(), 1u);
  EXPECT_EQ(service.received.Pop(kPatience)->message.hello().domain(), 2u);
  EXPECT_TRUE(client.client.Send(TestClient::Heartbeat(2)));
  EXPECT_EQ(client.replies.Pop(kPatience)->heartbeat().echo_boottime_ns(), 2u);
}

TEST_F(BidiClientTest, RefusesToSendWhenTheQueueIsFull) {
  TestService service;
  service.hold = true;
  const auto server = StartServer(&service);
  BidiClientOptions options = Options(server->address());
  options.queue_capacity = 3;
  TestClient client(options);
  v1::SensorMessage big;
  big.mutable_chunk()->set_data(std::string(1 << 20, 'x'));
  const absl::Time deadline = absl::Now() + kPatience;
  while (!client.client.connected() && absl::Now() < deadline) std::this_thread::yield();

  // The network holds less than 16 of them, the writer one, the queue three.
  int sent = 0;
  int refused = 0;
  while (refused < 1000 && sent < 100 && absl::Now() < deadline) {
    client.client.Send(big) ? ++sent : ++refused;
  }
  EXPECT_EQ(refused, 1000);
  EXPECT_LT(sent, 20);

  service.gate.Push(1);
  for (int i = 0; i < sent + 1; ++i) EXPECT_TRUE(client.replies.Pop(kPatience).has_value());
}

TEST_F(BidiClientTest, KeepsTryingWhatWasRefused) {
  TestService service;
  service.refuse_with = grpc::StatusCode::PERMISSION_DENIED;
  const auto server = StartServer(&service);
  BidiClientOptions options = Options(server->address());
  options.random = [] { return 0.5; };
  TestClient client(options);
  const auto end = client.ends.Pop(kPatience);
  ASSERT_TRUE(end.has_value());
  EXPECT_EQ(end->close_class, CloseClass::kRefused);
  EXPECT_EQ(end->status.error_message(), "refused");
  const int64_t refused_ns = BoottimeNow();

  service.refuse_with = grpc::StatusCode::OK;

  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());
  EXPECT_GE(BoottimeNow() - refused_ns, 900 * kNanosPerMilli);
}

TEST_F(BidiClientTest, TriesTheNextServerWithoutDelay) {
  TestService service;
  const auto server = StartServer(&service);
  BidiClientOptions options = Options(DeadAddress());
  options.servers.push_back(server->address());
  options.backoff.initial = absl::Hours(1);
  options.backoff.max = absl::Hours(1);

  TestClient client(options);

  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());
  const auto end = client.ends.Pop(absl::ZeroDuration());
  ASSERT_TRUE(end.has_value());
  EXPECT_EQ(end->status.error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_THAT(end->status.error_message(), HasSubstr("onnect"));
}

TEST_F(BidiClientTest, WaitsTheBackoffAfterEachRound) {
  BidiClientOptions options = Options(DeadAddress());
  options.backoff = {.initial = absl::Hours(1), .max = absl::Hours(1)};
  TestClient client(options);

  ASSERT_TRUE(client.ends.Pop(kPatience).has_value());

  EXPECT_FALSE(client.ends.Pop(absl::Milliseconds(200)).has_value());
  EXPECT_EQ(client.connected, 0u);
  client.client.Stop();  // ends the pause
}

TEST_F(BidiClientTest, GivesUpOnASilentServerAfterTheTimeout) {
  const SilentServer silent;
  BidiClientOptions options = Options(silent.address());
  options.connect_timeout = absl::Milliseconds(300);
  TestClient client(options);

  const auto end = client.ends.Pop(kPatience);

  ASSERT_TRUE(end.has_value());
  EXPECT_EQ(end->status.error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  EXPECT_THAT(end->status.error_message(), HasSubstr("within 300ms; is it reachable?"));
  EXPECT_EQ(end->close_class, CloseClass::kRetry);
}

TEST_F(BidiClientTest, StopsWhileConnecting) {
  const SilentServer silent;
  BidiClientOptions options = Options(silent.address());
  options.connect_timeout = absl::Hours(1);
  TestClient client(options);

  client.client.Stop();

  EXPECT_EQ(client.ends.size(), 0u);
}

TEST_F(BidiClientTest, StopsWhileConnectedAndSaysNothingMore) {
  TestService service;
  const auto server = StartServer(&service);
  TestClient client(Options(server->address()));
  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());

  client.client.Stop();
  client.client.Stop();

  EXPECT_EQ(client.ends.size(), 0u);
  EXPECT_FALSE(client.client.connected());
  EXPECT_FALSE(client.client.Send(TestClient::Heartbeat(1)));
}

TEST_F(BidiClientTest, SurvivesAMessageOverTheLimit) {
  TestService service;
  const auto server = StartServer(&service);
  TestClient client(Options(server->address()));
  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());
  v1::SensorMessage big;
  big.mutable_chunk()->set_data(std::string(kMessageBytesMax + 1, 'x'));

  ASSERT_TRUE(client.client.Send(big));

  const auto end = client.ends.Pop(kPatience);
  ASSERT_TRUE(end.has_value());
  EXPECT_EQ(end->status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_TRUE(client.replies.Pop(kPatience).has_value());  // connected again
}

TEST_F(BidiClientTest, TakesMessagesFromManyThreads) {
  constexpr int kThreads = 4;
  constexpr int kEach = 300;
  TestService service;
  const auto server = StartServer(&service);
  BidiClientOptions options = Options(server->address());
  options.queue_capacity = 8;
  TestClient client(options);
  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&] {
      for (int i = 0; i < kEach; ++i) {
        while (!client.client.Send(TestClient::Heartbeat(1))) std::this_thread::yield();
      }
    });
  }
  for (std::thread& thread : threads) thread.join();

  for (int i = 0; i < kThreads * kEach; ++i) {
    ASSERT_TRUE(client.replies.Pop(kPatience).has_value()) << i;
  }
}

TEST_F(BidiClientTest, ServerShutsDownWithAStreamOpen) {
  TestService service;
  auto server = StartServer(&service);
  TestClient client(Options(server->address()));
  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());
  const int64_t start_ns = BoottimeNow();

  server->Shutdown(absl::Milliseconds(100));
  server->Shutdown(absl::Milliseconds(100));

  EXPECT_GE(BoottimeNow() - start_ns, 90 * kNanosPerMilli);
  EXPECT_TRUE(client.ends.Pop(kPatience).has_value());
}

TEST_F(BidiClientTest, ServerSharesItsPortWithNobody) {
  TestService service;
  const auto server = StartServer(&service);

  EXPECT_THAT(RpcServer::Start({.listen = server->address(),
                                .credentials = LoadOrDie(pki_->Server())->ForServer()},
                               {&service}),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("is the port in use?")));
}

// The answer of grpc.health.v1.Health/Check, as bytes.
std::string CheckHealth(const std::shared_ptr<grpc::Channel>& channel) {
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(30));
  context.set_wait_for_ready(true);
  grpc::CompletionQueue queue;
  const auto call = stub.PrepareUnaryCall(
      &context, "/grpc.health.v1.Health/Check",
      grpc::ByteBuffer(std::vector<grpc::Slice>{grpc::Slice("")}.data(), 1), &queue);
  call->StartCall();
  grpc::ByteBuffer answer;
  grpc::Status status;
  call->Finish(&answer, &status, nullptr);
  void* tag = nullptr;
  bool ok = false;
  queue.Next(&tag, &ok);
  if (!status.ok()) return status.error_message();
  std::vector<grpc::Slice> slices;
  answer.Dump(&slices).ok();
  std::string bytes;
  for (const grpc::Slice& slice : slices) {
    bytes.append(reinterpret_cast<const char*>(slice.begin()), slice.size());
  }
  return bytes;
}

TEST_F(BidiClientTest, ServerAnswersHealthChecks) {
  TestService service;
  const auto server = StartServer(&service);
  const auto channel = MakeChannel(server->address(), LoadOrDie(pki_->Sensor())->ForClient());

  EXPECT_EQ(CheckHealth(channel), "\x08\x01");  // status: SERVING
  server->SetServing(false);
  EXPECT_EQ(CheckHealth(channel), "\x08\x02");  // status: NOT_SERVING
}

TEST(StatusConversionTest, KeepsCodeAndMessageBothWays) {
  EXPECT_TRUE(ToGrpc(absl::OkStatus()).ok());
  EXPECT_TRUE(FromGrpc(grpc::Status::OK).ok());
  for (int code = 1; code <= 16; ++code) {
    const absl::Status status(static_cast<absl::StatusCode>(code), "why");
    EXPECT_EQ(static_cast<int>(ToGrpc(status).error_code()), code);
    EXPECT_EQ(FromGrpc(ToGrpc(status)), status);
  }
  EXPECT_EQ(ToGrpc(absl::InternalError(std::string(kStatusMessageBytesMax + 1, 'x')))
                .error_message()
                .size(),
            kStatusMessageBytesMax);
}

TEST_F(BidiClientTest, EndsAStreamWhenTheServersCertificateExpires) {
  TestService service;
  const TlsFiles brief = pki_->Mint({.folder = "brief-server",
                                     .san = "URI:spiffe://fleet.example/policy-server/ps1",
                                     .age_seconds = 86'400 - 3});
  const auto server = StartOrDie("127.0.0.1:0", brief, &service);
  BidiClientOptions options = Options(server->address());
  BoundedQueue<Peer> peers({.capacity = 10});
  options.on_peer = [&](const Peer& peer) { peers.Push(peer); };
  TestClient client(options);
  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());
  const auto peer = peers.Pop(kPatience);
  ASSERT_TRUE(peer.has_value());
  EXPECT_EQ(ToString(peer->identity), "spiffe://fleet.example/policy-server/ps1");

  const auto end = client.ends.Pop(kPatience);

  ASSERT_TRUE(end.has_value());
  EXPECT_GE(absl::Now(), peer->not_after);
  EXPECT_LE(absl::Now(), peer->not_after + absl::Seconds(5));
  EXPECT_EQ(end->status.error_code(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(end->status.error_message(), "the policy server: the certificate has expired");
  EXPECT_EQ(end->close_class, CloseClass::kReidentify);
}

TEST_F(BidiClientTest, EndsAStreamWhenTheServersCertificateIsRevoked) {
  TestPki pki;
  TestService service;
  const TlsFiles server_files = pki.Server();
  TlsFiles sensor = pki.Sensor();
  sensor.crl = pki.SignRevocations();
  const auto server = StartOrDie("127.0.0.1:0", server_files, &service);
  TestClient client({.servers = {server->address()}, .credentials = LoadOrDie(sensor)});
  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());

  pki.Revoke(server_files);

  const auto end = client.ends.Pop(kPatience);
  ASSERT_TRUE(end.has_value());
  EXPECT_EQ(end->status.error_message(), "the policy server: the certificate is revoked");
}

TEST_F(BidiClientTest, WithoutUsableCredentialsItTriesUntilTheyAre) {
  TestService service;
  const auto server = StartServer(&service);
  const TlsFiles good = pki_->Sensor();
  TlsFiles late = good;
  late.cert = absl::StrCat(pki_->dir(), "/late-cert.pem");
  TestClient client(
      {.servers = {server->address()},
       .credentials = CredentialsSource(late),
       .backoff = {.initial = absl::Milliseconds(20), .max = absl::Milliseconds(100)}});
  const auto end = client.ends.Pop(kPatience);
  ASSERT_TRUE(end.has_value());
  EXPECT_EQ(end->status.error_code(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_THAT(end->status.error_message(), HasSubstr("late-cert.pem"));

  ASSERT_THAT(WriteFileAtomically(late.cert, *ReadFile(good.cert, 1 << 20)), IsOk());

  EXPECT_TRUE(client.replies.Pop(kPatience).has_value());
}

}  // namespace
}  // namespace rips::rpc

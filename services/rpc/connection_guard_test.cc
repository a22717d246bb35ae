#include "services/rpc/connection_guard.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/generic/generic_stub.h"
#include "grpcpp/security/server_credentials.h"
#include "gtest/gtest.h"
#include "rips/v1/sensor.grpc.pb.h"
#include "services/base/status_matchers.h"
#include "services/rpc/server_builder.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/real_clock.h"

namespace rips::rpc {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr absl::Duration kPatience = absl::Seconds(30);
constexpr char kSensor[] = "spiffe://td/robot/r1/sensor/base serial 0f";

// A plain TCP connection that sends nothing.
class Silent {
 public:
  explicit Silent(int port, const char* from = nullptr)
      : fd_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in own = {};
    own.sin_family = AF_INET;
    if (from != nullptr) {
      inet_pton(AF_INET, from, &own.sin_addr);
      EXPECT_EQ(bind(fd_.get(), reinterpret_cast<const sockaddr*>(&own), sizeof(own)), 0);
    }
    sockaddr_in address = {};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<uint16_t>(port));
    inet_pton(AF_INET, "127.0.0.1", &address.sin_addr);
    connected_ =
        connect(fd_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0;
  }
  bool connected() const { return connected_; }
  // True once the server has ended it.
  bool EndsWithin(absl::Duration patience) {
    const absl::Time end = absl::Now() + patience;
    while (absl::Now() < end) {
      pollfd polled = {.fd = fd_.get(), .events = POLLIN, .revents = 0};
      if (poll(&polled, 1, 50) < 1) continue;
      char buffer[4'096];  // NOLINT
      if (recv(fd_.get(), buffer, sizeof(buffer), 0) <= 0) return true;
    }
    return false;
  }

  void CloseItsSide() { shutdown(fd_.get(), SHUT_WR); }
  void ResetWhenClosed() {
    const linger now{.l_onoff = 1, .l_linger = 0};
    setsockopt(fd_.get(), SOL_SOCKET, SO_LINGER, &now, sizeof(now));
  }

 private:
  UniqueFd fd_;
  bool connected_ = false;
};

class ConnectionGuardTest : public ::testing::Test {
 protected:
  void Start(ConnectionGuard::Options options, const std::string& listen = "127.0.0.1:0") {
    options.on_ended = [this](const ConnectionGuard::Report& report) { reports_.Push(report); };
    options.on_wasted = [this](const std::string& address, bool known) {
      wasted_.Push(absl::StrCat(address, known ? ", known" : ""));
    };
    auto guard = ConnectionGuard::Listen(listen, std::move(options), &clock_, &metrics_);
    ASSERT_THAT(guard, IsOk());
    guard_ = *std::move(guard);
    auto server = RpcServer::Start(
        {.listen = listen, .guard = guard_.get(), .credentials = grpc::InsecureServerCredentials()},
        {&service_});
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
  }
  // One channel is one connection.
  std::shared_ptr<grpc::Channel> Connect() {
    grpc::ChannelArguments arguments;
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    return grpc::CreateCustomChannel(server_->address(), grpc::InsecureChannelCredentials(),
                                     arguments);
  }
  static grpc::Status Call(const std::shared_ptr<grpc::Channel>& channel,
                           const std::string& method) {
    grpc::ClientContext context;
    context.set_deadline(absl::ToChronoTime(absl::Now() + kPatience));
    grpc::TemplatedGenericStub<v1::SensorMessage, v1::SensorReply> stub(channel);
    v1::SensorMessage request;
    v1::SensorReply reply;
    grpc::Status status;
    BoundedQueue<int> done{{.capacity = 1}};
    stub.UnaryCall(&context, method, {}, &request, &reply, [&](grpc::Status ended) {
      status = std::move(ended);
      done.Push(1);
    });
    done.Pop(2 * kPatience);
    return status;
  }
  // The connections there are, as gRPC names them.
  std::vector<std::string> FindPeers() {
    std::vector<std::string> out;
    for (int port = 1; port < 65'536; ++port) {
      const std::string name = absl::StrCat("ipv4:127.0.0.1:", port);
      if (guard_->Find(name) != nullptr) out.push_back(name);
    }
    return out;
  }
  // The one connection there is.
  std::string FindPeer() {
    const std::vector<std::string> peers = FindPeers();
    return peers.size() == 1 ? peers[0] : "";
  }
  double Open() { return metrics_.AddGauge("rips_connections", "").Value(); }
  double Refused(const std::string& why) {
    return metrics_
        .AddCounter("rips_connections_refused_total", "Connections not taken, by why.",
                    {{"reason", why}})
        .Value();
  }

  RealClock clock_;
  Metrics metrics_;
  BoundedQueue<ConnectionGuard::Report> reports_{{.capacity = 1'000}};
  BoundedQueue<std::string> wasted_{{.capacity = 1'000}};
  v1::SensorService::Service service_;
  std::unique_ptr<ConnectionGuard> guard_;
  std::unique_ptr<RpcServer> server_;
};

TEST_F(ConnectionGuardTest, AConnectionWithoutACallIsEnded) {
  Start({.budget = {.silent_ns = 200 * kNanosPerMilli}});
  Silent silent(server_->port());
  EXPECT_TRUE(silent.EndsWithin(kPatience));
  const auto report = reports_.Pop(kPatience);
  ASSERT_TRUE(report.has_value());
  EXPECT_EQ(report->excess, Excess::kSilent);
  EXPECT_THAT(report->peer, StartsWith("ipv4:127.0.0.1:"));
  EXPECT_EQ(report->banned_ns, 0) << "it may be a peer on a bad line";
}

TEST_F(ConnectionGuardTest, EachConnectionThatComesToNothingIsToldHoweverItEnds) {
  const struct {
    const char* how;
    ConnectionGuard::Options options;
    bool waits;
    bool resets;
  } kWays[] = {{"refused", {.admission = {.burst = 1, .per_second = 0}}, true, false},
               {"ended for silence", {.budget = {.silent_ns = 200 * kNanosPerMilli}}, true, false},
               {"ended for room", {.admission = {.per_address = 1}}, true, false},
               {"left by the peer", {}, false, false},
               {"reset by the peer", {}, false, true}};
  for (const auto& way : kWays) {
    SCOPED_TRACE(way.how);
    Start(way.options);
    std::vector<std::unique_ptr<Silent>> flood;
    for (int i = 0; i < 9; ++i) {
      flood.push_back(std::make_unique<Silent>(server_->port()));
      if (way.resets) flood.back()->ResetWhenClosed();
      if (!way.waits) flood.clear();
    }
    for (int i = 0; i < 8; ++i) ASSERT_EQ(wasted_.Pop(kPatience), "127.0.0.1");
    server_->Shutdown(absl::ZeroDuration());
    guard_->Stop();
    while (wasted_.Pop(absl::ZeroDuration())) {
    }
  }
}

TEST_F(ConnectionGuardTest, WhoShowsACertificateIsNotWasted) {
  Start({});
  for (int i = 0; i < 4; ++i) {
    auto channel = Connect();
    ASSERT_EQ(Call(channel, "/rips.v1.SensorService/None").error_code(),
              grpc::StatusCode::UNIMPLEMENTED);
    const std::string peer = FindPeer();
    ASSERT_THAT(guard_->OnIdentified(peer, absl::StrCat(kSensor, i), /*agent=*/true), IsOk());
    channel.reset();
    const absl::Time end = absl::Now() + kPatience;
    while (guard_->Find(peer) != nullptr && absl::Now() < end) {
      absl::SleepFor(absl::Milliseconds(5));
    }
  }
  EXPECT_FALSE(wasted_.Pop(absl::Milliseconds(200)).has_value());
  // What comes from where it was shown may be an agent's.
  { const Silent silent(server_->port()); }
  EXPECT_EQ(wasted_.Pop(kPatience), "127.0.0.1, known");
}

TEST_F(ConnectionGuardTest, TakesNoMoreThanItsLimitAndMakesRoomAgain) {
  Start({.admission = {.per_address = 3}});
  std::vector<std::shared_ptr<grpc::Channel>> held;
  for (int i = 0; i < 3; ++i) {
    held.push_back(Connect());
    ASSERT_EQ(Call(held.back(), "/rips.v1.SensorService/None").error_code(),
              grpc::StatusCode::UNIMPLEMENTED);
  }
  for (const std::string& peer : FindPeers()) {
    ASSERT_THAT(guard_->OnIdentified(peer, kSensor, /*agent=*/true), IsOk());
  }
  Silent refused(server_->port());
  EXPECT_TRUE(refused.EndsWithin(kPatience));
  EXPECT_EQ(Refused("address"), 1);

  held.clear();
  const absl::Time end = absl::Now() + kPatience;
  grpc::Status status;
  do {
    status = Call(Connect(), "/rips.v1.SensorService/None");
  } while (status.error_code() == grpc::StatusCode::UNAVAILABLE && absl::Now() < end);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::UNIMPLEMENTED);
}

TEST_F(ConnectionGuardTest, EndsTheOldestConnectionWithoutACertificateForANewOne) {
  for (const AdmissionLimits& limits :
       {AdmissionLimits{.total = 4, .reserve = 0}, AdmissionLimits{.per_network = 4},
        AdmissionLimits{.per_address = 4}}) {
    Start({.admission = limits});
    const auto agent = Connect();
    ASSERT_EQ(Call(agent, "/rips.v1.SensorService/None").error_code(),
              grpc::StatusCode::UNIMPLEMENTED);
    ASSERT_THAT(guard_->OnIdentified(FindPeer(), kSensor, /*agent=*/true), IsOk());
    std::vector<std::unique_ptr<Silent>> flood;
    for (int i = 0; i < 20; ++i) {
      flood.push_back(std::make_unique<Silent>(server_->port()));
      const absl::Time end = absl::Now() + kPatience;
      while (Open() < std::min<size_t>(4, flood.size() + 1) && absl::Now() < end) {
        absl::SleepFor(absl::Milliseconds(5));
      }
    }
    EXPECT_EQ(Call(Connect(), "/rips.v1.SensorService/None").error_code(),
              grpc::StatusCode::UNIMPLEMENTED)
        << "the new one is taken";
    EXPECT_EQ(Call(agent, "/rips.v1.SensorService/None").error_code(),
              grpc::StatusCode::UNIMPLEMENTED)
        << "one with a certificate stays";
    EXPECT_TRUE(flood.front()->EndsWithin(kPatience));
    EXPECT_LE(Open(), 4u);
    server_->Shutdown(absl::ZeroDuration());
  }
}

TEST_F(ConnectionGuardTest, MakesRoomInTheNetworkThatHasMost) {
  Start({.admission = {.total = 6, .reserve = 0}});
  Silent lone(server_->port(), "127.9.9.9");
  std::vector<std::unique_ptr<Silent>> flood;
  for (int i = 0; i < 20; ++i) {
    flood.push_back(std::make_unique<Silent>(server_->port(), "127.1.0.1"));
  }
  EXPECT_TRUE(flood.front()->EndsWithin(kPatience));
  EXPECT_FALSE(lone.EndsWithin(absl::Milliseconds(200))) << "though it is the oldest";
}

TEST_F(ConnectionGuardTest, MakesRoomOnlySoOftenBetweenTwoLooks) {
  Start({.admission = {.per_address = 1},
         .handshakes = {.burst = 1'000},
         .interval = absl::Hours(1)});
  std::vector<std::unique_ptr<Silent>> flood;
  for (int i = 0; i < 200; ++i) flood.push_back(std::make_unique<Silent>(server_->port()));
  EXPECT_TRUE(flood.back()->EndsWithin(kPatience));
  EXPECT_EQ(Refused("address"), 200 - 1 - 128);
}

TEST_F(ConnectionGuardTest, MakesRoomWithoutLimitAmongThoseThatWaitForTheirHandshake) {
  Start({.admission = {.per_address = 1},
         .handshakes = {.burst = 1, .per_second = 1e-6},
         .interval = absl::Hours(1)});
  std::vector<std::unique_ptr<Silent>> flood;
  for (int i = 0; i < 200; ++i) flood.push_back(std::make_unique<Silent>(guard_->port()));
  EXPECT_TRUE(flood[198]->EndsWithin(kPatience));
  EXPECT_FALSE(flood[199]->EndsWithin(absl::Milliseconds(200)));
  EXPECT_EQ(Refused("address"), 0);
}

TEST_F(ConnectionGuardTest, AnAddressThatIsNotKnownWaitsForItsHandshakeAndOneThatIsKnownDoesNot) {
  Start({.handshakes = {.burst = 1, .per_second = 1e-6}});
  const Silent first(guard_->port());
  ASSERT_TRUE(first.connected());
  const auto waits = Connect();
  EXPECT_FALSE(waits->WaitForConnected(absl::ToChronoTime(absl::Now() + absl::Milliseconds(500))));
  ASSERT_FALSE(FindPeers().empty());
  EXPECT_THAT(guard_->OnIdentified(FindPeers()[0], kSensor, /*agent=*/true), IsOk());
  EXPECT_TRUE(Connect()->WaitForConnected(absl::ToChronoTime(absl::Now() + kPatience)));
  EXPECT_TRUE(waits->WaitForConnected(absl::ToChronoTime(absl::Now() + kPatience)))
      << "the one that was identified gave its place back";
}

TEST_F(ConnectionGuardTest, WhoHalfClosesBeforeItsHandshakeIsClosedAndTold) {
  Start({.handshakes = {.burst = 1, .per_second = 20}});
  Silent half(guard_->port());
  ASSERT_TRUE(half.connected());
  std::vector<std::unique_ptr<Silent>> more;
  for (int i = 0; i < 3; ++i) {
    more.push_back(std::make_unique<Silent>(guard_->port()));
    more.back()->CloseItsSide();
  }
  EXPECT_TRUE(more.back()->EndsWithin(absl::Seconds(5)));
  EXPECT_TRUE(wasted_.Pop(kPatience).has_value());
}

TEST_F(ConnectionGuardTest, WhoWaitsForAHandshakeComesWhenItsTimeHasCome) {
  Start({.handshakes = {.burst = 1, .per_second = 20}});
  std::vector<std::unique_ptr<Silent>> before;
  for (int i = 0; i < 20; ++i) {
    before.push_back(std::make_unique<Silent>(guard_->port()));
    ASSERT_TRUE(before.back()->connected());
  }
  // Those that have left take no turn.
  before.resize(2);
  EXPECT_TRUE(Connect()->WaitForConnected(absl::ToChronoTime(absl::Now() + kPatience)));
}

TEST_F(ConnectionGuardTest, AThrottledConnectionIsEndedTheSecondTime) {
  Start({});
  const auto channel = Connect();
  ASSERT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNIMPLEMENTED);
  const auto connection = guard_->Find(FindPeer());
  ASSERT_NE(connection, nullptr);
  const std::string peer = connection->source().peer;
  connection->OnThrottled();
  ASSERT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNIMPLEMENTED);
  EXPECT_NE(guard_->Find(peer), nullptr) << "the first time the call gets the reason";
  connection->OnThrottled();
  const absl::Time end = absl::Now() + kPatience;
  while (guard_->Find(peer) != nullptr && absl::Now() < end) {
    absl::SleepFor(absl::Milliseconds(5));
  }
  EXPECT_EQ(guard_->Find(peer), nullptr);
}

TEST_F(ConnectionGuardTest, TooManyCallsEndTheConnectionThoughTheirMethodIsUnknown) {
  Start({.budget = {.calls_burst = 20, .calls_per_second = 0.01}});
  const auto bystander = Connect();
  EXPECT_EQ(Call(bystander, "/rips.v1.SensorService/None").error_code(),
            grpc::StatusCode::UNIMPLEMENTED);
  const auto channel = Connect();
  for (int i = 0; i < 20; ++i) {
    ASSERT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNIMPLEMENTED);
  }
  EXPECT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNAVAILABLE);
  const auto report = reports_.Pop(kPatience);
  ASSERT_TRUE(report.has_value());
  EXPECT_EQ(report->excess, Excess::kCalls);
  EXPECT_GT(report->banned_ns, 0);
  EXPECT_EQ(Call(bystander, "/rips.v1.SensorService/None").error_code(),
            grpc::StatusCode::UNIMPLEMENTED)
      << "who is connected stays";
  Silent refused(server_->port());
  EXPECT_TRUE(refused.EndsWithin(kPatience));
  EXPECT_GE(Refused("banned"), 1);
}

TEST_F(ConnectionGuardTest, ACertificateIsBannedWithItsConnection) {
  Start({.budget = {.calls_burst = 2, .calls_per_second = 0.01}});
  const auto channel = Connect();
  ASSERT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNIMPLEMENTED);
  const std::string peer = FindPeer();
  ASSERT_FALSE(peer.empty());
  EXPECT_THAT(guard_->OnIdentified(peer, kSensor, /*agent=*/true), IsOk());
  EXPECT_EQ(guard_->Banned(kSensor, "127.0.0.1"), absl::ZeroDuration());
  for (int i = 0; i < 3; ++i) Call(channel, "/no.such.Service/None");
  EXPECT_GT(guard_->Banned(kSensor, "127.0.0.1"), absl::Seconds(1));
  EXPECT_EQ(guard_->Banned("spiffe://td/robot/r2/sensor/base serial 10", "127.0.0.1"),
            absl::ZeroDuration());
}

TEST_F(ConnectionGuardTest, WhatIsDoneWithACopiedKeyElsewhereShutsItsOwnerNotOut) {
  Start({.per_agent = 1, .agent_calls_burst = 3, .agent_calls_per_second = 0.01}, "[::]:0");
  const auto connect = [this](const char* host) {
    grpc::ChannelArguments arguments;
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    auto channel = grpc::CreateCustomChannel(absl::StrCat(host, ":", guard_->port()),
                                             grpc::InsecureChannelCredentials(), arguments);
    EXPECT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNIMPLEMENTED);
    return channel;
  };
  const auto agent = connect("127.0.0.1");
  const std::string owner = FindPeer();
  EXPECT_THAT(guard_->OnIdentified(owner, kSensor, /*agent=*/true), IsOk());
  const auto copy = connect("[::1]");
  std::string thief;
  for (int port = 1; port < 65'536 && thief.empty(); ++port) {
    const std::string name = absl::StrCat("ipv6:[::1]:", port);
    if (guard_->Find(name) != nullptr) thief = name;
  }
  for (int i = 0; i < 3; ++i) {
    EXPECT_THAT(guard_->OnIdentified(thief, kSensor, /*agent=*/true), IsOk()) << i;
  }
  EXPECT_THAT(guard_->OnIdentified(thief, kSensor, /*agent=*/true),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("too many streams")));
  ASSERT_TRUE(reports_.Pop(kPatience).has_value());
  EXPECT_GT(guard_->Banned(kSensor, "::/64"), absl::Seconds(1));
  EXPECT_GT(guard_->Banned(kSensor, "10.0.0.66"), absl::Seconds(1)) << "where it is not at home";
  EXPECT_EQ(guard_->Banned(kSensor, "127.0.0.1"), absl::ZeroDuration());
  EXPECT_THAT(guard_->OnIdentified(owner, kSensor, /*agent=*/true), IsOk());
}

TEST_F(ConnectionGuardTest, AMessageThatAHandlerRefusesEndsTheConnectionAndBansItsCertificate) {
  Start({});
  const auto channel = Connect();
  ASSERT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNIMPLEMENTED);
  const std::string peer = FindPeer();
  ASSERT_THAT(guard_->OnIdentified(peer, kSensor, /*agent=*/true), IsOk());
  guard_->Find(peer)->OnRefused();
  const auto report = reports_.Pop(kPatience);
  ASSERT_TRUE(report.has_value());
  EXPECT_EQ(report->excess, Excess::kRefused);
  EXPECT_EQ(report->certificate, kSensor);
  EXPECT_GT(guard_->Banned(kSensor, "127.0.0.1"), absl::Seconds(1));
}

TEST_F(ConnectionGuardTest, AnAgentsCallsAreCountedOnAllItsConnections) {
  Start({.agent_calls_burst = 3, .agent_calls_per_second = 0.01});
  const auto channel = Connect();
  ASSERT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNIMPLEMENTED);
  const std::string peer = FindPeer();
  for (int i = 0; i < 3; ++i) {
    EXPECT_THAT(guard_->OnIdentified(peer, kSensor, /*agent=*/true), IsOk());
  }
  EXPECT_THAT(guard_->OnIdentified(peer, kSensor, /*agent=*/true),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("too many streams")));
  const auto report = reports_.Pop(kPatience);
  ASSERT_TRUE(report.has_value());
  EXPECT_EQ(report->excess, Excess::kCalls);
  EXPECT_GT(guard_->Banned(kSensor, "127.0.0.1"), absl::Seconds(1));
}

TEST_F(ConnectionGuardTest, RefusesACertificateThatHasItsConnectionsAlready) {
  for (const bool agent : {true, false}) {
    SCOPED_TRACE(agent ? "agent" : "operator");
    Start({.per_operator = 3, .per_agent = 2});
    const size_t allowed = agent ? 2 : 3;
    std::vector<std::shared_ptr<grpc::Channel>> channels;
    for (size_t i = 0; i <= allowed; ++i) {
      channels.push_back(Connect());
      ASSERT_EQ(Call(channels.back(), "/no.such.Service/None").error_code(),
                grpc::StatusCode::UNIMPLEMENTED);
    }
    const std::vector<std::string> peers = FindPeers();
    ASSERT_EQ(peers.size(), allowed + 1);
    for (size_t i = 0; i < allowed; ++i) {
      EXPECT_THAT(guard_->OnIdentified(peers[i], kSensor, agent), IsOk());
    }
    EXPECT_THAT(guard_->OnIdentified(peers[allowed], kSensor, agent),
                StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("connections already")));
    EXPECT_THAT(guard_->OnIdentified(peers[0], kSensor, agent), IsOk()) << "a further call";
    EXPECT_THAT(guard_->OnIdentified(peers[allowed], "another certificate", agent), IsOk());
    // A connection that is over makes room.
    channels.clear();
    const absl::Time end = absl::Now() + kPatience;
    while (Open() > 0 && absl::Now() < end) absl::SleepFor(absl::Milliseconds(20));
    channels.push_back(Connect());
    Call(channels.back(), "/no.such.Service/None");
    EXPECT_THAT(guard_->OnIdentified(FindPeer(), kSensor, agent), IsOk());
    channels.clear();
    server_->Shutdown(absl::ZeroDuration());
  }
}

TEST_F(ConnectionGuardTest, CountsCallsOverIPv6) {
  Start({.budget = {.calls_burst = 2, .calls_per_second = 0.01}}, "[::1]:0");
  const auto channel = Connect();
  ASSERT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNIMPLEMENTED);
  ASSERT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNIMPLEMENTED);
  EXPECT_EQ(Call(channel, "/no.such.Service/None").error_code(), grpc::StatusCode::UNAVAILABLE);
  const auto report = reports_.Pop(kPatience);
  ASSERT_TRUE(report.has_value());
  EXPECT_THAT(report->peer, StartsWith("ipv6:[::1]:"));
}

TEST_F(ConnectionGuardTest, AProbeIsTakenThoughItsAddressIsFullOrBanned) {
  Start({.admission = {.total = 1, .reserve = 0, .per_address = 1}});
  const auto held = Connect();
  ASSERT_EQ(Call(held, "/no.such.Service/None").error_code(), grpc::StatusCode::UNIMPLEMENTED);
  ASSERT_THAT(guard_->OnIdentified(FindPeer(), kSensor, /*agent=*/true), IsOk());
  Silent refused(server_->port());
  ASSERT_TRUE(refused.EndsWithin(kPatience));
  EXPECT_THAT(guard_->Probe(kPatience), IsOk());
  EXPECT_THAT(guard_->Probe(kPatience), IsOk());
  server_->Shutdown(absl::ZeroDuration());
  EXPECT_THAT(guard_->Probe(kPatience), StatusIs(absl::StatusCode::kUnavailable));
}

TEST_F(ConnectionGuardTest, AProbeReachesAListenerOnAllAddresses) {
  Start({}, "[::]:0");
  EXPECT_THAT(guard_->Probe(kPatience), IsOk());
}

TEST_F(ConnectionGuardTest, APortInUseIsAnError) {
  Start({});
  EXPECT_THAT(ConnectionGuard::Listen(server_->address(), {}, &clock_, nullptr),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("is the port in use?")));
  EXPECT_THAT(ConnectionGuard::Listen("nonsense", {}, &clock_, nullptr),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("HOST:PORT")));
}

}  // namespace
}  // namespace rips::rpc

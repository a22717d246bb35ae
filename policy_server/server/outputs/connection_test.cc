#include "policy_server/server/outputs/connection.h"

#include <poll.h>

#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/server/outputs/fake_peer_for_test.h"
#include "policy_server/server/outputs/resolver.h"
#include "services/base/status_matchers.h"
#include "services/rpc/test_pki.h"

namespace rips::outputs {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr absl::Duration kPatience = absl::Seconds(10);

class ConnectionTest : public ::testing::Test {
 protected:
  static TlsFiles Mint(const std::string& folder, const std::string& san) {
    return pki_->Mint({.folder = folder, .san = san, .by_root = true});
  }
  static void SetUpTestSuite() {
    pki_ = new rpc::TestPki();
    server_ = Mint("server-files", "DNS:siem.example,IP:127.0.0.1");
  }
  static void TearDownTestSuite() { delete pki_; }

  server::OutputEndpoint Endpoint(const FakePeer& peer) const {
    return {.host = "127.0.0.1", .port = peer.port(), .ca = server_.ca};
  }
  absl::Status Open(const server::OutputEndpoint& endpoint) {
    return Connection::Open(endpoint, kPatience, &stop_).status();
  }

  static rpc::TestPki* pki_;
  static TlsFiles server_;
  WakeFd stop_;
};
rpc::TestPki* ConnectionTest::pki_ = nullptr;
TlsFiles ConnectionTest::server_;

void Echo(Taken& taken) {
  for (std::string bytes = taken.Read(); !bytes.empty(); bytes = taken.Read()) taken.Write(bytes);
}

TEST_F(ConnectionTest, CarriesBytesBothWays) {
  for (const bool tls : {true, false}) {
    FakePeer peer(Echo, tls ? &server_ : nullptr);
    server::OutputEndpoint endpoint = Endpoint(peer);
    endpoint.tls = tls;
    const auto connection = Connection::Open(endpoint, kPatience, &stop_);
    ASSERT_THAT(connection, IsOk());
    ASSERT_THAT((*connection)->Write("hello", kPatience), IsOk());
    const auto got = (*connection)->Read(100, Deadline(kPatience));
    ASSERT_THAT(got, IsOk());
    EXPECT_EQ(*got, "hello");
  }
}

TEST_F(ConnectionTest, ACertificateOfAnotherAuthorityIsNotAccepted) {
  rpc::TestPki other;
  FakePeer peer(Echo, &server_);
  server::OutputEndpoint endpoint = Endpoint(peer);
  endpoint.ca = other.Server().ca;
  EXPECT_THAT(Open(endpoint), StatusIs(absl::StatusCode::kUnavailable,
                                       HasSubstr("certificate of the receiver is not accepted")));
}

TEST_F(ConnectionTest, ACertificateOfAnotherNameIsNotAccepted) {
  const TlsFiles files = Mint("other-name", "DNS:other.example,IP:127.0.0.2");
  FakePeer peer(Echo, &files);
  EXPECT_THAT(Open(Endpoint(peer)),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("mismatch")));
  server::OutputEndpoint named = Endpoint(peer);
  named.host = "localhost";
  EXPECT_THAT(Open(named), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("mismatch")));
}

TEST_F(ConnectionTest, ShowsItsOwnCertificate) {
  const TlsFiles own = pki_->Server("ps7");
  FakePeer peer(Echo, &server_, true);
  server::OutputEndpoint endpoint = Endpoint(peer);
  // TLS 1.3 refuses a client after the handshake.
  const auto without = Connection::Open(endpoint, kPatience, &stop_);
  if (without.ok()) {
    EXPECT_THAT((*without)->StaysUp(kPatience), StatusIs(absl::StatusCode::kUnavailable));
  }
  endpoint.cert = own.cert;
  endpoint.key = own.key;
  const auto with = Connection::Open(endpoint, kPatience, &stop_);
  ASSERT_THAT(with, IsOk());
  ASSERT_THAT((*with)->Write("x", kPatience), IsOk());
  EXPECT_THAT((*with)->Read(1, Deadline(kPatience)), IsOk());
}

TEST_F(ConnectionTest, BadFilesAreNamedWithoutTheirContent) {
  FakePeer peer(Echo, &server_);
  server::OutputEndpoint endpoint = Endpoint(peer);
  endpoint.ca = absl::StrCat(pki_->dir(), "/none.pem");
  EXPECT_THAT(Open(endpoint), StatusIs(absl::StatusCode::kNotFound, HasSubstr("none.pem")));
  const std::string bad = absl::StrCat(pki_->dir(), "/bad.pem");
  std::ofstream(bad) << "-----BEGIN PRIVATE KEY-----\nhunter2\n-----END PRIVATE KEY-----\n";
  endpoint.ca = bad;
  EXPECT_THAT(Open(endpoint),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("CA certificate")));
  endpoint.ca = server_.ca;
  endpoint.cert = server_.cert;
  endpoint.key = bad;
  const absl::Status status = Open(endpoint);
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("bad.pem")));
  EXPECT_THAT(std::string(status.message()), Not(HasSubstr("hunter2")));
}

TEST_F(ConnectionTest, PeersThatAreAwayOrHangHaveATime) {
  const server::OutputEndpoint gone{.host = "127.0.0.1", .port = 1, .tls = false};
  EXPECT_THAT(Open(gone), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("cannot connect")));
  FakePeer silent([](Taken& taken) { taken.Hang(); });
  EXPECT_THAT(Connection::Open(Endpoint(silent), absl::Milliseconds(50), &stop_),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("TLS handshake took too long")));
  server::OutputEndpoint plain = Endpoint(silent);
  plain.tls = false;
  const auto connection = Connection::Open(plain, kPatience, &stop_);
  ASSERT_THAT(connection, IsOk());
  EXPECT_THAT((*connection)->Read(1, Deadline(absl::Milliseconds(20))),
              StatusIs(absl::StatusCode::kDeadlineExceeded));
}

TEST_F(ConnectionTest, AWriteThatIsNotReadHasATime) {
  // Reads nothing.
  FakePeer full([this](Taken&) {
    pollfd fd = {.fd = stop_.get(), .events = POLLIN, .revents = 0};
    poll(&fd, 1, -1);
  });
  const server::OutputEndpoint endpoint{.host = "127.0.0.1", .port = full.port(), .tls = false};
  auto connection = Connection::Open(endpoint, kPatience, &stop_);
  ASSERT_THAT(connection, IsOk());
  EXPECT_THAT((*connection)->Write(std::string(size_t{64} << 20, 'x'), absl::Milliseconds(100)),
              StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("sending")));
  stop_.Wake();
}

TEST_F(ConnectionTest, WhatIsNotTlsIsRefused) {
  FakePeer peer([](Taken& taken) { taken.Write("HTTP/1.1 400 Bad\r\n\r\n"); });
  EXPECT_THAT(Open(Endpoint(peer)), StatusIs(absl::StatusCode::kUnavailable));
}

TEST_F(ConnectionTest, StopEndsEveryWait) {
  FakePeer silent([](Taken& taken) { taken.Hang(); });
  std::thread stopper([this] { stop_.Wake(); });
  EXPECT_THAT(Connection::Open(Endpoint(silent), kPatience, &stop_),
              StatusIs(absl::StatusCode::kCancelled));
  stopper.join();
}

TEST_F(ConnectionTest, ANameThatIsNotKnownIsAnError) {
  const server::OutputEndpoint endpoint{.host = "nothing.invalid", .port = 1, .tls = false};
  EXPECT_THAT(Open(endpoint), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("resolv")));
}

TEST_F(ConnectionTest, SoManyNamesAreResolvedAtATime) {
  const server::OutputEndpoint endpoint{.host = "nothing.invalid", .port = 1, .tls = false};
  std::vector<std::shared_ptr<void>> taken;
  // Those of other tests may still run.
  while (std::shared_ptr<void> turn = TakeLookup()) taken.push_back(std::move(turn));
  EXPECT_LE(taken.size(), static_cast<size_t>(kLookupsMax));
  EXPECT_GT(taken.size(), 0u);
  EXPECT_THAT(Open(endpoint), StatusIs(absl::StatusCode::kUnavailable,
                                       HasSubstr("32 names wait for a name server already")));
  taken.clear();
  EXPECT_THAT(Open(endpoint),
              StatusIs(absl::StatusCode::kUnavailable, Not(HasSubstr("names wait"))));
}

TEST_F(ConnectionTest, ItShowsWhetherAPeerClosed) {
  FakePeer closing([](Taken& taken) { taken.Read(); });
  const server::OutputEndpoint endpoint{.host = "127.0.0.1", .port = closing.port(), .tls = false};
  const auto connection = Connection::Open(endpoint, kPatience, &stop_);
  ASSERT_THAT(connection, IsOk());
  EXPECT_THAT((*connection)->StaysUp(absl::ZeroDuration()), IsOk());
  ASSERT_THAT((*connection)->Write("x", kPatience), IsOk());
  EXPECT_THAT((*connection)->StaysUp(kPatience),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("closed")));
}

}  // namespace
}  // namespace rips::outputs

#include "services/rpc/credentials.h"

#include <arpa/inet.h>
#include <grpc/support/sync.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "grpcpp/security/tls_certificate_provider.h"
#include "grpcpp/security/tls_credentials_options.h"
#include "grpcpp/server_builder.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/rpc/test_pki.h"
#include "services/rpc/test_service.h"
#include "services/runtime/atomic_file.h"

namespace rips::rpc {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
namespace tls = grpc::experimental;

constexpr char kSensorUri[] = "spiffe://fleet.example/robot/r1/sensor/base";
constexpr char kServerUri[] = "spiffe://fleet.example/policy-server/ps1";

// Minting takes a while, so the tests of one suite share two authorities.
struct Authorities {
  TestPki ours;
  TestPki foreign;  // of the same trust domain
};
Authorities* g_authorities = nullptr;
TestPki& Pki() { return g_authorities->ours; }
TestPki& ForeignPki() { return g_authorities->foreign; }

class WithAuthorities : public ::testing::Test {
 protected:
  static void SetUpTestSuite() { g_authorities = new Authorities(); }
  static void TearDownTestSuite() {
    delete g_authorities;
    g_authorities = nullptr;
  }
};
class OwnCertificateTest : public WithAuthorities {};
class CredentialsTest : public WithAuthorities {};
class PeerTest : public WithAuthorities {};
class MintTest : public WithAuthorities {};

TlsFiles MintUri(const std::string& folder, const std::string& uri) {
  return Pki().Mint({.folder = folder, .san = "URI:" + uri});
}

std::string Read(const std::string& path) { return *ReadFile(path, 1 << 20); }

grpc::SslServerCredentialsOptions::PemKeyCertPair PairOf(const TlsFiles& files) {
  return {Read(files.key), Read(files.cert)};
}

// A server that is not ours: any certificate, no demands on the client.
std::unique_ptr<RpcServer> StartRogue(const TlsFiles& files, TestService* service) {
  grpc::SslServerCredentialsOptions options;
  options.pem_key_cert_pairs.push_back(PairOf(files));
  auto server = RpcServer::Start(
      {.listen = "127.0.0.1:0", .credentials = grpc::SslServerCredentials(options)}, {service});
  RIPS_CHECK(server.ok(), server.status().ToString().c_str());
  return *std::move(server);
}

// A client that is not ours: any certificate or none, believes any server.
std::shared_ptr<grpc::ChannelCredentials> RogueClient(const TlsFiles* files) {
  tls::TlsChannelCredentialsOptions options;
  options.set_verify_server_certs(false);
  options.set_check_call_host(false);
  options.set_certificate_verifier(std::make_shared<tls::NoOpCertificateVerifier>());
  if (files != nullptr) {
    options.set_certificate_provider(std::make_shared<tls::StaticDataCertificateProvider>(
        "", std::vector<tls::IdentityKeyCertPair>{{Read(files->key), Read(files->cert)}}));
    options.watch_identity_key_cert_pairs();
  }
  return tls::TlsCredentials(options);
}

std::string OutputOf(const std::string& command) {
  std::string output;
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  char buffer[4096];
  for (size_t n; (n = fread(buffer, 1, sizeof buffer, pipe)) > 0;) output.append(buffer, n);
  pclose(pipe);
  return output;
}

std::string SClient(int port, const TlsFiles& files, const std::string& flags) {
  return OutputOf(absl::StrCat("timeout 20 openssl s_client -connect 127.0.0.1:", port, " -cert ",
                               files.cert, " -key ", files.key, " -CAfile ", files.ca, " -alpn h2 ",
                               flags, " </dev/null"));
}

TEST_F(OwnCertificateTest, SaysWhoAndUntilWhen) {
  const auto own = ReadOwnCertificate(Pki().Sensor());

  ASSERT_THAT(own, IsOk());
  EXPECT_EQ(ToString(own->identity), kSensorUri);
  EXPECT_GT(own->not_after, absl::Now() + absl::Hours(24 * 29));
  EXPECT_LT(own->not_after, absl::Now() + absl::Hours(24 * 31));
}

TEST_F(OwnCertificateTest, RefusesWhatCannotWork) {
  const TlsFiles sensor = Pki().Sensor();
  const TlsFiles server = Pki().Server();
  const std::string empty = sensor.cert + ".empty";
  ASSERT_THAT(WriteFileAtomically(empty, ""), IsOk());
  const std::string encrypted = sensor.key + ".encrypted";
  OutputOf(
      absl::StrCat("openssl ec -in ", sensor.key, " -aes256 -passout pass:x -out ", encrypted));
  struct Case {
    TlsFiles files;
    const char* message;
  };
  const Case cases[] = {
      {{sensor.ca, sensor.cert, server.key}, "`key` does not belong to the certificate"},
      {{sensor.ca, sensor.cert, sensor.cert}, "there is no unencrypted private key in `key`"},
      {{sensor.ca, sensor.cert, encrypted}, "there is no unencrypted private key in `key`"},
      {{sensor.ca, empty, sensor.key}, "there is no certificate in it"},
      {{empty, sensor.cert, sensor.key}, "there is no certificate in `ca`"},
      {{ForeignPki().dir() + "/ca.pem", sensor.cert, sensor.key}, "is not valid under `ca`"},
      {Pki().Mint({.folder = "own-none", .san = ""}), "has 0 URI names; it must have exactly one"},
      {Pki().Mint({.folder = "own-dns", .san = "DNS:ps1"}), "has 0 URI names"},
      {Pki().Mint(
           {.folder = "own-two", .san = absl::StrCat("URI:", kSensorUri, ",URI:", kServerUri)}),
       "has 2 URI names"},
      {MintUri("own-form", "spiffe://fleet.example/robot/r1/camera/base"),
       "names no policy server"},
      {MintUri("own-domain", "spiffe://evil.test/policy-server/ps1"),
       "permitted subtree violation"},
      {Pki().Mint({.folder = "own-old", .san = absl::StrCat("URI:", kSensorUri), .days = 0}),
       "certificate has expired; it was valid until 20"},
  };
  for (const Case& c : cases) {
    EXPECT_THAT(ReadOwnCertificate(c.files),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(c.message)))
        << c.message;
  }
  EXPECT_THAT(Credentials::Load({sensor.ca, sensor.cert + ".no", sensor.key}),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("cert.pem.no")));
}

TEST_F(CredentialsTest, TellsTheServerWhoCalls) {
  struct Case {
    TlsFiles files;
    const char* uri;
  };
  const Case cases[] = {
      {Pki().Sensor(), kSensorUri},
      {Pki().Actuator("r1", "laptop"), "spiffe://fleet.example/robot/r1/actuator/laptop"},
      {Pki().Operator("viewer", "bob"), "spiffe://fleet.example/operator/viewer/bob"},
  };
  TestService service;
  const auto server = StartOrDie("127.0.0.1:0", Pki().Server(), &service);
  for (const Case& c : cases) {
    TestClient client(ClientOptions(server->address(), c.files));
    const auto received = service.received.Pop(kPatience);
    ASSERT_TRUE(received.has_value());
    EXPECT_EQ(received->peer, c.uri);
    EXPECT_EQ(service.peer_not_after, absl::ToUnixSeconds(ReadOwnCertificate(c.files)->not_after));
  }
}

TEST_F(CredentialsTest, ClientTalksOnlyToAPolicyServerOfItsDomain) {
  struct Case {
    const char* what;
    TlsFiles server;
    bool accepted;
  };
  const Case cases[] = {
      {"the policy server", Pki().Server(), true},
      {"a policy server without usages",
       MintUri("srv-plain", "spiffe://fleet.example/policy-server/ps2"), true},
      {"a sensor", Pki().Sensor(), false},
      {"a sensor fit for a server", MintUri("srv-sensor", kSensorUri), false},
      {"an actuator fit for a server",
       MintUri("srv-actuator", "spiffe://fleet.example/robot/r1/actuator/base"), false},
      {"an operator fit for a server",
       MintUri("srv-admin", "spiffe://fleet.example/operator/admin/alice"), false},
      {"two names",
       Pki().Mint(
           {.folder = "srv-two", .san = absl::StrCat("URI:", kServerUri, ",URI:", kSensorUri)}),
       false},
      {"a host name only", Pki().Mint({.folder = "srv-dns", .san = "DNS:localhost,IP:127.0.0.1"}),
       false},
      {"another domain, under our issuing CA",
       MintUri("srv-domain", "spiffe://evil.test/policy-server/ps1"), false},
      {"another domain, under our root",
       Pki().Mint({.folder = "srv-root",
                   .san = "URI:spiffe://evil.test/policy-server/ps1",
                   .by_root = true}),
       false},
      {"another authority", ForeignPki().Server(), false},
      {"an expired one",
       Pki().Mint({.folder = "srv-old", .san = absl::StrCat("URI:", kServerUri), .days = 0}),
       false},
  };
  for (const Case& c : cases) {
    TestService service;
    service.require_peer = false;
    const auto server = StartRogue(c.server, &service);
    TestClient client(ClientOptions(server->address(), Pki().Actuator()));
    if (c.accepted) {
      EXPECT_TRUE(service.received.Pop(kPatience).has_value()) << c.what;
      continue;
    }
    const auto end = client.ends.Pop(kPatience);
    ASSERT_TRUE(end.has_value()) << c.what;
    EXPECT_EQ(end->status.error_code(), grpc::StatusCode::UNAVAILABLE) << c.what;
    EXPECT_EQ(client.connected, 0u) << c.what;
    EXPECT_EQ(service.calls, 0) << c.what;
  }
}

TEST_F(CredentialsTest, ServerTakesOnlyIdentitiesOfItsDomain) {
  struct Case {
    const char* what;
    std::shared_ptr<grpc::ChannelCredentials> client;
    bool accepted;
  };
  const auto rogue = [](const TlsFiles& files) { return RogueClient(&files); };
  const Case cases[] = {
      {"a sensor", rogue(Pki().Sensor()), true},
      {"no certificate", RogueClient(nullptr), false},
      {"plain text", grpc::InsecureChannelCredentials(), false},
      {"another authority", rogue(ForeignPki().Sensor()), false},
      {"another domain, under our issuing CA",
       rogue(MintUri("cl-domain", "spiffe://evil.test/robot/r1/sensor/base")), false},
      {"another domain, under our root",
       rogue(Pki().Mint({.folder = "cl-root",
                         .san = "URI:spiffe://evil.test/robot/r1/sensor/base",
                         .by_root = true})),
       false},
      {"two names",
       rogue(Pki().Mint(
           {.folder = "cl-two", .san = absl::StrCat("URI:", kSensorUri, ",URI:", kSensorUri)})),
       false},
      {"no name", rogue(Pki().Mint({.folder = "cl-none", .san = ""})), false},
      {"an unknown role", rogue(MintUri("cl-role", "spiffe://fleet.example/robot/r1/camera/base")),
       false},
      {"an expired one",
       rogue(Pki().Mint({.folder = "cl-old", .san = absl::StrCat("URI:", kSensorUri), .days = 0})),
       false},
  };
  TestService service;
  const auto server = StartOrDie("127.0.0.1:0", Pki().Server(), &service);
  for (const Case& c : cases) {
    const int calls = service.calls;
    BidiClientOptions options = ClientOptions(server->address(), Pki().Sensor());
    options.credentials = c.client;
    TestClient client(options);
    if (c.accepted) {
      EXPECT_TRUE(service.received.Pop(kPatience).has_value()) << c.what;
      continue;
    }
    const auto end = client.ends.Pop(kPatience);
    ASSERT_TRUE(end.has_value()) << c.what;
    EXPECT_EQ(end->status.error_code(), grpc::StatusCode::UNAVAILABLE) << c.what;
    EXPECT_EQ(service.calls, calls) << c.what;
  }
}

TEST_F(CredentialsTest, SpeaksOnlyTls13) {
  TestService service;
  const auto server = StartOrDie("127.0.0.1:0", Pki().Server(), &service);

  const std::string with_13 = SClient(server->port(), Pki().Sensor(), "-tls1_3");
  EXPECT_THAT(with_13, HasSubstr("New, TLSv1.3, Cipher is TLS_"));
  EXPECT_THAT(with_13, HasSubstr("ALPN protocol: h2"));
  for (const char* flags :
       {"-tls1_2", "-tls1_2 -cipher ALL:@SECLEVEL=0", "-tls1_1", "-no_tls1_3"}) {
    const std::string old = SClient(server->port(), Pki().Sensor(), flags);
    EXPECT_THAT(old, HasSubstr("Cipher is (NONE)")) << flags;
    EXPECT_THAT(old, Not(HasSubstr("BEGIN CERTIFICATE"))) << flags;
  }
}

TEST_F(CredentialsTest, ServesOthersWhileOneSendsRubbish) {
  TestService service;
  const auto server = StartOrDie("127.0.0.1:0", Pki().Server(), &service);
  TestClient before(ClientOptions(server->address(), Pki().Sensor()));
  ASSERT_TRUE(before.replies.Pop(kPatience).has_value());

  for (const std::string& bytes :
       {std::string("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"), std::string("GET / HTTP/1.1\r\n\r\n"),
        std::string(100000, '\0'), std::string("\x16\x03\x01\xff\xff\x01")}) {
    const int fd = socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<uint16_t>(server->port()));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    ASSERT_EQ(connect(fd, reinterpret_cast<sockaddr*>(&to), sizeof to), 0);
    send(fd, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    shutdown(fd, SHUT_WR);
    char buffer[4096];
    std::string answer;
    for (ssize_t n; (n = recv(fd, buffer, sizeof buffer, 0)) > 0;) answer.append(buffer, n);
    EXPECT_LE(answer.size(), 7u);  // at most one TLS alert
    close(fd);
  }

  EXPECT_TRUE(before.client.Send(TestClient::Heartbeat(7)));
  const auto reply = before.replies.Pop(kPatience);
  ASSERT_TRUE(reply.has_value());
  EXPECT_EQ(reply->heartbeat().echo_boottime_ns(), 7u);
  TestClient after(ClientOptions(server->address(), Pki().Actuator()));
  EXPECT_TRUE(after.replies.Pop(kPatience).has_value());
}

TEST_F(CredentialsTest, UsesARenewedCertificateAndKeepsStreams) {
  TestService service;
  const TlsFiles files = Pki().Server("ps9");
  const auto server = StartOrDie("127.0.0.1:0", files, &service);
  TestClient client(ClientOptions(server->address(), Pki().Sensor()));
  ASSERT_TRUE(client.replies.Pop(kPatience).has_value());
  const auto served = [&] {
    return OutputOf(absl::StrCat("timeout 20 openssl s_client -connect 127.0.0.1:", server->port(),
                                 " -alpn h2 -cert ", files.cert, " -key ", files.key,
                                 " </dev/null 2>/dev/null | openssl x509 -noout -serial"));
  };
  const auto on_disk = [&] { return OutputOf("openssl x509 -noout -serial -in " + files.cert); };
  const std::string old_serial = on_disk();
  ASSERT_EQ(served(), old_serial);

  Pki().RenewServer("ps9");

  ASSERT_NE(on_disk(), old_serial);
  const absl::Time deadline = absl::Now() + kPatience;
  while (served() != on_disk() && absl::Now() < deadline) {
  }
  EXPECT_EQ(served(), on_disk());
  EXPECT_TRUE(client.client.Send(TestClient::Heartbeat(3)));
  EXPECT_EQ(client.replies.Pop(kPatience)->heartbeat().echo_boottime_ns(), 3u);
  EXPECT_EQ(client.ends.size(), 0u);
}

TEST_F(PeerTest, RefusesACallWithoutACertificate) {
  TestService service;
  const auto server = RpcServer::Start(
      {.listen = "127.0.0.1:0", .credentials = grpc::InsecureServerCredentials()}, {&service});
  ASSERT_THAT(server, IsOk());
  BidiClientOptions options = ClientOptions((*server)->address(), Pki().Sensor());
  options.credentials = grpc::InsecureChannelCredentials();
  TestClient client(options);

  const auto end = client.ends.Pop(kPatience);

  ASSERT_TRUE(end.has_value());
  EXPECT_EQ(end->status.error_code(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(end->close_class, CloseClass::kReidentify);
}

TEST_F(MintTest, KeepsWhatIsGoodAndRefusesMistakes) {
  const std::string mint = absl::StrCat(RIPS_SOURCE_DIR, "/deploy/pki/mint --dir ", Pki().dir());
  const std::string key = Read(Pki().Server("ps3").key);
  const std::string ours = mint + " --trust-domain fleet.example ";

  EXPECT_THAT(OutputOf(ours + "server ps3"), HasSubstr("kept "));
  EXPECT_EQ(Read(Pki().Server("ps3").key), key);
  EXPECT_THAT(OutputOf(ours + "init"), HasSubstr("kept "));
  EXPECT_THAT(OutputOf(ours + "--renew server ps3"), HasSubstr("minted "));
  EXPECT_NE(Read(Pki().Server("ps3").key), key);
  EXPECT_THAT(OutputOf(ours + "server PS3"), HasSubstr("`PS3` is not a valid server id"));
  EXPECT_THAT(OutputOf(ours + "sensor r1"), HasSubstr("usage: mint ... sensor ROBOT HOST"));
  EXPECT_THAT(OutputOf(ours + "operator root alice"), HasSubstr("is not an operator's role"));
  EXPECT_THAT(OutputOf(mint + " --trust-domain evil.test server ps3"),
              HasSubstr("belongs to trust domain fleet.example, not evil.test"));
  EXPECT_THAT(OutputOf("find " + Pki().dir() + " -name '*key*' -type f ! -perm 0600"), "");
  EXPECT_THAT(
      OutputOf(absl::StrCat("openssl x509 -noout -text -in ", Pki().dir(), "/ca/issuing.pem")),
      HasSubstr("Name Constraints: critical\n                Permitted:\n"
                "                  URI:fleet.example"));
}

class CredentialsSourceTest : public WithAuthorities {};

// OK for the sensor r1/base.
absl::Status IsOurs(const PeerIdentity& self) {
  if (ToString(self) == kSensorUri) return absl::OkStatus();
  return absl::PermissionDeniedError("another's");
}

TEST_F(CredentialsSourceTest, FilesThatComeLateAreUsedWhenTheyAreThere) {
  const TlsFiles good = Pki().Sensor();
  TlsFiles late = good;
  late.key = absl::StrCat(Pki().dir(), "/late.pem");
  CredentialsSource source(late);
  source.Require(IsOurs);
  EXPECT_THAT(source.Get(), StatusIs(absl::StatusCode::kUnauthenticated, HasSubstr("late.pem")));
  ASSERT_THAT(WriteFileAtomically(late.key, "-----BEGIN EC PRIV"), IsOk());  // half a key
  EXPECT_THAT(source.Get(), StatusIs(absl::StatusCode::kUnauthenticated));

  ASSERT_THAT(WriteFileAtomically(late.key, Read(good.key)), IsOk());

  const auto usable = source.Get();
  ASSERT_THAT(usable, IsOk());
  EXPECT_EQ(ToString(usable->own->self()), kSensorUri);
}

TEST_F(CredentialsSourceTest, ACertificateThatIsNotValidYetIsWaitedFor) {
  CredentialsSource source(
      Pki().Mint({.folder = "early", .san = absl::StrCat("URI:", kSensorUri), .age_seconds = -60}));
  source.Require(IsOurs);
  EXPECT_THAT(source.Get(), StatusIs(absl::StatusCode::kUnauthenticated,
                                     AllOf(HasSubstr("not yet valid; it is valid from 20"),
                                           HasSubstr(" UTC, and the clock of this host says 20"))));
  const std::string once(source.Get().status().message());
  EXPECT_EQ(source.Get().status().message(), once);
}

TEST_F(CredentialsSourceTest, ACertificateOfAnotherIsRefusedWhateverItsTimes) {
  CredentialsSource source(Pki().Mint(
      {.folder = "early-server", .san = absl::StrCat("URI:", kServerUri), .age_seconds = -60}));
  source.Require(IsOurs);
  EXPECT_THAT(source.Get(), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("another's")));
}

TEST_F(CredentialsSourceTest, AnotherIdentityThatTakesItsPlaceLaterIsRefusedAndIsNoReasonToEnd) {
  const TlsFiles ours = Pki().Sensor();
  const TlsFiles anothers = Pki().Sensor("r2");
  const std::string base = Pki().dir() + "/replaced-";
  const TlsFiles files{.ca = ours.ca, .cert = base + "cert.pem", .key = base + "key.pem"};
  const auto put = [&files](const TlsFiles& from) {
    ASSERT_THAT(WriteFileAtomically(files.key, Read(from.key)), IsOk());
    ASSERT_THAT(WriteFileAtomically(files.cert, Read(from.cert)), IsOk());
  };
  put(ours);
  CredentialsSource source(files);
  source.Require(IsOurs);
  ASSERT_THAT(source.Get(), IsOk());
  put(anothers);
  EXPECT_THAT(source.Get(), StatusIs(absl::StatusCode::kUnauthenticated, HasSubstr("another's")));
  ASSERT_THAT(WriteFileAtomically(files.cert, "half"), IsOk());
  EXPECT_THAT(source.Get(), IsOk()) << "what was read before may do";
  put(ours);
  EXPECT_THAT(source.Get(), IsOk());
}

TEST_F(CredentialsSourceTest, AKeyThatOthersMayReadIsRefused) {
  TlsFiles files = Pki().Sensor();
  const std::string pem = Read(files.key);
  files.key = Pki().dir() + "/open-key.pem";
  ASSERT_THAT(WriteFileAtomically(files.key, pem), IsOk());
  ASSERT_EQ(chmod(files.key.c_str(), 0644), 0);
  const auto refused = StatusIs(absl::StatusCode::kPermissionDenied,
                                HasSubstr(absl::StrCat("`chmod o-rwx ", files.key, "`")));
  CredentialsSource source(files);
  source.Require(IsOurs);
  EXPECT_THAT(source.Get(), refused);
  std::string warning = "of before";
  EXPECT_THAT(CheckOwn(files, IsOurs, &warning), refused);
  TlsFiles without = files;
  without.cert = "/nonexistent";
  EXPECT_THAT(CheckOwn(without, IsOurs, &warning), refused) << "whatever else is wrong";

  ASSERT_EQ(chmod(files.key.c_str(), 0600), 0);
  EXPECT_THAT(CheckOwn(files, IsOurs, &warning), IsOk());
  EXPECT_EQ(warning, "");
  EXPECT_THAT(source.Get(), IsOk());
}

// Of an authority of its own: lists name all that was ever revoked.
class RevocationTest : public ::testing::Test {
 protected:
  TlsFiles Listed(TlsFiles files) {
    files.crl = pki_.dir() + "/crl.pem";
    return files;
  }
  std::vector<CertificateId> ChainOf(const TlsFiles& files) { return ReadChain(Read(files.cert)); }

  TestPki pki_;
};

TEST_F(RevocationTest, NamesWhatIsOnTheListAndNothingElse) {
  const TlsFiles sensor = pki_.Sensor();
  const TlsFiles actuator = pki_.Actuator();
  pki_.Revoke(sensor);

  const auto lists = Revocations::Open(Listed(pki_.Server()));

  ASSERT_THAT(lists, IsOk());
  EXPECT_TRUE((*lists)->Revoke(ChainOf(sensor)));
  EXPECT_FALSE((*lists)->Revoke(ChainOf(actuator)));
  EXPECT_THAT((*lists)->problem(absl::Now()), IsOk());
}

TEST_F(RevocationTest, WhatIsMintedAfterARevocationIsNew) {
  const TlsFiles sensor = pki_.Sensor();
  const std::vector<CertificateId> old = ChainOf(sensor);
  EXPECT_EQ(ChainOf(pki_.Sensor())[0].serial, old[0].serial) << "a good one is kept";
  pki_.Revoke(sensor);

  EXPECT_NE(ChainOf(pki_.Sensor())[0].serial, old[0].serial);
}

TEST_F(RevocationTest, ANewListCountsWhenItIsThere) {
  const TlsFiles sensor = pki_.Sensor();
  pki_.SignRevocations();
  const auto lists = Revocations::Open(Listed(pki_.Server()));
  ASSERT_THAT(lists, IsOk());
  EXPECT_FALSE((*lists)->Revoke(ChainOf(sensor)));

  pki_.Revoke(sensor);
  (*lists)->Refresh();

  EXPECT_TRUE((*lists)->Revoke(ChainOf(sensor)));
}

TEST_F(RevocationTest, WhatCannotBeReadLaterLeavesTheLastGoodListInForce) {
  const TlsFiles sensor = pki_.Sensor();
  const std::string path = pki_.SignRevocations();
  const std::string older = Read(path);
  const auto lists = Revocations::Open(Listed(pki_.Server()));
  ASSERT_THAT(lists, IsOk());
  absl::SleepFor(absl::Seconds(1));  // lists have times of whole seconds
  const std::string newer = Read(pki_.Revoke(sensor));
  (*lists)->Refresh();
  ASSERT_TRUE((*lists)->Revoke(ChainOf(sensor)));

  const std::string half = newer.substr(0, newer.size() / 2);
  for (const std::string& bad : {half, std::string(), older, std::string("nonsense")}) {
    ASSERT_THAT(WriteFileAtomically(path, bad), IsOk());
    (*lists)->Refresh();
    EXPECT_TRUE((*lists)->Revoke(ChainOf(sensor))) << bad;
    EXPECT_THAT((*lists)->problem(absl::Now()), Not(IsOk())) << bad;
  }
  unlink(path.c_str());
  (*lists)->Refresh();
  EXPECT_TRUE((*lists)->Revoke(ChainOf(sensor)));
  EXPECT_THAT((*lists)->problem(absl::Now()), Not(IsOk()));

  ASSERT_THAT(WriteFileAtomically(path, newer), IsOk());
  (*lists)->Refresh();
  EXPECT_THAT((*lists)->problem(absl::Now()), IsOk());
}

TEST_F(RevocationTest, AnOutdatedListStaysInForceAndIsAProblem) {
  const TlsFiles sensor = pki_.Sensor();
  pki_.Revoke(sensor);
  const auto lists = Revocations::Open(Listed(pki_.Server()));
  ASSERT_THAT(lists, IsOk());

  EXPECT_THAT((*lists)->problem(absl::Now() + absl::Hours(24 * 29)), IsOk());
  EXPECT_THAT((*lists)->problem(absl::Now() + absl::Hours(24 * 31)),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("it stays in force")));
  EXPECT_TRUE((*lists)->Revoke(ChainOf(sensor)));
}

TEST_F(RevocationTest, AListOfAnotherAuthorityIsNone) {
  TestPki foreign;
  TlsFiles files = pki_.Server();
  files.crl = foreign.SignRevocations();
  EXPECT_THAT(Revocations::Open(files), StatusIs(absl::StatusCode::kInvalidArgument,
                                                 HasSubstr("no authority under `ca` signed")));
  files.crl = "/nonexistent.pem";
  EXPECT_THAT(Credentials::Load(files), StatusIs(absl::StatusCode::kNotFound));
}

TEST_F(RevocationTest, ADirectoryOfListsIsOne) {
  const TlsFiles sensor = pki_.Sensor();
  const std::string list = Read(pki_.Revoke(sensor));
  TlsFiles files = pki_.Server();
  files.crl = pki_.dir() + "/lists";
  ASSERT_EQ(mkdir(files.crl.c_str(), 0700), 0);
  ASSERT_THAT(WriteFileAtomically(files.crl + "/notes.txt", "not a list"), IsOk());
  EXPECT_THAT(Revocations::Open(files), StatusIs(absl::StatusCode::kInvalidArgument));
  ASSERT_THAT(WriteFileAtomically(files.crl + "/issuing.crl", list), IsOk());

  const auto lists = Revocations::Open(files);
  ASSERT_THAT(lists, IsOk());
  EXPECT_TRUE((*lists)->Revoke(ChainOf(sensor)));
}

TEST_F(RevocationTest, ARevokedServerIsRefusedInTheHandshake) {
  TestService service;
  const TlsFiles server_files = pki_.Server();
  const auto server = StartOrDie("127.0.0.1:0", server_files, &service);
  pki_.Revoke(server_files);

  TestClient client(
      {.servers = {server->address()}, .credentials = LoadOrDie(Listed(pki_.Sensor()))});

  const auto end = client.ends.Pop(kPatience);
  ASSERT_TRUE(end.has_value());
  EXPECT_FALSE(end->status.ok());
  EXPECT_EQ(service.calls, 0);
}

// Takes two of gRPC's locks in one order, then in the other; no thread waits for either.
void LockInBothOrders() {
  gpr_mu first;
  gpr_mu second;
  gpr_mu_init(&first);
  gpr_mu_init(&second);
  const auto lock = [](gpr_mu* outer, gpr_mu* inner) {
    gpr_mu_lock(outer);
    gpr_mu_lock(inner);
    gpr_mu_unlock(inner);
    gpr_mu_unlock(outer);
  };
  lock(&first, &second);
  lock(&second, &first);
}

TEST(GrpcLockOrderTest, EndsNoDaemon) {
  testing::FLAGS_gtest_death_test_style = "threadsafe";
  EXPECT_DEATH(LockInBothOrders(), "potential deadlock") << "abseil does not watch any more";
  EXPECT_EXIT(
      {
        TrustGrpcLockOrder();
        LockInBothOrders();
        std::_Exit(0);
      },
      testing::ExitedWithCode(0), "");
}

}  // namespace
}  // namespace rips::rpc

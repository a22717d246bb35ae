// Robots that fetch and renew their certificates, over real gRPC and TLS.
#include "policy_server/server/enrol/enrolment_service.h"

#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/sqlite_enrolments.h"
#include "services/base/status_matchers.h"
#include "services/enrol/fetch.h"
#include "services/pki/key_request.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/real_clock.h"

namespace rips::enrol {
namespace {

using ::testing::HasSubstr;

constexpr absl::Duration kPatience = absl::Seconds(60);

std::string Content(const std::string& path) { return ReadFile(path, 1 << 20).value_or(""); }

class EnrolmentServiceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    store_ = *store::SqliteEnrolments::Open(pki_.dir() + "/enrolment.db");
    enrolment_.emplace(EnrolmentOptions{.files = {.cert = pki_.dir() + "/ca/issuing.pem",
                                                  .key = pki_.dir() + "/ca/issuing.key",
                                                  .ca = pki_.dir() + "/ca.pem"},
                                        .trust_domain = "fleet.example"},
                       store_.get(), &clock_,
                       EnrolmentPorts{.is_banned = [](const auto&, const auto&) { return false; },
                                      .tell = [](const auto&, auto, const auto&) {},
                                      .issued = [](const auto&) {}});
    enrolment_->SetInventory(
        {.robots = {
             {.id = "r1", .bundle = "b", .sensors = {{.host = "base"}}, .actuators = {"base"}},
             {.id = "r2", .bundle = "b", .sensors = {{.host = "base"}}}}});
    Serve(&*enrolment_);
    folder_.emplace(pki_.dir() + "/robot-sensor");
  }
  void Serve(Enrolment* enrolment) {
    server_.reset();
    service_.reset();
    service_ = std::make_unique<EnrolmentService>(enrolment, &watch_, nullptr);
    credentials_ = *rpc::Credentials::Load(pki_.Server());
    auto server = rpc::RpcServer::Start(
        {.listen = "127.0.0.1:0", .credentials = credentials_->ForServer()}, {service_.get()});
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
  }
  // As `ripsctl enrol create-token` makes it.
  v1::EnrolmentToken Token(const std::string& robot = "r1") {
    v1::EnrolmentToken token;
    token.set_key_pem(*pki::NewKey());
    const auto made = enrolment_->CreateToken(
        {.robot = robot, .host = "base", .request_pem = *pki::RequestFor(token.key_pem())});
    EXPECT_THAT(made, IsOk());
    token.set_id(made->record.id);
    token.set_server(server_->address());
    token.set_robot(robot);
    token.set_host("base");
    token.add_roles("sensor");
    token.set_authorities_pem(made->fetched.authorities_pem);
    token.set_certificates_pem(made->fetched.certificates_pem);
    return token;
  }
  grpc::Status CallWith(const TlsFiles& files, bool renew) {
    const auto own = *rpc::Credentials::Load(files);
    const auto stub =
        rips::v1::EnrolmentService::NewStub(rpc::MakeChannel(server_->address(), own->ForClient()));
    grpc::ClientContext context;
    context.set_deadline(absl::ToChronoTime(absl::Now() + kPatience));
    rips::v1::IssuedCertificate issued;
    if (renew) {
      rips::v1::RenewRequest request;
      request.set_request_pem(*pki::RequestFor(*pki::NewKey()));
      return stub->Renew(&context, request, &issued);
    }
    rips::v1::EnrolRequest request;
    request.set_role("sensor");
    request.set_request_pem(*pki::RequestFor(*pki::NewKey()));
    return stub->Enrol(&context, request, &issued);
  }

  rpc::TestPki pki_;
  RealClock clock_;
  rpc::CallGate gate_{&clock_, nullptr, nullptr};
  rpc::SessionWatch watch_{&clock_, absl::InfiniteDuration(), &gate_};
  std::unique_ptr<store::SqliteEnrolments> store_;
  std::optional<Enrolment> enrolment_;
  std::shared_ptr<const rpc::Credentials> credentials_;
  std::unique_ptr<EnrolmentService> service_;
  std::unique_ptr<rpc::RpcServer> server_;
  std::optional<KeyFolder> folder_;
};

TEST_F(EnrolmentServiceTest, ARobotFetchesItsCertificateAndRenewsIt) {
  const auto first = FetchFirst(Token(), "sensor", *folder_, kPatience);
  ASSERT_THAT(first, IsOk());
  EXPECT_EQ(rpc::ToString(first->identity), "spiffe://fleet.example/robot/r1/sensor/base");
  const auto present = Present(*folder_);
  ASSERT_THAT(present, IsOk());
  EXPECT_EQ(present->serial, first->serial);
  EXPECT_EQ(folder_->Server(), server_->address());

  const auto second = Renew(*folder_, folder_->Server(), kPatience);
  ASSERT_THAT(second, IsOk());
  EXPECT_NE(second->serial, first->serial);
  EXPECT_EQ(Present(*folder_)->serial, second->serial);
  EXPECT_THAT(Renew(*folder_, folder_->Server(), kPatience),
              StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_EQ(Present(*folder_)->serial, second->serial) << "and nothing changes";
}

TEST_F(EnrolmentServiceTest, ASecondRobotWithTheSameTokenIsRefused) {
  const v1::EnrolmentToken token = Token();
  ASSERT_THAT(FetchFirst(token, "sensor", *folder_, kPatience), IsOk());
  const KeyFolder thief(pki_.dir() + "/thief");
  const auto stolen = FetchFirst(token, "sensor", thief, kPatience);
  EXPECT_FALSE(stolen.ok());
  EXPECT_FALSE(Present(thief).ok());
}

TEST_F(EnrolmentServiceTest, AHostDoesNotBecomeAnotherRobotUnasked) {
  ASSERT_THAT(FetchFirst(Token("r1"), "sensor", *folder_, kPatience), IsOk());
  const v1::EnrolmentToken token = Token("r2");
  EXPECT_THAT(FetchFirst(token, "sensor", *folder_, kPatience),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("--replace-identity")));
  EXPECT_EQ(Present(*folder_)->identity.robot, "r1");
  ASSERT_THAT(FetchFirst(token, "sensor", *folder_, kPatience, /*replace_identity=*/true), IsOk());
  EXPECT_EQ(Present(*folder_)->identity.robot, "r2");
}

TEST_F(EnrolmentServiceTest, ATokenThatHasExpiredSaysSoAndWhatToDo) {
  v1::EnrolmentToken token = Token();
  const TlsFiles old = pki_.Mint(
      {.folder = "old", .san = "URI:spiffe://fleet.example/enrolment/00112233aabbccdd", .days = 0});
  token.set_certificates_pem(Content(old.cert));
  token.set_key_pem(Content(old.key));
  absl::SleepFor(absl::Seconds(1));  // it is good for the second in which it was made
  EXPECT_THAT(FetchFirst(token, "sensor", *folder_, kPatience),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("ask an admin for a new one, or set the clock")));
}

TEST_F(EnrolmentServiceTest, ATokenIsPinnedToItsAuthority) {
  rpc::TestPki other;
  v1::EnrolmentToken token = Token();
  token.set_authorities_pem(Content(other.dir() + "/ca.pem"));
  EXPECT_THAT(
      FetchFirst(token, "sensor", *folder_, absl::Seconds(5)),
      StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("damaged, or of another fleet")));
  EXPECT_FALSE(Present(*folder_).ok());
}

TEST_F(EnrolmentServiceTest, EachCallIsForOneKindOfCertificate) {
  const auto refused = grpc::StatusCode::PERMISSION_DENIED;
  EXPECT_EQ(CallWith(pki_.Sensor(), false).error_code(), refused);
  EXPECT_EQ(CallWith(pki_.Actuator(), false).error_code(), refused);
  EXPECT_EQ(CallWith(pki_.Operator("admin", "eve"), false).error_code(), refused);
  EXPECT_EQ(CallWith(pki_.Operator("admin", "eve"), true).error_code(), refused);
  EXPECT_EQ(CallWith(pki_.Server(), true).error_code(), refused);
  EXPECT_EQ(CallWith(pki_.Sensor("r1", "leg"), true).error_code(), refused) << "not listed";
  EXPECT_EQ(CallWith(pki_.Sensor(), true).error_code(), grpc::StatusCode::OK);
  EXPECT_EQ(CallWith(pki_.Actuator(), true).error_code(), grpc::StatusCode::OK);
}

TEST_F(EnrolmentServiceTest, AServerWithoutAnIssuingKeySaysSo) {
  const v1::EnrolmentToken token = Token();
  Serve(nullptr);
  EXPECT_EQ(CallWith(pki_.Sensor(), true).error_code(), grpc::StatusCode::UNIMPLEMENTED);
}

TEST_F(EnrolmentServiceTest, AServerThatIsAwayLeavesTheKeyPending) {
  v1::EnrolmentToken token = Token();
  const std::string address = token.server();
  token.set_server("127.0.0.1:1");
  EXPECT_FALSE(FetchFirst(token, "sensor", *folder_, absl::Seconds(5)).ok());
  const std::string pending = *folder_->PendingKey();
  token.set_server(address);
  ASSERT_THAT(FetchFirst(token, "sensor", *folder_, kPatience), IsOk());
  EXPECT_EQ(Content(folder_->tls().key), pending);
}

TEST(IsDueTest, BeforeTheServersFirstNotice) {
  const absl::Time begin = absl::UnixEpoch();
  const rpc::Peer peer{.not_after = begin + absl::Hours(100), .not_before = begin};
  EXPECT_FALSE(IsDue(peer, begin + absl::Hours(59)));
  EXPECT_TRUE(IsDue(peer, begin + absl::Hours(60)));
  EXPECT_TRUE(IsDue(peer, begin + absl::Hours(1000)));
}

}  // namespace
}  // namespace rips::enrol

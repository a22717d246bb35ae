#include "policy_server/server/enrol/enrolment.h"

#include <filesystem>
#include <fstream>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/sqlite_enrolments.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"
#include "services/pki/key_request.h"
#include "services/rpc/test_pki.h"

namespace rips::enrol {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr char kAdmin[] = "spiffe://fleet.example/operator/admin/root serial 1f";

class EnrolmentTest : public ::testing::Test {
 protected:
  EnrolmentTest() {
    // Certificates are checked by the real time.
    clock_.JumpUnix(absl::ToUnixNanos(absl::Now()) - clock_.Now().unix_ns);
    store_ = *store::SqliteEnrolments::Open(pki_.dir() + "/enrolment.db");
    Make(pki_.dir() + "/ca/issuing.key");
    enrolment_->SetInventory(
        {.robots = {{.id = "r1",
                     .bundle = "b",
                     .sensors = {{.host = "base", .primary = true}, {.host = "arm"}},
                     .actuators = {"base"}}}});
  }
  void Make(const std::string& key) {
    files_ = {.cert = pki_.dir() + "/ca/issuing.pem", .key = key, .ca = pki_.dir() + "/ca.pem"};
    enrolment_ = std::make_unique<Enrolment>(
        EnrolmentOptions{.files = files_, .trust_domain = "fleet.example", .life = absl::Hours(24)},
        store_.get(), &clock_,
        EnrolmentPorts{.is_banned =
                           [this](const rpc::PeerIdentity& identity, const std::string& serial) {
                             const std::string uri = rpc::ToString(identity);
                             return banned_.contains(uri) || banned_.contains(uri + " " + serial);
                           },
                       .tell =
                           [this](const std::string& robot, engine::Severity severity,
                                  const std::string& text) {
                             alerts_.push_back(
                                 absl::StrCat(robot, " ", engine::ToString(severity), " ", text));
                           },
                       .issued =
                           [this](const rpc::Peer& agent) {
                             issued_.push_back(rpc::ToString(agent.identity));
                           }});
  }
  absl::StatusOr<NewToken> Token(const std::string& host = "base",
                                 std::vector<std::string> roles = {}) {
    return enrolment_->CreateToken({.robot = "r1",
                                    .host = host,
                                    .roles = std::move(roles),
                                    .request_pem = *pki::RequestFor(*pki::NewKey()),
                                    .by = kAdmin});
  }
  // Who shows the token's certificate.
  static rpc::PeerIdentity Holder(const NewToken& token) {
    return rpc::ReadLeaf(token.fetched.certificates_pem)->identity;
  }
  absl::StatusOr<Fetched> Enrol(const NewToken& token, const std::string& role,
                                const std::string& key) {
    clock_.Advance(absl::ToInt64Nanoseconds(kBetweenFetches));
    return enrolment_->Enrol(Holder(token), role, *pki::RequestFor(key));
  }

  rpc::TestPki pki_;
  FakeClock clock_;
  std::unique_ptr<store::SqliteEnrolments> store_;
  IssuingFiles files_;
  std::unique_ptr<Enrolment> enrolment_;
  std::vector<std::string> alerts_;
  std::vector<std::string> issued_;
  // URIs, and URIs with a blank and a serial.
  std::set<std::string> banned_;
};

constexpr char kSensor[] = "spiffe://fleet.example/robot/r1/sensor/base";

TEST_F(EnrolmentTest, ATokenFetchesEachOfItsCertificatesOnce) {
  const auto token = Token();
  ASSERT_THAT(token, IsOk());
  EXPECT_EQ(token->record.roles, "actuator,sensor") << "what the inventory lists on that host";
  EXPECT_EQ(Holder(*token).role, rpc::Role::kEnrolment);
  const std::string key = *pki::NewKey();
  const auto sensor = Enrol(*token, "sensor", key);
  ASSERT_THAT(sensor, IsOk());
  EXPECT_THAT(rpc::CheckChain(sensor->authorities_pem, sensor->certificates_pem, key), IsOk());
  EXPECT_EQ(rpc::ToString(rpc::ReadLeaf(sensor->certificates_pem)->identity), kSensor);
  ASSERT_THAT(Enrol(*token, "actuator", *pki::NewKey()), IsOk());
  const auto again = Enrol(*token, "sensor", key);
  ASSERT_THAT(again, IsOk()) << "the answer was lost";
  EXPECT_EQ(again->certificates_pem, sensor->certificates_pem) << "no other serial";
  EXPECT_EQ(again->record, sensor->record);
  EXPECT_THAT(Enrol(*token, "sensor", *pki::NewKey()),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("by another key")));
  EXPECT_THAT(issued_, SizeIs(2));
  EXPECT_THAT(alerts_.back(),
              AllOf(HasSubstr("r1 high"), HasSubstr("in two hands"), HasSubstr(token->record.id)));
  EXPECT_THAT(alerts_[0], AllOf(HasSubstr("r1 low the sensor of r1 on base was enrolled"),
                                HasSubstr(token->record.id)));
}

TEST_F(EnrolmentTest, WhoIsEnrolledAnewIsReportedWithWhatIsStillGood) {
  ASSERT_THAT(Enrol(*Token(), "sensor", *pki::NewKey()), IsOk());
  ASSERT_THAT(Enrol(*Token(), "sensor", *pki::NewKey()), IsOk());
  EXPECT_THAT(alerts_.back(), AllOf(HasSubstr("r1 medium"), HasSubstr("1 other certificates"),
                                    HasSubstr("agent ban"), HasSubstr(kSensor)));
}

TEST_F(EnrolmentTest, ABanIsNotEscapedWithTheTokenThatFetchedWhatIsBanned) {
  const auto token = Token();
  const std::string key = *pki::NewKey();
  const auto fetched = Enrol(*token, "sensor", key);
  ASSERT_THAT(fetched, IsOk());
  banned_ = {absl::StrCat(kSensor, " ", fetched->record.serial)};
  EXPECT_THAT(Enrol(*token, "sensor", key),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("is banned")));
  banned_ = {kSensor};
  EXPECT_THAT(Enrol(*Token(), "sensor", key),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("is banned")));
  banned_ = {"spiffe://fleet.example/operator/admin/root 1f"};
  EXPECT_THAT(Enrol(*Token(), "actuator", key),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("administrator")));
  banned_ = {};
  EXPECT_THAT(Enrol(*Token(), "actuator", key), IsOk());
}

TEST_F(EnrolmentTest, AnAgentThatIsRenewedWithoutEndIsReported) {
  const rpc::PeerIdentity agent = *rpc::ParseSpiffeUri(kSensor);
  for (size_t i = 0; i <= kGoodWithoutAlert; ++i) {
    EXPECT_THAT(alerts_, IsEmpty()) << i;
    ASSERT_THAT(enrolment_->Renew(agent, *pki::RequestFor(*pki::NewKey())), IsOk());
    clock_.Advance(absl::ToInt64Nanoseconds(kBetweenRenewals));
  }
  ASSERT_THAT(alerts_, SizeIs(1));
  EXPECT_THAT(alerts_[0], AllOf(HasSubstr("r1 medium"), HasSubstr("renewed more often")));
}

TEST_F(EnrolmentTest, ATokenIsForWhatItWasMadeForAndNoLongerThanThat) {
  const auto token = Token("base", {"sensor"});
  EXPECT_THAT(Enrol(*token, "actuator", *pki::NewKey()),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("not for actuator")));
  EXPECT_THAT(Enrol(*token, "admin", *pki::NewKey()), StatusIs(absl::StatusCode::kInvalidArgument));
  clock_.Advance(absl::ToInt64Nanoseconds(kTokenLifeDefault));
  EXPECT_THAT(Enrol(*token, "sensor", *pki::NewKey()),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("expired")));
  const auto revoked = Token();
  ASSERT_THAT(enrolment_->RevokeToken(revoked->record.id), IsOk());
  EXPECT_THAT(Enrol(*revoked, "sensor", *pki::NewKey()),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("revoked")));
  const auto unlisted = Token();
  enrolment_->SetInventory({});
  EXPECT_THAT(Enrol(*unlisted, "sensor", *pki::NewKey()),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("inventory")));
  EXPECT_THAT(enrolment_->Enrol({.role = rpc::Role::kEnrolment,
                                 .trust_domain = "fleet.example",
                                 .name = "0123456789abcdef"},
                                "sensor", *pki::RequestFor(*pki::NewKey())),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("does not know")));
  EXPECT_THAT(issued_, IsEmpty());
}

TEST_F(EnrolmentTest, TokensAreForAgentsOfTheInventory) {
  EXPECT_EQ(Token("arm")->record.roles, "sensor");
  EXPECT_THAT(Token("arm", {"actuator"}), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(Token("leg"), StatusIs(absl::StatusCode::kNotFound, HasSubstr("robots.yaml")));
  EXPECT_THAT(Token("base", {"operator"}), StatusIs(absl::StatusCode::kInvalidArgument));
  const std::string request = *pki::RequestFor(*pki::NewKey());
  for (const absl::Duration valid : {absl::Seconds(59), absl::Hours(25), -absl::Hours(1)}) {
    EXPECT_THAT(enrolment_->CreateToken(
                    {.robot = "r1", .host = "base", .valid = valid, .request_pem = request}),
                StatusIs(absl::StatusCode::kInvalidArgument));
  }
  EXPECT_THAT(enrolment_->CreateToken({.robot = "r1", .host = "base", .request_pem = "x"}),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST_F(EnrolmentTest, AnAgentRenewsForWhatItIsEveryTenSeconds) {
  const rpc::PeerIdentity agent = *rpc::ParseSpiffeUri(kSensor);
  const std::string key = *pki::NewKey();
  const auto renewed = enrolment_->Renew(agent, *pki::RequestFor(key));
  ASSERT_THAT(renewed, IsOk());
  EXPECT_EQ(rpc::ReadLeaf(renewed->certificates_pem)->identity, agent);
  EXPECT_THAT(alerts_, IsEmpty());
  EXPECT_THAT(issued_, ElementsAre(kSensor)) << "its old one must not be reported as expiring";
  EXPECT_THAT(enrolment_->Renew(agent, *pki::RequestFor(key)),
              StatusIs(absl::StatusCode::kResourceExhausted));
  clock_.Advance(absl::ToInt64Nanoseconds(kBetweenRenewals));
  EXPECT_THAT(enrolment_->Renew(agent, *pki::RequestFor(key)), IsOk());
  enrolment_->SetInventory({});
  EXPECT_THAT(enrolment_->Renew(agent, *pki::RequestFor(key)),
              StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_THAT(enrolment_->Renew(*rpc::ParseSpiffeUri("spiffe://fleet.example/operator/admin/eve"),
                                *pki::RequestFor(key)),
              StatusIs(absl::StatusCode::kPermissionDenied));
}

TEST_F(EnrolmentTest, WithoutAUsableKeyItSaysWhichFile) {
  const auto token = Token();
  Make(pki_.dir() + "/nowhere.key");
  enrolment_->SetInventory(
      {.robots = {{.id = "r1", .bundle = "b", .sensors = {{.host = "base"}}}}});
  EXPECT_THAT(CheckIssuingFiles(files_),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("nowhere.key")));
  EXPECT_THAT(Enrol(*token, "sensor", *pki::NewKey()),
              StatusIs(absl::StatusCode::kFailedPrecondition));
  // Mended without a restart.
  std::ofstream(pki_.dir() + "/nowhere.key")
      << std::ifstream(pki_.dir() + "/ca/issuing.key").rdbuf();
  std::filesystem::permissions(files_.key, std::filesystem::perms(0644));
  for (const absl::Status& open :
       {CheckIssuingFiles(files_), Enrol(*token, "sensor", *pki::NewKey()).status()}) {
    EXPECT_THAT(open, StatusIs(absl::StatusCode::kFailedPrecondition,
                               HasSubstr("nowhere.key` is open to other users (mode 0644); run ")));
  }
  std::filesystem::permissions(files_.key, std::filesystem::perms(0600));
  EXPECT_THAT(CheckIssuingFiles(files_), IsOk());
  EXPECT_THAT(Enrol(*token, "sensor", *pki::NewKey()), IsOk());
}

}  // namespace
}  // namespace rips::enrol

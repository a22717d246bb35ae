#include "services/pki/issuer.h"

#include <cstdlib>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/pki/key_request.h"
#include "services/rpc/certificate.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/atomic_file.h"

namespace rips::pki {
namespace {

using ::testing::HasSubstr;

std::string Content(const std::string& path) { return ReadFile(path, 1 << 20).value_or(""); }

class IssuerTest : public ::testing::Test {
 protected:
  std::string ca(const std::string& name) { return Content(pki_.dir() + "/ca/" + name); }
  std::string root() { return ca("root.pem"); }
  absl::StatusOr<Issuer> Read() {
    return Issuer::Read(ca("issuing.pem"), ca("issuing.key"), root());
  }
  // What `openssl req` makes with these arguments.
  std::string OpensslRequest(const std::string& arguments) {
    const std::string path = pki_.dir() + "/made.csr";
    const std::string command =
        absl::StrCat("openssl req -new -nodes -keyout ", pki_.dir(), "/made.key -out ", path, " ",
                     arguments, " 2>/dev/null");
    EXPECT_EQ(std::system(command.c_str()), 0) << command;
    return Content(path);
  }

  rpc::TestPki pki_;
  const rpc::PeerIdentity sensor_{
      .role = rpc::Role::kSensor, .trust_domain = "fleet.example", .robot = "r1", .host = "base"};
};

TEST_F(IssuerTest, SignsWhatAServerAccepts) {
  const auto issuer = Read();
  ASSERT_THAT(issuer, IsOk());
  const std::string key = *NewKey();
  const auto request = CertificateRequest::Read(*RequestFor(key));
  ASSERT_THAT(request, IsOk());
  EXPECT_EQ(request->key_hash(), *PublicKeyHash(key));
  const absl::Time now = absl::FromUnixSeconds(absl::ToUnixSeconds(absl::Now()));
  const auto issued = issuer->Sign(*request, sensor_, now, absl::Hours(24));
  ASSERT_THAT(issued, IsOk());
  EXPECT_THAT(rpc::CheckChain(root(), issued->certificates_pem, key), IsOk());
  const auto leaf = rpc::ReadLeaf(issued->certificates_pem);
  ASSERT_THAT(leaf, IsOk());
  EXPECT_EQ(leaf->identity, sensor_);
  EXPECT_EQ(leaf->serial, issued->serial);
  EXPECT_EQ(leaf->not_after, now + absl::Hours(24));
  EXPECT_EQ(issued->not_after, leaf->not_after);
  EXPECT_LE(leaf->not_before, now) << "a robot's clock may be behind";
  const auto again = issuer->Sign(*request, sensor_, now, absl::Hours(24));
  EXPECT_NE(again->serial, issued->serial);
}

TEST_F(IssuerTest, NeverSignsForLongerThanItIsValidItself) {
  const auto issuer = Read();
  const auto request = CertificateRequest::Read(*RequestFor(*NewKey()));
  const auto issued = issuer->Sign(*request, sensor_, absl::Now(), absl::Hours(24 * 365 * 100));
  ASSERT_THAT(issued, IsOk());
  EXPECT_LT(issued->not_after, absl::Now() + absl::Hours(24 * 1826));
  EXPECT_THAT(issuer->Sign(*request, sensor_, absl::Now() + absl::Hours(24 * 2000), absl::Hours(1)),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("issuing certificate")));
  EXPECT_THAT(issuer->Sign(*request, sensor_, absl::Now() - absl::Hours(24), absl::Hours(1)),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("set the clock")));
}

TEST_F(IssuerTest, IsNoneWithAnotherKeyNorWithoutTheRightNorUnderAnotherRoot) {
  EXPECT_THAT(Issuer::Read(ca("issuing.pem"), *NewKey(), root()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("does not belong")));
  EXPECT_THAT(Issuer::Read(ca("issuing.pem"), "nonsense", root()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("no unencrypted key")));
  EXPECT_THAT(Issuer::Read("", ca("issuing.key"), root()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("no certificate")));
  const TlsFiles leaf = pki_.Sensor();
  EXPECT_THAT(Issuer::Read(Content(leaf.cert), Content(leaf.key), root()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("may not sign")));
  rpc::TestPki other;
  EXPECT_THAT(
      Issuer::Read(ca("issuing.pem"), ca("issuing.key"), Content(other.dir() + "/ca/root.pem")),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("not issued under")));
}

TEST_F(IssuerTest, ARequestMayAskForNothingButItsKey) {
  EXPECT_THAT(CertificateRequest::Read(
                  OpensslRequest("-newkey ec -pkeyopt ec_paramgen_curve:P-256 -subj /CN=admin")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("subject")));
  EXPECT_THAT(CertificateRequest::Read(
                  OpensslRequest("-newkey ec -pkeyopt ec_paramgen_curve:P-256 -subj / -addext "
                                 "'subjectAltName=URI:spiffe://fleet.example/operator/admin/eve'")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("extensions")));
  EXPECT_THAT(CertificateRequest::Read(
                  OpensslRequest("-newkey ec -pkeyopt ec_paramgen_curve:P-384 -subj /")),
              IsOk());
  EXPECT_THAT(CertificateRequest::Read(OpensslRequest("-newkey rsa:3072 -subj /")), IsOk());
  EXPECT_THAT(CertificateRequest::Read(OpensslRequest(
                  "-newkey ec -pkeyopt ec_paramgen_curve:P-256 -pkeyopt ec_param_enc:explicit "
                  "-subj /")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("without a name")));
  const std::string good = *RequestFor(*NewKey());
  EXPECT_THAT(CertificateRequest::Read("\n" + good + "\n"), IsOk());
  for (const std::string& beside : {*NewKey(), good, std::string("x\n")}) {
    EXPECT_THAT(CertificateRequest::Read(beside + good),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("nothing else")));
    EXPECT_THAT(CertificateRequest::Read(good + beside),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("nothing else")));
  }
}

TEST_F(IssuerTest, WeakKeysAreRefused) {
  for (const char* weak : {"-newkey rsa:2048", "-newkey ec -pkeyopt ec_paramgen_curve:secp224r1",
                           "-newkey ec -pkeyopt ec_paramgen_curve:secp256k1"}) {
    EXPECT_THAT(CertificateRequest::Read(OpensslRequest(absl::StrCat(weak, " -subj /"))),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("key is not P-256")))
        << weak;
  }
}

TEST_F(IssuerTest, ARequestCutOrAlteredAnywhereIsRefused) {
  const std::string good = *RequestFor(*NewKey());
  ASSERT_THAT(CertificateRequest::Read(good), IsOk());
  const size_t begin = good.find('\n') + 1, end = good.rfind("-----END");
  for (size_t size = 0; size < end; ++size) {
    EXPECT_FALSE(CertificateRequest::Read(good.substr(0, size)).ok()) << size;
  }
  const std::string hash = CertificateRequest::Read(good)->key_hash();
  for (size_t at = begin; at < end; ++at) {
    std::string bad = good;
    if (bad[at] == '\n' || bad[at] == '=') continue;
    bad[at] = bad[at] == 'A' ? 'B' : 'A';
    const auto read = CertificateRequest::Read(bad);
    // Bits behind the last byte mean nothing.
    if (!read.ok()) continue;
    EXPECT_EQ(read->key_hash(), hash) << at;
  }
  EXPECT_FALSE(CertificateRequest::Read(std::string(kRequestBytesMax + 1, 'A')).ok());
  EXPECT_FALSE(CertificateRequest::Read(std::string("\0\xff", 2)).ok());
}

TEST(KeyRequestTest, OnlyAKeyHasARequest) {
  EXPECT_FALSE(RequestFor("").ok());
  EXPECT_FALSE(
      PublicKeyHash("-----BEGIN PRIVATE KEY-----\nAA==\n-----END PRIVATE KEY-----\n").ok());
  EXPECT_NE(*NewKey(), *NewKey());
}

}  // namespace
}  // namespace rips::pki

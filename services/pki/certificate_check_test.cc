#include "services/pki/certificate_check.h"

#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

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

constexpr char kSensorUri[] = "spiffe://fleet.example/robot/r1/sensor/base";
// As the server's own signing gives them, without the names.
constexpr char kUse[] =
    "basicConstraints=critical,CA:FALSE\\nkeyUsage=critical,digitalSignature\\n"
    "extendedKeyUsage=clientAuth\\n";

std::string FileText(const std::string& path) { return ReadFile(path, 1 << 20).value_or(""); }

class CertificateCheckTest : public ::testing::Test {
 protected:
  CertificateCheckTest() {
    EXPECT_THAT(WriteFileAtomically(pki_.dir() + "/csr", *RequestFor(key_)), IsOk());
  }
  // What openssl signs for `csr` with these extensions; more of its arguments in `more`.
  std::string Sign(const std::string& extensions, const std::string& more = "-days 1",
                   const std::string& issuer = "issuing") {
    const std::string ca = absl::StrCat(pki_.dir(), "/ca/", issuer);
    const std::string out = pki_.dir() + "/signed.pem";
    const std::string serial =
        more.find("-set_serial") == more.npos ? " -set_serial 0x$(openssl rand -hex 15) " : " ";
    const std::string command =
        absl::StrCat("cd ", pki_.dir(), "; printf '", extensions,
                     "' > ext; openssl x509 -req -in csr -CA ", ca, ".pem -CAkey ", ca, ".key",
                     serial, more, " -sha256 -extfile ext -out ", out, " 2>/dev/null");
    EXPECT_EQ(std::system(command.c_str()), 0) << command;
    return FileText(out);
  }
  static std::string Names(const std::string& names = absl::StrCat("URI:", kSensorUri)) {
    return absl::StrCat(kUse, "subjectAltName=", names, "\\n");
  }
  std::string Issuing() { return FileText(pki_.dir() + "/ca/issuing.pem"); }
  std::string Roots() { return FileText(pki_.dir() + "/ca.pem"); }
  absl::StatusOr<Issued> Check(const std::string& pem, absl::Time now = absl::Now(),
                               absl::Duration life = absl::Hours(24)) {
    return CheckIssued(pem, {.request = &request_, .identity = sensor_, .now = now, .life = life},
                       Roots());
  }
  // Of a certificate with these extensions under the right issuer.
  void ExpectRefused(const std::string& pem, const std::string& why) {
    EXPECT_THAT(Check(pem + Issuing()),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(why)))
        << pem;
  }

  rpc::TestPki pki_;
  const std::string key_ = *NewKey();
  const CertificateRequest request_ = *CertificateRequest::Read(*RequestFor(key_));
  const rpc::PeerIdentity sensor_{
      .role = rpc::Role::kSensor, .trust_domain = "fleet.example", .robot = "r1", .host = "base"};
};

TEST_F(CertificateCheckTest, AcceptsWhatWasAskedFor) {
  const std::string leaf = Sign(Names());
  const auto issued = Check(absl::StrCat("\n", leaf, "\n", Issuing()));
  ASSERT_THAT(issued, IsOk());
  EXPECT_EQ(issued->certificates_pem, leaf + Issuing());
  EXPECT_THAT(rpc::CheckChain(Roots(), issued->certificates_pem, key_), IsOk());
  const auto peer = rpc::ReadLeaf(issued->certificates_pem);
  ASSERT_THAT(peer, IsOk());
  EXPECT_EQ(peer->serial, issued->serial);
  EXPECT_EQ(peer->not_after, issued->not_after);
  for (const std::string& subject : {std::string("RIPS sensor"), std::string(kSensorUri)}) {
    const std::string escaped = subject[0] == 's' ? "spiffe:\\/\\/fleet.example\\/robot\\/r1\\/"
                                                    "sensor\\/base"
                                                  : subject;
    EXPECT_THAT(Check(Sign(Names(), absl::StrCat("-days 1 -subj '/CN=", escaped, "'")) + Issuing()),
                IsOk());
  }
}

TEST_F(CertificateCheckTest, KeepsOfTheChainWhatIsNeeded) {
  const std::string leaf = Sign(Names());
  const auto issued = Check(absl::StrCat(leaf, Roots(), leaf, Issuing()));
  ASSERT_THAT(issued, IsOk());
  EXPECT_EQ(issued->certificates_pem, leaf + Issuing()) << "neither root nor what is not in it";
}

TEST_F(CertificateCheckTest, AcceptsWhatTheServerSignsItself) {
  const auto issuer = Issuer::Read(Issuing(), FileText(pki_.dir() + "/ca/issuing.key"), Roots());
  ASSERT_THAT(issuer, IsOk());
  const auto signed_here = issuer->Sign(request_, sensor_, absl::Now(), absl::Hours(24));
  ASSERT_THAT(signed_here, IsOk());
  const auto checked = Check(signed_here->certificates_pem);
  ASSERT_THAT(checked, IsOk());
  EXPECT_EQ(checked->serial, signed_here->serial);
}

TEST_F(CertificateCheckTest, RefusesAnotherKey) {
  ASSERT_THAT(WriteFileAtomically(pki_.dir() + "/csr", *RequestFor(*NewKey())), IsOk());
  ExpectRefused(Sign(Names()), "public key is not that of the request");
}

TEST_F(CertificateCheckTest, RefusesOtherNames) {
  const std::string uri = absl::StrCat("URI:", kSensorUri);
  ExpectRefused(Sign(kUse), "has 0 names");
  ExpectRefused(Sign(Names("DNS:base")), "no URI");
  ExpectRefused(Sign(Names(uri + ",DNS:base")), "has 2 names");
  ExpectRefused(Sign(Names(uri + ",URI:spiffe://fleet.example/operator/admin/eve")), "has 2 names");
  ExpectRefused(Sign(Names("URI:spiffe://fleet.example/operator/admin/eve")), "admin/eve");
  ExpectRefused(Sign(Names(), "-days 1 -subj /CN=eve"), "subject must be empty");
  ExpectRefused(Sign(Names(), "-days 1 -subj '/CN=RIPS actuator'"), "subject must be empty");
  ExpectRefused(Sign(Names(), "-days 1 -subj '/CN=RIPS sensor/O=x'"), "subject must be empty");
}

TEST_F(CertificateCheckTest, RefusesOtherUses) {
  const std::string names = absl::StrCat("subjectAltName=URI:", kSensorUri, "\\n");
  ExpectRefused(Sign(names + "basicConstraints=critical,CA:TRUE\\n"
                             "keyUsage=keyCertSign,digitalSignature\\n"
                             "extendedKeyUsage=clientAuth\\n"),
                "CA:TRUE");
  ExpectRefused(Sign(names + "basicConstraints=CA:TRUE\\nkeyUsage=digitalSignature\\n"
                             "extendedKeyUsage=clientAuth\\n"),
                "CA:TRUE");
  ExpectRefused(Sign(names + "extendedKeyUsage=clientAuth\\n"), "key usage must be");
  ExpectRefused(Sign(names + "keyUsage=digitalSignature,keyEncipherment\\n"
                             "extendedKeyUsage=clientAuth\\n"),
                "key usage must be");
  ExpectRefused(Sign(names + "keyUsage=digitalSignature\\n"), "extended key usage");
  ExpectRefused(Sign(names + "keyUsage=digitalSignature\\n"
                             "extendedKeyUsage=clientAuth,serverAuth\\n"),
                "extended key usage");
  ExpectRefused(Sign(Names(), "-days 1 -set_serial 0"), "serial number");
  ExpectRefused(Sign(Names(), "-days 1 -set_serial -5"), "serial number");
  ExpectRefused(Sign(Names(), "-days 1 -set_serial 0x01" + std::string(40, '1')), "serial number");
}

TEST_F(CertificateCheckTest, RefusesOtherTimes) {
  const std::string pem = Sign(Names(), "-days 2") + Issuing();
  const absl::Time begin = rpc::ReadLeaf(pem)->not_before;
  // A life of one day, and one more.
  EXPECT_THAT(Check(pem, begin, absl::Hours(24)), IsOk());
  EXPECT_THAT(Check(pem, begin, absl::Hours(24) - absl::Seconds(1)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("valid for too long")));
  EXPECT_THAT(Check(pem, begin + absl::Hours(24), absl::Hours(23)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("valid for too long")))
      << "it was made before it was asked for";
  EXPECT_THAT(Check(pem, begin - kBeginsLateMax, absl::Hours(25)), IsOk());
  EXPECT_THAT(Check(pem, begin - kBeginsLateMax - absl::Seconds(1), absl::Hours(25)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("not valid yet")));
  EXPECT_THAT(Check(pem, begin + absl::Hours(48)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("has expired")));
}

TEST_F(CertificateCheckTest, RefusesAnotherRootAndAnIncompleteChain) {
  EXPECT_THAT(Check(Sign(Names())), StatusIs(absl::StatusCode::kInvalidArgument,
                                             HasSubstr("does not lead to a root of `tls.ca`")))
      << "without the issuing certificate";
  const std::string pem = Sign(Names()) + Issuing();
  const rpc::TestPki other;
  EXPECT_THAT(
      CheckIssued(
          pem,
          {.request = &request_, .identity = sensor_, .now = absl::Now(), .life = absl::Hours(24)},
          FileText(other.dir() + "/ca.pem")),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("does not lead to a root")));
}

TEST_F(CertificateCheckTest, OneCutOrAlteredAnywhereIsRefused) {
  const std::string good = Sign(Names()) + Issuing();
  const auto accepted = Check(good);
  ASSERT_THAT(accepted, IsOk());
  // The last two bytes are those of an end line.
  for (size_t size = 0; size + 2 < good.size(); size += 7) {
    EXPECT_FALSE(Check(good.substr(0, size)).ok()) << size;
  }
  for (size_t at = 0; at < good.size(); at += 3) {
    std::string altered = good;
    altered[at] = altered[at] == 'A' ? 'B' : 'A';
    const auto issued = Check(altered);
    // A bit that base64 does not use.
    if (issued.ok()) {
      EXPECT_EQ(issued->certificates_pem, accepted->certificates_pem) << at;
    }
  }
}

TEST_F(CertificateCheckTest, RefusesWhatIsNotCertificatesOnly) {
  const std::string leaf = Sign(Names());
  const std::string good = leaf + Issuing();
  std::string many = good;
  while (many.size() < 9 * leaf.size()) many += leaf;
  const std::vector<std::pair<std::string, std::string>> bad = {
      {"", "no certificate"},
      {" \n", "no certificate"},
      {"garbage", "nothing else"},
      {std::string(1000, '\0'), "nothing else"},
      {"text\n" + good, "nothing else"},
      {good + "text", "nothing else"},
      {good + key_, "nothing else"},
      {key_ + good, "nothing else"},
      {leaf.substr(0, leaf.size() / 2), "nothing else"},
      {leaf.substr(0, leaf.size() / 2) + good, "nothing else"},
      {"-----BEGIN CERTIFICATE-----\n-----END CERTIFICATE-----\n", "certificate 1 of 1"},
      {leaf + "-----BEGIN CERTIFICATE-----\n%%%%\n-----END CERTIFICATE-----\n",
       "certificate 2 of 2"},
      {"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n" + leaf,
       "certificate 1 of 2"},
      {many + leaf + leaf, "certificates, limit 8"},
  };
  for (const auto& [pem, why] : bad) {
    EXPECT_THAT(Check(pem), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(why))) << pem;
  }
}

}  // namespace
}  // namespace rips::pki

#include <sys/stat.h>

#include <fstream>
#include <sstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "policy_server/ripsctl/ripsctl_fixture.h"
#include "services/base/status_matchers.h"
#include "services/enrol/token_text.h"
#include "services/pki/issuer.h"
#include "services/pki/key_request.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::StartsWith;

TEST_F(RipsctlTest, EnrolCreateTokenPrintsNothingButTheTokenForAPipe) {
  const Result made = Run({"enrol", "create-token", "r1", "base", "--valid", "10min", "--role",
                           "sensor", "--address", "policy.example:7443"});
  ASSERT_EQ(made.code, 0) << made.err;
  EXPECT_EQ(fake_.calls()[0], "CreateEnrolmentToken r1 base sensor 600000");
  const auto token = enrol::ParseToken(made.out);
  ASSERT_THAT(token, IsOk()) << made.out;
  EXPECT_EQ(token->id(), "00112233aabbccdd");
  EXPECT_EQ(token->server(), "policy.example:7443");
  EXPECT_EQ(token->robot(), "r1");
  EXPECT_EQ(token->host(), "base");
  EXPECT_THAT(token->roles(), ElementsAre("sensor"));
  EXPECT_THAT(pki::PublicKeyHash(token->key_pem()), IsOk());
  EXPECT_THAT(made.err, AllOf(HasSubstr("It is secret"), HasSubstr("rips-enrol fetch --token FILE"),
                              Not(HasSubstr("warning")), Not(HasSubstr(token->key_pem()))));
}

TEST_F(RipsctlTest, EnrolCreateTokenIntoAFileForItsOwnerAlone) {
  const std::string path = home_ + "/r1.token";
  const Result made = Run({"enrol", "create-token", "r1", "base", "--out", path});
  ASSERT_EQ(made.code, 0) << made.err;
  EXPECT_THAT(made.out, IsEmpty());
  struct stat info {};
  ASSERT_EQ(stat(path.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 07777, 0600u);
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  EXPECT_THAT(enrol::ParseToken(text.str()), IsOk());
  EXPECT_THAT(made.err, HasSubstr("warning: the robot will look for the server at 127.0.0.1"));
  EXPECT_THAT(Run({"enrol", "create-token", "r1", "base", "--out", path}).err,
              HasSubstr("cannot make"))
      << "it is not replaced";
}

TEST_F(RipsctlTest, EnrolCreateTokenChecksWhatItIsAskedForFirst) {
  EXPECT_EQ(Run({"enrol", "create-token", "r1"}).code, 2);
  EXPECT_EQ(Run({"enrol", "create-token", "r1", "Base"}).code, 2);
  EXPECT_EQ(Run({"enrol", "create-token", "r1", "base", "--role", "admin"}).code, 2);
  EXPECT_EQ(Run({"enrol", "create-token", "r1", "base", "--valid", "10s"}).code, 2);
  EXPECT_EQ(Run({"enrol", "create-token", "r1", "base", "--valid", "25h"}).code, 2);
  EXPECT_EQ(Run({"enrol", "create-token", "r1", "base", "--address", "here"}).code, 2);
  EXPECT_THAT(fake_.calls(), IsEmpty());
}

TEST_F(RipsctlTest, EnrolListShowsTokensAndWhatWasIssued) {
  v1::TokenState& token = *fake_.enrolments.add_tokens();
  token.set_id("00112233aabbccdd");
  token.set_robot("r1");
  token.set_host("base");
  token.add_roles("actuator");
  token.add_roles("sensor");
  token.add_used_roles("sensor");
  token.set_by("spiffe://td/operator/admin/root serial 1");
  token.set_expires_unix_ns(1'700'000'000'000'000'000);
  v1::IssuedState& issued = *fake_.enrolments.add_issued();
  issued.set_uri("spiffe://td/robot/r1/sensor/base");
  issued.set_serial("af");
  issued.set_token(token.id());
  v1::IssuedState& renewed = *fake_.enrolments.add_issued();
  renewed.set_uri("spiffe://td/robot/r1/sensor/base");
  const Result listed = Run({"enrol", "list", "r1"});
  EXPECT_EQ(fake_.calls()[0], "ListEnrolments r1");
  EXPECT_THAT(listed.out, AllOf(HasSubstr("actuator,sensor"), HasSubstr("expired"),
                                HasSubstr("token 00112233aabbccdd"), HasSubstr("renewal")));
  const nlohmann::json json = RunJson({"enrol", "list"});
  EXPECT_EQ(json["tokens"][0]["state"], "expired");
  EXPECT_EQ(json["issued"][1]["token"], nullptr);
}

TEST_F(RipsctlTest, EnrolRevokeTokenAndJson) {
  EXPECT_EQ(Run({"enrol", "revoke-token", "00112233aabbccdd"}).out,
            "token 00112233aabbccdd is revoked\n");
  EXPECT_EQ(fake_.calls()[0], "RevokeEnrolmentToken 00112233aabbccdd");
  EXPECT_EQ(RunJson({"enrol", "revoke-token", "00112233aabbccdd"})["done"], "revoked");
  const nlohmann::json made = RunJson({"enrol", "create-token", "r1", "base"});
  EXPECT_THAT(std::string(made["token"]), StartsWith("rips-token-1."));
}

}  // namespace
}  // namespace rips::ripsctl

#include "services/rpc/identity.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::rpc {
namespace {

using ::testing::HasSubstr;

TEST(IdentityTest, ReadsEveryForm) {
  struct Case {
    const char* uri;
    PeerIdentity identity;
  };
  const Case cases[] = {
      {"spiffe://fleet.example/policy-server/ps1",
       {.role = Role::kPolicyServer, .trust_domain = "fleet.example", .name = "ps1"}},
      {"spiffe://fleet.example/robot/r1/sensor/base",
       {.role = Role::kSensor, .trust_domain = "fleet.example", .robot = "r1", .host = "base"}},
      {"spiffe://fleet.example/robot/r1/actuator/laptop-2",
       {.role = Role::kActuator,
        .trust_domain = "fleet.example",
        .robot = "r1",
        .host = "laptop-2"}},
      {"spiffe://f_1/operator/viewer/bob",
       {.role = Role::kOperator,
        .trust_domain = "f_1",
        .operator_role = OperatorRole::kViewer,
        .name = "bob"}},
      {"spiffe://f/operator/operator/bob",
       {.role = Role::kOperator,
        .trust_domain = "f",
        .operator_role = OperatorRole::kOperator,
        .name = "bob"}},
      {"spiffe://f/enrolment/00112233aabbccdd",
       {.role = Role::kEnrolment, .trust_domain = "f", .name = "00112233aabbccdd"}},
      {"spiffe://f/operator/admin/alice",
       {.role = Role::kOperator,
        .trust_domain = "f",
        .operator_role = OperatorRole::kAdmin,
        .name = "alice"}},
  };
  for (const Case& c : cases) {
    const auto identity = ParseSpiffeUri(c.uri);
    ASSERT_THAT(identity, IsOk()) << c.uri;
    EXPECT_EQ(*identity, c.identity) << c.uri;
    EXPECT_EQ(ToString(*identity), c.uri);
  }
}

TEST(IdentityTest, RefusesEverythingElse) {
  const std::string name64(64, 'a');
  const std::string uris[] = {
      "",
      "spiffe://",
      "spiffe:///policy-server/ps1",
      "spiffe://fleet.example",
      "spiffe://fleet.example/",
      "spiffe://fleet.example/policy-server",
      "spiffe://fleet.example/policy-server/",
      "spiffe://fleet.example/policy-server/ps1/",
      "spiffe://fleet.example//policy-server/ps1",
      "spiffe://fleet.example/policy-server/ps1/x",
      "spiffe://fleet.example/policy-server/PS1",
      "spiffe://fleet.example/policy-server/ps 1",
      "spiffe://fleet.example/policy-server/ps1?x",
      "spiffe://fleet.example/policy-server/ps1#x",
      "spiffe://fleet.example/policy-server/%70s1",
      "spiffe://fleet.example/policy-server/..",
      "spiffe://fleet.example/policy-server/-ps1",
      "spiffe://fleet.example/policy-server/" + name64,
      std::string("spiffe://fleet.example/policy-server/ps1\0x", 42),
      std::string("spiffe://fleet.example/policy-server/ps1\0", 41),
      "spiffe://Fleet.example/policy-server/ps1",
      "spiffe://fleet.example:443/policy-server/ps1",
      "spiffe://a@fleet.example/policy-server/ps1",
      "SPIFFE://fleet.example/policy-server/ps1",
      "https://fleet.example/policy-server/ps1",
      " spiffe://fleet.example/policy-server/ps1",
      "spiffe://fleet.example/Policy-server/ps1",
      "spiffe://fleet.example/robot/r1/sensor",
      "spiffe://fleet.example/robot/r1/camera/base",
      "spiffe://fleet.example/robot//sensor/base",
      "spiffe://fleet.example/robot/r1/sensor/base/x",
      "spiffe://fleet.example/robot/r1/policy-server/ps1",
      "spiffe://fleet.example/operator/owner/alice",
      "spiffe://fleet.example/operator/alice",
      "spiffe://fleet.example/operator/admin/",
      "spiffe://fleet.example/operator/admin/alice/x",
      "spiffe://" + std::string(256, 'a') + "/policy-server/ps1",
  };
  for (const std::string& uri : uris) {
    EXPECT_THAT(ParseSpiffeUri(uri), StatusIs(absl::StatusCode::kInvalidArgument)) << uri;
  }
  EXPECT_THAT(ParseSpiffeUri("spiffe://" + std::string(kSpiffeUriBytesMax, 'a')),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("of 2057 bytes exceeds the limit of 2048")));
}

TEST(IdentityTest, RefusesEveryPrefix) {
  for (const absl::string_view uri : {"spiffe://f/robot/r/sensor/b", "spiffe://f/operator/viewer/b",
                                      "spiffe://f/policy-server/p"}) {
    for (size_t i = 0; i < uri.size(); ++i) {
      EXPECT_FALSE(ParseSpiffeUri(uri.substr(0, i)).ok()) << uri.substr(0, i);
    }
  }
}

TEST(IdentityTest, OrdersOperatorRoles) {
  EXPECT_LT(OperatorRole::kViewer, OperatorRole::kOperator);
  EXPECT_LT(OperatorRole::kOperator, OperatorRole::kAdmin);
}

}  // namespace
}  // namespace rips::rpc

// Calls that the server refuses.
#include "absl/strings/str_cat.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"
#include "services/rpc/status_conversion.h"

namespace rips::ripsctl {
namespace {

TEST_F(RipsctlTest, ACallThatIsOneTooManyIsMadeAgain) {
  fake_.failure = grpc::Status(grpc::StatusCode::RESOURCE_EXHAUSTED,
                               absl::StrCat(rpc::kCalledTooOften, "20 calls a second"));
  const Result result = Run({"robot", "list", "--timeout", "1s"});
  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.err, "error: this certificate began more than 20 calls a second\n");
  EXPECT_GE(fake_.calls().size(), 3u);
  fake_.failure =
      grpc::Status(grpc::StatusCode::RESOURCE_EXHAUSTED, "this certificate has 8 calls");
  const size_t before = fake_.calls().size();
  EXPECT_EQ(Run({"robot", "list", "--timeout", "1s"}).code, 1);
  EXPECT_EQ(fake_.calls().size(), before + 1) << "it may never pass";
}

TEST_F(RipsctlTest, AnOlderServerIsNamed) {
  fake_.failure = grpc::Status(grpc::StatusCode::UNIMPLEMENTED, "");
  const Result result = Run({"robot", "receipts", "r1"});
  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.err,
            "error: the policy server does not know this call; is it older than this ripsctl?\n");
}

}  // namespace
}  // namespace rips::ripsctl

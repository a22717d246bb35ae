// Orders about levels that their sender has no right to, over real gRPC.
#include <memory>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/server/operator_api/calls_fixture.h"
#include "services/runtime/bounded_queue.h"

namespace rips::operator_api {
namespace {

using ::testing::HasSubstr;
using ::testing::SizeIs;
using ::testing::StartsWith;

class LevelCallsTest : public CallsTest {
 protected:
  void SetUp() override { Start({"base"}, {"HALT"}); }

  // The id of a lowering from HALT to DEFAULT that waits for a second operator.
  std::string AskToLower(Stub& stub) {
    rips::v1::LevelRequest request;
    rips::v1::LevelResponse response;
    request.set_robot("r1");
    request.set_to("HALT");
    request.set_reason("drill");
    const grpc::Status raised = Call(stub, &Stub::Raise, request, response);
    EXPECT_TRUE(raised.ok()) << raised.error_message();
    request.set_to("DEFAULT");
    request.set_accept_blind(true);
    request.set_expected_level("HALT");
    *request.mutable_expected_decision_id() = response.decision_id();
    const grpc::Status asked = Call(stub, &Stub::DeEscalate, request, response);
    EXPECT_TRUE(asked.ok()) << asked.error_message();
    return response.pending_approval_id();
  }
  static grpc::Status Approve(Stub& stub, const std::string& id, bool reject = false) {
    rips::v1::ApproveRequest request;
    rips::v1::LevelResponse response;
    request.set_robot("r1");
    request.set_pending_approval_id(id);
    request.set_reason("mine");
    request.set_reject(reject);
    return Call(stub, &Stub::Approve, request, response);
  }
  // What the robot has recorded of refused orders by now.
  std::vector<store::RefusalRecord> Refusals() {
    BoundedQueue<std::vector<store::RefusalRecord>> read{{.capacity = 1}};
    EXPECT_THAT(pipeline_.Post("r1", pipeline::Queue::kOrders,
                               [&](pipeline::Robot&) { read.Push(recorder_.refusals); }),
                IsOk());
    return read.Pop(absl::Seconds(60)).value_or(std::vector<store::RefusalRecord>());
  }
};

TEST_F(LevelCallsTest, AViewerWhoApprovesIsOnRecordAsOneWhoLowers) {
  const auto alice = Connect("operator", "alice");
  const auto vera = Connect("viewer", "vera");
  const std::string id = AskToLower(*alice);
  ASSERT_NE(id, "");

  EXPECT_EQ(Approve(*vera, id).error_code(), grpc::StatusCode::PERMISSION_DENIED);

  std::vector<store::RefusalRecord> refusals = Refusals();
  ASSERT_THAT(refusals, SizeIs(1));
  EXPECT_THAT(refusals[0].cause, StartsWith("operator vera ("));
  EXPECT_EQ(refusals[0].to, "DEFAULT");
  EXPECT_THAT(refusals[0].reason,
              HasSubstr("approving an operator's request: this needs the role `operator`"));

  EXPECT_EQ(Approve(*vera, id, /*reject=*/true).error_code(), grpc::StatusCode::PERMISSION_DENIED);
  refusals = Refusals();
  ASSERT_FALSE(refusals.empty());
  EXPECT_EQ(refusals.back().count, 2u);
  EXPECT_THAT(refusals.back().reason, StartsWith("rejecting an operator's request: "));
}

TEST_F(LevelCallsTest, OfALoweringThatDoesNotWaitThereIsNoRecord) {
  const auto vera = Connect("viewer", "vera");
  for (const std::string& id : {std::string(), std::string(32, 'a'), std::string(5'000, 'a')}) {
    EXPECT_EQ(Approve(*vera, id).error_code(), grpc::StatusCode::PERMISSION_DENIED);
  }
  EXPECT_THAT(Refusals(), SizeIs(0));
}

}  // namespace
}  // namespace rips::operator_api

// Orders about levels that their sender has no right to, over real gRPC.
#include <memory>
#include <string>
#include <utility>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/ids.h"
#include "services/base/status_matchers.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"

namespace rips::operator_api {
namespace {

using ::testing::HasSubstr;
using ::testing::SizeIs;
using ::testing::StartsWith;

class LevelCallsTest : public ::testing::Test {
 protected:
  static constexpr absl::Duration kAnswerPatience = absl::Seconds(60);
  using Stub = rips::v1::OperatorService::Stub;

  void SetUp() override {
    lang::CompileResult compiled =
        lang::Compile({{.path = "test.rul", .text = pipeline::kPaperRules}});
    ASSERT_TRUE(compiled.rules);
    auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules));
    ASSERT_THAT(program, IsOk());
    ASSERT_THAT(
        pipeline_.Add({.id = "r1",
                       .sensor_hosts = {"base"},
                       .primary_sensor = "base",
                       .actuator_hosts = {"base"}},
                      {.program = *program, .bundle_id = "sha256:0", .two_person = {"HALT"}}, {},
                      {}, 1, {.recorder = &recorder_, .audience = &hub_, .new_id = NewId}),
        IsOk());
    pipeline_.Start();
    const auto own = rpc::Credentials::Load(pki_.Server());
    ASSERT_THAT(own, IsOk());
    auto server = rpc::RpcServer::Start(
        {.listen = "127.0.0.1:0", .credentials = (*own)->ForServer()}, {&service_});
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
  }
  void TearDown() override {
    server_.reset();
    pipeline_.Stop();
  }

  std::unique_ptr<Stub> StubOf(const TlsFiles& files) {
    const auto credentials = rpc::Credentials::Load(files);
    EXPECT_THAT(credentials, IsOk());
    return rips::v1::OperatorService::NewStub(
        rpc::MakeChannel(server_->address(), (*credentials)->ForClient()));
  }
  template <typename Request, typename Response>
  static grpc::Status Call(Stub& stub,
                           grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&,
                                                        Response*),
                           const Request& request, Response& response) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + absl::ToChronoSeconds(kAnswerPatience));
    return (stub.*method)(&context, request, &response);
  }
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
    return read.Pop(kAnswerPatience).value_or(std::vector<store::RefusalRecord>());
  }

  rpc::TestPki pki_;
  RealClock clock_;
  store::FakeStore store_;
  StatusBroadcaster hub_{&store_, nullptr};
  pipeline::FakeRecorder recorder_;
  pipeline::Pipeline pipeline_{1, &clock_};
  rpc::SessionWatch watch_{&clock_};
  OperatorService service_{&pipeline_, &store_, &hub_, {.watch = &watch_}};
  std::unique_ptr<rpc::RpcServer> server_;
};

TEST_F(LevelCallsTest, AViewerWhoApprovesIsOnRecordAsOneWhoLowers) {
  const auto alice = StubOf(pki_.Operator("operator", "alice"));
  const auto vera = StubOf(pki_.Operator("viewer", "vera"));
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
  const auto vera = StubOf(pki_.Operator("viewer", "vera"));
  for (const std::string& id : {std::string(), std::string(32, 'a'), std::string(5'000, 'a')}) {
    EXPECT_EQ(Approve(*vera, id).error_code(), grpc::StatusCode::PERMISSION_DENIED);
  }
  EXPECT_THAT(Refusals(), SizeIs(0));
}

}  // namespace
}  // namespace rips::operator_api

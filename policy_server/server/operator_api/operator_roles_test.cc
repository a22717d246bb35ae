// Every method of the operators' contract refuses the role below its least, over real gRPC.
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "grpcpp/generic/generic_stub.h"
#include "gtest/gtest.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/status_matchers.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"

namespace rips::operator_api {
namespace {

using ::testing::HasSubstr;
using Role = rpc::OperatorRole;

constexpr absl::Duration kAnswerPatience = absl::Seconds(60);

// As in operator_service.h. A method that does not stand here fails the test.
const std::map<std::string, Role> kLeastRoles = {
    {"ListRobots", Role::kViewer},
    {"WatchRobots", Role::kViewer},
    {"GetGraph", Role::kViewer},
    {"GetInterest", Role::kViewer},
    {"GetCoverage", Role::kViewer},
    {"GetLevel", Role::kViewer},
    {"ListTransitions", Role::kViewer},
    {"ListAlerts", Role::kViewer},
    {"WatchAlerts", Role::kViewer},
    {"ListReceipts", Role::kViewer},
    {"Explain", Role::kViewer},
    {"ListAgents", Role::kViewer},
    {"ListBundles", Role::kViewer},
    {"GetRulesStatus", Role::kViewer},
    {"ListEnrolments", Role::kViewer},
    {"Raise", Role::kOperator},
    {"DeEscalate", Role::kOperator},
    {"Approve", Role::kOperator},
    {"ResumeRules", Role::kOperator},
    {"SetMaintenance", Role::kOperator},
    {"GetConfiguration", Role::kOperator},
    {"SendSignal", Role::kOperator},
    {"Record", Role::kOperator},
    {"GetAlertRecording", Role::kOperator},
    {"AckAlerts", Role::kOperator},
    {"DrillRobot", Role::kOperator},
    {"ShadowBundle", Role::kOperator},
    {"Ban", Role::kAdmin},
    {"Unban", Role::kAdmin},
    {"ResetTerm", Role::kAdmin},
    {"PushBundle", Role::kAdmin},
    {"ActivateBundle", Role::kAdmin},
    {"RollBackBundle", Role::kAdmin},
    {"StopRollout", Role::kAdmin},
    {"CreateEnrolmentToken", Role::kAdmin},
    {"RevokeEnrolmentToken", Role::kAdmin},
};

TEST(OperatorRolesTest, EveryMethodRefusesTheRoleBelowItsLeastBeforeAnythingElse) {
  rpc::TestPki pki;
  RealClock clock;
  store::FakeStore store;
  StatusBroadcaster hub(&store, nullptr);
  pipeline::Pipeline pipeline(1, &clock);
  rpc::SessionWatch watch(&clock);
  OperatorService service(&pipeline, &store, &hub, {.watch = &watch});
  const auto own = rpc::Credentials::Load(pki.Server());
  ASSERT_THAT(own, IsOk());
  const auto server = rpc::RpcServer::Start(
      {.listen = "127.0.0.1:0", .credentials = (*own)->ForServer()}, {&service});
  ASSERT_THAT(server, IsOk());
  const auto channel_of = [&server](const TlsFiles& files) {
    const auto credentials = rpc::Credentials::Load(files);
    EXPECT_THAT(credentials, IsOk());
    return rpc::MakeChannel((*server)->address(), (*credentials)->ForClient());
  };
  // Below a viewer is only a certificate of another kind.
  const std::map<Role, std::shared_ptr<grpc::Channel>> below = {
      {Role::kViewer, channel_of(pki.Sensor())},
      {Role::kOperator, channel_of(pki.Operator("viewer", "vera"))},
      {Role::kAdmin, channel_of(pki.Operator("operator", "otto"))}};
  const auto* contract =
      rips::v1::LevelRequest::descriptor()->file()->FindServiceByName("OperatorService");
  ASSERT_NE(contract, nullptr);

  std::set<std::string> names;
  for (int i = 0; i < contract->method_count(); ++i) {
    const std::string name(contract->method(i)->name());
    SCOPED_TRACE(name);
    names.insert(name);
    const auto row = kLeastRoles.find(name);
    ASSERT_NE(row, kLeastRoles.end()) << "give the method a row in the table";
    const Role least = row->second;
    // An empty request: a call that reads it first finds no robot, or no reason. A refusal of a
    // stream looks like that of a unary call.
    grpc::GenericStub stub(below.at(least));
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + absl::ToChronoSeconds(kAnswerPatience));
    const grpc::Slice nothing;
    grpc::ByteBuffer request(&nothing, 1), response;
    BoundedQueue<grpc::Status> ended{{.capacity = 1}};
    stub.UnaryCall(&context, absl::StrCat("/", std::string(contract->full_name()), "/", name), {},
                   &request, &response,
                   [&](grpc::Status status) { ended.Push(std::move(status)); });
    const std::optional<grpc::Status> end = ended.Pop(2 * kAnswerPatience);
    ASSERT_TRUE(end.has_value());
    EXPECT_EQ(end->error_code(), grpc::StatusCode::PERMISSION_DENIED) << end->error_message();
    if (least == Role::kViewer) continue;
    EXPECT_THAT(end->error_message(),
                HasSubstr(absl::StrCat("needs the role `", rpc::OperatorRoleName(least), "`")));
  }
  for (const auto& [name, role] : kLeastRoles) EXPECT_EQ(names.count(name), 1u) << name;
}

}  // namespace
}  // namespace rips::operator_api

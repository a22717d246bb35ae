// A policy server with one robot, as operators call it over real gRPC.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_CALLS_FIXTURE_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_CALLS_FIXTURE_H_

#include <chrono>
#include <memory>
#include <string>
#include <utility>
#include <vector>

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

class CallsTest : public ::testing::Test {
 protected:
  using Stub = rips::v1::OperatorService::Stub;

  // Once, before all else. `r1` has a sensor on host `base`, and actuators on `actuator_hosts`;
  // to lower it from `two_person` needs two.
  void Start(std::vector<std::string> actuator_hosts, std::vector<std::string> two_person,
             audit::OrderAudit* audit = nullptr) {
    lang::CompileResult compiled =
        lang::Compile({{.path = "test.rul", .text = pipeline::kPaperRules}});
    ASSERT_TRUE(compiled.rules);
    auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules));
    ASSERT_THAT(program, IsOk());
    ASSERT_THAT(
        pipeline_.Add(
            {.id = "r1",
             .sensor_hosts = {"base"},
             .primary_sensor = "base",
             .actuator_hosts = std::move(actuator_hosts)},
            {.program = *program, .bundle_id = "sha256:0", .two_person = std::move(two_person)}, {},
            {}, 1, {.recorder = &recorder_, .audience = &hub_, .new_id = NewId}),
        IsOk());
    pipeline_.Start();
    service_ = std::make_unique<OperatorService>(
        &pipeline_, &store_, &hub_,
        OperatorService::Access{
            .watch = &watch_, .audit = audit, .contacts = &contacts_, .settings = &settings_});
    const auto own = rpc::Credentials::Load(pki_.Server());
    ASSERT_THAT(own, IsOk());
    auto server = rpc::RpcServer::Start(
        {.listen = "127.0.0.1:0", .credentials = (*own)->ForServer()}, {service_.get()});
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
  }
  void Stop() {
    server_.reset();
    service_.reset();
    pipeline_.Stop();
  }
  void TearDown() override { Stop(); }

  std::unique_ptr<Stub> Connect(const std::string& role, const std::string& name) {
    const auto credentials = rpc::Credentials::Load(pki_.Operator(role, name));
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
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
    return (stub.*method)(&context, request, &response);
  }

  rpc::TestPki pki_;
  RealClock clock_;
  store::FakeStore store_;
  StatusBroadcaster hub_{&store_, nullptr};
  pipeline::FakeRecorder recorder_;
  pipeline::Pipeline pipeline_{1, &clock_};
  rpc::SessionWatch watch_{&clock_};
  pipeline::AgentContacts contacts_{&clock_};
  pipeline::ListedSettings settings_{{{"listen", "\"0.0.0.0:7443\"", "policy-server.yaml:2"}}};
  std::unique_ptr<OperatorService> service_;
  std::unique_ptr<rpc::RpcServer> server_;
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_CALLS_FIXTURE_H_

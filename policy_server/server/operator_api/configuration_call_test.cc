// What operators are told of settings, over real gRPC.
#include <memory>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/server/operator_api/calls_fixture.h"
#include "services/model_proto/configuration_codec.h"

namespace rips::operator_api {
namespace {

class ConfigurationCallTest : public CallsTest {
 protected:
  void SetUp() override { Start({"base"}, {}); }
  grpc::StatusCode Ask(Stub& stub, const std::string& robot) {
    rips::v1::GetConfigurationRequest request;
    request.set_robot(robot);
    answer_.Clear();
    return Call(stub, &Stub::GetConfiguration, request, answer_).error_code();
  }

  rips::v1::GetConfigurationResponse answer_;
};

TEST_F(ConfigurationCallTest, TellsWhatTheInventorySaysAndWhatEachAgentSaid) {
  contacts_.SetListed({{"r1", pipeline::AgentKind::kSensor, "base"},
                       {"r1", pipeline::AgentKind::kActuator, "base"}});
  settings_.Set({{"r1", {{"labels.ring", "\"canary\"", "robots.yaml:7"}}}});
  const std::vector<ConfigSetting> said = {{"settle", "3s", "sensor.yaml:4"}};
  contacts_.Greeted({"r1", pipeline::AgentKind::kSensor, "base"},
                    {"1", "", model_proto::Encode(said).SerializeAsString()});
  const std::unique_ptr<Stub> stub = Connect("operator", "carol");
  ASSERT_EQ(Ask(*stub, "r1"), grpc::StatusCode::OK);
  ASSERT_EQ(answer_.server().settings_size(), 1);
  EXPECT_EQ(answer_.server().settings(0).source(), "robots.yaml:7");
  ASSERT_EQ(answer_.agents_size(), 2);
  EXPECT_EQ(answer_.agents(0).role(), "sensor");
  EXPECT_EQ(answer_.agents(0).configuration().settings(0).value(), "3s");
  EXPECT_GT(answer_.agents(0).said_unix_ns(), 0);
  EXPECT_EQ(answer_.agents(1).role(), "actuator");
  EXPECT_FALSE(answer_.agents(1).has_configuration()) << "it has not connected";
  settings_.Set({});
  EXPECT_EQ(Ask(*stub, "r1"), grpc::StatusCode::NOT_FOUND) << "the inventory was reloaded";
}

TEST_F(ConfigurationCallTest, WithoutARobotTellsTheServersOwn) {
  const std::unique_ptr<Stub> stub = Connect("operator", "carol");
  ASSERT_EQ(Ask(*stub, ""), grpc::StatusCode::OK);
  EXPECT_EQ(answer_.server().settings(0).path(), "listen");
  EXPECT_EQ(answer_.agents_size(), 0);
}

TEST_F(ConfigurationCallTest, TellsNoViewerHowARobotDefendsItself) {
  const std::unique_ptr<Stub> stub = Connect("viewer", "bob");
  EXPECT_EQ(Ask(*stub, ""), grpc::StatusCode::PERMISSION_DENIED);
}

}  // namespace
}  // namespace rips::operator_api

#include "policy_server/server/operator_api/level_codec.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/runtime/real_clock.h"

namespace rips::operator_api {
namespace {

using pipeline::AgentId;
using pipeline::AgentKind;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

TEST(NameAgentsTest, NamesThoseAtTheAddressOfASource) {
  RealClock clock;
  pipeline::AgentContacts contacts(&clock);
  contacts.SetListed({AgentId{"r3", AgentKind::kActuator, "arm"},
                      AgentId{"r3", AgentKind::kSensor, "base"},
                      AgentId{"r4", AgentKind::kSensor, "base"}});
  contacts.Greeted({"r3", AgentKind::kActuator, "arm"}, {"1", "10.0.0.13"});
  contacts.Greeted({"r3", AgentKind::kSensor, "base"}, {"1", "10.0.0.13"});
  rips::v1::GetLevelResponse response;
  rips::v1::HostFirewall& firewall = *response.add_firewalls();
  for (const char* address : {"10.0.0.66", "10.0.0.13", ""}) {
    firewall.add_sources()->set_address(address);
  }
  NameAgents(contacts, response);
  EXPECT_THAT(firewall.sources(0).agents(), IsEmpty());
  EXPECT_THAT(firewall.sources(1).agents(), ElementsAre("sensor/r3/base", "actuator/r3/arm"));
  EXPECT_THAT(firewall.sources(2).agents(), IsEmpty());
}

TEST(NameAgentsTest, OfManyBehindOneAddressNamesFour) {
  RealClock clock;
  pipeline::AgentContacts contacts(&clock);
  std::vector<AgentId> agents;
  for (int i = 0; i < 9; ++i) agents.push_back({absl::StrCat("r", i), AgentKind::kSensor, "base"});
  contacts.SetListed(agents);
  for (const AgentId& agent : agents) contacts.Greeted(agent, {"1", "10.0.0.1"});
  rips::v1::GetLevelResponse response;
  response.add_firewalls()->add_sources()->set_address("10.0.0.1");
  NameAgents(contacts, response);
  EXPECT_THAT(response.firewalls(0).sources(0).agents(), SizeIs(4));
}

}  // namespace
}  // namespace rips::operator_api

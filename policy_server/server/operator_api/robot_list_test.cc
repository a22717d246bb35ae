#include "policy_server/server/operator_api/robot_list.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/operator_api/answer_limits.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/real_clock.h"

namespace rips::operator_api {
namespace {

using pipeline::AgentId;
using pipeline::AgentKind;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class RobotListTest : public ::testing::Test {
 protected:
  rips::v1::ListRobotsResponse List(const std::vector<std::string>& labels = {}) const {
    rips::v1::ListRobotsRequest request;
    for (const std::string& label : labels) request.add_labels(label);
    absl::btree_map<std::string, rips::v1::RobotStatus> statuses;
    for (const char* robot : {"r1", "r2"}) statuses[robot].set_robot(robot);
    rips::v1::ListRobotsResponse response;
    FillRobotList(request, {.contacts = &contacts_, .labels = &labels_}, std::move(statuses),
                  {"r3"}, response);
    return response;
  }

  RealClock clock_;
  pipeline::AgentContacts contacts_{&clock_};
  pipeline::RobotLabels labels_;
};

TEST_F(RobotListTest, NamesTheAgentsOfEachRobotWithVersionAndLastContact) {
  contacts_.SetListed(
      {AgentId{"r1", AgentKind::kActuator, "arm"}, AgentId{"r1", AgentKind::kSensor, "base"}});
  contacts_.Greeted({"r1", AgentKind::kSensor, "base"}, {"0.9.0\x1b[2J", "10.0.0.7"});
  const rips::v1::ListRobotsResponse response = List();
  EXPECT_EQ(response.server_version(), RipsVersion());
  ASSERT_THAT(response.robots(), SizeIs(2));
  ASSERT_THAT(response.robots(0).agents(), SizeIs(2));
  const rips::v1::AgentContact& base = response.robots(0).agents(0);
  EXPECT_EQ(base.role(), "sensor");
  EXPECT_EQ(base.host(), "base");
  EXPECT_EQ(base.version(), "0.9.0\x1b[2J") << "the reader escapes it";
  EXPECT_GT(base.heard_unix_ns(), 0);
  const rips::v1::AgentContact& arm = response.robots(0).agents(1);
  EXPECT_EQ(arm.role(), "actuator");
  EXPECT_EQ(arm.version(), "");
  EXPECT_EQ(arm.heard_unix_ns(), 0);
  EXPECT_THAT(response.robots(1).agents(), IsEmpty());
}

TEST_F(RobotListTest, ShowsTheRobotsThatHaveAllOfTheLabels) {
  labels_.Set({{"r1", {"ring=canary", "site=hall-1"}}, {"r3", {"ring=canary"}}});
  EXPECT_THAT(List().robots(), SizeIs(2));
  const rips::v1::ListRobotsResponse canary = List({"ring=canary"});
  ASSERT_THAT(canary.robots(), SizeIs(1));
  EXPECT_EQ(canary.robots(0).robot(), "r1");
  EXPECT_THAT(canary.no_answer(), ElementsAre("r3"));
  const rips::v1::ListRobotsResponse both = List({"ring=canary", "site=hall-1"});
  EXPECT_THAT(both.robots(), SizeIs(1));
  EXPECT_THAT(both.no_answer(), IsEmpty());
  for (const char* label :
       {"", "ring", "ring=", "=canary", "ring=canary ", "ring=Canary", "\xff"}) {
    EXPECT_THAT(List({label}).robots(), IsEmpty()) << label;
  }
}

TEST_F(RobotListTest, FitsWhateverVersionsAgentsName) {
  std::vector<AgentId> agents;
  for (int robot = 0; robot < 2'000; ++robot) {
    for (int host = 0; host < 16; ++host) {
      for (const AgentKind kind : {AgentKind::kSensor, AgentKind::kActuator}) {
        agents.push_back(
            {absl::StrCat("r", robot), kind, absl::StrCat(std::string(60, 'h'), "-", host)});
      }
    }
  }
  contacts_.SetListed(agents);
  absl::btree_map<std::string, rips::v1::RobotStatus> statuses;
  for (const AgentId& agent : agents) {
    contacts_.Greeted(agent, {std::string(128, 'v'), "10.0.0.7"});
    statuses[agent.robot].set_robot(agent.robot);
  }
  statuses["quiet"].set_robot("quiet");
  rips::v1::ListRobotsResponse response;
  FillRobotList({}, {.contacts = &contacts_}, std::move(statuses), {}, response);
  EXPECT_GT(response.ByteSizeLong(), kAnswerBytesMax);
  FitStatuses(response);
  EXPECT_LE(response.ByteSizeLong(), kAnswerBytesMax);
  EXPECT_THAT(response.robots(), SizeIs(2'001)) << "every robot stays";
  EXPECT_THAT(response.robots(1).agents(), IsEmpty());
}

}  // namespace
}  // namespace rips::operator_api

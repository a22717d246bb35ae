#include "policy_server/ripsctl/robot/agent_contact_text.h"

#include <limits>

#include "gtest/gtest.h"

namespace rips::ripsctl {
namespace {

v1::AgentContact Heard(const std::string& version, uint64_t ago_ms) {
  v1::AgentContact agent;
  agent.set_role("sensor");
  agent.set_host("base");
  agent.set_version(version);
  agent.set_heard_unix_ns(1);
  agent.set_heard_ago_ms(ago_ms);
  return agent;
}

v1::AgentContact Never() {
  v1::AgentContact agent;
  agent.set_role("actuator");
  agent.set_host("arm");
  return agent;
}

TEST(AgentContactTextTest, SaysHowLongAgoInTheLargestUnitOfWhichTwoHavePassed) {
  EXPECT_EQ(AgoText(0), "0 s ago");
  EXPECT_EQ(AgoText(3'999), "3 s ago");
  EXPECT_EQ(AgoText(119'999), "119 s ago");
  EXPECT_EQ(AgoText(120'000), "2 min ago");
  EXPECT_EQ(AgoText(7'199'999), "119 min ago");
  EXPECT_EQ(AgoText(7'200'000), "2 h ago");
  EXPECT_EQ(AgoText(172'800'000), "2 d ago");
  EXPECT_EQ(AgoText(std::numeric_limits<uint64_t>::max()), "213503982334 d ago");
}

TEST(AgentContactTextTest, TheOldestContactOfARobotIsShown) {
  v1::RobotStatus status;
  EXPECT_EQ(OldestContact(status, "0.1.0"), "") << "a server that does not say";
  *status.add_agents() = Heard("0.1.0", 500);
  *status.add_agents() = Heard("0.1.0", 9'000);
  EXPECT_EQ(OldestContact(status, "0.1.0"), "9 s ago");
  *status.add_agents() = Never();
  EXPECT_EQ(OldestContact(status, "0.1.0"), "never") << "and no other version: it has said none";
}

TEST(AgentContactTextTest, AnotherVersionThanTheServersIsMarked) {
  v1::RobotStatus status;
  *status.add_agents() = Heard("0.1.0", 500);
  *status.add_agents() = Heard("0.0.9", 100);
  EXPECT_EQ(OldestContact(status, "0.1.0"), "0 s ago*");
  EXPECT_TRUE(HasOtherVersion(status, "0.1.0"));
  EXPECT_FALSE(HasOtherVersion(status, "")) << "a server that does not say its own";
  *status.mutable_agents(1) = Heard("", 100);
  EXPECT_TRUE(HasOtherVersion(status, "0.1.0")) << "an agent that hides its version";
}

TEST(AgentContactTextTest, DescribesAnAgent) {
  EXPECT_EQ(AgentText(Heard("0.1.0", 3'000), "0.1.0"), "sensor base: version 0.1.0, heard 3 s ago");
  EXPECT_EQ(AgentText(Heard("0.0.9", 3'000), "0.1.0"),
            "sensor base: version 0.0.9 (the server's is 0.1.0), heard 3 s ago");
  EXPECT_EQ(AgentText(Heard("", 3'000), ""), "sensor base: version not given, heard 3 s ago");
  EXPECT_EQ(AgentText(Never(), "0.1.0"), "actuator arm: not heard since the server's start");
}

}  // namespace
}  // namespace rips::ripsctl

// What `ripsctl level lower` says before it asks, against the server of the fixture.

#include <nlohmann/json.hpp>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/cli/firewalls.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"

namespace rips::ripsctl {
namespace {

TEST_F(RipsctlTest, ALoweringSaysWhatFirewallsHoldThatMayEndWithTheLevel) {
  const auto add = [this](const std::string& host, uint64_t epoch, const std::string& step,
                          bool ok) {
    v1::ReceivedReceipt& received = *fake_.receipts.add_receipts();
    received.set_host(host);
    *received.mutable_receipt()->mutable_decision_id() = MakeDecisionId(3, epoch);
    received.mutable_receipt()->add_steps()->set_step("system_mode /safety=COMPROMISED");
    v1::StepResult& added = *received.mutable_receipt()->add_steps();
    added.set_step(step);
    added.set_ok(ok);
  };
  add("arm", 17, "firewall release", true);
  add("base", 17, "firewall isolate_host 10.0.0.66", true);
  add("base", 17, "firewall isolate_host 10.0.0.67", true);   // older
  add("lidar", 16, "firewall isolate_host 10.0.0.68", true);  // of an earlier decision
  add("lidar", 15, "firewall isolate_host 10.0.0.69", true);  // which that one replaced
  add("arm", 16, "firewall isolate_host 10.0.0.70", true);    // released since
  add("wrist", 17, "firewall /etc/rips/alert.nft", false);
  add("cam", 17, "firewall release", true);
  fake_.receipts.mutable_receipts()->rbegin()->mutable_receipt()->mutable_steps(1)->set_detail(
      "not run: a raise opens nothing; what is in force ends with its time");
  add("cam", 17, "firewall /etc/rips/alert.nft", true);
  const auto drops = [this](const std::string& host, uint64_t packets, uint32_t quiet_s) {
    v1::HostFirewall& firewall = fake_.firewalls.emplace_back();
    firewall.set_host(host);
    firewall.set_dropped_packets(packets);
    firewall.set_counted_s(300);
    firewall.set_quiet_s(quiet_s);
  };
  drops("base", 1240, 2);
  const auto source = [this](const std::string& address, uint64_t packets, uint32_t quiet_s) {
    v1::FirewallSource& from = *fake_.firewalls.front().add_sources();
    from.set_address(address);
    from.set_packets(packets);
    from.set_quiet_s(quiet_s);
    return &from;
  };
  source("10.0.0.66", 1200, 2);
  v1::FirewallSource* const robot = source("10.0.0.13", 40, 55);
  robot->add_agents("sensor/r3/base");
  robot->add_agents("actuator/r3/base");
  fake_.firewalls.front().set_more_sources(3);
  drops("lidar", 7, 0);  // holds nothing any more
  EXPECT_THAT(
      Run({"level", "lower", "r1", "--to", "DEFAULT", "--dry-run"}).out,
      testing::StartsWith(
          "r1 is at COMPROMISED (3.17) since 2026-01-01T00:00:00.000Z, rule "
          "rogue_cmd_vel\n"
          "base holds `firewall isolate_host 10.0.0.66` as long as this level stands\n"
          "base says that it dropped 1240 packets in 300 s, the newest less than 3 s "
          "ago: something that it keeps out still sends; by address, which may be forged:\n"
          "  from 10.0.0.66: 1200 packets, the newest less than 3 s ago\n"
          "  from 10.0.0.13 (sensor/r3/base, actuator/r3/base connect from there): 40 packets, "
          "none in the last 55 s\n"
          "  from 3 other addresses in the last 10 min\n"
          "lidar may still hold `firewall isolate_host 10.0.0.68` of the level before (3.16): no "
          "level since has released it, so it ends, and lets everything in, when its time is "
          "over\n"
          "what lidar drops is not known; `nft list table inet rips` there shows it\n"
          "cam holds `firewall /etc/rips/alert.nft` as long as this level stands\n"
          "what cam drops is not known; `nft list table inet rips` there shows it\n"
          "what a firewall keeps out may come back when it is released\n"
          "would lower r1"));
  const nlohmann::json expected = {{{"host", "base"},
                                    {"steps", {"firewall isolate_host 10.0.0.66"}},
                                    {"decision_id", "3.17"},
                                    {"renewed", true},
                                    {"dropped_packets", 1240},
                                    {"counted_s", 300},
                                    {"quiet_s", 2},
                                    {"sources",
                                     {{{"address", "10.0.0.66"},
                                       {"packets", 1200},
                                       {"quiet_s", 2},
                                       {"agents", nlohmann::json::array()}},
                                      {{"address", "10.0.0.13"},
                                       {"packets", 40},
                                       {"quiet_s", 55},
                                       {"agents", {"sensor/r3/base", "actuator/r3/base"}}}}},
                                    {"more_sources", 3}},
                                   {{"host", "lidar"},
                                    {"steps", {"firewall isolate_host 10.0.0.68"}},
                                    {"decision_id", "3.16"},
                                    {"renewed", false},
                                    {"dropped_packets", nullptr},
                                    {"counted_s", nullptr},
                                    {"quiet_s", nullptr},
                                    {"sources", nullptr},
                                    {"more_sources", nullptr}},
                                   {{"host", "cam"},
                                    {"steps", {"firewall /etc/rips/alert.nft"}},
                                    {"decision_id", "3.17"},
                                    {"renewed", true},
                                    {"dropped_packets", nullptr},
                                    {"counted_s", nullptr},
                                    {"quiet_s", nullptr},
                                    {"sources", nullptr},
                                    {"more_sources", nullptr}}};
  EXPECT_EQ(RunJson({"level", "lower", "r1", "--to", "DEFAULT", "--dry-run"})["firewalls"],
            expected);
  EXPECT_EQ(RunJson({"level", "show", "r1"})["firewalls"], expected);
}

TEST(FirewallsTest, SaysHowMuchIsDroppedAndHowLongNothingWas) {
  v1::HostFirewall drops;
  drops.set_counted_s(300);
  EXPECT_EQ(DropsText(drops), "says that it dropped no packet in 300 s");
  drops.set_quiet_s(301);
  EXPECT_EQ(DropsText(drops), "says of what it dropped what cannot be");
  drops.set_dropped_packets(1);
  drops.set_quiet_s(42);
  EXPECT_EQ(DropsText(drops), "says that it dropped 1 packet in 300 s, none in the last 42 s");
  EXPECT_THAT(SourceLines(drops), testing::IsEmpty());
}

TEST(FirewallsTest, SaysFromWhom) {
  v1::HostFirewall drops;
  v1::FirewallSource& source = *drops.add_sources();
  source.set_address("\x1b[2J");
  source.set_packets(1);
  source.add_agents("sensor/r3/\x1b[2J");
  EXPECT_EQ(DropsText(drops),
            "says that it dropped no packet in 0 s; by address, which may be forged:");
  EXPECT_THAT(SourceLines(drops),
              testing::ElementsAre("\\x1b[2J (sensor/r3/\\x1b[2J connects from there): 1 packet, "
                                   "the newest less than 1 s ago"));
  drops.set_more_sources(1);
  EXPECT_EQ(SourceLines(drops).back(), "1 other address in the last 10 min");
  // Of so many not all are counted.
  drops.set_more_sources(255);
  EXPECT_EQ(SourceLines(drops).back(), "at least 255 other addresses in the last 10 min");
}

TEST(FirewallsTest, SaysWhenAllThatStillSendsHasAddressesOfAgents) {
  v1::HostFirewall drops;
  drops.set_dropped_packets(9);
  drops.set_counted_s(300);
  drops.add_sources()->add_agents("sensor/r3/base");
  v1::FirewallSource& other = *drops.add_sources();
  const char kOnlyAgents[] = "only hosts with agents of RIPS still send, as robots do";
  EXPECT_THAT(DropsText(drops), testing::Not(testing::HasSubstr(kOnlyAgents)));
  other.set_quiet_s(10);
  EXPECT_THAT(DropsText(drops), testing::HasSubstr(kOnlyAgents));
  drops.set_more_sources(1);
  EXPECT_THAT(DropsText(drops), testing::Not(testing::HasSubstr(kOnlyAgents)))
      << "not all are shown";
}

TEST(FirewallsTest, OfManySourcesShowsFirstWhatNoAgentExplains) {
  v1::HostFirewall drops;
  for (int i = 0; i < 12; ++i) {
    drops.add_sources()->set_address(absl::StrCat("10.0.0.", i));
    drops.mutable_sources(i)->add_agents("sensor/r3/base");
  }
  drops.mutable_sources(11)->clear_agents();
  drops.set_more_sources(5);
  const std::vector<std::string> lines = SourceLines(drops, {{"10.0.0.10", "/intruder"}});
  ASSERT_THAT(lines, testing::SizeIs(11));
  EXPECT_THAT(lines[0], testing::StartsWith("10.0.0.10 (sensor/r3/base connects from there) (which "
                                            "/intruder gave as its own): 0 packets"));
  EXPECT_THAT(lines[0], testing::EndsWith("the newest less than 1 s ago: it still sends"));
  drops.mutable_sources(10)->set_quiet_s(5);
  EXPECT_THAT(SourceLines(drops, {{"10.0.0.10", "/intruder"}})[0],
              testing::EndsWith("the newest less than 6 s ago: it may still send; look again in "
                                "10 s"));
  EXPECT_THAT(lines[1], testing::StartsWith("10.0.0.11: "));
  EXPECT_THAT(lines[2], testing::StartsWith("10.0.0.0 ("));
  EXPECT_EQ(lines[10], "7 other addresses in the last 10 min");
}

TEST_F(RipsctlTest, ADryRunOfALoweringSaysWhichFindingsStand) {
  const std::vector<std::string> dry_run = {"level", "lower", "r1", "--to", "ALERT", "--dry-run"};
  EXPECT_THAT(Run(dry_run).out, testing::HasSubstr("\nFindings: none stands\n"));
  fake_.coverage = MakeFindings(1);
  EXPECT_THAT(Run(dry_run).out, testing::HasSubstr("\nFindings: 1 stand now: 1 non_ros_reader\n"));
  EXPECT_EQ(Run(dry_run).code, 0) << "no rule need ask for them";
  EXPECT_THAT(Run({"level", "lower", "r1", "--to", "ALERT", "--reason", "x"}).out,
              testing::Not(testing::HasSubstr("Findings")));
}

}  // namespace
}  // namespace rips::ripsctl

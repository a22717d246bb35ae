// What `ripsctl level lower` says before it asks, against the server of the fixture.

#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
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
  add("wrist", 17, "firewall /etc/rips/alert.nft", false);
  EXPECT_THAT(Run({"level", "lower", "r1", "--to", "DEFAULT", "--dry-run"}).out,
              testing::StartsWith(
                  "r1 is at COMPROMISED (3.17) since 2026-01-01T00:00:00.000Z, rule "
                  "rogue_cmd_vel\n"
                  "base holds `firewall isolate_host 10.0.0.66` until a level releases it or its "
                  "time is over\n"
                  "what a firewall keeps out is not seen by RIPS, and may come back then; `nft "
                  "list ruleset` on the host shows whether it still sends\n"
                  "would lower r1"));
}

}  // namespace
}  // namespace rips::ripsctl

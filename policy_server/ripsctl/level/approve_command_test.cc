// `ripsctl level` where lowering needs two persons, against the server of the fixture.

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/ripsctl_fixture.h"

namespace rips::ripsctl {
namespace {

using ::testing::HasSubstr;

v1::PendingApproval MakePending(char digit) {
  v1::PendingApproval pending;
  pending.set_id(std::string(32, digit));
  pending.set_from("COMPROMISED");
  pending.set_to("DEFAULT");
  pending.set_operator_("alice (spiffe://td/operator/operator/alice)");
  pending.set_reason("aisle\nis clear");
  pending.set_asked_unix_ns(kNewYear);
  pending.set_expires_unix_ns(kNewYear + 600'000'000'000);
  return pending;
}

TEST_F(RipsctlTest, SaysThatALoweringWaitsForASecondOperator) {
  fake_.level_response.set_needs_approval(true);
  fake_.level_response.set_pending_approval_id(std::string(32, '3'));
  fake_.level_response.set_approval_expires_unix_ns(kNewYear);
  const std::vector<std::string> lower = {
      "level", "lower", "r1", "--to", "DEFAULT", "--reason", "x", "--expect", "COMPROMISED@3.17",
      "--wait"};
  const Result result = Run(lower);
  EXPECT_EQ(result.code, 1) << "it is not lowered";
  EXPECT_EQ(
      result.out,
      "r1 stays at DEFAULT until a second operator approves the lowering, before "
      "2026-01-01T00:00:00.000Z, with\n"
      "  ripsctl level approve r1 33333333 --reason TEXT --wait\n"
      "it must be asked for again if the level, the rules or what they judge change before that, "
      "or the server restarts\n");
  const nlohmann::json json = RunJson(lower, 1);
  EXPECT_EQ(json["needs_approval"], true);
  EXPECT_EQ(json["pending_approval_id"], std::string(32, '3'));
  EXPECT_EQ(json.contains("reached"), false);
  fake_.level_response.clear_pending_approval_id();
  EXPECT_THAT(Run({"level", "lower", "r1", "--to", "DEFAULT", "--reason", "x", "--dry-run"}).out,
              HasSubstr("would wait for a second operator to approve it\n"));
}

TEST_F(RipsctlTest, SaysAfterTheLoweringWhatBecameOfTheFirewall) {
  fake_.pending = {MakePending('3')};
  fake_.level_response.set_decided_level("DEFAULT");
  *fake_.level_response.mutable_decision_id() = MakeDecisionId(3, 18);
  fake_.level_states = {MakeStatus("r1", "COMPROMISED"), MakeStatus("r1", "DEFAULT")};
  *fake_.level_states[1].mutable_decision_id() = MakeDecisionId(3, 18);
  const auto receipt = [](const char* step, uint64_t epoch) {
    v1::ReceivedReceipt received;
    received.set_host("base");
    *received.mutable_receipt()->mutable_decision_id() = MakeDecisionId(3, epoch);
    v1::StepResult& added = *received.mutable_receipt()->add_steps();
    added.set_step(step);
    added.set_ok(true);
    return received;
  };
  const auto begin = fake_.level_states;
  const std::vector<std::string> approve = {"level",    "approve", "r1",    "33333333",
                                            "--reason", "x",       "--wait"};
  EXPECT_THAT(Run(approve).out, testing::EndsWith("every actuator has read it back\n"))
      << "there was none";
  fake_.level_states = begin;
  *fake_.receipts.add_receipts() = receipt("firewall isolate_host 10.0.0.66", 17);
  fake_.receipts_after_approval.emplace();
  *fake_.receipts_after_approval->add_receipts() = receipt("firewall release", 18);
  EXPECT_THAT(Run(approve).out,
              testing::EndsWith("every actuator has read it back\n"
                                "its firewall is released: what that kept out can come back\n"));
  fake_.level_states = begin;
  fake_.receipts.Clear();
  *fake_.receipts.add_receipts() = receipt("firewall isolate_host 10.0.0.66", 17);
  fake_.receipts_after_approval = fake_.receipts;
  EXPECT_THAT(Run(approve).out,
              HasSubstr("every actuator has read it back\nbase may still hold `firewall "
                        "isolate_host 10.0.0.66` of the level before (3.17): no level since"));
}

TEST_F(RipsctlTest, ApprovesWhatItShowed) {
  fake_.pending = {MakePending('3'), MakePending('4')};
  fake_.level_response.set_decided_level("DEFAULT");
  *fake_.level_response.mutable_decision_id() = MakeDecisionId(3, 18);
  const Result result = Run({"level", "approve", "r1", "444444", "--reason", "I see it, too"});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_EQ(result.out,
            "44444444: operator alice asked at "
            "2026-01-01T00:00:00.000Z to lower r1 from COMPROMISED to DEFAULT; until "
            "2026-01-01T00:10:00.000Z: aisle\\x0ais clear\n"
            "r1 goes to DEFAULT (3.18)\n");
  EXPECT_THAT(fake_.calls(), testing::ElementsAre("GetLevel", "ListReceipts r1",
                                                  absl::StrCat("Approve r1 ", std::string(32, '4'),
                                                               " I see it, too")));
  EXPECT_EQ(Run({"level", "approve", "r1", "33333333", "--reason", "no", "--reject"}).out,
            "33333333: operator alice asked at "
            "2026-01-01T00:00:00.000Z to lower r1 from COMPROMISED to DEFAULT; until "
            "2026-01-01T00:10:00.000Z: aisle\\x0ais clear\n"
            "r1 stays at DEFAULT\n");
  EXPECT_THAT(fake_.calls().back(), HasSubstr("reject"));
  fake_.pending[0].add_changes("node /\nvisitor came");
  fake_.pending[0].add_changes("node /camera left");
  EXPECT_THAT(
      Run({"level", "approve", "r1", "33333333", "--reason", "x", "--accept-changes"}).out,
      HasSubstr("aisle\\x0ais clear; since then: node /\\x0avisitor came, node /camera left\n"));
  EXPECT_THAT(fake_.calls().back(), HasSubstr(" accept-changes"));
  EXPECT_EQ(RunJson({"level", "show", "r1"})["pending_approvals"][0]["changes"][1],
            "node /camera left");
  fake_.pending[0].clear_changes();
  EXPECT_EQ(RunJson({"level", "approve", "r1", "33333333", "--reason", "x"})["decision_id"],
            "3.18");

  const Result none = Run({"level", "approve", "r1", "555555", "--reason", "x"});
  EXPECT_EQ(none.code, 1);
  EXPECT_THAT(none.err,
              HasSubstr("no lowering of r1 waits under `555555`; this one does: 33333333"));
  fake_.pending = {MakePending('3'), MakePending('3')};
  EXPECT_THAT(Run({"level", "approve", "r1", "333333", "--reason", "x"}).err,
              HasSubstr("write more digits"));
  for (const char* id : {"33333", "3333333g", "333333333333333333333333333333333"}) {
    EXPECT_EQ(Run({"level", "approve", "r1", id, "--reason", "x"}).code, 2) << id;
  }
  EXPECT_EQ(Run({"level", "approve", "r1", "333333"}).code, 2) << "a reason is required";
  EXPECT_EQ(Run({"level", "approve", "r1", "333333", "--reason", "x", "--reject", "--wait"}).code,
            2);
  EXPECT_EQ(
      Run({"level", "approve", "r1", "333333", "--reason", "x", "--reject", "--accept-changes"})
          .code,
      2);
  fake_.pending = {};
  EXPECT_THAT(Run({"level", "approve", "r1", "333333", "--reason", "x"}).err,
              HasSubstr("nor any other; if one did, `ripsctl alert list r1` says why"));
  fake_.pending = {MakePending('3')};
  EXPECT_EQ(RunJson({"level", "show", "r1"})["pending_approvals"][0]["id"], std::string(32, '3'));
  EXPECT_THAT(Run({"level", "show", "r1"}).out, HasSubstr("33333333: operator alice"));
}

}  // namespace
}  // namespace rips::ripsctl

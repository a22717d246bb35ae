#include "services/model_proto/actuator_codec.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::model_proto {
namespace {

using ::testing::ElementsAre;
using ::testing::SizeIs;

rips::v1::ActuatorHello Hello() {
  rips::v1::ActuatorHello hello;
  hello.mutable_hello()->set_protocol(1);
  return hello;
}

model::AuditHead SomeAuditHead() {
  return {.segment = 3,
          .public_key = std::string(32, '\xff'),
          .sequence = 812,
          .hash = std::string(32, '\0'),
          .signature = std::string(64, 's')};
}

TEST(ActuatorCodecTest, ProtectedPartsAreTaken) {
  rips::v1::ActuatorHello hello = Hello();
  hello.add_protected_parts("/safety");
  hello.add_protected_parts("/ns/camera");
  const auto decoded = Decode(hello);
  ASSERT_THAT(decoded, IsOk());
  EXPECT_THAT(decoded->protected_parts, ElementsAre("/safety", "/ns/camera"));
}

TEST(ActuatorCodecTest, PartsThatAreNoNamesAreRefused) {
  const std::string bad[] = {"", "safety", "/", "/a b", "/\x1b[2J", std::string(300, 'x')};
  for (const std::string& part : bad) {
    rips::v1::ActuatorHello hello = Hello();
    hello.add_protected_parts(part);
    EXPECT_TRUE(absl::IsInvalidArgument(Decode(hello).status())) << part;
  }
}

TEST(ActuatorCodecTest, InactivePartsAreNamedByTheirPlaces) {
  rips::v1::ActuatorHello hello = Hello();
  hello.add_protected_parts("/safety");
  hello.add_protected_parts("/camera");
  rips::v1::InactiveParts& inactive = *hello.add_inactive_parts();
  inactive.set_level("ALERT");
  inactive.add_parts(1);
  hello.add_published_while_inactive("/camera/health");
  const auto decoded = Decode(hello);
  ASSERT_THAT(decoded, IsOk());
  EXPECT_THAT(decoded->inactive_parts, ElementsAre(model::InactiveParts{"ALERT", {"/camera"}}));
  EXPECT_THAT(decoded->published_while_inactive, ElementsAre("/camera/health"));
  inactive.add_parts(2);
  EXPECT_TRUE(absl::IsInvalidArgument(Decode(hello).status())) << "no such part";
  inactive.clear_parts();
  hello.add_published_while_inactive("/a b");
  EXPECT_TRUE(absl::IsInvalidArgument(Decode(hello).status())) << "no topic";
}

TEST(ActuatorCodecTest, AsManyPartsAsTheLimitAreTaken) {
  rips::v1::ActuatorHello hello = Hello();
  for (int i = 0; i < 256; ++i) hello.add_protected_parts(absl::StrCat("/part", i));
  const auto most = Decode(hello);
  ASSERT_THAT(most, IsOk());
  EXPECT_THAT(most->protected_parts, SizeIs(256));
}

model::Command CommandTo(decltype(model::Command::what) what) {
  return {.id = std::string(32, 'a'), .term = 7, .ttl_ms = 15'000, .what = std::move(what)};
}

TEST(ActuatorCodecTest, CommandsComeBackAsTheyWere) {
  const model::Command commands[] = {
      CommandTo(model::SetLevel{.decision_id = {7, 3},
                                .from = "HALT",
                                .to = "ALERT",
                                .cause = "operator alice",
                                .based_on = {7, 2}}),
      CommandTo(model::SetLevel{.decision_id = {7, 1}, .to = "HALT"}),
      CommandTo(model::RunProgram{.program = "horn", .args = {"-l", ""}, .timeout_ms = 500}),
      CommandTo(model::Drill{.level = "ALERT"})};
  for (const model::Command& command : commands) {
    const rips::v1::Command wire = Encode(command);
    EXPECT_EQ(wire.id().size(), 16u);
    const auto back = Decode(wire);
    ASSERT_THAT(back, IsOk());
    EXPECT_EQ(*back, command);
  }
  EXPECT_FALSE(Encode(commands[1]).set_level().has_based_on()) << "a raise needs none";
}

TEST(ActuatorCodecTest, CommandsThatNoServerSendsAreRefused) {
  rips::v1::Command wire = Encode(CommandTo(model::Drill{.level = "ALERT"}));
  wire.mutable_drill()->clear_level();
  EXPECT_THAT(Decode(wire), StatusIs(absl::StatusCode::kInvalidArgument));
  wire = Encode(CommandTo(model::RunProgram{.program = "horn"}));
  wire.mutable_run_program()->clear_program();
  EXPECT_THAT(Decode(wire), StatusIs(absl::StatusCode::kInvalidArgument));
  wire.clear_kind();
  EXPECT_THAT(Decode(wire), StatusIs(absl::StatusCode::kInvalidArgument));
  for (const size_t bytes : {0, 15, 17}) {
    wire = Encode(CommandTo(model::Drill{.level = "ALERT"}));
    wire.set_id(std::string(bytes, 'a'));
    EXPECT_THAT(Decode(wire), StatusIs(absl::StatusCode::kInvalidArgument)) << bytes;
  }
}

TEST(ActuatorCodecTest, LeasesComeBackAsTheyWere) {
  const model::LeaseGrant lease{.echo_boottime_ns = 12,
                                .term = 7,
                                .decision_id = {7, 3},
                                .level = "ALERT",
                                .ttl_ms = 15'000,
                                .heartbeat_ms = 2'000,
                                .evidence_complete = true,
                                .audit_head = SomeAuditHead()};
  rips::v1::Lease wire = Encode(lease, {.boottime_ns = 34, .unix_ns = 56});
  EXPECT_EQ(wire.heartbeat().clock().boottime_ns(), 34u);
  EXPECT_EQ(Decode(wire), lease);
  wire.mutable_heartbeat()->set_echo_boottime_ns(UINT64_MAX);
  EXPECT_GT(Decode(wire).echo_boottime_ns, 0) << "no time before the boot";
}

TEST(ActuatorCodecTest, AnAuditHeadThatIsNotWholeIsNone) {
  const model::LeaseGrant lease{.audit_head = SomeAuditHead()};
  const std::vector<std::function<void(rips::v1::AuditHead&)>> faults = {
      [](auto& head) { head.clear_segment(); }, [](auto& head) { head.clear_sequence(); },
      [](auto& head) { head.mutable_public_key()->pop_back(); },
      [](auto& head) { head.mutable_hash()->push_back('x'); },
      [](auto& head) { head.clear_signature(); }};
  for (const auto& fault : faults) {
    rips::v1::Lease granted = Encode(lease, {});
    fault(*granted.mutable_audit_head());
    EXPECT_TRUE(Decode(granted).audit_head.none());
    rips::v1::ActuatorHello hello =
        Encode(model::ActuatorHello{.last_audit_head = SomeAuditHead()});
    ASSERT_THAT(Decode(hello), IsOk());
    EXPECT_EQ(Decode(hello)->last_audit_head, SomeAuditHead());
    fault(*hello.mutable_hello()->mutable_last_audit_head());
    EXPECT_THAT(Decode(hello), StatusIs(absl::StatusCode::kInvalidArgument));
  }
  EXPECT_FALSE(Encode(model::LeaseGrant(), {}).has_audit_head());
  EXPECT_FALSE(Encode(model::ActuatorHello()).hello().has_last_audit_head());
}

TEST(ActuatorCodecTest, ReceiptsComeBackAsTheyWere) {
  model::Receipt receipt{.command_id = std::string(32, 'b'),
                         .decision_id = {7, 3},
                         .exit_code = 137,
                         .output_tail = "\xff",
                         .detail = "killed",
                         .effective_level = "ALERT"};
  for (const model::Drilled drilled : {model::Drilled::kNoDrill, model::Drilled::kDone,
                                       model::Drilled::kLooked, model::Drilled::kNot}) {
    receipt.steps.push_back({.step = "program horn",
                             .ok = true,
                             .took_ms = 9,
                             .detail = "d",
                             .drilled = drilled,
                             .output_tail = "o"});
  }
  for (int stage = 1; stage <= 7; ++stage) {
    receipt.stage = static_cast<model::Receipt::Stage>(stage);
    const auto back = Decode(Encode(receipt));
    ASSERT_THAT(back, IsOk());
    EXPECT_EQ(*back, receipt) << stage;
  }
}

TEST(ActuatorCodecTest, AStageThatIsUnknownIsRefusedAndADrillsIsNotTried) {
  rips::v1::Receipt wire;
  EXPECT_THAT(Decode(wire), StatusIs(absl::StatusCode::kInvalidArgument));
  wire.set_stage(static_cast<rips::v1::Receipt::Stage>(8));
  EXPECT_THAT(Decode(wire), StatusIs(absl::StatusCode::kInvalidArgument));
  wire.set_stage(rips::v1::Receipt::VERIFIED);
  for (const int drilled : {-1, 4}) {
    wire.add_steps()->set_drilled(static_cast<rips::v1::StepResult::Drilled>(drilled));
  }
  const auto receipt = Decode(wire);
  ASSERT_THAT(receipt, IsOk());
  for (const model::StepResult& step : receipt->steps) {
    EXPECT_EQ(step.drilled, model::Drilled::kNot);
  }
}

TEST(ActuatorCodecTest, AHelloComesBackAsItWas) {
  const model::ActuatorHello hello{.levels = {"DEFAULT", "ALERT"},
                                   .programs = {"horn"},
                                   .decision_id = {7, 3},
                                   .decided_level = "ALERT",
                                   .effective_level = "DEFAULT",
                                   .highest_term = 8,
                                   .state_lost = true,
                                   .fail_safe_level = "keep",
                                   .participant = *ros2::GuidFromBytes(std::string(16, 'g')),
                                   .protected_parts = {"/safety", "/camera"},
                                   .inactive_parts = {{"DEFAULT", {}}, {"HALT", {"/camera"}}},
                                   .published_while_inactive = {"/camera/health"},
                                   .clock = {.boottime_ns = 5, .unix_ns = 6}};
  const auto back = Decode(Encode(hello));
  ASSERT_THAT(back, IsOk());
  EXPECT_EQ(back->levels, hello.levels);
  EXPECT_EQ(back->programs, hello.programs);
  EXPECT_EQ(back->decision_id, hello.decision_id);
  EXPECT_EQ(back->decided_level, hello.decided_level);
  EXPECT_EQ(back->effective_level, hello.effective_level);
  EXPECT_EQ(back->highest_term, hello.highest_term);
  EXPECT_TRUE(back->state_lost);
  EXPECT_EQ(back->fail_safe_level, hello.fail_safe_level);
  EXPECT_EQ(back->participant, hello.participant);
  EXPECT_EQ(back->protected_parts, hello.protected_parts);
  EXPECT_EQ(back->inactive_parts, hello.inactive_parts);
  EXPECT_EQ(back->published_while_inactive, hello.published_while_inactive);
  EXPECT_EQ(back->clock.boottime_ns, 5);
  EXPECT_EQ(back->clock.unix_ns, 6);
}

TEST(ActuatorCodecTest, WhatIsDegradedIsTakenWithinLimits) {
  rips::v1::ActuatorHeartbeat wire;
  wire.add_degraded("held without the mode manager");
  wire.add_degraded("\x1b[2J");
  wire.add_degraded(std::string(300, 'x'));
  wire.add_degraded(std::string(300, '\x01'));
  for (int i = 0; i < 20; ++i) wire.add_degraded("more");
  wire.set_drifts(7);
  const model::ActuatorHeartbeat heartbeat = Decode(wire);
  ASSERT_THAT(heartbeat.degraded, SizeIs(8));
  EXPECT_EQ(heartbeat.degraded[0], "held without the mode manager");
  EXPECT_EQ(heartbeat.degraded[1], "\\x1b[2J");
  EXPECT_EQ(heartbeat.degraded[2], std::string(256, 'x'));
  EXPECT_THAT(heartbeat.degraded[3], SizeIs(256));
  EXPECT_EQ(heartbeat.drifts, 7u);
}

TEST(ActuatorCodecTest, WhatAFirewallDroppedComesBackOrIsAbsent) {
  model::ActuatorHeartbeat heartbeat;
  EXPECT_EQ(Decode(Encode(heartbeat)).firewall_drops, std::nullopt);
  heartbeat.firewall_drops = model::FirewallDrops{.packets = 1240, .counted_s = 300, .quiet_s = 42};
  EXPECT_EQ(Decode(Encode(heartbeat)).firewall_drops, heartbeat.firewall_drops);
  heartbeat.firewall_drops->sources = {{"10.0.0.66", 1200, 42}, {"fd00::7", 40, 60}};
  heartbeat.firewall_drops->more_sources = 3;
  EXPECT_EQ(Decode(Encode(heartbeat)).firewall_drops, heartbeat.firewall_drops);
}

TEST(ActuatorCodecTest, StepsKeepWhatTheyPrintedAndWhetherTheyWereDrilled) {
  rips::v1::Receipt receipt;
  receipt.set_stage(rips::v1::Receipt::VERIFIED);
  rips::v1::StepResult* step = receipt.add_steps();
  step->set_drilled(rips::v1::StepResult::DRILLED_LOOKED);
  step->set_output_tail(std::string(4096, 'x'));
  const auto decoded = Decode(receipt);
  ASSERT_THAT(decoded, IsOk());
  EXPECT_EQ(decoded->steps[0].drilled, model::Drilled::kLooked);
  EXPECT_EQ(decoded->steps[0].output_tail, std::string(4096, 'x'));
}

}  // namespace
}  // namespace rips::model_proto

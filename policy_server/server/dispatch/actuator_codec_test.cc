#include "policy_server/server/dispatch/actuator_codec.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::dispatch {
namespace {

using ::testing::ElementsAre;
using ::testing::SizeIs;

rips::v1::ActuatorHello Hello() {
  rips::v1::ActuatorHello hello;
  hello.mutable_hello()->set_protocol(1);
  return hello;
}

TEST(ActuatorCodecTest, ProtectedPartsAreTaken) {
  rips::v1::ActuatorHello hello = Hello();
  hello.add_protected_parts("/safety");
  hello.add_protected_parts("/ns/camera");
  const auto decoded = DecodeHello(hello);
  ASSERT_THAT(decoded, IsOk());
  EXPECT_THAT(decoded->protected_parts, ElementsAre("/safety", "/ns/camera"));
}

TEST(ActuatorCodecTest, PartsThatAreNoNamesAreRefused) {
  const std::string bad[] = {"", "safety", "/", "/a b", "/\x1b[2J", std::string(300, 'x')};
  for (const std::string& part : bad) {
    rips::v1::ActuatorHello hello = Hello();
    hello.add_protected_parts(part);
    EXPECT_TRUE(absl::IsInvalidArgument(DecodeHello(hello).status())) << part;
  }
}

TEST(ActuatorCodecTest, AsManyPartsAsTheLimitAreTaken) {
  rips::v1::ActuatorHello hello = Hello();
  for (int i = 0; i < 256; ++i) hello.add_protected_parts(absl::StrCat("/part", i));
  const auto most = DecodeHello(hello);
  ASSERT_THAT(most, IsOk());
  EXPECT_THAT(most->protected_parts, SizeIs(256));
}

TEST(ActuatorCodecTest, ADrillIsACommandOfItsOwn) {
  const rips::v1::Command command = EncodeCommand({.id = std::string(32, 'a'),
                                                   .term = 7,
                                                   .ttl_ms = 15'000,
                                                   .what = pipeline::Drill{.level = "ALERT"}});
  EXPECT_EQ(command.drill().level(), "ALERT");
  EXPECT_EQ(command.term(), 7u);
  EXPECT_EQ(command.ttl_ms(), 15'000u);
  EXPECT_EQ(command.id().size(), 16u);
}

TEST(ActuatorCodecTest, WhatIsDegradedIsTakenWithinLimits) {
  rips::v1::ActuatorHeartbeat wire;
  wire.add_degraded("held without the mode manager");
  wire.add_degraded("\x1b[2J");
  wire.add_degraded(std::string(300, 'x'));
  wire.add_degraded(std::string(300, '\x01'));
  for (int i = 0; i < 20; ++i) wire.add_degraded("more");
  wire.set_drifts(7);
  const pipeline::ActuatorHeartbeat heartbeat = DecodeHeartbeat(wire);
  ASSERT_THAT(heartbeat.degraded, SizeIs(8));
  EXPECT_EQ(heartbeat.degraded[0], "held without the mode manager");
  EXPECT_EQ(heartbeat.degraded[1], "\\x1b[2J");
  EXPECT_EQ(heartbeat.degraded[2], std::string(256, 'x'));
  EXPECT_THAT(heartbeat.degraded[3], SizeIs(256));
  EXPECT_EQ(heartbeat.drifts, 7u);
}

TEST(ActuatorCodecTest, StepsKeepWhatTheyPrintedAndWhetherTheyWereDrilled) {
  rips::v1::Receipt receipt;
  receipt.set_stage(rips::v1::Receipt::VERIFIED);
  rips::v1::StepResult* step = receipt.add_steps();
  step->set_drilled(rips::v1::StepResult::DRILLED_LOOKED);
  step->set_output_tail(std::string(4096, 'x'));
  const auto decoded = DecodeReceipt(receipt);
  ASSERT_THAT(decoded, IsOk());
  EXPECT_EQ(decoded->steps[0].drilled, pipeline::StepReport::Drilled::kLooked);
  EXPECT_EQ(decoded->steps[0].output_tail, std::string(4096, 'x'));
}

}  // namespace
}  // namespace rips::dispatch

// SystemModes with a mode manager on Fast DDS, which pairs replies with requests in its own way.
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/system_mode/system_modes.h"
#include "services/base/status_matchers.h"
#include "services/dds/participant.h"
#include "services/dds/service_client.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/real_clock.h"
#include "tests/integration/bus_world.h"

namespace rips::actuator {
namespace {

using bus::Child;
using ::testing::HasSubstr;

// Before any thread is started. Fast DDS knows no discovery tag.
const bool own_network = bus::EnterOwnNetwork();

constexpr absl::string_view kSmh = R"(safety:
  ros__parameters:
    type: system
    modes:
      __DEFAULT__: {eye: active}
      ALERT: {eye: inactive}
      HALT: {eye: inactive}
eye:
  ros__parameters:
    type: node
    modes: {__DEFAULT__: {ros__parameters: {rate: 15.0}}}
)";

class FastModesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(absl::StrCat(RIPS_BIN_DIR, "/fastdds_peer"))) {
      GTEST_SKIP() << "Fast DDS is not installed";
    }
    if (!own_network) GTEST_SKIP() << "no network namespace is granted; run as root";
    const dds::ScopedCycloneUri uri(
        "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" "
        "multicast=\"true\"/></Interfaces></General><Discovery><ParticipantIndex>none"
        "</ParticipantIndex></Discovery></Domain></CycloneDDS>");
    participant_ = *dds::Participant::Create({.id = dds::RandomDomain()});
    modes_ = *SystemModes::Create(participant_.get(), *ParseSmh(kSmh),
                                  {.verify = Verify::kManager, .fallback = Fallback::kNone},
                                  {{"/safety", "__DEFAULT__"}, {"/safety", "ALERT"}}, &clock_);
  }
  std::unique_ptr<Child> Manager(const std::vector<std::string>& modes) {
    std::vector<std::string> args = {
        "--domain", absl::StrCat(dds::RandomDomain()), "--node", "/manager", "--modes", "/safety"};
    for (const std::string& mode : modes) args.insert(args.end(), {"--mode", mode});
    auto manager = std::make_unique<Child>("fastdds_peer", args);
    EXPECT_TRUE(manager->WaitFor("up"));
    return manager;
  }
  ModeReading Enter(const std::string& mode) {
    return modes_->Enter("/safety", mode, absl::Seconds(20), 0, cancel_);
  }

  RealClock clock_;
  CancelFlag cancel_;
  std::unique_ptr<dds::Participant> participant_;
  std::unique_ptr<SystemModes> modes_;
};

TEST_F(FastModesTest, OrdersAndReadsBack) {
  const auto manager = Manager({"__DEFAULT__", "ALERT"});
  for (const char* mode : {"ALERT", "__DEFAULT__", "ALERT"}) {
    const ModeReading reading = Enter(mode);
    ASSERT_THAT(reading.status, IsOk()) << ::testing::PrintToString(manager->Lines());
    EXPECT_EQ(reading.observed, mode);
    EXPECT_THAT(modes_->Check("/safety", mode, cancel_).status, IsOk());
  }
  EXPECT_TRUE(dds::Eventually([&] { return modes_->CheckAvailable().ok(); }));
  EXPECT_EQ(manager->Line("order ?"), "") << "it understood what it was told";
}

TEST_F(FastModesTest, ARefusalAndAnotherFileAreTold) {
  const auto manager = Manager({"__DEFAULT__"});
  EXPECT_THAT(Enter("ALERT").status,
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("refuses `ALERT`")));
  EXPECT_TRUE(dds::Eventually([&] { return absl::IsFailedPrecondition(modes_->CheckAvailable()); }))
      << modes_->CheckAvailable();
}

TEST_F(FastModesTest, ARestartIsSeenAndManyCallsArePaired) {
  auto manager = Manager({"__DEFAULT__", "ALERT"});
  ASSERT_THAT(Enter("ALERT").status, IsOk());
  for (int i = 0; i < 50; ++i) {
    ASSERT_THAT(modes_->Check("/safety", "ALERT", cancel_).status, IsOk()) << i;
  }
  ASSERT_TRUE(manager->End(SIGTERM));
  manager = Manager({"__DEFAULT__", "ALERT"});
  // It starts in its own mode and is told of ours, once.
  EXPECT_TRUE(dds::Eventually([&] {
    const absl::Status status = modes_->Check("/safety", "ALERT", cancel_).status;
    if (!status.ok()) Enter("ALERT").status.IgnoreError();
    return !manager->Line("order ALERT").empty();
  }));
}

}  // namespace
}  // namespace rips::actuator

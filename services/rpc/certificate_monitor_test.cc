#include "services/rpc/certificate_monitor.h"

#include <sys/stat.h>

#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"

namespace rips::rpc {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

TEST(StageOfTest, ThirdTenthAndEnd) {
  const absl::Time begin = absl::FromUnixSeconds(0);
  const absl::Time end = absl::FromUnixSeconds(30);
  const auto stage = [&](int second) { return StageOf(begin, end, absl::FromUnixSeconds(second)); };
  EXPECT_EQ(stage(0), LifeStage::kGood);
  EXPECT_EQ(stage(19), LifeStage::kGood);
  EXPECT_EQ(stage(20), LifeStage::kThird);
  EXPECT_EQ(stage(26), LifeStage::kThird);
  EXPECT_EQ(stage(27), LifeStage::kTenth);
  EXPECT_EQ(stage(30), LifeStage::kTenth);
  EXPECT_EQ(stage(31), LifeStage::kExpired);
}

class CertificateMonitorTest : public ::testing::Test {
 protected:
  absl::Time Wall() const { return absl::FromUnixNanos(clock_.Now().unix_ns); }
  Peer Sensor(const std::string& serial, absl::Duration life) const {
    return {
        .identity = {.role = Role::kSensor, .trust_domain = "td", .robot = "r1", .host = "base"},
        .not_after = Wall() + life,
        .not_before = Wall(),
        .serial = serial};
  }
  std::vector<LifeStage> After(absl::Duration passed) {
    stages_.clear();
    clock_.Advance(absl::ToInt64Nanoseconds(passed));
    monitor_.Check();
    monitor_.Check();  // nothing is reported twice
    return stages_;
  }

  FakeClock clock_;
  Metrics metrics_;
  std::vector<LifeStage> stages_;
  CertificateMonitor monitor_{
      {.own = {.ca = "/none", .cert = "/none", .key = "/none"},
       .notify = [this](const auto& notice) { stages_.push_back(notice.stage); },
       .interval = absl::InfiniteDuration()},
      &clock_,
      &metrics_};
};

TEST_F(CertificateMonitorTest, TellsEachStageOnceAndKeepsTheGauge) {
  monitor_.Seen(Sensor("0a", absl::Hours(30)));
  EXPECT_THAT(After(absl::Hours(19)), IsEmpty());
  EXPECT_THAT(After(absl::Hours(1)), ElementsAre(LifeStage::kThird));
  EXPECT_THAT(After(absl::Hours(7)), ElementsAre(LifeStage::kTenth));
  EXPECT_THAT(
      metrics_.Text(),
      HasSubstr(
          R"(rips_certificate_expiry_seconds{name="r1/base",role="sensor",whose="peer"} 10800)"));
  EXPECT_THAT(After(absl::Hours(4)), ElementsAre(LifeStage::kExpired));
  EXPECT_THAT(metrics_.Text(), HasSubstr("} -3600"));
}

TEST_F(CertificateMonitorTest, ARenewedCertificateStartsAnewAndTheSameOneDoesNot) {
  const Peer first = Sensor("0a", absl::Hours(30));
  monitor_.Seen(first);
  EXPECT_THAT(After(absl::Hours(20)), ElementsAre(LifeStage::kThird));
  monitor_.Seen(first);
  EXPECT_THAT(After(absl::Hours(1)), IsEmpty());
  monitor_.Seen(Sensor("0b", absl::Hours(30)));
  EXPECT_THAT(After(absl::Hours(10)), IsEmpty());
  EXPECT_THAT(After(absl::Hours(11)), ElementsAre(LifeStage::kThird));
}

TEST_F(CertificateMonitorTest, OneMetByALateStartIsToldItsLastStageAlone) {
  monitor_.Seen(Sensor("0a", absl::Hours(30)));
  EXPECT_THAT(After(absl::Hours(28)), ElementsAre(LifeStage::kTenth));
}

TEST_F(CertificateMonitorTest, ItsOwnFilesCountForReadiness) {
  monitor_.Check();
  EXPECT_THAT(monitor_.own_status(), Not(IsOk()));
  EXPECT_THAT(stages_, IsEmpty());
}

TEST(CertificateMonitorKeyTest, SaysThatARenewedKeyIsOpenToOthersAndWhenItIsNoMore) {
  const std::string key = testing::TempDir() + "/monitor-key.pem";
  std::ofstream(key) << "x";
  FakeClock clock;
  Metrics metrics;
  CertificateMonitor monitor(
      {.own = {.ca = "/none", .cert = "/none", .key = key}, .interval = absl::InfiniteDuration()},
      &clock, &metrics);
  const auto said = [&](mode_t mode) {
    chmod(key.c_str(), mode);
    testing::internal::CaptureStderr();
    monitor.Check();
    monitor.Check();
    return testing::internal::GetCapturedStderr();
  };
  EXPECT_EQ(said(0600), "");
  const std::string open = said(0644);
  EXPECT_THAT(open, HasSubstr("the next start will refuse the private key"));
  EXPECT_THAT(open, HasSubstr("chmod o-rwx " + key));
  EXPECT_EQ(open.find("refuse"), open.rfind("refuse")) << "once";
  EXPECT_THAT(said(0600), HasSubstr("the private key is private again"));
  EXPECT_EQ(said(0600), "");
  std::remove(key.c_str());
}

}  // namespace
}  // namespace rips::rpc

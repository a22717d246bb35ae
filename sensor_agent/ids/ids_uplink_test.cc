// Alerts from a log through outbox and stream to a policy server.
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/ids/ids_feed.h"
#include "sensor_agent/uplink/fake_policy_server.h"
#include "sensor_agent/uplink/uplink.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips::sensor {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

TEST(OutboxIdsTest, AlertsAreCountedWhenTheyAreAcknowledged) {
  Outbox outbox;
  const auto add = [&](uint32_t sid) { outbox.AddControl({.what = IdsAlert{.sid = sid}}); };
  add(1);
  outbox.AddControl({.what = Finding{.kind = "impostor"}});
  add(2);
  add(3);
  outbox.MarkSent(Lane::kControl, 4);
  ASSERT_THAT(outbox.Acknowledge(Lane::kControl, 2), IsOk());
  EXPECT_EQ(outbox.acknowledged_ids_alerts(), 1);
  ASSERT_THAT(outbox.Acknowledge(Lane::kControl, 2), IsOk());
  EXPECT_EQ(outbox.acknowledged_ids_alerts(), 1) << "said twice";
  // Another stream, another incarnation, another place in the fleet: they are the same alerts.
  outbox.Rewind();
  outbox.Renumber();
  outbox.SetPrimary(false);
  outbox.ReplaceGraph({}, 1);
  outbox.MarkSent(Lane::kControl, 2);
  ASSERT_THAT(outbox.Acknowledge(Lane::kControl, 2), IsOk());
  EXPECT_EQ(outbox.acknowledged_ids_alerts(), 3);
}

class IdsUplinkTest : public testing::Test {
 protected:
  IdsUplinkTest() {
    std::string name = testing::TempDir() + "/ids_uplink_XXXXXX";
    dir_ = mkdtemp(name.data());
    std::ofstream(dir_ + "/fast.log");
    server_.Start();
    uplink_ = std::make_unique<Uplink>(
        UplinkOptions{.servers = {server_.address()},
                      .credentials = grpc::InsecureChannelCredentials(),
                      .host = "base"},
        Uplink::Hooks{.on_own_participants = [](const auto&) {},
                      .on_snapshot_wanted = [this] { uplink_->ReplaceGraph({}); },
                      .on_interest = [](const auto&) {}},
        &clock_, &metrics_);
    feed_ = std::make_unique<IdsFeed>(
        IdsFeedOptions{.logs = {{IdsFormat::kFast, dir_ + "/fast.log"}},
                       .offsets_file = dir_ + "/ids-offsets"},
        IdsSink{.ready = [this] { return uplink_->Ready().ok(); },
                .take =
                    [this](std::vector<ControlObservation> alerts, std::vector<Loss> losses) {
                      uplink_->Append(
                          {.losses = std::move(losses), .ids_alerts = std::move(alerts)});
                    },
                .acknowledged = [this] { return uplink_->acknowledged_ids_alerts(); }},
        &clock_, &metrics_);
    feed_->Turn();  // what is there is old from here on
    uplink_->Start();
    feed_->Start();
  }
  ~IdsUplinkTest() override {
    feed_->Stop();
    uplink_->Stop();
    server_.Stop();
    std::filesystem::remove_all(dir_);
    EXPECT_THAT(server_.violations, IsEmpty());
  }

  void Append(uint32_t sid) {
    std::ofstream(dir_ + "/fast.log", std::ios::app)
        << "11/21-10:11:12.1  [**] [1:" << sid << ":3] sc\xFF"
        << "an [**] [Classification: c] "
        << "[Priority: 2] {TCP} fe80::9:4444 -> 10.0.0.1:80\n";
  }
  static std::vector<rips::v1::IdsAlert> Alerts(const FakePolicyServer& server) {
    std::vector<rips::v1::IdsAlert> alerts;
    for (const Recorded& each : server.Distinct(rips::v1::CONTROL)) {
      if (each.what.has_ids()) alerts.push_back(each.what.ids());
    }
    return alerts;
  }
  bool WaitForAlerts(size_t count) {
    return server_.WaitUntil([&](const auto& s) { return Alerts(s).size() >= count; });
  }

  const RealClock clock_;
  Metrics metrics_;
  FakePolicyServer server_;
  std::string dir_;
  std::unique_ptr<Uplink> uplink_;
  std::unique_ptr<IdsFeed> feed_;
};

TEST_F(IdsUplinkTest, EveryFieldArrives) {
  Append(7);
  ASSERT_TRUE(WaitForAlerts(1));
  feed_->Stop();
  uplink_->Stop();
  const rips::v1::IdsAlert alert = Alerts(server_)[0];
  EXPECT_EQ(alert.source(), "snort");
  EXPECT_EQ(alert.gid(), 1);
  EXPECT_EQ(alert.sid(), 7);
  EXPECT_EQ(alert.rev(), 3);
  EXPECT_EQ(alert.message(),
            "sc\xEF\xBF\xBD"
            "an");
  EXPECT_EQ(alert.severity(), 2);
  EXPECT_EQ(alert.src(), "[fe80::9]:4444");
  EXPECT_EQ(alert.dst(), "10.0.0.1:80");
  EXPECT_EQ(alert.line(),
            "11/21-10:11:12.1  [**] [1:7:3] sc\xEF\xBF\xBD"
            "an [**] [Classification: c] "
            "[Priority: 2] {TCP} fe80::9:4444 -> 10.0.0.1:80");
}

TEST_F(IdsUplinkTest, OverBrokenStreamsEachIsThereOnce) {
  std::vector<uint32_t> expected;
  for (uint32_t sid = 1; sid <= 40; ++sid) {
    if (sid % 7 == 0) server_.Set([](auto& b) { b.batches_until_close = 1; });
    if (sid == 20) server_.Set([](auto& b) { b.acknowledge = false; });
    if (sid == 30) server_.Set([](auto& b) { b.acknowledge = true; });
    Append(sid);
    expected.push_back(sid);
    if (sid % 4 == 0) {
      ASSERT_TRUE(WaitForAlerts(sid));
    }
  }
  ASSERT_TRUE(WaitForAlerts(40));
  ASSERT_TRUE(
      server_.WaitUntil([&](const auto&) { return uplink_->acknowledged_ids_alerts() == 40; }));
  feed_->Stop();
  uplink_->Stop();
  std::vector<uint32_t> sids;
  for (const rips::v1::IdsAlert& each : Alerts(server_)) sids.push_back(each.sid());
  EXPECT_EQ(sids, expected);
  for (const Recorded& each : server_.received) EXPECT_FALSE(each.what.has_loss());
}

}  // namespace
}  // namespace rips::sensor

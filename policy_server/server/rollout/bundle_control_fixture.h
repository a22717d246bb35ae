// The parts of a server around BundleControl, for tests: real bundles on disk, a store in memory.
#ifndef RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_CONTROL_FIXTURE_H_
#define RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_CONTROL_FIXTURE_H_

#include <gtest/gtest.h>

#include <fstream>
#include <functional>
#include <memory>
#include <string>

#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_signature.h"
#include "policy_server/server/robot/fake_ports.h"
#include "policy_server/server/robot/ports.h"
#include "policy_server/server/rollout/bundle_control.h"
#include "policy_server/server/rollout/bundle_files_for_test.h"
#include "policy_server/server/shadow/shadow_run.h"
#include "policy_server/server/shadow/shadows.h"
#include "policy_server/server/shard/store_recorder.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/fake_store.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/fake_clock.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/base/status_matchers.h"

namespace rips::rollout {

// A server's parts around real bundles on disk and a store in memory, which outlive a restart.
class BundleControlFixture : public ::testing::Test {
 protected:
  void SetUp() override {
    WriteBundle(dir_.File("source/warehouse"), "warehouse");
    WriteBundle(dir_.File("source/dock"), "dock");
    std::ofstream inventory(dir_.File("robots.yaml"));
    inventory << "robots:\n";
    for (const char* robot : {"r1", "r2", "r3", "r4"}) {
      inventory << "  - {id: " << robot << ", bundle: warehouse, sensors: [{host: base, primary: "
                << "true}], labels: {ring: " << (robot[1] == '2' ? "canary" : "main") << "}}\n";
    }
    inventory << "  - {id: d1, bundle: dock, sensors: [{host: base, primary: true}]}\n";
    inventory.close();
    Start();
  }
  void TearDown() override { Stop(); }

  void Start() {
    committer_ = std::make_unique<store::Committer>(&store_);
    recorder_ = std::make_unique<pipeline::StoreRecorder>(&store_, committer_.get());
    alerts_ = std::make_unique<pipeline::ServerAlerts>(committer_.get(), &quiet_, &clock_, NewId);
    rates_ = std::make_unique<AlertRates>(&quiet_, &clock_);
    activations_ = std::make_unique<Activations>(dir_.File("kept/activated.json"), &store_);
    pipeline_ = std::make_unique<pipeline::Pipeline>(2, &clock_);
    policies_ = std::make_unique<server::PolicySource>(
        server::PolicySource::Options{
            .bundles_source = dir_.File("source"),
            .bundles_dir = dir_.File("kept"),
            .activated = [this](const auto& robot) { return activations_->For(robot); },
            .needed = [this] { return activations_->now().bundles(); }},
        [this](const std::string& dir, const std::string& name) { return Load(dir, name); });
    fleet_ = std::make_unique<server::Fleet>(
        server::FleetOptions{.inventory = dir_.File("robots.yaml"), .leaving = absl::Seconds(10)},
        &store_, pipeline_.get(), alerts_.get(), policies_.get(),
        pipeline::Ports{.recorder = recorder_.get(), .audience = rates_.get(), .new_id = NewId});
    ASSERT_THAT(fleet_->Start(), IsOk());
    pipeline_->Start();
    for (const std::string& robot : pipeline_->robots()) sensors_[robot].link = nullptr;
    Beat();
    library_ = std::make_unique<BundleLibrary>(
        dir_.File("kept"),
        [this](const std::string& dir) -> absl::StatusOr<LoadedBundle> {
          if (on_push_) on_push_();
          RIPS_ASSIGN_OR_RETURN(const LoadedBundle loaded, LoadForTest(dir));
          RIPS_RETURN_IF_ERROR(SignedBy(dir, loaded.id).status());
          return loaded;
        },
        [this](const std::string& dir, const std::string& id) { return SignedBy(dir, id); });
    shadows_ = std::make_unique<shadow::Shadows>();
    control_ = std::make_unique<BundleControl>(BundleControl::Parts{
        .fleet = fleet_.get(),
        .activations = activations_.get(),
        .library = library_.get(),
        .rates = rates_.get(),
        .policies = policies_.get(),
        .shadows = shadows_.get(),
        .load_shadow = [this](const KeptBundle& kept) { return LoadShadow(kept); },
        .pipeline = pipeline_.get(),
        .alerts = alerts_.get(),
        .clock = &clock_,
        .new_id = NewId});
  }
  void Stop() {
    control_.reset();
    if (shadows_ != nullptr) shadows_->Stop();
    if (pipeline_ != nullptr) pipeline_->Stop();
    if (committer_ != nullptr) committer_->Stop();
    fleet_.reset();
    pipeline_.reset();
    shadows_.reset();
  }
  absl::StatusOr<shadow::ShadowPolicy> LoadShadow(const KeptBundle& kept) {
    const auto loaded = bundle::LoadBundle(dir_.File("kept/") + kept.id.substr(7), &real_clock_);
    if (!loaded.ok()) return loaded.status();
    return shadow::PolicyOf(*loaded);
  }
  // The sensors of all robots are connected, and heard now.
  void Beat() {
    pipeline_->ForEach([this, now = clock_.Now()](pipeline::Robot& robot) {
      Sensor& sensor = sensors_.at(robot.id());
      if (sensor.off) return;
      if (sensor.link == nullptr) {
        sensor.link = std::make_shared<pipeline::FakeSensor>();
        robot.OnSensorHello("base", sensor.link,
                            {.incarnation = std::string(16, 'i'), .clock = now});
      }
      robot.OnSensorHeartbeat("base", sensor.link.get(),
                              {.clock = now, .echo_boottime_ns = now.boottime_ns});
      robot.OnInterestAnswer("base", sensor.link.get(),
                             {.id = sensor.link->interest_id(), .problem = ""});
    });
  }
  void Restart() {
    Stop();
    Start();
  }
  absl::StatusOr<pipeline::Policy> Load(const std::string& dir, const std::string& name) {
    ++loads_;
    absl::StatusOr<bundle::Bundle> loaded = bundle::LoadBundle(dir, &real_clock_);
    if (!loaded.ok()) return loaded.status();
    if (!name.empty() && loaded->manifest.name != name) {
      return absl::InvalidArgumentError("another name");
    }
    return pipeline::Policy{.program = loaded->program, .bundle_id = loaded->id};
  }
  // As of a server that trusts the keys of `signers_`; without any, alice signed all.
  absl::StatusOr<std::string> SignedBy(const std::string& dir, const std::string& id) const {
    if (signers_.empty()) return std::string("alice");
    RIPS_ASSIGN_OR_RETURN(const std::string signature, bundle::ReadSignature(dir));
    return signers_.Verify(id, signature);
  }

  // Of the thread of its robot.
  struct Sensor {
    std::shared_ptr<pipeline::FakeSensor> link;
    // It says nothing.
    bool off = false;
  };

  store::TempDir dir_;
  FakeClock clock_;
  RealClock real_clock_;
  store::FakeStore store_;
  pipeline::SilentObserver quiet_;
  bundle::SignerKeys signers_;
  int loads_ = 0;
  // Before a pushed bundle is checked; on the thread that checks it.
  std::function<void()> on_push_;
  absl::btree_map<std::string, Sensor> sensors_;
  std::unique_ptr<store::Committer> committer_;
  std::unique_ptr<pipeline::StoreRecorder> recorder_;
  std::unique_ptr<pipeline::ServerAlerts> alerts_;
  std::unique_ptr<AlertRates> rates_;
  std::unique_ptr<Activations> activations_;
  std::unique_ptr<shadow::Shadows> shadows_;
  std::unique_ptr<pipeline::Pipeline> pipeline_;
  std::unique_ptr<server::PolicySource> policies_;
  std::unique_ptr<server::Fleet> fleet_;
  std::unique_ptr<BundleLibrary> library_;
  std::unique_ptr<BundleControl> control_;
};

}  // namespace rips::rollout

#endif  // RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_CONTROL_FIXTURE_H_

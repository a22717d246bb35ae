// Uplink: what the server's store holds is said in the next hello, also of the next process.
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "grpcpp/security/credentials.h"
#include "gtest/gtest.h"
#include "sensor_agent/uplink/fake_policy_server.h"
#include "sensor_agent/uplink/store_file.h"
#include "sensor_agent/uplink/uplink.h"
#include "services/base/ids.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips::sensor {
namespace {

using ::testing::IsEmpty;

class UplinkStoreTest : public testing::Test {
 protected:
  UplinkStoreTest()
      : dir_(std::filesystem::temp_directory_path() / absl::StrCat("rips-uplink-", NewId())) {
    std::filesystem::create_directories(dir_);
    server_.Start();
  }
  ~UplinkStoreTest() override {
    Stop();
    server_.Stop();
    EXPECT_THAT(server_.violations, IsEmpty());
    std::filesystem::remove_all(dir_);
  }

  void Start() {
    uplink_ = std::make_unique<Uplink>(
        UplinkOptions{
            .servers = {server_.address()},
            .credentials = grpc::InsecureChannelCredentials(),
            .host = "base",
            .store_file = path(),
            .core = {.heartbeat = absl::Milliseconds(20)},
            .backoff = {.initial = absl::Milliseconds(20), .max = absl::Milliseconds(50)}},
        Uplink::Hooks{.on_own_participants = [](std::vector<ros2::Guid>) {},
                      .on_snapshot_wanted = [this] { uplink_->ReplaceGraph({Snapshot()}); },
                      .on_interest = [](std::shared_ptr<const Interest>) {}},
        &clock_, &metrics_);
    uplink_->Append({.graph = {Snapshot()}, .settled = true});
    uplink_->Start();
  }
  void Stop() {
    if (uplink_ != nullptr) uplink_->Stop();
    uplink_.reset();
  }
  GraphChange Snapshot() { return {.from_version = 0, .to_version = ++version_, .settled = true}; }
  std::string path() const { return StoreFile(dir_.string()); }
  static std::string Id(char letter) { return std::string(kGenerationBytes, letter); }
  // What the server tells from now on.
  void ServerHolds(const std::string& generation, uint64_t commit) {
    server_.Set([&](FakePolicyServer::Behaviour& b) {
      b.generation = generation;
      b.commit = commit;
    });
  }
  bool WaitForHellos(size_t count) {
    return server_.WaitUntil([&](const FakePolicyServer& s) { return s.hellos.size() >= count; });
  }
  // Until the file says so.
  bool WaitForFile(const std::string& generation, uint64_t commit) {
    return server_.WaitUntil([&](const FakePolicyServer&) {
      const auto kept = LoadStorePoint(path());
      return kept.ok() && kept->generation() == generation && kept->commit() == commit;
    });
  }
  // Until the uplink has one for something that is sent now.
  bool GetAcknowledgement() {
    uplink_->Append(
        {.ids_alerts = {{.boottime_ns = clock_.Now().boottime_ns, .what = IdsAlert{.sid = 1}}}});
    return server_.WaitUntil(
        [&](const FakePolicyServer&) { return uplink_->acknowledged_ids_alerts() == 1; });
  }
  void ExpectHello(size_t index, const std::string& generation, uint64_t commit) {
    ASSERT_LT(index, server_.hellos.size());
    const rips::v1::SensorHello& hello = server_.hellos[index];
    EXPECT_EQ(hello.has_store(), !generation.empty());
    EXPECT_EQ(hello.store().generation(), generation);
    EXPECT_EQ(hello.store().commit(), commit);
  }

  const RealClock clock_;
  Metrics metrics_;
  const std::filesystem::path dir_;
  std::atomic<uint64_t> version_ = 0;
  FakePolicyServer server_;
  std::unique_ptr<Uplink> uplink_;
};

TEST_F(UplinkStoreTest, TheNextProcessNamesWhatThisOneWasToldLast) {
  ServerHolds(Id('a'), 17);
  Start();
  ASSERT_TRUE(WaitForFile(Id('a'), 17));
  // Acknowledgements go on; the file need not.
  ServerHolds(Id('a'), 390);
  ASSERT_TRUE(GetAcknowledgement());
  Stop();
  Start();
  ASSERT_TRUE(WaitForHellos(2));
  Stop();
  ExpectHello(0, "", 0);
  ExpectHello(1, Id('a'), 390);
}

TEST_F(UplinkStoreTest, WhatAServerHeldIsKeptWhenItGoes) {
  ServerHolds(Id('a'), 17);
  Start();
  ASSERT_TRUE(WaitForFile(Id('a'), 17));
  ServerHolds(Id('a'), 390);
  ASSERT_TRUE(GetAcknowledgement());
  server_.Stop();
  EXPECT_TRUE(WaitForFile(Id('a'), 390)) << "this process may be killed before it comes back";

  // With another store, that has made fewer commits.
  ServerHolds(Id('b'), 5);
  server_.Start();
  ASSERT_TRUE(WaitForFile(Id('b'), 5));
  Stop();
  ExpectHello(1, Id('a'), 390);
}

TEST_F(UplinkStoreTest, AFileThatIsNoneIsNotKnown) {
  std::ofstream(path()) << "rips-store 1 nonsense\n";
  ServerHolds("", 0);
  Start();
  ASSERT_TRUE(WaitForHellos(1));
  Stop();
  ExpectHello(0, "", 0);
  EXPECT_FALSE(LoadStorePoint(path()).ok()) << "nothing was told that could replace it";
}

TEST_F(UplinkStoreTest, AGenerationThatIsNoneIsNotTaken) {
  ServerHolds("short", 5);
  Start();
  ASSERT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) { return s.heartbeats >= 3; }));
  Stop();
  Start();
  ASSERT_TRUE(WaitForHellos(2));
  Stop();
  ExpectHello(1, "", 0);
  EXPECT_THAT(LoadStorePoint(path()), StatusIs(absl::StatusCode::kNotFound));
}

}  // namespace
}  // namespace rips::sensor

// Uplink: what is set aside, and what a former process left.
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "grpcpp/security/credentials.h"
#include "gtest/gtest.h"
#include "sensor_agent/uplink/fake_policy_server.h"
#include "sensor_agent/uplink/uplink.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips::sensor {
namespace {

using rips::v1::CONTROL;
using rips::v1::MESSAGES;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

namespace fs = std::filesystem;

class UplinkBacklogTest : public testing::Test {
 protected:
  UplinkBacklogTest() {
    std::string name =
        absl::StrCat(access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp", "/rips-uplink-XXXXXX");
    dir_ = mkdtemp(name.data());
    options_.host = "base";
    options_.credentials = grpc::InsecureChannelCredentials();
    options_.core.outbox = {.message_bytes = 8 << 20, .control_bytes = 64 * 1024};
    options_.core.backlog.memory_bytes = 64 * 1024;
    options_.spool = {.dir = dir_ + "/spool",
                      .disk_bytes = 8 << 20,
                      .segment_bytes = 64 * 1024,
                      .boot_id = BootId(),
                      .now = clock_.Now()};
    options_.core.backlog.retry = absl::Milliseconds(20);
    options_.core.backlog_bytes_per_second = 64 << 20;
    options_.core.live = absl::Milliseconds(100);
    options_.backoff = {.initial = absl::Milliseconds(20), .max = absl::Milliseconds(50)};
    options_.core.heartbeat = absl::Milliseconds(20);
    server_.Start();
    options_.servers = {server_.address()};
  }
  ~UplinkBacklogTest() override {
    if (uplink_ != nullptr) uplink_->Stop();
    server_.Stop();
    EXPECT_THAT(server_.violations, IsEmpty());
    std::error_code error;
    fs::remove_all(dir_, error);
  }

  // As a new process would.
  void Start() {
    uplink_.reset();
    metrics_ = std::make_unique<Metrics>();
    uplink_ = std::make_unique<Uplink>(
        options_,
        Uplink::Hooks{.on_own_participants = [](std::vector<ros2::Guid>) {},
                      .on_snapshot_wanted = [this] { uplink_->ReplaceGraph({Snapshot()}); },
                      .on_interest = [](std::shared_ptr<const Interest>) {}},
        &clock_, metrics_.get());
    ASSERT_THAT(uplink_->Open(), IsOk());
    version_ = 0;
    uplink_->Append({.graph = {Snapshot()}, .settled = true});
    uplink_->Start();
  }
  GraphChange Snapshot() { return {.from_version = 0, .to_version = ++version_, .settled = true}; }
  // Messages told apart by their size.
  void Append(uint32_t first, uint32_t last) {
    for (uint32_t i = first; i <= last; ++i) {
      uplink_->Append(
          {.messages = {
               {.boottime_ns = clock_.Now().boottime_ns, .source = source_, .size_bytes = i}}});
    }
  }
  bool WaitForMessages(size_t count) {
    return server_.WaitUntil(
        [&](const FakePolicyServer& s) { return s.Distinct(MESSAGES).size() >= count; });
  }
  bool WaitForStreams(size_t count) {
    return server_.WaitUntil([&](const FakePolicyServer& s) { return s.hellos.size() >= count; });
  }
  void StopServer() {
    server_.Stop();
    ASSERT_TRUE(server_.WaitUntil([&](const auto&) { return !uplink_->Ready().ok(); }));
  }
  double Value(const char* name) const {
    const std::string text = metrics_->Text();
    const size_t at = text.find(absl::StrCat("\n", name, " "));
    return at == std::string::npos ? -1 : std::atof(text.c_str() + text.find(' ', at) + 1);
  }
  bool WaitForValue(const char* name, const std::function<bool(double)>& is) {
    return server_.WaitUntil([&](const auto&) { return is(Value(name)); });
  }
  // Every message 1..count came, each under one number only.
  void ExpectMessages(uint32_t count) {
    std::map<std::pair<std::string, uint64_t>, uint32_t> size_of;
    std::map<uint32_t, int> numbers;
    for (const Recorded& each : server_.received) {
      if (each.lane != MESSAGES) continue;
      const uint32_t size = each.what.message().size_bytes();
      const auto [it, is_new] = size_of.emplace(std::pair(each.incarnation, each.sequence), size);
      EXPECT_EQ(it->second, size);
      if (is_new) ++numbers[size];
      EXPECT_EQ(each.topic, "/t");
      EXPECT_EQ(each.writer.node(), "/talker");
    }
    EXPECT_THAT(numbers, SizeIs(count));
    for (const auto& [size, times] : numbers) EXPECT_EQ(times, 1) << "message " << size;
  }

  const std::shared_ptr<const MessageSource> source_ = std::make_shared<const MessageSource>(
      MessageSource{.topic = "/t", .type = "a/msg/A", .writer = {.name = "/t", .node = "/talker"}});
  RealClock clock_;
  std::string dir_;
  uint64_t version_ = 0;
  UplinkOptions options_;
  std::unique_ptr<Metrics> metrics_;
  FakePolicyServer server_;
  std::unique_ptr<Uplink> uplink_;
};

TEST_F(UplinkBacklogTest, WhatAnOutageLeavesCountsForItselfAndAllOfItComes) {
  Start();
  Append(1, 10);
  ASSERT_TRUE(WaitForMessages(10));
  StopServer();
  Append(11, 3'000);
  ASSERT_TRUE(WaitForValue("rips_sensor_backlog_bytes", [](double v) { return v > 0; }));
  Append(3'001, 3'010);

  server_.Start();

  ASSERT_TRUE(WaitForMessages(3'010));
  ExpectMessages(3'010);
  std::map<std::string, int> incarnations;
  for (const Recorded& each : server_.received) ++incarnations[each.incarnation];
  EXPECT_THAT(incarnations, SizeIs(2)) << "what is live, and the backlog";
  EXPECT_TRUE(WaitForValue("rips_sensor_backlog_bytes", [](double v) { return v == 0; }));
  EXPECT_EQ(Value("rips_sensor_shed_total"), 0);
}

TEST_F(UplinkBacklogTest, LiveMessagesDoNotWaitForTheBacklog) {
  options_.core.backlog_bytes_per_second = 4'096;  // would take minutes
  Start();
  ASSERT_TRUE(WaitForStreams(1));
  StopServer();
  Append(1, 5'000);
  ASSERT_TRUE(WaitForValue("rips_sensor_spool_bytes", [](double v) { return v > 0; }));
  server_.Start();
  ASSERT_TRUE(server_.WaitUntil([&](const auto&) { return uplink_->Ready().ok(); }));

  Append(9'001, 9'010);

  size_t distinct = 0;  // by then; the backlog goes on
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    distinct = s.Distinct(MESSAGES).size();
    return std::any_of(s.received.begin(), s.received.end(), [](const Recorded& each) {
      return each.what.message().size_bytes() == 9'010;
    });
  }));
  EXPECT_LT(distinct, 5'000u);
}

TEST_F(UplinkBacklogTest, TheBacklogLeavesHalfOfTheCreditToWhatIsLive) {
  server_.Set([](auto& b) { b.credit = 20'000; });
  Start();
  ASSERT_TRUE(WaitForStreams(1));
  StopServer();
  Append(1, 3'000);
  ASSERT_TRUE(WaitForValue("rips_sensor_backlog_bytes", [](double v) { return v > 30'000; }));
  server_.Start();
  ASSERT_TRUE(server_.WaitUntil([&](const auto&) { return uplink_->Ready().ok(); }));
  // Credit that is never given again: some of it is the backlog's, and the rest stays.
  size_t bytes = 0;
  const auto sent = [&](const FakePolicyServer& s) {
    bytes = 0;
    for (const auto& each : s.batches) {
      if (each.lane() == MESSAGES) bytes += each.ByteSizeLong();
    }
    return bytes;
  };
  ASSERT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) { return sent(s) >= 10'000; }));
  const int heartbeats = server_.heartbeats;
  ASSERT_TRUE(
      server_.WaitUntil([&](const FakePolicyServer& s) { return s.heartbeats > heartbeats + 5; }));
  EXPECT_LT(bytes, 10'000u + 5'000u) << "half, and the batch that passed it";
}

TEST_F(UplinkBacklogTest, ASensorThatIsStoppedLeavesEverythingToTheNext) {
  Start();
  Append(1, 10);
  ASSERT_TRUE(WaitForMessages(10));
  server_.Set([](auto& b) { b.acknowledge = false; });
  Append(11, 20);
  ASSERT_TRUE(WaitForMessages(20));
  StopServer();
  Append(21, 2'000);
  uplink_->Append({.losses = {{.cause = LossCause::kDdsGap, .topic = "/t", .count = 7}},
                   .signals = {"SIGUSR1"}});
  const std::string former = uplink_->incarnation();
  uplink_->Stop();
  EXPECT_FALSE(fs::exists(dir_ + "/spool/running"));

  Start();
  server_.Set([](auto& b) { b.acknowledge = true; });
  server_.Start();

  ASSERT_TRUE(WaitForMessages(2'000));
  ExpectMessages(2'000);
  ASSERT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    int found = 0;
    for (const Recorded& each : s.received) {
      if (each.incarnation != former || each.lane != CONTROL) continue;
      if (each.what.has_signal()) ++found;
      if (each.what.has_loss() && each.what.loss().count() == 7 && each.topic == "/t") ++found;
    }
    return found == 2;
  }));
  EXPECT_NE(uplink_->incarnation(), former);
  EXPECT_TRUE(WaitForValue("rips_sensor_spool_bytes", [](double v) { return v == 0; }));
}

TEST_F(UplinkBacklogTest, WhatIsSentLaterBringsTheGraphOfItsTime) {
  Start();
  ASSERT_TRUE(WaitForStreams(1));
  StopServer();
  const auto append = [&](uint64_t version) {
    uplink_->Append({.messages = {{.boottime_ns = clock_.Now().boottime_ns,
                                   .source = source_,
                                   .graph_version = version}}});
  };
  append(version_);
  ASSERT_TRUE(WaitForValue("rips_sensor_backlog_bytes", [](double v) { return v > 0; }));
  const uint64_t then = version_;
  uplink_->Append({.graph = {{.from_version = then, .to_version = ++version_, .settled = true}}});
  append(version_);
  const std::string former = uplink_->incarnation();
  uplink_->Stop();

  Start();
  server_.Start();
  ASSERT_TRUE(WaitForMessages(2));
  const auto brought = [&](const std::string& incarnation) {
    std::vector<std::string> steps;
    for (const auto& batch : server_.batches) {
      if (batch.lane() != MESSAGES || (batch.incarnation() == former) != (incarnation == former)) {
        continue;
      }
      for (const auto& step : batch.graph()) {
        steps.push_back(absl::StrCat(step.snapshot().graph_version(), "/",
                                     step.delta().from_version(), "-", step.delta().to_version()));
      }
    }
    return steps;
  };
  EXPECT_THAT(brought(former), testing::ElementsAre(absl::StrCat(then + 1, "/0-0")))
      << "what was live when it stopped";
  EXPECT_THAT(brought(""), testing::ElementsAre(absl::StrCat(then, "/0-0")))
      << "what it had set aside";
}

TEST_F(UplinkBacklogTest, EachOutageBringsTheGraphAnew) {
  Start();
  ASSERT_TRUE(WaitForStreams(1));
  const auto snapshots = [&] {
    size_t count = 0;
    for (const auto& batch : server_.batches) {
      for (const auto& step : batch.graph()) count += step.has_snapshot() ? 1 : 0;
    }
    return count;
  };
  for (size_t outage = 1; outage <= 2; ++outage) {
    StopServer();
    uplink_->Append({.messages = {{.boottime_ns = clock_.Now().boottime_ns,
                                   .source = source_,
                                   .graph_version = version_}}});
    ASSERT_TRUE(WaitForValue("rips_sensor_backlog_bytes", [](double v) { return v > 0; }));
    server_.Start();
    ASSERT_TRUE(WaitForMessages(outage));
    ASSERT_TRUE(WaitForValue("rips_sensor_backlog_bytes", [](double v) { return v == 0; }));
    EXPECT_EQ(snapshots(), outage) << "the server may have been started anew";
  }
}

TEST_F(UplinkBacklogTest, AnEndThatCannotBeReadIsAnnouncedNoMore) {
  options_.core.backlog.read_ahead_bytes = 1;
  Start();
  Append(1, 10);
  ASSERT_TRUE(WaitForMessages(10));
  StopServer();
  Append(11, 2'000);
  uplink_->Stop();
  Start();
  ASSERT_TRUE(WaitForValue("rips_sensor_spool_bytes", [](double v) { return v > 0; }));
  // Read back by now is only the first of it.
  for (const auto& file : fs::directory_iterator(dir_ + "/spool")) {
    if (file.path().extension() != ".seg") continue;
    std::fstream segment(file.path(), std::ios::in | std::ios::out | std::ios::binary);
    const auto size = static_cast<std::streamoff>(fs::file_size(file.path()));
    segment.seekp(size / 2);
    segment << std::string(static_cast<size_t>(size - size / 2), '!');
  }

  server_.Start();

  const auto last_announced = [&](const rips::v1::SensorHello& hello) {
    uint64_t last = 0;
    for (const rips::v1::SpoolStream& each : hello.spooled()) {
      if (each.incarnation() != uplink_->incarnation() && each.lane() == MESSAGES) {
        last = std::max(last, each.last_sequence());
      }
    }
    return last;
  };
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    return s.hellos.size() >= 3 && last_announced(s.hellos.back()) < last_announced(s.hellos[1]);
  }));
  EXPECT_TRUE(WaitForValue("rips_sensor_spool_bytes", [](double v) { return v == 0; }));
}

TEST_F(UplinkBacklogTest, StateTellsWhatIsOnDisk) {
  options_.core.backlog_bytes_per_second = 4'096;
  Start();
  ASSERT_TRUE(WaitForStreams(1));
  StopServer();
  Append(1, 5'000);
  ASSERT_TRUE(WaitForValue("rips_sensor_spool_bytes", [](double v) { return v > 0; }));
  server_.Start();
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    return std::any_of(s.received.begin(), s.received.end(), [](const Recorded& each) {
      return each.what.has_state() && each.what.state().spool_bytes() > 0 &&
             each.what.state().oldest_unacked_ns() > 0;
    });
  }));
  EXPECT_GT(Value("rips_sensor_oldest_unacked_seconds"), 0);
}

TEST_F(UplinkBacklogTest, FullMemoryAndFullDiskShedWithALossThatIsExact) {
  options_.core.outbox.message_bytes = 64 * 1024;
  options_.spool.disk_bytes = 128 * 1024;
  Start();
  ASSERT_TRUE(WaitForStreams(1));
  StopServer();
  // Little by little, as the observer does, until there is no room anywhere.
  uint32_t last = 0;
  ASSERT_TRUE(server_.WaitUntil([&](const auto&) {
    for (int i = 0; i < 200; ++i, ++last) Append(last + 1, last + 1);
    return last > 60'000 && Value("rips_sensor_spool_refuses") == 1;
  }));

  server_.Start();

  uint64_t lost = 0;
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    lost = 0;
    std::set<std::pair<std::string, uint64_t>> seen;
    for (const Recorded& each : s.received) {
      if (each.what.has_loss() && seen.emplace(each.incarnation, each.sequence).second) {
        EXPECT_EQ(each.what.loss().cause(), rips::v1::Loss::OUTBOX_SHED);
        lost += each.what.loss().count();
      }
    }
    return lost > 0 && s.Distinct(MESSAGES).size() + lost >= last;
  }));
  EXPECT_EQ(server_.Distinct(MESSAGES).size() + lost, last);
}

TEST_F(UplinkBacklogTest, ASecondSensorOnTheDirectoryIsTold) {
  Start();
  Metrics metrics;
  Uplink second(options_, {}, &clock_, &metrics);
  EXPECT_THAT(second.Open(), StatusIs(absl::StatusCode::kFailedPrecondition,
                                      HasSubstr("another process uses the spool")));
}

}  // namespace
}  // namespace rips::sensor

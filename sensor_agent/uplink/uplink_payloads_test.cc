// Uplink: payloads that go in chunks. What the fake server takes for a breach of the protocol fails
// every test.
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <string>

#include "absl/strings/match.h"
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
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr size_t kChunk = kPayloadChunkBytes;
constexpr size_t kMiB = size_t{1} << 20;

// No two places look alike.
std::string Pattern(size_t bytes, uint32_t seed) {
  std::string text(bytes, '\0');
  for (char& c : text) c = static_cast<char>((seed = seed * 1'664'525 + 1'013'904'223) >> 24);
  return text;
}

class UplinkPayloadsTest : public testing::Test {
 protected:
  UplinkPayloadsTest() {
    std::string name = testing::TempDir() + "/rips-payloads-XXXXXX";
    dir_ = mkdtemp(name.data());
    options_.host = "base";
    options_.credentials = grpc::InsecureChannelCredentials();
    // Nothing is too old, unless a test says so.
    options_.core.live = absl::Hours(1);
    options_.backoff = {.initial = absl::Milliseconds(20), .max = absl::Milliseconds(50)};
    options_.core.heartbeat = absl::Milliseconds(20);
    server_.Set([](auto& b) { b.renew_credit = true; });
    server_.Start();
    options_.servers = {server_.address()};
  }
  ~UplinkPayloadsTest() override {
    if (uplink_ != nullptr) uplink_->Stop();
    server_.Stop();
    EXPECT_THAT(server_.violations, IsEmpty());
    std::error_code error;
    std::filesystem::remove_all(dir_, error);
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
  // A message of `size` bytes of which `kept` are sent along; told apart by its size.
  void Append(size_t size, size_t kept) {
    Payload payload;
    if (kept > 0) {
      payload = std::make_shared<const std::string>(Pattern(kept, static_cast<uint32_t>(size)));
    }
    uplink_->Append({.messages = {{.boottime_ns = clock_.Now().boottime_ns,
                                   .source = source_,
                                   .size_bytes = static_cast<uint32_t>(size),
                                   .payload = payload}}});
  }
  void Append(size_t size) { Append(size, size); }
  bool WaitForMessages(size_t count) {
    return server_.WaitUntil(
        [&](const FakePolicyServer& s) { return s.Distinct(MESSAGES).size() >= count; });
  }
  bool WaitForChunks(int count) {
    return server_.WaitUntil([&](const FakePolicyServer& s) { return s.chunks >= count; });
  }
  bool WaitForSignal(const std::string& name) {
    uplink_->Append({.signals = {name}});
    return server_.WaitUntil([&](const FakePolicyServer& s) {
      for (const Recorded& each : s.Distinct(CONTROL)) {
        if (each.what.signal().name() == name) return true;
      }
      return false;
    });
  }
  void StopServer() {
    server_.Stop();
    ASSERT_TRUE(server_.WaitUntil([&](const auto&) { return !uplink_->Ready().ok(); }));
  }
  void Credit(uint64_t message_bytes, uint64_t payload_bytes) {
    rips::v1::SensorReply reply;
    reply.mutable_credit()->set_message_bytes(message_bytes);
    reply.mutable_credit()->set_payload_bytes(payload_bytes);
    server_.Send(reply);
  }
  double Value(const std::string& name) const {
    const std::string text = metrics_->Text();
    const size_t at = text.find(absl::StrCat("\n", name, " "));
    return at == std::string::npos ? -1 : std::atof(text.c_str() + text.find(' ', at) + 1);
  }
  // The message of that size came with its first `kept` bytes, as they were.
  void ExpectMessage(size_t size, size_t kept) {
    int came = 0;
    for (const Recorded& each : server_.Distinct(MESSAGES)) {
      if (each.what.message().size_bytes() != size) continue;
      ++came;
      EXPECT_TRUE(each.what.message().payload() == Pattern(kept, static_cast<uint32_t>(size)))
          << "of a message of " << size << " bytes " << each.what.message().payload().size()
          << " came, not " << kept;
    }
    EXPECT_EQ(came, 1) << size;
  }
  void ExpectMessage(size_t size) { ExpectMessage(size, size); }

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

TEST_F(UplinkPayloadsTest, PayloadsOfEverySizeComeWholeAndInOrder) {
  Start();
  const std::vector<size_t> sizes = {4,    kChunk - 1, kChunk, kChunk + 1,   2 * kChunk, kMiB - 1,
                                     kMiB, kMiB + 1,   7,      4 * kMiB - 1, 4 * kMiB};
  for (const size_t size : sizes) Append(size);
  Append(5 * kMiB, 4 * kMiB);
  Append(900, 0);
  ASSERT_TRUE(WaitForMessages(sizes.size() + 2));
  uplink_->Stop();
  for (const size_t size : sizes) ExpectMessage(size);
  ExpectMessage(5 * kMiB, 4 * kMiB);
  ExpectMessage(900, 0);
  const std::vector<Recorded> distinct = server_.Distinct(MESSAGES);
  for (size_t i = 0; i < sizes.size(); ++i) {
    EXPECT_EQ(distinct[i].what.message().size_bytes(), sizes[i]);
    EXPECT_EQ(distinct[i].sequence, i + 1);
  }
  EXPECT_EQ(Value("rips_sensor_payload_bytes_total"), static_cast<double>(server_.chunk_bytes));
  EXPECT_EQ(Value("rips_sensor_payloads_shed_total"), 0);
}

TEST_F(UplinkPayloadsTest, ControlPassesAPayloadThatWaitsForCredit) {
  server_.Set([](auto& b) {
    b.payload_credit = 3 * kChunk;
    b.renew_credit = false;
  });
  Start();
  Append(1);
  Append(6 * kChunk);
  Append(2);
  ASSERT_TRUE(WaitForChunks(3));
  ASSERT_TRUE(WaitForSignal("SIGUSR1"));
  EXPECT_TRUE(server_.WaitUntil([](const auto& s) { return s.chunks == 3; }));

  Credit(kMiB, 8 * kMiB);
  ASSERT_TRUE(WaitForMessages(3));
  uplink_->Stop();
  ExpectMessage(1);
  ExpectMessage(6 * kChunk);
  ExpectMessage(2);
  EXPECT_TRUE(absl::StrContains(server_.order, "cccl")) << server_.order;
  EXPECT_EQ(server_.chunks, 6) << "no piece was sent twice";
}

TEST_F(UplinkPayloadsTest, AMessageWhosePayloadFindsNoCreditInTimeGoesWithoutIt) {
  options_.core.live = absl::Milliseconds(100);
  server_.Set([](auto& b) {
    b.payload_credit = 3 * kChunk;
    b.renew_credit = false;
  });
  Start();
  Append(6 * kChunk);
  Append(2);
  ASSERT_TRUE(WaitForMessages(2));
  EXPECT_EQ(server_.chunks, 3);
  Append(7 * kChunk);
  ASSERT_TRUE(WaitForMessages(3)) << "not a single chunk of it";
  Credit(kMiB, 8 * kMiB);
  // One of the next comes whole: a busy machine may be too slow for some of them.
  bool whole = false;
  for (size_t i = 0; i < 100 && !whole; ++i) {
    Append(2 * kChunk + i);
    ASSERT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
      for (const Recorded& each : s.received) {
        if (each.what.message().size_bytes() != 2 * kChunk + i) continue;
        whole = !each.what.message().truncated();
        return true;
      }
      return false;
    }));
  }
  uplink_->Stop();
  EXPECT_TRUE(whole);
  ExpectMessage(6 * kChunk, 0);
  ExpectMessage(2);
  ExpectMessage(7 * kChunk, 0);
  for (const Recorded& each : server_.Distinct(CONTROL)) {
    EXPECT_FALSE(each.what.has_loss()) << "the message is there";
  }
}

TEST_F(UplinkPayloadsTest, MetadataGoesOnWhilePayloadsComeAndFindNoCredit) {
  options_.core.live = absl::Milliseconds(100);
  server_.Set([](auto& b) {
    b.payload_credit = 3 * kChunk;
    b.renew_credit = false;
  });
  Start();
  size_t came = 0;
  for (size_t i = 0; i < 2'000 && came < 10; ++i) {
    Append(6 * kChunk + i);
    absl::SleepFor(absl::Milliseconds(5));  // a pace, not a wait for something
    server_.WaitUntil([&](const FakePolicyServer& s) {
      came = s.Distinct(MESSAGES).size();
      return true;
    });
  }
  EXPECT_GE(came, 10u);
}

TEST_F(UplinkPayloadsTest, AMessageIsNotSetAsideWhileItsPayloadIsOnItsWay) {
  options_.core.outbox.message_bytes = 3 * kMiB;
  server_.Set([](auto& b) {
    b.payload_credit = 3 * kChunk;
    b.renew_credit = false;
  });
  Start();
  Append(6 * kChunk);
  ASSERT_TRUE(WaitForChunks(3));
  Append(kMiB);
  Append(kMiB + 1);  // the outbox is more than 3/4 full
  ASSERT_TRUE(WaitForSignal("SIGUSR1"));
  Credit(8 * kMiB, 64 * kMiB);
  ASSERT_TRUE(WaitForMessages(3));
  uplink_->Stop();
  for (const size_t size : {6 * kChunk, kMiB, kMiB + 1}) ExpectMessage(size);
  EXPECT_EQ(server_.chunks, 6 + 16 + 17) << "none went twice";
}

TEST_F(UplinkPayloadsTest, AServerThatGrantsNoPayloadsGetsMetadata) {
  options_.core.live = absl::Milliseconds(50);
  server_.Set([](auto& b) {
    b.payload_credit = 0;
    b.renew_credit = false;
  });
  Start();
  Append(kMiB);
  Append(kMiB + 1);
  ASSERT_TRUE(WaitForMessages(2));
  EXPECT_TRUE(server_.WaitUntil(
      [&](const auto&) { return Value("rips_sensor_payloads_shed_total") == 2; }));
  uplink_->Stop();
  EXPECT_EQ(server_.chunks, 0);
  ExpectMessage(kMiB, 0);
}

TEST_F(UplinkPayloadsTest, AStreamThatEndsAmidChunksCostsNothing) {
  Start();
  ASSERT_TRUE(WaitForSignal("SIGUSR1"));
  server_.Set([](auto& b) { b.chunks_until_close = 3; });
  Append(2 * kMiB);
  Append(kMiB);
  ASSERT_TRUE(WaitForMessages(2));
  uplink_->Stop();
  EXPECT_THAT(server_.hellos, SizeIs(2));
  ExpectMessage(2 * kMiB);
  ExpectMessage(kMiB);
}

TEST_F(UplinkPayloadsTest, WhatWasNotAcknowledgedGoesAgainWithItsPayload) {
  server_.Set([](auto& b) { b.acknowledge = false; });
  Start();
  Append(kMiB);
  Append(kMiB + 1);
  ASSERT_TRUE(WaitForMessages(2));
  StopServer();
  server_.Set([](auto& b) {
    b.acknowledge = true;
    b.forget = true;
  });
  const int before = server_.chunks;
  server_.Start();
  ASSERT_TRUE(WaitForChunks(2 * before));
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) {
    size_t messages = 0;
    for (const Recorded& each : s.received) messages += each.lane == MESSAGES;
    return messages >= 4;
  }));
  uplink_->Stop();
  ExpectMessage(kMiB);
  ExpectMessage(kMiB + 1);
}

TEST_F(UplinkPayloadsTest, AFullOutboxShedsPayloadsAndKeepsMessagesAndControl) {
  options_.core.outbox.message_bytes = 3 * kMiB;
  options_.core.backlog.memory_bytes = 0;  // nothing can be set aside
  server_.Set([](auto& b) {
    b.payload_credit = kChunk;
    b.renew_credit = false;
  });
  Start();
  for (uint32_t i = 1; i <= 20; ++i) Append(kMiB + i);
  ASSERT_TRUE(WaitForSignal("SIGUSR2"));
  Credit(kMiB, std::numeric_limits<uint32_t>::max());
  ASSERT_TRUE(WaitForMessages(20)) << "none is lost";
  uplink_->Stop();
  size_t whole = 0;
  for (const Recorded& each : server_.Distinct(MESSAGES)) {
    const auto& message = each.what.message();
    EXPECT_TRUE(message.payload().empty() || message.payload().size() == message.size_bytes());
    EXPECT_EQ(message.truncated(), message.payload().empty());
    whole += !message.truncated();
  }
  EXPECT_GE(whole, 1u) << "the newest";
  EXPECT_LE(whole, 3u);
  for (const Recorded& each : server_.Distinct(CONTROL)) EXPECT_FALSE(each.what.has_loss());
}

TEST_F(UplinkPayloadsTest, AnOutageSetsPayloadsAsideInMemory) {
  // Half of it is what the chunks of one payload may take.
  options_.core.live = absl::Milliseconds(600);
  options_.core.backlog.memory_bytes = 64 * kMiB;
  options_.core.backlog_bytes_per_second = 1 << 30;
  Start();
  ASSERT_TRUE(WaitForSignal("SIGUSR1"));
  StopServer();
  Append(3);
  Append(kMiB);
  Append(kMiB + 1);
  Append(4);
  ASSERT_TRUE(server_.WaitUntil(
      [&](const auto&) { return Value("rips_sensor_backlog_bytes") > 2 * kMiB; }));
  server_.Start();
  ASSERT_TRUE(WaitForMessages(4));
  uplink_->Stop();
  for (const size_t size : {size_t{3}, kMiB, kMiB + 1, size_t{4}}) ExpectMessage(size);
}

TEST_F(UplinkPayloadsTest, TheNextProcessSendsThePayloadsThatTheLastOneLeft) {
  options_.spool = {
      .dir = dir_ + "/spool", .disk_bytes = 64 << 20, .boot_id = BootId(), .now = clock_.Now()};
  options_.core.backlog_bytes_per_second = 1 << 30;
  server_.Stop();
  Start();
  Append(4 * kMiB);
  Append(5);
  Append(6 * kMiB, kMiB);
  uplink_->Stop();
  server_.Start();
  Start();
  ASSERT_TRUE(WaitForMessages(3));
  uplink_->Stop();
  ExpectMessage(4 * kMiB);
  ExpectMessage(5);
  ExpectMessage(6 * kMiB, kMiB);
}

TEST_F(UplinkPayloadsTest, ABacklogWhosePayloadFindsNoCreditGoesWithoutIt) {
  options_.spool = {
      .dir = dir_ + "/spool", .disk_bytes = 64 << 20, .boot_id = BootId(), .now = clock_.Now()};
  options_.core.backlog_bytes_per_second = 1 << 30;
  server_.Stop();
  Start();
  Append(2 * kMiB);
  Append(5);
  uplink_->Stop();
  options_.core.live = absl::Milliseconds(100);
  server_.Set([](auto& b) {
    b.payload_credit = kChunk;
    b.renew_credit = false;
  });
  server_.Start();
  Start();
  ASSERT_TRUE(WaitForMessages(2));
  uplink_->Stop();
  ExpectMessage(2 * kMiB, 0);
  ExpectMessage(5);
}

}  // namespace
}  // namespace rips::sensor

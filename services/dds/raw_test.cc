#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <fstream>
#include <map>
#include <memory>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/ros2/cdr.h"
#include "services/runtime/mutex.h"
#include "tests/support/ros2/test_world.h"

namespace rips::dds {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr char kTopic[] = "rt/chatter";
constexpr char kType[] = "std_msgs::msg::dds_::String_";

struct Received {
  std::string payload;
  RawSample sample;  // its view is not to be used
};

// What a reader's callback saw.
class Log {
 public:
  RawCallback Callback() {
    return [this](const RawSample& sample) {
      MutexLock lock(&mu_);
      received_.push_back({std::string(sample.payload), sample});
    };
  }
  std::vector<Received> Get() {
    MutexLock lock(&mu_);
    return received_;
  }
  size_t size() { return Get().size(); }

 private:
  Mutex mu_;
  std::vector<Received> received_;
};

std::string Message(absl::string_view text) {
  ros2::CdrWriter writer;
  writer.String(text);
  return std::move(writer).Finish();
}

// Differs at every offset, so that a fragment in the wrong place is seen.
std::string Pattern(size_t size) {
  std::string bytes("\0\1\0\0", 4);
  for (size_t i = 4; i < size; ++i) bytes.push_back(static_cast<char>(i * 2654435761u >> 13));
  return bytes;
}

class RawTest : public TestWorld {
 protected:
  std::unique_ptr<RawWriter> Writer(Participant& in,
                                    ros2::Qos qos = {
                                        .reliable = true, .depth = 10, .partitions = {}}) {
    auto writer = RawWriter::Create(in, {.topic = kTopic, .type = kType, .qos = std::move(qos)});
    EXPECT_THAT(writer, IsOk());
    return *std::move(writer);
  }
  std::unique_ptr<RawReader> Reader(Participant& in, RawCallback callback,
                                    RawReaderOptions options = {}) {
    options.topic = kTopic;
    options.type = kType;
    auto reader = RawReader::Create(in, options, std::move(callback));
    EXPECT_THAT(reader, IsOk());
    return *std::move(reader);
  }
  // Until both know of each other.
  static bool Matched(const RawWriter& writer, const RawReader& reader) {
    return Eventually(
        [&] { return writer.MatchedReaders() > 0 && !reader.MatchedWriters().empty(); });
  }
};

TEST_F(RawTest, ASampleArrivesWithItsOrigin) {
  Log log;
  const auto writer = Writer(near());
  const auto reader = Reader(far(), log.Callback());
  ASSERT_TRUE(Matched(*writer, *reader));
  EXPECT_THAT(reader->MatchedWriters(), ElementsAre(writer->guid()));
  ASSERT_THAT(writer->Write(Message("one"), 1'234'567'891), IsOk());
  ASSERT_THAT(writer->Write(Message("two")), IsOk());
  ASSERT_TRUE(Eventually([&] { return log.size() == 2; }));
  const std::vector<Received> got = log.Get();
  EXPECT_EQ(got[0].payload, Message("one"));
  EXPECT_EQ(got[0].sample.size, Message("one").size());
  EXPECT_EQ(got[0].sample.writer, writer->guid());
  EXPECT_EQ(got[0].sample.writer_sequence, 1u);
  EXPECT_EQ(got[1].sample.writer_sequence, 2u);
  EXPECT_EQ(got[0].sample.publication, got[1].sample.publication);
  // RTPS time has a resolution of 2^-32 s.
  EXPECT_NEAR(static_cast<double>(got[0].sample.source_unix_ns), 1'234'567'891, 2);
  EXPECT_NEAR(static_cast<double>(got[1].sample.source_unix_ns),
              static_cast<double>(got[1].sample.received.unix_ns), 10e9);
  EXPECT_GE(got[1].sample.received.boottime_ns, got[0].sample.received.boottime_ns);
}

TEST_F(RawTest, FragmentsAreJoined) {
  Log log;
  const auto writer = Writer(near());
  const auto reader = Reader(far(), log.Callback(), {.reliable = true});
  ASSERT_TRUE(Matched(*writer, *reader));
  const std::string payload = Pattern(400'000);
  for (int i = 0; i < 5; ++i) ASSERT_THAT(writer->Write(payload), IsOk());
  ASSERT_TRUE(Eventually([&] { return log.size() == 5; }));
  for (const Received& got : log.Get()) {
    EXPECT_EQ(got.sample.size, payload.size());
    EXPECT_TRUE(got.payload == payload);
  }
}

TEST_F(RawTest, LongPayloadsAreCutWhereAsked) {
  Log cut;
  Log whole;
  const auto writer = Writer(near());
  // Two types of one name on one topic of one participant.
  const auto cutting =
      Reader(far(), cut.Callback(), {.reliable = true, .payload_bytes_max = 2'001});
  const auto keeping = Reader(far(), whole.Callback(), {.reliable = true});
  ASSERT_TRUE(Matched(*writer, *cutting) && Matched(*writer, *keeping));
  ASSERT_TRUE(Eventually([&] { return writer->MatchedReaders() == 2; }));
  const std::string payload = Pattern(100'000);
  ASSERT_THAT(writer->Write(payload), IsOk());
  ASSERT_THAT(writer->Write(Message("short")), IsOk());
  ASSERT_TRUE(Eventually([&] { return cut.size() == 2 && whole.size() == 2; }));
  EXPECT_TRUE(cut.Get()[0].payload == payload.substr(0, 2'001));
  EXPECT_EQ(cut.Get()[0].sample.size, payload.size());
  EXPECT_EQ(cut.Get()[1].payload, Message("short"));
  EXPECT_TRUE(whole.Get()[0].payload == payload);
}

TEST_F(RawTest, TheLimitMayChangeWhileReading) {
  Log adjusted;
  Log fixed;
  const auto limit = std::make_shared<PayloadLimit>(0);
  const auto writer = Writer(near());
  // Of the same type and name: what is kept for one is not what is kept for the other.
  const auto reader =
      Reader(far(), adjusted.Callback(), {.reliable = true, .payload_limit = limit});
  const auto other = Reader(far(), fixed.Callback(), {.reliable = true, .payload_bytes_max = 7});
  ASSERT_TRUE(Matched(*writer, *reader) && Matched(*writer, *other));
  ASSERT_TRUE(Eventually([&] { return writer->MatchedReaders() == 2; }));
  const std::string payload = Pattern(100'000);
  size_t count = 0;
  for (const uint32_t bytes : {0u, 65'536u, 10u, kWholePayload}) {
    *limit = bytes;
    ASSERT_THAT(writer->Write(payload), IsOk());
    ++count;
    ASSERT_TRUE(Eventually([&] { return adjusted.size() == count && fixed.size() == count; }));
    EXPECT_EQ(adjusted.Get().back().sample.size, payload.size());
    EXPECT_TRUE(adjusted.Get().back().payload == payload.substr(0, std::max(bytes, 4u))) << bytes;
    EXPECT_TRUE(fixed.Get().back().payload == payload.substr(0, 7));
  }
}

// Of this process, bytes.
size_t ResidentBytes() {
  std::ifstream file("/proc/self/statm");
  size_t pages = 0;
  file >> pages >> pages;
  return pages * static_cast<size_t>(sysconf(_SC_PAGESIZE));
}

// While it lives, a process that wants gigabytes ends instead of taking the machine's. Address
// sanitizers need the room for themselves.
class MemoryLimit {
 public:
  explicit MemoryLimit(size_t more_bytes) {
    std::ifstream file("/proc/self/statm");
    size_t pages = 0;
    file >> pages;
    getrlimit(RLIMIT_AS, &before_);
    rlimit limit = before_;
    limit.rlim_cur = pages * static_cast<size_t>(sysconf(_SC_PAGESIZE)) + more_bytes;
#ifndef RIPS_SANITIZED
    setrlimit(RLIMIT_AS, &limit);
#endif
  }
  ~MemoryLimit() { setrlimit(RLIMIT_AS, &before_); }

 private:
  rlimit before_ = {};
};

// As where a rule asks for every topic, and hundreds carry std_msgs/String.
TEST_F(RawTest, ManyTopicsOfOneTypeTakeLittleMemory) {
  const size_t before = ResidentBytes();
  const MemoryLimit limit(size_t{512} << 20);
  std::vector<RawTopic> topics;
  for (int i = 0; i < 500; ++i) {
    auto topic = CreateRawTopic(near().entity(), absl::StrCat("rt/many_", i), kType, kWholePayload,
                                std::make_shared<const PayloadLimit>(100));
    ASSERT_THAT(topic, IsOk());
    topics.push_back(*std::move(topic));
    ASSERT_LT(ResidentBytes() - before, size_t{64} << 20) << "after " << i << " topics";
  }
}

TEST_F(RawTest, ALatchedSampleReachesALateReader) {
  Log latched;
  Log plain;
  const auto writer =
      Writer(near(), {.reliable = true, .transient_local = true, .depth = 1, .partitions = {}});
  ASSERT_THAT(writer->Write(Message("before")), IsOk());
  ASSERT_THAT(writer->Write(Message("latest")), IsOk());
  const auto late = Reader(far(), latched.Callback(), {.reliable_transient_local = true});
  ASSERT_TRUE(Eventually([&] { return latched.size() == 1; }));
  const auto now = Reader(far(), plain.Callback());
  EXPECT_EQ(latched.Get()[0].payload, Message("latest"));
  ASSERT_TRUE(Matched(*writer, *now));
  ASSERT_TRUE(Eventually([&] { return writer->MatchedReaders() == 2; }));
  ASSERT_THAT(writer->Write(Message("next")), IsOk());
  ASSERT_TRUE(Eventually([&] { return plain.size() == 1 && latched.size() == 2; }));
  EXPECT_EQ(plain.Get()[0].payload, Message("next"));
}

TEST_F(RawTest, AReaderThatAsksForMoreThanIsOfferedDoesNotMatch) {
  Log strict_log;
  Log weak_log;
  const auto writer = Writer(near(), {.reliable = false, .depth = 5, .partitions = {}});
  const auto strict = Reader(far(), strict_log.Callback(), {.reliable_transient_local = true});
  const auto weak = Reader(far(), weak_log.Callback());
  ASSERT_TRUE(Matched(*writer, *weak));
  EXPECT_TRUE(strict->MatchedWriters().empty());
}

TEST_F(RawTest, NoPartitionHidesAWriter) {
  Log every;
  Log own;
  const auto evil = Writer(near(), {.reliable = true, .depth = 10, .partitions = {"evil"}});
  const auto reader = Reader(far(), every.Callback());
  const auto blind = Reader(far(), own.Callback(), {.every_partition = false});
  ASSERT_TRUE(Matched(*evil, *reader));
  ASSERT_THAT(evil->Write(Message("psst")), IsOk());
  ASSERT_TRUE(Eventually([&] { return every.size() == 1; }));
  EXPECT_TRUE(blind->MatchedWriters().empty());
  EXPECT_EQ(own.size(), 0u);
}

// A callback that does not return until it is let go.
class Gate {
 public:
  RawCallback Callback() {
    return [this](const RawSample&) {
      entered_ = true;
      MutexLock lock(&mu_);
      while (!open_) changed_.Wait(lock);
    };
  }
  bool entered() const { return entered_; }
  void Open() {
    MutexLock lock(&mu_);
    open_ = true;
    changed_.NotifyAll();
  }

 private:
  std::atomic<bool> entered_ = false;
  Mutex mu_;
  CondVar changed_;
  bool open_ = false;
};

// Of `count` reliable writes of 1 kB under keep-all, how many were accepted in time while the
// reader hangs.
int AcceptedWrites(RawWriter& writer, Gate& gate, int count) {
  EXPECT_THAT(writer.Write(Pattern(1'000)), IsOk());
  EXPECT_TRUE(Eventually([&] { return gate.entered(); }));
  int accepted = 0;
  for (int i = 0; i < count; ++i) {
    if (!writer.Write(Pattern(1'000)).ok()) break;
    ++accepted;
  }
  gate.Open();
  return accepted;
}

constexpr int kHangingWrites = 3'000;

TEST_F(RawTest, AHangingBestEffortReaderDoesNotHoldAWriterUp) {
  Gate gate;
  const auto writer = Writer(near(), {.reliable = true, .keep_all = true, .partitions = {}});
  const auto reader = Reader(far(), gate.Callback());
  ASSERT_TRUE(Matched(*writer, *reader));
  EXPECT_EQ(AcceptedWrites(*writer, gate, kHangingWrites), kHangingWrites);
}

// Why best effort is the default.
TEST_F(RawTest, AHangingReliableReaderDoesHoldAWriterUp) {
  Gate gate;
  const auto writer = Writer(near(), {.reliable = true, .keep_all = true, .partitions = {}});
  const auto reader = Reader(far(), gate.Callback(), {.reliable = true});
  ASSERT_TRUE(Matched(*writer, *reader));
  EXPECT_LT(AcceptedWrites(*writer, gate, kHangingWrites), kHangingWrites);
}

TEST_F(RawTest, WhatIsNoCdrIsDeliveredAsItIs) {
  Log log;
  const auto writer = Writer(near());
  const auto reader = Reader(far(), log.Callback());
  ASSERT_TRUE(Matched(*writer, *reader));
  // Cyclone itself drops a sample whose encapsulation it does not know; behind that anything goes.
  std::vector<std::string> payloads = {std::string(4, '\0'),
                                       std::string("\0\1\0\0\xff\xff\xff\xff", 8),
                                       std::string("\0\3\xff\xff\xff\xff\xff\xff", 8)};
  // Lengths that are no multiple of 4 are padded on the wire.
  for (size_t size = 5; size < 12; ++size) payloads.push_back(Pattern(size));
  const uint64_t refused = RefusedSamples();
  for (size_t i = 0; i < payloads.size(); ++i) {
    ASSERT_THAT(writer->Write(payloads[i]), IsOk());
    ASSERT_TRUE(Eventually([&] { return log.size() == i + 1; })) << i;
    const std::string got = log.Get()[i].payload;
    EXPECT_THAT(got, StartsWith(payloads[i]));
    EXPECT_LE(got.size(), payloads[i].size() + 3);
  }
  EXPECT_EQ(RefusedSamples(), refused);
  for (size_t size = 0; size < 4; ++size) {
    EXPECT_THAT(writer->Write(std::string(size, 'x')),
                StatusIs(absl::StatusCode::kInvalidArgument));
  }
}

TEST_F(RawTest, WithinOneParticipant) {
  Log ignoring;
  Log cut;
  const auto writer = Writer(near());
  const auto without = Reader(near(), ignoring.Callback());
  const auto with = Reader(near(), cut.Callback(), {.payload_bytes_max = 16, .ignore_own = false});
  ASSERT_TRUE(Matched(*writer, *with));
  const std::string payload = Pattern(1'000);
  ASSERT_THAT(writer->Write(payload), IsOk());
  ASSERT_TRUE(Eventually([&] { return cut.size() == 1; }));
  const Received got = cut.Get()[0];
  EXPECT_EQ(got.payload, payload.substr(0, 16));
  EXPECT_EQ(got.sample.size, payload.size());
  EXPECT_EQ(got.sample.writer_sequence, 0u);
  EXPECT_EQ(got.sample.writer, writer->guid());
  EXPECT_EQ(ignoring.size(), 0u);
}

TEST_F(RawTest, AWriterThatGoesIsNoSample) {
  Log log;
  auto writer = Writer(near());
  const ros2::Guid guid = writer->guid();
  const auto reader = Reader(far(), log.Callback());
  ASSERT_TRUE(Matched(*writer, *reader));
  ASSERT_THAT(writer->Write(Message("last words")), IsOk());
  ASSERT_TRUE(Eventually([&] { return log.size() == 1; }));
  writer.reset();
  ASSERT_TRUE(Eventually([&] { return reader->MatchedWriters().empty(); }));
  EXPECT_EQ(log.size(), 1u);
  EXPECT_EQ(log.Get()[0].sample.writer, guid);
}

TEST_F(RawTest, ManyWritersKeepTheirSequences) {
  Log log;
  std::vector<std::unique_ptr<RawWriter>> writers;
  const ros2::Qos keep_all = {.reliable = true, .keep_all = true, .partitions = {}};
  for (int i = 0; i < 4; ++i) writers.push_back(Writer(near(), keep_all));
  const auto reader = Reader(far(), log.Callback(), {.reliable = true});
  ASSERT_TRUE(Eventually([&] { return reader->MatchedWriters().size() == writers.size(); }));
  for (const auto& writer : writers) {
    ASSERT_TRUE(Eventually([&] { return writer->MatchedReaders() == 1; }));
  }
  constexpr uint64_t kEach = 50;
  for (uint64_t i = 1; i <= kEach; ++i) {
    for (const auto& writer : writers) {
      ASSERT_THAT(writer->Write(Message(absl::StrCat(ToString(writer->guid()), " ", i))), IsOk());
    }
  }
  ASSERT_TRUE(Eventually([&] { return log.size() == kEach * writers.size(); }));
  std::map<ros2::Guid, uint64_t> last;
  for (const Received& got : log.Get()) {
    EXPECT_EQ(got.sample.writer_sequence, ++last[got.sample.writer]);
    EXPECT_EQ(got.payload,
              Message(absl::StrCat(ToString(got.sample.writer), " ", got.sample.writer_sequence)));
  }
}

TEST_F(RawTest, BadOptions) {
  const RawCallback ignore = [](const RawSample&) {};
  EXPECT_FALSE(RawReader::Create(near(), {.topic = "", .type = kType}, ignore).ok());
  EXPECT_THAT(
      RawReader::Create(near(), {.topic = kTopic, .type = kType, .payload_bytes_max = 3}, ignore),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("`payload_bytes_max` of 3")));
  EXPECT_FALSE(RawWriter::Create(near(), {.topic = "rt/a b*", .type = kType}).ok());
}

}  // namespace
}  // namespace rips::dds

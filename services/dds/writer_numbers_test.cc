// What one forged datagram does to a reader, and how it is undone.
#include <memory>
#include <set>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/dds/discovery.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/ros2/cdr.h"
#include "services/runtime/mutex.h"
#include "tests/support/ros2/forged_rtps.h"

namespace rips::dds {
namespace {

using ::testing::ElementsAre;

constexpr char kTopic[] = "rt/chatter";
constexpr char kType[] = "std_msgs::msg::dds_::String_";
constexpr uint64_t kForged = uint64_t{1} << 40;

std::string Message() {
  ros2::CdrWriter writer;
  writer.String("abc");
  return std::move(writer).Finish();
}

class WriterNumbersTest : public TestWorld {
 protected:
  void Join(const RawWriterOptions& writer, bool latched) {
    auto reader = RawReader::Create(
        near(), {.topic = kTopic, .type = kType, .reliable_transient_local = latched},
        [this](const RawSample& sample) {
          MutexLock lock(&mu_);
          numbers_.push_back(sample.writer_sequence);
        });
    ASSERT_THAT(reader, IsOk());
    reader_ = *std::move(reader);
    auto made = RawWriter::Create(far(), writer);
    ASSERT_THAT(made, IsOk());
    writer_ = *std::move(made);
    ASSERT_TRUE(Eventually(
        [&] { return writer_->MatchedReaders() > 0 && !reader_->MatchedWriters().empty(); }));
  }
  void Part() {
    reader_.reset();
    writer_.reset();
    MutexLock lock(&mu_);
    numbers_.clear();
  }
  void Write(int count = 1) {
    for (int i = 0; i < count; ++i) ASSERT_THAT(writer_->Write(Message()), IsOk());
  }
  std::vector<uint64_t> Numbers() {
    MutexLock lock(&mu_);
    return numbers_;
  }
  bool Heard(uint64_t number) {
    return Eventually([&] { return !Numbers().empty() && Numbers().back() == number; });
  }
  WriterNumbers Of(const ros2::Guid& writer) {
    return reader_->NumbersOf(writer).value_or(WriterNumbers{});
  }
  // Until the datagram has been taken.
  bool Jump(const ros2::Guid& writer, const std::string& datagram, bool discovery = false) {
    SendForged(datagram, discovery);
    return Eventually([&] { return Of(writer).next > kForged; });
  }

  Mutex mu_;
  std::vector<uint64_t> numbers_ ABSL_GUARDED_BY(mu_);
  std::unique_ptr<RawReader> reader_;
  std::unique_ptr<RawWriter> writer_;
};

TEST_F(WriterNumbersTest, BestEffortReaderHearsLowerNumbersOnceTheyAreForgotten) {
  for (const bool reliable : {false, true}) {
    Join({.topic = kTopic, .type = kType, .qos = {.reliable = reliable, .depth = 5}}, false);
    Write(2);
    ASSERT_TRUE(Heard(2));
    const ros2::Guid guid = writer_->guid();
    EXPECT_EQ(Of(guid).next, 3u);
    ASSERT_TRUE(Jump(guid, ForgedData(guid, kForged, Message())));
    // With a reliable writer the first only makes the readers go by themselves.
    ASSERT_TRUE(Jump(guid, ForgedData(guid, kForged, Message())));
    ASSERT_TRUE(Heard(kForged));
    const uint64_t discarded = Of(guid).discarded;

    Write(3);
    EXPECT_TRUE(Eventually([&] { return Of(guid).discarded > discarded; })) << "3 to 5 are old";
    EXPECT_EQ(Numbers().back(), kForged);
    EXPECT_TRUE(reader_->ForgetNumbersOf(guid));
    EXPECT_LE(Of(guid).next, 6u);
    Write();
    EXPECT_TRUE(Heard(6));
    Write();
    EXPECT_TRUE(Heard(7));
    EXPECT_EQ(Of(guid).next, 8u);
    Part();
  }
}

TEST_F(WriterNumbersTest, LatchedReaderIsSentAgainWhatItPassedOver) {
  for (const bool by_gap : {false, true}) {
    Join({.topic = kTopic,
          .type = kType,
          .qos = {.reliable = true, .transient_local = true, .depth = 3}},
         true);
    Write(4);
    ASSERT_TRUE(Heard(4));
    const ros2::Guid guid = writer_->guid();
    ASSERT_TRUE(Jump(guid, by_gap ? ForgedGap(guid, reader_->guid(), 1, kForged + 1)
                                  : ForgedHeartbeat(guid, kForged + 1, kForged + 1)));
    Write();
    const uint64_t last = Numbers().back();
    EXPECT_EQ(last, 4u);
    EXPECT_TRUE(reader_->ForgetNumbersOf(guid));
    EXPECT_TRUE(Heard(5)) << "though nothing more is written";
    const std::vector<uint64_t> all = Numbers();
    EXPECT_THAT(std::vector<uint64_t>(all.end() - 3, all.end()), ElementsAre(3, 4, 5));
    Write();
    EXPECT_TRUE(Heard(6));
    Part();
  }
}

TEST_F(WriterNumbersTest, DiscoveryIsSentAgainWhatItPassedOver) {
  Join({.topic = kTopic, .type = kType}, false);
  std::set<ros2::Guid> seen;
  const auto discovery = Discovery::Create(near(), {.on_endpoint = [&](const EndpointSeen& each) {
                                             MutexLock lock(&mu_);
                                             seen.insert(each.guid);
                                           }});
  ASSERT_THAT(discovery, IsOk());
  ros2::Guid publications = writer_->guid();
  publications.bytes[12] = 0;
  publications.bytes[13] = 0;
  publications.bytes[14] = 0x03;
  publications.bytes[15] = 0xc2;
  ASSERT_GT(Of(publications).next, 1u);
  ASSERT_TRUE(Jump(publications, ForgedHeartbeat(publications, kForged + 1, kForged + 1), true));
  auto hidden = RawWriter::Create(far(), {.topic = "rt/hidden", .type = kType});
  ASSERT_THAT(hidden, IsOk());
  EXPECT_FALSE(Eventually(
      [&] {
        MutexLock lock(&mu_);
        return seen.contains((*hidden)->guid());
      },
      absl::Milliseconds(200)));
  EXPECT_TRUE(reader_->ForgetNumbersOf(publications));
  EXPECT_TRUE(Eventually([&] {
    MutexLock lock(&mu_);
    return seen.contains((*hidden)->guid());
  }));
}

TEST_F(WriterNumbersTest, ThereAreNoneOfAnUnknownWriter) {
  Join({.topic = kTopic, .type = kType}, false);
  ros2::Guid guid = writer_->guid();
  guid.bytes[0] ^= 0xff;
  EXPECT_FALSE(reader_->NumbersOf(guid).has_value());
  EXPECT_FALSE(reader_->ForgetNumbersOf(guid));
}

}  // namespace
}  // namespace rips::dds

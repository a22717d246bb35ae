#include "services/rpc/unread_streams.h"

#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "services/base/fake_clock.h"

namespace rips::rpc {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::SizeIs;

struct Piece {
  size_t bytes = 0;
  size_t ByteSizeLong() const { return bytes; }
};
// A peer that never reads: the first write never ends.
struct DeafReactor {
  void StartWrite(const Piece*) {}
  void Finish(grpc::Status status) { ends.push_back(std::move(status)); }
  std::vector<grpc::Status> ends;
};
using DeafOutbound = StreamOutbound<DeafReactor, Piece>;

constexpr size_t kKiB = 1 << 10;

UnreadLimits Small(StreamKind kind) {
  if (kind == StreamKind::kRecord) return {.stream_bytes = 100 * kKiB, .all_bytes = 200 * kKiB};
  return {.stream_bytes = kKiB, .all_bytes = 4 * kKiB};
}

Peer Operator(const std::string& name) {
  Peer peer;
  peer.identity = {.role = Role::kOperator, .trust_domain = "f", .name = name};
  return peer;
}

class UnreadStreamsTest : public testing::Test {
 protected:
  struct Stream {
    DeafReactor reactor;
    std::shared_ptr<DeafOutbound> outbound = std::make_shared<DeafOutbound>(&reactor);
  };
  std::unique_ptr<Stream> Open(const std::string& name, StreamKind kind = StreamKind::kRecord) {
    auto stream = std::make_unique<Stream>();
    DeafOutbound::Limit(stream->outbound,
                        unread_.LimitsFor(kind, Operator(name), "ipv4:10.0.0.1:5"));
    return stream;
  }
  double Count(const char* kind) {
    return metrics_.AddCounter("rips_streams_unread_total", "", {{"stream", kind}}).Value();
  }

  FakeClock clock_;
  Metrics metrics_;
  std::vector<std::string> alerts_;
  UnreadStreams unread_{&clock_, &metrics_,
                        [this](const std::string& text) { alerts_.push_back(text); }, Small};
};

TEST_F(UnreadStreamsTest, AStreamThatIsNotReadIsEndedAtItsLimitAndTold) {
  const auto stream = Open("ann");
  size_t sent = 0;
  while (stream->outbound->Send({10 * kKiB})) sent += 10 * kKiB;

  EXPECT_EQ(sent, 100 * kKiB);
  ASSERT_THAT(stream->reactor.ends, SizeIs(1));
  EXPECT_EQ(stream->reactor.ends[0].error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(stream->reactor.ends[0].error_message(),
            "the peer does not read what it is sent: more than 100 KiB wait");
  EXPECT_EQ(Count("record"), 1);
  ASSERT_THAT(alerts_, SizeIs(1));
  EXPECT_THAT(alerts_[0], AllOf(HasSubstr("ann"), HasSubstr("ipv4:10.0.0.1:5"),
                                HasSubstr("record stream"), HasSubstr("100 KiB wait")));
}

TEST_F(UnreadStreamsTest, OneIdentityIsToldOnceAMinuteAndAlwaysCounted) {
  for (int i = 0; i < 3; ++i) {
    const auto stream = Open("ann");
    while (stream->outbound->Send({10 * kKiB})) {
    }
    stream->outbound->Detach();
  }
  EXPECT_THAT(alerts_, SizeIs(1));
  EXPECT_EQ(Count("record"), 3);
  clock_.Advance(UnreadStreams::kTellEveryNs);
  const auto later = Open("ann");
  while (later->outbound->Send({10 * kKiB})) {
  }
  EXPECT_THAT(alerts_, SizeIs(2));
}

TEST_F(UnreadStreamsTest, TheIdentityThatHoldsMostPaysForTheCommonLimit) {
  const auto reads = Open("bob");
  EXPECT_TRUE(reads->outbound->Send({30 * kKiB})) << "more than any one stream of mallory's";
  std::vector<std::unique_ptr<Stream>> unread;
  for (int i = 0; i < 50; ++i) {
    unread.push_back(Open("mallory"));
    unread.back()->outbound->Send({20 * kKiB});
  }
  // Mallory's writes never end, whatever is done about them.
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(reads->outbound->Send({20 * kKiB}));

  EXPECT_TRUE(reads->outbound->open());
  EXPECT_TRUE(reads->reactor.ends.empty());
  EXPECT_GE(Count("record"), 1);
  ASSERT_THAT(alerts_, SizeIs(1));
  EXPECT_THAT(alerts_[0], AllOf(HasSubstr("mallory"), HasSubstr("and this peer most of it")));
}

// A write that never ends keeps its message, also after the end of the call.
TEST_F(UnreadStreamsTest, WhatTheLibraryHoldsIsChargedUntilTheCallIsOver) {
  std::vector<std::unique_ptr<Stream>> stuck;
  size_t taken = 0;
  for (int i = 0; i < 50; ++i) {
    stuck.push_back(Open("mallory"));
    taken += stuck.back()->outbound->Send({50 * kKiB}) ? 50 * kKiB : 0;
    stuck.back()->outbound->Close(grpc::Status::OK);
  }
  EXPECT_EQ(taken, 200 * kKiB);

  for (const auto& each : stuck) each->outbound->Detach();
  EXPECT_TRUE(Open("mallory")->outbound->Send({50 * kKiB}));
}

TEST_F(UnreadStreamsTest, ACallWhosePeerDoesNotReadItsEndIsCancelled) {
  const auto stream = Open("ann");
  int cancelled = 0;
  stream->outbound->set_cancel([&] { ++cancelled; });
  constexpr int64_t kPatience = 5 * kNanosPerSecond;
  stream->outbound->Reap(1);
  stream->outbound->Reap(10 * kPatience);
  EXPECT_EQ(cancelled, 0) << "it has not ended";

  stream->outbound->Close(grpc::Status::OK);
  stream->outbound->Reap(20 * kPatience);
  stream->outbound->Reap(21 * kPatience - 1);
  EXPECT_EQ(cancelled, 0);
  stream->outbound->Reap(21 * kPatience);
  stream->outbound->Reap(30 * kPatience);
  EXPECT_EQ(cancelled, 1);
}

TEST_F(UnreadStreamsTest, NothingIsCancelledOnceTheCallIsOver) {
  const auto stream = Open("ann");
  stream->outbound->set_cancel([] { FAIL(); });
  stream->outbound->Close(grpc::Status::OK);
  stream->outbound->Reap(1);
  stream->outbound->Detach();
  stream->outbound->Reap(int64_t{1} << 60);
}

TEST_F(UnreadStreamsTest, KindsHaveLimitsOfTheirOwn) {
  const auto record = Open("ann");
  const auto watch = Open("ann", StreamKind::kWatch);
  EXPECT_TRUE(record->outbound->Send({90 * kKiB}));
  EXPECT_TRUE(watch->outbound->Send({kKiB}));
  EXPECT_FALSE(watch->outbound->Send({1}));
  EXPECT_TRUE(record->outbound->open());
  EXPECT_EQ(Count("watch"), 1);
  EXPECT_EQ(Count("record"), 0);
}

// Takers evict one another from many threads: no lock is held then.
TEST_F(UnreadStreamsTest, ManyThreadsTakeAndEvict) {
  std::vector<std::thread> threads;
  Mutex mu;
  UnreadStreams unread(
      &clock_, &metrics_,
      [&](const std::string&) {
        MutexLock lock(&mu);
        alerts_.emplace_back();
      },
      Small);
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < 200; ++i) {
        Stream stream;
        DeafOutbound::Limit(stream.outbound,
                            unread.LimitsFor(StreamKind::kRecord, Operator(absl::StrCat(t)), "a"));
        for (int k = 0; k < 20 && stream.outbound->Send({8 * kKiB}); ++k) {
        }
        stream.outbound->Detach();
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  const auto last = std::make_unique<Stream>();
  DeafOutbound::Limit(last->outbound, unread.LimitsFor(StreamKind::kRecord, Operator("last"), "a"));
  EXPECT_TRUE(last->outbound->Send({200 * kKiB})) << "everything was given back";
}

}  // namespace
}  // namespace rips::rpc

#include "services/rpc/stream_outbound.h"

#include <memory>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::rpc {
namespace {

using ::testing::ElementsAre;

// Its copies say how many messages are held.
using Token = std::shared_ptr<const int>;

struct FakeReactor {
  void StartWrite(const Token* message) { writing.push_back(**message); }
  void Read() { ++reads; }
  void Finish(grpc::Status status) { ends.push_back(std::move(status)); }
  std::vector<int> writing;
  std::vector<grpc::Status> ends;
  int reads = 0;
};
using FakeOutbound = StreamOutbound<FakeReactor, Token>;

Token MakeToken(int number) { return std::make_shared<const int>(number); }

TEST(StreamOutboundTest, WritesOneAfterTheOtherInOrder) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);

  for (int i = 1; i <= 3; ++i) EXPECT_TRUE(outbound.Send(MakeToken(i)));

  EXPECT_THAT(reactor.writing, ElementsAre(1));
  for (int i = 1; i <= 3; ++i) outbound.OnWritten(true);
  EXPECT_THAT(reactor.writing, ElementsAre(1, 2, 3));
  EXPECT_TRUE(outbound.Send(MakeToken(4)));
  EXPECT_THAT(reactor.writing, ElementsAre(1, 2, 3, 4));
  EXPECT_TRUE(outbound.open());
}

TEST(StreamOutboundTest, ReadsAgainOnlyIfItPausesAndIsOpen) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);
  outbound.Resume();
  EXPECT_EQ(reactor.reads, 0) << "a read is under way";
  outbound.Pause();
  outbound.Resume();
  outbound.Resume();
  EXPECT_EQ(reactor.reads, 1);
  outbound.Pause();
  outbound.Close(grpc::Status::CANCELLED);
  outbound.Resume();
  outbound.Detach();
  outbound.Resume();
  EXPECT_EQ(reactor.reads, 1);
}

TEST(StreamOutboundTest, OneMoreThanTheLimitEndsTheCallAndLetsGoOfWhatWaited) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);
  const Token message = MakeToken(1);
  for (size_t i = 0; i < OutboundLimits().messages; ++i) ASSERT_TRUE(outbound.Send(message)) << i;
  EXPECT_TRUE(outbound.open());
  EXPECT_EQ(message.use_count(), 1 + static_cast<long>(OutboundLimits().messages));

  EXPECT_FALSE(outbound.Send(message));

  EXPECT_FALSE(outbound.open());
  ASSERT_EQ(reactor.ends.size(), 1u);
  EXPECT_EQ(reactor.ends[0].error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(reactor.ends[0].error_message(),
            "the peer does not read what it is sent: 4096 messages wait");
  EXPECT_EQ(message.use_count(), 2);  // only the one that is being written
  for (int i = 0; i < 10'000; ++i) EXPECT_FALSE(outbound.Send(message));
  EXPECT_EQ(message.use_count(), 2);
  outbound.OnWritten(true);
  EXPECT_EQ(message.use_count(), 1);
  EXPECT_EQ(reactor.writing.size(), 1u);
  EXPECT_EQ(reactor.ends.size(), 1u);
}

TEST(StreamOutboundTest, RoomIsMadeByEachWrite) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);
  for (size_t i = 0; i < OutboundLimits().messages; ++i)
    ASSERT_TRUE(outbound.Send(MakeToken(1))) << i;

  outbound.OnWritten(true);

  EXPECT_TRUE(outbound.Send(MakeToken(2)));
  EXPECT_FALSE(outbound.Send(MakeToken(3)));
}

TEST(StreamOutboundTest, OnlyTheFirstEndCounts) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);
  const Token message = MakeToken(1);
  outbound.Send(message);
  outbound.Send(message);

  outbound.Close(grpc::Status(grpc::StatusCode::ABORTED, "first"));
  outbound.Close(grpc::Status::OK);
  outbound.OnWritten(false);

  ASSERT_EQ(reactor.ends.size(), 1u);
  EXPECT_EQ(reactor.ends[0].error_message(), "first");
  EXPECT_EQ(message.use_count(), 1);
}

TEST(StreamOutboundTest, CloseWhenSentWritesWhatWaitsAndTakesNoMore) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);
  outbound.Send(MakeToken(1));
  outbound.Send(MakeToken(2));

  outbound.CloseWhenSent(grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping"));

  EXPECT_FALSE(outbound.open());
  EXPECT_FALSE(outbound.Send(MakeToken(3)));
  EXPECT_TRUE(reactor.ends.empty()) << "two messages wait";
  outbound.OnWritten(true);
  EXPECT_THAT(reactor.writing, ElementsAre(1, 2));
  EXPECT_TRUE(reactor.ends.empty()) << "one message waits";
  outbound.OnWritten(true);
  ASSERT_EQ(reactor.ends.size(), 1u);
  EXPECT_EQ(reactor.ends[0].error_message(), "stopping");
  outbound.Close(grpc::Status::OK);
  outbound.CloseWhenSent(grpc::Status::OK);
  EXPECT_EQ(reactor.ends.size(), 1u);
}

TEST(StreamOutboundTest, CloseWhenSentEndsAnIdleCallAtOnce) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);
  outbound.CloseWhenSent(grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping"));
  ASSERT_EQ(reactor.ends.size(), 1u);
  EXPECT_EQ(reactor.ends[0].error_message(), "stopping");
}

TEST(StreamOutboundTest, CloseCutsACallThatIsStillSending) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);
  outbound.Send(MakeToken(1));
  outbound.Send(MakeToken(2));
  outbound.CloseWhenSent(grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping"));

  outbound.Close(grpc::Status::CANCELLED);  // as a shutdown does after its grace

  ASSERT_EQ(reactor.ends.size(), 1u);
  EXPECT_EQ(reactor.ends[0].error_message(), "stopping") << "the first status counts";
  outbound.OnWritten(true);
  EXPECT_THAT(reactor.writing, ElementsAre(1)) << "what waited was let go";
}

TEST(StreamOutboundTest, AWriteThatFailsEndsACallThatIsClosing) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);
  outbound.Send(MakeToken(1));
  outbound.Send(MakeToken(2));
  outbound.CloseWhenSent(grpc::Status(grpc::StatusCode::UNAVAILABLE, "stopping"));
  outbound.OnWritten(false);
  EXPECT_EQ(reactor.ends.size(), 1u);
}

TEST(StreamOutboundTest, AFailedWriteEndsTheCall) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);
  outbound.Send(MakeToken(1));
  outbound.Send(MakeToken(2));

  outbound.OnWritten(false);

  ASSERT_EQ(reactor.ends.size(), 1u);
  EXPECT_EQ(reactor.ends[0].error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_FALSE(outbound.Send(MakeToken(3)));
  EXPECT_THAT(reactor.writing, ElementsAre(1));
}

TEST(StreamOutboundTest, NothingReachesAReactorThatIsDone) {
  FakeReactor reactor;
  FakeOutbound outbound(&reactor);
  outbound.Detach();

  EXPECT_FALSE(outbound.Send(MakeToken(1)));
  outbound.Close(grpc::Status::OK);

  EXPECT_FALSE(outbound.open());
  EXPECT_TRUE(reactor.writing.empty());
  EXPECT_TRUE(reactor.ends.empty());
}

// As a message of protobuf says how long it is.
struct Sized {
  size_t bytes = 0;
  size_t ByteSizeLong() const { return bytes; }
};
struct SizedReactor {
  void StartWrite(const Sized*) {}
  void Finish(grpc::Status status) { ends.push_back(std::move(status)); }
  std::vector<grpc::Status> ends;
};

TEST(StreamOutboundTest, BytesThatWaitAreBoundedToo) {
  SizedReactor reactor;
  StreamOutbound<SizedReactor, Sized> outbound(&reactor);
  const size_t kMax = OutboundLimits().bytes;
  EXPECT_TRUE(outbound.Send({2 * kMax})) << "one goes, whatever its length";
  outbound.OnWritten(true);
  for (int round = 0; round < 3; ++round) {
    EXPECT_TRUE(outbound.Send({kMax / 2}));
    EXPECT_TRUE(outbound.Send({kMax / 2}));
    outbound.OnWritten(true);
    outbound.OnWritten(true);
  }
  EXPECT_TRUE(outbound.Send({kMax}));
  EXPECT_FALSE(outbound.Send({1}));
  ASSERT_EQ(reactor.ends.size(), 1u);
  EXPECT_EQ(reactor.ends[0].error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
}

}  // namespace
}  // namespace rips::rpc

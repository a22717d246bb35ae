// The pieces of a push, over real gRPC.
#include "policy_server/server/operator_api/push_stream.h"

#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/server_credentials.h"
#include "grpcpp/server_builder.h"
#include "gtest/gtest.h"
#include "policy_server/policy/bundle/bundle_archive.h"
#include "rips/v1/operator.grpc.pb.h"
#include "services/base/fake_clock.h"
#include "services/runtime/bounded_queue.h"

namespace rips::operator_api {
namespace {

using ::testing::HasSubstr;

using Code = grpc::StatusCode;

constexpr absl::Duration kPushPatience = absl::Seconds(60);
// The same as archive_bytes.
constexpr uint64_t kWholeBytes = 6;

struct WholePush {
  std::string archive;
  std::shared_ptr<PushStream::Answer> answer;
};

// Takes each push as it comes; the test answers it.
class PushService final : public rips::v1::OperatorService::CallbackService {
 public:
  grpc::ServerReadReactor<rips::v1::PushBundleRequest>* PushBundle(
      grpc::CallbackServerContext*, rips::v1::PushBundleResponse* response) override {
    auto* stream = new PushStream(
        &clock, response,
        [this](const rips::v1::PushBundleRequest& piece) {
          pieces.Push(piece.data());
          return heard;
        },
        [this](std::string archive, const std::shared_ptr<PushStream::Answer>& answer) {
          whole.Push({std::move(archive), answer});
        });
    stream->set_held(std::shared_ptr<void>(nullptr, [this](void*) { over.Push(1); }));
    stream->answer()->set_turn(std::shared_ptr<void>(nullptr, [this](void*) { turns.Push(1); }));
    stream->Begin();
    return stream;
  }

  FakeClock clock;
  absl::Status heard;
  BoundedQueue<std::string> pieces{{.capacity = 1'000}};
  BoundedQueue<WholePush> whole{{.capacity = 10}};
  // One for each stream that is over, and for each turn that was given back.
  BoundedQueue<int> over{{.capacity = 100}};
  BoundedQueue<int> turns{{.capacity = 100}};
};

class PushStreamTest : public ::testing::Test {
 protected:
  PushStreamTest() {
    int port = 0;
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(&service_);
    server_ = builder.BuildAndStart();
    stub_ = rips::v1::OperatorService::NewStub(
        grpc::CreateChannel(absl::StrCat("127.0.0.1:", port), grpc::InsecureChannelCredentials()));
  }
  ~PushStreamTest() override { server_->Shutdown(); }

  // The client's side of one push.
  struct Client {
    explicit Client(rips::v1::OperatorService::Stub& stub) {
      context.set_deadline(std::chrono::system_clock::now() + absl::ToChronoSeconds(kPushPatience));
      writer = stub.PushBundle(&context, &response);
    }
    bool Send(const std::string& data, uint64_t archive_bytes = kWholeBytes) {
      rips::v1::PushBundleRequest piece;
      piece.set_data(data);
      piece.set_archive_bytes(archive_bytes);
      return writer->Write(piece);
    }
    grpc::Status End() {
      writer->WritesDone();
      return writer->Finish();
    }

    grpc::ClientContext context;
    rips::v1::PushBundleResponse response;
    std::unique_ptr<grpc::ClientWriter<rips::v1::PushBundleRequest>> writer;
  };
  // Sends these pieces, and expects that the push is refused, and nothing is whole.
  void ExpectRefused(const std::vector<std::pair<std::string, uint64_t>>& pieces, Code code,
                     const std::string& why) {
    SCOPED_TRACE(why);
    Client client(*stub_);
    for (const auto& [data, archive_bytes] : pieces) client.Send(data, archive_bytes);
    const grpc::Status end = client.End();
    EXPECT_EQ(end.error_code(), code);
    EXPECT_THAT(end.error_message(), HasSubstr(why));
    EXPECT_TRUE(service_.over.Pop(kPushPatience).has_value());
    EXPECT_TRUE(service_.turns.Pop(kPushPatience).has_value());
    EXPECT_FALSE(service_.whole.Pop(absl::ZeroDuration()).has_value());
  }

  PushService service_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<rips::v1::OperatorService::Stub> stub_;
};

TEST_F(PushStreamTest, PiecesBecomeOneArchiveInTheirOrder) {
  Client client(*stub_);
  for (const char* data : {"ab", "c", "def"}) ASSERT_TRUE(client.Send(data));
  ASSERT_TRUE(client.writer->WritesDone());
  auto whole = service_.whole.Pop(kPushPatience);
  ASSERT_TRUE(whole.has_value());
  EXPECT_EQ(whole->archive, "abcdef");
  rips::v1::PushBundleResponse response;
  response.set_name("warehouse");
  whole->answer->Fill(response);
  EXPECT_FALSE(whole->answer->ended());
  whole->answer->End(absl::OkStatus());
  EXPECT_TRUE(client.writer->Finish().ok());
  EXPECT_EQ(client.response.name(), "warehouse");
  EXPECT_TRUE(service_.over.Pop(kPushPatience).has_value());
  EXPECT_TRUE(whole->answer->ended());
  // It is over: neither does anything any more.
  whole->answer->Fill(response);
  whole->answer->End(absl::InternalError("again"));
}

TEST_F(PushStreamTest, TheTurnIsGivenBackBeforeTheAnswerUnlessItIsTaken) {
  Client client(*stub_);
  ASSERT_TRUE(client.Send("abcdef"));
  ASSERT_TRUE(client.writer->WritesDone());
  const auto whole = service_.whole.Pop(kPushPatience);
  ASSERT_TRUE(whole.has_value());
  std::shared_ptr<void> turn = whole->answer->TakeTurn();
  client.context.TryCancel();
  EXPECT_EQ(client.writer->Finish().error_code(), Code::CANCELLED);
  EXPECT_TRUE(service_.over.Pop(kPushPatience).has_value());
  EXPECT_FALSE(service_.turns.Pop(absl::ZeroDuration()).has_value()) << "the taker has it";
  turn.reset();
  EXPECT_TRUE(service_.turns.Pop(absl::ZeroDuration()).has_value());

  Client other(*stub_);
  ASSERT_TRUE(other.Send("abcdef"));
  ASSERT_TRUE(other.writer->WritesDone());
  const auto next = service_.whole.Pop(kPushPatience);
  ASSERT_TRUE(next.has_value());
  next->answer->End(absl::OkStatus());
  EXPECT_TRUE(other.writer->Finish().ok());
  EXPECT_TRUE(service_.turns.Pop(absl::ZeroDuration()).has_value());
}

TEST_F(PushStreamTest, WhatIsNotWholeIsRefused) {
  ExpectRefused({}, Code::INVALID_ARGUMENT, "the push ended after 0 of 0 bytes");
  ExpectRefused({{"abcde", kWholeBytes}}, Code::INVALID_ARGUMENT,
                "the push ended after 5 of 6 bytes");
}

TEST_F(PushStreamTest, PiecesThatDoNotFitAreRefused) {
  const std::string misfit = "the pieces of the push do not fit together";
  ExpectRefused({{"abcdefg", kWholeBytes}}, Code::INVALID_ARGUMENT, misfit);
  ExpectRefused({{"abcdef", kWholeBytes}, {"g", kWholeBytes}}, Code::INVALID_ARGUMENT, misfit);
  ExpectRefused({{"abc", kWholeBytes}, {"def", 7}}, Code::INVALID_ARGUMENT, misfit);
  ExpectRefused({{"abc", kWholeBytes}, {"", kWholeBytes}}, Code::INVALID_ARGUMENT, misfit);
  ExpectRefused({{"", kWholeBytes}}, Code::INVALID_ARGUMENT, misfit);
}

TEST_F(PushStreamTest, TheSizeOfAnArchiveHasALimit) {
  constexpr uint64_t kMost = bundle::kArchiveBytesMax;
  ExpectRefused({{"abc", kMost + 1}}, Code::INVALID_ARGUMENT,
                absl::StrCat("a bundle of ", kMost + 1, " bytes; the limit is ", kMost));
  ExpectRefused({{"abc", std::numeric_limits<uint64_t>::max()}}, Code::INVALID_ARGUMENT,
                "a bundle of 18446744073709551615 bytes");
  ExpectRefused({{"abc", 0}}, Code::INVALID_ARGUMENT, "a bundle of 0 bytes");
  // Only what has come is held.
  ExpectRefused({{"abc", kMost}}, Code::INVALID_ARGUMENT,
                absl::StrCat("the push ended after 3 of ", kMost, " bytes"));
}

TEST_F(PushStreamTest, ASlowPushIsEnded) {
  Client client(*stub_);
  ASSERT_TRUE(client.Send("abc"));
  ASSERT_TRUE(service_.pieces.Pop(kPushPatience).has_value());
  service_.clock.Advance(absl::ToInt64Nanoseconds(PushStream::kPatience));
  ASSERT_TRUE(client.Send("d"));
  ASSERT_TRUE(service_.pieces.Pop(kPushPatience).has_value());
  service_.clock.Advance(1);
  client.Send("ef");
  const grpc::Status end = client.End();
  EXPECT_EQ(end.error_code(), Code::DEADLINE_EXCEEDED);
  EXPECT_THAT(end.error_message(),
              HasSubstr("the push is too slow: less than 65536 bytes a second"));
}

TEST_F(PushStreamTest, APieceThatIsRefusedEndsThePush) {
  service_.heard = absl::ResourceExhaustedError("too large a field");
  ExpectRefused({{"abc", kWholeBytes}}, Code::RESOURCE_EXHAUSTED, "too large a field");
}

TEST_F(PushStreamTest, ACancelledPushIsDropped) {
  Client client(*stub_);
  ASSERT_TRUE(client.Send("abc"));
  ASSERT_TRUE(service_.pieces.Pop(kPushPatience).has_value());
  client.context.TryCancel();
  EXPECT_EQ(client.writer->Finish().error_code(), Code::CANCELLED);
  EXPECT_TRUE(service_.over.Pop(kPushPatience).has_value());
  EXPECT_TRUE(service_.turns.Pop(absl::ZeroDuration()).has_value());
  EXPECT_FALSE(service_.whole.Pop(absl::ZeroDuration()).has_value());
}

}  // namespace
}  // namespace rips::operator_api

#include "services/rpc/call_gate.h"

#include <memory>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "rips/v1/operator.grpc.pb.h"
#include "services/rpc/test_pki.h"
#include "services/rpc/test_service.h"
#include "services/runtime/real_clock.h"

namespace rips::rpc {
namespace {

using ::testing::HasSubstr;

class CallGateTest : public ::testing::Test {
 protected:
  struct Told {
    std::string peer;
    std::string reason;
    std::string address;
    std::string certificate;
  };

  void SetUp() override {
    ConnectionGuard::Options options;
    options.agent_calls_burst = 6;
    auto guard = ConnectionGuard::Listen("127.0.0.1:0", std::move(options), &clock_, &metrics_);
    ASSERT_TRUE(guard.ok()) << guard.status();
    guard_ = *std::move(guard);
    gate_ = std::make_unique<CallGate>(&clock_, nullptr, &metrics_, guard_.get());
    gate_->set_on_refused([this](const Peer& peer, const Refusal& refusal, absl::string_view from) {
      told_.Push({ToString(peer.identity), refusal.reason, std::string(from), Describe(peer)});
    });
    auto server = RpcServer::Start({.listen = "127.0.0.1:0",
                                    .guard = guard_.get(),
                                    .gate = gate_.get(),
                                    .credentials = LoadOrDie(pki_.Server())->ForServer()},
                                   {&service_});
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
    channel_ = MakeChannel(server_->address(), LoadOrDie(pki_.Operator())->ForClient());
  }

  grpc::Status Drill(const std::string& robot, bool packed = false) {
    grpc::ClientContext context;
    if (packed) context.set_compression_algorithm(GRPC_COMPRESS_GZIP);
    context.set_deadline(std::chrono::system_clock::now() + absl::ToChronoSeconds(kPatience));
    rips::v1::DrillRobotRequest request;
    request.set_robot(robot);
    rips::v1::DrillRobotResponse response;
    return rips::v1::OperatorService::NewStub(channel_)->DrillRobot(&context, request, &response);
  }
  grpc::Status Watch(const std::string& robot) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + absl::ToChronoSeconds(kPatience));
    rips::v1::WatchAlertsRequest request;
    request.set_robot(robot);
    const auto reader =
        rips::v1::OperatorService::NewStub(channel_)->WatchAlerts(&context, request);
    rips::v1::Alert alert;
    while (reader->Read(&alert)) {
    }
    return reader->Finish();
  }

  TestPki pki_;
  RealClock clock_;
  Metrics metrics_;
  BoundedQueue<Told> told_{{.capacity = 100}};
  std::unique_ptr<ConnectionGuard> guard_;
  std::unique_ptr<CallGate> gate_;
  rips::v1::OperatorService::CallbackService service_;  // answers nothing
  std::unique_ptr<RpcServer> server_;
  std::shared_ptr<grpc::Channel> channel_;
};

constexpr char kUndecodable[] =
    "rips_refused_calls_total{reason=\"undecodable\",role=\"operator\"} ";

TEST_F(CallGateTest, CallsThatCannotBeDecodedAreCountedWithTheirPeer) {
  EXPECT_EQ(Drill("\xff\xfe").error_code(), grpc::StatusCode::UNIMPLEMENTED);
  EXPECT_THAT(metrics_.Text(), HasSubstr(absl::StrCat(kUndecodable, 1)));
  const auto told = told_.Pop(kPatience);
  ASSERT_TRUE(told.has_value());
  EXPECT_EQ(told->reason, "undecodable");
  EXPECT_THAT(told->peer, HasSubstr("/operator/"));
}

TEST_F(CallGateTest, AStreamOfAnswersIsAskedForByARequestToo) {
  EXPECT_FALSE(Watch("\xc3").ok());
  EXPECT_THAT(metrics_.Text(), HasSubstr(absl::StrCat(kUndecodable, 1)));
}

// What is unpacked before its size is known may be a thousand times as large.
TEST_F(CallGateTest, ACompressedRequestIsNotUnpacked) {
  EXPECT_EQ(Drill(std::string(100'000, 'r'), /*packed=*/true).error_code(),
            grpc::StatusCode::UNIMPLEMENTED);
  EXPECT_THAT(metrics_.Text(), HasSubstr(absl::StrCat(kUndecodable, 1)));
  EXPECT_EQ(Drill("r1").error_code(), grpc::StatusCode::UNIMPLEMENTED) << "no such handler here";
  EXPECT_THAT(metrics_.Text(), HasSubstr(absl::StrCat(kUndecodable, 1)));
}

TEST_F(CallGateTest, ACertificateThatSendsManyIsBanned) {
  const int64_t deadline_ns = BoottimeAfter(kPatience);
  const std::string certificate = [&] {
    Drill("\xff");
    return told_.Pop(kPatience)->certificate;
  }();
  while (guard_->Banned(certificate, "127.0.0.1") == absl::ZeroDuration()) {
    ASSERT_LT(BoottimeNow(), deadline_ns);
    Drill("\xff");
  }
}

TEST_F(CallGateTest, CallsThatCanBeDecodedAreNotCounted) {
  EXPECT_EQ(Drill("r1").error_code(), grpc::StatusCode::UNIMPLEMENTED) << "no such handler here";
  Drill("");
  Watch("r1");
  EXPECT_THAT(metrics_.Text(), HasSubstr(absl::StrCat(kUndecodable, 0)));
}

}  // namespace
}  // namespace rips::rpc

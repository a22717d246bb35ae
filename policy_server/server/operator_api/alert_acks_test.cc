// Acknowledging alerts, as operators do it and see it.
#include "policy_server/server/operator_api/alert_acks.h"

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/status_matchers.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"

namespace rips::operator_api {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

// `digits`, then zeros.
std::string AlertId(const std::string& digits) {
  return digits + std::string(32 - digits.size(), '0');
}

class AlertAcksTest : public ::testing::Test {
 protected:
  void SetUp() override {
    server_credentials_ = *rpc::Credentials::Load(pki_.Server());
    for (const char* digits : {"aaaaaa1", "aaaaaa2", "bbbbbb"}) {
      ASSERT_THAT(store_.Commit({.robot = "r1",
                                 .alerts = {{.id = AlertId(digits),
                                             .time_unix_ns = 1,
                                             .robot = "r1",
                                             .rule = "intruder",
                                             .severity = "high",
                                             .text = digits}}}),
                  IsOk());
    }
    Serve(&store_);
    alice_ = Connect("operator", "alice");
    bob_ = Connect("operator", "bob");
  }
  void Serve(store::AckStore* acks) {
    server_.reset();
    service_ = std::make_unique<OperatorService>(
        &pipeline_, &store_, &hub_, OperatorService::Access{.watch = &watch_, .acks = acks});
    auto server = rpc::RpcServer::Start(
        {.listen = "127.0.0.1:0", .credentials = server_credentials_->ForServer()},
        {service_.get()});
    ASSERT_THAT(server, IsOk());
    server_ = *std::move(server);
  }
  using Stub = rips::v1::OperatorService::Stub;
  std::unique_ptr<Stub> Connect(const std::string& role, const std::string& name) {
    const auto credentials = *rpc::Credentials::Load(pki_.Operator(role, name));
    return rips::v1::OperatorService::NewStub(
        rpc::MakeChannel(server_->address(), credentials->ForClient()));
  }
  static void SetDeadline(grpc::ClientContext& context) {
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
  }
  grpc::Status Acknowledge(Stub& stub, const std::vector<std::string>& ids,
                           const std::string& note = "") {
    grpc::ClientContext context;
    SetDeadline(context);
    rips::v1::AckAlertsRequest request;
    for (const std::string& id : ids) request.add_alert_ids(id);
    request.set_note(note);
    answer_.Clear();
    return stub.AckAlerts(&context, request, &answer_);
  }
  rips::v1::ListAlertsResponse List(bool open = false) {
    grpc::ClientContext context;
    SetDeadline(context);
    rips::v1::ListAlertsRequest request;
    request.set_open(open);
    rips::v1::ListAlertsResponse response;
    listed_ = alice_->ListAlerts(&context, request, &response);
    return response;
  }

  rpc::TestPki pki_;
  RealClock clock_;
  store::FakeStore store_;
  StatusBroadcaster hub_{&store_, nullptr};
  pipeline::Pipeline pipeline_{1, &clock_};
  rpc::SessionWatch watch_{&clock_};
  std::shared_ptr<const rpc::Credentials> server_credentials_;
  std::unique_ptr<OperatorService> service_;
  std::unique_ptr<rpc::RpcServer> server_;
  std::unique_ptr<Stub> alice_;
  std::unique_ptr<Stub> bob_;
  rips::v1::AckAlertsResponse answer_;
  grpc::Status listed_;
};

TEST_F(AlertAcksTest, ShowsWhoAcknowledgedAnAlertFirst) {
  const int64_t before_ns = clock_.Now().unix_ns;
  ASSERT_TRUE(Acknowledge(*alice_, {"bbbbbb", AlertId("aaaaaa1"), AlertId("bbbbbb")}, "seen").ok());
  ASSERT_THAT(answer_.alerts(), SizeIs(2)) << "each once";
  EXPECT_EQ(answer_.alerts(0).alert_id(), AlertId("bbbbbb"));
  EXPECT_FALSE(answer_.alerts(0).already());
  EXPECT_THAT(answer_.alerts(0).acknowledged().by(), HasSubstr("/operator/operator/alice serial "));
  EXPECT_GE(answer_.alerts(0).acknowledged().time_unix_ns(), before_ns);

  ASSERT_TRUE(Acknowledge(*bob_, {"bbbbbb", "aaaaaa2"}, "me too").ok());
  ASSERT_THAT(answer_.alerts(), SizeIs(2));
  EXPECT_TRUE(answer_.alerts(0).already());
  EXPECT_EQ(answer_.alerts(0).acknowledged().note(), "seen");
  EXPECT_THAT(answer_.alerts(0).acknowledged().by(), HasSubstr("/alice serial "));
  EXPECT_FALSE(answer_.alerts(1).already());

  const auto all = List();
  ASSERT_THAT(all.alerts(), SizeIs(3));
  EXPECT_EQ(all.alerts(0).acknowledged().note(), "seen");
  EXPECT_EQ(all.alerts(1).acknowledged().note(), "me too");
  EXPECT_THAT(List(true).alerts(), IsEmpty());
}

TEST_F(AlertAcksTest, ListsOnlyWhatIsOpen) {
  ASSERT_TRUE(Acknowledge(*alice_, {"bbbbbb"}).ok());
  const auto open = List(true);
  ASSERT_THAT(open.alerts(), SizeIs(2));
  EXPECT_EQ(open.alerts(0).id(), AlertId("aaaaaa2"));
  EXPECT_FALSE(open.alerts(0).has_acknowledged());
  EXPECT_TRUE(List().alerts(0).has_acknowledged());
  EXPECT_FALSE(List().alerts(1).has_acknowledged());
}

TEST_F(AlertAcksTest, AViewerMayNot) {
  const auto viewer = Connect("viewer", "vera");
  EXPECT_EQ(Acknowledge(*viewer, {"bbbbbb"}).error_code(), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_THAT(List(true).alerts(), SizeIs(3));
}

TEST_F(AlertAcksTest, OneBadIdAndNothingIsAcknowledged) {
  using grpc::StatusCode;
  const auto refused = [&](const std::string& id) { return Acknowledge(*alice_, {"bbbbbb", id}); };
  EXPECT_EQ(refused("cccccc").error_code(), StatusCode::NOT_FOUND);
  EXPECT_THAT(refused("cccccc").error_message(), HasSubstr("cccccc"));
  EXPECT_EQ(refused(AlertId("c")).error_code(), StatusCode::NOT_FOUND);
  EXPECT_EQ(refused("aaaaaa").error_code(), StatusCode::INVALID_ARGUMENT) << "of two";
  for (const std::string bad : {"", "bbbbb", "BBBBBB", "%", "\x1b[2Jaaaa"}) {
    EXPECT_EQ(refused(bad).error_code(), StatusCode::INVALID_ARGUMENT) << bad;
    EXPECT_EQ(refused(bad).error_message().find('\x1b'), std::string::npos);
  }
  EXPECT_FALSE(refused(AlertId("bbbbbb") + "0").ok()) << "too long";
  EXPECT_EQ(Acknowledge(*alice_, {}).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_FALSE(Acknowledge(*alice_, {"bbbbbb"}, std::string(1'001, 'x')).ok());
  EXPECT_FALSE(Acknowledge(*alice_, std::vector<std::string>(101, "bbbbbb")).ok());
  EXPECT_THAT(List(true).alerts(), SizeIs(3));
  EXPECT_TRUE(
      Acknowledge(*alice_, std::vector<std::string>(100, "bbbbbb"), std::string(1'000, 'x')).ok());
}

TEST_F(AlertAcksTest, SaysWhenTheStoreCannot) {
  store_.FailWrites(absl::ResourceExhaustedError("the disk is full"));
  EXPECT_EQ(Acknowledge(*alice_, {"bbbbbb"}).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  store_.FailWrites(absl::OkStatus());
  store_.FailReads(absl::UnavailableError("the disk fails"));
  EXPECT_EQ(Acknowledge(*alice_, {"bbbbbb"}).error_code(), grpc::StatusCode::UNAVAILABLE);
  List(true);
  EXPECT_EQ(listed_.error_code(), grpc::StatusCode::UNAVAILABLE);
}

TEST_F(AlertAcksTest, WithoutThemListsAreAsBefore) {
  Serve(nullptr);
  alice_ = Connect("operator", "alice");
  EXPECT_EQ(Acknowledge(*alice_, {"bbbbbb"}).error_code(), grpc::StatusCode::UNIMPLEMENTED);
  EXPECT_THAT(List().alerts(), SizeIs(3));
  List(true);
  EXPECT_EQ(listed_.error_code(), grpc::StatusCode::UNIMPLEMENTED);
}

}  // namespace
}  // namespace rips::operator_api

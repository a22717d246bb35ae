// Acknowledging alerts, as operators do it and see it.
#include "policy_server/server/operator_api/alert_acks.h"

#include <stdlib.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/audit/segments.h"
#include "policy_server/audit/verify.h"
#include "policy_server/server/audit/audit_log.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/store/committer.h"
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

// A directory that goes with the test.
class TempDirectory {
 public:
  TempDirectory() {
    std::string name = (std::filesystem::temp_directory_path() / "rips-acks-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    path_ = name;
  }
  ~TempDirectory() { std::filesystem::remove_all(path_); }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

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
    Serve();
    alice_ = Connect("operator", "alice");
    bob_ = Connect("operator", "bob");
  }
  void Serve(bool with_acks = true) {
    server_.reset();
    OperatorService::Access access{.watch = &watch_, .quota = quota_, .audit = orders_.get()};
    if (with_acks) {
      access.acks = &store_;
      access.committer = &committer_;
    }
    service_ = std::make_unique<OperatorService>(&pipeline_, &store_, &hub_, std::move(access));
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
    rips::v1::ListAlertsRequest request;
    request.set_open(open);
    return List(request);
  }
  rips::v1::ListAlertsResponse List(const rips::v1::ListAlertsRequest& request) {
    grpc::ClientContext context;
    SetDeadline(context);
    rips::v1::ListAlertsResponse response;
    listed_ = alice_->ListAlerts(&context, request, &response);
    return response;
  }

  rpc::TestPki pki_;
  RealClock clock_;
  store::FakeStore store_;
  StatusBroadcaster hub_{&store_, nullptr};
  store::Committer committer_{&store_};
  pipeline::Pipeline pipeline_{1, &clock_};
  std::shared_ptr<CallerQuota> quota_;
  std::unique_ptr<audit::OrderAudit> orders_;
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
  EXPECT_EQ(answer_.alerts(0).robot(), "r1");
  EXPECT_EQ(answer_.alerts(0).rule(), "intruder");
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
  EXPECT_EQ(refused("aaaaaa").error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(refused("aaaaaa").error_message(),
              AllOf(HasSubstr(AlertId("aaaaaa1")), HasSubstr(AlertId("aaaaaa2"))));
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
  const grpc::Status full = Acknowledge(*alice_, {"bbbbbb"});
  EXPECT_EQ(full.error_code(), grpc::StatusCode::ABORTED) << "it is not the way to the server";
  EXPECT_THAT(full.error_message(), HasSubstr("the disk is full"));
  store_.FailWrites(absl::OkStatus());
  store_.FailReads(absl::UnavailableError("the disk fails"));
  EXPECT_EQ(Acknowledge(*alice_, {"bbbbbb"}).error_code(), grpc::StatusCode::UNAVAILABLE);
  List(true);
  EXPECT_EQ(listed_.error_code(), grpc::StatusCode::UNAVAILABLE);
}

TEST_F(AlertAcksTest, OfTwoAtATimeTheOneWrittenFirstStays) {
  // Bob's is written while Alice's has been found not to be acknowledged.
  BoundedQueue<int> committing{{.capacity = 1}}, go_on{{.capacity = 1}};
  store_.OnCommit([&] {
    committing.Push(1);
    go_on.Pop(absl::Seconds(60));
  });
  std::thread alices([&] { EXPECT_TRUE(Acknowledge(*alice_, {"bbbbbb"}, "me").ok()); });
  ASSERT_TRUE(committing.Pop(absl::Seconds(60)).has_value());
  store_.OnCommit(nullptr);
  ASSERT_THAT(store_.Commit({.robot = "r1",
                             .acks = {{.alert_id = AlertId("bbbbbb"),
                                       .ack = {.by = "bob", .note = "first", .time_unix_ns = 1}}}}),
              IsOk());
  go_on.Push(1);
  alices.join();
  ASSERT_THAT(answer_.alerts(), SizeIs(1));
  EXPECT_TRUE(answer_.alerts(0).already());
  EXPECT_EQ(answer_.alerts(0).acknowledged().by(), "bob");
  EXPECT_EQ(answer_.alerts(0).acknowledged().note(), "first");
}

TEST_F(AlertAcksTest, WhatIsAcknowledgedAlreadyWritesNothing) {
  ASSERT_TRUE(Acknowledge(*alice_, {"bbbbbb"}).ok());
  const size_t commits = store_.commit_sizes().size();
  ASSERT_TRUE(Acknowledge(*bob_, {"bbbbbb"}).ok());
  EXPECT_EQ(store_.commit_sizes().size(), commits);
  EXPECT_TRUE(answer_.alerts(0).already());
}

TEST_F(AlertAcksTest, UsesUpTheQuotaOfQueriesByItsSizeAndNoOrder) {
  quota_ =
      CallerQuota::Create(&clock_, {.queries = {.at_a_time = 8, .per_second = 0, .burst = 12}});
  Serve();
  alice_ = Connect("operator", "alice");
  const std::vector<std::string> hundred(100, "bbbbbb");
  EXPECT_TRUE(Acknowledge(*alice_, hundred).ok());
  EXPECT_TRUE(Acknowledge(*alice_, hundred).ok());
  EXPECT_EQ(Acknowledge(*alice_, hundred).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_TRUE(Acknowledge(*alice_, {"bbbbbb"}).ok());
  grpc::ClientContext context;
  SetDeadline(context);
  rips::v1::LevelResponse raised;
  EXPECT_EQ(alice_->Raise(&context, {}, &raised).error_code(), grpc::StatusCode::NOT_FOUND)
      << "of no robot, but not of the quota";
}

// What was acknowledged, RecordsOfTest has.
TEST_F(AlertAcksTest, WhatWasRefusedIsOnRecord) {
  const TempDirectory directory;
  {
    const auto log = *audit::AuditLog::Open({.directory = directory.path()}, &clock_);
    orders_ = std::make_unique<audit::OrderAudit>(log.get(), &clock_);
    Serve();
    alice_ = Connect("operator", "alice");
    const auto viewer = Connect("viewer", "vera");
    EXPECT_TRUE(Acknowledge(*alice_, {"bbbbbb"}, "on it").ok());
    EXPECT_FALSE(Acknowledge(*alice_, {"cccccc"}).ok());
    EXPECT_FALSE(Acknowledge(*viewer, {"aaaaaa1"}).ok());
    server_.reset();
    service_.reset();
    orders_.reset();
  }
  std::vector<std::string> calls;
  const auto report = audit::Verify(
      audit::SegmentsInDirectory(directory.path()), {}, [&](uint64_t, absl::string_view payload) {
        rips::v1::AuditRecord record;
        record.ParseFromString(std::string(payload));
        if (record.action() != "AckAlerts") return;
        calls.push_back(absl::StrCat(record.actor(), "|", record.outcome(), "|", record.text()));
      });
  ASSERT_TRUE(report.ok() && !report->fault);
  ASSERT_THAT(calls, SizeIs(2));
  EXPECT_THAT(calls[0], AllOf(HasSubstr("/operator/operator/alice serial "), HasSubstr("NOT_FOUND"),
                              HasSubstr("cccccc")));
  EXPECT_THAT(calls[1], AllOf(HasSubstr("/viewer/vera serial "), HasSubstr("PERMISSION_DENIED")));
}

TEST_F(AlertAcksTest, ListsBySeverityRuleAndTime) {
  const int64_t now_ns = clock_.Now().unix_ns;
  const auto add = [&](const std::string& digits, const char* rule, const char* severity,
                       int64_t time_unix_ns) {
    ASSERT_THAT(store_.Commit({.robot = "r2",
                               .alerts = {{.id = AlertId(digits),
                                           .time_unix_ns = time_unix_ns,
                                           .robot = "r2",
                                           .rule = rule,
                                           .severity = severity}}}),
                IsOk());
  };
  add("dddddd", "scan", "critical", now_ns);
  add("eeeeee", "scan", "medium", now_ns - 3'600'000'000'000);
  const auto ids = [&](const rips::v1::ListAlertsRequest& request) {
    std::string digits;
    const rips::v1::ListAlertsResponse response = List(request);
    for (const auto& alert : response.alerts()) digits += alert.id().substr(0, 1);
    EXPECT_TRUE(listed_.ok()) << listed_.error_message();
    return digits;
  };
  rips::v1::ListAlertsRequest request;
  request.set_severity("high");
  EXPECT_EQ(ids(request), "dbaa");
  request.set_severity("info");
  EXPECT_EQ(ids(request), "edbaa");
  request.set_rule("scan");
  EXPECT_EQ(ids(request), "ed");
  request.set_within_ms(1'800'000);
  EXPECT_EQ(ids(request), "d");
  request.Clear();
  request.set_within_ms(~uint64_t{0});
  EXPECT_EQ(ids(request), "edbaa");
  ASSERT_TRUE(Acknowledge(*alice_, {"dddddd"}).ok());
  request.set_open(true);
  request.set_severity("high");
  EXPECT_EQ(ids(request), "baa");
  request.set_robot("r2");
  EXPECT_EQ(ids(request), "") << "no robot of the inventory, but there are alerts of it";
  request.set_severity("HIGH\x1b[2J");
  List(request);
  EXPECT_EQ(listed_.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(listed_.error_message().find('\x1b'), std::string::npos);
}

TEST_F(AlertAcksTest, IsPartOfAnExplanation) {
  ASSERT_TRUE(Acknowledge(*alice_, {"bbbbbb"}, "on it").ok());
  grpc::ClientContext context;
  SetDeadline(context);
  rips::v1::ExplainRequest request;
  request.set_id("bbbbbb");
  rips::v1::ExplainResponse response;
  ASSERT_TRUE(alice_->Explain(&context, request, &response).ok());
  EXPECT_EQ(response.alert().acknowledged().note(), "on it");
}

TEST_F(AlertAcksTest, WithoutThemListsAreAsBefore) {
  Serve(false);
  alice_ = Connect("operator", "alice");
  EXPECT_EQ(Acknowledge(*alice_, {"bbbbbb"}).error_code(), grpc::StatusCode::UNIMPLEMENTED);
  EXPECT_THAT(List().alerts(), SizeIs(3));
  List(true);
  EXPECT_EQ(listed_.error_code(), grpc::StatusCode::UNIMPLEMENTED);
}

}  // namespace
}  // namespace rips::operator_api

// Maintenance of a robot as operators call for it, over real gRPC.
#include <stdlib.h>

#include <filesystem>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/audit/segments.h"
#include "policy_server/audit/verify.h"
#include "policy_server/server/audit/audit_log.h"
#include "policy_server/server/operator_api/answer_limits.h"
#include "policy_server/server/operator_api/calls_fixture.h"

namespace rips::operator_api {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr uint64_t kMinuteMs = 60'000;
constexpr uint64_t kDayMs = 24 * 60 * kMinuteMs;

class MaintenanceCallsTest : public CallsTest {
 protected:
  void SetUp() override {
    std::string name = (std::filesystem::temp_directory_path() / "rips-calls-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    directory_ = name;
    log_ = *audit::AuditLog::Open({.directory = directory_}, &clock_);
    orders_ = std::make_unique<audit::OrderAudit>(log_.get(), &clock_);
    Start({}, {}, orders_.get());
  }
  void TearDown() override {
    Stop();
    std::filesystem::remove_all(directory_);
  }
  void Stop() {
    CallsTest::Stop();
    orders_.reset();
    log_.reset();
  }
  grpc::Status Set(Stub& stub, uint64_t for_ms, const std::string& reason = "reboot",
                   const std::string& robot = "r1") {
    rips::v1::SetMaintenanceRequest request;
    request.set_robot(robot);
    request.set_for_ms(for_ms);
    request.set_reason(reason);
    answer_.Clear();
    return Call(stub, &Stub::SetMaintenance, request, answer_);
  }
  rips::v1::RobotStatus Status(Stub& stub) {
    rips::v1::ListRobotsResponse response;
    EXPECT_TRUE(Call(stub, &Stub::ListRobots, rips::v1::ListRobotsRequest(), response).ok());
    return response.robots_size() == 1 ? response.robots(0) : rips::v1::RobotStatus();
  }

  std::string directory_;
  std::unique_ptr<audit::AuditLog> log_;
  std::unique_ptr<audit::OrderAudit> orders_;
  rips::v1::SetMaintenanceResponse answer_;
};

TEST_F(MaintenanceCallsTest, BeginsReplacesAndEnds) {
  const auto carol = Connect("operator", "carol");
  ASSERT_TRUE(Set(*carol, 2 * kMinuteMs).ok());
  const rips::v1::Maintenance& now = answer_.maintenance();
  EXPECT_EQ(now.until_unix_ns() - now.began_unix_ns(), 120 * kNanosPerSecond);
  EXPECT_THAT(now.operator_(), AllOf(HasSubstr("carol ("), HasSubstr("/operator/operator/carol")));
  EXPECT_EQ(now.reason(), "reboot");
  EXPECT_EQ(Status(*carol).maintenance().until_unix_ns(), now.until_unix_ns());

  ASSERT_TRUE(Set(*carol, kDayMs, "longer").ok());
  EXPECT_EQ(Status(*carol).maintenance().reason(), "longer");
  ASSERT_TRUE(Set(*carol, 0, "it is back").ok());
  EXPECT_FALSE(answer_.has_maintenance());
  EXPECT_FALSE(Status(*carol).has_maintenance());
  EXPECT_EQ(Set(*carol, 0).error_code(), grpc::StatusCode::FAILED_PRECONDITION);
}

TEST_F(MaintenanceCallsTest, BadRequestsAreRefusedWithTheirReason) {
  const auto carol = Connect("operator", "carol");
  for (const uint64_t bad : {uint64_t{1}, kMinuteMs - 1, kDayMs + 1, uint64_t{1} << 63,
                             std::numeric_limits<uint64_t>::max()}) {
    const grpc::Status status = Set(*carol, bad);
    EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << bad;
    EXPECT_THAT(status.error_message(), HasSubstr("1 minute to 24 hours"));
  }
  EXPECT_EQ(Set(*carol, kMinuteMs, "").error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(Set(*carol, kMinuteMs, std::string(1'001, 'x')).error_code(),
            grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(Set(*carol, kMinuteMs, "x", "r9").error_code(), grpc::StatusCode::NOT_FOUND);
  EXPECT_FALSE(Status(*carol).has_maintenance());
}

TEST_F(MaintenanceCallsTest, CallsAreOnRecordAlsoThoseThatAreRefused) {
  EXPECT_EQ(Set(*Connect("viewer", "vera"), kMinuteMs).error_code(),
            grpc::StatusCode::PERMISSION_DENIED);
  const auto carol = Connect("operator", "carol");
  ASSERT_TRUE(Set(*carol, kMinuteMs).ok());
  EXPECT_FALSE(Set(*carol, kDayMs + 1).ok());
  ASSERT_TRUE(Set(*carol, 0).ok());
  Stop();
  std::vector<std::string> calls;
  const auto report = audit::Verify(
      audit::SegmentsInDirectory(directory_), {}, [&](uint64_t, absl::string_view payload) {
        rips::v1::AuditRecord record;
        record.ParseFromString(std::string(payload));
        if (record.action() != "SetMaintenance") return;
        calls.push_back(absl::StrCat(record.robot(), "|", record.actor(), "|", record.outcome(),
                                     "|", record.text()));
      });
  ASSERT_TRUE(report.ok() && !report->fault);
  EXPECT_THAT(
      calls,
      ElementsAre(AllOf(HasSubstr("/viewer/vera serial "), HasSubstr("PERMISSION_DENIED")),
                  AllOf(HasSubstr("r1|"), HasSubstr("/operator/operator/carol serial "),
                        HasSubstr("|admitted|"), HasSubstr("reason: \"reboot\"")),
                  HasSubstr("|admitted|"), HasSubstr("INVALID_ARGUMENT"), HasSubstr("|admitted|")));
}

TEST(MaintenanceOfAFleetTest, ItsReasonsAreCutWhereThereIsNoRoom) {
  rips::v1::ListRobotsResponse response;
  for (int i = 0; i < 100; ++i) {
    *response.add_robots() =
        EncodeStatus({.robot = absl::StrCat("r", i),
                      .maintenance = store::Maintenance{
                          .until_unix_ns = 1, .by = "carol", .reason = std::string(1'000, 'x')}});
  }
  FitStatuses(response, 20'000);
  EXPECT_LT(response.ByteSizeLong(), 20'000u);
  EXPECT_EQ(response.robots_size(), 100);
  EXPECT_THAT(response.robots(7).maintenance().reason(), HasSubstr("xxx..."));
}

}  // namespace
}  // namespace rips::operator_api

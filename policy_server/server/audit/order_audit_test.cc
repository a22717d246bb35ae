#include "policy_server/server/audit/order_audit.h"

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/audit/segments.h"
#include "rips/v1/operator.pb.h"
#include "services/base/fake_clock.h"

namespace rips::audit {
namespace {

using testing::HasSubstr;
using testing::SizeIs;

constexpr int64_t kSecond = 1'000'000'000;

TEST(OrderAuditTest, RefusedCallsOfOneCertificateAreCountedPastABurst) {
  std::string directory = (std::filesystem::temp_directory_path() / "audit-XXXXXX").string();
  ASSERT_NE(mkdtemp(directory.data()), nullptr);
  FakeClock clock;
  {
    const auto log = *AuditLog::Open({.directory = directory}, &clock);
    OrderAudit audit(log.get(), &clock);
    v1::LevelRequest request;
    request.set_robot("r1");
    request.set_reason("why");
    request.mutable_expected_decision_id()->set_term(3);
    request.set_request_id(std::string("\x8f\x00\n\"\xff", 5));
    audit.Record({"alice", "ipv4:1", "DeEscalate", request, absl::OkStatus()});
    for (int i = 0; i < 1'000; ++i) {
      audit.Record({"mallory", "ipv4:2", "Ban", request, absl::PermissionDeniedError("role")});
    }
    request.set_reason(std::string(9'000, 'x'));
    audit.Record({"dave", "ipv4:3", "Raise", request, absl::PermissionDeniedError("role")});
    request.set_reason(std::string(1 << 20, 'x'));
    audit.Record({"eve", "ipv4:3", "Raise", request, absl::InvalidArgumentError("limit")});
  }
  std::vector<v1::AuditRecord> calls;
  const auto report =
      Verify(SegmentsInDirectory(directory), {}, [&](uint64_t, absl::string_view payload) {
        v1::AuditRecord record;
        record.ParseFromString(std::string(payload));
        if (!record.action().empty()) calls.push_back(record);
      });
  std::filesystem::remove_all(directory);
  ASSERT_TRUE(report.ok() && !report->fault);
  // The burst of the limiter, the rest in one, and perhaps one more on a slow machine.
  ASSERT_GE(calls.size(), 54u);
  EXPECT_LE(calls.size(), 57u);
  uint64_t of_mallory = 0;
  for (const v1::AuditRecord& each : calls) {
    if (each.actor() == "mallory") of_mallory += each.count();
  }
  EXPECT_EQ(of_mallory, 1'000u) << "whom nothing makes speak again";
  EXPECT_EQ(calls.back().actor(), "mallory");
  calls.pop_back();
  EXPECT_EQ(calls[0].robot(), "r1");
  EXPECT_EQ(calls[0].outcome(), "admitted");
  EXPECT_EQ(
      calls[0].text(),
      "robot: \"r1\" reason: \"why\" expected_decision_id { term: 3 } request_id: 8f000a22ff");
  EXPECT_THAT(calls[1].outcome(), HasSubstr("role"));
  EXPECT_EQ(calls[calls.size() - 2].actor(), "dave");
  EXPECT_EQ(calls[calls.size() - 2].text().size(), 512u);
  EXPECT_THAT(calls[calls.size() - 2].text(), testing::StartsWith("robot: \"r1\" reason: \"xxx"));
  EXPECT_EQ(calls.back().actor(), "eve");
  EXPECT_EQ(calls.back().text(), "");
}

TEST(OrderAuditTest, WhatIsLeftOutIsRecordedThoughNothingMoreComes) {
  std::string directory = (std::filesystem::temp_directory_path() / "audit-XXXXXX").string();
  ASSERT_NE(mkdtemp(directory.data()), nullptr);
  FakeClock clock;
  std::vector<uint64_t> counts;
  {
    const auto log = *AuditLog::Open({.directory = directory}, &clock);
    OrderAudit audit(log.get(), &clock);
    v1::LevelRequest request;
    const auto refuse = [&](const char* who, int times) {
      for (int i = 0; i < times; ++i) {
        audit.Record({who, "ipv4:2", "Ban", request, absl::PermissionDeniedError("role")});
      }
    };
    refuse("mallory", 60);
    clock.Advance(29 * kSecond);
    audit.RecordLeftOut(30 * kSecond);
    refuse("eve", 52);
    clock.Advance(kSecond);
    audit.RecordLeftOut(30 * kSecond);
    refuse("mallory", 3);
    audit.RecordLeftOut(0);
    audit.RecordLeftOut(0);
  }
  const auto report =
      Verify(SegmentsInDirectory(directory), {}, [&](uint64_t, absl::string_view payload) {
        v1::AuditRecord record;
        record.ParseFromString(std::string(payload));
        if (record.action() == "Ban" && record.count() != 1) counts.push_back(record.count());
      });
  std::filesystem::remove_all(directory);
  ASSERT_TRUE(report.ok() && !report->fault);
  EXPECT_THAT(counts, testing::ElementsAre(10, 2, 3));
}

}  // namespace
}  // namespace rips::audit

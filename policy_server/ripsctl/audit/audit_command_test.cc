#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/audit/log_samples.h"
#include "policy_server/ripsctl/offline_run.h"

namespace rips::ripsctl {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::StartsWith;

class AuditCommandTest : public testing::Test {
 protected:
  AuditCommandTest() {
    for (const auto& [name, bytes] : log_.segments.files) directory_.Write(name, bytes);
  }
  Result Audit(const std::string& verb, const std::vector<std::string>& more = {}) {
    std::vector<std::string> args = {"audit", verb, directory_.path()};
    args.insert(args.end(), more.begin(), more.end());
    return RunOffline(args);
  }

  audit::SampleLog log_ = audit::TwoSegments();
  TestDirectory directory_;
};

TEST_F(AuditCommandTest, AWholeLogIsSaidToBeWholeWithItsHead) {
  const Result result = Audit("verify", {"--head", audit::FormatHead(log_.head)});
  EXPECT_EQ(result.code, 0) << result.err;
  EXPECT_THAT(result.out, AllOf(StartsWith("The log is whole: 5 records in 2 segments."),
                                HasSubstr(audit::FormatHead(log_.head))));
}

TEST_F(AuditCommandTest, AFaultIsNamedWithItsPlace) {
  std::string bytes = log_.file(2);
  bytes[audit::kHeaderBytes + 60] ^= 1;
  directory_.Write(audit::SegmentName(2), bytes);
  const Result result = Audit("verify");
  EXPECT_EQ(result.code, 1);
  EXPECT_EQ(result.err,
            "error: the log is altered: 00000002.audit, byte 208: altered bytes\n"
            "       record 4 is the first in doubt; 3 before it are proven by a seal\n");
  EXPECT_THAT(Audit("verify", {"--output", "json"}).out,
              HasSubstr(R"("fault":{"kind":"altered","file":"00000002.audit","offset":208)"));
  EXPECT_EQ(Audit("export").code, 1);
}

TEST_F(AuditCommandTest, AnOlderLogIsRolledBack) {
  directory_.Write(audit::SegmentName(2),
                   log_.file(2).substr(0, audit::PieceStarts(log_.file(2))[2]));
  EXPECT_EQ(Audit("verify").code, 0);
  const Result result = Audit("verify", {"--head", audit::FormatHead(log_.head)});
  EXPECT_EQ(result.code, 1);
  EXPECT_THAT(result.err, HasSubstr("rolled back: the log ends with record 4 and had 5 once"));
}

TEST_F(AuditCommandTest, TailAndExportReadRecords) {
  EXPECT_THAT(Audit("tail", {"--limit", "2"}).out, HasSubstr("RECORD"));
  const Result result = Audit("export");
  EXPECT_EQ(result.code, 0);
  EXPECT_THAT(result.out, StartsWith(R"({"sequence":1,)"));
  EXPECT_EQ(Audit("export", {"--output", "json"}).out, result.out);
  EXPECT_THAT(Audit("tail", {"--output", "json"}).out, HasSubstr(R"("log":{"whole":true,)"));
}

TEST_F(AuditCommandTest, WhatIsNoLogIsAUsageError) {
  EXPECT_EQ(RunOffline({"audit", "verify", "/nonexistent"}).code, 2);
  const TestDirectory empty;
  const Result result = RunOffline({"audit", "verify", empty.path()});
  EXPECT_EQ(result.code, 2);
  EXPECT_THAT(result.err, HasSubstr("holds no audit log"));
  EXPECT_EQ(Audit("verify", {"--head", "12"}).code, 2);
}

}  // namespace
}  // namespace rips::ripsctl

#include "policy_server/policy/inspect/scanner_process.h"

#include <signal.h>
#include <unistd.h>

#include <fstream>
#include <string>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"
#include "services/runtime/real_clock.h"

namespace rips::inspect {
namespace {

using engine::Verdict;

constexpr char kAttack[] = "rule r { strings: $a = \"attack\" condition: $a }";
// Passes the load check, and takes minutes on what Stuck() gives.
constexpr char kTrap[] = "rule r { strings: $a = /abcd(.{0,50}efgh){1,20}zzzz/s condition: $a }";

std::string Stuck() {
  std::string payload;
  for (int i = 0; i < 4000; ++i) payload += "abcdefgh";
  return payload;
}

class ScannerProcessTest : public ::testing::Test {
 protected:
  ScannerProcessTest() {
    options_.payload_bytes_max = size_t{4} << 20;
    options_.scan_time = absl::Seconds(60);
    options_.restart = {.first = absl::Hours(1), .longest = absl::Hours(1)};
  }
  std::unique_ptr<ScannerProcess> Make(const std::vector<std::string>& texts) {
    std::vector<std::shared_ptr<const YaraRules>> files;
    for (const std::string& text : texts) {
      auto rules = YaraRules::Create(text, "x.yar");
      EXPECT_THAT(rules, IsOk());
      files.push_back(*std::move(rules));
    }
    auto image = RuleImage::Create(files);
    EXPECT_THAT(image, IsOk());
    return std::make_unique<ScannerProcess>(*image, options_, &clock_);
  }

  RealClock clock_;
  ScannerOptions options_;
};

TEST_F(ScannerProcessTest, AsksTheFileByItsPlace) {
  const auto scanner = Make({kAttack, "rule r { condition: filesize < 3 }"});
  EXPECT_EQ(scanner->Scan(0, "r1", "an attack"), Verdict::kYes);
  EXPECT_EQ(scanner->Scan(0, "r1", "calm"), Verdict::kNo);
  EXPECT_EQ(scanner->Scan(1, "r1", "xx"), Verdict::kYes);
  EXPECT_EQ(scanner->Scan(1, "r1", "xxx"), Verdict::kNo);
  EXPECT_EQ(scanner->Scan(1, "r1", ""), Verdict::kYes) << "nothing of the last payload is seen";
  EXPECT_EQ(scanner->starts(), 1u);
}

TEST_F(ScannerProcessTest, SeesAllOfALargePayload) {
  const auto scanner = Make({kAttack});
  const std::string large(options_.payload_bytes_max - 6, 'x');
  EXPECT_EQ(scanner->Scan(0, "r1", large), Verdict::kNo);
  EXPECT_EQ(scanner->Scan(0, "r1", large + "attack"), Verdict::kYes);
  EXPECT_EQ(scanner->Scan(0, "r1", large + "attack!"), Verdict::kUnscanned) << "over the limit";
}

TEST_F(ScannerProcessTest, AStuckScanIsKilledAndCostsItsRobotOnly) {
  options_.scan_time = absl::Milliseconds(100);
  const auto scanner = Make({kTrap, kAttack});
  ASSERT_THAT(scanner->Start(), IsOk());
  const pid_t first = scanner->pid();

  EXPECT_EQ(scanner->Scan(0, "evil", Stuck()), Verdict::kUnscanned);

  EXPECT_EQ(scanner->failures(), 1u) << "libyara did not stop by itself";
  EXPECT_NE(kill(first, 0), 0);
  EXPECT_EQ(scanner->Scan(1, "evil", "attack"), Verdict::kUnscanned) << "it waits";
  EXPECT_EQ(scanner->starts(), 1u);
  options_.scan_time = absl::Seconds(60);
  EXPECT_EQ(scanner->Scan(1, "good", "attack"), Verdict::kYes);
  EXPECT_EQ(scanner->starts(), 2u);
  EXPECT_GT(scanner->TakeStartNs(), 0);
  EXPECT_EQ(scanner->TakeStartNs(), 0);
}

TEST_F(ScannerProcessTest, ADeadScannerIsReplaced) {
  const auto scanner = Make({kAttack});
  ASSERT_THAT(scanner->Start(), IsOk());
  kill(scanner->pid(), SIGKILL);
  // Whether it is dead yet is a matter of luck; another robot is not to blame.
  scanner->Scan(0, "r1", "attack");
  EXPECT_EQ(scanner->Scan(0, "r2", "attack"), Verdict::kYes);
  EXPECT_EQ(scanner->starts(), 2u);
}

TEST_F(ScannerProcessTest, OneThatDoesNotComeUpMakesAllWait) {
  options_.contain.helpers = "/no/such";
  const auto scanner = Make({kAttack});
  EXPECT_EQ(scanner->Scan(0, "r1", "attack"), Verdict::kUnscanned);
  EXPECT_EQ(scanner->Scan(0, "r2", "attack"), Verdict::kUnscanned);
  EXPECT_EQ(scanner->starts(), 1u);
}

TEST_F(ScannerProcessTest, ItCanDoNothingButScan) {
  const bool as_another = RootMayActForOthers();
  if (as_another) options_.contain.ids = JailIds{.uid = 54'322, .gid = 54'322};
  const auto scanner = Make({kAttack});
  ASSERT_THAT(scanner->Start(), IsOk());
  std::ifstream file(absl::StrCat("/proc/", scanner->pid(), "/status"));
  const std::string status(std::istreambuf_iterator<char>(file), {});
  EXPECT_THAT(status, ::testing::AllOf(::testing::HasSubstr("Seccomp:\t2"),
                                       ::testing::HasSubstr("NoNewPrivs:\t1"),
                                       ::testing::HasSubstr("CapPrm:\t0000000000000000")));
  if (geteuid() == 0) {  // others cannot drop it
    EXPECT_THAT(status, ::testing::HasSubstr("CapBnd:\t0000000000000000"));
  }
  if (as_another) {
    EXPECT_THAT(status, ::testing::AllOf(::testing::HasSubstr("Uid:\t54322\t54322\t54322\t54322"),
                                         ::testing::HasSubstr("Groups:\t \n")));
  }
}

}  // namespace
}  // namespace rips::inspect

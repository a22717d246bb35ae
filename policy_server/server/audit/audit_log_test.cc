#include "policy_server/server/audit/audit_log.h"

#include <atomic>
#include <filesystem>
#include <thread>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/audit/segments.h"
#include "services/base/fake_clock.h"
#include "services/runtime/await.h"

namespace rips::audit {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::SizeIs;

v1::AuditRecord Text(std::string text) {
  v1::AuditRecord record;
  record.set_kind(v1::AuditRecord::KIND_CALL);
  record.set_text(std::move(text));
  return record;
}

class AuditLogTest : public testing::Test {
 protected:
  AuditLogTest() {
    std::string name = (fs::temp_directory_path() / "audit-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    root_ = name;
    options_.directory = name + "/audit";
  }
  ~AuditLogTest() override { fs::remove_all(root_); }

  std::unique_ptr<AuditLog> Open() {
    auto log = AuditLog::Open(options_, &clock_);
    EXPECT_TRUE(log.ok()) << log.status();
    return *std::move(log);
  }
  // Of all records.
  std::vector<std::string> Texts() {
    std::vector<std::string> texts;
    const auto report = Verify(SegmentsInDirectory(options_.directory), {},
                               [&](uint64_t, absl::string_view payload) {
                                 v1::AuditRecord record;
                                 EXPECT_TRUE(record.ParseFromString(std::string(payload)));
                                 texts.push_back(record.text());
                               });
    EXPECT_TRUE(report.ok() && !report->fault);
    return texts;
  }
  // No file can be made or opened any more: each attempt needs a new segment.
  void Break() { fs::rename(options_.directory, options_.directory + ".away"); }
  void Mend() { fs::rename(options_.directory + ".away", options_.directory); }

  FakeClock clock_;
  fs::path root_;
  AuditOptions options_;
};

TEST_F(AuditLogTest, RecordsOfManyThreadsAreAllThere) {
  {
    const auto log = Open();
    std::vector<std::thread> threads;
    for (int thread = 0; thread < 4; ++thread) {
      threads.emplace_back([&, thread] {
        for (int i = 0; i < 25; ++i) {
          EXPECT_TRUE(log->Commit({Text(absl::StrCat("c", thread, ".", i))}).ok());
          log->Add(Text(absl::StrCat("a", thread, ".", i)));
        }
      });
    }
    for (std::thread& thread : threads) thread.join();
  }
  EXPECT_THAT(Texts(), SizeIs(1 + 200));
}

TEST_F(AuditLogTest, WhatIsAddedIsWrittenWithoutACommit) {
  const auto log = Open();
  const uint64_t before = log->head().sequence;
  log->Add(Text("one"));
  while (log->head().sequence == before) absl::SleepFor(absl::Milliseconds(1));
  EXPECT_THAT(Texts(), ElementsAre("the log was begun", "one"));
}

TEST_F(AuditLogTest, AStartIsOnRecord) {
  Open();
  Open();
  EXPECT_THAT(Texts(), ElementsAre("the log was begun", "the log was opened by a server's start"));
}

TEST_F(AuditLogTest, HostileTextIsCutAndMadeUtf8) {
  Open()->Add(Text(absl::StrCat("\xff\x01", std::string(100'000, 'x'))));
  const std::vector<std::string> texts = Texts();
  ASSERT_THAT(texts, SizeIs(2));
  EXPECT_THAT(texts[1], AllOf(HasSubstr("\\xff"), SizeIs(testing::Le(4'096u))));
}

TEST_F(AuditLogTest, AnOutageIsOnRecordWithWhatWasLost) {
  options_.segment_bytes = 1;
  options_.waiting_max = 3;
  std::atomic<int> failures = 0;
  options_.on_failure = [&] { ++failures; };
  const auto log = Open();
  Break();
  EXPECT_FALSE(log->Commit({Text("refused")}).ok());
  EXPECT_FALSE(log->health().ok());
  log->Add(Text("added 0"));
  while (failures < 2) absl::SleepFor(absl::Milliseconds(1));
  // The next attempt by itself comes a second later, whatever is added.
  for (int i = 1; i < 5; ++i) log->Add(Text(absl::StrCat("added ", i)));
  clock_.Advance(3 * kNanosPerSecond);
  Mend();
  ASSERT_TRUE(log->Commit({}).ok());
  EXPECT_TRUE(log->health().ok());
  const std::vector<std::string> texts = Texts();
  ASSERT_THAT(texts, SizeIs(5));
  EXPECT_THAT(texts[1],
              AllOf(HasSubstr("could not be written for 3 s"), HasSubstr("2 records are lost")));
  EXPECT_EQ(texts[4], "added 4");
}

}  // namespace
}  // namespace rips::audit

#include "policy_server/server/audit/store_audit.h"

#include <filesystem>
#include <future>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/fake_clock.h"

namespace rips::audit {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;
using testing::IsEmpty;
using testing::SizeIs;
using v1::AuditRecord;

store::WriteBatch Decides(uint64_t epoch, const std::string& to) {
  store::WriteBatch batch{.robot = "r1", .tenure = 1};
  batch.decisions.push_back({.id = "0123456789abcdef0123456789abcde" + std::to_string(epoch % 10),
                             .decision_id = {.term = 1, .epoch = epoch},
                             .from = "DEFAULT",
                             .to = to,
                             .cause = "rule stranger",
                             .reason = "why",
                             .time_unix_ns = 5});
  return batch;
}

TEST(RecordsOfTest, WhatAnAuditorNeedsAndNoMore) {
  store::WriteBatch batch = Decides(3, "ALERT");
  batch.refusals = {{.id = "r", .count = 3}, {.id = "s", .count = 4}};
  batch.alerts = {{.id = "a", .robot = "r1", .rule = "stranger"},
                  {.id = "b", .robot = "r1", .rule = "(rips)", .text = "banned"}};
  batch.stages = {{}};
  batch.acks = {{.alert_id = "a", .ack = {.by = "alice", .note = "on it"}, .rule = "intruder"}};
  batch.checkpoint = {.variables = store::Variables(), .rules_halted = true, .bundle = "sha256:12"};
  std::vector<std::string> lines;
  for (const AuditRecord& record : RecordsOf({&batch, 1})) {
    lines.push_back(AuditRecord::Kind_Name(record.kind()) + " " + record.id() + " " +
                    record.text());
  }
  EXPECT_THAT(lines, ElementsAre("KIND_DECISION 0123456789abcdef0123456789abcde3 why",
                                 "KIND_REFUSAL s ", "KIND_ALERT b banned", "KIND_ACK a on it",
                                 "KIND_POLICY  runs bundle sha256:12",
                                 "KIND_POLICY  a rule called crash: no rule runs"));
}

class StoreAuditTest : public testing::Test {
 protected:
  StoreAuditTest() {
    std::string name = (fs::temp_directory_path() / "audit-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    root_ = name;
    // Each commit begins a segment, so that it notices when the directory is gone.
    options_ = {.directory = name + "/audit", .segment_bytes = 1};
    log_ = *AuditLog::Open(options_, &clock_);
    EXPECT_TRUE(store_.Acquire("r1").ok());
    audit_ = std::make_unique<StoreAudit>(log_.get());
    committer_ = std::make_unique<store::Committer>(
        &store_,
        store::CommitterOptions{.before_commit =
                                    [this](std::span<const store::WriteBatch> batches) {
                                      return audit_->RecordBefore(batches);
                                    }},
        &clock_);
  }
  ~StoreAuditTest() override {
    committer_->Stop();
    fs::remove_all(root_);
  }

  absl::Status Commit(store::WriteBatch batch) {
    std::promise<absl::Status> done;
    EXPECT_TRUE(
        committer_
            ->Submit(std::move(batch), [&](const absl::Status& status) { done.set_value(status); })
            .ok());
    return done.get_future().get();
  }
  void Break() { fs::rename(options_.directory, options_.directory + ".away"); }
  void Mend() { fs::rename(options_.directory + ".away", options_.directory); }
  size_t Stored() { return store_.ListTransitions("r1", 0)->size(); }

  FakeClock clock_;
  fs::path root_;
  AuditOptions options_;
  std::unique_ptr<AuditLog> log_;
  std::unique_ptr<StoreAudit> audit_;
  store::FakeStore store_;
  std::unique_ptr<store::Committer> committer_;
};

TEST_F(StoreAuditTest, ADecisionIsInTheLogBeforeItIsInTheStore) {
  const uint64_t before = log_->head().sequence;
  uint64_t at_commit = 0;
  store_.OnCommit([&] { at_commit = log_->head().sequence; });
  ASSERT_TRUE(Commit(Decides(1, "ALERT")).ok());
  EXPECT_EQ(at_commit, before + 1);
  store::WriteBatch variables{
      .robot = "r1", .tenure = 1, .checkpoint = {.variables = store::Variables()}};
  ASSERT_TRUE(Commit(std::move(variables)).ok());
  EXPECT_EQ(log_->head().sequence, before + 1);
}

TEST_F(StoreAuditTest, ABatchThatTheStoreCouldNotWriteIsInTheLogOnce) {
  const uint64_t before = log_->head().sequence;
  store_.FailWrites(absl::UnavailableError("disk"));
  store::WriteBatch batch = Decides(1, "ALERT");
  batch.alerts.push_back({.id = "a", .robot = "r1", .rule = "(rips)"});
  for (int i = 0; i < 3; ++i) EXPECT_FALSE(Commit(batch).ok());
  store_.FailWrites(absl::OkStatus());
  batch.alerts.push_back({.id = "b", .robot = "r1", .rule = "(rips)"});
  EXPECT_TRUE(Commit(batch).ok());
  EXPECT_EQ(log_->head().sequence, before + 3) << "a decision and two alerts";
}

TEST_F(StoreAuditTest, AnAlertAndItsAcknowledgementsAreRecordsOfTheirOwn) {
  const uint64_t before = log_->head().sequence;
  ASSERT_TRUE(
      Commit({.robot = "r1", .alerts = {{.id = "a", .robot = "r1", .rule = "(rips)"}}}).ok());
  for (const char* by : {"alice", "bob", "alice"}) {
    ASSERT_TRUE(Commit({.robot = "(server)",
                        .acks = {{.alert_id = "a", .ack = {.by = by, .time_unix_ns = 1}}}})
                    .ok());
  }
  EXPECT_EQ(log_->head().sequence, before + 3) << "the alert, and one of each operator";
}

TEST_F(StoreAuditTest, APolicyIsRecordedWhenItChanges) {
  const auto commit = [&](bool halted, bool suspended) {
    return Commit({.robot = "r1",
                   .tenure = 1,
                   .checkpoint = {.soft_suspended = suspended, .rules_halted = halted}});
  };
  const uint64_t before = log_->head().sequence;
  ASSERT_TRUE(commit(false, false).ok());
  EXPECT_EQ(log_->head().sequence, before + 2);
  ASSERT_TRUE(commit(false, false).ok());
  EXPECT_EQ(log_->head().sequence, before + 2);
  ASSERT_TRUE(commit(false, true).ok());
  EXPECT_EQ(log_->head().sequence, before + 3);
  ASSERT_TRUE(commit(false, false).ok());
  EXPECT_EQ(log_->head().sequence, before + 4);
}

TEST_F(StoreAuditTest, WithoutTheLogALoweringIsNotStoredAndARaiseIs) {
  Break();
  EXPECT_EQ(Commit(Decides(1, "DEFAULT")).code(), absl::StatusCode::kResourceExhausted);
  EXPECT_FALSE(committer_->healthy());
  EXPECT_EQ(Stored(), 0u);
  store::WriteBatch raise = Decides(2, "ALERT");
  raise.uses_reserve = true;
  EXPECT_TRUE(Commit(raise).ok());
  EXPECT_EQ(Stored(), 1u);
  // Nothing else is stored, so that the outage is told and not forgotten between two decisions.
  store::WriteBatch variables{
      .robot = "r1", .tenure = 1, .checkpoint = {.variables = store::Variables()}};
  EXPECT_FALSE(Commit(variables).ok());
  Mend();
  const uint64_t before = log_->head().sequence;
  EXPECT_TRUE(Commit(variables).ok());
  EXPECT_TRUE(committer_->healthy());
  // The gap and the raise.
  EXPECT_EQ(log_->head().sequence, before + 2);
}

}  // namespace
}  // namespace rips::audit

// What AckStore promises, tried on every implementation.
#include "policy_server/server/store/ack_store.h"

#include <memory>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/fake_store.h"
#include "policy_server/server/store/sqlite_store.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/status_matchers.h"

namespace rips::store {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

const Ack kAlices{.by = "spiffe://td/operator/operator/alice serial 0a",
                  .note = std::string("\x1b[2J\xff\0", 6),
                  .time_unix_ns = 7};
const Ack kBobs{.by = "spiffe://td/operator/operator/bob serial 0b", .time_unix_ns = 8};

class AckStoreTest : public testing::TestWithParam<bool> {
 protected:
  void SetUp() override {
    if (GetParam()) {
      auto opened = SqliteStore::Open(dir_.File("state.db"));
      ASSERT_THAT(opened, IsOk());
      acks_ = opened->get();
      store_ = *std::move(opened);
    } else {
      auto fake = std::make_unique<FakeStore>();
      acks_ = fake.get();
      store_ = std::move(fake);
    }
    for (const char* robot : {"r1", "r2", "r1"}) {
      const AlertRecord alert = MakeAlert(robot, "seen");
      ids_.push_back(alert.id);
      ASSERT_THAT(store_->Commit({.robot = robot, .alerts = {alert}}), IsOk());
    }
  }
  std::vector<std::string> Found(const AlertQuery& query) {
    const auto listed = acks_->SearchAlerts(query);
    EXPECT_THAT(listed, IsOk());
    std::vector<std::string> ids;
    if (!listed.ok()) return ids;
    EXPECT_FALSE(listed->older_not_searched);
    for (const AlertRecord& alert : listed->alerts) ids.push_back(alert.id);
    return ids;
  }
  absl::Status Acknowledge(const std::vector<std::string>& ids, const Ack& ack) {
    WriteBatch batch{.robot = std::string(kServerRobot)};
    for (const std::string& id : ids) batch.acks.push_back({.alert_id = id, .ack = ack});
    return store_->Commit(batch);
  }

  TempDir dir_;
  std::unique_ptr<Store> store_;
  AckStore* acks_ = nullptr;
  // Of r1, r2 and r1, in the order of writing.
  std::vector<std::string> ids_;
};

TEST_P(AckStoreTest, TheFirstAcknowledgementStays) {
  EXPECT_THAT(*acks_->FindAcks(ids_), IsEmpty());
  const AckRecord first{.alert_id = ids_[0], .ack = kAlices};
  ASSERT_THAT(Acknowledge({ids_[0]}, kAlices), IsOk());
  EXPECT_THAT(*acks_->FindAcks(ids_), ElementsAre(first));
  ASSERT_THAT(Acknowledge({ids_[1], ids_[0], ids_[1]}, kBobs), IsOk());
  EXPECT_THAT(*acks_->FindAcks(ids_),
              ElementsAre(first, AckRecord{.alert_id = ids_[1], .ack = kBobs}));
}

TEST_P(AckStoreTest, FindsWhatIsOpenOfOneRobotOrOfAll) {
  EXPECT_THAT(Found({.open = true}), ElementsAre(ids_[2], ids_[1], ids_[0]));
  ASSERT_THAT(Acknowledge({ids_[2]}, kAlices), IsOk());
  EXPECT_THAT(Found({.open = true}), ElementsAre(ids_[1], ids_[0]));
  EXPECT_THAT(Found({.limit = 1, .open = true}), ElementsAre(ids_[1]));
  EXPECT_THAT(Found({.robot = "r1", .open = true}), ElementsAre(ids_[0]));
  EXPECT_THAT(Found({.robot = "r1"}), ElementsAre(ids_[2], ids_[0]));
  EXPECT_THAT(Found({.robot = "unknown", .open = true}), IsEmpty());
  EXPECT_EQ(store_->ListAlerts("", 0)->size(), 3u);
  EXPECT_EQ(store_->ListAlerts("r1", 0)->front().text, "seen") << "nothing else changes";
}

TEST_P(AckStoreTest, FindsBySeverityRuleAndTime) {
  AlertRecord alert = MakeAlert("r2", "another");
  alert.severity = "low";
  alert.rule = "intruder's";
  alert.time_unix_ns = 100;
  ASSERT_THAT(store_->Commit({.robot = "r2", .alerts = {alert}}), IsOk());
  const std::vector<std::string> all = {alert.id, ids_[2], ids_[1], ids_[0]};
  EXPECT_EQ(Found({}), all);
  EXPECT_EQ(Found({.severities = {"low", "high"}, .since_unix_ns = 100}), all);
  EXPECT_THAT(Found({.severities = {"medium", "high"}}), ElementsAre(ids_[2], ids_[1], ids_[0]));
  EXPECT_THAT(Found({.severities = {"critical"}}), IsEmpty());
  EXPECT_THAT(Found({.limit = 1, .severities = {"high"}}), ElementsAre(ids_[2]));
  EXPECT_THAT(Found({.rule = "intruder's"}), ElementsAre(alert.id));
  EXPECT_THAT(Found({.rule = "intrude"}), IsEmpty());
  EXPECT_THAT(Found({.rule = "' OR 1 --"}), IsEmpty());
  EXPECT_THAT(Found({.since_unix_ns = 101}), ElementsAre(ids_[2], ids_[1], ids_[0]));
  ASSERT_THAT(Acknowledge({ids_[1]}, kAlices), IsOk());
  EXPECT_THAT(Found({.robot = "r2", .open = true, .severities = {"high"}}), IsEmpty());
  EXPECT_THAT(Found({.open = true, .rule = "intruder"}), ElementsAre(ids_[2], ids_[0]));
}

TEST_P(AckStoreTest, OneUnknownIdAndNothingIsAcknowledged) {
  const std::string unknown(32, '0');
  EXPECT_THAT(Acknowledge({ids_[0], unknown, ids_[1]}, kAlices),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr(unknown)));
  EXPECT_THAT(*acks_->FindAcks(ids_), IsEmpty());
}

TEST_P(AckStoreTest, ARefusedOneSpoilsNoOtherBatch) {
  const AlertRecord alert = MakeAlert("r1", "beside it");
  WriteBatch refused{.robot = "r1",
                     .alerts = {MakeAlert("r1", "of the refused")},
                     .acks = {{.alert_id = std::string(32, '0'), .ack = kAlices}}};
  const std::vector<WriteBatch> batches = {
      {.robot = "r1", .alerts = {alert}},
      refused,
      {.robot = "r1", .acks = {{.alert_id = alert.id, .ack = kBobs}}}};
  const auto statuses = store_->CommitAll(batches);
  ASSERT_THAT(statuses, IsOk());
  EXPECT_THAT((*statuses)[0], IsOk());
  EXPECT_THAT((*statuses)[1], StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT((*statuses)[2], IsOk()) << "of an alert that is written with it";
  EXPECT_EQ(store_->ListAlerts("r1", 1)->front().id, alert.id);
}

TEST_P(AckStoreTest, RefusesWhatSaysTooLittleOrTooMuch) {
  using absl::StatusCode;
  Ack ack = kAlices;
  ack.note = std::string(kAckNoteBytesMax + 1, 'x');
  EXPECT_THAT(Acknowledge(ids_, ack),
              StatusIs(StatusCode::kInvalidArgument, HasSubstr("1001 bytes")));
  EXPECT_THAT(Acknowledge(ids_, {.by = "", .time_unix_ns = 1}),
              StatusIs(StatusCode::kInvalidArgument));
  EXPECT_THAT(Acknowledge(ids_, {.by = "alice", .time_unix_ns = 0}),
              StatusIs(StatusCode::kInvalidArgument));
  EXPECT_THAT(Acknowledge({""}, kAlices), StatusIs(StatusCode::kInvalidArgument));
  EXPECT_THAT(
      store_->Commit(
          {.robot = "r1", .acks = {{.alert_id = ids_[0], .ack = kAlices}}, .uses_reserve = true}),
      StatusIs(StatusCode::kInvalidArgument));
  EXPECT_THAT(*acks_->FindAcks(ids_), IsEmpty());
  ack.note.pop_back();
  EXPECT_THAT(Acknowledge(ids_, ack), IsOk());
}

INSTANTIATE_TEST_SUITE_P(Stores, AckStoreTest, testing::Bool(),
                         [](const auto& kind) { return kind.param ? "Sqlite" : "Fake"; });

TEST(SqliteAcksTest, LastAsLongAsTheirAlerts) {
  const TempDir dir;
  const AlertRecord oldest = MakeAlert("r1", "oldest");
  const std::vector<std::string> ids = {oldest.id};
  const auto acknowledge = [&](Store& store, const Ack& ack) {
    return store.Commit({.robot = "r1", .acks = {{.alert_id = oldest.id, .ack = ack}}});
  };
  const SqliteLimits limits{.alerts_per_robot_max = 2};
  const auto add = [](Store& store, const AlertRecord& alert) {
    EXPECT_THAT(store.Commit({.robot = "r1", .alerts = {alert}}), IsOk());
  };
  {
    auto store = SqliteStore::Open(dir.File("state.db"), limits);
    ASSERT_THAT(store, IsOk());
    add(**store, oldest);
    ASSERT_THAT(acknowledge(**store, kAlices), IsOk());
    add(**store, oldest);
  }
  auto store = SqliteStore::Open(dir.File("state.db"), limits);
  ASSERT_THAT(store, IsOk());
  EXPECT_THAT(*(*store)->FindAcks(ids),
              ElementsAre(AckRecord{.alert_id = oldest.id, .ack = kAlices}))
      << "after a restart, and after the alert was written again";
  for (int i = 0; i < 4; ++i) add(**store, MakeAlert("r1", "newer"));
  EXPECT_THAT(*(*store)->FindAcks(ids), IsEmpty());
  EXPECT_THAT(acknowledge(**store, kBobs), StatusIs(absl::StatusCode::kNotFound));
}

TEST(SqliteAcksTest, ASearchHasABound) {
  const TempDir dir;
  auto store = SqliteStore::Open(dir.File("state.db"), {.alerts_per_robot_max = 100'000});
  ASSERT_THAT(store, IsOk());
  WriteBatch batch{.robot = "r1"};
  for (int64_t i = 0; i <= kAlertsSearchedMax; ++i) batch.alerts.push_back(MakeAlert("r1", "x"));
  for (AlertRecord& alert : batch.alerts) alert.severity = "low";
  batch.alerts[0].severity = "critical";
  batch.alerts[0].rule = "oldest";
  batch.alerts[1].rule = "second";
  ASSERT_THAT((*store)->Commit(batch), IsOk());
  for (const char* robot : {"", "r1"}) {
    const auto oldest = (*store)->SearchAlerts({.robot = robot, .rule = "oldest"});
    ASSERT_THAT(oldest, IsOk());
    EXPECT_THAT(oldest->alerts, IsEmpty());
    EXPECT_TRUE(oldest->older_not_searched);
    const auto second = (*store)->SearchAlerts({.robot = robot, .limit = 1, .rule = "second"});
    ASSERT_THAT(second, IsOk());
    EXPECT_EQ(second->alerts.size(), 1u);
    EXPECT_FALSE(second->older_not_searched) << "as many as were wanted";
  }
  // What is acknowledged does not count.
  ASSERT_THAT(
      (*store)->Commit({.robot = "r1", .acks = {{.alert_id = batch.alerts[5].id, .ack = kBobs}}}),
      IsOk());
  EXPECT_EQ((*store)->SearchAlerts({.open = true, .rule = "oldest"})->alerts.size(), 1u);
  for (const bool open : {false, true}) {
    const auto grave = (*store)->SearchAlerts({.open = open, .severities = {"critical"}});
    EXPECT_EQ(grave->alerts.size(), 1u) << "however many of less severity came later";
    EXPECT_FALSE(grave->older_not_searched);
  }
  EXPECT_EQ((*store)->SearchAlerts({.limit = 1'000, .open = true})->alerts.size(), 1'000u);
}

}  // namespace
}  // namespace rips::store

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
  // Ids of the alerts that are open.
  std::vector<std::string> Open(const std::string& robot, uint32_t limit = 0) {
    const auto listed = acks_->ListOpenAlerts(robot, limit);
    EXPECT_THAT(listed, IsOk());
    std::vector<std::string> ids;
    for (const AlertRecord& alert : *listed) ids.push_back(alert.id);
    return ids;
  }

  absl::StatusOr<std::vector<AckRecord>> Acknowledge(const std::vector<std::string>& ids,
                                                     const Ack& ack) {
    return acks_->Acknowledge(ids, ack);
  }

  TempDir dir_;
  std::unique_ptr<Store> store_;
  AckStore* acks_ = nullptr;
  // Of r1, r2 and r1, in the order of writing.
  std::vector<std::string> ids_;
};

TEST_P(AckStoreTest, TheFirstAcknowledgementStays) {
  EXPECT_THAT(*acks_->FindAcks(ids_), IsEmpty());
  EXPECT_THAT(Open(""), ElementsAre(ids_[2], ids_[1], ids_[0]));
  const AckRecord first{.alert_id = ids_[0], .ack = kAlices};
  EXPECT_THAT(Acknowledge({ids_[0]}, kAlices), IsOkAndHolds(std::vector{first}));

  const auto second = Acknowledge({ids_[1], ids_[0], ids_[1]}, kBobs);
  ASSERT_THAT(second, IsOk());
  EXPECT_THAT(*second, ElementsAre(AckRecord{.alert_id = ids_[1], .ack = kBobs},
                                   AckRecord{.alert_id = ids_[0], .ack = kAlices, .already = true},
                                   AckRecord{.alert_id = ids_[1], .ack = kBobs, .already = true}));
  EXPECT_THAT(*acks_->FindAcks(ids_),
              ElementsAre(first, AckRecord{.alert_id = ids_[1], .ack = kBobs}));
}

TEST_P(AckStoreTest, ListsWhatIsOpenOfOneRobotOrOfAll) {
  ASSERT_THAT(Acknowledge({ids_[2]}, kAlices), IsOk());
  EXPECT_THAT(Open(""), ElementsAre(ids_[1], ids_[0]));
  EXPECT_THAT(Open("", 1), ElementsAre(ids_[1]));
  EXPECT_THAT(Open("r1"), ElementsAre(ids_[0]));
  EXPECT_THAT(Open("unknown"), IsEmpty());
  EXPECT_EQ(store_->ListAlerts("", 0)->size(), 3u);
  EXPECT_EQ(store_->ListAlerts("r1", 0)->front().text, "seen") << "nothing else changes";
}

TEST_P(AckStoreTest, OneUnknownIdAndNothingIsAcknowledged) {
  const std::string unknown(32, '0');
  EXPECT_THAT(Acknowledge({ids_[0], unknown, ids_[1]}, kAlices),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr(unknown)));
  EXPECT_THAT(*acks_->FindAcks(ids_), IsEmpty());
  EXPECT_THAT(*Acknowledge({}, kAlices), IsEmpty());
}

TEST_P(AckStoreTest, RefusesWhatSaysTooLittleOrTooMuch) {
  Ack ack = kAlices;
  ack.note = std::string(kAckNoteBytesMax + 1, 'x');
  EXPECT_THAT(acks_->Acknowledge(ids_, ack),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("1001 bytes")));
  EXPECT_THAT(acks_->Acknowledge(ids_, {.by = "", .time_unix_ns = 1}),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(acks_->Acknowledge(ids_, {.by = "alice", .time_unix_ns = 0}),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(*acks_->FindAcks(ids_), IsEmpty());
  ack.note.pop_back();
  EXPECT_THAT(acks_->Acknowledge(ids_, ack), IsOk());
}

INSTANTIATE_TEST_SUITE_P(Stores, AckStoreTest, testing::Bool(),
                         [](const auto& kind) { return kind.param ? "Sqlite" : "Fake"; });

TEST(SqliteAcksTest, LastAsLongAsTheirAlerts) {
  const TempDir dir;
  const AlertRecord oldest = MakeAlert("r1", "oldest");
  const std::vector<std::string> ids = {oldest.id};
  const SqliteLimits limits{.alerts_per_robot_max = 2};
  const auto add = [](Store& store, const AlertRecord& alert) {
    EXPECT_THAT(store.Commit({.robot = "r1", .alerts = {alert}}), IsOk());
  };
  {
    auto store = SqliteStore::Open(dir.File("state.db"), limits);
    ASSERT_THAT(store, IsOk());
    add(**store, oldest);
    ASSERT_THAT((*store)->Acknowledge(ids, kAlices), IsOk());
    add(**store, oldest);
  }
  auto store = SqliteStore::Open(dir.File("state.db"), limits);
  ASSERT_THAT(store, IsOk());
  EXPECT_THAT(*(*store)->FindAcks(ids),
              ElementsAre(AckRecord{.alert_id = oldest.id, .ack = kAlices}))
      << "after a restart, and after the alert was written again";
  for (int i = 0; i < 4; ++i) add(**store, MakeAlert("r1", "newer"));
  EXPECT_THAT(*(*store)->FindAcks(ids), IsEmpty());
  EXPECT_THAT((*store)->Acknowledge(ids, kBobs), StatusIs(absl::StatusCode::kNotFound));
}

}  // namespace
}  // namespace rips::store

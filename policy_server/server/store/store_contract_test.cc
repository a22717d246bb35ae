// What the port promises, tried on every implementation.
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/fake_store.h"
#include "policy_server/server/store/sqlite_store.h"
#include "policy_server/server/store/store.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/status_matchers.h"

namespace rips::store {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

enum class Kind { kFake, kSqlite };

class StoreContractTest : public testing::TestWithParam<Kind> {
 protected:
  void SetUp() override {
    if (GetParam() == Kind::kFake) {
      store_ = std::make_unique<FakeStore>();
    } else {
      auto opened = SqliteStore::Open(dir_.File("state.db"));
      ASSERT_THAT(opened, IsOk());
      store_ = *std::move(opened);
    }
    const std::vector<std::string> robots = {"r1", "r2", "r3"};
    ASSERT_THAT(store_->Acquire(robots), IsOk());
  }

  RobotRecord Load(absl::string_view robot) {
    absl::StatusOr<RobotRecord> record = store_->Load(robot);
    EXPECT_THAT(record, IsOk());
    return record.value_or(RobotRecord{});
  }
  // Empty if there is none.
  std::string Decision(absl::string_view robot, const DecisionId& decision_id) {
    const auto known = store_->FindDecision(robot, decision_id);
    EXPECT_THAT(known, IsOk());
    return known.ok() ? known->value_or("") : "";
  }
  std::vector<TransitionRecord> Transitions(absl::string_view robot, uint32_t limit = 0) {
    auto list = store_->ListTransitions(robot, limit);
    EXPECT_THAT(list, IsOk());
    return list.ok() ? *list : std::vector<TransitionRecord>();
  }
  std::vector<std::string> AlertTexts(absl::string_view robot, uint32_t limit = 0) {
    auto list = store_->ListAlerts(robot, limit);
    EXPECT_THAT(list, IsOk());
    std::vector<std::string> texts;
    if (list.ok()) {
      for (const AlertRecord& alert : *list) texts.push_back(alert.text);
    }
    return texts;
  }
  // `one` of r1, `two` of r2, `three` of r1.
  std::vector<WriteBatch> CommitThreeAlerts() {
    std::vector<WriteBatch> batches;
    for (const auto& [robot, text] : {std::pair("r1", "one"), {"r2", "two"}, {"r1", "three"}}) {
      batches.push_back({.robot = robot, .tenure = 1, .alerts = {MakeAlert(robot, text)}});
    }
    EXPECT_THAT(store_->CommitAll(batches), IsOk());
    return batches;
  }

  TempDir dir_;
  std::unique_ptr<Store> store_;
};

TEST_P(StoreContractTest, KeepsBansByIdentityAndSerial) {
  auto& bans = dynamic_cast<BanStore&>(*store_);
  const BanRecord all{.uri = "spiffe://td/robot/r1/sensor/base",
                      .reason = "stolen",
                      .by = "spiffe://td/operator/admin/alice serial 0a",
                      .time_unix_ns = 7};
  BanRecord one = all;
  one.serial = "0f";
  EXPECT_THAT(bans.PutBan(one), IsOk());
  EXPECT_THAT(bans.PutBan(all), IsOk());
  one.reason = "seen in the wild";
  EXPECT_THAT(bans.PutBan(one), IsOk());
  auto listed = bans.ListBans();
  ASSERT_THAT(listed, IsOk());
  EXPECT_THAT(*listed, ElementsAre(all, one));

  EXPECT_EQ(bans.RemoveBan(all.uri, "ff").value_or(true), false);
  EXPECT_EQ(bans.RemoveBan(all.uri, "").value_or(false), true);
  EXPECT_EQ(bans.RemoveBan(all.uri, "").value_or(true), false);
  listed = bans.ListBans();
  ASSERT_THAT(listed, IsOk());
  EXPECT_THAT(*listed, ElementsAre(one));
  EXPECT_THAT(bans.PutBan({.uri = ""}), StatusIs(absl::StatusCode::kInvalidArgument));
}

ReceiptRecord AReceipt(const std::string& command_id, model::Receipt::Stage stage) {
  return {.unix_ns = 5,
          .host = "base",
          .command = "level ALERT",
          .receipt = {.command_id = command_id,
                      .decision_id = {1, 2},
                      .stage = stage,
                      .steps = {{.step = "system_mode /safety=ALERT", .ok = true, .took_ms = 7}},
                      .exit_code = 3,
                      .output_tail = std::string("\xff\0\n", 3),
                      .detail = "as it was",
                      .effective_level = "ALERT"}};
}

TEST_P(StoreContractTest, KeepsTheNewestReceiptOfEachCommand) {
  using Stage = model::Receipt::Stage;
  const uint64_t tenure = store_->Acquire("r1")->tenure;
  const auto commit = [&](std::vector<ReceiptRecord> receipts) {
    EXPECT_THAT(store_->Commit({.robot = "r1", .tenure = tenure, .receipts = std::move(receipts)}),
                IsOk());
  };
  const std::string first = "0001";
  const std::string second = "02";
  commit({AReceipt(first, Stage::kAcknowledged), AReceipt(second, Stage::kFailed)});
  commit({AReceipt(first, Stage::kVerified)});
  EXPECT_THAT(*store_->ListReceipts("r1", 10),
              ElementsAre(AReceipt(first, Stage::kVerified), AReceipt(second, Stage::kFailed)));
  EXPECT_THAT(*store_->ListReceipts("r1", 1), ElementsAre(AReceipt(first, Stage::kVerified)));
  EXPECT_THAT(*store_->ListReceipts("r2", 10), IsEmpty());
  for (size_t i = 0; i < kReceiptsPerRobotMax; ++i) {
    commit({AReceipt(absl::StrCat(1000 + i), Stage::kRefused)});
  }
  const auto kept = *store_->ListReceipts("r1", 1'000);
  EXPECT_EQ(kept.size(), kReceiptsPerRobotMax);
  EXPECT_EQ(kept.back().receipt.command_id, "1000");
}

TEST_P(StoreContractTest, RefusesAReceiptThatNobodyCouldFind) {
  const uint64_t tenure = store_->Acquire("r1")->tenure;
  EXPECT_THAT(store_->Commit({.robot = "r1",
                              .tenure = tenure,
                              .receipts = {AReceipt("", model::Receipt::Stage::kFailed)}}),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(
      store_->Commit({.robot = "r1", .receipts = {AReceipt("x", model::Receipt::Stage::kFailed)}}),
      StatusIs(absl::StatusCode::kInvalidArgument))
      << "of no owner";
}

TEST_P(StoreContractTest, KnowsNothingOfAnUnknownRobot) {
  EXPECT_EQ(Load("r9"), RobotRecord{});
  EXPECT_EQ(Decision("r9", {1, 1}), "");
  EXPECT_EQ(Decision("r9", {}), "");
  EXPECT_THAT(Transitions("r9"), IsEmpty());
  EXPECT_THAT(AlertTexts(""), IsEmpty());
}

TEST_P(StoreContractTest, HandsOutEachTermOnce) {
  EXPECT_THAT(store_->NextTerm("r1", 1, 0), IsOkAndHolds(2u));
  EXPECT_THAT(store_->NextTerm("r2", 1, 0), IsOkAndHolds(2u));
  EXPECT_THAT(store_->NextTerm("r1", 1, 10), IsOkAndHolds(11u));
  EXPECT_THAT(store_->NextTerm("r1", 1, 5), IsOkAndHolds(12u));
  EXPECT_EQ(Load("r1").highest_term, 12u);
  EXPECT_EQ(store_->Acquire("r1")->tenure, 13u);
  EXPECT_THAT(store_->NextTerm("r1", 13, 0), IsOkAndHolds(14u));
}

TEST_P(StoreContractTest, TermsCannotBeUsedUp) {
  const uint64_t most = std::numeric_limits<uint64_t>::max();
  EXPECT_THAT(store_->NextTerm("r1", 1, most), IsOkAndHolds(kTermAboveMax + 1));
  EXPECT_THAT(store_->NextTerm("r1", 1, most), IsOkAndHolds(kTermAboveMax + 2));
  EXPECT_THAT(store_->Commit(Decide("r1", {kTermAboveMax + 2, 1}, "A", "B")), IsOk());
  EXPECT_EQ(Load("r1").highest_term, kTermAboveMax + 2);
  EXPECT_EQ(Decision("r1", {kTermAboveMax + 2, 1}), "B");
}

TEST_P(StoreContractTest, AcquiringShowsWhatIsStoredUnderATermAboveAll) {
  ASSERT_THAT(store_->Commit(Decide("r2", {7, 1}, "DEFAULT", "HALT")), IsOk());
  const std::vector<std::string> robots = {"r2", "new", "r1"};
  const auto acquired = store_->Acquire(robots);
  ASSERT_THAT(acquired, IsOk());
  ASSERT_THAT(*acquired, SizeIs(3));
  EXPECT_EQ((*acquired)[0].tenure, 8u);
  EXPECT_EQ((*acquired)[0].record, Load("r2"));
  EXPECT_EQ((*acquired)[0].record.level, "HALT");
  EXPECT_EQ((*acquired)[0].record.highest_term, 8u);
  EXPECT_EQ((*acquired)[1].tenure, 1u);
  EXPECT_EQ((*acquired)[1].record, (RobotRecord{.highest_term = 1}));
  EXPECT_EQ((*acquired)[2].tenure, 2u);
  EXPECT_THAT(store_->Acquire(std::vector<std::string>()), IsOkAndHolds(std::vector<Acquired>()));
}

TEST_P(StoreContractTest, AFormerOwnerWritesNothing) {
  ASSERT_THAT(store_->Commit(Decide("r1", {1, 1}, "DEFAULT", "HALT")), IsOk());
  const WriteBatch late = Decide("r1", {1, 2}, "HALT", "DEFAULT");
  ASSERT_EQ(store_->Acquire("r1")->tenure, 2u);
  const RobotRecord before = Load("r1");

  WriteBatch checkpoint{.robot = "r1", .tenure = 1};
  checkpoint.checkpoint.variables = Variables{{"n", int64_t{1}}};
  WriteBatch alert{.robot = "r1", .tenure = 1};
  alert.alerts.push_back(MakeAlert("r1", "late"));
  for (const WriteBatch& batch : {late, checkpoint, alert}) {
    EXPECT_THAT(store_->Commit(batch), StatusIs(absl::StatusCode::kAborted));
  }
  EXPECT_THAT(store_->NextTerm("r1", 1, 0), StatusIs(absl::StatusCode::kAborted));
  EXPECT_EQ(Load("r1"), before);
  EXPECT_THAT(AlertTexts("r1"), IsEmpty());

  ASSERT_EQ(store_->Acquire("r1")->tenure, 3u) << "by the first one again";
  EXPECT_THAT(store_->Commit(late), StatusIs(absl::StatusCode::kAborted));
  EXPECT_EQ(Load("r1").level, "HALT");
  WriteBatch now = late;
  now.tenure = 3;
  EXPECT_THAT(store_->Commit(now), IsOk());
}

TEST_P(StoreContractTest, WithoutAnOwnerAlertsAreAllThatIsWritten) {
  WriteBatch unknown = Decide("r9", {1, 1}, "DEFAULT", "HALT");
  EXPECT_THAT(store_->Commit(unknown), StatusIs(absl::StatusCode::kAborted));
  unknown = Decide("r1", {2, 1}, "DEFAULT", "HALT");
  unknown.tenure = 2;
  EXPECT_THAT(store_->Commit(unknown), StatusIs(absl::StatusCode::kAborted)) << "never drawn";
  EXPECT_THAT(store_->NextTerm("r9", 0, 0), StatusIs(absl::StatusCode::kAborted));
  for (const std::string& robot :
       {std::string(kServerRobot), std::string("r9"), std::string("r1")}) {
    const WriteBatch alert{.robot = robot, .alerts = {MakeAlert(robot, "of the server")}};
    EXPECT_THAT(store_->Commit(alert), IsOk());
  }
  EXPECT_THAT(AlertTexts(""), SizeIs(3));
  EXPECT_EQ(Load("r9"), RobotRecord{});
}

TEST_P(StoreContractTest, EachBatchOfAGroupHasItsOwnStatus) {
  ASSERT_THAT(store_->BeginGeneration(std::string(16, 'a')), IsOk());
  ASSERT_THAT(store_->Commit(Decide("r3", {1, 1}, "DEFAULT", "ALERT")), IsOk());
  ASSERT_EQ(store_->Acquire("r2")->tenure, 2u);
  WriteBatch clash = Decide("r3", {1, 2}, "ALERT", "HALT");
  clash.decisions.push_back(Decide("r3", {1, 1}, "ALERT", "HALT").decisions[0]);
  clash.alerts.push_back(MakeAlert("r3", "of the clash"));
  WriteBatch invalid = Decide("r1", {1, 2}, "ALERT", "HALT");
  invalid.alerts.push_back({.robot = "r1"});
  const std::vector<WriteBatch> group = {Decide("r1", {1, 1}, "DEFAULT", "ALERT"), clash,
                                         Decide("r2", {1, 1}, "DEFAULT", "HALT"), invalid,
                                         Decide("r1", {1, 3}, "ALERT", "HALT")};
  const auto statuses = store_->CommitAll(group);
  ASSERT_THAT(statuses, IsOk());
  EXPECT_THAT(*statuses, ElementsAre(IsOk(), StatusIs(absl::StatusCode::kAlreadyExists),
                                     StatusIs(absl::StatusCode::kAborted),
                                     StatusIs(absl::StatusCode::kInvalidArgument), IsOk()));
  EXPECT_EQ(Load("r1").decision_id, (DecisionId{1, 3}));
  EXPECT_THAT(Transitions("r1"), SizeIs(2));
  EXPECT_EQ(Load("r2").level, "");
  EXPECT_EQ(Load("r3").level, "ALERT") << "nothing of the batch";
  EXPECT_THAT(AlertTexts(""), IsEmpty());
  EXPECT_EQ(store_->newest_commit(), 2u) << "one transaction";
}

TEST_P(StoreContractTest, TakesTheLevelFromTheHighestDecisionId) {
  ASSERT_THAT(store_->Commit(Decide("r1", {1, 1}, "DEFAULT", "ALERT")), IsOk());
  ASSERT_THAT(store_->Commit(Decide("r1", {1, 2}, "ALERT", "COMPROMISED")), IsOk());

  const RobotRecord record = Load("r1");
  EXPECT_EQ(record.level, "COMPROMISED");
  EXPECT_EQ(record.decision_id, (DecisionId{1, 2}));
  EXPECT_EQ(record.highest_term, 1u);
  EXPECT_EQ(Decision("r1", {1, 1}), "ALERT");
  EXPECT_EQ(Decision("r1", {1, 2}), "COMPROMISED");
  EXPECT_EQ(Decision("r1", {1, 3}), "");
  EXPECT_EQ(Decision("r2", {1, 1}), "");
  EXPECT_EQ(Decision("r1", {std::numeric_limits<uint64_t>::max(), 1}), "");
}

TEST_P(StoreContractTest, DoesNotSinkByALateWrite) {
  ASSERT_THAT(store_->Commit(Decide("r1", {2, 7}, "ALERT", "HALT")), IsOk());
  ASSERT_THAT(store_->Commit(Decide("r1", {1, 9}, "ALERT", "DEFAULT")), IsOk());

  EXPECT_EQ(Load("r1").level, "HALT");
  EXPECT_EQ(Load("r1").decision_id, (DecisionId{2, 7}));
  EXPECT_EQ(Load("r1").highest_term, 2u);
  EXPECT_EQ(Decision("r1", {1, 9}), "DEFAULT");
}

TEST_P(StoreContractTest, ADecisionRaisesTheTerm) {
  ASSERT_THAT(store_->Commit(Decide("r1", {7, 1}, "DEFAULT", "ALERT")), IsOk());
  EXPECT_THAT(store_->NextTerm("r1", 1, 0), IsOkAndHolds(8u));
}

TEST_P(StoreContractTest, WritingADecisionAgainChangesNothing) {
  const WriteBatch batch = Decide("r1", {1, 1}, "DEFAULT", "ALERT");
  ASSERT_THAT(store_->Commit(batch), IsOk());
  WriteBatch stage{.robot = "r1", .tenure = 1};
  stage.stages.push_back({.decision_id = {1, 1}, .stage = "verified", .detail = "2 parts"});
  ASSERT_THAT(store_->Commit(stage), IsOk());

  EXPECT_THAT(store_->Commit(batch), IsOk());
  ASSERT_THAT(Transitions("r1"), SizeIs(1));
  EXPECT_EQ(Transitions("r1")[0].stage, "verified");
  stage.stages = {{.decision_id = {1, 1}, .stage = "superseded"}};
  ASSERT_THAT(store_->Commit(stage), IsOk());
  EXPECT_EQ(Transitions("r1")[0].stage, "verified") << "the robot was there";
  stage.stages = {{.decision_id = {1, 1}, .stage = "contradicted", .detail = "/drive goes on"}};
  ASSERT_THAT(store_->Commit(stage), IsOk());
  EXPECT_EQ(Transitions("r1")[0].stage, "contradicted");
  EXPECT_EQ(Transitions("r1")[0].detail, "/drive goes on");
}

TEST_P(StoreContractTest, ADecisionIdNamesOneDecisionForEver) {
  ASSERT_THAT(store_->Commit(Decide("r1", {1, 1}, "DEFAULT", "HALT")), IsOk());
  const std::vector<TransitionRecord> before = Transitions("r1");

  WriteBatch other = Decide("r1", {1, 1}, "HALT", "DEFAULT");
  EXPECT_THAT(store_->Commit(other), StatusIs(absl::StatusCode::kAlreadyExists));
  other = Decide("r1", {1, 2}, "HALT", "DEFAULT");
  other.decisions[0].id = before[0].id;
  EXPECT_THAT(store_->Commit(other), StatusIs(absl::StatusCode::kAlreadyExists));

  EXPECT_EQ(Transitions("r1"), before);
  EXPECT_EQ(Load("r1").level, "HALT");
}

TEST_P(StoreContractTest, ABatchIsAllOrNothing) {
  const WriteBatch good = Decide("r1", {1, 1}, "DEFAULT", "ALERT");
  WriteBatch bad = good;
  bad.alerts.push_back({.id = "", .robot = "r1", .text = "no id"});
  EXPECT_THAT(store_->Commit(bad), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_EQ(Load("r1"), RobotRecord{.highest_term = 1});
  EXPECT_THAT(Transitions("r1"), IsEmpty());

  ASSERT_THAT(store_->Commit(good), IsOk());
  WriteBatch clash = Decide("r1", {1, 2}, "ALERT", "HALT");
  clash.decisions.push_back(Decide("r1", {1, 1}, "ALERT", "HALT").decisions[0]);
  EXPECT_THAT(store_->Commit(clash), StatusIs(absl::StatusCode::kAlreadyExists));
  EXPECT_EQ(Load("r1").level, "ALERT");
  EXPECT_THAT(Transitions("r1"), SizeIs(1));
}

TEST_P(StoreContractTest, RefusesRecordsThatSayTooLittleOrTooMuch) {
  std::vector<WriteBatch> bad(15, WriteBatch{.robot = "r1", .tenure = 1});
  bad[0] = Decide("", {1, 1}, "A", "B");
  bad[1] = Decide("r1", {0, 1}, "A", "B");
  bad[2] = Decide("r1", {1, 0}, "A", "B");
  bad[3] = Decide("r1", {1, 1}, "A", "");
  bad[4] = Decide("r1", {1, kNumberMax + 1}, "A", "B");
  bad[5].refusals.push_back({.id = ""});
  bad[6].stages.push_back({.decision_id = {1, 1}, .stage = ""});
  bad[7].alerts.push_back({.id = "x", .robot = ""});
  bad[8].alerts.push_back({.id = "x", .robot = "r2"});
  bad[9].checkpoint.high_water = {{LaneKey{}, kNumberMax + 1}};
  bad[10] = Decide("r1", {1, 1}, "A", "B");
  bad[10].tenure = 0;
  bad[11].tenure = 0;
  bad[11].checkpoint.rules_halted = true;
  bad[12].checkpoint.maintenance = {.until_unix_ns = 60, .reason = "no operator"};
  bad[13].checkpoint.maintenance = {.began_unix_ns = 60, .until_unix_ns = 60, .by = "carol"};
  bad[14].checkpoint.maintenance = {
      .until_unix_ns = 60, .by = "c", .reason = std::string(kMaintenanceReasonBytesMax + 1, 'x')};
  for (size_t i = 0; i < bad.size(); ++i) {
    EXPECT_THAT(store_->Commit(bad[i]), StatusIs(absl::StatusCode::kInvalidArgument)) << i;
  }
}

TEST_P(StoreContractTest, ListsTransitionsAsTheyWereWrittenNewestFirst) {
  WriteBatch batch = Decide("r1", {1, 1}, "DEFAULT", "ALERT");
  batch.decisions[0].based_on = {0, 0};
  batch.decisions[0].reason = "looked \"odd\"\n";
  batch.refusals.push_back({.id = "f1",
                            .from = "ALERT",
                            .to = "DEFAULT",
                            .cause = "rule calm",
                            .reason = "blind",
                            .count = 1,
                            .time_unix_ns = 20});
  batch.stages.push_back({.decision_id = {1, 1}, .stage = "failed", .detail = "timeout"});
  batch.stages.push_back({.decision_id = {9, 9}, .stage = "verified"});
  ASSERT_THAT(store_->Commit(batch), IsOk());
  ASSERT_THAT(store_->Commit(Decide("r2", {1, 1}, "DEFAULT", "HALT")), IsOk());

  const DecisionRecord& decision = batch.decisions[0];
  EXPECT_THAT(Transitions("r1"), ElementsAre(TransitionRecord{.id = "f1",
                                                              .robot = "r1",
                                                              .time_unix_ns = 20,
                                                              .from = "ALERT",
                                                              .to = "DEFAULT",
                                                              .cause = "rule calm",
                                                              .reason = "blind",
                                                              .refused = true},
                                             TransitionRecord{.id = decision.id,
                                                              .robot = "r1",
                                                              .time_unix_ns = decision.time_unix_ns,
                                                              .from = "DEFAULT",
                                                              .to = "ALERT",
                                                              .cause = decision.cause,
                                                              .reason = "looked \"odd\"\n",
                                                              .decision_id = {1, 1},
                                                              .stage = "failed",
                                                              .detail = "timeout"}));
}

TEST_P(StoreContractTest, ARepeatedRefusalIsUpdatedNotAdded) {
  RefusalRecord refusal = {.id = "f1", .from = "B", .to = "A", .reason = "blind"};
  WriteBatch batch{.robot = "r1", .tenure = 1};
  batch.refusals = {refusal};
  ASSERT_THAT(store_->Commit(batch), IsOk());
  refusal.count = 17;
  refusal.time_unix_ns = 99;
  batch.refusals = {refusal};
  ASSERT_THAT(store_->Commit(batch), IsOk());

  ASSERT_THAT(Transitions("r1"), SizeIs(1));
  EXPECT_EQ(Transitions("r1")[0].count, 17u);
  EXPECT_EQ(Transitions("r1")[0].time_unix_ns, 99);
  EXPECT_TRUE(Transitions("r1")[0].decision_id.none());

  ASSERT_THAT(store_->Commit(Decide("r1", {1, 1}, "A", "B", "d1")), IsOk());
  batch.refusals[0].id = "d1";
  EXPECT_THAT(store_->Commit(batch), StatusIs(absl::StatusCode::kAlreadyExists));
  EXPECT_EQ(Load("r1").level, "B");
}

TEST_P(StoreContractTest, ListsAlertsOfOneRobotOrOfAll) {
  CommitThreeAlerts();

  EXPECT_THAT(AlertTexts(""), ElementsAre("three", "two", "one"));
  EXPECT_THAT(AlertTexts("r1"), ElementsAre("three", "one"));
  EXPECT_THAT(AlertTexts("", 1), ElementsAre("three"));
  EXPECT_THAT(AlertTexts("r3"), IsEmpty());
}

TEST_P(StoreContractTest, AnAlertWrittenTwiceIsThereOnce) {
  WriteBatch batch{.robot = "r1", .tenure = 1};
  batch.alerts = {MakeAlert("r1", "first")};
  ASSERT_THAT(store_->Commit(batch), IsOk());
  batch.alerts[0].text = "second";
  ASSERT_THAT(store_->Commit(batch), IsOk());
  EXPECT_THAT(AlertTexts("r1"), ElementsAre("first"));
}

TEST_P(StoreContractTest, ListsAlertsAfterOneInTheOrderOfWriting) {
  EXPECT_EQ(store_->NewestAlert()->sequence, 0u);
  const std::vector<WriteBatch> batches = CommitThreeAlerts();
  ASSERT_THAT(store_->Commit(batches[0]), IsOk());  // again: no new sequence

  const auto newest = store_->NewestAlert();
  ASSERT_THAT(newest, IsOk());
  EXPECT_EQ(newest->id, batches[2].alerts[0].id);
  EXPECT_THAT(store_->FindAlert(newest->id), IsOkAndHolds(newest->sequence));
  EXPECT_THAT(store_->FindAlert("no such"), IsOkAndHolds(0u));

  const auto all = store_->AlertsAfter("", 0, 2);
  ASSERT_THAT(all, IsOk());
  EXPECT_FALSE(all->forgotten);
  ASSERT_THAT(all->alerts, SizeIs(2));
  EXPECT_EQ(all->alerts[0].text, "one");
  EXPECT_GT(all->alerts[0].sequence, 0u);
  EXPECT_LT(all->alerts[0].sequence, all->alerts[1].sequence);
  const auto rest = store_->AlertsAfter("r1", all->alerts[0].sequence, 0);
  ASSERT_THAT(rest, IsOk());
  ASSERT_THAT(rest->alerts, SizeIs(1));
  EXPECT_EQ(rest->alerts[0].text, "three");
  EXPECT_THAT(store_->AlertsAfter("", newest->sequence, 0)->alerts, IsEmpty());
  EXPECT_THAT(store_->AlertsAfter("", ~uint64_t{0}, 0)->alerts, IsEmpty());
}

engine::Trace SomeTrace() {
  engine::Trace trace{.place = "warehouse.rul:31",
                      .condition = "nodecount(3, 4) && !nodes(\"/a\")",
                      .event = "graph change",
                      .event_unix_ns = 1'767'225'600'000'000'007,
                      .bundle = "sha256:00",
                      .cut = true};
  trace.values.push_back({.offset = 3, .length = 4, .depth = 1, .value = "true: there are 3"});
  trace.subjects.push_back(
      {.name = "/x", .role = "is a node", .guid = {{1, 2, 3}}, .host = "h", .pid = 7});
  trace.subjects.push_back({.name = "\xf0\x9f\xa4\x96\n\x1b[2J", .role = "sent the message"});
  trace.finding = {.kind = "impostor", .guid = {{1, 2, 3}}, .node = "/rips", .over = true};
  return trace;
}

TEST_P(StoreContractTest, KeepsWhyARuleFired) {
  WriteBatch batch = Decide("r1", {1, 1}, "A", "B");
  batch.decisions[0].trace = SomeTrace();
  batch.refusals.push_back({.id = NewId(), .from = "B", .to = "A", .trace = SomeTrace()});
  batch.alerts.push_back(MakeAlert("r1", "with"));
  batch.alerts[0].trace = SomeTrace();
  batch.alerts.push_back(MakeAlert("r1", "without"));
  ASSERT_THAT(store_->Commit(batch), IsOk());
  EXPECT_THAT(store_->Commit(batch), IsOk()) << "a repeated write is the same decision";
  for (const TransitionRecord& each : Transitions("r1")) EXPECT_EQ(each.trace, SomeTrace());
  const auto alerts = store_->ListAlerts("r1", 10);
  ASSERT_THAT(alerts, IsOk());
  ASSERT_EQ(alerts->size(), 2u);
  EXPECT_TRUE((*alerts)[0].trace.none());
  EXPECT_EQ((*alerts)[1].trace, SomeTrace());
  const auto page = store_->AlertsAfter("r1", 0, 10);
  ASSERT_THAT(page, IsOk());
  EXPECT_EQ(page->alerts[0].trace, SomeTrace());
}

TEST_P(StoreContractTest, KeepsTheFindingOfAnAlertThatNoRuleRaised) {
  WriteBatch batch = Decide("r1", {1, 1}, "A", "B");
  batch.alerts.push_back(MakeAlert("r1", "finding"));
  batch.alerts[0].trace.finding = {.kind = "non_ros_reader", .topic = "/camera"};
  batch.alerts[0].trace.subjects = {{.name = "/camera", .host = "h"}};
  const engine::Trace trace = batch.alerts[0].trace;
  ASSERT_THAT(store_->Commit(batch), IsOk());
  EXPECT_EQ(store_->ListAlerts("r1", 1)->front().trace, trace);
}

TEST_P(StoreContractTest, FindsRecordsByTheBeginningOfTheirIds) {
  const auto id = [](const std::string& begin) {
    return begin + std::string(32 - begin.size(), '0');
  };
  WriteBatch batch = Decide("r1", {1, 1}, "A", "B", id("abc1"));
  batch.refusals.push_back({.id = id("abc2"), .from = "B", .to = "A"});
  for (const char* begin : {"abd1", "abd2", "abd3", "ffff"}) {
    batch.alerts.push_back(MakeAlert("r1", begin));
    batch.alerts.back().id = id(begin);
  }
  ASSERT_THAT(store_->Commit(batch), IsOk());
  const auto count = [&](const std::string& prefix) {
    const auto found = store_->FindRecords(prefix);
    EXPECT_THAT(found, IsOk());
    return found.ok() ? std::pair(found->alerts.size(), found->transitions.size())
                      : std::pair<size_t, size_t>(99, 99);
  };
  using Counts = std::pair<size_t, size_t>;
  EXPECT_EQ(count("abc1"), Counts(0, 1));
  EXPECT_EQ(count(id("abc1")), Counts(0, 1));
  EXPECT_EQ(count("abc"), Counts(0, 2));
  EXPECT_EQ(count("abd"), Counts(2, 0)) << "two say that it is not one";
  EXPECT_EQ(count("ab"), Counts(2, 2));
  EXPECT_EQ(count("ffff"), Counts(1, 0));
  EXPECT_EQ(count("0"), Counts(0, 0));
}

TEST_P(StoreContractTest, RemembersNotes) {
  EXPECT_THAT(store_->Note("where"), IsOkAndHolds(""));
  ASSERT_THAT(store_->SetNote("where", "here"), IsOk());
  ASSERT_THAT(store_->SetNote("where", "there"), IsOk());
  EXPECT_THAT(store_->Note("where"), IsOkAndHolds("there"));
  EXPECT_THAT(store_->SetNote("", "x"), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(store_->SetNote("where", std::string(kNoteBytesMax + 1, 'x')),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST_P(StoreContractTest, KeepsHostileTextAsItIs) {
  const std::string hostile("\x1b[2J'; DROP TABLE alerts;--\xff\xfe\0tail", 34);
  AlertRecord alert = MakeAlert("r1", hostile);
  alert.event = hostile;
  alert.rule = hostile;
  WriteBatch batch{.robot = "r1", .tenure = 1};
  batch.alerts = {alert};
  batch.checkpoint.variables = Variables{{"v", hostile}};
  ASSERT_THAT(store_->Commit(batch), IsOk());

  auto list = store_->ListAlerts("r1", 0);
  ASSERT_THAT(list, IsOk());
  EXPECT_THAT(*list, ElementsAre(alert));
  EXPECT_EQ(std::get<std::string>(Load("r1").variables.at("v")), hostile);
}

TEST_P(StoreContractTest, CutsListsToTheirLimit) {
  WriteBatch batch{.robot = "r1", .tenure = 1};
  for (uint64_t i = 1; i <= kListMax + 5; ++i) {
    batch.alerts.push_back(MakeAlert("r1", absl::StrCat(i)));
    batch.decisions.push_back(Decide("r1", {1, i}, "A", "B").decisions[0]);
  }
  ASSERT_THAT(store_->Commit(batch), IsOk());

  EXPECT_THAT(AlertTexts("r1", 0), SizeIs(kListDefault));
  EXPECT_THAT(AlertTexts("", kListMax + 5), SizeIs(kListMax));
  EXPECT_THAT(Transitions("r1", 0), SizeIs(kListDefault));
  EXPECT_THAT(Transitions("r1", kListMax + 5), SizeIs(kListMax));
  EXPECT_EQ(Transitions("r1", 1)[0].decision_id, (DecisionId{1, kListMax + 5}));
}

TEST_P(StoreContractTest, RestoresVariablesExactly) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const Variables variables = {
      {"int", std::numeric_limits<int64_t>::min()},
      {"float", 0.1},
      {"huge", std::numeric_limits<double>::infinity()},
      {"zero", -0.0},
      {"nan", nan},
      {"yes", true},
      {"no", false},
      {"one", int64_t{1}},
      {"text", std::string("")},
  };
  WriteBatch batch{.robot = "r1", .tenure = 1};
  batch.checkpoint.variables = variables;
  ASSERT_THAT(store_->Commit(batch), IsOk());

  Variables read = Load("r1").variables;
  ASSERT_TRUE(read.contains("nan"));
  EXPECT_TRUE(std::isnan(std::get<double>(read.at("nan"))));
  EXPECT_TRUE(std::signbit(std::get<double>(read.at("zero"))));
  read.erase("nan");
  Variables expected = variables;
  expected.erase("nan");
  EXPECT_EQ(read, expected);
}

TEST_P(StoreContractTest, ACheckpointReplacesWhatItHasAndKeepsTheRest) {
  const LaneKey control = {.host = "base", .incarnation = "aa", .lane = LaneKey::Lane::kControl};
  const LaneKey messages = {.host = "base", .incarnation = "aa", .lane = LaneKey::Lane::kMessages};
  WriteBatch batch{.robot = "r1", .tenure = 1};
  batch.checkpoint = {.variables = Variables{{"a", int64_t{1}}, {"b", int64_t{2}}},
                      .high_water = {{control, 5}, {messages, 100}},
                      .soft_suspended = true,
                      .rules_halted = true,
                      .bundle = "sha256:b"};
  ASSERT_THAT(store_->Commit(batch), IsOk());
  WriteBatch later{.robot = "r1", .tenure = 1};
  later.checkpoint.high_water = {{control, 6}};
  ASSERT_THAT(store_->Commit(later), IsOk());
  EXPECT_EQ(Load("r1").variables.size(), 2u);
  EXPECT_TRUE(Load("r1").soft_suspended);
  EXPECT_TRUE(Load("r1").rules_halted);
  EXPECT_EQ(Load("r1").bundle, "sha256:b");
  EXPECT_EQ(Load("r1").high_water, (HighWater{{control, 6}, {messages, 100}}));

  later.checkpoint.variables = Variables{{"a", int64_t{3}}};
  later.checkpoint.soft_suspended = false;
  later.checkpoint.rules_halted = false;
  later.checkpoint.high_water = {{control, 2}};
  ASSERT_THAT(store_->Commit(later), IsOk());
  EXPECT_EQ(Load("r1").variables, (Variables{{"a", int64_t{3}}}));
  EXPECT_FALSE(Load("r1").soft_suspended);
  EXPECT_FALSE(Load("r1").rules_halted);
  EXPECT_EQ(Load("r1").high_water.at(control), 6u) << "a sequence never goes back";
  EXPECT_EQ(Load("r2"), RobotRecord{.highest_term = 1});
}

TEST_P(StoreContractTest, ForgetsTheOldestLanesOfAHostBeyondTheLimit) {
  const LaneKey other = {.host = "laptop", .incarnation = "l"};
  WriteBatch batch{.robot = "r1", .tenure = 1};
  batch.checkpoint.high_water = {{other, 1}};
  ASSERT_THAT(store_->Commit(batch), IsOk());
  for (size_t i = 0; i <= kHighWaterPerHostMax; ++i) {
    const LaneKey key = {.host = "base", .incarnation = absl::StrCat(1'000 - i)};
    batch.checkpoint.high_water = {{key, i + 1}};
    ASSERT_THAT(store_->Commit(batch), IsOk());
  }

  const HighWater kept = Load("r1").high_water;
  EXPECT_THAT(kept, SizeIs(kHighWaterPerHostMax + 1));
  EXPECT_TRUE(kept.contains(other));
  EXPECT_FALSE(kept.contains(LaneKey{.host = "base", .incarnation = "1000"}));
  EXPECT_TRUE(kept.contains(LaneKey{.host = "base", .incarnation = "999"}));
}

TEST_P(StoreContractTest, CommitsAreCountedThroughItsGenerations) {
  const std::string first(16, 'a');
  const std::string second(16, 'b');
  EXPECT_EQ(store_->newest_commit(), 0u);
  EXPECT_THAT(store_->Generations(), IsOkAndHolds(std::vector<Generation>()));
  ASSERT_THAT(store_->Commit(Decide("r1", {1, 1}, "DEFAULT", "ALERT")), IsOk());
  EXPECT_EQ(store_->newest_commit(), 0u) << "of no generation";

  ASSERT_THAT(store_->BeginGeneration(first), IsOk());
  EXPECT_EQ(store_->newest_commit(), 0u);
  ASSERT_THAT(store_->Commit(Decide("r1", {1, 2}, "ALERT", "HALT")), IsOk());
  const std::vector<WriteBatch> both = {Decide("r2", {1, 1}, "DEFAULT", "ALERT"),
                                        Decide("r3", {1, 1}, "DEFAULT", "ALERT")};
  ASSERT_THAT(store_->CommitAll(both), IsOk());
  EXPECT_EQ(store_->newest_commit(), 2u);
  EXPECT_THAT(store_->Commit(Decide("r1", {1, 2}, "HALT", "DEFAULT")),
              StatusIs(absl::StatusCode::kAlreadyExists));
  EXPECT_EQ(store_->newest_commit(), 2u) << "nothing was written";

  ASSERT_THAT(store_->BeginGeneration(second), IsOk());
  EXPECT_EQ(store_->newest_commit(), 2u);
  ASSERT_THAT(store_->Commit(Decide("r1", {1, 3}, "HALT", "DEFAULT")), IsOk());
  EXPECT_EQ(store_->newest_commit(), 3u);
  EXPECT_THAT(store_->Generations(),
              IsOkAndHolds(std::vector<Generation>{{first, 2}, {second, 3}}));

  EXPECT_THAT(store_->BeginGeneration(first), StatusIs(absl::StatusCode::kAlreadyExists));
  EXPECT_THAT(store_->BeginGeneration("short"), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(store_->BeginGeneration(""), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_EQ(store_->newest_commit(), 3u);
}

TEST_P(StoreContractTest, ForgetsTheOldestGenerationsBeyondTheLimit) {
  const auto id = [](size_t i) { return absl::StrCat(1'000'000'000'000'000 + i); };
  for (size_t i = 0; i <= kGenerationsMax; ++i) {
    ASSERT_THAT(store_->BeginGeneration(id(i)), IsOk());
    ASSERT_THAT(store_->Commit(Decide("r1", {1, i + 1}, "DEFAULT", "ALERT")), IsOk());
  }
  const auto kept = store_->Generations();
  ASSERT_THAT(kept, IsOk());
  ASSERT_THAT(*kept, SizeIs(kGenerationsMax));
  EXPECT_EQ(kept->front(), (Generation{id(1), 2}));
  EXPECT_EQ(kept->back(), (Generation{id(kGenerationsMax), kGenerationsMax + 1}));
}

TEST(GenerationsTest, AStoreGoesOnFromWhatItHeldAndFromNothingElse) {
  const std::vector<Generation> chain = {{"a", 10}, {"b", 10}, {"c", 25}, {"d", 25}};
  const auto goes_on = [&](const std::string& generation, uint64_t commit) {
    return GoesOnFrom(chain, 30, {.generation = generation, .commit = commit});
  };
  EXPECT_TRUE(goes_on("", 99)) << "it does not say";
  EXPECT_TRUE(goes_on("d", 30));
  EXPECT_FALSE(goes_on("d", 31)) << "it has not come so far";
  EXPECT_TRUE(goes_on("a", 0));
  EXPECT_TRUE(goes_on("a", 10));
  EXPECT_FALSE(goes_on("a", 11)) << "another history begins there";
  EXPECT_FALSE(goes_on("x", 0)) << "another store";
  EXPECT_TRUE(GoesOnFrom({}, 0, {.generation = "a", .commit = 1})) << "it does not know";
}

TEST(GenerationsTest, WhatTheLimitMayHaveForgottenIsNoOtherStore) {
  std::vector<Generation> chain;
  for (size_t i = 0; i < kGenerationsMax; ++i) chain.push_back({absl::StrCat(i), 100 + i});
  EXPECT_TRUE(GoesOnFrom(chain, 1'000, {.generation = "x", .commit = 100}));
  EXPECT_FALSE(GoesOnFrom(chain, 1'000, {.generation = "x", .commit = 101}));
  chain.pop_back();
  EXPECT_FALSE(GoesOnFrom(chain, 1'000, {.generation = "x", .commit = 100})) << "none is forgotten";
}

TEST_P(StoreContractTest, ShowsTheNewestDecisionsOfRules) {
  WriteBatch batch = Decide("r1", {1, 1}, "DEFAULT", "ALERT");
  batch.decisions[0].time_unix_ns = 100;
  batch.decisions.push_back(Decide("r1", {1, 3}, "DEFAULT", "ALERT").decisions[0]);
  batch.decisions.push_back(Decide("r1", {1, 2}, "ALERT", "DEFAULT").decisions[0]);
  for (const char* cause : {"operator alice", "adopted", "crash in rule x", "rules", ""}) {
    batch.decisions.push_back(
        Decide("r1", {1, batch.decisions.size() + 1}, "DEFAULT", "ALERT").decisions[0]);
    batch.decisions.back().cause = cause;
  }
  batch.refusals.push_back({.id = "no", .cause = "rule x"});
  ASSERT_THAT(store_->Commit(batch), IsOk());
  ASSERT_THAT(store_->Commit(Decide("r2", {1, 1}, "DEFAULT", "ALERT")), IsOk());
  EXPECT_THAT(Load("r1").rule_decisions, ElementsAre(RuleDecision{{1, 1}, "DEFAULT", "ALERT", 100},
                                                     RuleDecision{{1, 2}, "ALERT", "DEFAULT", 10},
                                                     RuleDecision{{1, 3}, "DEFAULT", "ALERT", 10}));

  WriteBatch resumed{.robot = "r1", .tenure = 1};
  resumed.checkpoint.resumed_at = DecisionId{1, 2};
  ASSERT_THAT(store_->Commit(resumed), IsOk());
  EXPECT_EQ(Load("r1").resumed_at, (DecisionId{1, 2}));
  EXPECT_THAT(Load("r1").rule_decisions, ElementsAre(RuleDecision{{1, 3}, "DEFAULT", "ALERT", 10}));
  resumed.checkpoint.resumed_at.reset();
  ASSERT_THAT(store_->Commit(resumed), IsOk());
  EXPECT_EQ(Load("r1").resumed_at, (DecisionId{1, 2})) << "absent = as before";

  WriteBatch many{.robot = "r1", .tenure = 1};
  for (uint64_t i = 1; i <= kRuleDecisionsMax; ++i) {
    many.decisions.push_back(Decide("r1", {2, i}, "DEFAULT", "ALERT").decisions[0]);
  }
  ASSERT_THAT(store_->Commit(many), IsOk());
  EXPECT_THAT(Load("r1").rule_decisions, SizeIs(kRuleDecisionsMax));
  EXPECT_EQ(Load("r1").rule_decisions.front().decision_id, (DecisionId{2, 1}));
}

TEST_P(StoreContractTest, KeepsTheMaintenanceOfARobotUntilItEnds) {
  EXPECT_TRUE(Load("r1").maintenance.none());
  WriteBatch batch{.robot = "r1", .tenure = 1};
  const std::string hostile("it's\0 \xFF", 8);
  const Maintenance first{
      .began_unix_ns = 5, .until_unix_ns = 60, .by = "carol", .reason = hostile};
  batch.checkpoint.maintenance = first;
  batch.alerts = {MakeAlert("r1", "marked")};
  batch.alerts[0].maintenance = hostile;
  ASSERT_THAT(store_->Commit(batch), IsOk());
  EXPECT_EQ(Load("r1").maintenance, first);
  EXPECT_TRUE(Load("r2").maintenance.none());
  EXPECT_EQ((*store_->ListAlerts("r1", 0)).front().maintenance, hostile);
  EXPECT_EQ((*store_->AlertsAfter("", 0, 0)).alerts.front().maintenance, hostile);

  WriteBatch other{.robot = "r1", .tenure = 1};
  other.checkpoint.rules_halted = true;
  ASSERT_THAT(store_->Commit(other), IsOk());
  EXPECT_EQ(Load("r1").maintenance, first) << "absent = as before";
  batch.checkpoint.maintenance->by = "dave";
  ASSERT_THAT(store_->Commit(batch), IsOk());
  EXPECT_EQ(Load("r1").maintenance.by, "dave") << "one of each robot";
  batch.checkpoint.maintenance = Maintenance();
  ASSERT_THAT(store_->Commit(batch), IsOk());
  EXPECT_TRUE(Load("r1").maintenance.none());
}

INSTANTIATE_TEST_SUITE_P(All, StoreContractTest, testing::Values(Kind::kFake, Kind::kSqlite),
                         [](const testing::TestParamInfo<Kind>& param) {
                           return param.param == Kind::kFake ? "Fake" : "Sqlite";
                         });

}  // namespace
}  // namespace rips::store

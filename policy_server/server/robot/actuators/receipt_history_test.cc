#include "policy_server/server/robot/actuators/receipt_history.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::pipeline {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using Told = Receipt::Stage;

Receipt Of(const std::string& id, Told stage, const std::string& detail = "") {
  return {.command_id = id, .stage = stage, .detail = detail};
}
Command Level(const std::string& id, const std::string& to = "ALERT") {
  return {.id = id, .what = SetLevel{.to = to}};
}

std::vector<std::string> Commands(const ReceiptHistory& log, size_t limit = 0) {
  std::vector<std::string> texts;
  for (const LoggedReceipt& each : log.Newest(limit)) {
    texts.push_back(absl::StrCat(each.host, " ", each.command));
  }
  return texts;
}

TEST(ReceiptLogTest, NamesCommandsAndGivesTheNewestFirst) {
  ReceiptHistory log;
  log.Sent("base", Level("1"));
  log.Sent("base", {.id = "2", .what = RunProgram{.program = "usb_alarm"}});
  log.Sent("arm", {.id = "3", .what = Drill{.level = "HALT"}});
  log.Received("base", Of("1", Told::kVerified), 10);
  log.Received("base", Of("2", Told::kFailed, "exit code 1"), 20);
  log.Received("arm", Of("3", Told::kAcknowledged), 30);
  EXPECT_THAT(Commands(log),
              ElementsAre("arm drill HALT", "base exec usb_alarm", "base level ALERT"));
  EXPECT_THAT(Commands(log, 2), ElementsAre("arm drill HALT", "base exec usb_alarm"));
  EXPECT_THAT(Commands(log, 1000), SizeIs(3));
  EXPECT_EQ(log.Newest(1)[0].unix_ns, 30);
}

TEST(ReceiptLogTest, TheStageOfACommandNeverGoesBack) {
  const Told order[] = {Told::kAcknowledged, Told::kUnknown,    Told::kRefused,
                        Told::kFailed,       Told::kSuperseded, Told::kVerified};
  for (const Told before : order) {
    for (const Told after : order) {
      ReceiptHistory log;
      log.Sent("base", Level("1"));
      log.Received("base", Of("1", before, "before"), 1);
      log.Received("base", Of("1", after, "after"), 2);
      const std::vector<LoggedReceipt> kept = log.Newest(0);
      ASSERT_THAT(kept, SizeIs(1));
      const bool taken =
          std::find(order, std::end(order), after) >= std::find(order, std::end(order), before);
      EXPECT_EQ(kept[0].receipt.stage, taken ? after : before);
      EXPECT_EQ(kept[0].receipt.detail, taken ? "after" : "before");
      EXPECT_EQ(kept[0].unix_ns, taken ? 2 : 1);
      EXPECT_EQ(kept[0].command, "level ALERT");
    }
  }
}

TEST(ReceiptLogTest, ARepeatedReceiptIsNoNews) {
  ReceiptHistory log;
  log.Sent("base", Level("1"));
  log.Sent("base", Level("2"));
  log.Received("base", Of("1", Told::kVerified), 1);
  log.Received("base", Of("2", Told::kVerified), 2);
  log.Received("base", Of("1", Told::kVerified), 3);
  EXPECT_EQ(log.Newest(0)[0].receipt.command_id, "2");
  EXPECT_EQ(log.Newest(0)[1].unix_ns, 1);
}

TEST(ReceiptLogTest, AnotherHostsCommandIsNotRecognised) {
  ReceiptHistory log;
  log.Sent("base", Level("1"));
  log.Received("arm", Of("1", Told::kVerified), 1);
  log.Received("base", Of("1", Told::kFailed), 2);
  EXPECT_THAT(Commands(log), ElementsAre("base level ALERT", "arm unknown command"));
}

TEST(ReceiptLogTest, StrangeReceiptsDoNotPushOutTheOthers) {
  ReceiptHistory log;
  log.Sent("base", Level("mine"));
  log.Received("base", Of("mine", Told::kFailed), 1);
  for (size_t i = 0; i < 1000; ++i) log.Received("base", Of(absl::StrCat(i), Told::kVerified), 2);
  EXPECT_THAT(log.Newest(0), SizeIs(kStrangeReceiptsKept + 1));
  EXPECT_EQ(log.Newest(0).back().receipt.command_id, "mine");
  EXPECT_EQ(log.Newest(0).front().receipt.command_id, "999");
}

TEST(ReceiptLogTest, KeepsALimitedNumber) {
  ReceiptHistory log;
  for (size_t i = 0; i < 2 * kReceiptsKept; ++i) {
    log.Sent("base", Level(absl::StrCat(i)));
    log.Received("base", Of(absl::StrCat(i), Told::kVerified), 1);
  }
  EXPECT_THAT(log.Newest(0), SizeIs(kReceiptsKept));
  EXPECT_EQ(log.Newest(0).front().receipt.command_id, "127");
  EXPECT_EQ(log.Newest(0).back().receipt.command_id, "64");
}

TEST(ReceiptLogTest, ALevelThatIsTriedAgainAndAgainIsNotAll) {
  ReceiptHistory log;
  log.Sent("base", Level("first"));
  log.Received("base", Of("first", Told::kVerified), 1);
  for (size_t i = 0; i < 100; ++i) {
    log.Sent("base", Level(absl::StrCat(i)));
    Receipt receipt = Of(absl::StrCat(i), Told::kFailed);
    receipt.decision_id = {.term = 1, .epoch = 2};
    log.Received("base", receipt, 2);
  }
  EXPECT_THAT(log.Newest(0), SizeIs(kAttemptsKept + 1));
  EXPECT_EQ(log.Newest(0).front().receipt.command_id, "99");
}

TEST(ReceiptLogTest, OnlySoManyCommandsAreRemembered) {
  ReceiptHistory log;
  for (size_t i = 0; i <= kCommandsKnown; ++i) {
    log.Sent("base", Level(absl::StrCat(i)));
    log.Sent("base", Level(absl::StrCat(i)));  // sent again: no second entry
  }
  log.Received("base", Of("0", Told::kVerified), 1);
  log.Received("base", Of("1", Told::kVerified), 1);
  EXPECT_THAT(Commands(log), ElementsAre("base level ALERT", "base unknown command"));
}

TEST(ReceiptLogTest, HostileTextsAreMadeHarmlessAndCut) {
  Receipt receipt = Of("id", Told::kFailed, "\x1b[2J\n\xff");
  receipt.steps = {{.step = std::string(500, 's'), .detail = std::string(5000, 'd')}};
  const Receipt kept = Trimmed(receipt);
  EXPECT_EQ(kept.detail, "\\x1b[2J\\x0a\\xff");
  EXPECT_EQ(kept.steps[0].step, std::string(kStepNameBytesKept - 3, 's') + "...");
  EXPECT_EQ(kept.steps[0].detail.size(), kDetailBytesKept);
  EXPECT_EQ(Harmless("abc", 3), "abc");
  EXPECT_EQ(Harmless("abcd", 3), "...");
  EXPECT_EQ(Harmless("abcd", 2), "");
  EXPECT_EQ(Harmless("\n\n", 7), "\\x0a...");
}

TEST(ReceiptLogTest, FailedStepsKeepTheirWordsWhereThereIsTooMuch) {
  Receipt receipt = Of("id", Told::kFailed);
  for (size_t i = 0; i < 2 * kReceiptStepsKept; ++i) {
    receipt.steps.push_back({.step = "s", .ok = i != 100, .output_tail = std::string(4096, 'o')});
    receipt.steps.back().detail = std::string(1024, 'd');
  }
  receipt.output_tail = absl::StrCat(std::string(64 << 10, 'x'), "the end");
  const Receipt kept = Trimmed(receipt);
  ASSERT_THAT(kept.steps, SizeIs(kReceiptStepsKept));
  EXPECT_EQ(kept.steps[100].detail.size(), 1024u);
  EXPECT_EQ(kept.steps[100].output_tail.size(), 4096u);
  EXPECT_TRUE(kept.output_tail.ends_with("the end"));
  size_t bytes = kept.command_id.size() + kept.detail.size() + kept.output_tail.size();
  for (const StepResult& step : kept.steps) {
    bytes += step.step.size() + step.detail.size() + step.output_tail.size();
  }
  EXPECT_LE(bytes, kReceiptBytesKept);
  EXPECT_EQ(kept.steps.back().detail, "");
}

TEST(ReceiptLogTest, AFailureNamesTheStepsThatFailed) {
  Receipt receipt = Of("id", Told::kFailed, "in short");
  EXPECT_EQ(FailureText(receipt), "in short");
  receipt.steps = {{.step = "system_mode /safety=ALERT", .ok = true},
                   {.step = "program horn", .detail = "exit code 1\n"},
                   {.step = "alarm siren=on"}};
  EXPECT_EQ(FailureText(receipt), "program horn: exit code 1\\x0a; alarm siren=on");
  receipt.steps.assign(200, {.step = "x", .detail = std::string(100, 'y')});
  EXPECT_EQ(FailureText(receipt).size(), kDetailBytesKept);
}

TEST(ReceiptHistoryTest, RecordsWhatMovesACommandOfOursUp) {
  ReceiptHistory log;
  const auto received = [&](const std::string& id, Receipt::Stage stage, const char* detail) {
    return log.Received("base", {.command_id = id, .stage = stage, .detail = detail}, 1);
  };
  EXPECT_EQ(received("unknown", Receipt::Stage::kVerified, ""), nullptr);
  log.Sent("base", {.id = "ours", .what = SetLevel{.to = "ALERT"}});
  const LoggedReceipt* logged = received("ours", Receipt::Stage::kAcknowledged, "a");
  ASSERT_NE(logged, nullptr);
  EXPECT_EQ(logged->command, "level ALERT");
  // A peer that says other words a thousand times a second writes nothing.
  EXPECT_EQ(received("ours", Receipt::Stage::kAcknowledged, "b"), nullptr);
  ASSERT_NE(received("ours", Receipt::Stage::kVerified, "c"), nullptr);
  EXPECT_EQ(received("ours", Receipt::Stage::kVerified, "d"), nullptr);
  EXPECT_EQ(received("ours", Receipt::Stage::kFailed, "e"), nullptr);
}

}  // namespace
}  // namespace rips::pipeline

#include "policy_server/server/operator_api/receipt_codec.h"

#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/operator_api/answer_limits.h"
#include "policy_server/server/robot/actuators/receipt_history.h"
#include "services/rpc/bidi_client.h"

namespace rips::operator_api {
namespace {

TEST(ReceiptCodecTest, AllThatIsKeptFitsIntoOneMessage) {
  pipeline::Receipt receipt{.stage = pipeline::Receipt::Stage::kFailed,
                            .output_tail = std::string(64 << 10, 'x'),
                            .detail = std::string(4096, 'x')};
  for (int i = 0; i < 256; ++i) {
    receipt.steps.push_back({.step = std::string(500, 's'),
                             .took_ms = 0xffffffff,
                             .detail = std::string(4096, '\n'),
                             .output_tail = std::string(4096, 'x')});
  }
  pipeline::ReceiptHistory log;
  for (size_t i = 0; i < pipeline::kReceiptsKept; ++i) {
    receipt.command_id = absl::StrCat("ab", i);
    log.Sent("base", {.id = receipt.command_id, .what = pipeline::Drill{.level = "ALERT"}});
    log.Received("base", receipt, 1);
  }
  rips::v1::ListReceiptsResponse response;
  for (const pipeline::LoggedReceipt& each : log.Newest(0)) Encode(each, response.add_receipts());
  EXPECT_EQ(static_cast<size_t>(response.receipts_size()), pipeline::kReceiptsKept);
  EXPECT_LT(response.ByteSizeLong(), static_cast<size_t>(rpc::kMessageBytesMax));
  EXPECT_GT(response.ByteSizeLong(), pipeline::kReceiptsKept * 40'000);
}

store::ReceiptRecord Record(const std::string& id, const std::string& command) {
  return {.host = "base", .command = command, .receipt = {.command_id = id}};
}

std::vector<std::string> Listed(const std::vector<store::ReceiptRecord>& newest,
                                const std::vector<store::ReceiptRecord>& stored,
                                uint32_t limit = 0) {
  rips::v1::ListReceiptsResponse response;
  Encode(newest, stored, limit, response);
  std::vector<std::string> commands;
  for (const auto& each : response.receipts()) commands.push_back(each.command());
  return commands;
}

TEST(ReceiptListTest, WhatAnActuatorRepeatsAfterARestartDoesNotHideWhatIsStored) {
  EXPECT_THAT(Listed({Record("0c", "level HALT"), Record("0b", "unknown command"),
                      Record("0d", "unknown command")},
                     {Record("0c", "level HALT"), Record("0b", "level ALERT")}),
              ::testing::ElementsAre("level HALT", "unknown command", "level ALERT"));
}

TEST(ReceiptListTest, GivesAsManyAsAreAskedForAndFit) {
  std::vector<store::ReceiptRecord> many;
  for (int i = 0; i < 300; ++i) {
    many.push_back(Record(absl::StrCat(absl::Hex(i, absl::kZeroPad4)), "exec x"));
  }
  EXPECT_EQ(Listed(many, {}).size(), kReceiptsListed);
  EXPECT_EQ(Listed({}, many, 200).size(), 200u);
  EXPECT_EQ(Listed(many, many, 1'000).size(), 300u);
  for (store::ReceiptRecord& each : many) each.receipt.output_tail = std::string(40'000, 'x');
  const size_t fit = Listed(many, {}, 1'000).size();
  EXPECT_GT(fit, 50u);
  EXPECT_LT(fit * 40'000, kAnswerBytesMax);
}

}  // namespace
}  // namespace rips::operator_api

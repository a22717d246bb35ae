#include "policy_server/server/operator_api/receipt_codec.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
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

}  // namespace
}  // namespace rips::operator_api

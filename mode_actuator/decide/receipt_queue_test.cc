#include "mode_actuator/decide/receipt_queue.h"

#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::actuator {
namespace {

using Stage = Receipt::Stage;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

class ReceiptQueueTest : public ::testing::Test {
 protected:
  void Add(const std::string& id, DecisionId decision_id = {}, Stage stage = Stage::kVerified) {
    Receipt receipt;
    receipt.command_id = id;
    receipt.decision_id = decision_id;
    receipt.stage = stage;
    book_.Add(std::move(receipt));
  }
  std::vector<std::string> Flush(int64_t seconds, bool connected = true) {
    std::vector<std::string> sent;
    book_.Flush(seconds * kNanosPerSecond + 1, [&](const Receipt& receipt) {
      if (connected) sent.push_back(receipt.command_id);
      return connected;
    });
    return sent;
  }

  ReceiptQueue book_;
};

TEST_F(ReceiptQueueTest, KeepsWhatCouldNotBeSentHoweverLong) {
  Add("exec");
  EXPECT_THAT(Flush(0, false), IsEmpty());
  EXPECT_THAT(Flush(1'000, false), IsEmpty());
  book_.NewSession();
  EXPECT_THAT(Flush(2'000), ElementsAre("exec"));
  EXPECT_THAT(Flush(2'001), IsEmpty());
}

TEST_F(ReceiptQueueTest, SendsRecentOnesAgainAfterAReconnect) {
  book_.NewSession();
  Add("exec");
  EXPECT_THAT(Flush(0), ElementsAre("exec"));
  book_.NewSession();
  EXPECT_THAT(Flush(29), ElementsAre("exec"));
  Flush(31);
  book_.NewSession();
  EXPECT_THAT(Flush(32), IsEmpty());
  EXPECT_EQ(book_.size(), 0u);
}

TEST_F(ReceiptQueueTest, TheNewestLevelReceiptIsSentOnEveryConnection) {
  book_.NewSession();
  Add("first", {1, 1});
  Add("second", {1, 2}, Stage::kAcknowledged);
  Add("second", {1, 2}, Stage::kVerified);
  EXPECT_THAT(Flush(0), ElementsAre("first", "second"));
  Flush(500);
  book_.NewSession();
  EXPECT_THAT(Flush(1'000), ElementsAre("second"));
}

TEST_F(ReceiptQueueTest, AFailureThatWasMendedIsNotReportedAgainAfterAReconnect) {
  book_.NewSession();
  Add("attempt 1", {1, 2}, Stage::kFailed);
  EXPECT_THAT(Flush(0), ElementsAre("attempt 1"));
  Add("attempt 2", {1, 2}, Stage::kVerified);
  EXPECT_THAT(Flush(1), ElementsAre("attempt 2"));
  book_.NewSession();
  EXPECT_THAT(Flush(2), ElementsAre("attempt 2"));
}

TEST_F(ReceiptQueueTest, HasALimit) {
  for (size_t i = 0; i < kReceiptsKeptMax + 5; ++i) Add(absl::StrCat(i));
  EXPECT_EQ(book_.size(), kReceiptsKeptMax);
  EXPECT_EQ(book_.dropped(), 5u);
}

}  // namespace
}  // namespace rips::actuator

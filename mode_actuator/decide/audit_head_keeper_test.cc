#include "mode_actuator/decide/audit_head_keeper.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using model::AuditHead;
using testing::AllOf;
using testing::HasSubstr;

AuditHead Head(uint64_t segment, uint64_t sequence, char key = 'k', char hash = 'h') {
  return {.segment = segment,
          .public_key = std::string(AuditHead::kKeyBytes, key),
          .sequence = sequence,
          .hash = std::string(AuditHead::kHashBytes, hash),
          .signature = std::string(AuditHead::kSignatureBytes, 's')};
}

TEST(AuditHeadFileTest, ComesBackAsItWasWritten) {
  const AuditHead head = Head(3, 812);
  const auto decoded = DecodeAuditHead(EncodeAuditHead(head));
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_EQ(*decoded, head);
}

TEST(AuditHeadFileTest, EachCutAndEachFlippedBitIsLost) {
  const std::string bytes = EncodeAuditHead(Head(3, 812));
  EXPECT_LE(bytes.size(), kAuditHeadBytesMax);
  for (size_t size = 0; size < bytes.size(); ++size) {
    EXPECT_TRUE(absl::IsDataLoss(DecodeAuditHead(bytes.substr(0, size)).status())) << size;
  }
  for (size_t bit = 0; bit < bytes.size() * 8; ++bit) {
    std::string altered = bytes;
    altered[bit / 8] = static_cast<char>(altered[bit / 8] ^ (1 << (bit % 8)));
    EXPECT_TRUE(absl::IsDataLoss(DecodeAuditHead(altered).status())) << bit;
  }
  EXPECT_TRUE(absl::IsDataLoss(DecodeAuditHead(absl::StrCat(bytes, "\n")).status()));
  EXPECT_TRUE(absl::IsDataLoss(DecodeAuditHead(std::string(1 << 20, 'x')).status()));
}

TEST(AuditHeadFileTest, ANumberThatCannotBeIsLost) {
  for (const AuditHead& head : {Head(UINT64_MAX, 1), Head(1, UINT64_MAX), Head(0, 1), Head(1, 0)}) {
    EXPECT_TRUE(absl::IsDataLoss(DecodeAuditHead(EncodeAuditHead(head)).status()));
  }
}

TEST(AuditHeadKeeperTest, FollowsALogThatGrows) {
  AuditHeadKeeper keeper;
  EXPECT_EQ(keeper.OnLease(Head(1, 5)), "");
  EXPECT_EQ(keeper.OnLease(Head(1, 5)), "");
  EXPECT_EQ(keeper.OnLease(Head(1, 9)), "");
  EXPECT_EQ(keeper.OnLease(Head(2, 10, 'n')), "");
  EXPECT_EQ(keeper.head(), Head(2, 10, 'n'));
}

TEST(AuditHeadKeeperTest, ALeaseWithoutAHeadTakesNothingAway) {
  AuditHeadKeeper keeper(Head(1, 5));
  EXPECT_EQ(keeper.OnLease({}), "");
  EXPECT_EQ(keeper.head(), Head(1, 5));
  EXPECT_FALSE(keeper.TakeWrite(0).has_value());
}

TEST(AuditHeadKeeperTest, SaysThatALogWasPutBackOrReplaced) {
  const struct {
    AuditHead head;
    const char* why;
  } cases[] = {{Head(2, 8), "shorter"},
               {Head(1, 12), "an older segment"},
               {Head(2, 12, 'x'), "another key"},
               {Head(2, 10, 'k', 'x'), "another record in its place"}};
  for (const auto& [head, why] : cases) {
    AuditHeadKeeper keeper(Head(2, 10));
    EXPECT_THAT(keeper.OnLease(head),
                AllOf(HasSubstr("ended at 10:686868"),
                      HasSubstr(absl::StrCat("now ends at ", head.sequence, ":"))))
        << why;
    EXPECT_EQ(keeper.OnLease(head), "") << why;
  }
}

TEST(AuditHeadKeeperTest, IsWrittenAtOnceAndThenEveryTenSeconds) {
  AuditHeadKeeper keeper;
  keeper.OnLease(Head(1, 1));
  EXPECT_EQ(keeper.TakeWrite(0), EncodeAuditHead(Head(1, 1)));
  keeper.OnLease(Head(1, 2));
  EXPECT_FALSE(keeper.TakeWrite(AuditHeadKeeper::kWriteNs - 1).has_value());
  keeper.OnLease(Head(1, 3));
  EXPECT_EQ(keeper.TakeWrite(AuditHeadKeeper::kWriteNs), EncodeAuditHead(Head(1, 3)));
  EXPECT_FALSE(keeper.TakeWrite(3 * AuditHeadKeeper::kWriteNs).has_value());
}

}  // namespace
}  // namespace rips::actuator

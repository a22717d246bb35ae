#include "sensor_agent/ids/log_position.h"

#include <limits>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::sensor {
namespace {

using ::testing::HasSubstr;

LogOffsets Offsets() {
  constexpr uint64_t kMax = std::numeric_limits<uint64_t>::max();
  return {.logs = {{"/var/log/suricata/eve.json", {2049, 77, 4096, Fingerprint("x")}},
                   {"/a b\n\"c\"/\xFF", {0, 0, 0, 0}},
                   {"/max", {kMax, kMax, kMax, kMax}}},
          .unacknowledged = 3};
}

TEST(LogPositionTest, OffsetsReadBack) {
  for (const LogOffsets& offsets : {Offsets(), LogOffsets()}) {
    const auto read = DecodeLogOffsets(EncodeLogOffsets(offsets));
    ASSERT_THAT(read, IsOk());
    EXPECT_EQ(*read, offsets);
  }
}

TEST(LogPositionTest, CutAnywhereIsDataLoss) {
  const std::string text = EncodeLogOffsets(Offsets());
  for (size_t cut = 0; cut < text.size(); ++cut) {
    EXPECT_THAT(DecodeLogOffsets(text.substr(0, cut)), StatusIs(absl::StatusCode::kDataLoss))
        << cut;
  }
}

TEST(LogPositionTest, AnyFlippedBitIsDataLoss) {
  const std::string text = EncodeLogOffsets(Offsets());
  for (size_t bit = 0; bit < text.size() * 8; ++bit) {
    std::string flipped = text;
    flipped[bit / 8] = static_cast<char>(flipped[bit / 8] ^ (1 << (bit % 8)));
    EXPECT_THAT(DecodeLogOffsets(flipped), StatusIs(absl::StatusCode::kDataLoss)) << bit;
  }
}

TEST(LogPositionTest, OtherFilesAreRefusedWithTheReason) {
  EXPECT_THAT(DecodeLogOffsets(""),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("no checksum")));
  std::string other = EncodeLogOffsets({});
  other.replace(other.find('1'), 1, "2");
  other.resize(other.rfind("sum "));
  char sum[32];
  snprintf(sum, sizeof(sum), "sum %016lx\n", static_cast<unsigned long>(Fingerprint(other)));
  EXPECT_THAT(DecodeLogOffsets(other + sum),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("the first line is not")));
}

TEST(LogPositionTest, FingerprintIsFnv1a) {
  EXPECT_EQ(Fingerprint(""), 0xcbf29ce484222325);
  EXPECT_EQ(Fingerprint("a"), 0xaf63dc4c8601ec8c);
}

}  // namespace
}  // namespace rips::sensor

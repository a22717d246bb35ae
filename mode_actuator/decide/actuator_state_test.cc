#include "mode_actuator/decide/actuator_state.h"

#include "absl/strings/str_replace.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

const ActuatorState& Sample() {
  static const auto* state = new ActuatorState{
      .decision_id = {3, 17}, .decided = "ALERT", .effective = "COMPROMISED", .highest_term = 4};
  return *state;
}

TEST(ActuatorStateTest, Crc32HasItsCheckValue) {
  EXPECT_EQ(Crc32("123456789"), 0xcbf43926u);
  EXPECT_EQ(Crc32(""), 0u);
}

TEST(ActuatorStateTest, ReadsBackWhatItWrites) {
  for (const ActuatorState& state :
       {Sample(), ActuatorState{.effective = "HALT"},
        ActuatorState{{UINT64_MAX, UINT64_MAX}, "A", "B", UINT64_MAX}}) {
    const auto decoded = DecodeState(EncodeState(state));
    ASSERT_THAT(decoded, IsOk());
    EXPECT_EQ(*decoded, state);
  }
}

TEST(ActuatorStateTest, HasTheDocumentedForm) {
  EXPECT_EQ(EncodeState(Sample()).substr(0, 87),
            "rips-actuator-state 1\nmark 3.17\ndecided ALERT\neffective COMPROMISED\n"
            "highest_term 4\ncrc ");
}

TEST(ActuatorStateTest, EveryCutIsCorrupt) {
  const std::string bytes = EncodeState(Sample());
  for (size_t length = 0; length < bytes.size(); ++length) {
    EXPECT_THAT(DecodeState(bytes.substr(0, length)), StatusIs(absl::StatusCode::kDataLoss))
        << length;
  }
  EXPECT_THAT(DecodeState(bytes + "\n"), StatusIs(absl::StatusCode::kDataLoss));
  EXPECT_THAT(DecodeState(bytes + bytes), StatusIs(absl::StatusCode::kDataLoss));
}

TEST(ActuatorStateTest, EveryFlippedBitIsCorrupt) {
  const std::string bytes = EncodeState(Sample());
  for (size_t i = 0; i < bytes.size() * 8; ++i) {
    std::string flipped = bytes;
    flipped[i / 8] = static_cast<char>(flipped[i / 8] ^ (1 << (i % 8)));
    EXPECT_THAT(DecodeState(flipped), StatusIs(absl::StatusCode::kDataLoss)) << i;
  }
}

TEST(ActuatorStateTest, AnotherSpellingIsCorruptEvenWithItsOwnChecksum) {
  const std::string other =
      "rips-actuator-state 1\nmark 03.17\ndecided ALERT\neffective HALT\n"
      "highest_term 4\n";
  char crc[16];
  std::snprintf(crc, sizeof(crc), "crc %08x\n", Crc32(other));
  EXPECT_THAT(DecodeState(other + crc), StatusIs(absl::StatusCode::kDataLoss));
}

TEST(ActuatorStateTest, AMissingLevelIsCorrupt) {
  EXPECT_THAT(DecodeState(EncodeState({.decision_id = {1, 1}, .decided = "", .effective = "HALT"})),
              StatusIs(absl::StatusCode::kDataLoss));
  EXPECT_THAT(DecodeState(EncodeState({.decided = "HALT", .effective = "HALT"})),
              StatusIs(absl::StatusCode::kDataLoss));
  EXPECT_THAT(DecodeState(EncodeState({})), StatusIs(absl::StatusCode::kDataLoss));
}

TEST(ActuatorStateTest, HasALimit) {
  EXPECT_THAT(DecodeState(std::string(kStateBytesMax + 1, 'x')),
              StatusIs(absl::StatusCode::kDataLoss));
}

}  // namespace
}  // namespace rips::actuator

#include "mode_actuator/decide/actuator_state.h"

#include <array>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"

namespace rips::actuator {
namespace {

constexpr absl::string_view kMagic = "rips-actuator-state 1";
constexpr absl::string_view kKeys[] = {"mark ", "decided ", "effective ", "highest_term "};

std::string Body(const ActuatorState& state) {
  return absl::StrCat(kMagic, "\n", kKeys[0], ToString(state.decision_id), "\n", kKeys[1],
                      state.decided, "\n", kKeys[2], state.effective, "\n", kKeys[3],
                      state.highest_term, "\n");
}

absl::Status Corrupt(absl::string_view why) {
  return absl::DataLossError(absl::StrCat("the state is corrupt: ", why));
}

}  // namespace

uint32_t Crc32(absl::string_view bytes) {
  static constexpr std::array<uint32_t, 256> kTable = [] {
    std::array<uint32_t, 256> table{};
    for (uint32_t i = 0; i < 256; ++i) {
      uint32_t value = i;
      for (int bit = 0; bit < 8; ++bit) value = (value >> 1) ^ ((value & 1) ? 0xEDB88320u : 0);
      table[i] = value;
    }
    return table;
  }();
  uint32_t crc = 0xFFFFFFFFu;
  for (char c : bytes) crc = (crc >> 8) ^ kTable[(crc ^ static_cast<uint8_t>(c)) & 0xFF];
  return crc ^ 0xFFFFFFFFu;
}

std::string EncodeState(const ActuatorState& state) {
  const std::string body = Body(state);
  return absl::StrCat(body, absl::StrFormat("crc %08x\n", Crc32(body)));
}

absl::StatusOr<ActuatorState> DecodeState(absl::string_view bytes) {
  if (bytes.size() > kStateBytesMax) {
    return Corrupt(absl::StrCat(bytes.size(), " bytes, limit ", kStateBytesMax));
  }
  const std::vector<absl::string_view> lines = absl::StrSplit(bytes, '\n');
  if (lines.size() != 7 || !lines[6].empty()) return Corrupt("not six lines");
  if (lines[0] != kMagic) return Corrupt("unknown format");
  absl::string_view values[4];
  for (int i = 0; i < 4; ++i) {
    values[i] = lines[i + 1];
    if (!absl::ConsumePrefix(&values[i], kKeys[i])) {
      return Corrupt(absl::StrCat("no `", absl::StripTrailingAsciiWhitespace(kKeys[i]), "`"));
    }
  }
  ActuatorState state;
  const absl::StatusOr<DecisionId> decision_id = ParseDecisionId(values[0]);
  if (!decision_id.ok()) return Corrupt("bad decision id");
  state.decision_id = *decision_id;
  state.decided = std::string(values[1]);
  state.effective = std::string(values[2]);
  if (!absl::SimpleAtoi(values[3], &state.highest_term)) return Corrupt("bad term");
  // Written again it must be the same bytes: that covers the checksum and every other spelling.
  if (EncodeState(state) != bytes) return Corrupt("wrong checksum");
  if (state.effective.empty() || state.decided.empty() != state.decision_id.none()) {
    return Corrupt("a level is missing");
  }
  return state;
}

}  // namespace rips::actuator

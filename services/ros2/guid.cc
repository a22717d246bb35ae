#include "services/ros2/guid.h"

#include <algorithm>
#include <cstddef>

#include "absl/status/status.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"

namespace rips::ros2 {
namespace {

constexpr size_t kPrefixBytes = 12;
// DDSI-RTPS 2.5 §9.3.1.3: the entity id of every participant.
constexpr std::array<uint8_t, 4> kParticipantEntity = {0x00, 0x00, 0x01, 0xc1};

int HexDigit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  return -1;
}

}  // namespace

bool Guid::SamePrefix(const Guid& other) const {
  return std::equal(bytes.begin(), bytes.begin() + kPrefixBytes, other.bytes.begin());
}

Guid Guid::Participant() const {
  Guid participant = *this;
  std::copy(kParticipantEntity.begin(), kParticipantEntity.end(),
            participant.bytes.begin() + kPrefixBytes);
  return participant;
}

std::string Guid::ToBytes() const { return std::string(bytes.begin(), bytes.end()); }

std::string ToString(const Guid& guid) {
  const std::string hex = absl::BytesToHexString(guid.ToBytes());
  const absl::string_view all = hex;
  return absl::StrCat(all.substr(0, 8), ".", all.substr(8, 8), ".", all.substr(16, 8), ".",
                      all.substr(24, 8));
}

absl::StatusOr<Guid> ParseGuid(absl::string_view text) {
  const absl::Status bad = absl::InvalidArgumentError(
      "not a GUID; expected four groups of 8 lower-case hex digits joined by dots");
  constexpr size_t kGroupChars = 9;  // 8 digits and a dot
  if (text.size() != 4 * kGroupChars - 1) return bad;
  Guid guid;
  size_t digits = 0;
  for (size_t i = 0; i < text.size(); ++i) {
    if (i % kGroupChars == kGroupChars - 1) {
      if (text[i] != '.') return bad;
      continue;
    }
    const int digit = HexDigit(text[i]);
    if (digit < 0) return bad;
    uint8_t& byte = guid.bytes[digits / 2];
    byte = static_cast<uint8_t>(byte * 16 + digit);
    ++digits;
  }
  return guid;
}

absl::StatusOr<Guid> GuidFromBytes(absl::string_view bytes) {
  Guid guid;
  if (bytes.size() != guid.bytes.size()) {
    return absl::InvalidArgumentError(absl::StrCat("a GUID has 16 bytes, not ", bytes.size()));
  }
  std::copy(bytes.begin(), bytes.end(), guid.bytes.begin());
  return guid;
}

}  // namespace rips::ros2

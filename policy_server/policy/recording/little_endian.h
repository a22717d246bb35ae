// Fields of binary recordings: little endian, bounds checked; and their checksum. Internal to this
// folder.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_LITTLE_ENDIAN_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_LITTLE_ENDIAN_H_

#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/strings/string_view.h"

namespace rips::recording {

// Reads field after field. Past the end everything is 0 or empty, and ok() is false from then on.
// Not thread-safe.
class Cursor {
 public:
  // `bytes` outlive this and the views it gives.
  explicit Cursor(absl::string_view bytes) : rest_(bytes) {}

  uint8_t U8() { return static_cast<uint8_t>(Number(1)); }
  uint16_t U16() { return static_cast<uint16_t>(Number(2)); }
  uint32_t U32() { return static_cast<uint32_t>(Number(4)); }
  uint64_t U64() { return Number(8); }
  absl::string_view Bytes(uint64_t count) {
    if (count > rest_.size()) {
      ok_ = false;
      rest_ = {};
      return {};
    }
    const absl::string_view taken = rest_.substr(0, static_cast<size_t>(count));
    rest_.remove_prefix(static_cast<size_t>(count));
    return taken;
  }
  // A u32 length, then that many bytes.
  absl::string_view Text() { return Bytes(U32()); }
  absl::string_view rest() const { return rest_; }
  bool ok() const { return ok_; }

 private:
  uint64_t Number(size_t bytes) {
    uint64_t number = 0;
    const absl::string_view taken = Bytes(bytes);
    for (size_t i = taken.size(); i > 0; --i) {
      number = number << 8 | static_cast<uint8_t>(taken[i - 1]);
    }
    return number;
  }

  absl::string_view rest_;
  bool ok_ = true;
};

// Appends the `bytes` low bytes of `number`; zeros beyond its eighth.
inline void AppendNumber(uint64_t number, size_t bytes, std::string* out) {
  for (size_t i = 0; i < bytes; ++i, number >>= 8) out->push_back(static_cast<char>(number));
}

// CRC-32 (ISO-HDLC: polynomial 04c11db7 reflected, as in zip and PNG) of what `crc` covers, then
// `bytes`; that of nothing is 0.
uint32_t Crc32(uint32_t crc, absl::string_view bytes);
// CRC-32 of two parts in a row, from the CRC-32 of each; the second is `second_bytes` long.
uint32_t CombineCrc32(uint32_t first, uint32_t second, uint64_t second_bytes);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_LITTLE_ENDIAN_H_

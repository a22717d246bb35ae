#include "policy_server/policy/recording/little_endian.h"

#include <zlib.h>

namespace rips::recording {

uint32_t Crc32(uint32_t crc, absl::string_view bytes) {
  // A null pointer would ask for the start value.
  if (bytes.empty()) return crc;
  return static_cast<uint32_t>(
      crc32_z(crc, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

uint32_t CombineCrc32(uint32_t first, uint32_t second, uint64_t second_bytes) {
  return static_cast<uint32_t>(crc32_combine(first, second, static_cast<z_off_t>(second_bytes)));
}

}  // namespace rips::recording

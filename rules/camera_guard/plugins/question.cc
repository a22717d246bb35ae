#include "rules/camera_guard/plugins/question.h"

#include <charconv>
#include <system_error>

namespace rips::camera_guard {
namespace {

constexpr char kPayloadBytesKey[] = "\"payload_bytes\":";

bool ReadAll(std::FILE* input, void* to, size_t size) {
  return std::fread(to, 1, size, input) == size;
}

}  // namespace

std::optional<uint32_t> PayloadBytes(const std::string& header) {
  size_t at = header.find(kPayloadBytesKey);
  if (at == std::string::npos) return std::nullopt;
  at += sizeof(kPayloadBytesKey) - 1;
  while (at < header.size() && header[at] == ' ') ++at;
  uint32_t value = 0;
  const char* end = header.data() + header.size();
  const std::from_chars_result result = std::from_chars(header.data() + at, end, value);
  if (result.ec != std::errc() || value > kPayloadBytesMax) return std::nullopt;
  if (result.ptr == end || (*result.ptr != ',' && *result.ptr != '}')) return std::nullopt;
  return value;
}

std::optional<std::vector<uint8_t>> ReadPayload(std::FILE* input) {
  uint8_t size_bytes[4];
  if (!ReadAll(input, size_bytes, sizeof(size_bytes))) return std::nullopt;
  uint32_t header_bytes = 0;
  for (int i = 3; i >= 0; --i) header_bytes = header_bytes << 8 | size_bytes[i];
  if (header_bytes > kHeaderBytesMax) return std::nullopt;
  std::string header(header_bytes, '\0');
  if (!ReadAll(input, header.data(), header.size())) return std::nullopt;
  const std::optional<uint32_t> payload_bytes = PayloadBytes(header);
  if (!payload_bytes) return std::nullopt;
  std::vector<uint8_t> payload(*payload_bytes);
  if (!ReadAll(input, payload.data(), payload.size())) return std::nullopt;
  return payload;
}

}  // namespace rips::camera_guard

// The plugin's side of the framed protocol: greeting, questions, answers.
#ifndef RIPS_RULES_CAMERA_GUARD_PLUGINS_QUESTION_H_
#define RIPS_RULES_CAMERA_GUARD_PLUGINS_QUESTION_H_

#include <cstdint>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

namespace rips::camera_guard {

inline constexpr uint32_t kHeaderBytesMax = 64 << 10;
inline constexpr uint32_t kPayloadBytesMax = 64 << 20;

// The number behind "payload_bytes": in the JSON header; nullopt if there is none or it exceeds
// kPayloadBytesMax. The quote and colon that are looked for cannot stand so inside a JSON string,
// where a quote has a backslash before it, so that no topic's name can pose as the number.
std::optional<uint32_t> PayloadBytes(const std::string& header);

// Reads one question: u32 little endian, header, payload. nullopt at the end of input, also in the
// middle of a question, and for one that breaks a limit.
std::optional<std::vector<uint8_t>> ReadPayload(std::FILE* input);

}  // namespace rips::camera_guard

#endif  // RIPS_RULES_CAMERA_GUARD_PLUGINS_QUESTION_H_

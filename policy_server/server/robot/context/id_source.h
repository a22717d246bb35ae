// Ids of what a robot's core makes: alerts, transitions, commands. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ID_SOURCE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ID_SOURCE_H_

#include <cstdint>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace rips::pipeline {

// Ids of 32 hex digits, each once. They look drawn at random, so that a few of their digits tell
// them apart (`ripsctl explain 8c1f0a2b`); no secret may depend on them.
class IdSource {
 public:
  // `seed`: 32 hex digits, drawn at random; another one for each start of a robot.
  explicit IdSource(absl::string_view seed) : high_(Fold(seed, 1)), low_(Fold(seed, 2)) {}

  std::string Next() {
    ++count_;
    // Both halves are one-to-one in the count.
    return absl::StrCat(absl::Hex(Mix(high_ + count_), absl::kZeroPad16),
                        absl::Hex(Mix(low_ + count_), absl::kZeroPad16));
  }

 private:
  // One-to-one; every digit of the result depends on every bit of `x`.
  static uint64_t Mix(uint64_t x) {
    for (int i = 0; i < 3; ++i) {
      x ^= x >> 32;
      x *= 0xd6e8feb86659fd93;  // odd
    }
    return x ^ (x >> 32);
  }
  static uint64_t Fold(absl::string_view text, uint64_t folded) {
    for (const char c : text) folded = Mix(folded + static_cast<unsigned char>(c));
    return folded;
  }

  uint64_t high_;
  uint64_t low_;
  uint64_t count_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ID_SOURCE_H_

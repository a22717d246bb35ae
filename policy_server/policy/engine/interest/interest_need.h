// What a plan of interest asks for of one topic, as a sensor reads it.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_INTEREST_NEED_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_INTEREST_NEED_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/interest/interest.h"

namespace re2 {
class RE2;
}  // namespace re2

namespace rips::engine {

// What sensors are asked to send, all told.
struct Interest {
  InterestPlan plan;
  PayloadLimits limits;

  friend bool operator==(const Interest&, const Interest&) = default;
};

struct Need {
  Depth depth = Depth::kNothing;
  // First bytes of the payload; 0 unless kPayload.
  uint32_t payload_bytes = 0;

  friend bool operator==(const Need&, const Need&) = default;
};

// Not thread-safe.
class InterestReader {
 public:
  // Answers that are remembered; past them it begins anew, since anyone on the robot can make up
  // topic names.
  static constexpr size_t kTopicsMax = 4'096;

  // Compiles the patterns. One that is not a pattern is taken to match every topic.
  explicit InterestReader(const Interest& interest);
  ~InterestReader();

  Need Of(absl::string_view topic);
  // RE2 instructions of all patterns; past kInterestInstructionsMax if one is not a pattern.
  size_t instructions() const { return instructions_; }

 private:
  // Null = every topic.
  using Pattern = std::unique_ptr<const re2::RE2>;

  Pattern Compiled(const std::string& regex);
  Need Find(absl::string_view topic) const;

  size_t instructions_ = 0;
  std::vector<std::pair<Pattern, Need>> plan_;
  std::vector<std::pair<Pattern, uint32_t>> limits_;
  absl::flat_hash_map<std::string, Need> known_;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_INTEREST_NEED_H_

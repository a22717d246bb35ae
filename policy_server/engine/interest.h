// What a robot's sensors must tell so that the rules can be judged: which topics need more than
// metadata. Derived from the rules alone.
#ifndef RIPS_POLICY_SERVER_ENGINE_INTEREST_H_
#define RIPS_POLICY_SERVER_ENGINE_INTEREST_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "policy_server/lang/checked_rules.h"

namespace rips::engine {

// Messages of these topics are needed with the first bytes of their payload.
struct TopicInterest {
  // RE2, searched in the topic name; empty = every topic.
  std::string topic_regex;
  // Bytes that are enough.
  uint32_t payload_bytes_max = 0;

  friend bool operator==(const TopicInterest&, const TopicInterest&) = default;
};

// Past either, one interest in all topics takes the place of the many.
inline constexpr size_t kInterestsMax = 256;
// RE2 instructions of all patterns together: sensors hold them in memory.
inline constexpr size_t kInterestInstructionsMax = 100'000;

// The topics on which a message rule may ask about a payload, in its condition or in an argument of
// its actions: never too few, perhaps too many. Sorted by regex, distinct; none if no rule asks.
std::vector<TopicInterest> PayloadInterest(const lang::CheckedRules& rules,
                                           uint32_t payload_bytes_max);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_ENGINE_INTEREST_H_

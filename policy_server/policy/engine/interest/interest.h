// What a robot's sensors must tell so that the rules can be judged: of which topics nothing, of
// which metadata, of which payloads too. Derived from the rules alone.
//
// Rules judge the same, in the same way, whether they are given every message or only those that
// the plan asks for:
//   - A message is asked for if a message rule may fire, fault or count on its topic. What such a
//     rule does to variables is therefore seen by all rules.
//   - Graph and External rules need no messages.
//   - /rosout and /parameter_events are busy and seldom meant: their messages are asked for only if
//     a message rule names the topic as a literal in `topicin`.
// Two things differ by what is not asked for: `Time`, which never goes back, may have been carried
// further by a message that is not asked for; and the counts of a topic begin anew when rules come
// into force that ask for it for the first time.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_INTEREST_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_INTEREST_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "policy_server/policy/lang/checked_rules.h"

namespace rips::engine {

// Each holds what is before it.
enum class Depth { kNothing, kMetadata, kPayload };

// What is needed of some topics. Types are never told apart: `msgtypein` and `msgsubtype` ask for
// all types of a topic, of which a message has one.
struct TopicInterest {
  // RE2, searched in the topic name; empty = every topic.
  std::string topic_regex;
  Depth depth = Depth::kMetadata;
  // First bytes of the payload that are enough; 0 unless kPayload.
  uint32_t payload_bytes_max = 0;
  // Names of message rules that are a reason for it, sorted, the first kWantedByMax.
  std::vector<std::string> wanted_by;

  friend bool operator==(const TopicInterest&, const TopicInterest&) = default;
};

// The first match wins. The last one is about every topic.
using InterestPlan = std::vector<TopicInterest>;

// Payloads of topics of which these many bytes are asked for, instead of the plan's.
struct PayloadLimit {
  // RE2, searched in the topic name.
  std::string topic_regex;
  uint32_t bytes = 0;

  friend bool operator==(const PayloadLimit&, const PayloadLimit&) = default;
};

// The first match wins; without one, the plan's payload_bytes_max counts.
using PayloadLimits = std::vector<PayloadLimit>;

// Past one of these more is asked for than is needed, never less: of topics that are named, or of
// all topics.
inline constexpr size_t kInterestsMax = 256;
// RE2 instructions of all patterns together: sensors hold them in memory.
inline constexpr size_t kInterestInstructionsMax = 100'000;
// Rules times named topics that are looked at one by one.
inline constexpr size_t kInterestForecastsMax = 1 << 20;

inline constexpr size_t kWantedByMax = 100;

InterestPlan PlanInterest(const lang::CheckedRules& rules, uint32_t payload_bytes_max);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_INTEREST_H_

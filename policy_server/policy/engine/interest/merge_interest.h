// One interest that serves two policies.
//
// Of every topic the merged one asks for at least what each of both asks for alone:
//
//   a topic that one of both names   exactly what the deeper asks for
//   a topic of a pattern             what the deepest pattern asks for that it matches, so that an
//                                    exception that a pattern makes from a later one is lost
//   a payload                        as many bytes as the one that wants more; where the limits of
//                                    both differ, a limit of one is not below the other's default
//   past a limit of interest.h,      the deepest depth of all topics, and the most bytes; topics
//   or of payload limits             that `first` names stay named, those of `second` if there is
//                                    room
//
// The order is that of `first`, then that of `second`: merged with itself an interest stays as it
// is, so that sensors need not be asked anew.
//
// Sensors read topics that their owner excludes only if the interest names them. Therefore a name
// that asks for messages stays, also where a pattern asks for as much.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_MERGE_INTEREST_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_MERGE_INTEREST_H_

#include <cstddef>

#include "policy_server/policy/engine/interest/interest.h"
#include "policy_server/policy/engine/interest/interest_need.h"
#include "services/ros2/graph_limits.h"

namespace rips::engine {

// Entries of a merged plan: two plans of PlanInterest fit. Sensors take 1,024. For the instructions
// of its patterns, and those of its limits, kInterestInstructionsMax counts.
inline constexpr size_t kMergedInterestsMax = 2 * kInterestsMax;

// Takes as long as compiling the patterns of both. Reasons (`wanted_by`) are those of both, as far
// as kWantedByMax allows.
Interest MergeInterest(const Interest& first, const Interest& second);

// Those of `first`, and then those of `second` in the order of their names, up to
// ros2::kKeptTopicsMax.
ros2::TopicNames MergeKeptTopics(const ros2::TopicNames& first, const ros2::TopicNames& second);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_MERGE_INTEREST_H_

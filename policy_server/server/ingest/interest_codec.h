// What sensors are asked to watch, as rips.v1.Interest.
#ifndef RIPS_POLICY_SERVER_SERVER_INGEST_INTEREST_CODEC_H_
#define RIPS_POLICY_SERVER_SERVER_INGEST_INTEREST_CODEC_H_

#include <cstddef>

#include "policy_server/policy/engine/interest/interest.h"
#include "rips/v1/sensor.pb.h"
#include "services/ros2/graph_limits.h"

namespace rips::ingest {

// Of an id: SHA-256.
inline constexpr size_t kInterestIdBytes = 32;

// Without the reasons. Plans and limits that ask for the same, in the same order, give equal ids if
// the topics are the same.
rips::v1::Interest EncodeInterest(const engine::InterestPlan& plan,
                                  const engine::PayloadLimits& limits = {},
                                  const ros2::TopicNames& kept_topics = {});

}  // namespace rips::ingest

#endif  // RIPS_POLICY_SERVER_SERVER_INGEST_INTEREST_CODEC_H_

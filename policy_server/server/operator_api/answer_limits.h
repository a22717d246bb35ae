// Keeps answers to operators below what a gRPC client takes (4 MiB), whatever agents and rules say:
// what does not fit is left out, and the answer says so. Nothing here makes a whole answer fail.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ANSWER_LIMITS_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ANSWER_LIMITS_H_

#include <cstddef>

#include "google/protobuf/message_lite.h"
#include "policy_server/server/robot/ports.h"
#include "rips/v1/operator.pb.h"

namespace rips::operator_api {

// Serialized, of one answer.
inline constexpr size_t kAnswerBytesMax = size_t{3} << 20;
// Texts of one robot's status that are shown, and bytes of each. All robots of a fleet may have as
// many: FitStatuses.
inline constexpr size_t kDegradedShownMax = 64;
inline constexpr size_t kDegradedShownBytesMax = 512;

// What is left of an answer's bytes. Not thread-safe.
class AnswerRoom {
 public:
  explicit AnswerRoom(size_t bytes = kAnswerBytesMax) : left_(bytes) {}

  // False: it does not fit any more, nor does anything after it.
  bool Take(const google::protobuf::MessageLite& element);
  size_t left() const { return left_; }

 private:
  size_t left_;
};

rips::v1::Maintenance Encode(const store::Maintenance& maintenance);
// `degraded` as far as the limits above let, else `degraded_cut`.
rips::v1::RobotStatus EncodeStatus(const pipeline::RobotStatus& status);
// Where all together would be too long, robots with more than an equal share of the room lose their
// texts (`degraded_cut`), and if that is not enough their agents and the end of a maintenance's
// reason. Every robot stays.
void FitStatuses(rips::v1::ListRobotsResponse& response, size_t bytes_max = kAnswerBytesMax);
// Drops endpoints from the end, then nodes, then participants, until the rest fits; counts them.
void FitGraph(rips::v1::GetGraphResponse& response, size_t bytes_max = kAnswerBytesMax);

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ANSWER_LIMITS_H_

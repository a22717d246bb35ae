// What a robot's rules need and what is seen of it, as operators are told. On the robot's thread.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_COVERAGE_CODEC_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_COVERAGE_CODEC_H_

#include "policy_server/server/robot/robot.h"
#include "rips/v1/operator.pb.h"

namespace rips::operator_api {

// Into an empty `out`, at most kAnswerBytesMax.
void EncodeInterest(const pipeline::Robot& robot, rips::v1::GetInterestResponse& out);
void EncodeCoverage(const pipeline::Robot& robot, const rips::v1::GetCoverageRequest& request,
                    rips::v1::GetCoverageResponse& out);
// The status and, in brief, the findings that stand.
rips::v1::RobotStatus EncodeListed(const pipeline::Robot& robot);

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_COVERAGE_CODEC_H_

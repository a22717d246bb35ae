// Bundles and roll-outs, as operators see them.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RULES_CODEC_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RULES_CODEC_H_

#include <string>
#include <vector>

#include "policy_server/server/rollout/bundle_control.h"
#include "rips/v1/operator.pb.h"

namespace rips::operator_api {

rollout::RobotSelection Decode(const rips::v1::RobotSelection& in);
// Without operator.
rollout::ActivateOrder Decode(const rips::v1::ActivateBundleRequest& in);

rips::v1::StoredBundle Encode(const rollout::KeptBundle& bundle);
// With the robots that each judges; what does not fit is left out.
void Encode(const std::vector<rollout::KeptBundle>& bundles, const rollout::RulesStatus& status,
            rips::v1::ListBundlesResponse& out);
rips::v1::ShadowReport Encode(const shadow::ShadowReport& report);
rips::v1::RobotRules Encode(const rollout::RobotRules& rules);
void Encode(const rollout::RolloutAnswer& answer, rips::v1::RolloutResponse& out);
// What does not fit is left out, and said so.
void Encode(const rollout::RulesStatus& status, rips::v1::GetRulesStatusResponse& out);

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RULES_CODEC_H_

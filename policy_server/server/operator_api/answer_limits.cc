#include "policy_server/server/operator_api/answer_limits.h"

#include <algorithm>
#include <cstdint>
#include <string>

#include "services/base/cut_text.h"
#include "services/model_proto/decision_id_codec.h"

namespace rips::operator_api {
namespace {

// Tag and length of an element.
constexpr size_t kElementBytesMax = 8;
// Of a reason, where there is no room for more.
constexpr size_t kReasonBytesCut = 64;

}  // namespace

bool AnswerRoom::Take(const google::protobuf::MessageLite& element) {
  const size_t bytes = element.ByteSizeLong() + kElementBytesMax;
  if (bytes > left_) {
    left_ = 0;
    return false;
  }
  left_ -= bytes;
  return true;
}

rips::v1::Maintenance Encode(const store::Maintenance& maintenance) {
  rips::v1::Maintenance out;
  out.set_began_unix_ns(maintenance.began_unix_ns);
  out.set_until_unix_ns(maintenance.until_unix_ns);
  out.set_operator_(maintenance.by);
  out.set_reason(maintenance.reason);
  return out;
}

rips::v1::RobotStatus EncodeStatus(const pipeline::RobotStatus& status) {
  rips::v1::RobotStatus out;
  out.set_robot(status.robot);
  out.set_decided_level(status.decided_level);
  out.set_effective_level(status.effective_level);
  out.set_stage(status.stage);
  model_proto::Encode(status.decision_id, *out.mutable_decision_id());
  out.set_bundle_version(status.bundle_version);
  out.set_pending_approvals(static_cast<uint32_t>(status.pending_approvals.size()));
  const size_t shown = std::min(status.degraded.size(), kDegradedShownMax);
  out.set_degraded_cut(shown < status.degraded.size());
  for (size_t i = 0; i < shown; ++i) {
    const std::string& text = status.degraded[i];
    out.add_degraded(Shortened(text, kDegradedShownBytesMax));
    if (text.size() > kDegradedShownBytesMax) out.set_degraded_cut(true);
  }
  if (status.maintenance) *out.mutable_maintenance() = Encode(*status.maintenance);
  return out;
}

void FitStatuses(rips::v1::ListRobotsResponse& response, size_t bytes_max) {
  if (response.robots_size() == 0 || response.ByteSizeLong() <= bytes_max) return;
  const size_t others =
      static_cast<size_t>(response.robots_size()) + static_cast<size_t>(response.no_answer_size());
  const size_t share = bytes_max / others;
  for (rips::v1::RobotStatus& status : *response.mutable_robots()) {
    if (status.ByteSizeLong() + kElementBytesMax <= share) continue;
    status.clear_degraded();
    status.set_degraded_cut(true);
    if (status.ByteSizeLong() + kElementBytesMax <= share) continue;
    status.clear_agents();
    if (!status.has_maintenance()) continue;
    std::string& reason = *status.mutable_maintenance()->mutable_reason();
    reason = Shortened(reason, kReasonBytesCut);
  }
}

void FitGraph(rips::v1::GetGraphResponse& response, size_t bytes_max) {
  size_t bytes = response.ByteSizeLong();
  uint64_t left_out = 0;
  const auto drop = [&](auto& list) {
    while (bytes > bytes_max && !list.empty()) {
      bytes -= std::min(bytes, list.rbegin()->ByteSizeLong());
      list.RemoveLast();
      ++left_out;
    }
  };
  drop(*response.mutable_graph()->mutable_endpoints());
  drop(*response.mutable_graph()->mutable_nodes());
  drop(*response.mutable_graph()->mutable_participants());
  response.set_left_out(left_out);
}

}  // namespace rips::operator_api

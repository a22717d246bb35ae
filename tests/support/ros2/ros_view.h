// Which node each endpoint of a bus has, as the tools of ROS find it. Test code only.
#ifndef RIPS_TESTS_SUPPORT_ROS2_ROS_VIEW_H_
#define RIPS_TESTS_SUPPORT_ROS2_ROS_VIEW_H_

#include <cstddef>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "gtest/gtest.h"
#include "services/dds/discovery.h"
#include "services/dds/participant.h"
#include "services/dds/raw_reader.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/mutex.h"
#include "tests/support/ros2/server_messages.h"

namespace rips::dds {

// The bus as a ROS process sees it, which knows claims by their writer: endpoints of other
// participants, and the newest claim of each. Reads only the form of gids that it was built for.
class RosView {
 public:
  RosView(const Participant& participant, ros2::GidBytes form) : form_(form) {
    auto claims = RawReader::Create(participant,
                                    {.topic = ros2::kDiscoveryTopic,
                                     .type = ros2::kDiscoveryType,
                                     .reliable_transient_local = true,
                                     .keep_all = true,
                                     .every_partition = false},
                                    [this](const RawSample& sample) { OnClaim(sample); });
    EXPECT_TRUE(claims.ok()) << claims.status();
    claims_ = *std::move(claims);
    auto discovery = Discovery::Create(
        participant, {.on_participant = [](const ParticipantSeen&) {},
                      .on_endpoint = [this, own = participant.guid()](
                                         const EndpointSeen& seen) { OnEndpoint(seen, own); }});
    EXPECT_TRUE(discovery.ok()) << discovery.status();
    discovery_ = *std::move(discovery);
  }
  ~RosView() {
    discovery_.reset();
    claims_.reset();
  }

  // The node of an endpoint, `_NODE_NAME_UNKNOWN_` as `ros2 topic info -v` has it, empty if the
  // endpoint is not there.
  std::string NodeOf(const ros2::Guid& endpoint) {
    MutexLock lock(&mu_);
    return endpoints_.contains(endpoint) ? NodeOfLocked(endpoint) : "";
  }
  // Of the ROS endpoints of a participant.
  std::vector<std::string> NodesOf(const ros2::Guid& participant) {
    MutexLock lock(&mu_);
    std::vector<std::string> nodes;
    for (const ros2::Guid& each : endpoints_) {
      if (each.SamePrefix(participant)) nodes.push_back(NodeOfLocked(each));
    }
    return nodes;
  }
  size_t claims() {
    MutexLock lock(&mu_);
    return claims_heard_;
  }
  bool HasClaimOf(const ros2::Guid& participant) {
    MutexLock lock(&mu_);
    return newest_.contains(participant);
  }

 private:
  void OnClaim(const RawSample& sample) {
    auto decoded = ros2::DecodeParticipantEntities(sample.payload);
    EXPECT_TRUE(decoded.ok()) << decoded.status();
    if (!decoded.ok()) return;
    EXPECT_TRUE(ros2::CheckOrigin(*decoded, sample.writer).ok());
    MutexLock lock(&mu_);
    ++claims_heard_;
    // To one who reads the other form it names no node.
    if (decoded->gid_bytes != form_) decoded->nodes.clear();
    newest_[sample.writer.Participant()] = *decoded;
  }
  void OnEndpoint(const EndpointSeen& seen, const ros2::Guid& own) {
    if (seen.guid.SamePrefix(own)) return;
    MutexLock lock(&mu_);
    if (!seen.alive) {
      endpoints_.erase(seen.guid);
    } else if (ros2::DemangleTopic(seen.topic).kind != ros2::DdsTopicKind::kOther) {
      endpoints_.insert(seen.guid);
    }
  }
  std::string NodeOfLocked(const ros2::Guid& endpoint) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    const auto claim = newest_.find(endpoint.Participant());
    if (claim != newest_.end()) {
      for (const ros2::NodeEntities& node : claim->second.nodes) {
        for (const auto* list : {&node.readers, &node.writers}) {
          for (const ros2::Guid& each : *list) {
            if (each == endpoint) return ros2::JoinNodeName(node.node_namespace, node.node_name);
          }
        }
      }
    }
    return "_NODE_NAME_UNKNOWN_";
  }

  const ros2::GidBytes form_;
  Mutex mu_;
  std::set<ros2::Guid> endpoints_ ABSL_GUARDED_BY(mu_);
  std::map<ros2::Guid, ros2::ParticipantEntities> newest_ ABSL_GUARDED_BY(mu_);
  size_t claims_heard_ ABSL_GUARDED_BY(mu_) = 0;
  std::unique_ptr<RawReader> claims_;
  std::unique_ptr<Discovery> discovery_;
};

}  // namespace rips::dds

#endif  // RIPS_TESTS_SUPPORT_ROS2_ROS_VIEW_H_

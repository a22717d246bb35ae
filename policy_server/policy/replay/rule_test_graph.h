// The graph of a unit test of rules: from its YAML, with GUIDs that are made up. Internal to this
// folder.
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_TEST_GRAPH_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_TEST_GRAPH_H_

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/recording/recorded.h"
#include "services/ros2/ros_graph.h"
#include "services/runtime/config_reader.h"

namespace rips::replay {

// Of one test. Not thread-safe.
class RuleTestGraph {
 public:
  // The graph under `graph` (rule_test_file.h says how it looks); what was before is forgotten.
  // Problems are reported there.
  recording::RecordedGraph Read(const ConfigSection& graph);

  // The first type of the topic; empty if the graph has none.
  std::string TypeOf(absl::string_view topic) const;
  // The endpoint with which `node` publishes on `topic`, or a GUID made up for the two: the same
  // each time. None for an empty `node`.
  ros2::Guid WriterOf(absl::string_view node, absl::string_view topic);

 private:
  // Nodes of one name, and whose turn it is to have the next endpoint on a topic.
  using Participants = std::vector<ros2::Guid>;

  void ReadTopics(const ConfigSection& graph);
  void ReadServices(const ConfigSection& graph);
  void AddEndpoints(const ConfigSection& section, absl::string_view key,
                    const ros2::Endpoint& pattern);
  void AddEndpoint(const ros2::Guid& participant, ros2::Endpoint endpoint);
  ros2::Guid NewParticipant();

  ros2::GraphDelta delta_;
  ros2::RosGraph graph_;
  absl::btree_map<std::string, Participants> nodes_;
  absl::btree_map<std::pair<std::string, std::string>, ros2::Guid> writers_;
  uint32_t last_participant_ = 0;
  uint32_t last_endpoint_ = 0;
};

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_TEST_GRAPH_H_

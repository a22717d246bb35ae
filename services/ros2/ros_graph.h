// The computation graph of one robot: participants, nodes and endpoints, and the questions that
// rules ask of it (RIPS paper, "Expressions"). The sensor builds one from discovery; the server
// keeps one per robot from snapshots and deltas.
#ifndef RIPS_SERVICES_ROS2_ROS_GRAPH_H_
#define RIPS_SERVICES_ROS2_ROS_GRAPH_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/btree_set.h"
#include "absl/container/flat_hash_map.h"
#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "services/ros2/graph_limits.h"
#include "services/ros2/guid.h"

namespace rips::ros2 {

struct Participant {
  Guid guid;
  // Self-declared.
  std::string host;
  std::string enclave;
  uint32_t pid = 0;
  // RTPS vendor id, 4 hex digits.
  std::string vendor;
  bool authenticated = false;
  // An IP address where it says that it is reached; self-declared, empty if it does not.
  std::string address;

  friend bool operator==(const Participant&, const Participant&) = default;
};

struct Node {
  // Fully qualified: "/ns/name".
  std::string full_name;
  Guid participant;

  friend auto operator<=>(const Node&, const Node&) = default;
};

enum class EndpointKind { kPublisher, kSubscriber, kService, kClient };
enum class Visibility { kUnspecified, kWatched, kNotNeeded, kNotVisible };

struct Qos {
  bool reliable = false;
  bool transient_local = false;
  bool keep_all = false;
  uint32_t depth = 0;
  std::vector<std::string> partitions;

  friend bool operator==(const Qos&, const Qos&) = default;
};

struct Endpoint {
  Guid guid;
  EndpointKind kind = EndpointKind::kPublisher;
  // ROS topic or service name with leading slash; the DDS topic name if !ros.
  std::string name;
  // ROS type, "std_msgs/msg/String"; the DDS type name if !ros.
  std::string type;
  // Full name of the owning node; empty = not attributed.
  std::string node;
  // Within the attribution grace: left out of every answer below.
  bool pending = false;
  Qos qos;
  Visibility visibility = Visibility::kUnspecified;
  std::string why;
  bool ros = true;

  friend bool operator==(const Endpoint&, const Endpoint&) = default;
};

// A change. What is gone is applied before what is upserted.
struct GraphDelta {
  std::vector<Participant> upsert_participants;
  std::vector<Node> upsert_nodes;
  std::vector<Endpoint> upsert_endpoints;
  // Participants (with their nodes and endpoints) and endpoints. Unknown ones are ignored.
  std::vector<Guid> gone_guids;
  // Every node of that name goes; survivors are upserted again.
  std::vector<std::string> gone_nodes;
  // What the sender's limits leave out of the graph from now on; nullopt = as before.
  std::optional<Truncation> truncation;

  bool empty() const {
    return upsert_participants.empty() && upsert_nodes.empty() && upsert_endpoints.empty() &&
           gone_guids.empty() && gone_nodes.empty() && !truncation.has_value();
  }
};

// What is asked of one topic. One entry per endpoint: two publishers in one node give two. An
// endpoint that is past its grace and has no node stands as "(unattributed GUID)".
struct Topic {
  // Sorted.
  std::vector<std::string> publishers;
  std::vector<std::string> subscribers;
  // Distinct, sorted; a topic whose endpoints disagree has several.
  std::vector<std::string> types;
};

// Not thread-safe. Copyable. Only ROS endpoints (Endpoint::ros) that are not pending count in
// answers.
class RosGraph {
 public:
  explicit RosGraph(GraphLimits limits = {}) : limits_(limits) {}

  // Applies `delta` whole or not at all. InvalidArgument if, afterwards, a node would name an
  // unknown participant or an endpoint an unknown node or participant, or a name is malformed.
  // Past a limit (graph_limits.h) the excess is left out, counted in dropped(), and truncated() is
  // true from then on until Clear(); then unknown references are left out and counted too, since
  // what they name may have been. An endpoint whose node was left out stays, unattributed.
  absl::Status Apply(const GraphDelta& delta);
  // Keeps limits, kept topics and observer.
  void Clear();

  // Endpoints of these topics are kept first. What was left out before stays left out.
  void SetKeptTopics(std::shared_ptr<const TopicNames> topics);
  // The participant that subscribes to every topic of others: only GraphLimits::topics holds for
  // its endpoints, beside those of others.
  void SetObserver(const Guid& participant);
  const GraphLimits& limits() const { return limits_; }

  // What turns `from` into `to`; Apply(Diff(a, b)) on a gives b, in which all that is left out is
  // the sender's doing.
  static GraphDelta Diff(const RosGraph& from, const RosGraph& to);

  const absl::btree_map<Guid, Participant>& participants() const { return participants_; }
  const absl::btree_set<Node>& nodes() const { return nodes_; }
  const absl::btree_map<Guid, Endpoint>& endpoints() const { return endpoints_; }

  // Topics that have a publisher or a subscriber, by name.
  const absl::btree_map<std::string, Topic>& topics() const { return topics_; }
  // Null if no endpoint publishes or subscribes.
  const Topic* FindTopic(absl::string_view name) const;
  // Services offered by the nodes of that full name, sorted; two nodes of one name are merged.
  std::vector<std::string> ServicesOf(absl::string_view node) const;
  const Endpoint* FindEndpoint(const Guid& guid) const;

  // Something was left out, here or by the sender: "exactly these" cannot be answered with yes.
  bool truncated() const { return left_out() > 0; }
  // At least as many participants, nodes and endpoints as are missing.
  uint64_t left_out() const;
  // Left out here.
  uint64_t dropped() const { return dropped_; }
  // Here and by the sender.
  Truncation truncation() const;
  // An eighth of each limit is free: a truncated graph that is sent anew may be whole.
  bool HasRoom() const;

 private:
  // What one participant holds of the limits.
  struct Share {
    size_t endpoints = 0;
    // Of topics that are not kept first.
    size_t unkept = 0;
    size_t nodes = 0;
    uint64_t left_out = 0;
  };

  absl::Status Check(const GraphDelta& delta) const;
  void ApplyNode(const Node& node);
  void ApplyEndpoint(Endpoint endpoint);
  bool IsKept(const Endpoint& endpoint) const;
  // False if there is none; evicts an endpoint for one that is kept.
  bool MakeRoom(const Guid& participant, bool kept);
  // Of the participant with the most that may go.
  bool EvictFromLargest();
  bool EvictFrom(const Guid& participant);
  void LeaveOut(const Guid& participant);
  void CountEndpoint(const Endpoint& endpoint, bool gone);
  void RecountEndpoints();
  absl::btree_map<Guid, Endpoint>::iterator Erase(absl::btree_map<Guid, Endpoint>::iterator at);
  void RemoveParticipant(const Guid& guid);
  void RemoveEndpoint(const Guid& guid);
  // False if the topic would be one too many.
  bool Index(const Endpoint& endpoint);
  void Unindex(const Endpoint& endpoint);

  GraphLimits limits_;
  absl::btree_map<Guid, Participant> participants_;
  absl::btree_set<Node> nodes_;
  absl::btree_map<Guid, Endpoint> endpoints_;
  absl::btree_map<std::string, Topic> topics_;
  // How many endpoints stand behind each entry of Topic::types, and behind each service of a node.
  using Counts = absl::btree_map<std::string, uint32_t>;
  absl::flat_hash_map<std::string, Counts> types_of_topic_;
  absl::flat_hash_map<std::string, Counts> services_of_node_;
  uint64_t dropped_ = 0;
  // As the sender says.
  Truncation sender_;
  std::shared_ptr<const TopicNames> kept_topics_;
  Guid observer_;
  // By participant; none for one that holds nothing and lacks nothing.
  absl::flat_hash_map<Guid, Share> shares_;
  // Of all but the observer.
  size_t counted_ = 0;
  size_t unkept_ = 0;
};

// True if `name` (as a rule writes it) means the node `full_name`: with a slash the whole name is
// compared, without one the base name in any namespace.
bool NodeNameMatches(absl::string_view name, absl::string_view full_name);

}  // namespace rips::ros2

#endif  // RIPS_SERVICES_ROS2_ROS_GRAPH_H_

// From discovery facts to the robot's computation graph, and from the graph to the steps that are
// sent: one settled snapshot, then deltas.
//
// Whose endpoint is it? The middleware tells which participant owns an endpoint; which node does is
// told by the participant itself, in `ros_discovery_info`. What a participant claims about
// endpoints of another is ignored and counted. An endpoint nobody claims is `pending` for the
// attribution grace (the claim travels on another topic than the discovery of the endpoint), then
// it stands in the graph without a node. The grace is given once more, once, when a claim is taken
// back, since nodes do so just before they delete an endpoint; not again, or a participant could
// stay pending for ever by claiming and unclaiming.
//
// RIPS itself is the node `/rips`: this sensor's participant subscribes to every ROS topic that
// others use but the `unwatched` ones, whether or not a reader exists just now, so that what rules
// count depends neither on the interest nor on what we optimise. Its real endpoints are not shown.
//
// Every endpoint says how far it is seen:
//
// | endpoint                 | watched                  | not needed      | not visible       |
// |--------------------------|--------------------------|-----------------|-------------------|
// | writer of a ROS topic    | what it writes is read   | nobody needs it | else, and why     |
// | reader of a ROS topic    | what its writers, as     | nobody needs it | never             |
// |                          | they say, let us read    |                 |                   |
// | service, client          | never                    | never           | always: requests  |
// | `ros_discovery_info`     | always                   | never           | never             |
// | any other DDS topic      | never                    | always          | never             |
//
// What comes and goes between two steps is shown in one all the same, and is gone with the next: a
// short visit is no way past the rules. It is shown with the node that claimed it last, if any did.
// The first snapshot shows what a node had claimed of the visits before discovery settled.
#ifndef RIPS_SENSOR_AGENT_GRAPH_GRAPH_BUILDER_H_
#define RIPS_SENSOR_AGENT_GRAPH_GRAPH_BUILDER_H_

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/btree_set.h"
#include "absl/container/flat_hash_map.h"
#include "absl/status/status.h"
#include "sensor_agent/graph/graph_options.h"
#include "sensor_agent/interest/interest.h"
#include "sensor_agent/outbox/observation.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::sensor {

inline constexpr char kOwnNode[] = "/rips";
inline constexpr int64_t kNever = std::numeric_limits<int64_t>::max();

// Not thread-safe; no clock: times are CLOCK_BOOTTIME in nanoseconds and never go back.
class GraphBuilder {
 public:
  GraphBuilder(GraphOptions options, int64_t start_ns);

  void ParticipantSeen(const ros2::Participant& participant, int64_t now_ns);
  // With its nodes and endpoints.
  void ParticipantGone(const ros2::Guid& participant, int64_t now_ns);
  // New or changed. Endpoints of this sensor's own participant are ignored.
  void EndpointSeen(const EndpointFact& endpoint, int64_t now_ns);
  void EndpointGone(const ros2::Guid& endpoint, int64_t now_ns);
  // `claim` was published by the endpoint `writer`. PermissionDenied if it speaks for another
  // participant or lists endpoints of another (those are ignored, the rest counts);
  // ResourceExhausted if nodes were left out.
  absl::Status NodesClaimed(const ros2::Guid& writer, const ros2::ParticipantEntities& claim,
                            int64_t now_ns);
  // Participants of other RIPS processes on this robot: node `/rips` too.
  void SetOwnParticipants(const std::vector<ros2::Guid>& participants, int64_t now_ns);
  // What is read from now on.
  void SetPlan(std::shared_ptr<const WatchPlan> plan, int64_t now_ns);
  // Endpoints of these topics are kept first (graph_limits.h).
  void SetKeptTopics(std::shared_ptr<const ros2::TopicNames> topics);
  // Facts of discovery were lost before they came here: the graph lacks them until EndTruncation.
  void FactsLost(uint64_t count) { truncation_.left_out += count; }
  // Discovery was told anew and nothing was left out: the graph is whole.
  void EndTruncation();
  // Something is left out, or was and EndTruncation has not been called.
  bool truncated() const { return truncation_.left_out > 0; }
  uint64_t left_out() const { return truncation_.left_out; }
  // An eighth of each limit is free.
  bool HasRoom() const;
  // Messages of this writer cannot be read, because of `why`; empty = they can, again. Counts while
  // they are needed.
  void SetNotVisible(const ros2::Guid& writer, const std::string& why, int64_t now_ns);

  // Discovery is told anew from the start: whatever is not seen again until EndResync is gone.
  void BeginResync() { ++generation_; }
  void EndResync(int64_t now_ns);

  // What is to be sent now, in order; usually nothing.
  std::vector<GraphChange> Poll(int64_t now_ns);
  // When Poll may next have something to say; kNever = not before another fact.
  int64_t NextDue() const;
  // The whole graph as the steps sent so far (and all that is known by now) add up to, as new
  // versions. Empty until settled.
  std::vector<GraphChange> Snapshot(int64_t now_ns);

  bool settled() const { return settled_; }
  // As it would be sent now; nullopt if not known or not shown.
  std::optional<ros2::Endpoint> Find(const ros2::Guid& endpoint) const;
  // The version of the graph that shows this endpoint with the owner that Find gives: the newest
  // that was sent, or the next one. nullopt if Find does not know the endpoint.
  std::optional<uint64_t> VersionShowing(const ros2::Guid& endpoint) const;
  // The newest that was sent; 0 = none yet.
  uint64_t version() const { return version_; }
  // Changes whenever an answer of Find may have changed; never 0.
  uint64_t revision() const { return revision_; }
  const GraphCounters& counters() const { return counters_; }

 private:
  struct EndpointState {
    bool hidden = false;   // reply side of a service, shown by its request side
    bool kept = false;     // of a topic that is kept first
    ros2::Endpoint shown;  // without node and pending
    bool topic = false;    // of a ROS topic
    std::string not_visible_because;
    // End of the attribution grace; 0 = over.
    int64_t pending_until_ns = 0;
    bool grace_renewed = false;
    // It stood in a step, not as pending.
    bool was_shown = false;
    std::string visitor;  // the node that took its claim back before a step showed it
    uint32_t generation = 0;
  };
  struct ParticipantState {
    struct Claims {
      absl::btree_set<std::string> nodes;
      absl::flat_hash_map<ros2::Guid, std::string> node_of;
    };
    bool discovered = false;
    bool leaving = false;  // has gone and stays until the next step
    ros2::Participant facts;
    absl::btree_map<ros2::Guid, EndpointState> endpoints;
    Claims claims;
    absl::btree_set<std::string> visitors;  // taken back since the last step; the next shows them
    // A claim without a discovered participant is dropped then; 0 = not so.
    int64_t orphan_until_ns = 0;
    uint32_t generation = 0;
    // As sent.
    std::optional<ros2::Participant> sent;
    absl::btree_set<std::string> sent_nodes;
    absl::btree_map<ros2::Guid, ros2::Endpoint> sent_endpoints;

    // Endpoints that are not hidden; of those, the ones that are not kept first; the hidden ones.
    size_t shown = 0;
    size_t unkept = 0;
    size_t hidden = 0;
    // Since the graph was whole.
    uint64_t left_out = 0;

    bool present() const { return discovered || !endpoints.empty(); }
    // By a node, now or before.
    bool IsClaimed(const EndpointState& endpoint) const;
  };
  struct TopicUse {
    // Types of the endpoints of others, with how many have each.
    absl::btree_map<std::string, int> types;
    // Our subscription as sent.
    std::optional<ros2::Endpoint> observer;
  };

  bool IsOwn(const ros2::Guid& participant) const;
  // graph_builder_limits.cc
  bool IsKept(const ros2::Endpoint& shown) const;
  // False if there is none for this endpoint of `owner`; evicts another for one that is kept.
  bool MakeRoom(const ros2::Guid& owner, bool hidden, bool kept, int64_t now_ns);
  bool EvictFromLargest(int64_t now_ns);
  bool EvictFrom(const ros2::Guid& participant, int64_t now_ns);
  // Counts an endpoint that comes (by 1) or goes (by -1).
  void CountShare(ParticipantState& owner, const EndpointState& state, int by);
  void LeaveOut(ParticipantState* of, uint64_t count);
  // What a step says is left out: at least as much as is, and seldom something else.
  ros2::Truncation Told() const;

  // Null if the limit on participants is hit.
  ParticipantState* Obtain(const ros2::Guid& participant);
  EndpointState* FindState(const ros2::Guid& endpoint);
  void SetShown(EndpointState& state, const EndpointFact& fact) const;
  void SetVisibility(EndpointState& state) const;
  // `/rips` subscribes to this ROS topic if others use it.
  bool Observes(absl::string_view topic) const;
  // What is shown of a participant has changed, though nothing was discovered.
  void Refresh(const ros2::Guid& participant, int64_t now_ns);
  ros2::Endpoint Attributed(const ParticipantState& owner, const EndpointState& state) const;
  // What `before` claimed and no longer is: visits, and graces that are renewed.
  void TakeBack(ParticipantState& owner, const ParticipantState::Claims& before, int64_t now_ns);
  void DropClaims(ParticipantState& state);
  // What is known of it goes; what was sent stays until the next step.
  void Forget(const ros2::Guid& participant);
  void Remove(const ros2::Guid& endpoint, int64_t now_ns);
  // True if it must not go before it was shown; it is no longer pending then.
  bool Unseen(const ParticipantState& owner, EndpointState& state) const;
  bool Unseen(ParticipantState& state) const;
  void EndVisits(int64_t now_ns);
  void Wait(EndpointState& state, int64_t now_ns);
  // Something was discovered about `participant`.
  void Touch(const ros2::Guid& participant, int64_t now_ns);
  void EndGraces(int64_t now_ns);

  ros2::GraphDelta TakeDelta();
  void DiffParticipant(const ros2::Guid& guid, ParticipantState& state, ros2::GraphDelta& delta);
  void DiffNodes(const ros2::Guid& guid, ParticipantState& state,
                 absl::btree_set<std::string> nodes, ros2::GraphDelta& delta);
  void DiffEndpoints(ParticipantState& state, ros2::GraphDelta& delta);
  void DiffObserver(ros2::GraphDelta& delta);
  void CountTopic(const ros2::Endpoint& endpoint, int by);
  std::vector<GraphChange> Number(ros2::GraphDelta delta, bool snapshot);

  const GraphOptions options_;
  const int64_t start_ns_;
  std::shared_ptr<const WatchPlan> plan_;
  GraphCounters counters_;
  absl::btree_set<ros2::Guid> own_participants_;
  absl::btree_map<ros2::Guid, ParticipantState> participants_;
  std::shared_ptr<const ros2::TopicNames> kept_topics_;
  // Of others, as in ParticipantState.
  size_t shown_count_ = 0;
  size_t unkept_count_ = 0;
  size_t hidden_count_ = 0;
  // What is left out, and as it was told last.
  ros2::Truncation truncation_;
  ros2::Truncation told_truncation_;
  size_t node_count_ = 0;
  size_t claim_count_ = 0;
  uint32_t generation_ = 0;
  uint64_t revision_ = 1;
  // Deadlines of graces (by endpoint) and orphaned claims (by participant).
  absl::btree_set<std::pair<int64_t, ros2::Guid>> deadlines_;

  // What may differ from what was sent.
  absl::btree_set<ros2::Guid> dirty_;
  // Endpoints and participants that have gone, or had visitors, and stay until the next step.
  absl::btree_set<ros2::Guid> leaving_;
  absl::btree_set<std::string> dirty_topics_;
  int64_t burst_first_ns_ = 0;
  int64_t last_discovery_ns_;
  // A grace has ended: do not wait for the burst.
  bool hurry_ = false;
  bool settled_ = false;
  uint64_t version_ = 0;
  absl::btree_map<std::string, TopicUse> topics_;
  // Participants that were sent as having a node of that name.
  absl::btree_map<std::string, absl::btree_set<ros2::Guid>> node_owners_;
  uint32_t observer_entities_ = 0;
};

// `delta` in pieces of at most about `bytes` each, in an order in which each can be applied after
// the ones before. Never empty.
std::vector<ros2::GraphDelta> SplitDelta(ros2::GraphDelta delta, size_t bytes);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_GRAPH_GRAPH_BUILDER_H_

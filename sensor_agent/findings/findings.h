// What is wrong on a bus whatever the rules say: begins, and ends.
//
// | kind                | stands while                                              | told        |
// |---------------------|-----------------------------------------------------------|-------------|
// | duplicate_node      | two participants claim a node of that name                | at once     |
// | impostor            | one that is none of RIPS's claims a node `rips`           | foreign     |
// |                     |                                                           | grace       |
// | false_claim         | the newest claim of a participant speaks for another      | at once     |
// | foreign_mode_writer | a client of change_mode, change_state, set_parameters or  | foreign     |
// |                     | set_parameters_atomically of a protected part is neither  | grace, or   |
// |                     | RIPS's nor in the participant that serves its change_mode | rival       |
// |                     |                                                           | grace       |
// | rival_server        | a participant serves a protected part beside the one that | rival       |
// |                     | came first, or its state and parameters while its node is | server      |
// |                     | elsewhere; or no node claims what it serves of the part   | grace, or   |
// |                     |                                                           | as a writer |
// | non_ros_writer      | a ROS topic has a writer that no node claims, past the    | at once, or |
// |                     | attribution grace                                         | slow node   |
// | non_ros_reader      | a participant reads a ROS topic, none of those that may   | foreign     |
// |                     | be read so, and no node claims its reader                 | grace       |
// | unauthenticated     | with DDS Security: a participant shows no endpoint        | handshake   |
// | sequence_jump       | a writer's sequence numbers jumped as no honest writer's  | at once     |
// |                     | do, until it is discovered again                          |             |
//
// "At once" is after the graph step that shows it, so never before discovery has settled.
// A node that died without farewell and was started again is a duplicate until its lease ends.
// A writer without a node waits for the slow node if its participant publishes
// `ros_discovery_info`; one that does not publish it is no ROS process.
// A reader waits for the slow node, too, and for the server's word, since RIPS's own may read
// unannounced. One that no node ever claimed is one although it has left by then. The grace counts
// from its participant's first reader of that topic, whatever takes its place.
// A foreign mode writer waits because RIPS's own processes are on the bus before the server tells
// us that they are; the grace counts from when the server can tell us, so while there is no stream
// none is told. One that has left by then is told all the same: it may have written. An impostor
// waits for the same reason, and so does a duplicate of its name: RIPS's processes, too, call
// themselves `rips`. Who serves
// change_mode is taken from discovery: the first one seen. A second one waits the rival grace: the
// mode manager may have died and been started again, and then the first goes with its lease. Of
// several in the same snapshot none is trusted. A rival server waits for longer than any lease for
// that reason. RIPS serves no part: one in a participant of RIPS is a rival, too.
#ifndef RIPS_SENSOR_AGENT_FINDINGS_FINDINGS_H_
#define RIPS_SENSOR_AGENT_FINDINGS_FINDINGS_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/btree_set.h"
#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "sensor_agent/findings/findings_options.h"
#include "sensor_agent/findings/part_servers.h"
#include "sensor_agent/graph/graph_builder.h"
#include "sensor_agent/outbox/observation.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::sensor {

// Bytes of Finding::detail.
inline constexpr size_t kFindingDetailBytesMax = 512;

// Not thread-safe; no clock: times are CLOCK_BOOTTIME in nanoseconds and never go back.
class Findings {
 public:
  explicit Findings(FindingsOptions options);

  // A step of the graph, in order; a snapshot (from_version 0) with all its parts before the next
  // Poll. Snapshots that replace steps count, too.
  void OnGraph(const GraphChange& change, int64_t now_ns);
  // As discovered, before the graph step that shows it, if one does: a client may be gone by then.
  void OnEndpointSeen(const EndpointFact& endpoint, int64_t now_ns);
  void OnEndpointGone(const ros2::Guid& endpoint);
  // The numbers of `jump.guid`, a writer that discovery shows, jumped: stands until it or its
  // participant has gone. With its node and topic, if it has them, and what happened as `detail`.
  void OnSequenceJump(const Finding& jump);
  void OnParticipantGone(const ros2::Guid& participant);
  // What GraphBuilder::NodesClaimed said of a claim published by the endpoint `writer`.
  void OnClaim(const ros2::Guid& writer, const absl::Status& taken, int64_t now_ns);
  // As the server says. `parts`: full names.
  void SetOwnParticipants(const std::vector<ros2::Guid>& participants);
  void SetProtectedParts(const std::vector<std::string>& parts);
  // There is a stream to the server, which has said what it knows of RIPS's participants.
  void SetConnected(bool connected, int64_t now_ns);

  // What is to be told now; usually nothing.
  std::vector<Finding> Poll(int64_t now_ns);
  // When Poll may next have something to say; kNever = not before another fact.
  int64_t NextDue() const { return dirty_ ? 0 : next_due_ns_; }
  // Told and not over, for a server that has forgotten.
  std::vector<Finding> Told() const;

  // Participants that use DDS Security and show nothing to us, who do not. As of the last Poll.
  size_t secured_strangers() const { return secured_strangers_; }
  // Findings that were not held because of the limit.
  uint64_t dropped() const { return dropped_; }
  // Nothing waits for its grace, the server's word, room or another minute. As of the last Poll.
  bool told_all() const { return !holds_untold_ && not_held_ == 0; }
  // The kinds that it tells, as Finding::kind.
  static absl::Span<const char* const> Kinds();

 private:
  enum Kind {
    kDuplicateNode,
    kImpostor,
    kFalseClaim,
    kForeignModeWriter,
    kRivalServer,
    kNonRosWriter,
    kNonRosReader,
    kUnauthenticated,
    kSequenceJump,
    kKinds
  };
  struct Key {
    Kind kind = kKinds;
    ros2::Guid guid;
    // Or the topic that is read, or the part that is served.
    std::string node;

    friend auto operator<=>(const Key&, const Key&) = default;
  };
  struct Party {
    int64_t seen_ns = 0;
    std::string host;
    std::string address;
    uint32_t pid = 0;
    // Its writer of ros_discovery_info; none() = it has none.
    ros2::Guid announcer;
    // Has shown an endpoint or a node.
    bool shown = false;
    absl::btree_set<std::string> nodes;
  };
  // An endpoint that may be part of a finding.
  struct Suspect {
    int64_t seen_ns = 0;
    ros2::EndpointKind kind = ros2::EndpointKind::kPublisher;
    std::string name;
    std::string node;
    bool was_claimed = false;  // by a node that has gone
  };
  struct Tables {
    absl::btree_map<ros2::Guid, Party> parties;
    absl::btree_map<ros2::Guid, Suspect> suspects;
    PartServers servers;
    // Readers that a node claims or claimed.
    absl::btree_set<ros2::Guid> claimed;
    // Participants that claim a node of that name.
    absl::btree_map<std::string, absl::btree_set<ros2::Guid>> owners;
  };
  struct Wanted {
    Finding finding;
    int64_t due_ns = 0;
    int64_t since_ns = 0;
    bool late = false;  // told although it has left
  };
  struct Held : Wanted {
    bool told = false;
    // Due, but its kind is told too often.
    bool withheld = false;
    // No longer so, and still to be told.
    bool gone = false;
  };
  struct Window {
    int64_t start_ns = 0;
    size_t told = 0;
    uint64_t folded = 0;
  };
  using WantedMap = absl::btree_map<Key, Wanted>;
  // Of each part's change_mode.
  using Servers = absl::btree_map<std::string, PartServers::Server>;

  bool IsOwn(const ros2::Guid& participant) const;
  void UpsertParticipant(const ros2::Participant& participant, int64_t now_ns);
  void UpsertNode(const ros2::Node& node);
  void UpsertEndpoint(const ros2::Endpoint& endpoint, int64_t now_ns);
  void DropNode(const std::string& name);
  void DropGuid(const ros2::Guid& guid);

  WantedMap Collect(int64_t now_ns);
  void CollectNodes(WantedMap& wanted);
  void CollectClaims(int64_t now_ns, WantedMap& wanted);
  Servers CollectServers() const;
  void CollectModeWriters(WantedMap& wanted);
  void CollectRivals(WantedMap& wanted);
  void CollectNonRos(WantedMap& wanted);
  void CollectStrangers(int64_t now_ns, WantedMap& wanted);
  void CollectJumps(WantedMap& wanted);
  // `key` stands. Where to say what it is, unless it was told already or too many are new.
  Wanted* Want(const Key& key, int64_t due_ns, WantedMap& wanted);
  std::string Describe(const ros2::Guid& participant) const;

  void Begin(WantedMap wanted);
  void End(const WantedMap& wanted, std::vector<Finding>& told);
  void Tell(int64_t now_ns, std::vector<Finding>& told);
  void TurnWindows(int64_t now_ns, std::vector<Finding>& told);
  // The server may still tell us that it is RIPS's.
  static bool MayBeOurs(const Key& key);
  // It is told although it has left.
  bool IsToldLate(const Key& key, const Held& held) const;
  int64_t ForeignDue(int64_t seen_ns) const;
  bool CanBeTold(const Key& key) const { return connected_ || !MayBeOurs(key); }
  void ScheduleNext();

  const FindingsOptions options_;
  absl::btree_set<ros2::Guid> own_participants_;
  absl::btree_set<std::string> protected_parts_;
  bool connected_ = false;
  int64_t connected_ns_ = 0;
  Tables now_;
  // What was known before the snapshot that is being taken.
  Tables before_;
  // Clients that may steer a part, by GUID: since when, and what service. At most findings_max.
  absl::btree_map<ros2::Guid, std::pair<int64_t, std::string>> glimpses_;
  // By participant: when and what.
  absl::btree_map<ros2::Guid, std::pair<int64_t, std::string>> false_claims_;
  absl::btree_map<ros2::Guid, Finding> jumps_;

  absl::btree_map<Key, Held> held_;
  std::array<Window, kKinds> windows_;
  bool dirty_ = false;
  // Of what is not held: when a participant has been a stranger for long enough.
  int64_t strangers_due_ns_ = kNever;
  int64_t next_due_ns_ = kNever;
  size_t secured_strangers_ = 0;
  // New ones in the Collect that is going on, of each kind.
  std::array<size_t, kKinds> fresh_ = {};
  size_t not_held_ = 0;
  bool holds_untold_ = false;
  uint64_t dropped_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_FINDINGS_FINDINGS_H_

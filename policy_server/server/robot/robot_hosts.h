// What a robot remembers of its hosts, and what of them was told.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_HOSTS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_HOSTS_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "policy_server/server/robot/links.h"
#include "policy_server/server/robot/model/actuator_inbound.h"
#include "policy_server/server/robot/model/coverage.h"
#include "policy_server/server/robot/model/inbound.h"
#include "policy_server/server/robot/parts/drill_run.h"
#include "policy_server/server/robot/parts/graph_health.h"
#include "policy_server/server/robot/parts/own_participants.h"
#include "policy_server/server/robot/parts/second_holder.h"
#include "policy_server/server/robot/parts/sensor_health.h"
#include "policy_server/server/robot/parts/sequence_track.h"
#include "policy_server/server/robot/parts/term_reset.h"
#include "policy_server/server/robot/parts/truncation_alarm.h"
#include "policy_server/server/robot/waiting_batches.h"
#include "services/ros2/guid.h"

namespace rips::pipeline {

struct SensorSession {
  std::shared_ptr<SensorLink> link;
  std::string incarnation;
  // Server time minus the sensor's boottime, fixed at Hello.
  int64_t boottime_offset_ns = 0;
  int64_t unix_offset_ns = 0;
  int64_t heard_ns = 0;
  int64_t peer_boottime_ns = 0;
  uint32_t domain = 0;
  // Announced in Hello: evidence is incomplete until judged up to here.
  std::vector<SpooledRange> spooled;
  uint64_t judged_bytes = 0;
  uint64_t granted_bytes = 0;
  uint64_t judged_payload_bytes = 0;
  uint64_t granted_payload_bytes = 0;
  // Ids; what it uses is what it says.
  std::string interest_wanted;
  std::string interest_in_use;
  // Why it does not use the one wanted; printable.
  std::string interest_problem;
  ClockSkew skew;
};

// A sensor host of the inventory, with or without a session.
struct SensorHost {
  std::string name;
  std::optional<SensorSession> session;
  SequenceTrack sequences;
  // Of the incarnation whose graph is held.
  std::string graph_incarnation;
  uint64_t graph_version = 0;
  // Collects an unsettled snapshot; becomes the robot's graph when settled.
  ros2::RosGraph graph;
  bool settled = false;
  bool lost = false;
  int64_t gone_since_ns = 0;
  SecondHolder second;
  // Up to where observations are judged and their effects durable.
  SequenceTrack durable;
  RestartCount restarts;
  RecentLosses losses;
  SensorStateSeen state;
  // When it said what `state` says of inputs, by its own clock.
  int64_t state_boottime_ns = 0;
  OwnParticipants participants;
  // Gaps were put down to a restored store; once for each start of the server.
  bool excused = false;

  // No graph is held; the next one has these limits and keeps these topics first.
  void BeginGraph(const ros2::GraphLimits& limits,
                  std::shared_ptr<const ros2::TopicNames> kept_topics);
  // Observations that were announced in its hello are not judged yet.
  bool HasBacklog() const;
  // The graph as the sensor of `incarnation` tells it. InvalidArgument: it makes no sense.
  absl::Status TakeSnapshot(const std::string& incarnation, const GraphSnapshotSeen& snapshot);
  absl::Status TakeDelta(const std::string& incarnation, const GraphDeltaSeen& delta);
};

struct ActuatorSession {
  std::shared_ptr<ActuatorLink> link;
  // It began without a state of its own: above this level, what it holds is what it found.
  std::optional<levels::LevelIndex> found_above;
  // The highest that was ordered in this session: where it may be because we said so.
  levels::LevelIndex ordered_most = 0;
  int64_t heard_ns = 0;
  int64_t peer_boottime_ns = 0;
  ActuatorHeartbeat heartbeat;
};

// An actuator host of the inventory, with or without a session.
struct ActuatorHost {
  std::optional<ActuatorSession> session;
  OwnParticipants participants;
  // As it said last.
  std::vector<std::string> protected_parts;
  std::optional<uint64_t> drifts;
  std::vector<std::string> degraded;
  // Why it held a level of its own, as told last; empty = it did not.
  std::string floor_told;
  bool lost = false;
  int64_t gone_since_ns = 0;
  SecondHolder second;
  // Of a hello that waits for the store.
  std::shared_ptr<ActuatorLink> arming;
  // It has had a session since this process began.
  bool met = false;
  // The newest decision that it verified.
  DecisionId verified;
  // Of the hello that was refused last for it, until one is accepted.
  std::optional<ShownTerm> refused_term;
  // What an administrator let the server go above.
  std::optional<ShownTerm> pardoned_term;
};

// An actuator's hello that is acceptable, and what the store has said to it so far.
struct Arming {
  std::string host;
  std::shared_ptr<ActuatorLink> link;
  ActuatorHello hello;
  // Drawn above the term that the actuator has obeyed.
  std::optional<uint64_t> term;
  // The level of the decision that the hello names; the inner nullopt: no decision of ours.
  std::optional<std::optional<std::string>> level;
};

// CLOCK_BOOTTIME.
struct NextTimes {
  int64_t heartbeat_ns = 0;
  int64_t tick_ns = 0;
  int64_t checkpoint_ns = 0;
};

// What is not seen of the robot, and what of that has been told.
struct Sight {
  // Why the robot is not seen, as of the last UpdateBlind.
  std::vector<std::string> blind;
  BlindAlarm blind_alarm;
  std::optional<size_t> blind_counted;
  GraphHealth graph_health;
  // What graph_health was found from: revision, number of actuator_hellos, domain.
  std::tuple<uint64_t, uint64_t, uint32_t> graph_examined = {};
  uint64_t actuator_hellos = 0;
  TruncationAlarm truncation_alarm;
  std::optional<uint64_t> left_out_counted;
  // The sensor is not asked for its graph again before.
  int64_t next_recovery_ns = 0;
  CutPayloads cut_payloads;
  // Of the graph whose endpoints were counted last, and participants of RIPS.
  uint64_t counted_revision = 0;
  std::vector<ros2::Guid> counted_without;
};

// What is told once.
struct ToldOnce {
  // Until the next start: the store is older than what a sensor was told is durable.
  bool store_went_back = false;
  // Until an operator resumes them: the budget of soft lowerings is spent.
  bool budget_spent = false;
  // Programs that no actuator offers; empty = none.
  std::string missing_programs;
};

struct RunningDrill {
  DrillOrder order;
  DrillRun run;
  DrillReply reply;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_HOSTS_H_

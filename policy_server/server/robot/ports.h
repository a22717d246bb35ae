// What a robot needs of the outside: to record, to be heard, to know the time.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_PORTS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_PORTS_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/engine/state/verdict.h"
#include "policy_server/server/robot/model/coverage.h"
#include "policy_server/server/robot/model/inbound.h"
#include "policy_server/server/robot/model/inspected_message.h"
#include "policy_server/server/robot/model/judged_event.h"
#include "policy_server/server/robot/model/robot_status.h"
#include "policy_server/server/store/store.h"
#include "services/base/clock.h"
#include "services/base/decision_id.h"

namespace rips::pipeline {

// The level that a decision led to; nullopt if no decision has that decision id.
using FoundDecision = absl::StatusOr<std::optional<std::string>>;

// Makes records durable, in order. `done` may run on any thread.
class Recorder {
 public:
  virtual ~Recorder() = default;
  // `done` gets the status of the batch; Aborted: the robot has another owner.
  virtual void Record(store::WriteBatch batch, std::function<void(const absl::Status&)> done) = 0;
  // The last write succeeded.
  virtual bool healthy() const = 0;
  // As of store::Store. Neither waits for the disk: `done` is called once, on any thread, maybe
  // before this returns.
  virtual void FindDecision(const std::string& robot, const DecisionId& decision_id,
                            std::function<void(const FoundDecision&)> done) = 0;
  virtual void NextTerm(const std::string& robot, uint64_t tenure, uint64_t above,
                        std::function<void(const absl::StatusOr<uint64_t>&)> done) = 0;
  // What is durable by now. Neither blocks.
  virtual store::StorePoint point() const = 0;
  // False: the store is older than it was at that point, or it is another one.
  virtual bool GoesOnFrom(const store::StorePoint& seen) const = 0;
};

// Those who watch. Any thread; never blocks.
class RobotObserver {
 public:
  virtual ~RobotObserver() = default;
  // Durable already.
  virtual void OnAlert(const store::AlertRecord& alert) = 0;
  // What those who watch must know before it can be durable: that cannot write the store.
  virtual void OnNotice(const std::string& text) = 0;
  virtual void OnStatus(const RobotStatus& status) = 0;
  // A rule has shown values with True or False; text of a robot, to be escaped.
  virtual void OnRuleLog(const std::string& robot, const std::string& rule,
                         const std::string& text) = 0;
};

// One who records what a robot's rules are given to judge: messages that they do not need are never
// sent. Called on the robot's thread; must not block.
class EventRecorder {
 public:
  virtual ~EventRecorder() = default;
  // False: no more, please.
  virtual bool OnEvent(const JudgedEvent& event) = 0;
  virtual bool OnLevel(const LevelChange& level) = 0;
};

// Keeps the last events of one robot, in pieces that each begin with a state of the rules, and
// saves them with alerts. Called on the robot's thread; must not block.
class FlightRecorder : public EventRecorder {
 public:
  // A piece is due, to begin between two inputs. Asked at least every 50 ms.
  virtual bool wants_piece(Instant now) const = 0;
  // At first, and whenever one is due or another policy is in force.
  virtual void BeginPiece(RulesState state, Instant now) = 0;
  // What has been kept by the next piece is saved with that alert.
  virtual void Keep(const GraveAlert& alert) = 0;
};

// Runs another policy muted on what the robot's rules are given, and on messages that it alone
// asked for (JudgedEvent::muted). Called on the robot's thread; must not block.
class ShadowRecorder : public EventRecorder {
 public:
  // First; from here on all is recorded.
  virtual void OnBegin(RulesState state) = 0;
  // After the event that it is of. False: no more, please.
  virtual bool OnOutcome(const RuleOutcome& outcome) = 0;
  // The robot has retired; last.
  virtual void OnRetired() = 0;
};

// Asks YARA files and plugins of one policy about messages.
class Inspector {
 public:
  virtual ~Inspector() = default;
  // `inspections` are indices into CheckedRules::inspections. `done` is called once, on any thread,
  // maybe before this returns, with their verdicts in that order. Never blocks.
  virtual void Inspect(const std::string& robot, const std::vector<uint32_t>& inspections,
                       const InspectedMessage& message,
                       std::function<void(std::vector<engine::Verdict>)> done) = 0;
};

// What is counted; a null entry is not.
struct Counts {
  // Of a robot, when they have changed.
  std::function<void(const std::string& robot, const EndpointCounts&)> endpoints;
  // Of a robot: why it is not seen, at first and when that has changed.
  std::function<void(const std::string& robot, size_t reasons)> blind;
  // Of a robot: how many participants, nodes and endpoints are left out of its graph, when that has
  // changed; `began`: nothing was.
  std::function<void(const std::string& robot, uint64_t left_out, bool began)> graph_left_out;
  // Of a robot's sensor host, nanoseconds, as estimated.
  std::function<void(const std::string& robot, const std::string& host, int64_t)> clock_skew;
  // Inspections that were not made, by reason.
  std::function<void(const std::string& reason, uint64_t)> inspections_skipped;
  std::function<void(uint64_t)> observations_judged;
  std::function<void(uint64_t)> observations_lost;
  std::function<void(uint64_t)> observations_duplicate;
  // Judged without a node, since the graph did not show their writer in time.
  std::function<void(uint64_t)> messages_unattributed;
  // Graphs that were not judged by themselves, since their sensor told of more in one batch than a
  // sensor does.
  std::function<void(uint64_t)> graphs_merged;
  // Of agents that have a live session already.
  std::function<void(uint64_t)> sessions_refused;
  // Messages of which a payload was asked for and only the first bytes came.
  std::function<void(uint64_t)> payloads_cut;
  std::function<void(uint64_t)> alerts;
  // Not recorded because the store could not be written for too long.
  std::function<void(uint64_t)> alerts_lost;
};

struct Ports {
  const Clock* clock = nullptr;
  Recorder* recorder = nullptr;
  RobotObserver* audience = nullptr;
  Counts counts;
  // Run a task on the robot's own thread, later: what completes something, before all that agents
  // send; and what is work, such as judging messages, in turn with it.
  std::function<void(std::function<void()>)> post;
  std::function<void(std::function<void()>)> post_work;
  // The robot has another owner, and has retired: nothing that it decides is recorded any more. On
  // the robot's thread; may be empty.
  std::function<void(const std::string& robot, const absl::Status& why)> fenced;
  // A status of the robot is published. On the robot's thread; may be empty.
  std::function<void(const RobotStatus& status)> on_status;
  // Makes the flight recorder of a robot; may be empty.
  std::function<std::unique_ptr<FlightRecorder>(const std::string& robot)> flight_recorder;
  // Draws ids of alerts, transitions and commands.
  std::function<std::string()> new_id;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_PORTS_H_

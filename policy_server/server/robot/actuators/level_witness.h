// Whether the robot belies a level that its actuators have read back: nodes that the level has
// inactive must not publish. A second way beside the reading back, which a peer on the bus may
// forge. Pure.
//
//   a message of a node that must be silent           is
//   taken within kGraceNs of the reading back         nothing: it was under way
//   on a topic that inactive nodes publish honestly   nothing (IsSpared)
//   the first of its writer, or after kPauseNs        remembered: a latched writer sends what it
//                                                     wrote before to each new reader
//   of that writer, kApartNs or more after it         a contradiction
//
// A contradiction stands until a level is read back again, or until sensors that see the robot have
// seen no such message for kSilentNs. Names on DDS are claims: whoever uses the name of a silent
// node makes one, too.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_LEVEL_WITNESS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_LEVEL_WITNESS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "services/base/clock.h"
#include "services/base/decision_id.h"
#include "services/model/receipt.h"
#include "services/ros2/guid.h"

namespace rips::pipeline {

// Topics that ROS and System Modes publish for a node that is inactive: its log, its parameters,
// its transitions, its health, its actions' state.
bool IsSpared(absl::string_view topic);

// Not thread-safe; times are CLOCK_BOOTTIME of the server.
class LevelWitness {
 public:
  static constexpr int64_t kGraceNs = kNanosPerSecond;
  static constexpr int64_t kApartNs = 300 * kNanosPerMilli;
  static constexpr int64_t kPauseNs = 10 * kNanosPerSecond;
  static constexpr int64_t kSilentNs = 10 * kNanosPerSecond;
  // Told apart; further ones count as one of their node.
  static constexpr size_t kWritersMax = 256;

  // A host whose actuator has read back its level, which may be above the one decided: what both
  // have inactive is silent.
  struct Holder {
    absl::string_view host;
    absl::string_view level;
  };
  struct Sent {
    absl::string_view topic;
    absl::string_view node;
    ros2::Guid writer;
    int64_t taken_ns = 0;
  };

  // What the actuator of that host says in its hello. False: it names no nodes of any level.
  bool SetParts(const std::string& host, const model::ActuatorHello& hello);
  // Why what is read back may be forged, whatever is seen; empty = nothing speaks for that.
  void SetDoubt(std::string why) { doubt_ = std::move(why); }

  // The level is verified. Any other decision, holder or level of one begins anew.
  void Update(const DecisionId& decision_id, const std::string& level,
              absl::Span<const Holder> holders, int64_t now_ns);
  // It is not, or no longer.
  void End();
  // A sensor begins: what latched writers sent before comes again.
  void BeginAgain(int64_t now_ns);
  bool Watches(absl::string_view node) const { return !silent_.empty() && silent_.contains(node); }
  // Of a node that it watches.
  void OnMessage(const Sent& sent, int64_t now_ns);
  // `seen`: sensors see the robot now. Call it often.
  void OnTime(bool seen, int64_t now_ns);

  // What belies the level while it is verified; empty = nothing.
  const std::string& contradiction() const {
    return contradiction_.empty() ? doubt_ : contradiction_;
  }

 private:
  struct Parts {
    // By level, full names.
    absl::btree_map<std::string, std::vector<std::string>> inactive;
    std::vector<std::string> topics;
  };
  struct Taken {
    int64_t first_ns = 0;
    int64_t last_ns = 0;
  };

  absl::btree_map<std::string, Parts> parts_;
  std::string doubt_;
  // Of what was read back last; none = it is not verified.
  DecisionId decision_id_;
  std::string level_;
  std::vector<std::pair<std::string, std::string>> holders_;
  int64_t since_ns_ = 0;
  absl::flat_hash_set<std::string> silent_;
  // Topics that they publish all the same, besides those of IsSpared.
  absl::flat_hash_set<std::string> spared_;
  absl::btree_map<std::pair<std::string, ros2::Guid>, Taken> writers_;
  std::string contradiction_;
  // When such a message was heard last, or the robot was not seen.
  int64_t heard_ns_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_LEVEL_WITNESS_H_

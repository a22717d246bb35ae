// A roll-out: a bundle comes into force on robots stage by stage, and stops by itself where it does
// harm. Pure; one thread.
//
//   a robot of a stage that has begun         then
//   is judged by the bundle, nothing else     healthy
//   is in no inventory any more               does not count
//   has not taken it within kTakeNs           the roll-out stops
//   does not answer, is held                  not healthy; for kTakeNs: stops
//   degraded as it was before                 healthy
//   degraded otherwise                        not healthy; for kGraceNs: stops
//   its level rose since the stage began      stops; a level that its table does not have any more
//                                             counts as the least restrictive
//   more alerts a minute than the plan has    stops
//
// Time in which a robot is not healthy adds up, for each of the two limits on its own, and is
// forgotten a quarter as fast when it is: a sensor that the bundle makes start anew again and again
// is healthy in between.
//
// A stage is done when all robots of the stages so far have been healthy for the plan's soak time
// without a break, and at least one of the stage is watched by its sensors: one that sends nothing
// proves nothing. Robots of stages that have not begun do not count. After a restart of the server
// the soak time begins anew, and for kRestartGraceNs, in which sensors come back and their graphs
// are judged anew, nothing counts as harm but a level that rises.
#ifndef RIPS_POLICY_SERVER_SERVER_ROLLOUT_ROLLOUT_H_
#define RIPS_POLICY_SERVER_SERVER_ROLLOUT_ROLLOUT_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/strings/string_view.h"
#include "services/base/clock.h"

namespace rips::rollout {

inline constexpr int64_t kTakeNs = 30 * kNanosPerSecond;
inline constexpr int64_t kGraceNs = 10 * kNanosPerSecond;
inline constexpr int64_t kRestartGraceNs = 60 * kNanosPerSecond;
inline constexpr int64_t kSoakNsDefault = 600 * kNanosPerSecond;
inline constexpr int64_t kSoakNsMax = int64_t{7} * 24 * 3600 * kNanosPerSecond;
inline constexpr uint32_t kAlertsPerMinuteDefault = 10;
inline constexpr uint32_t kAlertsPerMinuteMax = 1'000;
inline constexpr size_t kStagesMax = 32;

struct RolloutPlan {
  // 32 hex digits.
  std::string id;
  // That robots report when they have taken it.
  std::string bundle_id;
  // It is the one of the server's directory, whatever that holds later.
  bool from_directory = false;
  // Of the bundle's manifest.
  std::string name;
  std::string operator_name;
  std::string reason;
  // At least one; each robot once; sorted within a stage.
  std::vector<std::vector<std::string>> stages;
  int64_t soak_ns = kSoakNsDefault;
  // Alerts of rules, of severity medium or above, of one robot.
  uint32_t alerts_per_minute_max = kAlertsPerMinuteDefault;
  // When it stops by itself, its robots go back to what judged them before.
  bool roll_back_when_stopped = false;

  friend bool operator==(const RolloutPlan&, const RolloutPlan&) = default;
};

enum class RolloutState { kRunning, kDone, kStopped };

// `running`, `done`, `stopped`.
absl::string_view ToString(RolloutState state);

// What a robot was like before its stage began.
struct Baseline {
  // As Normalized.
  std::set<std::string> degraded;
  // Empty = not known.
  std::string level;
  // What judged it; empty = nothing, or not known.
  std::string bundle_id;

  friend bool operator==(const Baseline&, const Baseline&) = default;
};

// All there is to know of a roll-out; durable.
struct RolloutRecord {
  RolloutPlan plan;
  RolloutState state = RolloutState::kRunning;
  // Why it stopped.
  std::string why;
  // Robots that went back since, and why, as text; empty = none.
  std::string rolled_back;
  // Of the stage that runs, or ran last.
  size_t stage = 0;
  int64_t began_unix_ns = 0;
  int64_t ended_unix_ns = 0;
  // Of robots whose stage has begun.
  absl::btree_map<std::string, Baseline> before;

  friend bool operator==(const RolloutRecord&, const RolloutRecord&) = default;
};

// What one robot is like now.
struct RobotHealth {
  // Empty: nothing judges it.
  std::string bundle_id;
  // As an operator sees them.
  std::vector<std::string> degraded;
  // Why it has not taken a bundle; may be empty.
  std::string problem;
  // Its sensors are connected.
  bool watched = false;
  // The inventory does not have it any more, or with another policy.
  bool gone = false;
  std::string level;
  // All of its table, the least restrictive first; empty = not known.
  std::vector<std::string> levels;
  // Within the last minute, since its stage began.
  uint32_t alerts = 0;
};

// Robots that have not answered are missing.
using FleetHealth = absl::btree_map<std::string, RobotHealth>;

// What is to be done; the record has changed if anything is.
struct RolloutStep {
  // Robots that are to be judged by the bundle from now on.
  std::vector<std::string> activate;
  // Robots that are to go back to what judged them before.
  std::vector<std::string> roll_back;
  // It stopped, or is done.
  bool over = false;
  // It stopped by itself.
  bool by_itself = false;

  bool empty() const { return activate.empty() && roll_back.empty() && !over; }
};

class Rollout {
 public:
  // `restarted`: the record comes from an earlier process.
  Rollout(RolloutRecord record, Instant now, bool restarted);

  // Once, for a new one: its first stage begins.
  RolloutStep Begin(const FleetHealth& health, Instant now);
  // About once a second.
  RolloutStep Look(const FleetHealth& health, Instant now);
  // An operator stops it, or rolls back. Nothing if it is over.
  RolloutStep Stop(absl::string_view why, Instant now);

  const RolloutRecord& record() const { return record_; }
  bool running() const { return record_.state == RolloutState::kRunning; }
  // `r7: sensor base is silent`; empty if all are healthy, or it is over.
  const std::string& not_healthy_because() const { return not_healthy_because_; }
  // Wall clock; nullopt if a robot is not healthy, or it is over.
  std::optional<int64_t> healthy_since_unix_ns() const;

 private:
  RolloutStep BeginStage(const FleetHealth& health, Instant now);
  RolloutStep StopByItself(const std::string& why, Instant now);
  // Why a robot stops the roll-out, or an empty text. One that is not healthy is noted.
  std::string Harm(const std::string& robot, const FleetHealth& health, Instant now);
  bool Watches(const FleetHealth& health) const;
  // As Harm, for what stops the roll-out only after a time.
  std::string Bad(const std::string& robot, std::string what, int64_t patience_ns, Instant now);
  void Forgive(const std::string& robot);
  // Robots of all stages that have begun.
  std::vector<std::string> Begun() const;

  RolloutRecord record_;
  std::string not_healthy_because_;
  // CLOCK_BOOTTIME.
  int64_t patient_until_ns_ = 0;
  std::optional<Instant> healthy_since_;
  // CLOCK_BOOTTIME of the look before this one, and how long before.
  int64_t looked_ns_ = 0;
  int64_t elapsed_ns_ = 0;
  // For how long a robot has been bad, by robot and the time that it may be.
  absl::btree_map<std::string, absl::btree_map<int64_t, int64_t>> bad_ns_;
};

// Without digits, so that a count or a time in it makes no other one.
std::string Normalized(absl::string_view degraded);

}  // namespace rips::rollout

#endif  // RIPS_POLICY_SERVER_SERVER_ROLLOUT_ROLLOUT_H_

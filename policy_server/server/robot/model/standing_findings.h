// The findings of a robot that stand, as operators see them.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_STANDING_FINDINGS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_STANDING_FINDINGS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "policy_server/policy/engine/state/trace.h"
#include "policy_server/server/robot/model/inbound.h"

namespace rips::pipeline {

// Of those that stand, shown in brief.
inline constexpr size_t kNewestFindingsMax = 5;
// Participants named of each of them.
inline constexpr size_t kFindingSubjectsMax = 4;
// Reasons why not all is known.
inline constexpr size_t kNotKnownMax = 16;
// Stands for all kinds that rules cannot name.
inline constexpr char kOtherKinds[] = "other";

struct StandingFinding {
  FindingSeen finding;
  // When the server learnt of it.
  int64_t since_unix_ns = 0;
  // Of the graph in force.
  std::vector<engine::TracedSubject> subjects;
};

// In brief, whatever the sensors report.
struct FindingsNow {
  size_t total = 0;
  // Most first, then by name.
  std::vector<std::pair<std::string, size_t>> kinds;
  // Newest first.
  std::vector<StandingFinding> newest;
  // Why others may stand, or some of these may have ended; empty = the sensors have reported all.
  std::vector<std::string> not_known;
};

// What is known of one finding.
struct FindingState {
  enum class State { kStands, kEnded, kNotKnown };
  State state = State::kNotKnown;
  // If it stands: when the server learnt of it.
  int64_t since_unix_ns = 0;
  // When the server learnt that it has ended; 0 = it does not stand, and that was not seen.
  int64_t ended_unix_ns = 0;
  // Why it is not known.
  std::vector<std::string> not_known;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_STANDING_FINDINGS_H_

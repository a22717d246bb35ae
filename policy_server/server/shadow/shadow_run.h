// ShadowRun: one robot's shadow. Judges what the robot's rules are given by another policy, and
// counts what that one would have done. Pure, but for the session of inspections.
//
// What differs from a robot that is judged by that policy:
//   - As for a Replayer, programs and levels have their answer at once.
//   - It begins with the robot's level if its rules declare a level of that name, else with their
//     start level, and with those of the robot's variables that fit by name and type.
//   - What others than rules do to the robot's level happens to this one too, and is not counted;
//     a level that its rules do not declare is passed over.
//   - Evidence is that of the robot.
//
//   an event that it cannot judge                what follows
//   a message or a loss of a topic of which its  not given to it, as its sensors would not send it
//   policy asks for no messages
//   a payload longer than its policy asks for    cut
//   a time before 1970 or after 2116             the nearest that is not
//   a change that does not fit its graph         the whole graph instead; if that does not fit, it
//                                                stops with a problem
//   a rule of it calls `crash`                   it stops with a problem
#ifndef RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_RUN_H_
#define RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_RUN_H_

#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/engine/interest/interest_need.h"
#include "policy_server/policy/inspect/inspection_set.h"
#include "policy_server/policy/replay/replayer.h"
#include "policy_server/server/flight/recorded_event.h"
#include "policy_server/server/robot/context/watch.h"
#include "policy_server/server/robot/model/judged_event.h"
#include "policy_server/server/shadow/shadow_report.h"

namespace rips::shadow {

struct ShadowPolicy {
  // As engine bundles have them.
  std::string bundle_id;
  std::string name;
  std::shared_ptr<const engine::CompiledPolicy> program;
  levels::LevelIndex start_level = 0;
  // Null: its rules inspect nothing.
  std::shared_ptr<const inspect::InspectionSet> inspections;
  // What its rules need; not null. Reasons are marked as of a shadow.
  std::shared_ptr<const pipeline::AlsoWatched> watched;
};

// Takes as long as compiling the rules.
std::shared_ptr<const pipeline::AlsoWatched> MakeWatched(const engine::CompiledPolicy& program,
                                                         const engine::PayloadLimits& limits);
ShadowPolicy PolicyOf(const bundle::Bundle& bundle);

// Not thread-safe. Memory does not grow with the number of events.
class ShadowRun {
 public:
  // `session` is of the policy's inspections, or null. Not owned; outlives this.
  ShadowRun(const ShadowPolicy& policy, const std::string& robot, const pipeline::RulesState& start,
            inspect::Session* session);

  // The next one.
  void Judge(const pipeline::JudgedEvent& judged);
  void Judge(const pipeline::LevelChange& level);

  // It judges nothing any more.
  bool stopped() const { return !problem_.empty(); }
  // Sets what is known here: all but the operator's part, `missed` and what is of the live policy.
  void Report(ShadowReport& report) const;

 private:
  bool Asks(const pipeline::JudgedEvent& judged, size_t& payload_bytes_max);
  absl::Status JudgeNow(recording::Recorded& recorded);
  // Counts what came of an event; `by_rules`: also its transitions.
  void Fold(bool by_rules);
  void Fold(const replay::Changed& change);
  void AddExample(const replay::Moment& at, const std::string& rule, const char* kind,
                  const std::string& text);
  void Stop(const std::string& problem);

  const std::string bundle_id_;
  const std::string name_;
  const std::shared_ptr<const engine::CompiledPolicy> program_;
  engine::InterestReader interest_;
  flight::EventConverter converter_;
  replay::Replayer replayer_;
  uint64_t events_ = 0;
  std::string problem_;
  ShadowCounts would_;
  std::vector<ShadowExample> first_;
  std::deque<ShadowExample> newest_;
};

}  // namespace rips::shadow

#endif  // RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_RUN_H_

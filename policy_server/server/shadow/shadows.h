// Shadows: runs policies muted beside those in force, each on one robot, all on one thread of the
// lowest priority.
//
// What they cost a robot: one copy of each event, and one lock (shadow_tap.h); what its sensors
// send more (robot/context/watch.h). Inspections are made on this thread, by processes of its own,
// and take nothing from the budget of the robot's.
//
// Robots take turns of kTurnNs, or of one event that takes longer. A shadow that is too slow for
// its robot misses events; another waits for one turn of it at a time.
//
//   its rule calls `crash`, or it cannot   it stops; its report stays, with the problem
//   go on
//   its robot retires, or is removed       the same, after what waits has been judged
//   another bundle comes into force        it goes on: its level and variables are its own, `live`
//                                          counts both bundles together
//   End, Stop                              it is gone at once; the robot's sensors are asked for
//                                          less with the next event, a tick at the latest
#ifndef RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOWS_H_
#define RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOWS_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "policy_server/server/robot/context/watch.h"
#include "policy_server/server/robot/ports.h"
#include "policy_server/server/shadow/shadow_report.h"
#include "policy_server/server/shadow/shadow_run.h"
#include "policy_server/server/shadow/shadow_tap.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::shadow {

struct ShadowStart {
  ShadowPolicy policy;
  std::string operator_name;
  std::string reason;
};

// Any thread. To be destroyed when no robot calls a tap any more.
class Shadows {
 public:
  static constexpr size_t kRobotsMax = 64;
  static constexpr int64_t kTurnNs = 5 * kNanosPerMilli;
  // Reports are at most this old.
  static constexpr int64_t kReportNs = 100 * kNanosPerMilli;

  // Sees to it that Robot::SetShadow is called on the robot's thread, now or later.
  using AddTap = std::function<absl::Status(std::shared_ptr<pipeline::ShadowRecorder> tap,
                                            std::shared_ptr<const pipeline::AlsoWatched> also)>;

  Shadows();
  // As Stop.
  ~Shadows();
  Shadows(const Shadows&) = delete;
  Shadows& operator=(const Shadows&) = delete;

  // Takes the place of one that has stopped. AlreadyExists: the robot has one that runs.
  // ResourceExhausted past kRobotsMax. Unavailable: stopped. Else what `add_tap` returns, and then
  // none begins.
  absl::Status Begin(const std::string& robot, ShadowStart start, const AddTap& add_tap)
      ABSL_LOCKS_EXCLUDED(mu_);
  // False: the robot has none.
  bool End(const std::string& robot) ABSL_LOCKS_EXCLUDED(mu_);
  // nullopt: the robot has none. None of these waits for a shadow that judges.
  std::optional<ShadowReport> Report(const std::string& robot, bool with_examples) const
      ABSL_LOCKS_EXCLUDED(mu_);
  // By name of the robot; without examples.
  absl::btree_map<std::string, ShadowReport> Reports() const ABSL_LOCKS_EXCLUDED(mu_);
  // Ends all, and the thread: after the event that is judged. Nothing begins any more.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Shadow;
  using ShadowPtr = std::shared_ptr<Shadow>;

  ShadowReport ReportOf(const Shadow& shadow, bool with_examples) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Its processes end on the thread.
  void Drop(const std::string& robot) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Wake() ABSL_LOCKS_EXCLUDED(mu_);

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Waits for work, and gives all that there are and those that are to go. False: it is over.
  bool Next(std::vector<ShadowPtr>& turns) ABSL_LOCKS_EXCLUDED(mu_);
  // True: it has more to judge.
  bool Turn(Shadow& shadow) ABSL_LOCKS_EXCLUDED(mu_);
  void Judge(Shadow& shadow, const ShadowTap::Item& item);
  // Shows what it has done, if it is time.
  void Publish(Shadow& shadow, int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);

  mutable Mutex mu_;
  CondVar changed_;
  absl::btree_map<std::string, ShadowPtr> shadows_ ABSL_GUARDED_BY(mu_);
  std::vector<ShadowPtr> dropped_ ABSL_GUARDED_BY(mu_);
  bool work_ ABSL_GUARDED_BY(mu_) = false;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  // Of the thread: a report is due.
  bool unpublished_ = false;
  std::thread thread_;
};

}  // namespace rips::shadow

#endif  // RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOWS_H_

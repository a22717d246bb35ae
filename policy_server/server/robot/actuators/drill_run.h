// One drill of a robot: its levels in turn on each actuator, all actuators at the same time. Pure;
// not thread-safe.
//
// | what an actuator does                       | its entry of that level | its further levels  |
// |---------------------------------------------|-------------------------|---------------------|
// | answers VERIFIED, FAILED, REFUSED, UNKNOWN  | as it says              | tried               |
// | answers REFUSED_STALE or SUPERSEDED         | as it says              | as that, not tried  |
// | acknowledges, and is not over in time       | no answer               | no answer           |
// | says nothing for kDrillResendNs             | told again              |                     |
// | goes away                                   | UNKNOWN, saying so      | UNKNOWN, not tried  |
// | is not attached from the beginning          | no answer, saying so    | the same            |
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_DRILL_RUN_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_DRILL_RUN_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "policy_server/server/robot/actuators/command_reconciler.h"
#include "policy_server/server/robot/context/id_source.h"
#include "policy_server/server/robot/model/actuator_inbound.h"
#include "policy_server/server/robot/model/drill_order.h"
#include "services/base/clock.h"

namespace rips::pipeline {

// Whoever asks is answered by then.
inline constexpr int64_t kDrillAnswerNs = 30 * kNanosPerSecond;
inline constexpr int64_t kDrillResendNs = 2 * kNanosPerSecond;
// What all answers of one drill may have together.
inline constexpr size_t kDrillBytesMax = 2 << 20;

class DrillRun {
 public:
  struct Host {
    std::string name;
    bool attached = false;
  };
  // `ids` names commands. At least one host is attached.
  DrillRun(const std::vector<std::string>& levels, const std::vector<Host>& hosts, IdSource& ids,
           Instant now);

  // What is to be sent now; `term` fences it.
  std::vector<Outgoing> Due(uint64_t term, Instant now);
  // False if it is of no command of this drill.
  bool OnReceipt(const std::string& host, const Receipt& receipt);
  void OnGone(const std::string& host);
  // Every entry has its answer, or the time is up.
  bool Over(Instant now) const;
  // Once it is over.
  std::vector<DrillEntry> PopEntries();

 private:
  struct Try {
    DrillEntry entry;
    std::string command_id;
    int64_t sent_ns = 0;  // 0 = not yet
    bool acknowledged = false;
    bool over = false;
  };
  // The one that `host` is at; null when it has none left.
  Try* Current(const std::string& host);
  // Ends what `host` has not answered.
  void EndRest(const std::string& host, Receipt::Stage stage, const std::string& why);

  const int64_t began_ns_;
  std::vector<std::string> hosts_;  // attached at the beginning
  std::vector<Try> tries_;          // by level, then by host
};

// `7 of 9 steps work; these do not: base: program horn (ALERT): exit code 1`.
std::string Summary(const std::vector<DrillEntry>& drills);
// Every entry was verified.
bool AllWork(const std::vector<DrillEntry>& drills);

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_DRILL_RUN_H_

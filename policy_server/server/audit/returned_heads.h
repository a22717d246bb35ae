// Compares the heads that actuators bring back with the audit log, on a thread of its own.
//
// One pass at most in `pause`, over what came since: of each actuator its first head, since what an
// honest one brings later it was shown by this server; of each segment one read. A hostile actuator
// costs one read of one segment in a pass. The same finding about one actuator is
// reported once in kAgainPasses: the same head, or another one that proves nothing.
#ifndef RIPS_POLICY_SERVER_SERVER_AUDIT_RETURNED_HEADS_H_
#define RIPS_POLICY_SERVER_SERVER_AUDIT_RETURNED_HEADS_H_

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "policy_server/audit/returned_head.h"
#include "policy_server/policy/engine/state/effect.h"
#include "services/model/audit_head.h"
#include "services/runtime/mutex.h"

namespace rips::audit {

// An actuator, by its certificate.
struct HeadSource {
  std::string robot;
  std::string host;
  friend auto operator<=>(const HeadSource&, const HeadSource&) = default;
};

class ReturnedHeads {
 public:
  // Actuators whose heads wait; more are not compared, which is logged.
  static constexpr size_t kWaitingMax = 8'192;
  // With the default pause, an hour at least.
  static constexpr uint64_t kAgainPasses = 360;

  // Calls `report` on its thread with each verdict that is held or that it has not reported yet;
  // `report` must not block.
  using Report =
      std::function<void(const HeadSource&, const model::AuditHead&, HeadVerdict verdict)>;
  ReturnedHeads(std::unique_ptr<Segments> segments, Report report,
                absl::Duration pause = absl::Seconds(10));
  // Compares what waits, without the pause: an actuator brings a head once.
  ~ReturnedHeads();

  // Nothing happens for a head that is none. Any thread; never blocks.
  void Compare(HeadSource source, model::AuditHead head) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  using Waiting = std::map<HeadSource, model::AuditHead>;

  // The last finding of one kind that was reported about an actuator.
  struct Last {
    std::string hash;
    uint64_t pass = 0;
  };

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Those whose segments could not be read: they are compared again.
  Waiting CompareAll(const Waiting& heads);
  void ReportOnce(const HeadSource& source, const model::AuditHead& head, HeadVerdict verdict);

  const std::unique_ptr<Segments> segments_;
  const Report report_;
  const absl::Duration pause_;
  // Both of the thread.
  uint64_t pass_ = 0;
  std::map<std::pair<HeadSource, HeadVerdict>, Last> last_;
  Mutex mu_;
  CondVar changed_;
  // Of stopping_ alone.
  CondVar stopped_;
  Waiting waiting_ ABSL_GUARDED_BY(mu_);
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

// The alert that a verdict raises; an empty text: none.
struct HeadAlert {
  engine::Severity severity = engine::Severity::kHigh;
  std::string text;
};
HeadAlert AlertOf(const HeadSource& source, const model::AuditHead& head, HeadVerdict verdict);

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_SERVER_AUDIT_RETURNED_HEADS_H_

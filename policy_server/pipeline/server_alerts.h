// Alerts that no robot of the pipeline can raise: of the server itself, and of robots that it does
// not judge. Kept until they are recorded, in an outage too, and told when they are.
#ifndef RIPS_POLICY_SERVER_PIPELINE_SERVER_ALERTS_H_
#define RIPS_POLICY_SERVER_PIPELINE_SERVER_ALERTS_H_

#include <functional>
#include <string>

#include "policy_server/engine/effect.h"
#include "policy_server/pipeline/ports.h"
#include "policy_server/store/committer.h"
#include "services/base/clock.h"

namespace rips::pipeline {

// Any thread; never blocks on the disk.
class ServerAlerts {
 public:
  // Nothing is owned; all outlive what is raised.
  ServerAlerts(store::Committer* committer, Audience* audience, const Clock* clock,
               std::function<std::string()> new_id)
      : committer_(committer), audience_(audience), clock_(clock), new_id_(std::move(new_id)) {}

  // `robot`: store::kServerRobot, or one of the inventory; `level` as recorded, may be empty.
  void Raise(const std::string& robot, engine::Severity severity, const std::string& text,
             const std::string& level = "");
  // Tells those who watch at once, whether it can be recorded or not.
  void Announce(const std::string& text) { audience_->OnNotice(text); }

 private:
  store::Committer* committer_;
  Audience* audience_;
  const Clock* clock_;
  std::function<std::string()> new_id_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_PIPELINE_SERVER_ALERTS_H_

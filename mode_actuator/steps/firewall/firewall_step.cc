#include "mode_actuator/steps/firewall/firewall_step.h"

#include <string>
#include <variant>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/ros2/ros_name.h"

namespace rips::actuator {
namespace {

class FirewallLevelStep final : public LevelStep {
 public:
  FirewallLevelStep(const Step& spec, FirewallControl* firewall, const Clock* clock)
      : LevelStep(spec), firewall_(firewall), clock_(clock) {}

  std::string Name() const override {
    const auto& step = std::get<FirewallStep>(spec().what);
    switch (step.kind) {
      case FirewallStep::Kind::kRules:
        return absl::StrCat("firewall ", step.file);
      case FirewallStep::Kind::kIsolateHosts:
        return absl::StrCat("firewall isolate_host ", absl::StrJoin(step.targets, ","));
      case FirewallStep::Kind::kIsolateParticipants:
        return absl::StrCat("firewall isolate_participant ", absl::StrJoin(step.targets, ","));
      case FirewallStep::Kind::kRelease:
        return "firewall release";
    }
    return "firewall";
  }
  bool in_order() const override { return true; }
  bool opens() const override {
    return std::get<FirewallStep>(spec().what).kind == FirewallStep::Kind::kRelease;
  }

  std::unique_ptr<StepAttempt> Enter(const EnterOptions& options, int64_t) override {
    return std::make_unique<BlockingAttempt>(Name(), clock_, [this, options] {
      return firewall_->Enter(spec(), options.timeout, options.retries, *options.cancel);
    });
  }
  std::unique_ptr<StepAttempt> Check(const CancelFlag& cancel, int64_t) override {
    return std::make_unique<BlockingAttempt>(
        Name(), clock_, [this, &cancel] { return firewall_->Check(spec(), cancel); });
  }
  StepResult Drill(const DrillOptions& options) override {
    const StepReading reading = firewall_->Drill(spec(), *options.cancel);
    return Looked(reading.status, ros2::Printable(reading.note));
  }

 private:
  FirewallControl* const firewall_;  // Not owned; outlives this.
  const Clock* const clock_;         // Not owned; outlives this.
};

}  // namespace

std::unique_ptr<LevelStep> MakeFirewallStep(const Step& spec, FirewallControl* firewall,
                                            const Clock* clock) {
  return std::make_unique<FirewallLevelStep>(spec, firewall, clock);
}

}  // namespace rips::actuator

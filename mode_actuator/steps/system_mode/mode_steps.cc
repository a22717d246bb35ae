#include "mode_actuator/steps/system_mode/mode_steps.h"

#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"

namespace rips::actuator {
namespace {

using Modes = std::map<std::string, std::string>;

StepReading ToReading(const SystemModeStep& mode, const ModeReading& reading) {
  return {.status = reading.status,
          .observed = absl::StrCat(mode.part, "=", reading.observed),
          .note = reading.note};
}

class ModeLevelStep final : public LevelStep {
 public:
  ModeLevelStep(const Step& spec, bool on_drift, PartModes* modes, const Clock* clock,
                std::shared_ptr<Modes> overridden)
      : LevelStep(spec),
        step_(std::get<SystemModeStep>(spec.what)),
        on_drift_(on_drift),
        modes_(modes),
        clock_(clock),
        overridden_(std::move(overridden)) {}

  std::string Name() const override {
    return absl::StrCat("system_mode ", step_.part, "=", step_.mode);
  }
  bool in_order() const override { return true; }

  std::unique_ptr<StepAttempt> Enter(const EnterOptions& options, int64_t) override {
    if (on_drift_) overridden_->erase(step_.part);
    return std::make_unique<BlockingAttempt>(Name(), clock_, [this, options] {
      const SystemModeStep wanted = Wanted();
      return ToReading(wanted, modes_->Enter(wanted.part, wanted.mode, options.timeout,
                                             options.retries, *options.cancel));
    });
  }
  void Entered(const StepAttempt& attempt) override {
    if (on_drift_ && attempt.result.ok) (*overridden_)[step_.part] = step_.mode;
  }
  void Forget() override { overridden_->erase(step_.part); }

  std::unique_ptr<StepAttempt> Check(const CancelFlag& cancel, int64_t) override {
    return std::make_unique<BlockingAttempt>(Name(), clock_, [this, &cancel] {
      const SystemModeStep wanted = Wanted();
      return ToReading(wanted, modes_->Check(wanted.part, wanted.mode, cancel));
    });
  }

  StepResult Drill(const DrillOptions& options) override {
    const ModeReading reading = modes_->Probe(step_.part, step_.mode, *options.cancel);
    return Looked(reading.status, absl::StrCat("its manager and parts answer; it is in ",
                                               ros2::Printable(reading.observed)));
  }

 private:
  SystemModeStep Wanted() const {
    const auto overridden = overridden_->find(step_.part);
    if (overridden == overridden_->end()) return step_;
    return {.part = step_.part, .mode = overridden->second};
  }

  const SystemModeStep step_;
  const bool on_drift_;
  PartModes* const modes_;    // Not owned; outlives this.
  const Clock* const clock_;  // Not owned; outlives this.
  const std::shared_ptr<Modes> overridden_;
};

}  // namespace

std::unique_ptr<LevelStep> ModeSteps::Make(const Step& spec, bool on_drift) const {
  return std::make_unique<ModeLevelStep>(spec, on_drift, modes_, clock_, overridden_);
}

}  // namespace rips::actuator

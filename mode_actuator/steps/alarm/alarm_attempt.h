// One alarm step with its retries, driven by polling.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_ATTEMPT_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_ATTEMPT_H_

#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/alarms.h"
#include "mode_actuator/steps/port/level_step.h"

namespace rips::actuator {

// Between two attempts: a device that is being plugged in again has a chance.
inline constexpr absl::Duration kAlarmRetryPause = absl::Milliseconds(200);

// One thread at a time.
class AlarmAttempt final : public StepAttempt {
 public:
  struct Options {
    AlarmOrder order = AlarmOrder::kSet;
    absl::Duration timeout;  // of one attempt
    int retries = 0;
  };

  // `alarms` is not owned and outlives this; the step must be an alarm.
  AlarmAttempt(const AlarmStep& step, std::string name, Alarms* alarms, const Options& options,
               int64_t now_ns);

  bool Poll(int64_t now_ns) override;
  void Cancel() override;

  // As AlarmResult::observed, of the last try; once it is over.
  const std::string& seen() const { return seen_; }

 private:
  void Try(int64_t now_ns);
  void EndTry(AlarmResult ended, int64_t now_ns);
  void See(std::string seen);

  const AlarmStep step_;
  Alarms* const alarms_;  // Not owned; outlives this.
  const Options options_;
  const int64_t began_ns_;
  uint64_t order_ = 0;  // 0 = none
  int tries_ = 0;
  int64_t next_try_ns_ = 0;
  int64_t try_end_ns_ = 0;
  bool finished_ = false;
  std::string seen_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_ATTEMPT_H_

// Carrying out one order of a test to its end. Test code only.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_TEST_ORDER_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_TEST_ORDER_H_

#include <string>

#include "absl/time/clock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/port/alarms.h"

namespace rips::actuator {

inline constexpr AlarmState kTestOff = {AlarmPattern::kOff, {}};
inline constexpr AlarmState kTestOn = {AlarmPattern::kOn, {}};

// Of devices that are not slow: this machine may be.
inline constexpr absl::Duration kTestIoBudget = absl::Seconds(15);

// The result of `order`; fails the test if there is none in 20 s.
inline AlarmResult Await(Alarms& alarms, uint64_t order) {
  for (int i = 0; i < 4000; ++i) {
    if (std::optional<AlarmResult> result = alarms.Poll(order)) return *std::move(result);
    absl::SleepFor(absl::Milliseconds(5));
  }
  ADD_FAILURE() << "order " << order << " is not over";
  return {.status = absl::InternalError("not over")};
}

inline AlarmResult Carry(Alarms& alarms, const std::string& alarm, AlarmOrder what,
                         const AlarmState& state) {
  const auto order = alarms.Begin(alarm, what, state);
  if (!order.ok()) return {.status = order.status()};
  return Await(alarms, *order);
}

inline AlarmResult SetAlarm(Alarms& alarms, const std::string& alarm, const AlarmState& state) {
  return Carry(alarms, alarm, AlarmOrder::kSet, state);
}
inline AlarmResult ReadAlarm(Alarms& alarms, const std::string& alarm, const AlarmState& state) {
  return Carry(alarms, alarm, AlarmOrder::kRead, state);
}

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_TEST_ORDER_H_

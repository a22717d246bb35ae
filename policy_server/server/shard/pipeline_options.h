// What a pipeline allows its robots, and what it reports of them.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_PIPELINE_OPTIONS_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_PIPELINE_OPTIONS_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>

#include "services/base/clock.h"

namespace rips::pipeline {

struct PipelineLimits {
  // Tasks of one robot that wait, per queue; `control_max` counts for actuators and for sensors.
  // One more is refused with ResourceExhausted.
  size_t orders_max = 1'024;
  size_t control_max = 4'096;
  size_t messages_max = 4'096;
  // Between two calls of a robot's OnTime.
  int64_t time_step_ns = 50 * kNanosPerMilli;
  // A turn ends after the task during which it has lasted so long.
  int64_t turn_ns = 2 * kNanosPerMilli;
  // CPU time that what a robot's agents send may use; at most `cpu_burst_ns` are saved. Beyond it
  // the robot's tasks wait, orders excepted.
  int64_t cpu_per_second_ns = 250 * kNanosPerMilli;
  int64_t cpu_burst_ns = 500 * kNanosPerMilli;
  // A robot with a task that costs so much moves to the thread of slow robots, and back when none
  // has for so long.
  int64_t long_task_ns = 20 * kNanosPerMilli;
  int64_t slow_stay_ns = 60 * kNanosPerSecond;
  // A thread that is late for leases and heartbeats by so much is an alert; so is a robot whose
  // tasks wait so long for its budget.
  int64_t late_ns = 500 * kNanosPerMilli;
};

// Called on the pipeline's threads; must not block. A null entry is not called.
struct PipelineReports {
  // A thread has been late for leases and heartbeats by `late_ns`; `robot` used most of that time.
  // Once an episode, which ends when the thread was in time for 10 s.
  std::function<void(const std::string& robot, int64_t late_ns)> late;
  // The tasks of a robot have waited for its budget for `late_ns`. Once an episode, which ends when
  // none has waited for a minute.
  std::function<void(const std::string& robot)> deferred;
  // True: the robot moved to the thread of slow robots; false: back.
  std::function<void(const std::string& robot, bool slow)> moved;
  // A task was refused because too many of the robot wait.
  std::function<void(const std::string& robot)> refused;
  // Gauges, once a second if they have changed: how long a task of the robot has waited at most in
  // that second; how late the thread was at most in the last 10 to 20 s.
  std::function<void(const std::string& robot, int64_t longest_ns)> waited;
  std::function<void(const std::string& thread, int64_t longest_ns)> lateness;
  // Each thread has called OnTime of all its robots since the last such call. Several times a
  // second, but not while a thread hangs.
  std::function<void()> advanced;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_PIPELINE_OPTIONS_H_

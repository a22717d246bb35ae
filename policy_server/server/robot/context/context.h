// What every part of a robot's core shares: who the robot is, when it is, and where actions go.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_CONTEXT_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_CONTEXT_H_

#include <cstdint>
#include <deque>
#include <utility>

#include "policy_server/policy/engine/state/event.h"
#include "policy_server/server/robot/context/action.h"
#include "policy_server/server/robot/context/id_source.h"
#include "policy_server/server/robot/context/input.h"
#include "policy_server/server/robot/context/policy.h"
#include "policy_server/server/robot/context/watch.h"
#include "policy_server/server/robot/model/robot_config.h"
#include "policy_server/server/store/generations.h"
#include "services/base/clock.h"

namespace rips::pipeline {

// One per core, of one thread. Parts add to `actions` and `events`, and change nothing else.
struct Context {
  RobotConfig config;
  // In force; its interest and kept topics are not null.
  Policy policy;
  Watch watch = {};
  Timing timing;
  // Names the robot's batches and its questions for terms.
  uint64_t tenure = 0;
  IdSource ids;
  // Of the input that is judged.
  Moment moment;
  // As the store said last.
  store::StorePoint store;
  // The server is about to stop.
  bool draining = false;
  Actions actions;
  // What parts have seen and rules are to judge; the core runs them when the part is done.
  std::deque<engine::ExternalEvent> events;

  const Instant& now() const { return moment.now; }
  int64_t now_ns() const { return moment.now.boottime_ns; }
  template <typename T>
  void Do(T what) {
    actions.emplace_back(std::move(what));
  }
  void Count(Counter counter, uint64_t by = 1) {
    if (by > 0) Do(action::Count{.counter = counter, .by = by});
  }
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_CONTEXT_H_

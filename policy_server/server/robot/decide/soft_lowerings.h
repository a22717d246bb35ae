// When rules have lowered a robot's level, as the store knows it after a restart: what is spent of
// the budget of soft lowerings stays spent.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_SOFT_LOWERINGS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_SOFT_LOWERINGS_H_

#include <cstdint>
#include <vector>

#include "policy_server/policy/levels/level_table.h"
#include "policy_server/server/store/records.h"
#include "services/base/clock.h"

namespace rips::pipeline {

// CLOCK_BOOTTIME of each lowering among `record.rule_decisions`, oldest first. The store has their
// times by the wall clock, which may have been set since. Where it contradicts itself, a lowering
// counts as the latest that it can have been: one of the future was made now, and none was made
// before a decision that precedes it. A change from or to a level that `table` does not have counts
// as a lowering.
std::vector<int64_t> SoftLowerings(const store::RobotRecord& record,
                                   const levels::LevelTable& table, Instant now);

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_SOFT_LOWERINGS_H_

// What happened in a simulation, so that a run in which little happens is noticed.
#ifndef RIPS_TESTS_SIMULATION_COUNTS_H_
#define RIPS_TESTS_SIMULATION_COUNTS_H_

#include <cstdint>

namespace rips::simulation {

struct Counts {
  uint64_t decisions = 0;
  uint64_t soft_lowerings = 0;
  uint64_t operator_lowerings = 0;
  uint64_t approved_lowerings = 0;  // of these, by two
  uint64_t judged = 0;
  uint64_t resent = 0;
  uint64_t verified = 0;
  uint64_t floors = 0;
  uint64_t lifted = 0;
  uint64_t refused_stale = 0;

  void Add(const Counts& other) {
    decisions += other.decisions;
    soft_lowerings += other.soft_lowerings;
    operator_lowerings += other.operator_lowerings;
    approved_lowerings += other.approved_lowerings;
    judged += other.judged;
    resent += other.resent;
    verified += other.verified;
    floors += other.floors;
    lifted += other.lifted;
    refused_stale += other.refused_stale;
  }
};

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_COUNTS_H_

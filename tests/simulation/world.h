// All parties of one robot in one thread, an operator, and what goes wrong: crashes, broken
// streams, disks that fail, clocks that jump, an actuator that is cut off.
#ifndef RIPS_TESTS_SIMULATION_WORLD_H_
#define RIPS_TESTS_SIMULATION_WORLD_H_

#include <cstdint>
#include <deque>
#include <optional>
#include <string>

#include "tests/simulation/actuator_model.h"
#include "tests/simulation/context.h"
#include "tests/simulation/sensor_model.h"
#include "tests/simulation/server_model.h"
#include "tests/simulation/store_model.h"

namespace rips::simulation {

class World {
 public:
  explicit World(uint64_t seed, Fault fault = Fault::kNone);

  // Runs one task and checks the invariants. False: one is violated.
  bool Step();
  uint64_t steps() const { return steps_; }
  const std::optional<Violation>& violation() const { return context_.checker.violation(); }
  const Counts& counts() const { return context_.checker.counts(); }
  const std::deque<std::string>& trace() const { return context_.trace.lines(); }

 private:
  void Robot();     // something happens on the robot, and again
  void Operator();  // the operator acts, and again
  void Trouble();   // something goes wrong, and again
  void Order(bool lower);
  // What waits for a second operator, who comes later, or the first one tries it alone.
  void Approve(const std::string& lowering, const std::string& reason);
  void CrashServer();

  Context context_;
  StoreModel store_;
  ServerModel server_;
  SensorModel sensor_;
  ActuatorModel actuator_;
  bool storm_ = false;
  uint64_t orders_ = 0;
  pipeline::RobotStatus seen_;  // by the operator
  uint64_t steps_ = 0;
};

// Runs until an invariant is violated, at most `steps` steps in worlds of `steps_each`, of the
// seeds from `seed` on.
struct Finding {
  uint64_t seed = 0;
  uint64_t step = 0;   // in the world of that seed
  uint64_t total = 0;  // of all worlds
  Violation violation;
  std::deque<std::string> trace;
};
// `counts`: of all worlds that were run to their end; may be null.
std::optional<Finding> Search(uint64_t seed, uint64_t steps, uint64_t steps_each, Fault fault,
                              Counts* counts = nullptr);

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_WORLD_H_

// The process of the policy server: one robot, its thread, its clock, and who watches it.
#ifndef RIPS_TESTS_SIMULATION_SERVER_MODEL_H_
#define RIPS_TESTS_SIMULATION_SERVER_MODEL_H_

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <string>

#include "policy_server/server/robot/robot.h"
#include "tests/simulation/context.h"
#include "tests/simulation/store_model.h"

namespace rips::simulation {

inline constexpr char kHost[] = "base";

class ServerModel final : public pipeline::RobotObserver {
 public:
  ServerModel(Context* context, StoreModel* store) : context_(*context), store_(*store) {}

  void Start();
  void Crash();
  bool up() const { return robot_ != nullptr; }
  // Names the process; another one after each start.
  uint64_t life() const { return life_; }
  // On the robot's thread, if that process still lives.
  void Call(uint64_t life, const std::function<void(pipeline::Robot&)>& call);
  // What the process that runs holds; it is up.
  pipeline::RobotStatus Status() const { return robot_->Status(); }

  // --- pipeline::RobotObserver
  void OnAlert(const store::AlertRecord& alert) override;
  void OnNotice(const std::string&) override {}
  void OnStatus(const pipeline::RobotStatus&) override {}
  void OnRuleLog(const std::string&, const std::string&, const std::string&) override {}

 private:
  pipeline::Ports MakePorts();
  void Post(std::deque<std::function<void()>>* line, std::function<void()> task);
  void RunPosted();
  void Tick();

  Context& context_;
  StoreModel& store_;
  uint64_t life_ = 0;
  uint64_t ids_ = 0;
  std::deque<std::function<void()>> posted_;
  std::deque<std::function<void()>> posted_work_;
  bool running_posted_ = false;
  std::unique_ptr<pipeline::Robot> robot_;
};

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_SERVER_MODEL_H_

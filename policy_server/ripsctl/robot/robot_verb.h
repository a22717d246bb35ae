// What the verbs `ripsctl robot VERB ROBOT` have in common.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_VERB_H_
#define RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_VERB_H_

#include <CLI/CLI.hpp>
#include <string>

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

// Takes the robot's id and checks it.
class RobotVerb : public Command {
 public:
  absl::string_view noun() const final { return "robot"; }
  void AddFlags(CLI::App& app) final {
    app.add_option("ROBOT", robot_, "Robot id")->required();
    AddMore(app);
  }
  ExitCode Run(Env& env) final {
    const absl::Status valid = CheckRobot(robot_);
    return valid.ok() ? RunFor(env, robot_) : UsageError(env, valid.message());
  }

 protected:
  virtual void AddMore(CLI::App&) {}
  virtual ExitCode RunFor(Env& env, const std::string& robot) = 0;

 private:
  std::string robot_;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_VERB_H_

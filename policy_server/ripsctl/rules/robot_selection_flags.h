// The flags by which an operator chooses robots: --robot, --label or --all.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_ROBOT_SELECTION_FLAGS_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_ROBOT_SELECTION_FLAGS_H_

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "rips/v1/operator.pb.h"

namespace CLI {
class App;
}

namespace rips::ripsctl {

class RobotSelectionFlags {
 public:
  // Once; this outlives what the App parses. `all_means`: the help of --all.
  void AddFlags(CLI::App& app, const std::string& all_means);
  // InvalidArgument unless exactly one kind is given, and each robot and label is well-formed.
  absl::Status Check() const;
  // After Check.
  v1::RobotSelection ToProto() const;
  // As it was given, for a command line: `--label ring=canary`.
  std::string ToFlags() const;

 private:
  std::vector<std::string> robots_;
  std::vector<std::string> labels_;
  bool all_ = false;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_ROBOT_SELECTION_FLAGS_H_

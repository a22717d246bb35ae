#include "policy_server/ripsctl/rules/robot_selection_flags.h"

#include <CLI/CLI.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/bundle/inventory.h"
#include "policy_server/ripsctl/cli/command.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {

void RobotSelectionFlags::AddFlags(CLI::App& app, const std::string& all_means) {
  app.add_option("--robot", robots_, "Robots by id");
  app.add_option("--label", labels_, "Robots that have all of these labels, each KEY=VALUE");
  app.add_flag("--all", all_, all_means);
}

absl::Status RobotSelectionFlags::Check() const {
  const int given = (robots_.empty() ? 0 : 1) + (labels_.empty() ? 0 : 1) + (all_ ? 1 : 0);
  if (given != 1) {
    return absl::InvalidArgumentError(
        absl::StrCat(given == 0 ? "which robots? " : "robots are chosen in one way only; ",
                     "give --robot ROBOT..., --label KEY=VALUE..., or --all"));
  }
  for (const std::string& robot : robots_) RIPS_RETURN_IF_ERROR(CheckRobot(robot));
  for (const std::string& label : labels_) {
    RIPS_RETURN_IF_ERROR(bundle::ParseLabel(label).status());
  }
  return absl::OkStatus();
}

v1::RobotSelection RobotSelectionFlags::ToProto() const {
  v1::RobotSelection selection;
  for (const std::string& robot : robots_) selection.add_robots(robot);
  for (const std::string& label : labels_) selection.add_labels(label);
  selection.set_all(all_);
  return selection;
}

std::string RobotSelectionFlags::ToFlags() const {
  if (all_) return "--all";
  return robots_.empty() ? absl::StrCat("--label ", absl::StrJoin(labels_, " "))
                         : absl::StrCat("--robot ", absl::StrJoin(robots_, " "));
}

}  // namespace rips::ripsctl

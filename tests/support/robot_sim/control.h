// What a test does to a running robot: lines written into a named pipe.
//
//   conduct honest|lie|deceive|refuse|absent   how the mode manager treats change_mode from now on
//   manager stop|start                          its process ends; another one starts
//   modes forget                                it forgets what was ordered, as after a restart
//   mode remove NAME                            its file has no such mode of the system any more
//   mode restore                                and has all of them again
//   pull FROM TO                                it leaves mode FROM for TO, as its own rules would
//   lens cover|clear                            the camera sees black, or its picture again
//   stuck NODE on|off                           the node's transitions fail
//   goes_on NODE on|off                         it publishes also while it says that it is inactive
//   go PLACE                                    it drives to this place of its floor
//   person                                      a person walks across its floor
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_CONTROL_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_CONTROL_H_

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/runtime/unique_fd.h"
#include "tests/support/robot_sim/robot.h"

namespace rips::robot_sim {

class Control {
 public:
  // Makes the pipe. Unavailable if it cannot.
  static absl::StatusOr<std::unique_ptr<Control>> Create(const std::string& path);

  // Does what was written since the last call and prints {"event":"control","line":...} for each
  // line. InvalidArgument for a line that is none of the above. Thread of Robot::Step.
  absl::Status Step(Robot& robot);

 private:
  explicit Control(UniqueFd fd) : fd_(std::move(fd)) {}

  const UniqueFd fd_;
  std::string input_;  // an unfinished line
};

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_CONTROL_H_

#include "tests/support/robot_sim/control.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "tests/support/robot_sim/events.h"

namespace rips::robot_sim {
namespace {

using Words = std::vector<std::string>;

absl::Status Unknown(const Words& words) {
  return absl::InvalidArgumentError(
      absl::StrCat("`", absl::StrJoin(words, " "), "` is no order to the robot"));
}

absl::Status SetConduct(const Words& words, Robot& robot) {
  static const auto* conducts =
      new absl::btree_map<std::string, ManagerConduct>{{"honest", ManagerConduct::kHonest},
                                                       {"lie", ManagerConduct::kLie},
                                                       {"deceive", ManagerConduct::kDeceive},
                                                       {"refuse", ManagerConduct::kRefuse},
                                                       {"absent", ManagerConduct::kAbsent}};
  const auto conduct = conducts->find(words[1]);
  if (conduct == conducts->end()) return Unknown(words);
  robot.With([&](ModeMachine& machine) { machine.SetConduct(conduct->second); });
  return absl::OkStatus();
}

absl::Status Obey(const Words& words, Robot& robot) {
  const std::string& verb = words[0];
  if (words.size() == 2 && verb == "conduct") return SetConduct(words, robot);
  if (words == Words{"manager", "start"}) return robot.StartManager();
  if (words.size() == 2 && verb == "go") return robot.Send(words[1]);
  if (words == Words{"person"}) return robot.SendPerson();
  if (words == Words{"manager", "stop"}) {
    robot.StopManager();
  } else if (words == Words{"modes", "forget"}) {
    robot.With([](ModeMachine& machine) { machine.ForgetModes(); });
  } else if (words == Words{"mode", "restore"}) {
    robot.With([](ModeMachine& machine) { machine.RestoreModes(); });
  } else if (words.size() == 3 && verb == "mode" && words[1] == "remove") {
    robot.With([&](ModeMachine& machine) { machine.RemoveMode(words[2]); });
  } else if (words == Words{"lens", "cover"} || words == Words{"lens", "clear"}) {
    robot.CoverLens(words[1] == "cover");
  } else if (words.size() == 3 && verb == "pull") {
    robot.With([&](ModeMachine& machine) { machine.SetPull(words[1], words[2]); });
  } else if (words.size() == 3 && verb == "stuck" && (words[2] == "on" || words[2] == "off")) {
    robot.With([&](ModeMachine& machine) { machine.SetStuck(words[1], words[2] == "on"); });
  } else if (words.size() == 3 && verb == "goes_on" && (words[2] == "on" || words[2] == "off")) {
    robot.With([&](ModeMachine& machine) { machine.SetGoesOn(words[1], words[2] == "on"); });
  } else {
    return Unknown(words);
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::unique_ptr<Control>> Control::Create(const std::string& path) {
  if (mkfifo(path.c_str(), 0600) != 0) {
    return absl::UnavailableError(
        absl::StrCat("cannot make the pipe `", path, "`: ", std::strerror(errno)));
  }
  // Open for writing, too: so it does not end when a writer closes it.
  UniqueFd fd(open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
  if (fd.get() < 0) return absl::UnavailableError(absl::StrCat("cannot open `", path, "`"));
  return std::unique_ptr<Control>(new Control(std::move(fd)));
}

absl::Status Control::Step(Robot& robot) {
  char buffer[512];
  for (ssize_t got = 0; (got = read(fd_.get(), buffer, sizeof(buffer))) > 0;) {
    input_.append(buffer, static_cast<size_t>(got));
  }
  for (size_t end = 0; (end = input_.find('\n')) != std::string::npos; input_.erase(0, end + 1)) {
    const std::string line = input_.substr(0, end);
    RIPS_RETURN_IF_ERROR(Obey(absl::StrSplit(line, ' '), robot));
    PrintEvent(nlohmann::ordered_json::object({{"event", "control"}, {"line", line}}));
  }
  return absl::OkStatus();
}

}  // namespace rips::robot_sim

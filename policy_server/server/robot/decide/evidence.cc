#include "policy_server/server/robot/decide/evidence.h"

namespace rips::pipeline {

std::vector<std::string> Evidence::Problems() const {
  std::vector<std::string> problems;
  sensors_.AddProblems(problems);
  if (context_.moment.backlog) {
    problems.push_back("what its agents sent waits: the robot costs more than its share");
  }
  if (sensors_.hosts().empty()) problems.push_back("no sensor is listed in the inventory");
  problems.insert(problems.end(), sight_.blind().begin(), sight_.blind().end());
  actuators_.AddProblems(problems);
  if (!context_.moment.store_writable) problems.push_back("cannot write the store");
  return problems;
}

}  // namespace rips::pipeline

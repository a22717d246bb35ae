// The robots of this server, distributed over threads. A robot belongs to one shard, a shard is one
// thread, and only that thread touches its robots; everything else crosses by Post.
#ifndef RIPS_POLICY_SERVER_PIPELINE_PIPELINE_H_
#define RIPS_POLICY_SERVER_PIPELINE_PIPELINE_H_

#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/status/status.h"
#include "policy_server/pipeline/robot.h"
#include "services/base/clock.h"

namespace rips::pipeline {

class Shard;

struct PipelineLimits {
  // Tasks waiting in one shard, per lane. Credit keeps sensors far below; a peer that does not keep
  // to it is refused.
  size_t control_max = 65'536;
  size_t messages_max = 16'384;
};

class Pipeline {
 public:
  // `shards` >= 1. `clock` is not owned and outlives this.
  Pipeline(int shards, const Clock* clock, PipelineLimits limits = {});
  ~Pipeline();

  // Before Start. `ports.post` is filled in here. Errors of Robot::Create.
  absl::Status Add(RobotConfig config, Policy policy, Timing timing,
                   const store::RobotRecord& record, uint64_t term, Ports ports);
  void Start();
  // Ends the threads; tasks still waiting are dropped. Idempotent.
  void Stop();

  // Runs `task` on the robot's thread. Control tasks run before message tasks; each lane in order.
  // NotFound for an unknown robot, ResourceExhausted if the shard is overloaded. Any thread.
  absl::Status Post(absl::string_view robot, Lane lane, std::function<void(Robot&)> task);
  // The same on every robot, in no order; waits until all have run. Not from a shard's thread.
  void ForEach(const std::function<void(Robot&)>& task);

  // Sorted. Fixed after Start.
  const std::vector<std::string>& robots() const { return names_; }

 private:
  const Clock* clock_;
  std::vector<std::unique_ptr<Shard>> shards_;
  std::vector<std::string> names_;
  absl::flat_hash_map<std::string, std::pair<Shard*, Robot*>> robots_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_PIPELINE_PIPELINE_H_

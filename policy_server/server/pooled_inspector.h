// Inspections of one policy, made by the server's pool.
#ifndef RIPS_POLICY_SERVER_SERVER_POOLED_INSPECTOR_H_
#define RIPS_POLICY_SERVER_SERVER_POOLED_INSPECTOR_H_

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "policy_server/policy/inspect/inspection_pool.h"
#include "policy_server/server/robot/ports.h"

namespace rips::server {

class PooledInspector final : public pipeline::Inspector {
 public:
  // `pool` is not owned and outlives this.
  PooledInspector(inspect::InspectionPool* pool, std::shared_ptr<const inspect::InspectionSet> set)
      : pool_(pool), set_(std::move(set)) {}

  // What the pool does not take is answered at once: unscanned.
  void Inspect(const std::string& robot, const std::vector<uint32_t>& inspections,
               const pipeline::InspectedMessage& message,
               std::function<void(std::vector<engine::Verdict>)> done) override;

 private:
  inspect::InspectionPool* const pool_;
  const std::shared_ptr<const inspect::InspectionSet> set_;
};

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_POOLED_INSPECTOR_H_

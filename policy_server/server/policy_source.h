// Where the policies of robots come from: for each, the kept bundle that an operator activated,
// else the one of its name in the server's directory.
#ifndef RIPS_POLICY_SERVER_SERVER_POLICY_SOURCE_H_
#define RIPS_POLICY_SERVER_SERVER_POLICY_SOURCE_H_

#include <functional>
#include <set>
#include <string>
#include <utility>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/bundle/inventory.h"
#include "policy_server/server/robot/context/policy.h"

namespace rips::server {

// One thread at a time.
class PolicySource {
 public:
  // A bundle of a directory, ready to judge; its manifest has that name. If `name` is empty it is
  // one that judged the robot before, whose id is compared: of any name, and no signature is
  // wanted, so that robots whose bundles are not signed yet are not left without a policy.
  using Load = std::function<absl::StatusOr<pipeline::Policy>(const std::string& dir,
                                                              const std::string& name)>;
  struct Options {
    // Paths, as ServerConfig's.
    std::string bundles_source;
    std::string bundles_dir;
    // Id of the kept bundle that was activated for a robot; empty: none. Null: of no robot.
    std::function<std::string(const bundle::InventoryRobot&)> activated;
    // Ids of bundles that are kept besides those that judge. Null: none.
    std::function<std::set<std::string>()> needed;
  };
  // A policy's name in the inventory, and the id of the bundle that was activated; empty = none.
  using Source = std::pair<std::string, std::string>;
  // The policy, or why it is refused.
  using Policies = absl::btree_map<Source, absl::StatusOr<pipeline::Policy>>;

  PolicySource(Options options, Load load) : options_(std::move(options)), load_(std::move(load)) {}

  Source SourceOf(const bundle::InventoryRobot& robot) const;
  // Of every robot of the inventory, or of `only`.
  Policies FindAll(const bundle::Inventory& inventory, const std::set<std::string>* only = nullptr);
  // The policy of that name that the directory holds, or, if `id` is not empty, the kept bundle of
  // that id.
  absl::StatusOr<pipeline::Policy> Find(const std::string& name, const std::string& id);
  // The kept copy of a bundle that judged before. DataLoss: it was changed.
  absl::StatusOr<pipeline::Policy> FindLastGood(const std::string& id);
  // Removes copies of bundles that are not needed, beyond what bundle_keep.h lets stay. `in_use`:
  // those that judge.
  void ForgetUnused(std::set<std::string> in_use);

 private:
  absl::StatusOr<pipeline::Policy> LoadFromDirectory(const std::string& name);

  const Options options_;
  const Load load_;
  // Kept bundles that were loaded, by id.
  absl::btree_map<std::string, pipeline::Policy> loaded_;
};

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_POLICY_SOURCE_H_

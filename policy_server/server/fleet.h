// The robots of the inventory and the policies that they are judged by. One robot's trouble costs
// that robot only:
//
//   its bundle                       robot
//   good                             judged by it; the bundle is kept, its id recorded
//   refused, the last good one kept  judged by the last good one; critical alert, status
//   refused, none is kept held: nothing judges it, its agents are refused with words, its
//                                    actuators keep their level and take their fail-safe one when
//                                    the lease ends; critical alert, status
//   does not declare the level that  as refused
//   the robot is recorded at
//   mended, then Reload              judged
//
// Its bundle is the one that an operator activated for it (server/rollout), else the one in the
// server's directory of the name that the inventory has.
//
// A robot that another server acquires is held, too, until Reload acquires it anew: its leases end,
// its level is the other server's.
//
// A robot of no inventory any more is removed; one that comes back has its recorded level.
#ifndef RIPS_POLICY_SERVER_SERVER_FLEET_H_
#define RIPS_POLICY_SERVER_SERVER_FLEET_H_

#include <functional>
#include <set>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "policy_server/policy/bundle/inventory.h"
#include "policy_server/server/policy_source.h"
#include "policy_server/server/shard/agent_contacts.h"
#include "policy_server/server/shard/pipeline.h"
#include "policy_server/server/shard/robot_labels.h"
#include "policy_server/server/shard/server_alerts.h"
#include "policy_server/server/store/store.h"

namespace rips::server {

struct FleetOptions {
  // A file or a directory, as ServerConfig's.
  std::string inventory;
  pipeline::Timing timing;
  // How long a robot that was removed may take to be gone before it can be added again.
  absl::Duration leaving = absl::Seconds(5);
};

// What is counted; a null entry is not.
struct FleetCounts {
  // Robots that are judged by what the inventory names, by an older bundle, and by nothing.
  std::function<void(size_t armed, size_t on_last_good, size_t held)> robots;
  // A robot of the inventory, when it is first seen there.
  std::function<void(const bundle::InventoryRobot&)> listed;
  // The inventory that is in force from now on; before Start returns, and at each Reload.
  // `refused`: it is an older one than that on disk.
  std::function<void(const bundle::Inventory&, bool refused)> inventory;
};

// The sensors and actuators that it lists.
std::vector<pipeline::AgentId> AgentsOf(const bundle::Inventory& inventory);
pipeline::RobotLabels::Labels LabelsOf(const bundle::Inventory& inventory);

// One thread at a time.
class Fleet {
 public:
  // Nothing is owned; all outlive this. `ports` are given to each robot.
  Fleet(FleetOptions options, store::Store* store, pipeline::Pipeline* pipeline,
        pipeline::ServerAlerts* alerts, PolicySource* policies, pipeline::Ports ports,
        FleetCounts counts = {});

  // Before Pipeline::Start: the robots of the inventory. An error only if the inventory or the
  // store cannot be read, or the store not be written.
  absl::Status Start();
  // Reads inventory and bundles anew: robots and hosts come, change and go. What is refused leaves
  // the old in force and says so.
  void Reload();
  // Has those robots of the inventory judged by what is activated for them now.
  void Apply(const std::set<std::string>& robots);
  // Removes copies of bundles that are not needed, beyond what bundle_keep.h lets stay.
  void ForgetUnused();
  // Why the robot is not judged by what it should be; empty = it is.
  std::string Problem(const std::string& robot) const;
  // In force.
  const bundle::Inventory& inventory() const { return inventory_; }
  // Sensors and actuators that the inventory in force lists.
  int agents() const;

 private:
  absl::StatusOr<bundle::Inventory> ReadInventory() const;
  // Adds, changes or holds each robot of `now`, or of `only`.
  void Settle(const bundle::Inventory& now, const std::set<std::string>* only = nullptr);
  // Adds or holds it.
  absl::Status Arm(const bundle::InventoryRobot& robot,
                   const absl::StatusOr<pipeline::Policy>& policy, const store::Acquired& acquired);
  // Another server has acquired the robot: it is held here. Any thread.
  void OnFenced(const std::string& robot, const absl::Status& why);
  absl::Status Hold(const bundle::InventoryRobot& robot, const store::RobotRecord& record,
                    const std::string& why);
  // A robot that is judged: other hosts, another policy.
  void Change(const bundle::InventoryRobot& robot, const bundle::InventoryRobot* before,
              const absl::StatusOr<pipeline::Policy>& policy);
  void RemoveMissing(const bundle::Inventory& now);
  // Tells of it where it is news, and forgets it if `text` is empty. `status`: as the robot shows
  // it.
  void SetProblem(const std::string& robot, const std::string& text, const std::string& level);
  void Count();

  const FleetOptions options_;
  store::Store* store_;
  pipeline::Pipeline* pipeline_;
  pipeline::ServerAlerts* alerts_;
  PolicySource* policies_;
  pipeline::Ports ports_;
  const FleetCounts counts_;
  bundle::Inventory inventory_;
  // By robot: why it is not judged by what the inventory names.
  absl::btree_map<std::string, std::string> problems_;
};

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_FLEET_H_

// The inventory on disk: one file, or a directory of files, `robots.yaml` or `robots.d`.
//
//   what the path is     what is read
//   a file, or a link    that file
//   a directory          its entries `*.yaml` in the order of their names (bytes); the others are
//                        ignored: names that begin with `.` or `#`, `*.bak`, `*~`, `*.yaml.tmp`;
//                        a name `*.yml` is an error, since its robots would go without guard
//
// Entries of `bundles` and of `sensor_settings` hold for the robots of all files, in the order of
// the files.
//
// All or nothing: one file that cannot be read or is malformed refuses the whole inventory. Each
// file has the form of robots.yaml, and is opened as that is: links are followed.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_INVENTORY_FILES_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_INVENTORY_FILES_H_

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/policy/bundle/inventory.h"

namespace rips::bundle {

// Of one directory, those that are ignored included.
inline constexpr size_t kInventoryEntriesMax = 10'000;

struct InventoryFiles {
  Inventory inventory;
  // Path of each file that was read, in that order, and how many robots it lists.
  std::vector<std::pair<std::string, size_t>> files;
};

// InvalidArgument with every problem of every file; also for a robot in two files, for a directory
// without a file `*.yaml`, for what every user may write, and for more than kRobotsMax robots. Else
// as the file cannot be read.
absl::StatusOr<InventoryFiles> ReadInventory(const std::string& path);

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_INVENTORY_FILES_H_

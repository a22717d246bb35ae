// Which participants serve what a level is read back from and ordered by: for each part, the
// request readers of its state, mode and parameter services.
#ifndef RIPS_SENSOR_AGENT_FINDINGS_PART_SERVERS_H_
#define RIPS_SENSOR_AGENT_FINDINGS_PART_SERVERS_H_

#include <cstdint>
#include <limits>
#include <optional>
#include <string>

#include "absl/container/btree_map.h"
#include "absl/container/btree_set.h"
#include "absl/strings/string_view.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::sensor {

// Not thread-safe; no clock.
class PartServers {
 public:
  static constexpr int64_t kNone = std::numeric_limits<int64_t>::max();

  // Participants that serve one service.
  struct Server {
    absl::btree_set<ros2::Guid> all;
    int64_t first_ns = kNone;
    // The first of them; nullopt = it cannot be told.
    std::optional<ros2::Guid> first;
  };
  // What one participant serves of a part and should not.
  struct Rival {
    absl::btree_set<std::string> services;
    std::string node;  // that claims one of them; empty = none
    // When the first server was seen that a node claims, and that no node claims; kNone = there is
    // none such.
    int64_t claimed_ns = kNone;
    int64_t unclaimed_ns = kNone;
  };

  // A node's endpoint of kind kService, as the graph has it now; any other service is ignored. One
  // that `before` knows was seen when that says.
  void Upsert(const ros2::Endpoint& endpoint, int64_t now_ns, const PartServers& before);
  void Drop(const ros2::Guid& endpoint);
  void DropAllOf(const ros2::Guid& participant);

  // nullopt if nothing serves it.
  std::optional<Server> ChangeModeOf(absl::string_view part) const;
  // By participant: a server of a service that another participant served first (or all, if they
  // were seen at once); one of the part's state or parameters while its node is in `owners`, which
  // are others; one that no node claims. `owners` null = no node of that name is known.
  absl::btree_map<ros2::Guid, Rival> RivalsOf(absl::string_view part,
                                              const absl::btree_set<ros2::Guid>* owners) const;

 private:
  struct Served {
    int64_t seen_ns = 0;
    std::string service;
    std::string node;
    bool unclaimed = false;  // past the attribution grace
  };
  using ServedBy = absl::btree_map<ros2::Guid, Served>;

  static absl::btree_map<absl::string_view, Server> ByService(const ServedBy& served);

  absl::btree_map<std::string, ServedBy> parts_;
  absl::btree_map<ros2::Guid, std::string> part_of_;  // of each request reader
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_FINDINGS_PART_SERVERS_H_

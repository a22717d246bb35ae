// What a graph may hold, who shares it, and what is said of the rest.
//
// The sensor's graph and the server's go by one table. "Kept" is an endpoint that publishes or
// subscribes to a topic that rules name. First line that fits:
//
// | the new endpoint's participant | the graph | the endpoint | becomes                          |
// |--------------------------------|-----------|--------------|----------------------------------|
// | holds `endpoints_per_...`      | any       | is kept      | held; one of the same            |
// |                                |           |              | participant's that are not goes  |
// | holds `endpoints_per_...`      | any       | is not       | left out                         |
// | holds fewer                    | is full   | is kept      | held; one that is not kept goes, |
// |                                |           |              | of the participant that has most |
// | holds fewer                    | is full   | is not       | left out                         |
// | holds fewer                    | has room  | any          | held                             |
//
// Where none can go, the endpoint is left out. Nodes have the same limits and are never evicted.
// A participant at its limit could have had anything, so the whole graph counts as truncated.
#ifndef RIPS_SERVICES_ROS2_GRAPH_LIMITS_H_
#define RIPS_SERVICES_ROS2_GRAPH_LIMITS_H_

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "absl/container/flat_hash_set.h"
#include "services/ros2/guid.h"

namespace rips::ros2 {

struct GraphLimits {
  // Names of topics that rules name come on top: kKeptTopicsMax at most.
  size_t topics = 4'096;
  size_t nodes = 2'048;
  size_t endpoints = 16'384;
  size_t participants = 2'048;
  // A process that publishes on a topic of its own each time holds half of the topics.
  size_t endpoints_per_participant = 2'048;
  size_t nodes_per_participant = 512;

  friend bool operator==(const GraphLimits&, const GraphLimits&) = default;
};

// For what was bounded before: a recording, a graph that was acknowledged.
inline constexpr GraphLimits kWideGraphLimits = {
    .topics = 65'536,
    .nodes = 65'536,
    .endpoints = 65'536,
    .participants = 65'536,
    .endpoints_per_participant = std::numeric_limits<size_t>::max(),
    .nodes_per_participant = std::numeric_limits<size_t>::max()};

// ROS names of topics whose endpoints are kept first.
using TopicNames = absl::flat_hash_set<std::string>;
inline constexpr size_t kKeptTopicsMax = 1'024;

// What limits leave out of a graph; of a whole graph everything is zero.
struct Truncation {
  // A participant of which something is left out.
  struct Crowd {
    Guid participant;
    // That the graph holds, and that it does not: at least so many.
    uint64_t endpoints = 0;
    uint64_t left_out = 0;

    friend bool operator==(const Crowd&, const Crowd&) = default;
  };
  static constexpr size_t kCrowdsMax = 8;

  // At least as many participants, nodes and endpoints as are missing; 0 = nothing is.
  uint64_t left_out = 0;
  // Those of which most is left out, most first; at most kCrowdsMax.
  std::vector<Crowd> crowds;

  friend bool operator==(const Truncation&, const Truncation&) = default;
};

// Sorts and cuts `crowds` to what a Truncation holds.
void KeepLargest(std::vector<Truncation::Crowd>& crowds);

}  // namespace rips::ros2

#endif  // RIPS_SERVICES_ROS2_GRAPH_LIMITS_H_

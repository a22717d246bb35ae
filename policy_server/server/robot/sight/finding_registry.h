// The findings of one robot that stand, as its sensors tell them.
//
// A finding is the same one if kind, GUID, node and topic are. It may be told by several sensors,
// which see the same bus, and again by one whose server has forgotten: it is news once. It stands
// until no sensor says so: a sensor tells that it is over, or begins a new incarnation and does not
// tell it again in time.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_REGISTRY_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_REGISTRY_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <tuple>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/robot/model/inbound.h"
#include "services/base/clock.h"

namespace rips::pipeline {

struct FindingsLimits {
  // Standing findings of one robot. Further ones are told and not kept, so they are news again each
  // time they are told.
  size_t standing = 4'096;
  // A sensor that was started again has this long to tell what still stands.
  int64_t confirm_ns = 60 * kNanosPerSecond;
};

// Not thread-safe; times are CLOCK_BOOTTIME in nanoseconds.
class FindingRegistry {
 public:
  enum class News {
    kBegins,   // nobody had told it
    kKnown,    // it stands already, or is over already
    kEnds,     // nobody says so any more
    kTooMany,  // begins, and is not kept because of the limit
  };

  explicit FindingRegistry(FindingsLimits limits = {}) : limits_(limits) {}

  // `incarnation` is the one that took the observation; the sensor may be in a later one.
  News Apply(const std::string& host, const std::string& incarnation, const FindingSeen& seen,
             int64_t now_ns);
  // The sensor speaks as this incarnation from now on.
  void OnIncarnation(const std::string& host, const std::string& incarnation, int64_t now_ns);
  // Takes out, and gives, what nobody has told again in time.
  std::vector<FindingSeen> Expire(int64_t now_ns);

  // Oldest first.
  std::vector<FindingSeen> standing() const;

 private:
  using Key = std::tuple<std::string, ros2::Guid, std::string, std::string>;
  struct Entry {
    FindingSeen finding;
    uint64_t order = 0;
    // By sensor: until when its word counts; 0 = until it says otherwise.
    absl::btree_map<std::string, int64_t> told_by;
  };

  static Key KeyOf(const FindingSeen& seen) {
    return {seen.kind, seen.guid, seen.node, seen.topic};
  }

  FindingsLimits limits_;
  absl::btree_map<Key, Entry> entries_;
  absl::btree_map<std::string, std::string> incarnations_;
  uint64_t last_order_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_REGISTRY_H_

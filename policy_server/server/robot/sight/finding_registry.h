// The findings of one robot that stand, as its sensors tell them.
//
// A finding is the same one if kind, GUID, node and topic are. It may be told by several sensors,
// which see the same bus, and again by one whose server has forgotten: it is news once. It stands
// until no sensor says so: a sensor tells that it is over, or begins a new incarnation and does not
// tell it again in time.
//
// What is not here does not stand only as far as the sensors have told all:
//
//   a sensor                                        has told all
//   that was not heard since the server's start     no
//   of a new incarnation, from its first            confirm_ns after its hello: as long as
//   observation, or asked to tell all again         discovery and every grace may take
//   of an older incarnation, not asked              no: it tells no more than what changes
//   whose finding was not kept because of the       not before its next incarnation
//   limit
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_REGISTRY_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_REGISTRY_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
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
  // Ends that are remembered; beyond, the oldest are forgotten.
  size_t ended = 256;
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
  using Key = std::tuple<std::string, ros2::Guid, std::string, std::string>;
  struct Entry {
    FindingSeen finding;
    uint64_t order = 0;
    int64_t since_ns = 0;
    // An alert names it.
    bool named = false;
    // By sensor: until when its word counts; 0 = until it says otherwise.
    absl::btree_map<std::string, int64_t> told_by;
  };
  struct Ended {
    Key key;
    int64_t at_ns = 0;
    bool named = false;
  };

  explicit FindingRegistry(FindingsLimits limits = {}) : limits_(limits) {}

  static Key KeyOf(const FindingSeen& seen) {
    return {seen.kind, seen.guid, seen.node, seen.topic};
  }

  // `incarnation` is the one that took the observation; the sensor may be in a later one.
  News Apply(const std::string& host, const std::string& incarnation, const FindingSeen& seen,
             int64_t now_ns);
  // The sensor speaks as this incarnation from now on. `tells_all`: from its first observation, or
  // it was asked to tell again all that stands.
  void OnIncarnation(const std::string& host, const std::string& incarnation, int64_t now_ns,
                     bool tells_all = true);
  // Takes out, and gives, what nobody has told again in time.
  std::vector<Entry> Expire(int64_t now_ns);

  // Null if it does not stand.
  Entry* Find(const Key& key);
  const Entry* Find(const Key& key) const;
  const absl::btree_map<Key, Entry>& entries() const { return entries_; }
  // The newest last.
  const std::deque<Ended>& ended() const { return ended_; }
  // Oldest first.
  std::vector<FindingSeen> standing() const;
  // Why the sensor may have more to tell, as words behind its name; empty = it has told all.
  std::string NotToldAll(const std::string& host, int64_t now_ns) const;

 private:
  static constexpr int64_t kNever = std::numeric_limits<int64_t>::max();
  struct Host {
    std::string incarnation;
    // From then on it has told all that stands.
    int64_t told_all_ns = kNever;
    // Something that it told was not kept.
    bool overflowed = false;
  };

  void AddEnded(const Key& key, bool named, int64_t now_ns);

  FindingsLimits limits_;
  absl::btree_map<Key, Entry> entries_;
  std::deque<Ended> ended_;
  absl::btree_map<std::string, Host> hosts_;
  uint64_t last_order_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_REGISTRY_H_

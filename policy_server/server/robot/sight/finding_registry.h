// The findings of one robot that stand, as its sensors tell them.
//
// A finding is the same one if kind, GUID, node and topic are. It may be told by several sensors,
// which see the same bus, and again by one whose server has forgotten: it is news once. It stands
// until no sensor says so: a sensor tells that it is over, or begins a new incarnation and does not
// tell it again in time.
//
// What is not here does not stand only as far as the sensors have told all. Each says so of itself,
// with a digest of what it has told: a sensor and its server may lose, end or keep different ones.
//
//   a sensor                                        has told all
//   that has not said so since its last hello       no
//   of a version that does not say so               no
//   whose digest is another one than ours           no; it is asked to tell again what stands, and
//                                                   what it does not tell stands for confirm_ns
//   that says that more may stand                   no
//   else                                            yes
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_REGISTRY_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_REGISTRY_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/functional/function_ref.h"
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
    uint64_t digest = 0;
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
  // A session begins: the sensor speaks as this incarnation from now on.
  void OnHello(const std::string& host, const std::string& incarnation, int64_t now_ns);
  // What the sensor said last, in this session. `digest`: none = its version does not say.
  void OnState(const std::string& host, std::optional<uint64_t> digest, bool all_told);
  // Those that the inventory does not list any more have said nothing.
  void KeepOnly(absl::FunctionRef<bool(const std::string& host)> listed, int64_t now_ns);
  // Takes out, and gives, what nobody has told again in time.
  std::vector<Entry> Expire(int64_t now_ns);
  enum class Asked {
    kNo,
    kYes,        // it has confirm_ns for it
    kYesInVain,  // this process of it was asked, had its time and differs; once until it agrees
  };
  // Whether to ask the sensor now to tell again what stands.
  Asked Ask(const std::string& host, int64_t now_ns);

  // Null if it does not stand.
  Entry* Find(const Key& key);
  const Entry* Find(const Key& key) const;
  const absl::btree_map<Key, Entry>& entries() const { return entries_; }
  // One of that kind stands.
  bool HasKind(absl::string_view kind) const;
  // The newest last.
  const std::deque<Ended>& ended() const { return ended_; }
  // Oldest first.
  std::vector<FindingSeen> standing() const;
  // Why the sensor may have more to tell, as words behind its name; empty = it has told all.
  std::string NotToldAll(const std::string& host) const;

 private:
  struct Said {
    std::optional<uint64_t> digest;
    bool all_told = false;
  };
  struct Host {
    std::string incarnation;
    // In this session.
    std::optional<Said> said;
    // Of what it has told, here.
    uint64_t digest = 0;
    // When that was seen first not to be what it said; 0 = it is.
    int64_t differs_ns = 0;
    int64_t asked_ns = 0;
    // kYesInVain was answered.
    bool in_vain = false;

    bool differs() const { return said && said->digest && *said->digest != digest; }
  };
  static constexpr int64_t kDiffersNs = 5 * kNanosPerSecond;

  // What it has told ends, unless it tells it again in time.
  void MayEnd(const std::string& host, int64_t now_ns);
  void AddTeller(Entry& entry, const std::string& host, int64_t until_ns);
  void RemoveTellers(Entry& entry, absl::FunctionRef<bool(const std::string& host, int64_t)> goes);
  void AddEnded(const Key& key, bool named, int64_t now_ns);

  FindingsLimits limits_;
  absl::btree_map<Key, Entry> entries_;
  std::deque<Ended> ended_;
  absl::btree_map<std::string, Host> hosts_;
  uint64_t last_order_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_REGISTRY_H_

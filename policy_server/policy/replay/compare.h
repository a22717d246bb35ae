// What two rule sets did differently on one recording.
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_COMPARE_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_COMPARE_H_

#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "policy_server/policy/replay/result.h"

namespace rips::replay {

// Entries that only one of the two has, in the order they happened.
template <typename Record>
struct OnlyOne {
  std::vector<Record> before;
  std::vector<Record> after;

  bool none() const { return before.empty() && after.empty(); }
};

struct Difference {
  // The first event at which the two did not do the same; nullopt: there is none.
  std::optional<Moment> first;
  OnlyOne<Changed> transitions;
  OnlyOne<Alerted> alerts;
  OnlyOne<Executed> execs;
  // At the end.
  std::string level_before;
  std::string level_after;
  // At the end: those that only one has, or both with other values.
  absl::btree_map<std::string, lang::Value> variables_before;
  absl::btree_map<std::string, lang::Value> variables_after;
  // A list of one of them was cut (Result::left_out); what is not there is not compared.
  bool left_out = false;

  bool none() const {
    return transitions.none() && alerts.none() && execs.none() && level_before == level_after &&
           variables_before.empty() && variables_after.empty();
  }
};

// Both results are of the same recording. An entry is the same if event and content are, whatever
// rule it comes from and in whatever order an event's entries come; one that is there twice must be
// there twice. Faults, hits and what `True` and `False` show are not compared.
Difference Compare(const Result& before, const Result& after);

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_COMPARE_H_

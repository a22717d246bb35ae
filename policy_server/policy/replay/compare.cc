#include "policy_server/policy/replay/compare.h"

#include <map>
#include <tuple>

#include "policy_server/policy/lang/value_text.h"

namespace rips::replay {
namespace {

// What makes an entry the same.
auto KeyOf(const Changed& change) {
  return std::tie(change.at.event, change.from, change.to, change.refused);
}
auto KeyOf(const Alerted& alert) { return std::tie(alert.at.event, alert.text, alert.severity); }
auto KeyOf(const Executed& exec) {
  return std::tie(exec.at.event, exec.program, exec.args, exec.ok);
}

// The entries of `records` beyond those that `others` has too.
template <typename Record>
std::vector<Record> Beyond(const std::vector<Record>& records, const std::vector<Record>& others) {
  std::map<decltype(KeyOf(records[0])), size_t> theirs;
  for (const Record& other : others) ++theirs[KeyOf(other)];
  std::vector<Record> out;
  for (const Record& record : records) {
    const auto found = theirs.find(KeyOf(record));
    if (found == theirs.end() || found->second == 0) {
      out.push_back(record);
    } else {
      --found->second;
    }
  }
  return out;
}

template <typename Record>
OnlyOne<Record> Only(const std::vector<Record>& before, const std::vector<Record>& after,
                     std::optional<Moment>& first) {
  OnlyOne<Record> only{.before = Beyond(before, after), .after = Beyond(after, before)};
  for (const std::vector<Record>* list : {&only.before, &only.after}) {
    if (list->empty()) continue;
    const Moment& at = list->front().at;
    if (!first.has_value() || at.event < first->event) first = at;
  }
  return only;
}

using Variables = absl::btree_map<std::string, lang::Value>;

// Those of `values` that `others` has not, or otherwise. NaN is the same as NaN.
Variables Beyond(const Variables& values, const Variables& others) {
  Variables out;
  for (const auto& [name, value] : values) {
    const auto other = others.find(name);
    const bool same = other != others.end() && other->second.index() == value.index() &&
                      lang::ToText(other->second) == lang::ToText(value);
    if (!same) out.emplace(name, value);
  }
  return out;
}

}  // namespace

Difference Compare(const Result& before, const Result& after) {
  Difference out;
  out.transitions = Only(before.transitions, after.transitions, out.first);
  out.alerts = Only(before.alerts, after.alerts, out.first);
  out.execs = Only(before.execs, after.execs, out.first);
  out.level_before = before.level;
  out.level_after = after.level;
  out.variables_before = Beyond(before.variables, after.variables);
  out.variables_after = Beyond(after.variables, before.variables);
  out.left_out = before.left_out > 0 || after.left_out > 0;
  return out;
}

}  // namespace rips::replay

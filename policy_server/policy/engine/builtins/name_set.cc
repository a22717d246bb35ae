#include "policy_server/policy/engine/builtins/name_set.h"

#include <algorithm>

#include "absl/strings/match.h"

namespace rips::engine {

void NameSet::Seal() {
  std::sort(given_.begin(), given_.end(),
            [](const Given& a, const Given& b) { return a.name < b.name; });
  given_.erase(std::unique(given_.begin(), given_.end(),
                           [](const Given& a, const Given& b) { return a.name == b.name; }),
               given_.end());
}

bool NameSet::MarkSeen(absl::string_view name) {
  const auto found =
      std::lower_bound(given_.begin(), given_.end(), name,
                       [](const Given& given, absl::string_view n) { return given.name < n; });
  if (found == given_.end() || found->name != name) return false;
  found->seen = true;
  return true;
}

bool NameSet::See(absl::string_view name) {
  bool known = false;
  if (kind_ == Kind::kPlain) {
    known = MarkSeen(name);
  } else if (absl::StartsWith(name, "/")) {
    known = MarkSeen(name);
    // A base name holds no slash, so it can only meet a given name without one.
    known |= MarkSeen(name.substr(name.rfind('/') + 1));
  }
  if (!known) ++strangers_;
  return known;
}

bool NameSet::AllGivenCurrent() const {
  return std::all_of(given_.begin(), given_.end(), [](const Given& given) { return given.seen; });
}

}  // namespace rips::engine

#include "policy_server/server/store/generations.h"

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"

namespace rips::store {

bool GoesOnFrom(const std::vector<Generation>& chain, uint64_t commit, const StorePoint& seen) {
  if (seen.generation.empty() || chain.empty()) return true;
  if (chain.back().id == seen.generation) return seen.commit <= commit;
  for (const Generation& generation : chain) {
    if (generation.id == seen.generation) return seen.commit <= generation.last_commit;
  }
  return chain.size() >= kGenerationsMax && seen.commit <= chain.front().last_commit;
}

std::string ToString(const StorePoint& point) {
  // Enough to tell generations apart.
  const std::string id = absl::BytesToHexString(point.generation.substr(0, 4));
  return absl::StrCat("generation ", id, ", commit ", point.commit);
}

}  // namespace rips::store

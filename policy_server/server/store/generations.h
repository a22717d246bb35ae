// Whether this store is the one that an agent has worked with, or a backup of it.
//
// Each start of the server begins a generation of its store, under an id drawn at random; commits
// are counted through all generations. A store that was restored lacks the later commits, and its
// next start begins another generation: from there on it is another history.
//
//   an agent names                       this store
//   nothing                              goes on from it: nothing is known
//   a generation of the chain, a commit  goes on from it if that generation reached the commit,
//                                        else it is older
//   another generation                   is older or another one; but if generations have been
//                                        dropped from the chain, and the commit is not above the
//                                        oldest that is left, it goes on: that may be one of them
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_GENERATIONS_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_GENERATIONS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace rips::store {

inline constexpr size_t kGenerationBytes = 16;
// Kept in the store; a robot may be off for so many starts of the server.
inline constexpr size_t kGenerationsMax = 256;

struct Generation {
  // Random, kGenerationBytes.
  std::string id;
  // The newest commit counted when it was the newest generation, of it or of those before.
  uint64_t last_commit = 0;

  friend bool operator==(const Generation&, const Generation&) = default;
};

// A moment in the life of a store.
struct StorePoint {
  // Empty = not known.
  std::string generation;
  uint64_t commit = 0;

  friend bool operator==(const StorePoint&, const StorePoint&) = default;
};

// `chain`: what the store keeps, oldest first; the last is in use and has come to `commit`.
bool GoesOnFrom(const std::vector<Generation>& chain, uint64_t commit, const StorePoint& seen);

// `generation 0123abcd, commit 17`, for people.
std::string ToString(const StorePoint& point);

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_GENERATIONS_H_

// The names that a rule gives to a builtin, as a set, and how it compares with what is there.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_NAME_SET_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_NAME_SET_H_

#include <cstdint>

#include "absl/container/inlined_vector.h"
#include "absl/strings/string_view.h"

namespace rips::engine {

// Built, asked by See() about each current name, then read. Holds views of what it is given.
class NameSet {
 public:
  // kNodes: a given name without a slash means every node with that base name, and a current name
  // without a leading slash (an endpoint that belongs to no node) is none of the given.
  enum class Kind { kPlain, kNodes };

  explicit NameSet(Kind kind) : kind_(kind) {}

  void Add(absl::string_view name) { given_.push_back({name, false}); }
  // Sorts and drops duplicates; after the last Add, before the first See.
  void Seal();

  // `name` is there now. True if it is one of the given.
  bool See(absl::string_view name);

  // Of the names seen so far.
  bool AllCurrentGiven() const { return strangers_ == 0; }
  bool AllGivenCurrent() const;
  // Calls `each` with every given name that was not seen.
  template <typename Each>
  void ForUnseen(const Each& each) const {
    for (const Given& given : given_) {
      if (!given.seen) each(given.name);
    }
  }

 private:
  struct Given {
    absl::string_view name;
    bool seen;
  };
  bool MarkSeen(absl::string_view name);

  Kind kind_;
  absl::InlinedVector<Given, 16> given_;
  uint64_t strangers_ = 0;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_NAME_SET_H_

// How many messages came lately: what `msgcount` and `sendercount` ask.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_COUNT_WINDOWS_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_COUNT_WINDOWS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/string_view.h"

namespace rips::engine {

// Counts are exact up to kExactMax messages in the longest window of a key. Beyond, neighbouring
// instants are merged into the later one: a count may then be too high, by the messages of 1/512th
// of the longest window, and is never too low. Not thread-safe.
class CountWindows {
 public:
  // Past it the key that was silent longest is forgotten: whoever makes up names cannot grow this,
  // nor silence a key that is busy.
  static constexpr size_t kKeysMax = 256;
  static constexpr size_t kInstantsMax = 1'024;
  static constexpr size_t kExactMax = 768;
  static constexpr uint64_t kSpreadMax = 64;

  // A message of `key` at `time_ns`, which never goes back, not even behind what was lost. What is
  // older than `keep_ns` may be forgotten.
  void Add(absl::string_view key, int64_t time_ns, int64_t keep_ns);

  // `count` messages of `key` that nobody saw, evenly from `first_ns` to `last_ns`: each of at most
  // kSpreadMax parts of them at the end of its part of the time. Neither end is after a
  // time that is added later; `first_ns` <= `last_ns`.
  void AddLost(absl::string_view key, uint64_t count, int64_t first_ns, int64_t last_ns,
               int64_t keep_ns);

  // Messages of `key` later than `now_ns - window_ns`.
  uint64_t Count(absl::string_view key, int64_t now_ns, int64_t window_ns) const;

  void Clear() { windows_.clear(); }
  size_t keys() const { return windows_.size(); }

 private:
  struct Instant {
    int64_t time_ns;
    // Messages up to and with this instant.
    uint64_t total;
  };
  struct Window {
    // Times ascend. Never empty once added to.
    std::vector<Instant> instants;
    // Messages before the first instant kept.
    uint64_t forgotten = 0;
  };

  Window& Find(absl::string_view key);
  void ForgetOldest();
  static void Shorten(Window& window, int64_t now_ns, int64_t keep_ns);

  absl::flat_hash_map<std::string, Window> windows_;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_COUNT_WINDOWS_H_

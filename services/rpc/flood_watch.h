// Finds the source of a flood of wasted connections: refused, ended without a call, ended to make
// room, or closed by the peer before it showed a certificate. Admission limits refuse these one by
// one and report no source. Pure: no sockets, no clock.
//
// | wasted connections in one window of `window_ns`    | Count returns, once in `told_ns`      |
// |----------------------------------------------------|---------------------------------------|
// | `of_source` from one source                        | that source                           |
// | `of_all` from sources not reported by themselves   | how many, and the source of the most  |
//
// Only `named` sources are reported by themselves, and one more in each `told_ns`: decoys cannot
// use up what whoever reads the reports is shown. All others stay in the total.
//
// A source is an address; or whatever else is refused, such as a certificate's identity.
#ifndef RIPS_SERVICES_RPC_FLOOD_WATCH_H_
#define RIPS_SERVICES_RPC_FLOOD_WATCH_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "absl/container/flat_hash_map.h"
#include "services/base/clock.h"

namespace rips::rpc {

// Not thread-safe; times are CLOCK_BOOTTIME.
class FloodWatch {
 public:
  struct Limits {
    int of_source = 64;
    int of_all = 512;
    int named = 8;
    int64_t window_ns = 10 * kNanosPerSecond;
    int64_t told_ns = 60 * kNanosPerSecond;
  };
  struct Flood {
    // The one, or that of the most.
    std::string source;
    int of_source = 0;
    // How many, and of all of them together, `source` among them.
    size_t sources = 1;
    int refused = 0;
    // In which they came, until now.
    int64_t within_ns = 0;
    // A certificate of ours was shown from `source` not long ago. Set by ConnectionGuard.
    bool known = false;
  };

  explicit FloodWatch(const Limits& limits) : limits_(limits), names_left_(limits.named) {}

  // Counts one wasted connection. The flood to report, if this one makes it due.
  std::optional<Flood> Count(const std::string& source, int64_t now_ns);

 private:
  void BeginWindow(int64_t now_ns);
  bool Reported(const std::string& source) const { return reported_ns_.contains(source); }
  Flood All(int64_t now_ns) const;

  const Limits limits_;
  int64_t begun_ns_ = 0;
  // Wasted connections of this window. No more than a listener can take in it.
  absl::flat_hash_map<std::string, int> sources_;
  // From those of them that were not reported by themselves.
  int others_ = 0;
  // When each source was reported by itself, and all others together, in the last `told_ns`.
  absl::flat_hash_map<std::string, int64_t> reported_ns_;
  std::optional<int64_t> all_reported_ns_;
  int names_left_;
  int64_t named_ns_ = 0;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_FLOOD_WATCH_H_

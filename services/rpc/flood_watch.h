// Finds the source of a flood of wasted connections: refused, ended without a call, ended to make
// room, or closed by the peer before it showed a certificate. Admission limits refuse these one by
// one and report no source. Pure: no sockets, no clock.
//
// | wasted connections in one window of `window_ns`            | Count returns, once in `told_ns` |
// |------------------------------------------------------------|----------------------------------|
// | `of_source` from one source                                | that source                      |
// | `of_all` from sources not yet reported in this window      | their number, and one of them    |
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
    int64_t window_ns = 10 * kNanosPerSecond;
    int64_t told_ns = 60 * kNanosPerSecond;
  };
  struct Flood {
    // The one, or one of several.
    std::string source;
    size_t sources = 1;
    int refused = 0;
    // In which they came, until now.
    int64_t within_ns = 0;
  };

  explicit FloodWatch(const Limits& limits) : limits_(limits) {}

  // Counts one wasted connection. The flood to report, if this one makes it due.
  std::optional<Flood> Count(const std::string& source, int64_t now_ns);

 private:
  struct Source {
    int refused = 0;
    bool told = false;
  };
  void BeginWindow(int64_t now_ns);

  const Limits limits_;
  int64_t begun_ns_ = 0;
  // Of this window. No more than connections that a listener can take in it.
  absl::flat_hash_map<std::string, Source> sources_;
  // From sources not reported in this window.
  int others_ = 0;
  // When each source, or all together (empty), was reported last.
  absl::flat_hash_map<std::string, int64_t> told_ns_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_FLOOD_WATCH_H_

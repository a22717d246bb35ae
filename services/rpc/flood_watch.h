// Finds the source of a flood of wasted connections: refused, ended without a call, ended to make
// room, or closed by the peer before it showed a certificate. Admission limits refuse these one by
// one and report no source. Pure: no sockets, no clock.
//
// | wasted connections in one window of `window_ns`            | Count returns, once in `told_ns` |
// |------------------------------------------------------------|----------------------------------|
// | `of_address` from one address                              | that address                     |
// | `of_all` from addresses not yet reported in this window    | their number, and one of them    |
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
    int of_address = 64;
    int of_all = 512;
    int64_t window_ns = 10 * kNanosPerSecond;
    int64_t told_ns = 60 * kNanosPerSecond;
  };
  struct Flood {
    // The one, or one of several.
    std::string address;
    size_t addresses = 1;
    int connections = 0;
    // In which they came, until now.
    int64_t within_ns = 0;
  };

  explicit FloodWatch(const Limits& limits) : limits_(limits) {}

  // A connection of this address came to nothing. What is to be told of it, if anything.
  std::optional<Flood> Count(const std::string& address, int64_t now_ns);

 private:
  struct Address {
    int connections = 0;
    bool told = false;
  };
  void BeginWindow(int64_t now_ns);

  const Limits limits_;
  int64_t begun_ns_ = 0;
  // Of this window. No more than connections that a listener can take in it.
  absl::flat_hash_map<std::string, Address> addresses_;
  // Of addresses that were not told.
  int others_ = 0;
  // When each address, or all together (empty), was told last.
  absl::flat_hash_map<std::string, int64_t> told_ns_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_FLOOD_WATCH_H_

// Connections that wait for their handshake. gRPC does all that were handed to it in the order in
// which their bytes come, on the threads that also serve streams: a thousand of them delay every
// stream by a second. So those of addresses that are not known are handed over at a pace, and in
// turns: networks take turns, and within a network its addresses. Pure: no sockets, no clock.
#ifndef RIPS_SERVICES_RPC_HANDSHAKE_QUEUE_H_
#define RIPS_SERVICES_RPC_HANDSHAKE_QUEUE_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <utility>

#include "absl/container/flat_hash_map.h"
#include "services/base/clock.h"
#include "services/rpc/connection_admission.h"

namespace rips::rpc {

struct HandshakePace {
  // At once, then so many a second; a handshake takes about a millisecond.
  double burst = 32;
  double per_second = 250;

  friend bool operator==(const HandshakePace&, const HandshakePace&) = default;
};

// Not thread-safe; times are CLOCK_BOOTTIME. Without a limit of its own: Admission has one.
template <typename T>
class HandshakeQueue {
 public:
  explicit HandshakeQueue(const HandshakePace& pace) : pace_(pace), tokens_(pace.burst) {}

  void Add(const Source& source, T connection) {
    Network& network = networks_[source.network];
    if (network.addresses.empty()) turns_.push_back(source.network);
    std::deque<T>& waiting = network.addresses[source.address];
    if (waiting.empty()) network.turns.push_back(source.address);
    waiting.push_back(std::move(connection));
    ++size_;
  }
  // The next one, if its time has come.
  std::optional<T> Next(int64_t now_ns) {
    Refill(now_ns);
    if (size_ == 0 || tokens_ < 1) return std::nullopt;
    tokens_ -= 1;
    --size_;
    const std::string network_name = std::move(turns_.front());
    turns_.pop_front();
    Network& network = networks_[network_name];
    const std::string address = std::move(network.turns.front());
    network.turns.pop_front();
    std::deque<T>& waiting = network.addresses[address];
    T next = std::move(waiting.front());
    waiting.pop_front();
    if (waiting.empty()) {
      network.addresses.erase(address);
    } else {
      network.turns.push_back(address);
    }
    if (network.addresses.empty()) {
      networks_.erase(network_name);
    } else {
      turns_.push_back(network_name);
    }
    return next;
  }
  // What Next gave need not be done after all, or was a peer of ours: a fleet that comes back is
  // not kept waiting.
  void GiveBack() { tokens_ = std::min(pace_.burst, tokens_ + 1); }
  // Drops those for which `gone` is true; the others keep their turns.
  template <typename Gone>
  void EraseIf(const Gone& gone) {
    for (auto network = networks_.begin(); network != networks_.end();) {
      auto& addresses = network->second.addresses;
      for (auto address = addresses.begin(); address != addresses.end();) {
        size_ -= std::erase_if(address->second, gone);
        if (address->second.empty()) {
          std::erase(network->second.turns, address->first);
          addresses.erase(address++);
        } else {
          ++address;
        }
      }
      if (addresses.empty()) {
        std::erase(turns_, network->first);
        networks_.erase(network++);
      } else {
        ++network;
      }
    }
  }
  size_t size() const { return size_; }

 private:
  struct Network {
    absl::flat_hash_map<std::string, std::deque<T>> addresses;
    std::deque<std::string> turns;
  };

  void Refill(int64_t now_ns) {
    const double seconds =
        static_cast<double>(std::max<int64_t>(0, now_ns - refilled_ns_)) / kNanosPerSecond;
    tokens_ = std::min(pace_.burst, tokens_ + seconds * pace_.per_second);
    refilled_ns_ = now_ns;
  }

  const HandshakePace pace_;
  double tokens_;
  int64_t refilled_ns_ = 0;
  size_t size_ = 0;
  absl::flat_hash_map<std::string, Network> networks_;
  std::deque<std::string> turns_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_HANDSHAKE_QUEUE_H_

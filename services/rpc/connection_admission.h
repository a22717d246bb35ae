// Which new connections a listener takes. Pure: no sockets, no clock.
//
// First line that fits:
//
// | the address, or its network                     | a new connection is               |
// |-------------------------------------------------|-----------------------------------|
// | is banned, and no certificate of ours was seen  | refused                           |
// | there lately                                    |                                   |
// | is banned otherwise                             | taken, but one a second at most   |
// | opened more than `burst` at once, or more than  | refused                           |
// | `per_second` since                              |                                   |
// | has `per_address` (`per_network`) connections   | refused                           |
// | there are `total` connections, or, for one that | refused                           |
// | is not known, `total` less the reserve          |                                   |
//
// Refused by one of the last two lines, a connection is taken all the same if ConnectionGuard finds
// one to end for it (MakeRoomLocked).
//
// An address is an IPv4 address or an IPv6 /64, its network an IPv4 /24 or an IPv6 /48. It is known
// for an hour after a connection from it was identified by a certificate of ours. Each certificate
// makes kVouchedMax addresses known, no more: who has stolen one must not make thousands known.
#ifndef RIPS_SERVICES_RPC_CONNECTION_ADMISSION_H_
#define RIPS_SERVICES_RPC_CONNECTION_ADMISSION_H_

#include <sys/socket.h>

#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/string_view.h"
#include "services/base/clock.h"

namespace rips::rpc {

struct AdmissionLimits {
  int total = 2'048;
  // Of `total`, for addresses that are known.
  int reserve = 512;
  int per_network = 1'024;
  int per_address = 256;
  double burst = 256;
  double per_second = 64;

  friend bool operator==(const AdmissionLimits&, const AdmissionLimits&) = default;
};

// Where a connection comes from.
struct Source {
  // As gRPC names the peer, decoded: `ipv4:10.0.0.7:4711`, `ipv6:[::1]:4711`.
  std::string peer;
  std::string address;
  std::string network;
};
// Of an IPv4 or IPv6 address; an IPv4 one in IPv6 counts as IPv4. Others: all empty.
Source SourceOf(const sockaddr_storage& address);

// Not thread-safe; times are CLOCK_BOOTTIME.
class Admission {
 public:
  static constexpr int64_t kKnownNs = 3'600 * kNanosPerSecond;
  // The first ban of an address; doubled for each that follows within kKnownNs, up to the last.
  static constexpr int64_t kBanNs = 10 * kNanosPerSecond;
  static constexpr int64_t kBanNsMax = 600 * kNanosPerSecond;
  // Addresses that one certificate makes known at the same time; the first ones stay.
  static constexpr size_t kVouchedMax = 4;
  // Addresses that are remembered; beyond it, of those without connections the half that was heard
  // of longest ago is forgotten.
  static constexpr size_t kAddressesMax = 8'192;

  enum class Verdict { kTake, kBanned, kRate, kAddress, kNetwork, kTotal };

  explicit Admission(const AdmissionLimits& limits) : limits_(limits) {}

  // kTake counts the connection until Left.
  Verdict Ask(const Source& source, int64_t now_ns);
  void Left(const Source& source);
  // A certificate of ours was shown.
  void Identified(const Source& source, const std::string& certificate, int64_t now_ns);
  // The certificate makes the address known: it is at home there.
  bool AtHome(const std::string& address, const std::string& certificate, int64_t now_ns) const;
  // How long it lasts.
  int64_t Ban(const Source& source, int64_t now_ns);
  int total() const { return total_; }
  // Connections of its network.
  int InNetwork(const Source& source) const;
  // One of its certificates was admitted not long ago.
  bool Known(const Source& source, int64_t now_ns) const;

 private:
  struct Address {
    int connections = 0;
    // Connections that may be opened at once, as of touched_ns.
    double tokens = 0;
    int64_t touched_ns = 0;
    int64_t known_until_ns = 0;
    int64_t banned_until_ns = 0;
    // The last one's.
    int64_t ban_ns = 0;
  };
  Address& Touch(const std::string& address, int64_t now_ns);
  void Forget();
  // This certificate may make the address known.
  bool MayVouch(const std::string& address, const std::string& certificate, int64_t now_ns);

  const AdmissionLimits limits_;
  int total_ = 0;
  absl::flat_hash_map<std::string, Address> addresses_;
  absl::flat_hash_map<std::string, int> networks_;
  // By certificate: the addresses that it makes known, and until when.
  absl::flat_hash_map<std::string, absl::flat_hash_map<std::string, int64_t>> vouched_;
};

absl::string_view ToString(Admission::Verdict verdict);

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_CONNECTION_ADMISSION_H_

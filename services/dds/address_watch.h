// Decides when the DDS part of a process must begin again because the host's addresses have
// changed. Cyclone keeps the address that its interface had when the domain began.
//
// | of what the domain took                    | then                                          |
// |--------------------------------------------|-----------------------------------------------|
// | all is there; another address came or went | nothing                                       |
// | an address is gone, and its interface has  | a problem at once; begins again when the next |
// | another                                    | look finds the same                           |
// | an address is gone, and its interface has  | a problem at once; ends when it has been gone |
// | none                                       | for kGoneNs: it may come back unharmed        |
// | all is there, but Cyclone chose it itself  | begins again when that has been so for        |
// | and would choose another interface now     | kBetterNs                                     |
// Each beginning takes one of kBurst turns, of which one comes back every kTurnNs: an interface
// that flaps costs no more. The problem stands until SeenAgain.
#ifndef RIPS_SERVICES_DDS_ADDRESS_WATCH_H_
#define RIPS_SERVICES_DDS_ADDRESS_WATCH_H_

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "services/base/clock.h"
#include "services/dds/host_addresses.h"

namespace rips::dds {

// Not thread-safe; no clock: times are CLOCK_BOOTTIME in nanoseconds. For one process and domain.
class AddressWatch {
 public:
  static constexpr int64_t kLookNs = kNanosPerSecond;
  static constexpr int64_t kGoneNs = 3 * kNanosPerSecond;
  static constexpr int64_t kBetterNs = 3 * kNanosPerSecond;
  static constexpr int kBurst = 3;
  static constexpr int64_t kTurnNs = 20 * kNanosPerSecond;
  // Without a domain: between two attempts to begin one, when the addresses changed or did not.
  static constexpr int64_t kAttemptNs = 2 * kNanosPerSecond;
  static constexpr int64_t kAttemptAnywayNs = 30 * kNanosPerSecond;

  // `interface`: the one that a domain must use; empty if that is not known here.
  explicit AddressWatch(std::string interface) : interface_(std::move(interface)) {}

  // About every kLookNs while a domain runs. True: end it now and begin again, or wait for
  // MayBegin if that fails.
  bool Look(const InterfacesInUse& in_use, const std::vector<InterfaceAddress>& host,
            int64_t now_ns);
  // About every kLookNs while none runs. True: it is worth an attempt.
  bool MayBegin(const std::vector<InterfaceAddress>& host, int64_t now_ns);
  // What Look found wrong first, human-readable; empty = nothing. Interface names and addresses are
  // the kernel's.
  const std::string& problem() const { return problem_; }
  // Why Look gave true.
  const std::string& change() const { return change_; }
  // The domain that runs shows the robot.
  void SeenAgain();

 private:
  bool TakeTurn(int64_t now_ns);

  const std::string interface_;
  std::string problem_;
  std::string change_;
  // What differs as of the last look, and since when.
  std::string differs_;
  int64_t differs_since_ns_ = 0;
  std::optional<int64_t> gone_since_ns_;
  bool ended_ = false;  // Look gave true for the problem that stands
  int turns_ = kBurst;
  int64_t turns_from_ns_ = 0;
  std::vector<InterfaceAddress> attempted_;
  std::optional<int64_t> attempted_ns_;
};

// The address that Cyclone 0.10 would choose: of the interfaces that rank highest, the first. Null
// if there is none.
const InterfaceAddress* CycloneChoice(const std::vector<InterfaceAddress>& host, bool ipv6);

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_ADDRESS_WATCH_H_

// Whether two processes use the key of one agent at the same time: a copied key, or a robot that
// was cloned. The one without a session is refused; it is a second holder if the one with the
// session is still heard afterwards. An agent that starts anew is refused, too, until its old
// session is stale, but nothing is heard on that one any more.
//
// Which of the two is the agent cannot be known here, so both addresses are told, and a session
// that comes from another address than the one before it is told as well.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_SECOND_HOLDER_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_SECOND_HOLDER_H_

#include <cstdint>
#include <optional>
#include <string>
#include <utility>

#include "services/base/clock.h"

namespace rips::pipeline {

// Of one agent. Not thread-safe; times are CLOCK_BOOTTIME.
class SecondHolder {
 public:
  // Heartbeats that were underway when the other one came are older than this.
  static constexpr int64_t kUnderwayNs = 1 * kNanosPerSecond;
  static constexpr int64_t kReportEveryNs = 60 * kNanosPerSecond;
  // After the last refusal; agents try again at least every half minute.
  static constexpr int64_t kContestedNs = 90 * kNanosPerSecond;

  struct Report {
    // Of the one that was refused last, with its port.
    std::string peer;
    // Of the session that is heard.
    std::string holder;
    // Refusals since the last report.
    uint64_t refused = 0;
  };

  // A session was refused because there is a live one.
  void Refused(const std::string& peer, int64_t now_ns) {
    if (refused_ == 0) first_refused_ns_ = now_ns;
    peer_ = peer;
    refused_ns_ = now_ns;
    ++refused_;
  }
  // A session begins; the one before it is over. Gives the address of that one if it is another's;
  // empty = the same, or there was none.
  std::string Begin(const std::string& peer) {
    refused_ = 0;
    contested_until_ns_ = 0;
    const std::string before = std::exchange(holder_, peer);
    if (before.empty() || Address(before) == Address(peer)) return "";
    reported_ns_ = 0;  // whom it refuses is news
    return before;
  }
  // The live session was heard. What is to be reported, once a minute at most.
  std::optional<Report> Heard(int64_t now_ns) {
    if (refused_ == 0 || now_ns - first_refused_ns_ < kUnderwayNs) return std::nullopt;
    contested_until_ns_ = refused_ns_ + kContestedNs;
    if (reported_ns_ != 0 && now_ns - reported_ns_ < kReportEveryNs) return std::nullopt;
    reported_ns_ = now_ns;
    return Report{.peer = peer_, .holder = holder_, .refused = std::exchange(refused_, 0)};
  }
  // Two use the key, so what its session says may be the wrong one's.
  bool Contested(int64_t now_ns) const { return now_ns < contested_until_ns_; }

 private:
  // As gRPC writes them: `ipv4:10.0.0.7:4711`.
  static std::string Address(const std::string& peer) { return peer.substr(0, peer.rfind(':')); }

  std::string holder_;
  std::string peer_;
  uint64_t refused_ = 0;
  int64_t first_refused_ns_ = 0;
  int64_t refused_ns_ = 0;
  int64_t contested_until_ns_ = 0;
  int64_t reported_ns_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_SECOND_HOLDER_H_

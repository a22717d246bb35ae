// Whether two processes use the key of one agent: a copied key, or a robot that was cloned.
//
// | seen                                           | what the session says is doubted             |
// |------------------------------------------------|----------------------------------------------|
// | a session is refused, since there is a live    | if that one is heard afterwards: until 90 s  |
// | one                                            | after the last refusal. An agent that starts |
// |                                                | anew is refused, too, until its old session  |
// |                                                | is stale, but nothing is heard on that one   |
// | the key is used for what no agent does: its    | until 90 s after the last time, whoever has  |
// | calls are throttled, its connections are ended | the session then: the other one may be kept  |
// |                                                | out by that                                  |
// | a session comes from another address than the  | for 45 s: if there is another holder, it is  |
// | one before it                                  | refused by then                              |
//
// Which of the two is the agent cannot be known here, so both addresses are told.
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
  static constexpr int64_t kMovedNs = 45 * kNanosPerSecond;

  enum class Doubt { kNone, kSecond, kMisused, kMoved };

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
  // The key was used for what no agent does. True, once a minute at most: it is to be reported.
  bool Misused(int64_t now_ns) {
    misused_until_ns_ = now_ns + kContestedNs;
    if (misuse_told_ns_ != 0 && now_ns - misuse_told_ns_ < kReportEveryNs) return false;
    misuse_told_ns_ = now_ns;
    return true;
  }
  // A session begins; the one before it is over. Gives the address of that one if it is another's;
  // empty = the same, or there was none.
  std::string Begin(const std::string& peer, int64_t now_ns) {
    refused_ = 0;
    const std::string before = std::exchange(holder_, peer);
    if (before.empty() || Address(before) == Address(peer)) return "";
    moved_until_ns_ = now_ns + kMovedNs;
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
  // Of the session, or the last one; empty = there was none.
  const std::string& holder() const { return holder_; }
  // Why what its session says may be the wrong one's.
  Doubt DoubtAt(int64_t now_ns) const {
    if (now_ns < contested_until_ns_) return Doubt::kSecond;
    if (now_ns < misused_until_ns_) return Doubt::kMisused;
    return now_ns < moved_until_ns_ ? Doubt::kMoved : Doubt::kNone;
  }

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
  int64_t misused_until_ns_ = 0;
  int64_t misuse_told_ns_ = 0;
  int64_t moved_until_ns_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_SECOND_HOLDER_H_

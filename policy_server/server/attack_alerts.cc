#include "policy_server/server/attack_alerts.h"

#include <cstdint>
#include <optional>

#include "absl/strings/str_cat.h"
#include "policy_server/server/store/store.h"

namespace rips {
namespace {

constexpr int64_t kEveryNs = 60 * kNanosPerSecond;
constexpr char kRest[] = " (more of this is only counted for a minute)";

std::string Server() { return std::string(store::kServerRobot); }

}  // namespace

bool AttackAlerts::IsDue(const std::string& name) {
  MutexLock lock(&mu_);
  const int64_t now_ns = clock_->Now().boottime_ns;
  std::erase_if(told_ns_, [&](const auto& told) { return now_ns - told.second >= kEveryNs; });
  return told_ns_.try_emplace(name, now_ns).second;
}

void AttackAlerts::OnConnectionEnded(const rpc::ConnectionGuard::Report& report) {
  if (report.banned_ns == 0) return;
  if (!IsDue(absl::StrCat("certificate ", report.certificate))) return;
  std::string what = "sent bytes of which nothing came";
  if (report.excess == rpc::Excess::kCalls) what = "began calls without end";
  if (report.excess == rpc::Excess::kRefused) what = "sent what no agent of ours sends";
  alerts_->Raise(Server(), engine::Severity::kCritical,
                 absl::StrCat("the server is attacked: a connection from ", report.peer,
                              report.certificate.empty()
                                  ? std::string(" without a certificate of ours")
                                  : absl::StrCat(" with the certificate of ", report.certificate),
                              " ", what, "; it was ended and is banned for ",
                              report.banned_ns / kNanosPerSecond, " s", kRest));
}

void AttackAlerts::OnFlood(const rpc::FloodWatch::Flood& flood) {
  const bool one = flood.sources == 1;
  alerts_->Raise(
      Server(), engine::Severity::kHigh,
      absl::StrCat("a flood of connections: ", flood.refused, " from ",
                   one ? flood.source
                       : absl::StrCat(flood.sources, " addresses, ", flood.source, " among them,"),
                   " came to nothing within ", flood.within_ns / kNanosPerSecond + 1,
                   " s; what is connected stays, but a new connection of an agent ",
                   one ? "at this address" : "from an address that is not known yet", " may wait",
                   kRest));
}

void AttackAlerts::OnPeerRefused(const std::string& robot) {
  if (!IsDue(absl::StrCat("robot ", robot))) return;
  alerts_->Raise(robot, engine::Severity::kHigh,
                 absl::StrCat("peers of robot ", robot,
                              " send more than can be judged: a stream was closed", kRest));
}

void AttackAlerts::OnCallRefused(const std::string& identity) {
  std::optional<rpc::FloodWatch::Flood> flood;
  {
    MutexLock lock(&mu_);
    flood = refused_calls_.Count(identity, clock_->Now().boottime_ns);
  }
  if (!flood) return;
  alerts_->Raise(Server(), engine::Severity::kHigh,
                 absl::StrCat(identity, " asks more than its quota allows: ", flood->refused,
                              " calls were refused within ", flood->within_ns / kNanosPerSecond + 1,
                              " s", kRest));
}

}  // namespace rips

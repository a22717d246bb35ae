#include "policy_server/server/attack_alerts.h"

#include <cstdint>
#include <optional>

#include "absl/strings/str_cat.h"
#include "policy_server/server/store/store.h"

namespace rips {
namespace {

constexpr int64_t kEveryNs = 60 * kNanosPerSecond;
constexpr char kRest[] = " (more of this is only counted for a minute)";

constexpr char kEachMinute[] = " (repeated each minute while it lasts)";

std::string Seconds(int64_t ns) { return absl::StrCat(ns / kNanosPerSecond + 1, " s"); }

// `reason` as AttackAlerts::OnCallRefused has it.
absl::string_view Because(absl::string_view reason) {
  if (reason == "quota") return "it asks more than its quota allows";
  if (reason == "role") return "its role does not allow what it asks";
  if (reason == "claim") return "it says that it is another agent";
  if (reason == "limit") return "a field of the request is past its limit";
  if (reason == "throttled") return "its connections are too many or broke the limits";
  if (reason == "banned") return "it is banned";
  if (reason == "revoked") return "its certificate is revoked";
  return "its certificate does not count";
}

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
  const std::string within = absl::StrCat(" within ", Seconds(flood.within_ns), " made no call");
  const std::string known =
      flood.known ? " Agents of ours have connected from there: it may be one that fails, or "
                    "share its address with the attacker."
                  : "";
  if (flood.sources == 1) {
    alerts_->Raise(Server(), engine::Severity::kHigh,
                   absl::StrCat("a flood of connections: ", flood.refused, " from ", flood.source,
                                within, ". What is connected stays; an agent at this address may ",
                                "wait. A firewall can close it out.", known, kEachMinute));
    return;
  }
  alerts_->Raise(
      Server(), engine::Severity::kHigh,
      absl::StrCat("a flood of connections: ", flood.refused, " from ", flood.sources,
                   " addresses,", within, "; the most (", flood.of_source, ") from ", flood.source,
                   ". What is connected stays; an agent at an address that is not known yet may "
                   "wait.",
                   known, kEachMinute));
}

void AttackAlerts::OnPeerRefused(const std::string& robot) {
  if (!IsDue(absl::StrCat("robot ", robot))) return;
  alerts_->Raise(robot, engine::Severity::kHigh,
                 absl::StrCat("peers of robot ", robot,
                              " send more than can be judged: a stream was closed", kRest));
}

void AttackAlerts::OnCallRefused(const std::string& identity, absl::string_view reason) {
  std::optional<rpc::FloodWatch::Flood> flood;
  {
    MutexLock lock(&mu_);
    flood = refused_calls_.Count(identity, clock_->Now().boottime_ns);
  }
  if (!flood) return;
  alerts_->Raise(Server(), engine::Severity::kHigh,
                 absl::StrCat(flood->refused, " calls of ", identity, " were refused within ",
                              Seconds(flood->within_ns), ", the last because ", Because(reason),
                              ". If its key may be stolen: ripsctl agent ban ", identity,
                              " --reason TEXT", kEachMinute));
}

}  // namespace rips

#include "policy_server/server/attack_alerts.h"

#include <cstdint>
#include <iterator>
#include <optional>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/store/store.h"

namespace rips {
namespace {

using Kind = FloodWatch::Report::Kind;

constexpr int64_t kEveryNs = 60 * kNanosPerSecond;
constexpr char kRest[] = " (more of this is only counted for a minute)";
constexpr char kSafe[] = "Robots that are connected are guarded as before; ";

std::string Server() { return std::string(store::kServerRobot); }

std::string Seconds(int64_t ns) { return absl::StrCat(ns / kNanosPerSecond + 1, " s"); }

std::string Summary(const FloodWatch::Report& report, absl::string_view what,
                    absl::string_view sources) {
  return absl::StrCat(report.count, " ", what, " in the last ", Seconds(report.within_ns - 1),
                      ", from ", report.counted ? "" : "more than ", report.sources, " ", sources,
                      ", most from ");
}

std::string Ending(const FloodWatch::Report& report) {
  return report.goes_on ? "; it goes on" : "; it has stopped";
}

// Why calls are refused, the gravest last: what one certificate is refused for is told by it.
struct Reason {
  absl::string_view name;
  absl::string_view text;
  // Not served at all: nothing is left to be done about it.
  bool shut_out = false;
};
constexpr Reason kReasons[] = {
    {"quota", "it asks more than its quota allows"},
    {"limit", "a field of its requests is past its limit"},
    {"throttled", "its connections are too many, or broke the limits"},
    {"expired", "its certificate has expired", true},
    {"banned", "it is banned", true},
    {"revoked", "its certificate is revoked", true},
    {"claim", "it says that it is another agent"},
    {"role", "its role does not allow what it asks"},
};

int RankOf(absl::string_view reason) {
  for (size_t i = 0; i < std::size(kReasons); ++i) {
    if (kReasons[i].name == reason) return static_cast<int>(i);
  }
  return 0;
}

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

void AttackAlerts::OnConnectionWasted(const std::string& address, bool known) {
  std::optional<FloodWatch::Report> report;
  {
    MutexLock lock(&mu_);
    report =
        connections_.Count({.source = address, .rank = known ? 1 : 0}, clock_->Now().boottime_ns);
  }
  if (report) TellConnections(*report);
}

void AttackAlerts::TellConnections(const FloodWatch::Report& report) {
  const std::vector<FloodWatch::Part>& most = report.most;
  if (report.kind == Kind::kSource) {
    const bool known = most[0].refused.rank > 0;
    alerts_->Raise(
        Server(), engine::Severity::kHigh,
        absl::StrCat("a flood of connections from ", most[0].refused.source, ": ", report.count,
                     " within ", Seconds(report.within_ns), " made no call. ", kSafe,
                     "an agent at this address may wait until it can connect. It may be an "
                     "attacker, or agents whose certificate or clock is wrong",
                     known ? "; agents or operators of ours have connected from there, and a "
                             "firewall would shut them out, too"
                           : "; a firewall can shut the address out"));
    return;
  }
  const std::string from = absl::StrJoin(most, ", ", [](std::string* out, const auto& part) {
    absl::StrAppend(out, part.refused.source, " (", part.count, ")");
  });
  const std::string text =
      absl::StrCat("a flood of connections: ", Summary(report, "without a call", "addresses"), from,
                   Ending(report), ". ", kSafe, "an agent at a new address may wait");
  // Each a kind of its own, so that none uses up the other's rate.
  if (report.kind == Kind::kAll) {
    alerts_->Raise(Server(), engine::Severity::kHigh, text);
  } else {
    alerts_->Raise(Server(), engine::Severity::kHigh, text);
  }
}

void AttackAlerts::OnPeerRefused(const std::string& robot) {
  if (!IsDue(absl::StrCat("robot ", robot))) return;
  alerts_->Raise(robot, engine::Severity::kHigh,
                 absl::StrCat("peers of robot ", robot,
                              " send more than can be judged: a stream was closed", kRest));
}

void AttackAlerts::OnCallRefused(const rpc::PeerIdentity& identity, absl::string_view reason,
                                 absl::string_view address) {
  std::optional<FloodWatch::Report> report;
  {
    MutexLock lock(&mu_);
    report = calls_.Count(
        {.source = rpc::ToString(identity), .rank = RankOf(reason), .detail = std::string(address)},
        clock_->Now().boottime_ns);
  }
  if (report) TellCalls(*report);
}

void AttackAlerts::TellCalls(const FloodWatch::Report& report) {
  if (report.kind == Kind::kMinute) {
    const std::string from =
        absl::StrJoin(report.most, "; ", [](std::string* out, const FloodWatch::Part& part) {
          absl::StrAppend(out, part.refused.source, " (", part.count, ", last from ",
                          part.refused.detail, ": ", kReasons[part.refused.rank].text, ")");
        });
    alerts_->Raise(
        Server(), engine::Severity::kHigh,
        absl::StrCat("calls are refused: ", Summary(report, "without effect", "certificates"), from,
                     Ending(report)));
    return;
  }
  const FloodWatch::Refused& refused = report.most[0].refused;
  const Reason& reason = kReasons[refused.rank];
  const std::string text = absl::StrCat(
      report.count, " calls of ", refused.source, " were refused within ",
      Seconds(report.within_ns), ", last from ", refused.detail, ": ", reason.text,
      ". None had an effect",
      reason.shut_out
          ? ""
          : absl::StrCat("; if its key may be in other hands, an administrator shuts ",
                         "it out: ripsctl agent ban ", refused.source, " --reason TEXT"));
  // Agents' and operators' keys do not use up one another's rate.
  if (absl::StrContains(refused.source, "/operator/")) {
    alerts_->Raise(Server(), engine::Severity::kHigh, text);
  } else {
    alerts_->Raise(Server(), engine::Severity::kHigh, text);
  }
}

void AttackAlerts::Look() {
  std::optional<FloodWatch::Report> connections;
  std::optional<FloodWatch::Report> calls;
  {
    MutexLock lock(&mu_);
    const int64_t now_ns = clock_->Now().boottime_ns;
    connections = connections_.Look(now_ns);
    calls = calls_.Look(now_ns);
  }
  if (connections) TellConnections(*connections);
  if (calls) TellCalls(*calls);
}

}  // namespace rips

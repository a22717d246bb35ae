#include "policy_server/server/attack_alerts.h"

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <optional>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/store/store.h"
#include "services/rpc/peer_address.h"

namespace rips {
namespace {

using Kind = FloodWatch::Report::Kind;

constexpr int64_t kEveryNs = 60 * kNanosPerSecond;
constexpr char kRest[] = " (more of this is only counted for a minute)";
constexpr char kSafe[] = "Robots that are connected are guarded as before; ";

std::string Server() { return std::string(store::kServerRobot); }

// Rounded up.
std::string Seconds(int64_t ns) {
  return absl::StrCat(std::max<int64_t>(1, (ns + kNanosPerSecond - 1) / kNanosPerSecond), " s");
}

// "1010 without a call in the last minute, from 2 addresses".
std::string Minute(const FloodWatch::Report& report, absl::string_view what,
                   absl::string_view sources) {
  return absl::StrCat(report.count, " ", what, " in the last minute, from ",
                      report.counted ? "" : "more than ", report.sources, " ", sources);
}

std::string Ending(const FloodWatch::Report& report) {
  return report.goes_on ? "; it goes on" : "; below the limit in the last 10 s";
}

// Why calls are refused, the gravest last.
struct Reason {
  absl::string_view name;
  absl::string_view text;
  // Not served at all: nothing is left to be done about it.
  bool shut_out = false;
};
constexpr Reason kReasons[] = {
    {"", "for a reason of its own"},
    {"quota", "it asks more than its quota allows"},
    {"limit", "a field of its requests is past its limit"},
    {"undecodable", "its requests cannot be decoded"},
    {"throttled", "its connections are too many, or broke the limits"},
    {"expired", "its certificate has expired", true},
    {"banned", "it is banned", true},
    {"revoked", "its certificate is revoked", true},
    {"claim", "it says that it is another agent"},
    {"role", "its role does not allow what it asks"},
};
static_assert(std::size(kReasons) <= FloodWatch::kRanks);

int RankOf(absl::string_view reason) {
  for (size_t i = 0; i < std::size(kReasons); ++i) {
    if (kReasons[i].name == reason) return static_cast<int>(i);
  }
  return 0;
}

// "its role does not allow what it asks (360), it asks more than its quota allows (40)".
std::string ReasonsOf(const FloodWatch::Part& part) {
  std::vector<std::string> reasons;
  for (size_t rank = std::size(kReasons); rank-- > 0;) {
    if (part.by_rank[rank] == 0) continue;
    reasons.push_back(absl::StrCat(kReasons[rank].text, " (", part.by_rank[rank], ")"));
  }
  return absl::StrJoin(reasons, ", ");
}

std::string LastFrom(const FloodWatch::Part& part) {
  return part.detail.empty() ? "" : absl::StrCat(", last from ", part.detail);
}

// A source that sent one is not worth a name.
std::vector<FloodWatch::Part> Named(const FloodWatch::Report& report) {
  std::vector<FloodWatch::Part> named = report.most;
  std::erase_if(named, [](const FloodWatch::Part& part) { return part.count < 2; });
  return named;
}

}  // namespace

bool AttackAlerts::IsDue(const std::string& name) {
  MutexLock lock(&mu_);
  const int64_t now_ns = clock_->Now().boottime_ns;
  std::erase_if(told_ns_, [&](const auto& told) { return now_ns - told.second >= kEveryNs; });
  return told_ns_.try_emplace(name, now_ns).second;
}

void AttackAlerts::OnConnectionEnded(const rpc::ConnectionGuard::Report& report) {
  if (report.excess == rpc::Excess::kSilent) return;
  if (report.identity) KeyMisused(*report.identity, report.peer);
  if (!IsDue(absl::StrCat("certificate ", report.certificate))) return;
  std::string what = "sent bytes of which nothing came";
  if (report.excess == rpc::Excess::kCalls) what = "began calls without end";
  if (report.excess == rpc::Excess::kRefused) what = "sent what no agent of ours sends";
  alerts_->Raise(Server(), engine::Severity::kCritical,
                 absl::StrCat("the server is attacked: a connection from ", report.peer,
                              report.certificate.empty()
                                  ? std::string(", whose peer was not known yet,")
                                  : absl::StrCat(" with the certificate of ", report.certificate),
                              " ", what, "; it was ended",
                              report.banned_ns == 0
                                  ? std::string(", and nothing banned, since ours connect from "
                                                "that address, too")
                                  : absl::StrCat(" and is banned for ",
                                                 report.banned_ns / kNanosPerSecond, " s"),
                              kRest));
}

void AttackAlerts::KeyMisused(const rpc::PeerIdentity& identity, const std::string& peer) {
  const bool agent = identity.role == rpc::Role::kSensor || identity.role == rpc::Role::kActuator;
  if (!agent || !on_key_misused_) return;
  {
    MutexLock lock(&mu_);
    const int64_t now_ns = clock_->Now().boottime_ns;
    const auto [at, fresh] = misused_ns_.try_emplace(rpc::ToString(identity), now_ns);
    if (!fresh && now_ns - at->second < kMisuseEveryNs) return;
    at->second = now_ns;
  }
  on_key_misused_(identity, peer);
}

void AttackAlerts::OnConnectionWasted(const std::string& address, bool known) {
  std::optional<FloodWatch::Report> report;
  {
    MutexLock lock(&mu_);
    report =
        connections_.Count({.source = address, .rank = known ? 1 : 0}, clock_->Now().boottime_ns);
  }
  if (report) ReportConnections(*report);
}

void AttackAlerts::ReportConnections(const FloodWatch::Report& report) {
  if (report.kind == Kind::kOver) {
    return alerts_->Raise(Server(), engine::Severity::kInfo,
                          absl::StrCat("the flood of connections is over: ",
                                       Minute(report, "without a call", "addresses")));
  }
  if (report.kind == Kind::kSource) {
    const FloodWatch::Part& source = report.most[0];
    return alerts_->Raise(
        Server(), engine::Severity::kHigh,
        absl::StrCat("a flood of connections from ", source.source, ": ", report.count, " within ",
                     Seconds(report.within_ns), " made no call. ", kSafe,
                     "an agent at this address may wait until it can connect. The sender may be an "
                     "attacker, or agents whose certificate or clock is wrong",
                     source.by_rank[1] > 0
                         ? "; agents or operators of ours have connected from there, and a "
                           "firewall would shut them out, too"
                         : "; none of ours has connected from there in the last hour: if none is "
                           "to, a firewall can shut the address out"));
  }
  const std::string most =
      absl::StrJoin(Named(report), ", ", [](std::string* out, const FloodWatch::Part& part) {
        absl::StrAppend(
            out, part.source, " (", part.count,
            part.by_rank[1] > 0 ? "; agents or operators of ours are there, too)" : ")");
      });
  const std::string from = most.empty() ? "" : absl::StrCat(", most from ", most);
  // Each a kind of its own, so that none uses up the other's rate.
  if (report.kind == Kind::kAll) {
    alerts_->Raise(Server(), engine::Severity::kHigh,
                   absl::StrCat("a flood of connections: ", report.count, " within ",
                                Seconds(report.within_ns), " made no call, from many addresses",
                                from, ". ", kSafe, "an agent at a new address may wait"));
  } else {
    alerts_->Raise(
        Server(), engine::Severity::kHigh,
        absl::StrCat("a flood of connections: ", Minute(report, "without a call", "addresses"),
                     from, Ending(report), ". ", kSafe, "an agent at a new address may wait"));
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
  // Its connections are too many or broke the limits, it says that it is another, or asks for what
  // is an operator's. Not what a newer or older agent may get wrong.
  if (reason == "throttled" || reason == "claim" || reason == "role") {
    KeyMisused(identity, rpc::DecodePeer(address));
  }
  std::optional<FloodWatch::Report> report;
  {
    MutexLock lock(&mu_);
    report = calls_.Count({.source = rpc::ToString(identity),
                           .rank = RankOf(reason),
                           .detail = rpc::DecodePeer(address)},
                          clock_->Now().boottime_ns);
  }
  if (report) ReportCalls(*report);
}

void AttackAlerts::ReportCalls(const FloodWatch::Report& report) {
  if (report.kind == Kind::kOver) {
    return alerts_->Raise(Server(), engine::Severity::kInfo,
                          absl::StrCat("the flood of refused calls is over: ",
                                       Minute(report, "without effect", "certificates")));
  }
  const auto shut_out = [](const FloodWatch::Part& part) { return kReasons[part.rank].shut_out; };
  if (report.kind == Kind::kMinute) {
    const std::vector<FloodWatch::Part> named = Named(report);
    const std::string from =
        absl::StrJoin(named, "; ", [](std::string* out, const FloodWatch::Part& part) {
          absl::StrAppend(out, part.source, LastFrom(part), ": ", ReasonsOf(part));
        });
    return alerts_->Raise(
        Server(), engine::Severity::kHigh,
        absl::StrCat("calls are refused: ", Minute(report, "without effect", "certificates"),
                     Ending(report), ". ", from,
                     std::all_of(named.begin(), named.end(), shut_out)
                         ? ""
                         : ". A key that may be in other hands: ripsctl agent ban URI --reason "
                           "TEXT"));
  }
  const FloodWatch::Part& part = report.most[0];
  const std::string text = absl::StrCat(
      report.count, " calls of ", part.source, " were refused within ", Seconds(report.within_ns),
      LastFrom(part), "; in this minute: ", ReasonsOf(part), ". None had an effect",
      shut_out(part) ? ""
                     : absl::StrCat("; if its key may be in other hands, an administrator shuts it "
                                    "out: ripsctl agent ban ",
                                    part.source, " --reason TEXT"));
  // Agents' and operators' keys do not use up one another's rate.
  if (absl::StrContains(part.source, "/operator/")) {
    alerts_->Raise(Server(), engine::Severity::kHigh, text);
  } else {
    alerts_->Raise(Server(), engine::Severity::kHigh, text);
  }
}

void AttackAlerts::Poll() {
  std::optional<FloodWatch::Report> connections;
  std::optional<FloodWatch::Report> calls;
  {
    MutexLock lock(&mu_);
    const int64_t now_ns = clock_->Now().boottime_ns;
    connections = connections_.Poll(now_ns);
    calls = calls_.Poll(now_ns);
  }
  if (connections) ReportConnections(*connections);
  if (calls) ReportCalls(*calls);
}

}  // namespace rips

#include "policy_server/server/robot/decide/approvals.h"

#include <algorithm>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/engine/foresight.h"
#include "policy_server/server/robot/decide/graph_changes.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {
namespace {

// As `ripsctl` shows it.
std::string ShortId(const std::string& id) { return id.substr(0, 8); }

}  // namespace

bool Approvals::Needed(levels::LevelIndex to) const {
  // Also of a level in between: who may not leave it alone must not go round it, by raising the
  // robot above it first.
  const std::vector<std::string>& two_person = context_.policy.two_person;
  for (levels::LevelIndex level = state_.level.level(); level > to; --level) {
    const std::string name = state_.level.table().name(level);
    if (std::find(two_person.begin(), two_person.end(), name) != two_person.end()) return true;
  }
  return false;
}

void Approvals::Ask(const LevelOrder& order, LevelAnswer& answer) {
  auto it = std::find_if(pending_.begin(), pending_.end(), [&](const Pending& each) {
    return each.order.identity == order.identity;
  });
  const bool repeated = it != pending_.end() && it->order.to == order.to &&
                        it->order.reason == order.reason &&
                        it->order.accept_blind == order.accept_blind && WhyOver(*it).empty();
  if (!repeated) {
    if (it != pending_.end()) {
      ReportEnd(*it, "the same operator asks for another one");
      pending_.erase(it);
    }
    if (pending_.size() >= kPendingMax) {
      answer.status = absl::ResourceExhaustedError(absl::StrCat(
          kPendingMax, " lowerings of ", context_.config.id,
          " wait for a second operator already, the limit; approve or reject one of them"));
      return;
    }
    it = pending_.insert(
        pending_.end(),
        {.id = context_.ids.Next(), .order = order, .seen = Now(order), .asked = context_.now()});
    // Not `info`: a SIEM that filters it must receive this one.
    Report(order, engine::Severity::kMedium,
           absl::StrCat("operator ", order.operator_name, " asks to lower ", context_.config.id,
                        " from ", order.expected_level, " to ", order.to,
                        order.accept_blind ? ", whatever RIPS sees of it" : "",
                        ", which a second operator must approve (", ShortId(it->id),
                        "): ", order.reason));
  }
  answer.pending_approval_id = it->id;
  answer.approval_expires_unix_ns = it->asked.unix_ns + kApprovalNs;
}

absl::StatusOr<LevelOrder> Approvals::Find(const ApprovalOrder& approval) {
  if (const std::string why = End(approval.id); !why.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat("that lowering must be asked for again: ", why));
  }
  const auto it = std::find_if(pending_.begin(), pending_.end(),
                               [&](const Pending& each) { return each.id == approval.id; });
  if (it == pending_.end()) {
    return absl::NotFoundError(absl::StrCat(
        "no lowering of ", context_.config.id, " waits under `", absl::CHexEscape(approval.id),
        "`; `ripsctl level show ", context_.config.id, "` lists those that wait"));
  }
  return it->order;
}

void Approvals::Remove(absl::string_view id) {
  std::erase_if(pending_, [&](const Pending& each) { return each.id == id; });
}

Approvals::Seen Approvals::Now(const LevelOrder& order) const {
  return {.decision_id = state_.level.decision_id(),
          .graph = state_.graph.version(),
          .would_raise = engine::WouldRaise(state_.level.table().Find(order.to).value_or(0),
                                            context_.now(), state_),
          .bundle_id = context_.policy.bundle_id,
          .level_requests = state_.level_requests()};
}

std::string Approvals::WhyOver(const Pending& pending) const {
  const DecisionId& decision_id = state_.level.decision_id();
  if (pending.seen.decision_id != decision_id) {
    return absl::StrCat("the level was decided anew (", ToString(decision_id), ")");
  }
  if (pending.seen.bundle_id != context_.policy.bundle_id) return "another bundle is in force";
  if (const std::string rule = RuleSince(pending); !rule.empty()) return rule;
  if (const std::string graph = GraphSince(pending); !graph.empty()) return graph;
  if (context_.now_ns() - pending.asked.boottime_ns >= kApprovalNs) {
    return absl::StrCat("it was not approved within ", kApprovalNs / (60 * kNanosPerSecond),
                        " minutes");
  }
  return "";
}

std::string Approvals::GraphSince(const Pending& pending) const {
  const Seen& seen = pending.seen;
  if (seen.graph.revision == state_.graph.revision()) return "";
  const std::string publishers =
      PublisherChange(*seen.graph.graph, state_.graph.get(), *context_.policy.kept_topics);
  if (!publishers.empty()) return absl::StrCat("the robot's graph has changed: ", publishers);
  const levels::LevelTable& table = state_.level.table();
  const levels::LevelIndex to = table.Find(pending.order.to).value_or(0);
  for (const std::string& rule : engine::WouldRaise(to, context_.now(), state_)) {
    if (std::find(seen.would_raise.begin(), seen.would_raise.end(), rule) !=
        seen.would_raise.end()) {
      continue;
    }
    return absl::StrCat(
        "the robot's graph has changed, and rule ", rule, " would raise it again: ",
        ros2::Printable(absl::StrJoin(GraphChanges(*seen.graph.graph, state_.graph.get()), ", ")));
  }
  return "";
}

std::vector<std::string> Approvals::ChangesSince(absl::string_view id) const {
  for (const Pending& each : pending_) {
    if (each.id == id && each.seen.graph.revision != state_.graph.revision()) {
      return GraphChanges(*each.seen.graph.graph, state_.graph.get());
    }
  }
  return {};
}

std::string Approvals::RuleSince(const Pending& pending) const {
  const levels::LevelTable& table = state_.level.table();
  const levels::LevelIndex to = table.Find(pending.order.to).value_or(0);
  const auto& seen = pending.seen.level_requests;
  for (const auto& [level, now] : state_.level_requests()) {
    const auto before = seen.find(level);
    if (level <= to || (before != seen.end() && before->second == now)) continue;
    return absl::StrCat("rule ", now.rule, " asked for ", table.name(level), " since");
  }
  return "";
}

std::string Approvals::End(absl::string_view id) {
  std::string of_id;
  std::erase_if(pending_, [&](const Pending& each) {
    std::string why = WhyOver(each);
    if (why.empty()) return false;
    ReportEnd(each, why);
    if (each.id == id) of_id = std::move(why);
    return true;
  });
  return of_id;
}

void Approvals::EndOf(absl::string_view identity) {
  std::erase_if(pending_, [&](const Pending& each) {
    if (each.order.identity != identity) return false;
    ReportEnd(each, "a certificate of who asked is banned");
    return true;
  });
}

void Approvals::ReportEnd(const Pending& pending, absl::string_view why) {
  Report(pending.order, engine::Severity::kInfo,
         absl::StrCat("the lowering of ", context_.config.id, " to ", pending.order.to, " (",
                      ShortId(pending.id), ") that operator ", pending.order.operator_name,
                      " asked for cannot be approved any more: ", why));
}

void Approvals::Report(const LevelOrder& asked, engine::Severity severity,
                       const std::string& text) {
  alerts_.RaiseOfKind(absl::StrCat("asked by ", asked.identity), severity, text);
}

std::vector<PendingApproval> Approvals::pending() const {
  std::vector<PendingApproval> out;
  for (const Pending& each : pending_) {
    if (!WhyOver(each).empty()) continue;  // ended with the next step of time
    out.push_back({.id = each.id,
                   .from = each.order.expected_level,
                   .to = each.order.to,
                   .decision_id = each.seen.decision_id,
                   .operator_name = each.order.operator_name,
                   .reason = each.order.reason,
                   .accept_blind = each.order.accept_blind,
                   .asked_unix_ns = each.asked.unix_ns,
                   .expires_unix_ns = each.asked.unix_ns + kApprovalNs,
                   .changes = ChangesSince(each.id)});
  }
  return out;
}

}  // namespace rips::pipeline

#include "policy_server/server/audit/returned_heads.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "policy_server/audit/verify.h"
#include "services/runtime/log.h"

namespace rips::audit {

ReturnedHeads::ReturnedHeads(std::unique_ptr<Segments> segments, Report report,
                             absl::Duration pause)
    : segments_(std::move(segments)),
      report_(std::move(report)),
      pause_(pause),
      thread_([this] { Run(); }) {}

ReturnedHeads::~ReturnedHeads() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    changed_.NotifyAll();
    stopped_.NotifyAll();
  }
  thread_.join();
}

void ReturnedHeads::Compare(HeadSource source, model::AuditHead head) {
  if (head.none()) return;
  MutexLock lock(&mu_);
  if (waiting_.size() >= kWaitingMax && !waiting_.contains(source)) {
    LogWarning("an actuator's audit head is not compared; too many wait",
               {{"robot", source.robot}, {"host", source.host}, {"limit", kWaitingMax}});
    return;
  }
  waiting_.try_emplace(std::move(source), std::move(head));
  changed_.NotifyOne();
}

void ReturnedHeads::Run() {
  while (true) {
    Waiting heads;
    {
      MutexLock lock(&mu_);
      while (waiting_.empty() && !stopping_) changed_.Wait(lock);
      if (waiting_.empty()) return;
      heads.swap(waiting_);
    }
    Waiting unread = CompareAll(heads);
    MutexLock lock(&mu_);
    if (stopping_) continue;
    for (auto& [source, head] : waiting_) {
      if (unread.size() < kWaitingMax) unread.try_emplace(source, std::move(head));
    }
    waiting_ = std::move(unread);
    stopped_.WaitFor(lock, pause_);
  }
}

ReturnedHeads::Waiting ReturnedHeads::CompareAll(const Waiting& heads) {
  ++pass_;
  Waiting unread;
  struct Group {
    std::vector<const HeadSource*> sources;
    std::vector<model::AuditHead> heads;
  };
  std::map<uint64_t, Group> groups;
  for (const auto& [source, head] : heads) {
    Group& group = groups[head.segment];
    group.sources.push_back(&source);
    group.heads.push_back(head);
  }
  for (const auto& [segment, group] : groups) {
    const absl::StatusOr<std::vector<HeadVerdict>> verdicts =
        CompareHeads(*segments_, segment, group.heads);
    if (!verdicts.ok()) {
      LogError("cannot compare the audit heads of actuators",
               {{"segment", segment}, {"reason", verdicts.status().message()}});
      for (size_t i = 0; i < group.heads.size(); ++i) {
        unread.emplace(*group.sources[i], group.heads[i]);
      }
      continue;
    }
    for (size_t i = 0; i < group.heads.size(); ++i) {
      ReportOnce(*group.sources[i], group.heads[i], (*verdicts)[i]);
    }
  }
  return unread;
}

void ReturnedHeads::ReportOnce(const HeadSource& source, const model::AuditHead& head,
                               HeadVerdict verdict) {
  if (verdict != HeadVerdict::kHeld) {
    const auto [last, fresh] = last_.try_emplace({source, verdict});
    const bool same = verdict != HeadVerdict::kContradicted || last->second.hash == head.hash;
    if (!fresh && same && pass_ - last->second.pass < kAgainPasses) return;
    last->second = {.hash = head.hash, .pass = pass_};
    // Actuators that are gone are forgotten with the rest.
    if (last_.size() > kWaitingMax) last_.clear();
  }
  report_(source, head, verdict);
}

HeadAlert AlertOf(const HeadSource& source, const model::AuditHead& head, HeadVerdict verdict) {
  using engine::Severity;
  const std::string who = absl::StrCat("the actuator on ", source.host, " was shown record ",
                                       head.sequence, " of the audit log");
  const std::string proof = absl::StrCat("`ripsctl audit verify DIR --head ",
                                         FormatHead({.sequence = head.sequence, .hash = head.hash}),
                                         "`, with a copy of the log as DIR, checks it");
  switch (verdict) {
    case HeadVerdict::kHeld:
      return {};
    case HeadVerdict::kContradicted:
      return {Severity::kCritical,
              absl::StrCat(who, ", signed by the key of segment ", head.segment,
                           ", and the log does not hold it: the log was put back to an older "
                           "state, or rewritten; ",
                           proof)};
    case HeadVerdict::kUnknownSegment:
      return {Severity::kHigh,
              absl::StrCat(who, " in segment ", head.segment,
                           ", which the log does not have, or has with another key: the log was "
                           "put back or replaced, or the actuator's key is in wrong hands; ",
                           proof)};
    case HeadVerdict::kForged:
      return {
          Severity::kHigh,
          absl::StrCat("the actuator on ", source.host, " says that it was shown record ",
                       head.sequence, " of the audit log, but the key of segment ", head.segment,
                       " has not signed it: its key is in wrong hands, or its file audit_head was "
                       "damaged; remove that file and restart the actuator, and if this comes "
                       "again, revoke its certificate")};
    case HeadVerdict::kOlder:
      return {Severity::kMedium,
              absl::StrCat(who, " in segment ", head.segment,
                           ", which is no longer in the log's directory: it cannot be compared; "
                           "with the segments that were moved away, ",
                           proof)};
  }
  return {};
}

}  // namespace rips::audit

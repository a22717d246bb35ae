#include "policy_server/server/audit/returned_heads.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "policy_server/audit/verify.h"
#include "services/runtime/log.h"

namespace rips::audit {

ReturnedHeads::ReturnedHeads(std::unique_ptr<Segments> segments, Told told, absl::Duration pause)
    : segments_(std::move(segments)),
      told_(std::move(told)),
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

void ReturnedHeads::Compare(HeadBringer bringer, model::AuditHead head) {
  if (head.none()) return;
  MutexLock lock(&mu_);
  if (waiting_.size() >= kWaitingMax && !waiting_.contains(bringer)) {
    LogWarning("an actuator's audit head is not compared; too many wait",
               {{"robot", bringer.robot}, {"host", bringer.host}, {"limit", kWaitingMax}});
    return;
  }
  waiting_.try_emplace(std::move(bringer), std::move(head));
  changed_.NotifyOne();
}

void ReturnedHeads::Run() {
  while (true) {
    Waiting heads;
    {
      MutexLock lock(&mu_);
      while (waiting_.empty() && !stopping_) changed_.Wait(lock);
      if (stopping_) return;
      heads.swap(waiting_);
    }
    CompareAll(heads);
    MutexLock lock(&mu_);
    if (!stopping_) stopped_.WaitFor(lock, pause_);
  }
}

void ReturnedHeads::CompareAll(const Waiting& heads) {
  ++pass_;
  struct Group {
    std::vector<const HeadBringer*> bringers;
    std::vector<model::AuditHead> heads;
  };
  std::map<uint64_t, Group> groups;
  for (const auto& [bringer, head] : heads) {
    Group& group = groups[head.segment];
    group.bringers.push_back(&bringer);
    group.heads.push_back(head);
  }
  for (const auto& [segment, group] : groups) {
    const absl::StatusOr<std::vector<HeadVerdict>> verdicts =
        CompareHeads(*segments_, segment, group.heads);
    if (!verdicts.ok()) {
      LogError("cannot compare the audit heads of actuators",
               {{"segment", segment}, {"reason", verdicts.status().message()}});
      continue;
    }
    for (size_t i = 0; i < group.heads.size(); ++i) {
      Tell(*group.bringers[i], group.heads[i], (*verdicts)[i]);
    }
  }
}

void ReturnedHeads::Tell(const HeadBringer& bringer, const model::AuditHead& head,
                         HeadVerdict verdict) {
  if (verdict != HeadVerdict::kHeld) {
    const auto [last, fresh] = last_.try_emplace(bringer);
    const bool proof = verdict == HeadVerdict::kContradicted;
    const bool again = !fresh && last->second.verdict == verdict &&
                       (!proof || last->second.hash == head.hash) &&
                       pass_ - last->second.pass < kAgainPasses;
    if (again) return;
    last->second = {.verdict = verdict, .hash = head.hash, .pass = pass_};
    // Names are of the inventory; those that have left it are forgotten with the rest.
    if (last_.size() > kWaitingMax) last_.clear();
  }
  told_(bringer, head, verdict);
}

HeadAlert AlertOf(const HeadBringer& bringer, const model::AuditHead& head, HeadVerdict verdict) {
  using engine::Severity;
  const std::string who = absl::StrCat("the actuator on ", bringer.host, " was shown record ",
                                       head.sequence, " of the audit log");
  const std::string proof =
      absl::StrCat("`ripsctl audit verify --head ",
                   FormatHead({.sequence = head.sequence, .hash = head.hash}), "` checks it");
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
          absl::StrCat("the actuator on ", bringer.host, " says that it was shown record ",
                       head.sequence, " of the audit log, but the key of segment ", head.segment,
                       " has not signed it: its file audit_head was damaged, or its key is in "
                       "wrong hands")};
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

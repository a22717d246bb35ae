#include "policy_server/server/robot/actuators/drill_run.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/actuators/receipt_history.h"

namespace rips::pipeline {
namespace {

// Of the sentence that sums it up.
constexpr size_t kSummaryBytesMax = 512;
// The actuator's own limit, told as the time to live.
constexpr uint32_t kDrillTtlMs = 15'000;

}  // namespace

DrillRun::DrillRun(const std::vector<std::string>& levels, const std::vector<Host>& hosts,
                   IdSource& ids, Instant now)
    : began_ns_(now.boottime_ns) {
  for (const Host& host : hosts) {
    if (host.attached) hosts_.push_back(host.name);
  }
  for (const std::string& level : levels) {
    for (const Host& host : hosts) {
      Try each{.entry = {.level = level, .host = host.name}, .command_id = ids.Next()};
      each.over = !host.attached;
      each.entry.detail = host.attached ? "no answer in time" : "the actuator is not attached";
      tries_.push_back(std::move(each));
    }
  }
}

DrillRun::Try* DrillRun::Current(const std::string& host) {
  for (Try& each : tries_) {
    if (each.entry.host == host && !each.over) return &each;
  }
  return nullptr;
}

std::vector<Outgoing> DrillRun::Due(uint64_t term, Instant now) {
  std::vector<Outgoing> due;
  for (const std::string& host : hosts_) {
    Try* current = Current(host);
    if (current == nullptr || current->acknowledged) continue;
    if (current->sent_ns != 0 && now.boottime_ns - current->sent_ns < kDrillResendNs) continue;
    current->sent_ns = now.boottime_ns;
    due.push_back({.host = host,
                   .command = {.id = current->command_id,
                               .term = term,
                               .ttl_ms = kDrillTtlMs,
                               .what = Drill{.level = current->entry.level}}});
  }
  return due;
}

bool DrillRun::OnReceipt(const std::string& host, const Receipt& receipt) {
  const auto found = std::find_if(tries_.begin(), tries_.end(), [&](const Try& each) {
    return each.entry.host == host && each.command_id == receipt.command_id;
  });
  if (found == tries_.end()) return false;
  // Nothing was asked yet, or it is answered: a peer that makes things up, or repeats itself.
  if (found->over || found->sent_ns == 0) return true;
  found->acknowledged = true;
  if (receipt.stage == Receipt::Stage::kAcknowledged) return true;
  Receipt kept = Trimmed(receipt, std::min(kReceiptBytesKept, kDrillBytesMax / tries_.size()));
  found->over = true;
  found->entry.stage = kept.stage;
  found->entry.steps = std::move(kept.steps);
  found->entry.detail = kept.detail;
  if (kept.stage == Receipt::Stage::kSuperseded || kept.stage == Receipt::Stage::kRefusedStale) {
    EndRest(host, kept.stage, absl::StrCat("not tried: ", kept.detail));
  }
  return true;
}

void DrillRun::EndRest(const std::string& host, Receipt::Stage stage, const std::string& why) {
  while (Try* rest = Current(host)) {
    rest->over = true;
    rest->entry.stage = stage;
    rest->entry.detail = why;
  }
}

void DrillRun::OnGone(const std::string& host) {
  if (Try* current = Current(host); current != nullptr && current->sent_ns != 0) {
    current->over = true;
    current->entry.stage = Receipt::Stage::kUnknown;
    current->entry.detail = "the actuator went away during the drill";
  }
  EndRest(host, Receipt::Stage::kUnknown, "not tried: the actuator went away");
}

bool DrillRun::Over(Instant now) const {
  if (now.boottime_ns - began_ns_ >= kDrillAnswerNs) return true;
  return std::all_of(tries_.begin(), tries_.end(), [](const Try& each) { return each.over; });
}

std::vector<DrillEntry> DrillRun::PopEntries() {
  std::vector<DrillEntry> entries;
  for (Try& each : tries_) entries.push_back(std::move(each.entry));
  tries_.clear();
  return entries;
}

bool AllWork(const std::vector<DrillEntry>& drills) {
  return std::all_of(drills.begin(), drills.end(), [](const DrillEntry& each) {
    return each.stage == Receipt::Stage::kVerified;
  });
}

std::string Summary(const std::vector<DrillEntry>& drills) {
  size_t steps = 0, work = 0;
  std::string failed;
  for (const DrillEntry& drill : drills) {
    for (const StepResult& step : drill.steps) {
      ++steps;
      work += step.ok ? 1 : 0;
      if (step.ok) continue;
      absl::StrAppend(&failed, failed.empty() ? "" : "; ", drill.host, ": ", step.step, " (",
                      drill.level, "): ", step.detail);
    }
    const bool told =
        drill.stage == Receipt::Stage::kVerified || drill.stage == Receipt::Stage::kFailed;
    if (told) continue;
    absl::StrAppend(&failed, failed.empty() ? "" : "; ", drill.host, ": ", drill.level, ": ",
                    drill.detail);
  }
  const std::string sum = absl::StrCat(work, " of ", steps, " steps work");
  if (failed.empty()) return sum;
  return Harmless(absl::StrCat(sum, "; these do not: ", failed), kSummaryBytesMax);
}

}  // namespace rips::pipeline

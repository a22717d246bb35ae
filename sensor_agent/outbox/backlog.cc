#include "sensor_agent/outbox/backlog.h"

#include <algorithm>
#include <limits>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/check.h"

namespace rips::sensor {

namespace {

// Lost control observations in one batch.
constexpr uint64_t kGapBatch = 128;
constexpr int kRefusalsMax = 2;
constexpr Lane kLanes[] = {Lane::kControl, Lane::kMessages};

}  // namespace

Backlog::Backlog(BacklogOptions options, std::string incarnation)
    : options_(options), incarnation_(std::move(incarnation)) {
  RIPS_CHECK(incarnation_.size() == kIncarnationBytes, "incarnation");
}

// --- Queues

BacklogQueue* Backlog::Find(const StreamKey& stream) {
  const auto it = std::find_if(queues_.begin(), queues_.end(),
                               [&](const BacklogQueue& each) { return each.stream() == stream; });
  return it == queues_.end() ? nullptr : &*it;
}

BacklogQueue& Backlog::QueueOf(const StreamKey& stream) {
  if (BacklogQueue* queue = Find(stream)) return *queue;
  return queues_.emplace_back(stream);
}

const BacklogQueue* Backlog::FrontQueue(Lane lane) const {
  for (const BacklogQueue& each : queues_) {
    if (each.stream().lane == lane && each.Front() != nullptr) return &each;
  }
  return nullptr;
}

bool Backlog::HasUnsent(Lane lane) const {
  return std::any_of(queues_.begin(), queues_.end(), [lane](const BacklogQueue& each) {
    return each.stream().lane == lane && each.sent() < each.entries().size();
  });
}

size_t Backlog::UnwrittenBytes() const {
  size_t bytes = 0;
  for (const BacklogQueue& each : queues_) bytes += each.unwritten_bytes();
  return bytes;
}

void Backlog::AddLoss(uint64_t count, int64_t now_ns) {
  losses_.push_back({.cause = LossCause::kSpoolLost,
                     .count = count,
                     .first_boottime_ns = now_ns,
                     .last_boottime_ns = now_ns});
}

// --- Filling

bool Backlog::ShouldShedPayloads() const {
  if (disk_.bytes_max > 0 && disk_.bytes > disk_.bytes_max / 4 * 3) return true;
  return UnwrittenBytes() > options_.memory_bytes / 4 * 3;
}

uint64_t Backlog::NextSequence(const StreamKey& stream) const {
  for (const BacklogQueue& each : queues_) {
    if (each.stream() == stream) return each.next_sequence();
  }
  return 1;
}

void Backlog::Put(const StreamKey& stream, uint64_t first_sequence, uint32_t count,
                  int64_t oldest_ns, std::string bytes) {
  QueueOf(stream).Put({.first_sequence = first_sequence,
                       .count = count,
                       .oldest_ns = oldest_ns,
                       .bytes = std::make_shared<const std::string>(std::move(bytes))});
}

// --- Sending

std::vector<BacklogRange> Backlog::Rewind() {
  std::vector<BacklogRange> ranges;
  announced_too_much_ = false;
  for (BacklogQueue& each : queues_) {
    if (!each.Rewind()) continue;
    ranges.push_back({.stream = each.stream(),
                      .first_sequence = each.entries().front().first_sequence,
                      .last_sequence = each.entries().back().last_sequence()});
  }
  return ranges;
}

std::optional<BacklogBatch> Backlog::Front(Lane lane) const {
  const BacklogQueue* queue = FrontQueue(lane);
  if (queue == nullptr) return std::nullopt;
  const BacklogEntry& entry = *queue->Front();
  if (entry.bytes == nullptr && !entry.gap) return std::nullopt;
  return BacklogBatch{.stream = queue->stream(),
                      .first_sequence = entry.first_sequence,
                      .count = entry.count,
                      .time_shift_ns = entry.record.has_value() ? entry.record->time_shift_ns : 0,
                      .bytes = entry.bytes};
}

void Backlog::MarkSent(const StreamKey& stream) {
  BacklogQueue* queue = Find(stream);
  RIPS_CHECK(queue != nullptr, "no such stream");
  queue->MarkSent();
}

absl::Status Backlog::Acknowledge(const StreamKey& stream, uint64_t sequence) {
  BacklogQueue* queue = Find(stream);
  if (queue == nullptr) return absl::OkStatus();
  if (stream.incarnation == incarnation_ && sequence >= queue->next_sequence()) {
    return absl::InvalidArgumentError(absl::StrCat("acknowledgement of ", sequence,
                                                   " of the backlog, but the last number given is ",
                                                   queue->next_sequence() - 1));
  }
  if (queue->Acknowledge(sequence, to_release_)) refusals_ = 0;
  return absl::OkStatus();
}

void Backlog::Discard(const StreamKey& stream, uint64_t first_sequence, int64_t now_ns) {
  BacklogQueue* queue = Find(stream);
  if (queue == nullptr) return;
  const std::optional<BacklogQueue::Discarded> discarded = queue->Discard(first_sequence);
  if (!discarded.has_value()) return;
  unreadable_ += discarded->count;
  if (discarded->released.has_value()) to_release_.push_back(*discarded->released);
  if (discarded->untold == 0) return;
  AddLoss(discarded->untold, now_ns);
  announced_too_much_ = true;
}

std::vector<std::pair<StreamKey, uint64_t>> Backlog::OnRefused(int64_t now_ns) {
  std::vector<std::pair<StreamKey, uint64_t>> oldest;
  for (const BacklogQueue& each : queues_) {
    if (each.sent() == 0) continue;
    oldest.emplace_back(each.stream(), each.entries().front().first_sequence);
  }
  if (oldest.empty() || ++refusals_ < kRefusalsMax) return {};
  refusals_ = 0;
  for (const auto& [stream, first_sequence] : oldest) Discard(stream, first_sequence, now_ns);
  return oldest;
}

// --- The disk

void Backlog::AddGap(const SpoolGap& gap, int64_t now_ns) {
  for (uint64_t done = 0; done < gap.count;) {
    const uint64_t some = std::min(gap.count - done, kGapBatch);
    QueueOf(gap.stream)
        .Put({.first_sequence = gap.first_sequence + done,
              .count = static_cast<uint32_t>(some),
              .oldest_ns = now_ns,
              .gap = true});
    done += some;
  }
}

void Backlog::Recover(const Recovered& recovered, int64_t now_ns) {
  std::map<StreamKey, std::deque<SpoolGap>> gaps;
  for (const SpoolGap& each : recovered.gaps) {
    unreadable_ += each.count;
    if (each.at_end) {
      AddLoss(each.count, now_ns);
    } else if (each.stream.lane == Lane::kControl) {
      gaps[each.stream].push_back(each);
    }
  }
  for (const SpoolRecord& each : recovered.records) {
    std::deque<SpoolGap>& before = gaps[each.stream];
    while (!before.empty() && before.front().first_sequence < each.first_sequence) {
      AddGap(before.front(), now_ns);
      before.pop_front();
    }
    QueueOf(each.stream)
        .Put({.first_sequence = each.first_sequence,
              .count = each.count,
              .oldest_ns = each.oldest_ns,
              .record = each});
  }
  if (recovered.unknown_lost) AddLoss(1, now_ns);
  for (BacklogQueue& each : queues_) each.Rewind();
}

void Backlog::BeginStop() {
  stopping_ = true;
  if (disk_.bytes_max > 0) refuses_until_ns_ = 0;
}

std::optional<SpoolJob> Backlog::NextJob(int64_t now_ns) {
  if (!to_release_.empty()) {
    SpoolRelease job{.record = std::move(to_release_.back())};
    to_release_.pop_back();
    return job;
  }
  std::optional<SpoolJob> job = NextRead();
  return job.has_value() ? std::move(job) : NextWrite(now_ns);
}

std::optional<SpoolJob> Backlog::NextWrite(int64_t now_ns) {
  if (writing_ || disk_.bytes_max == 0) return std::nullopt;
  if (stopping_ ? refuses_until_ns_ != 0
                : (UnwrittenBytes() <= options_.memory_bytes / 2 || now_ns < refuses_until_ns_)) {
    return std::nullopt;
  }
  for (const BacklogQueue& each : queues_) {
    const BacklogEntry* entry = each.NextToWrite();
    if (entry == nullptr) continue;
    RIPS_CHECK(entry->bytes != nullptr, "neither in memory nor on disk");
    writing_ = true;
    return SpoolWrite{.stream = each.stream(),
                      .first_sequence = entry->first_sequence,
                      .count = entry->count,
                      .oldest_ns = entry->oldest_ns,
                      .bytes = entry->bytes};
  }
  return std::nullopt;
}

std::optional<SpoolJob> Backlog::NextRead() {
  if (reading_ || stopping_) return std::nullopt;
  for (const Lane lane : kLanes) {
    const BacklogQueue* queue = FrontQueue(lane);
    if (queue == nullptr) continue;
    const BacklogEntry* entry = queue->NextToRead(options_.read_ahead_bytes);
    if (entry == nullptr) continue;
    reading_ = true;
    return SpoolRead{.record = *entry->record};
  }
  return std::nullopt;
}

void Backlog::On(SpoolWritten result, int64_t now_ns) {
  writing_ = false;
  disk_.bytes = result.disk_bytes;
  if (!result.record.ok()) {
    refuses_until_ns_ = now_ns + absl::ToInt64Nanoseconds(options_.retry);
    return;
  }
  refuses_until_ns_ = 0;
  BacklogQueue* queue = Find(result.stream);
  // Acknowledged or refused meanwhile.
  if (queue == nullptr || !queue->Written(result.first_sequence, *result.record)) {
    to_release_.push_back(*std::move(result.record));
  }
}

std::optional<uint64_t> Backlog::On(SpoolReadBack result, int64_t now_ns) {
  reading_ = false;
  if (!result.bytes.ok()) {
    Discard(result.stream, result.first_sequence, now_ns);
    return result.first_sequence;
  }
  if (BacklogQueue* queue = Find(result.stream)) {
    queue->ReadBack(result.first_sequence, *std::move(result.bytes));
  }
  return std::nullopt;
}

std::optional<int64_t> Backlog::RetryAt() const {
  if (disk_.bytes_max == 0 || writing_ || refuses_until_ns_ == 0) return std::nullopt;
  if (UnwrittenBytes() <= options_.memory_bytes / 2) return std::nullopt;
  return refuses_until_ns_;
}

// --- State

BacklogState Backlog::state() const {
  BacklogState state{.disk_refuses = disk_.refuses || refuses_until_ns_ != 0,
                     .unreadable = unreadable_,
                     .announced_too_much = announced_too_much_};
  for (const BacklogQueue& queue : queues_) {
    state.memory_bytes += queue.memory_bytes();
    if (queue.entries().empty()) continue;
    state.observations +=
        queue.entries().back().last_sequence() - queue.entries().front().first_sequence + 1;
    const int64_t oldest_ns = queue.entries().front().oldest_ns;
    state.oldest_ns = std::min(state.oldest_ns.value_or(oldest_ns), oldest_ns);
  }
  return state;
}

uint64_t Backlog::Unwritten() const {
  uint64_t count = 0;
  for (const BacklogQueue& queue : queues_) {
    for (const BacklogEntry& each : queue.entries()) count += each.on_disk() ? 0 : each.count;
  }
  return count;
}

}  // namespace rips::sensor

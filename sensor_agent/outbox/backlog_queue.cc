#include "sensor_agent/outbox/backlog_queue.h"

#include <algorithm>
#include <utility>

#include "services/base/check.h"

namespace rips::sensor {

void BacklogQueue::Put(BacklogEntry entry) {
  if (entries_.empty()) acknowledged_ = entry.first_sequence - 1;
  next_sequence_ = entry.last_sequence() + 1;
  if (entry.bytes != nullptr) {
    memory_bytes_ += entry.bytes->size();
    if (!entry.record.has_value()) unwritten_bytes_ += entry.bytes->size();
  }
  entries_.push_back(std::move(entry));
  AdvanceWritten();
}

BacklogEntry* BacklogQueue::Find(uint64_t first_sequence) {
  const auto it = std::lower_bound(
      entries_.begin(), entries_.end(), first_sequence,
      [](const BacklogEntry& entry, uint64_t sequence) { return entry.first_sequence < sequence; });
  if (it == entries_.end() || it->first_sequence != first_sequence) return nullptr;
  return &*it;
}

void BacklogQueue::SetBytes(BacklogEntry& entry, std::shared_ptr<const std::string> bytes) {
  const size_t before = entry.bytes == nullptr ? 0 : entry.bytes->size();
  const size_t after = bytes == nullptr ? 0 : bytes->size();
  memory_bytes_ += after - before;
  if (!entry.record.has_value()) unwritten_bytes_ += after - before;
  entry.bytes = std::move(bytes);
}

void BacklogQueue::AdvanceWritten() {
  while (written_ < entries_.size() && entries_[written_].on_disk()) ++written_;
}

// --- Sending

bool BacklogQueue::Rewind() {
  sent_ = 0;
  resumed_ = entries_.empty();
  return !entries_.empty();
}

const BacklogEntry* BacklogQueue::Front() const {
  return resumed_ && sent_ < entries_.size() ? &entries_[sent_] : nullptr;
}

void BacklogQueue::MarkSent() {
  RIPS_CHECK(sent_ < entries_.size(), "no such batch");
  ++sent_;
}

bool BacklogQueue::Acknowledge(uint64_t sequence, std::vector<SpoolRecord>& release) {
  resumed_ = true;
  bool went = false;
  while (!entries_.empty() && entries_.front().last_sequence() <= sequence) {
    PopFront(release);
    went = true;
  }
  return went;
}

void BacklogQueue::PopFront(std::vector<SpoolRecord>& release) {
  BacklogEntry& entry = entries_.front();
  acknowledged_ = entry.last_sequence();
  SetBytes(entry, nullptr);
  if (entry.record.has_value()) release.push_back(*entry.record);
  entries_.pop_front();
  if (sent_ > 0) --sent_;
  if (written_ > 0) --written_;
}

// --- The disk

const BacklogEntry* BacklogQueue::NextToWrite() const {
  return written_ < entries_.size() ? &entries_[written_] : nullptr;
}

const BacklogEntry* BacklogQueue::NextToRead(size_t ahead_bytes) const {
  size_t ahead = 0;
  for (size_t i = sent_; i < entries_.size() && ahead < ahead_bytes; ++i) {
    const BacklogEntry& entry = entries_[i];
    if (entry.bytes == nullptr && !entry.gap) return &entry;
    ahead += entry.bytes == nullptr ? 0 : entry.bytes->size();
  }
  return nullptr;
}

bool BacklogQueue::Written(uint64_t first_sequence, const SpoolRecord& record) {
  BacklogEntry* entry = Find(first_sequence);
  if (entry == nullptr || entry->gap) return false;
  unwritten_bytes_ -= entry->bytes->size();
  entry->record = record;
  AdvanceWritten();
  const bool in_flight = sent_ > 0 && entry->first_sequence <= entries_[sent_ - 1].first_sequence;
  if (!in_flight) SetBytes(*entry, nullptr);
  return true;
}

void BacklogQueue::ReadBack(uint64_t first_sequence, std::string bytes) {
  BacklogEntry* entry = Find(first_sequence);
  if (entry == nullptr || entry->gap) return;
  SetBytes(*entry, std::make_shared<const std::string>(std::move(bytes)));
}

std::optional<BacklogQueue::Discarded> BacklogQueue::Discard(uint64_t first_sequence) {
  BacklogEntry* entry = Find(first_sequence);
  if (entry == nullptr) return std::nullopt;
  Discarded discarded{.count = entry->count, .released = entry->record};
  SetBytes(*entry, nullptr);
  entry->record.reset();
  entry->gap = true;
  if (stream_.lane == Lane::kControl) {
    AdvanceWritten();
    return discarded;
  }
  const auto index = static_cast<size_t>(std::count_if(
      entries_.begin(), entries_.end(),
      [&](const BacklogEntry& each) { return each.first_sequence < first_sequence; }));
  if (index + 1 == entries_.size()) {
    // No number behind them shows that they, and what was lost just before them, are missing.
    const uint64_t before = index > 0 ? entries_[index - 1].last_sequence() : acknowledged_;
    discarded.untold = entry->last_sequence() - before;
  }
  entries_.erase(entries_.begin() + static_cast<ptrdiff_t>(index));
  if (index < written_) --written_;
  if (index < sent_) --sent_;
  return discarded;
}

}  // namespace rips::sensor

#include "sensor_agent/spool/backlog.h"

#include <algorithm>
#include <limits>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/check.h"
#include "services/runtime/log.h"

namespace rips::sensor {

namespace {

// Lost control observations in one batch.
constexpr uint64_t kGapBatch = 128;
constexpr int kRefusalsMax = 2;

}  // namespace

Backlog::Backlog(BacklogOptions options, std::string incarnation, const Clock* clock,
                 std::function<void()> wake)
    : options_(std::move(options)),
      incarnation_(std::move(incarnation)),
      clock_(clock),
      wake_(std::move(wake)) {
  RIPS_CHECK(incarnation_.size() == kIncarnationBytes, "incarnation");
}

Backlog::~Backlog() { Stop(); }

absl::Status Backlog::Open() {
  if (options_.spool.dir.empty() || options_.spool.disk_bytes == 0) return absl::OkStatus();
  absl::StatusOr<std::unique_ptr<Spool>> spool = Spool::Open(options_.spool);
  if (spool.ok()) {
    spool_ = *std::move(spool);
    has_disk_ = true;
    return absl::OkStatus();
  }
  if (absl::IsFailedPrecondition(spool.status())) return spool.status();
  LogError("no spool on disk; unacknowledged observations are kept in memory only",
           {{"error", spool.status().message()}});
  MutexLock lock(&mu_);
  refuses_until_ns_ = std::numeric_limits<int64_t>::max();
  return absl::OkStatus();
}

void Backlog::Start() {
  RIPS_CHECK(!thread_.joinable(), "a backlog starts once");
  thread_ = std::thread([this] { Run(); });
}

uint64_t Backlog::Stop() {
  {
    MutexLock lock(&mu_);
    // The disk is asked once more.
    if (!stopping_ && has_disk_) refuses_until_ns_ = 0;
    stopping_ = true;
    work_.NotifyOne();
  }
  if (thread_.joinable()) thread_.join();
  MutexLock lock(&mu_);
  return UnwrittenLocked();
}

uint64_t Backlog::UnwrittenLocked() const {
  uint64_t count = 0;
  for (const Queue& queue : queues_) {
    for (const Entry& entry : queue.entries) {
      if (!entry.record.has_value() && !entry.gap) count += entry.count;
    }
  }
  return count;
}

void Backlog::WaitUntilRecovered() {
  MutexLock lock(&mu_);
  while (!recovered_) recovered_cond_.Wait(lock);
}

// --- Queues

Backlog::Queue* Backlog::FindQueue(const StreamKey& stream) {
  for (Queue& each : queues_) {
    if (each.stream == stream) return &each;
  }
  return nullptr;
}

Backlog::Queue& Backlog::QueueOf(const StreamKey& stream) {
  if (Queue* queue = FindQueue(stream)) return *queue;
  queues_.push_back({.stream = stream});
  return queues_.back();
}

Backlog::Entry* Backlog::Find(const Place& place) {
  Queue* queue = FindQueue(place.stream);
  if (queue == nullptr) return nullptr;
  const auto it = std::lower_bound(
      queue->entries.begin(), queue->entries.end(), place.first_sequence,
      [](const Entry& entry, uint64_t sequence) { return entry.first_sequence < sequence; });
  if (it == queue->entries.end() || it->first_sequence != place.first_sequence) return nullptr;
  return &*it;
}

const Backlog::Queue* Backlog::FrontQueue(Lane lane) const {
  for (const Queue& each : queues_) {
    if (each.stream.lane == lane && each.resumed && each.sent < each.entries.size()) return &each;
  }
  return nullptr;
}

void Backlog::SetBytes(Entry& entry, std::shared_ptr<const std::string> bytes) {
  const size_t before = entry.bytes == nullptr ? 0 : entry.bytes->size();
  const size_t after = bytes == nullptr ? 0 : bytes->size();
  memory_bytes_ += after - before;
  if (!entry.record.has_value()) unwritten_bytes_ += after - before;
  entry.bytes = std::move(bytes);
}

void Backlog::PutLocked(Queue& queue, Entry entry) {
  if (queue.entries.empty()) queue.acknowledged = entry.first_sequence - 1;
  queue.next_sequence = entry.last_sequence() + 1;
  if (entry.bytes != nullptr) {
    memory_bytes_ += entry.bytes->size();
    if (!entry.record.has_value()) unwritten_bytes_ += entry.bytes->size();
  }
  queue.entries.push_back(std::move(entry));
  AdvanceWritten(queue);
}

void Backlog::AdvanceWritten(Queue& queue) {
  while (queue.written < queue.entries.size() && queue.entries[queue.written].on_disk()) {
    ++queue.written;
  }
}

void Backlog::PopFront(Queue& queue) {
  Entry& entry = queue.entries.front();
  queue.acknowledged = entry.last_sequence();
  SetBytes(entry, nullptr);
  if (entry.record.has_value()) to_release_.push_back(*entry.record);
  queue.entries.pop_front();
  if (queue.sent > 0) --queue.sent;
  if (queue.written > 0) --queue.written;
}

void Backlog::AddLoss(uint64_t count) {
  const int64_t now_ns = clock_->Now().boottime_ns;
  losses_.push_back({.cause = LossCause::kSpoolLost,
                     .count = count,
                     .first_boottime_ns = now_ns,
                     .last_boottime_ns = now_ns});
}

void Backlog::AddGap(Queue& queue, uint64_t first_sequence, uint64_t count) {
  while (count > 0) {
    const uint64_t some = std::min(count, kGapBatch);
    PutLocked(queue, {.first_sequence = first_sequence,
                      .count = static_cast<uint32_t>(some),
                      .oldest_ns = clock_->Now().boottime_ns,
                      .gap = true});
    first_sequence += some;
    count -= some;
  }
}

// --- Filling

bool Backlog::HasRoom() const {
  MutexLock lock(&mu_);
  return unwritten_bytes_ < options_.memory_bytes;
}

bool Backlog::ShouldShedPayloads() const {
  MutexLock lock(&mu_);
  if (has_disk_ && disk_bytes_ > options_.spool.disk_bytes / 4 * 3) return true;
  return unwritten_bytes_ > options_.memory_bytes / 4 * 3;
}

void Backlog::SetAside(Lane lane, uint32_t count, int64_t oldest_ns, std::string bytes) {
  MutexLock lock(&mu_);
  Queue& queue = QueueOf({.incarnation = incarnation_, .lane = lane});
  PutLocked(queue, {.first_sequence = queue.next_sequence,
                    .count = count,
                    .oldest_ns = oldest_ns,
                    .bytes = std::make_shared<const std::string>(std::move(bytes))});
  if (NextToWrite().has_value()) work_.NotifyOne();
}

void Backlog::Put(const StreamKey& stream, uint64_t first_sequence, uint32_t count,
                  int64_t oldest_ns, std::string bytes) {
  MutexLock lock(&mu_);
  PutLocked(QueueOf(stream), {.first_sequence = first_sequence,
                              .count = count,
                              .oldest_ns = oldest_ns,
                              .bytes = std::make_shared<const std::string>(std::move(bytes))});
  if (NextToWrite().has_value()) work_.NotifyOne();
}

// --- Sending

std::vector<BacklogRange> Backlog::Rewind() {
  MutexLock lock(&mu_);
  std::vector<BacklogRange> ranges;
  announced_too_much_ = false;
  for (Queue& each : queues_) {
    each.sent = 0;
    each.highest_sent = 0;
    each.resumed = each.entries.empty();
    if (each.entries.empty()) continue;
    ranges.push_back({.stream = each.stream,
                      .first_sequence = each.entries.front().first_sequence,
                      .last_sequence = each.entries.back().last_sequence()});
  }
  return ranges;
}

std::optional<BacklogBatch> Backlog::Front(Lane lane) const {
  MutexLock lock(&mu_);
  const Queue* queue = FrontQueue(lane);
  if (queue == nullptr) return std::nullopt;
  const Entry& entry = queue->entries[queue->sent];
  if (entry.bytes == nullptr && !entry.gap) return std::nullopt;
  return BacklogBatch{.stream = queue->stream,
                      .first_sequence = entry.first_sequence,
                      .count = entry.count,
                      .time_shift_ns = entry.record.has_value() ? entry.record->time_shift_ns : 0,
                      .bytes = entry.bytes};
}

void Backlog::MarkSent(const StreamKey& stream) {
  MutexLock lock(&mu_);
  Queue* queue = FindQueue(stream);
  RIPS_CHECK(queue != nullptr && queue->sent < queue->entries.size(), "no such batch");
  queue->highest_sent = queue->entries[queue->sent].last_sequence();
  ++queue->sent;
  if (NextToRead().has_value()) work_.NotifyOne();
}

absl::Status Backlog::Acknowledge(const StreamKey& stream, uint64_t sequence) {
  MutexLock lock(&mu_);
  Queue* queue = FindQueue(stream);
  if (queue == nullptr) return absl::OkStatus();
  if (stream.incarnation == incarnation_ && sequence >= queue->next_sequence) {
    return absl::InvalidArgumentError(absl::StrCat("acknowledgement of ", sequence,
                                                   " of the backlog, but the last number given is ",
                                                   queue->next_sequence - 1));
  }
  const bool resuming = !queue->resumed;
  queue->resumed = true;
  if (!resuming && sequence > queue->highest_sent && !queue->entries.empty() &&
      sequence >= queue->entries.front().first_sequence) {
    return absl::InvalidArgumentError(absl::StrCat("acknowledgement of ", sequence,
                                                   " of the backlog, but the last sent is ",
                                                   queue->highest_sent));
  }
  if (resuming) queue->highest_sent = sequence;
  while (!queue->entries.empty() && queue->entries.front().last_sequence() <= sequence) {
    PopFront(*queue);
    refusals_ = 0;
  }
  if (!to_release_.empty() || NextToRead().has_value()) work_.NotifyOne();
  return absl::OkStatus();
}

// --- Looking

std::vector<Loss> Backlog::TakeLosses() {
  MutexLock lock(&mu_);
  return std::exchange(losses_, {});
}

BacklogState Backlog::state() const {
  MutexLock lock(&mu_);
  BacklogState state{.memory_bytes = memory_bytes_,
                     .disk_bytes = disk_bytes_,
                     .disk_refuses = refuses_until_ns_ != 0,
                     .unreadable = unreadable_,
                     .announced_too_much = announced_too_much_};
  for (const Queue& queue : queues_) {
    if (queue.entries.empty()) continue;
    state.observations +=
        queue.entries.back().last_sequence() - queue.entries.front().first_sequence + 1;
    const int64_t oldest_ns = queue.entries.front().oldest_ns;
    state.oldest_ns = std::min(state.oldest_ns.value_or(oldest_ns), oldest_ns);
  }
  return state;
}

// --- The thread's

std::optional<Backlog::Place> Backlog::NextToWrite() const {
  if (!has_disk_ || !recovered_) return std::nullopt;
  if (!stopping_) {
    if (unwritten_bytes_ <= options_.memory_bytes / 2) return std::nullopt;
    if (clock_->Now().boottime_ns < refuses_until_ns_) return std::nullopt;
  } else if (refuses_until_ns_ != 0) {
    return std::nullopt;
  }
  for (const Queue& each : queues_) {
    if (each.written == each.entries.size()) continue;
    return Place{.stream = each.stream,
                 .first_sequence = each.entries[each.written].first_sequence};
  }
  return std::nullopt;
}

std::optional<Backlog::Place> Backlog::NextToRead() const {
  if (stopping_) return std::nullopt;
  for (const Lane lane : {Lane::kControl, Lane::kMessages}) {
    const Queue* queue = FrontQueue(lane);
    if (queue == nullptr) continue;
    size_t ahead = 0;
    for (size_t i = queue->sent; i < queue->entries.size() && ahead < options_.read_ahead_bytes;
         ++i) {
      const Entry& entry = queue->entries[i];
      if (entry.bytes == nullptr && !entry.gap) {
        return Place{.stream = queue->stream, .first_sequence = entry.first_sequence};
      }
      ahead += entry.bytes == nullptr ? 0 : entry.bytes->size();
    }
  }
  return std::nullopt;
}

void Backlog::Run() {
  Recover();
  wake_();
  while (true) {
    std::vector<SpoolRecord> release;
    std::optional<Place> to_read;
    std::optional<Place> to_write;
    {
      MutexLock lock(&mu_);
      while (true) {
        to_read = NextToRead();
        to_write = NextToWrite();
        if (stopping_ || !to_release_.empty() || to_read.has_value() || to_write.has_value()) break;
        work_.WaitFor(lock, options_.retry);
      }
      release = std::exchange(to_release_, {});
      if (stopping_ && !to_write.has_value() && release.empty()) break;
    }
    for (const SpoolRecord& each : release) spool_->Release(each);
    if (to_read.has_value()) ReadOne(*to_read);
    if (to_write.has_value()) WriteOne(*to_write);
    if (!has_disk_) continue;
    MutexLock lock(&mu_);
    disk_bytes_ = spool_->bytes();
  }
  if (!has_disk_) return;
  {
    MutexLock lock(&mu_);
    // The next process shall say that something is lost.
    if (UnwrittenLocked() > 0) return;
  }
  if (absl::Status clean = spool_->MarkClean(); !clean.ok()) {
    LogError("spool not closed cleanly", {{"error", clean.message()}});
  }
}

void Backlog::Recover() {
  Recovered recovered;
  if (spool_ != nullptr) recovered = spool_->Recover();
  for (const std::string& problem : recovered.problems) {
    LogWarning("spool", {{"problem", problem}});
  }
  MutexLock lock(&mu_);
  std::map<StreamKey, std::deque<SpoolGap>> gaps;
  for (const SpoolGap& each : recovered.gaps) {
    unreadable_ += each.count;
    if (each.at_end) {
      AddLoss(each.count);
    } else if (each.stream.lane == Lane::kControl) {
      gaps[each.stream].push_back(each);
    }
  }
  for (const SpoolRecord& each : recovered.records) {
    std::deque<SpoolGap>& before = gaps[each.stream];
    while (!before.empty() && before.front().first_sequence < each.first_sequence) {
      AddGap(QueueOf(each.stream), before.front().first_sequence, before.front().count);
      before.pop_front();
    }
    PutLocked(QueueOf(each.stream), {.first_sequence = each.first_sequence,
                                     .count = each.count,
                                     .oldest_ns = each.oldest_ns,
                                     .record = each});
  }
  if (recovered.unknown_lost) AddLoss(1);
  for (Queue& each : queues_) each.resumed = false;
  if (spool_ != nullptr) disk_bytes_ = spool_->bytes();
  if (!recovered.records.empty()) {
    LogInfo("found observations of a previous run",
            {{"batches", recovered.records.size()}, {"bytes", disk_bytes_}});
  }
  recovered_ = true;
  recovered_cond_.NotifyAll();
}

void Backlog::WriteOne(const Place& place) {
  std::shared_ptr<const std::string> bytes;
  Frame frame;
  {
    MutexLock lock(&mu_);
    const Entry* entry = Find(place);
    if (entry == nullptr || entry->gap) return;
    RIPS_CHECK(entry->bytes != nullptr, "neither in memory nor on disk");
    bytes = entry->bytes;
    frame = {.first_sequence = entry->first_sequence,
             .count = entry->count,
             .oldest_ns = entry->oldest_ns,
             .payload = *bytes};
  }
  const absl::StatusOr<SpoolRecord> record = spool_->Append(place.stream, frame);
  bool refused = false;
  {
    MutexLock lock(&mu_);
    refused = refuses_until_ns_ != 0;
    if (!record.ok()) {
      refuses_until_ns_ = clock_->Now().boottime_ns + absl::ToInt64Nanoseconds(options_.retry);
    } else {
      refuses_until_ns_ = 0;
      TakeRecord(place, *record);
    }
  }
  if (!record.ok() && !refused) {
    LogError("spool full; keeping new observations in memory and dropping them when that is full",
             {{"error", record.status().message()}});
  } else if (record.ok() && refused) {
    LogInfo("spool accepts observations again");
    wake_();
  }
}

void Backlog::TakeRecord(const Place& place, const SpoolRecord& record) {
  Queue* queue = FindQueue(place.stream);
  Entry* entry = Find(place);
  // Acknowledged or refused meanwhile.
  if (entry == nullptr || entry->gap) return to_release_.push_back(record);
  unwritten_bytes_ -= entry->bytes->size();
  entry->record = record;
  AdvanceWritten(*queue);
  const bool in_flight =
      queue->sent > 0 && entry->first_sequence <= queue->entries[queue->sent - 1].first_sequence;
  if (!in_flight) SetBytes(*entry, nullptr);
}

void Backlog::ReadOne(const Place& place) {
  std::optional<SpoolRecord> record;
  {
    MutexLock lock(&mu_);
    const Entry* entry = Find(place);
    if (entry == nullptr || !entry->record.has_value()) return;
    record = entry->record;
  }
  absl::StatusOr<std::string> bytes = spool_->Read(*record);
  if (!bytes.ok()) {
    Discard(place.stream, place.first_sequence, bytes.status());
  } else {
    MutexLock lock(&mu_);
    Entry* entry = Find(place);
    if (entry == nullptr) return;
    SetBytes(*entry, std::make_shared<const std::string>(*std::move(bytes)));
  }
  wake_();
}

void Backlog::Discard(const StreamKey& stream, uint64_t first_sequence, const absl::Status& why) {
  MutexLock lock(&mu_);
  DiscardLocked(stream, first_sequence, why);
}

void Backlog::Refused(const absl::Status& why) {
  MutexLock lock(&mu_);
  std::vector<Place> oldest;
  for (const Queue& each : queues_) {
    if (each.sent == 0) continue;
    oldest.push_back({.stream = each.stream, .first_sequence = each.entries[0].first_sequence});
  }
  if (oldest.empty() || ++refusals_ < kRefusalsMax) return;
  refusals_ = 0;
  for (const Place& each : oldest) DiscardLocked(each.stream, each.first_sequence, why);
}

void Backlog::DiscardLocked(const StreamKey& stream, uint64_t first_sequence,
                            const absl::Status& why) {
  LogError("backlog observations lost",
           {{"first_sequence", first_sequence}, {"error", why.message()}});
  Queue* queue = FindQueue(stream);
  Entry* entry = Find({.stream = stream, .first_sequence = first_sequence});
  if (entry == nullptr) return;
  unreadable_ += entry->count;
  if (entry->record.has_value()) to_release_.push_back(*entry->record);
  SetBytes(*entry, nullptr);
  entry->record.reset();
  entry->gap = true;
  work_.NotifyOne();
  if (stream.lane == Lane::kControl) return AdvanceWritten(*queue);
  if (entry == &queue->entries.back()) {
    // No number behind them shows that they, and what was lost just before them, are missing.
    const size_t count = queue->entries.size();
    const uint64_t before =
        count > 1 ? queue->entries[count - 2].last_sequence() : queue->acknowledged;
    AddLoss(entry->last_sequence() - before);
    announced_too_much_ = true;
  }
  const size_t index = static_cast<size_t>(
      std::count_if(queue->entries.begin(), queue->entries.end(),
                    [&](const Entry& each) { return each.first_sequence < first_sequence; }));
  queue->entries.erase(queue->entries.begin() + static_cast<ptrdiff_t>(index));
  if (index < queue->written) --queue->written;
  if (index < queue->sent) --queue->sent;
}

}  // namespace rips::sensor

#include "policy_server/server/store/committer.h"

#include <algorithm>
#include <chrono>
#include <iterator>
#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::store {
namespace {

// It says how far a robot is, and nothing else: only the outbox of a sensor waits for it.
template <typename Item>
bool IsPatient(const Item& item) {
  const WriteBatch& batch = item.batch;
  const Checkpoint& checkpoint = batch.checkpoint;
  return item.done && !checkpoint.high_water.empty() && !checkpoint.bundle &&
         !checkpoint.maintenance && batch.decisions.empty() && batch.refusals.empty() &&
         batch.stages.empty() && batch.alerts.empty() && batch.receipts.empty() &&
         batch.acks.empty();
}

// Empty = the end.
template <typename Item>
std::vector<Item> NextGroup(BoundedQueue<Item>& queue, const CommitterOptions& options) {
  std::vector<Item> items = queue.PopAll(absl::InfiniteDuration(), options.group_max);
  const auto until = std::chrono::steady_clock::now() + absl::ToChronoNanoseconds(options.gather);
  bool patient = !items.empty() && std::all_of(items.begin(), items.end(), IsPatient<Item>);
  while (patient && items.size() < options.group_max) {
    const absl::Duration left = absl::FromChrono(until - std::chrono::steady_clock::now());
    if (left <= absl::ZeroDuration()) break;
    std::vector<Item> more = queue.PopAll(left, options.group_max - items.size());
    patient = !more.empty() && std::all_of(more.begin(), more.end(), IsPatient<Item>);
    std::move(more.begin(), more.end(), std::back_inserter(items));
  }
  return items;
}

}  // namespace

Committer::Committer(Store* store, CommitterOptions options, const Clock* clock)
    : store_(store),
      options_(std::move(options)),
      queue_({.capacity = options_.waiting_max, .on_full = OnFull::kRefuse}),
      clock_(clock),
      thread_([this] { Run(); }) {}

Committer::~Committer() { Stop(); }

absl::Status Committer::Submit(WriteBatch batch, Done done) {
  if (queue_.Push({.batch = std::move(batch), .done = std::move(done)})) return absl::OkStatus();
  if (queue_.closed()) return absl::FailedPreconditionError("the committer has been stopped");
  return absl::ResourceExhaustedError(absl::StrCat(
      "more than ", options_.waiting_max, " batches wait to be stored; the disk is too slow"));
}

void Committer::Stop() {
  if (stopped_.exchange(true)) return;
  queue_.Close();
  thread_.join();
}

void Committer::Run() {
  while (true) {
    std::vector<Item> items = NextGroup(queue_, options_);
    // Only a closed queue gives nothing after an endless wait.
    if (items.empty()) return;
    CommitFirst();
    // What only woke this thread.
    std::erase_if(items, [](const Item& item) { return !item.done; });
    if (!items.empty()) CommitGroup(std::move(items));
  }
}

void Committer::PutFirst(WriteBatch batch, Done done) {
  {
    MutexLock lock(&mu_);
    if (first_.size() >= options_.first_max) {
      first_.pop_front();
      ++first_dropped_;
    }
    first_.push_back({.batch = std::move(batch), .done = std::move(done)});
  }
  // Wakes the thread. If it cannot, enough waits to wake it, or it has ended.
  Submit({}, nullptr).IgnoreError();
}

absl::Status Committer::health() const {
  MutexLock lock(&mu_);
  if (began_ns_ != 0) {
    const int64_t took_ns = clock_->Now().boottime_ns - began_ns_;
    if (took_ns > options_.hang_ns) {
      return absl::UnavailableError(absl::StrCat("a write has not ended for more than ",
                                                 options_.hang_ns / kNanosPerSecond, " s"));
    }
  }
  return health_;
}

void Committer::UpdateHealth(const std::vector<WriteBatch>& batches, const Statuses& statuses) {
  if (statuses.ok()) {
    // That the reserve was written says nothing of the rest of the disk.
    bool written = false;
    for (size_t i = 0; i < batches.size(); ++i) {
      written |= (*statuses)[i].ok() && !batches[i].uses_reserve;
    }
    if (!written) return;
  } else {
    ++failures_;
  }
  MutexLock lock(&mu_);
  health_ = statuses.status();
}

Committer::Statuses Committer::Commit(const std::vector<WriteBatch>& batches) {
  const int64_t began_ns = clock_ == nullptr ? 0 : clock_->Now().boottime_ns;
  {
    MutexLock lock(&mu_);
    began_ns_ = began_ns;
  }
  const absl::Status before =
      options_.before_commit ? options_.before_commit(batches) : absl::OkStatus();
  Statuses statuses = before.ok() ? store_->CommitAll(batches) : Statuses(before);
  if (clock_ != nullptr && options_.on_commit) {
    options_.on_commit(clock_->Now().boottime_ns - began_ns);
  }
  MutexLock lock(&mu_);
  began_ns_ = 0;
  return statuses;
}

void Committer::CommitFirst() {
  std::vector<Item> items;
  {
    MutexLock lock(&mu_);
    items.assign(std::make_move_iterator(first_.begin()), std::make_move_iterator(first_.end()));
    first_.clear();
  }
  if (items.empty()) return;
  std::vector<WriteBatch> batches;
  for (const Item& item : items) batches.push_back(item.batch);
  const Statuses statuses = Commit(batches);
  UpdateHealth(batches, statuses);
  if (statuses.ok()) {
    for (size_t i = 0; i < items.size(); ++i) std::move(items[i].done)((*statuses)[i]);
    return;
  }
  MutexLock lock(&mu_);
  first_.insert(first_.begin(), std::make_move_iterator(items.begin()),
                std::make_move_iterator(items.end()));
}

void Committer::CommitGroup(std::vector<Item> items) {
  std::vector<WriteBatch> batches;
  batches.reserve(items.size());
  for (Item& item : items) batches.push_back(std::move(item.batch));
  const Statuses together = Commit(batches);
  UpdateHealth(batches, together);
  if (together.ok()) {
    for (size_t i = 0; i < items.size(); ++i) std::move(items[i].done)((*together)[i]);
    return;
  }
  // Raises of levels have the reserve, which the others must not use up.
  std::vector<WriteBatch> raises;
  for (const WriteBatch& batch : batches) {
    if (absl::IsResourceExhausted(together.status()) && batch.uses_reserve) raises.push_back(batch);
  }
  const Statuses alone = raises.empty() ? together : Commit(raises);
  size_t raise = 0;
  for (size_t i = 0; i < items.size(); ++i) {
    absl::Status status = together.status();
    if (!raises.empty() && batches[i].uses_reserve) {
      status = alone.ok() ? (*alone)[raise++] : alone.status();
    }
    std::move(items[i].done)(status);
  }
}

}  // namespace rips::store

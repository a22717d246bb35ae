#include "policy_server/server/store/committer.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::store {
namespace {

// The batch is wrong, not the disk.
bool IsCallersFault(const absl::Status& status) {
  return absl::IsInvalidArgument(status) || absl::IsAlreadyExists(status);
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
    std::vector<Item> items = queue_.PopAll(absl::InfiniteDuration(), options_.group_max);
    // Only a closed queue gives nothing after an endless wait.
    if (items.empty()) return;
    CommitGroup(std::move(items));
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
  Submit({}, [](const absl::Status&) {}).IgnoreError();
}

std::vector<Committer::Item> Committer::TakeFirst() {
  MutexLock lock(&mu_);
  std::vector<Item> taken(std::make_move_iterator(first_.begin()),
                          std::make_move_iterator(first_.end()));
  first_.clear();
  return taken;
}

void Committer::PutBack(std::vector<Item> first) {
  MutexLock lock(&mu_);
  first_.insert(first_.begin(), std::make_move_iterator(first.begin()),
                std::make_move_iterator(first.end()));
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
  return verdict_;
}

void Committer::TakeVerdict(const absl::Status& status) {
  if (IsCallersFault(status)) return;
  if (!status.ok()) ++failures_;
  MutexLock lock(&mu_);
  verdict_ = status;
}

absl::Status Committer::Commit(const std::vector<WriteBatch>& batches) {
  if (clock_ != nullptr) {
    MutexLock lock(&mu_);
    began_ns_ = clock_->Now().boottime_ns;
  }
  absl::Status status = options_.before_commit ? options_.before_commit(batches) : absl::OkStatus();
  if (status.ok()) status = store_->CommitAll(batches);
  MutexLock lock(&mu_);
  began_ns_ = 0;
  return status;
}

void Committer::CommitGroup(std::vector<Item> items) {
  std::vector<Item> first = TakeFirst();
  if (!first.empty()) {
    std::vector<WriteBatch> batches;
    for (const Item& item : first) batches.push_back(item.batch);
    const absl::Status status = Commit(batches);
    TakeVerdict(status);
    if (!status.ok() && !IsCallersFault(status)) {
      PutBack(std::move(first));
    } else if (status.ok()) {
      for (Item& item : first) std::move(item.done)(status);
    } else {
      for (size_t i = 0; i < first.size(); ++i) std::move(first[i].done)(Commit({batches[i]}));
    }
  }
  std::vector<WriteBatch> batches;
  batches.reserve(items.size());
  for (Item& item : items) batches.push_back(std::move(item.batch));

  const absl::Status together = Commit(batches);
  // That the reserve was written says nothing of the rest of the disk.
  const bool reserve_alone =
      !batches.empty() && std::all_of(batches.begin(), batches.end(),
                                      [](const WriteBatch& batch) { return batch.uses_reserve; });
  if (!reserve_alone || !together.ok()) TakeVerdict(together);
  if (!IsCallersFault(together)) {
    for (size_t i = 0; i < items.size(); ++i) {
      // Raises of levels have the reserve, which the others must not use up.
      const bool again = absl::IsResourceExhausted(together) && batches[i].uses_reserve;
      std::move(items[i].done)(again ? Commit({batches[i]}) : together);
    }
    return;
  }
  // One of them is at fault; the others must not suffer for it.
  for (size_t i = 0; i < items.size(); ++i) {
    const absl::Status alone = items.size() == 1 ? together : Commit({batches[i]});
    if (items.size() > 1) TakeVerdict(alone);
    std::move(items[i].done)(alone);
  }
}

}  // namespace rips::store

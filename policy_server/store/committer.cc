#include "policy_server/store/committer.h"

#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::store {
namespace {

// The batch is wrong, not the disk.
bool IsCallersFault(const absl::Status& status) {
  return absl::IsInvalidArgument(status) || absl::IsAlreadyExists(status);
}

}  // namespace

Committer::Committer(Store* store, CommitterLimits limits)
    : store_(store),
      limits_(limits),
      queue_({.capacity = limits.waiting_max, .on_full = OnFull::kRefuse}),
      thread_([this] { Run(); }) {}

Committer::~Committer() { Stop(); }

absl::Status Committer::Submit(WriteBatch batch, Done done) {
  if (queue_.Push({.batch = std::move(batch), .done = std::move(done)})) return absl::OkStatus();
  if (queue_.closed()) return absl::FailedPreconditionError("the committer has been stopped");
  return absl::ResourceExhaustedError(absl::StrCat(
      "more than ", limits_.waiting_max, " batches wait to be stored; the disk is too slow"));
}

void Committer::Stop() {
  if (stopped_.exchange(true)) return;
  queue_.Close();
  thread_.join();
}

void Committer::Run() {
  while (true) {
    std::vector<Item> items = queue_.PopAll(absl::InfiniteDuration(), limits_.group_max);
    // Only a closed queue gives nothing after an endless wait.
    if (items.empty()) return;
    CommitGroup(std::move(items));
  }
}

void Committer::CommitGroup(std::vector<Item> items) {
  std::vector<WriteBatch> batches;
  batches.reserve(items.size());
  for (Item& item : items) batches.push_back(std::move(item.batch));

  const absl::Status together = store_->CommitAll(batches);
  if (!IsCallersFault(together)) {
    healthy_.store(together.ok());
    for (Item& item : items) std::move(item.done)(together);
    return;
  }
  // One of them is at fault; the others must not suffer for it.
  for (size_t i = 0; i < items.size(); ++i) {
    const absl::Status alone = items.size() == 1 ? together : store_->Commit(batches[i]);
    if (!IsCallersFault(alone)) healthy_.store(alone.ok());
    std::move(items[i].done)(alone);
  }
}

}  // namespace rips::store

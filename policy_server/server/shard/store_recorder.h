// Recorder over the store and its committer.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_STORE_RECORDER_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_STORE_RECORDER_H_

#include <string>
#include <vector>

#include "policy_server/server/robot/ports.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/store.h"
#include "services/base/status_macros.h"

namespace rips::pipeline {

// Any thread. Neither is owned; both outlive this.
class StoreRecorder final : public Recorder {
 public:
  StoreRecorder(store::Store* store, store::Committer* committer)
      : store_(store), committer_(committer) {}

  // Begins a generation of the store, once, before robots use this. `id`: 16 random bytes.
  absl::Status BeginGeneration(const std::string& id) {
    RIPS_RETURN_IF_ERROR(store_->BeginGeneration(id));
    RIPS_ASSIGN_OR_RETURN(generations_, store_->Generations());
    return absl::OkStatus();
  }

  void Record(store::WriteBatch batch, std::function<void(const absl::Status&)> done) override {
    auto shared = std::make_shared<std::function<void(const absl::Status&)>>(std::move(done));
    const absl::Status taken = committer_->Submit(
        std::move(batch), [shared](const absl::Status& status) { (*shared)(status); });
    if (!taken.ok()) (*shared)(taken);
  }
  bool healthy() const override { return committer_->healthy(); }
  absl::StatusOr<std::optional<std::string>> FindDecision(const std::string& robot,
                                                          const Mark& mark) override {
    return store_->FindDecision(robot, mark);
  }
  absl::StatusOr<uint64_t> NextTerm(const std::string& robot, uint64_t above) override {
    return store_->NextTerm(robot, above);
  }
  store::StorePoint point() const override {
    if (generations_.empty()) return {};
    return {.generation = generations_.back().id, .commit = store_->newest_commit()};
  }
  bool GoesOnFrom(const store::StorePoint& seen) const override {
    return store::GoesOnFrom(generations_, store_->newest_commit(), seen);
  }

 private:
  store::Store* store_;
  store::Committer* committer_;
  std::vector<store::Generation> generations_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_STORE_RECORDER_H_

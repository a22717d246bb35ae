// Recorder over the store and its committer.
#ifndef RIPS_POLICY_SERVER_PIPELINE_STORE_RECORDER_H_
#define RIPS_POLICY_SERVER_PIPELINE_STORE_RECORDER_H_

#include <string>

#include "policy_server/pipeline/ports.h"
#include "policy_server/store/committer.h"
#include "policy_server/store/store.h"

namespace rips::pipeline {

// Any thread. Neither is owned; both outlive this.
class StoreRecorder final : public Recorder {
 public:
  StoreRecorder(store::Store* store, store::Committer* committer)
      : store_(store), committer_(committer) {}

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

 private:
  store::Store* store_;
  store::Committer* committer_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_PIPELINE_STORE_RECORDER_H_

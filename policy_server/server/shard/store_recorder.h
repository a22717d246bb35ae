// Recorder over the store and its committer.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_STORE_RECORDER_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_STORE_RECORDER_H_

#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "policy_server/server/robot/ports.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/store.h"
#include "services/base/status_macros.h"
#include "services/runtime/bounded_queue.h"

namespace rips::pipeline {

// Any thread. Neither is owned; both outlive this. What is asked of the store is asked by a thread
// of its own, in order: a disk that hangs keeps no robot waiting.
class StoreRecorder final : public Recorder {
 public:
  StoreRecorder(store::Store* store, store::Committer* committer)
      : store_(store), committer_(committer), thread_([this] { Run(); }) {}
  // What is not answered yet never will be.
  ~StoreRecorder() override {
    questions_.Close();
    thread_.join();
  }

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
  void FindDecision(const std::string& robot, const DecisionId& decision_id,
                    std::function<void(const FoundDecision&)> done) override {
    if (!questions_.Push([=, this] { done(store_->FindDecision(robot, decision_id)); }))
      done(Busy());
  }
  void NextTerm(const std::string& robot, uint64_t tenure, uint64_t above,
                std::function<void(const absl::StatusOr<uint64_t>&)> done) override {
    if (!questions_.Push([=, this] { done(store_->NextTerm(robot, tenure, above)); })) done(Busy());
  }
  store::StorePoint point() const override {
    if (generations_.empty()) return {};
    return {.generation = generations_.back().id, .commit = store_->newest_commit()};
  }
  bool GoesOnFrom(const store::StorePoint& seen) const override {
    return store::GoesOnFrom(generations_, store_->newest_commit(), seen);
  }

 private:
  // Of all robots together; each asks at most one per actuator and order.
  static constexpr size_t kQuestionsMax = 4'096;

  static absl::Status Busy() {
    return absl::UnavailableError("too many questions wait for the store; try again");
  }
  void Run() {
    while (!questions_.closed()) {
      if (const auto question = questions_.Pop(absl::Seconds(1))) (*question)();
    }
  }

  store::Store* store_;
  store::Committer* committer_;
  BoundedQueue<std::function<void()>> questions_{{.capacity = kQuestionsMax}};
  std::vector<store::Generation> generations_;
  std::thread thread_;  // last: it uses the rest
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_STORE_RECORDER_H_

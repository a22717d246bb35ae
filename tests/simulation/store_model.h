// The server's store and the thread that writes it: batches become durable in order, some time
// after they were given, or fail; a crash loses what is not durable.
#ifndef RIPS_TESTS_SIMULATION_STORE_MODEL_H_
#define RIPS_TESTS_SIMULATION_STORE_MODEL_H_

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "policy_server/server/robot/ports.h"
#include "policy_server/server/store/store.h"
#include "tests/simulation/context.h"

namespace rips::simulation {

class StoreModel final : public pipeline::Recorder {
 public:
  enum class Disk { kWorks, kFails, kFull };

  explicit StoreModel(Context* context) : context_(*context) {}

  // --- the process that uses it
  // Begins a generation, as each start of a server does.
  void Open();
  // What was given and is not durable is lost, but for a part that was just being written.
  void Crash();
  // What a server finds at its start; it owns the robot from now on.
  store::Acquired Acquire();

  // --- the disk
  void set_disk(Disk disk) { disk_ = disk; }
  // The next write takes so long.
  void Hang(int64_t ns) { hang_ns_ = ns; }

  // --- pipeline::Recorder
  void Record(store::WriteBatch batch, std::function<void(const absl::Status&)> done) override;
  bool healthy() const override { return healthy_; }
  void FindDecision(const std::string& robot, const DecisionId& decision_id,
                    std::function<void(const pipeline::FoundDecision&)> done) override;
  void NextTerm(const std::string& robot, uint64_t tenure, uint64_t above,
                std::function<void(const absl::StatusOr<uint64_t>&)> done) override;
  store::StorePoint point() const override;
  bool GoesOnFrom(const store::StorePoint& seen) const override;

 private:
  struct Waiting {
    store::WriteBatch batch;
    // Empty: it was called before its time.
    std::function<void(const absl::Status&)> done;
  };

  void ScheduleWrite();
  void Write(size_t count);
  absl::Status Apply(const store::WriteBatch& batch);
  absl::Status CheckTenure(uint64_t tenure) const;
  uint64_t DrawTerm(uint64_t above);
  // The planted fault: this batch is called durable at once.
  bool CalledEarly(const store::WriteBatch& batch) const;
  // Runs `task` unless the process has died by then.
  void Later(int64_t delay_ns, std::function<void()> task);

  Context& context_;
  uint64_t life_ = 0;  // of the process that uses it
  Disk disk_ = Disk::kWorks;
  int64_t hang_ns_ = 0;
  bool healthy_ = true;
  bool writing_ = false;
  std::deque<Waiting> waiting_;

  // Durable.
  store::RobotRecord record_;
  uint64_t tenure_ = 0;
  std::map<DecisionId, store::DecisionRecord> decisions_;
  std::vector<store::Generation> generations_;
};

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_STORE_MODEL_H_

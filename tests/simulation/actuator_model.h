// The actuator agent: the real level controller and receipt queue, a disk that may lose what was
// being written, and a robot that reaches a mode some time after it was ordered, or does not.
#ifndef RIPS_TESTS_SIMULATION_ACTUATOR_MODEL_H_
#define RIPS_TESTS_SIMULATION_ACTUATOR_MODEL_H_

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "mode_actuator/decide/level_controller.h"
#include "mode_actuator/decide/receipt_queue.h"
#include "policy_server/server/robot/links.h"
#include "tests/simulation/context.h"
#include "tests/simulation/server_model.h"

namespace rips::simulation {

class ActuatorModel {
 public:
  ActuatorModel(Context* context, ServerModel* server) : context_(*context), server_(*server) {}

  void Start();
  void Crash();
  bool up() const { return controller_.has_value(); }
  // The stream ends without a word. Its newest commands may come again much later, as from a server
  // that does not know that it was replaced. `half_open`: the server does not notice.
  void Break(bool half_open);
  void LoseState() { disk_.reset(); }
  // No stream begins before that.
  void Isolate(int64_t ns) { isolated_until_ns_ = context_.scheduler.now_ns() + ns; }
  // The robot leaves its mode by itself.
  void Drift();
  void set_disk_fails(bool fails) { disk_fails_ = fails; }
  // Tells the checker what is held; after each step.
  void Check();

 private:
  class ServerEnd;
  struct Stream;
  using Task = std::function<void()>;

  int64_t now_ns() const { return context_.scheduler.now_ns() + kClockOffsetNs; }
  Instant Clock() const { return {now_ns(), context_.scheduler.clock().Now().unix_ns}; }
  void Later(int64_t delay_ns, Task task);
  void Connect();
  void Disconnected(const std::shared_ptr<Stream>& stream);
  pipeline::ActuatorHello MakeHello();
  void Send(std::function<void(pipeline::Robot&, const pipeline::ActuatorLink*)> call);

  void OnCommand(const pipeline::Command& command);
  void OnLease(const pipeline::LeaseGrant& lease);

  void Tick();
  void Turn();
  void Publish();
  void Do(const actuator::Actions& actions);
  void RunJob(const actuator::ApplyLevel& job);
  void EndJob(const actuator::ApplyLevel& job, bool reaches);
  void EndWrite();

  static constexpr int64_t kClockOffsetNs = -300 * kNanosPerSecond;

  Context& context_;
  ServerModel& server_;
  uint64_t life_ = 0;
  std::optional<actuator::LevelController> controller_;
  actuator::ReceiptQueue receipts_;
  actuator::ExecutorReport published_;
  std::shared_ptr<Stream> stream_;
  int64_t next_heartbeat_ns_ = 0;
  int64_t isolated_until_ns_ = 0;
  uint64_t late_ = 0;     // commands that came late
  uint64_t attempt_ = 0;  // of the job that runs, surveys apart

  bool disk_fails_ = false;
  std::optional<std::string> disk_;  // the state file
  std::deque<actuator::PersistState> writes_;

  int robot_ = 0;  // the level that its modes show
};

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_ACTUATOR_MODEL_H_

// The sensor agent: the real outbox, and what the uplink does with it. What is not acknowledged is
// sent again on the next stream. Its process keeps nothing: with it goes what was not acknowledged.
#ifndef RIPS_TESTS_SIMULATION_SENSOR_MODEL_H_
#define RIPS_TESTS_SIMULATION_SENSOR_MODEL_H_

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "policy_server/server/robot/links.h"
#include "sensor_agent/outbox/outbox.h"
#include "services/ros2/ros_graph.h"
#include "tests/simulation/context.h"
#include "tests/simulation/server_model.h"

namespace rips::simulation {

class SensorModel {
 public:
  SensorModel(Context* context, ServerModel* server) : context_(*context), server_(*server) {}

  void Start();
  void Crash();
  bool up() const { return outbox_.has_value(); }
  // The stream ends without a word. `half_open`: the server does not notice.
  void Break(bool half_open);

  // --- what happens on the robot
  void SeeProbe();    // an alert of the IDS
  void SeeMessage();  // from the navigator, or from the intruder while it is there
  void SeeSignal();
  void IntruderComesOrGoes();

 private:
  class ServerEnd;
  struct Stream;
  using Task = std::function<void()>;

  int64_t now_ns() const { return context_.scheduler.now_ns() + kClockOffsetNs; }
  Instant Clock() const { return {now_ns(), context_.scheduler.clock().Now().unix_ns}; }
  void Later(int64_t delay_ns, Task task);
  void Connect();
  void Disconnected(const std::shared_ptr<Stream>& stream, const absl::Status& status);
  pipeline::SensorHello MakeHello();
  // To the server's robot, over the stream.
  void Send(std::function<void(pipeline::Robot&, const pipeline::SensorLink*)> call);

  void OnSetup(const pipeline::SensorSetup& setup);
  void OnAcknowledge(const std::string& incarnation, pipeline::Lane lane, uint64_t sequence,
                     uint64_t commit);
  void FinishResume();

  void Tick();
  void SendBatch(sensor::Lane lane);
  // The sequence that the batch travels under; its own, without a fault.
  uint64_t NumberOf(sensor::Lane lane, uint64_t first);
  void TakeSnapshot();

  static constexpr int64_t kClockOffsetNs = 7'000 * kNanosPerSecond;

  Context& context_;
  ServerModel& server_;
  uint64_t life_ = 0;
  std::string incarnation_;
  std::optional<sensor::Outbox> outbox_;
  std::shared_ptr<Stream> stream_;
  int64_t last_heartbeat_ns_ = 0;
  uint64_t acknowledged_[2] = {0, 0};  // as announced in the next hello
  // For the planted fault: what numbers were shifted by, and what a server has taken, and which.
  uint64_t shifted_[2] = {0, 0};
  uint64_t delivered_[2] = {0, 0};
  uint64_t delivered_to_ = 0;
  store::StorePoint store_;
  ros2::RosGraph graph_;
  uint64_t graph_version_ = 0;

  uint32_t observations_ = 0;  // of all processes
  bool intruder_ = false;
};

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_SENSOR_MODEL_H_

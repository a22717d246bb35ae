// The sensor agent: the real core of its uplink, whose actions are performed on simulated lines. It
// has no disk: with its process goes what was not acknowledged.
#ifndef RIPS_TESTS_SIMULATION_SENSOR_MODEL_H_
#define RIPS_TESTS_SIMULATION_SENSOR_MODEL_H_

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "policy_server/server/robot/links.h"
#include "sensor_agent/outbox/uplink_core.h"
#include "services/ros2/ros_graph.h"
#include "tests/simulation/context.h"
#include "tests/simulation/server_model.h"

namespace rips::simulation {

class SensorModel {
 public:
  SensorModel(Context* context, ServerModel* server) : context_(*context), server_(*server) {}

  void Start();
  void Crash();
  bool up() const { return core_.has_value(); }
  // The stream ends without a word. `half_open`: the server does not notice.
  void Break(bool half_open);

  // --- what happens on the robot
  void SeeProbe();    // an alert of the IDS
  void SeeMessage();  // from the navigator, or from the intruder while it is there
  void SeeSignal();
  void IntruderComesOrGoes();

 private:
  class ServerEnd;
  struct Performer;
  struct Stream;
  using Task = std::function<void()>;

  int64_t now_ns() const { return context_.scheduler.now_ns() + kClockOffsetNs; }
  Instant Clock() const { return {now_ns(), context_.scheduler.clock().Now().unix_ns}; }
  void Later(int64_t delay_ns, Task task);
  void Connect();
  void Disconnected(const std::shared_ptr<Stream>& stream, const absl::Status& status);
  // To the server's robot, over the stream.
  void Send(std::function<void(pipeline::Robot&, const pipeline::SensorLink*)> call);
  void SendBatch(pipeline::Batch batch);

  void OnSetup(const pipeline::SensorSetup& setup);
  void OnAcknowledge(const std::string& incarnation, pipeline::Lane lane, uint64_t sequence,
                     uint64_t commit);

  // Hands the input to the core, and does what it wants.
  void On(sensor::UplinkInput input);
  void Tick();
  // The sequence that a live batch travels under; its own, without a fault.
  uint64_t NumberOf(sensor::Lane lane, uint64_t first);
  sensor::GraphChange WholeGraph() const;
  std::string NewIncarnation();

  static constexpr int64_t kClockOffsetNs = 7'000 * kNanosPerSecond;

  Context& context_;
  ServerModel& server_;
  uint64_t life_ = 0;
  int incarnations_ = 0;  // of all processes
  std::optional<sensor::UplinkCore> core_;
  int64_t wake_ns_ = 0;  // when its next turn is due
  std::shared_ptr<Stream> stream_;
  // What the core's backlog holds, by the bytes that stand for it.
  std::map<std::string, std::vector<pipeline::Observation>> aside_;
  int encoded_ = 0;
  sensor::BacklogBatch opened_;
  // For the planted fault: what numbers were shifted by, and what a server has taken, and which.
  uint64_t shifted_[2] = {0, 0};
  uint64_t delivered_[2] = {0, 0};
  uint64_t delivered_to_ = 0;
  store::StorePoint store_point_;
  ros2::RosGraph graph_;
  uint64_t graph_version_ = 0;

  uint32_t observations_ = 0;  // of all processes
  bool intruder_ = false;
};

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_SENSOR_MODEL_H_

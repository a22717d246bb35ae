// A robot as the policy server sees it: a sensor's and an actuator's stream, each with its own
// certificate and connection, which come back by themselves. What was not acknowledged is sent
// again, as an agent does; no DDS, no disk, no rules.
#ifndef RIPS_TESTS_BENCH_FLEET_ROBOT_H_
#define RIPS_TESTS_BENCH_FLEET_ROBOT_H_

#include <array>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "grpcpp/channel.h"
#include "grpcpp/generic/generic_stub.h"
#include "grpcpp/support/byte_buffer.h"
#include "grpcpp/support/slice.h"
#include "rips/v1/actuator.grpc.pb.h"
#include "rips/v1/sensor.grpc.pb.h"
#include "services/model/heartbeat.h"
#include "services/runtime/mutex.h"

namespace rips::bench {

// How long things took, in steps of 4 %. Any thread.
class Latencies {
 public:
  void Add(int64_t ns) ABSL_LOCKS_EXCLUDED(mu_);
  // Milliseconds; 0 if there are none.
  double Percentile(double percent) const ABSL_LOCKS_EXCLUDED(mu_);
  uint64_t count() const ABSL_LOCKS_EXCLUDED(mu_);
  void Clear() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  mutable Mutex mu_;
  std::array<uint64_t, 600> steps_ ABSL_GUARDED_BY(mu_) = {};
  uint64_t count_ ABSL_GUARDED_BY(mu_) = 0;
};

struct FleetLatencies {
  // From sending a batch first until it is durable.
  Latencies acknowledged;
  // From sending a message on /probe until the actuator has the command that a rule gives.
  Latencies command;
};

struct RobotPlan {
  std::string id;
  // Messages a second.
  double rate = 0;
  int nodes = 20;
  // Sends as much as the server lets it, and a new graph of that many nodes every second.
  bool hostile = false;
  // Makes a rule raise its level once.
  bool raises = false;
  // Sends a message on /probe every second.
  bool probes = false;
};

struct RobotCounts {
  uint64_t sent = 0;
  uint64_t acknowledged = 0;
  uint64_t waiting = 0;
  uint64_t connects = 0;
  // Commands or leases with a level below the one held.
  uint64_t lowered = 0;
  bool connected = false;
  std::string level;
  // Of the last stream that ended.
  std::string error;
};

// Sends bytes: a batch is made and copied for the server, not for the load.
using SensorStub = grpc::TemplatedGenericStub<grpc::ByteBuffer, v1::SensorReply>;

// Call Step from one thread; the rest happens on those of gRPC.
class FleetRobot {
 public:
  // Of one stream; ends itself.
  class SensorStream;
  class ActuatorStream;

  FleetRobot(RobotPlan plan, std::shared_ptr<grpc::Channel> sensor,
             std::shared_ptr<grpc::Channel> actuator, FleetLatencies* latencies);
  ~FleetRobot();

  // Connects what is not, and sends what is due. Call it every kStepNs, later the more at once.
  // Messages wait as long as the server lets a sensor collect them, but those on /probe and /raise
  // go at once; heartbeats go as often as the server says.
  void Step(int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  // No further messages are made.
  void Quiet() ABSL_LOCKS_EXCLUDED(mu_);
  void End() ABSL_LOCKS_EXCLUDED(mu_);
  RobotCounts counts() const ABSL_LOCKS_EXCLUDED(mu_);

  static constexpr int64_t kStepNs = 100'000'000;

 private:
  // A batch as it goes over the wire.
  struct Sent {
    std::vector<grpc::Slice> bytes;
    int64_t at_ns = 0;
    uint64_t first = 0;
    uint64_t last = 0;
  };

  void OnReply(const v1::SensorReply& reply) ABSL_LOCKS_EXCLUDED(mu_);
  void OnReply(const v1::ActuatorReply& reply) ABSL_LOCKS_EXCLUDED(mu_);
  void OnSensorGone(const grpc::Status& status) ABSL_LOCKS_EXCLUDED(mu_);
  void OnActuatorGone(const grpc::Status& status) ABSL_LOCKS_EXCLUDED(mu_);

  void ConnectSensor(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ConnectActuator(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void TakeAck(const v1::Ack& ack) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void TakeCommand(const v1::Command& command) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void HoldLevel(const std::string& level, const v1::DecisionId& decision)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void MakeMessages(int count, int topic, int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void MakeGraph(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // As far as the credit goes.
  void SendWaiting() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Heartbeats(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const RobotPlan plan_;
  SensorStub sensor_stub_;
  const std::unique_ptr<v1::ActuatorService::Stub> actuator_stub_;
  FleetLatencies& latencies_;
  const std::string incarnation_;

  mutable Mutex mu_;
  CondVar gone_;
  SensorStream* sensor_ ABSL_GUARDED_BY(mu_) = nullptr;
  ActuatorStream* actuator_ ABSL_GUARDED_BY(mu_) = nullptr;
  bool ended_ ABSL_GUARDED_BY(mu_) = false;
  bool quiet_ ABSL_GUARDED_BY(mu_) = false;
  RobotCounts counts_ ABSL_GUARDED_BY(mu_);
  int64_t sensor_due_ns_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t actuator_due_ns_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t batch_due_ns_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t linger_ns_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t sensor_heartbeat_ns_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t sensor_interval_ns_ ABSL_GUARDED_BY(mu_) = model::kHeartbeatNs;
  int64_t actuator_heartbeat_ns_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t actuator_interval_ns_ ABSL_GUARDED_BY(mu_) = model::kHeartbeatNs;
  int64_t second_due_ns_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t stepped_ns_ ABSL_GUARDED_BY(mu_) = 0;
  double owed_ ABSL_GUARDED_BY(mu_) = 0;
  bool raised_ ABSL_GUARDED_BY(mu_) = false;
  // 0 = none is under way.
  int64_t probe_at_ns_ ABSL_GUARDED_BY(mu_) = 0;

  // Of the sensor's stream.
  bool configured_ ABSL_GUARDED_BY(mu_) = false;
  bool want_snapshot_ ABSL_GUARDED_BY(mu_) = false;
  int acks_due_ ABSL_GUARDED_BY(mu_) = 0;
  bool named_ ABSL_GUARDED_BY(mu_) = false;
  uint64_t credit_bytes_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t used_bytes_ ABSL_GUARDED_BY(mu_) = 0;
  size_t sent_batches_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t server_boottime_ns_ ABSL_GUARDED_BY(mu_) = 0;

  // Not acknowledged.
  std::deque<Sent> messages_ ABSL_GUARDED_BY(mu_);
  std::deque<Sent> control_ ABSL_GUARDED_BY(mu_);
  size_t sent_control_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t next_message_ ABSL_GUARDED_BY(mu_) = 1;
  uint64_t next_control_ ABSL_GUARDED_BY(mu_) = 1;
  uint64_t graph_version_ ABSL_GUARDED_BY(mu_) = 0;

  // Of the actuator.
  std::string level_ ABSL_GUARDED_BY(mu_) = "DEFAULT";
  v1::DecisionId decision_ ABSL_GUARDED_BY(mu_);
  uint64_t term_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t lease_boottime_ns_ ABSL_GUARDED_BY(mu_) = 0;
};

}  // namespace rips::bench

#endif  // RIPS_TESTS_BENCH_FLEET_ROBOT_H_

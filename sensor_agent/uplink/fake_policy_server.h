// A SensorService that records what a sensor sends and behaves as it is told. Test code only.
#ifndef RIPS_SENSOR_AGENT_UPLINK_FAKE_POLICY_SERVER_H_
#define RIPS_SENSOR_AGENT_UPLINK_FAKE_POLICY_SERVER_H_

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "grpcpp/security/server_credentials.h"
#include "grpcpp/server.h"
#include "rips/v1/sensor.grpc.pb.h"
#include "services/ros2/ros_graph.h"
#include "services/runtime/mutex.h"

namespace rips::sensor {

// One observation, with the names of its stream resolved.
struct Recorded {
  std::string incarnation;
  rips::v1::Lane lane = rips::v1::LANE_UNSPECIFIED;
  uint64_t sequence = 0;
  rips::v1::Observation what;
  // Of a message or loss.
  std::string topic;
  std::string type;
  rips::v1::Endpoint writer;
};

// Any thread.
class FakePolicyServer final : public rips::v1::SensorService::Service {
 public:
  struct Behaviour {
    bool acknowledge = true;
    uint64_t credit = 1 << 20;
    uint64_t payload_credit = 8 << 20;
    // Grant anew what was used of both.
    bool renew_credit = false;
    // End the stream after so many chunks more; 0 = never.
    int chunks_until_close = 0;
    bool primary = true;
    // Of several sensors only that of this host is; empty = all are.
    std::string primary_host;
    std::vector<std::string> own_participants;
    std::vector<std::string> protected_parts;
    // Say so while no snapshot of the incarnation was seen.
    bool ask_for_snapshot = true;
    // Forget the graph and the sequences of the incarnation at the next stream.
    bool forget = false;
    // Answer the next hello with acknowledgements of nothing.
    bool acknowledge_zero_once = false;
    // End the stream after so many batches more; 0 = never.
    int batches_until_close = 0;
    grpc::Status close_with = grpc::Status(grpc::StatusCode::UNAVAILABLE, "told to");
    // Send nothing after the hello.
    bool silent = false;
    // What its store holds; empty = it does not say.
    std::string generation;
    uint64_t commit = 0;
  };

  FakePolicyServer() = default;
  ~FakePolicyServer() override { Stop(); }

  // On a free port of loopback; on the same one after a Stop.
  void Start(
      std::shared_ptr<grpc::ServerCredentials> credentials = grpc::InsecureServerCredentials());
  // Ends all streams.
  void Stop();
  std::string address() const;

  void Set(const std::function<void(Behaviour&)>& change) ABSL_LOCKS_EXCLUDED(mu_);
  // Only while a stream is up.
  void Send(const rips::v1::SensorReply& reply) ABSL_LOCKS_EXCLUDED(mu_);

  // Polls until `done` (called with the lock held) or 20 s; false if it never was.
  bool WaitUntil(const std::function<bool(const FakePolicyServer&)>& done) const
      ABSL_LOCKS_EXCLUDED(mu_);

  // The following are for use within WaitUntil, or when nothing is running.
  // In order of arrival, repetitions included.
  std::vector<Recorded> received;
  std::vector<rips::v1::SensorHello> hellos;
  std::vector<rips::v1::ObservationBatch> batches;
  // Of all streams. What is in `batches` and `received` has the payloads in their place.
  int chunks = 0;
  uint64_t chunk_bytes = 0;
  // Kinds of messages in order of arrival: 'c'hunk, 'm'essages, 'l' for control, per stream.
  std::string order;
  std::vector<rips::v1::InterestApplied> interests_applied;
  int heartbeats = 0;
  // What contradicts the contract.
  std::vector<std::string> violations;
  // As snapshots and deltas add up.
  ros2::RosGraph graph;
  uint64_t graph_version = 0;
  bool settled = false;

  // Distinct sequences received of a lane, over all incarnations.
  std::vector<Recorded> Distinct(rips::v1::Lane lane) const;

 private:
  using Stream = grpc::ServerReaderWriter<rips::v1::SensorReply, rips::v1::SensorMessage>;
  using LaneKey = std::pair<std::string, rips::v1::Lane>;
  // Of one stream.
  struct Names {
    std::map<uint32_t, rips::v1::Intern> by_id;
    uint64_t last_payload = 0;
    uint64_t message_bytes = 0;
    uint64_t payload_bytes = 0;
    // Since the last batch of the message lane.
    std::map<uint64_t, std::string> payloads;
  };

  grpc::Status Observe(grpc::ServerContext* context, Stream* stream) override;
  void AnswerHello(const rips::v1::SensorHello& hello, Stream* stream) ABSL_LOCKS_EXCLUDED(mu_);
  void TakeChunk(const rips::v1::PayloadChunk& chunk, Names& names)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Puts payloads that came in chunks into the batch.
  void Assemble(rips::v1::ObservationBatch& batch, Names& names) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void TakeBatch(const rips::v1::ObservationBatch& batch, Names& names)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void TakeGraph(const std::string& incarnation, const rips::v1::Observation& observation)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  rips::v1::SensorReply AckLocked(const LaneKey& key) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  mutable Mutex mu_;
  Behaviour behaviour_ ABSL_GUARDED_BY(mu_);
  Stream* stream_ ABSL_GUARDED_BY(mu_) = nullptr;
  // Highest judged sequence.
  std::map<LaneKey, uint64_t> judged_ ABSL_GUARDED_BY(mu_);
  std::string graph_incarnation_ ABSL_GUARDED_BY(mu_);
  std::map<std::tuple<std::string, rips::v1::Lane, uint64_t>, std::string> contents_
      ABSL_GUARDED_BY(mu_);
  std::set<grpc::ServerContext*> contexts_ ABSL_GUARDED_BY(mu_);
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::unique_ptr<grpc::Server> server_;
  int port_ = 0;
  // In the newest stream.
  uint64_t payload_granted_ ABSL_GUARDED_BY(mu_) = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_FAKE_POLICY_SERVER_H_

// Many sensors on one policy server, as it sees them: a stream each with its own certificate, a
// graph and heartbeats, for the benchmark of a session's memory.
//   session_load --server HOST:PORT --pki DIR --robots N --nodes N
// DIR/sensor/rK/base holds the certificate of robot `rK`. Prints {"event":"ready"} when every
// server has acknowledged every graph, and stays until SIGTERM.
#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "grpcpp/create_channel.h"
#include "nlohmann/json.hpp"
#include "rips/v1/sensor.grpc.pb.h"
#include "services/base/status_macros.h"
#include "services/rpc/credentials.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/shutdown.h"
#include "tests/support/robot_sim/events.h"

namespace rips::bench {
namespace {

constexpr absl::Duration kHeartbeat = absl::Milliseconds(500);

v1::Clock ClockNow() {
  const Instant now = RealClock().Now();
  v1::Clock clock;
  clock.set_boottime_ns(static_cast<uint64_t>(now.boottime_ns));
  clock.set_unix_ns(now.unix_ns);
  return clock;
}

// 16 bytes: participant `robot`, entity `entity`.
std::string GuidBytes(int robot, int entity, char kind) {
  std::string guid(16, '\0');
  guid[0] = 0x01;
  guid[1] = 0x10;
  guid[2] = static_cast<char>(robot >> 8);
  guid[3] = static_cast<char>(robot);
  guid[13] = static_cast<char>(entity >> 8);
  guid[14] = static_cast<char>(entity);
  guid[15] = kind;
  return guid;
}

v1::GraphSnapshot MakeGraph(int robot, int nodes) {
  v1::GraphSnapshot graph;
  graph.set_graph_version(1);
  graph.set_settled(true);
  const std::string participant = GuidBytes(robot, 1, '\xc1');
  graph.add_participants()->set_guid(participant);
  for (int i = 0; i < nodes; ++i) {
    v1::Node* node = graph.add_nodes();
    node->set_full_name(absl::StrCat("/robot/node_", i));
    node->set_participant_guid(participant);
    v1::Endpoint* endpoint = graph.add_endpoints();
    endpoint->set_guid(GuidBytes(robot, i + 2, '\x03'));
    endpoint->set_kind(v1::Endpoint::PUBLISHER);
    endpoint->set_name(absl::StrCat("/robot/topic_", i));
    endpoint->set_type("std_msgs/msg/String");
    endpoint->set_node(node->full_name());
    endpoint->set_ros(true);
    endpoint->set_visibility(v1::WATCHED);
  }
  return graph;
}

class Session {
 public:
  Session(int robot, const std::shared_ptr<grpc::Channel>& channel)
      : incarnation_(absl::StrCat("incarnation-", 1000 + robot)),
        stub_(v1::SensorService::NewStub(channel)),
        stream_(stub_->Observe(&context_)) {}

  // Hello and graph, until both are acknowledged.
  absl::Status Begin(int robot, int nodes) {
    v1::SensorMessage message;
    v1::Hello* hello = message.mutable_hello()->mutable_hello();
    hello->set_protocol(1);
    hello->set_incarnation(incarnation_);
    hello->set_host("base");
    *hello->mutable_clock() = ClockNow();
    stream_->Write(message);
    v1::SensorMessage graph;
    v1::ObservationBatch* batch = graph.mutable_batch();
    batch->set_incarnation(incarnation_);
    batch->set_first_sequence(1);
    batch->set_lane(v1::CONTROL);
    batch->set_base_boottime_ns(ClockNow().boottime_ns());
    *batch->add_observations()->mutable_snapshot() = MakeGraph(robot, nodes);
    stream_->Write(graph);
    v1::SensorReply reply;
    while (stream_->Read(&reply)) {
      if (reply.ack().lane() == v1::CONTROL && reply.ack().durable_sequence() == 1) {
        return absl::OkStatus();
      }
    }
    const grpc::Status status = stream_->Finish();
    return absl::UnavailableError(status.error_message());
  }
  void Heartbeat() {
    v1::SensorMessage message;
    *message.mutable_heartbeat()->mutable_clock() = ClockNow();
    stream_->Write(message);
  }
  void End() { context_.TryCancel(); }

 private:
  const std::string incarnation_;
  grpc::ClientContext context_;
  std::unique_ptr<v1::SensorService::Stub> stub_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::SensorMessage, v1::SensorReply>> stream_;
};

struct Options {
  std::string server;
  std::string pki;
  int robots = 1;
  int nodes = 20;
};

absl::Status Run(const Options& options, SignalWaiter& signals) {
  std::vector<std::shared_ptr<const rpc::Credentials>> credentials;
  std::vector<std::unique_ptr<Session>> sessions;
  for (int robot = 1; robot <= options.robots; ++robot) {
    const std::string dir = absl::StrCat(options.pki, "/sensor/r", robot, "/base/");
    RIPS_ASSIGN_OR_RETURN(auto own, rpc::Credentials::Load({.ca = absl::StrCat(dir, "ca.pem"),
                                                            .cert = absl::StrCat(dir, "cert.pem"),
                                                            .key = absl::StrCat(dir, "key.pem")}));
    sessions.push_back(
        std::make_unique<Session>(robot, grpc::CreateChannel(options.server, own->ForClient())));
    credentials.push_back(std::move(own));
    RIPS_RETURN_IF_ERROR(sessions.back()->Begin(robot, options.nodes));
  }
  std::atomic<bool> stopping = false;
  std::thread heartbeats([&] {
    for (; !stopping; absl::SleepFor(kHeartbeat)) {
      for (const auto& session : sessions) session->Heartbeat();
    }
  });
  robot_sim::PrintEvent({{"event", "ready"}});
  signals.WaitForShutdown();
  stopping = true;
  heartbeats.join();
  for (const auto& session : sessions) session->End();
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("Many sensors on one policy server.");
  app.add_option("--server", options.server, "HOST:PORT")->required();
  app.add_option("--pki", options.pki, "directory of deploy/pki/mint")->required();
  app.add_option("--robots", options.robots)->check(CLI::Range(1, 2'000));
  app.add_option("--nodes", options.nodes, "of each robot's graph")->check(CLI::Range(1, 2'000));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  rpc::RequireTls13();
  BlockSignals();
  SignalWaiter signals({});
  const absl::Status status = Run(options, signals);
  if (status.ok()) return 0;
  LogError("failed", {{"error", status.message()}});
  return 1;
}

}  // namespace
}  // namespace rips::bench

int main(int argc, char** argv) { return rips::bench::Main(argc, argv); }

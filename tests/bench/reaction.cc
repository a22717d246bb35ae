// How long from an offending DDS message to the command at an actuator: one process that is both,
// so that there is one clock. Around it run the real sensor and the real policy server, whose rules
// run program `note` for each message on /probe.
//   reaction --domain D --server HOST:PORT --actuator DIR --floor-server DIR --count N
// DIR: certificates. Between the messages it measures the two floors, bare: a DDS message one way
// between two participants, and a round trip on a gRPC stream with mTLS.
// Then what waiting for the graph costs (--rounds): `first` is the first message of a new writer of
// a new node on /probe, sent 10 ms after that was made; `behind` a message of the known writer
// sent right after one from each of 16 new writers on /other.
// Prints {"event":"done", "command":{"p50_us":..,"p99_us":..}, "dds":{..}, "grpc":{..},
// "first":{..}, "behind":{..}, "unseen":N}, the last of them messages that DDS gave to no reader.
#include <algorithm>
#include <atomic>
#include <cstring>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "grpcpp/create_channel.h"
#include "nlohmann/json.hpp"
#include "rips/v1/actuator.grpc.pb.h"
#include "services/base/status_macros.h"
#include "services/dds/raw_writer.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/runtime/log.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/shutdown.h"
#include "tests/support/robot_sim/events.h"
#include "tests/support/robot_sim/ros_process.h"

namespace rips::bench {
namespace {

using robot_sim::PrintEvent;
using robot_sim::RosNode;
using robot_sim::RosProcess;

constexpr absl::Duration kPatience = absl::Seconds(30);
constexpr absl::Duration kHeartbeat = absl::Milliseconds(500);
// The line is idle before each message.
constexpr absl::Duration kPause = absl::Milliseconds(15);
constexpr int kBurst = 16;
constexpr absl::Duration kReaderKnows = absl::Milliseconds(10);
constexpr absl::Duration kSeen = absl::Seconds(3);
constexpr char kType[] = "std_msgs/msg/UInt8MultiArray";
constexpr char kPayload[] = {0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0};

struct Options {
  dds::DomainOptions domain = {.id = 0, .interface = "lo"};
  std::string server;
  std::string actuator;
  std::string floor_server;
  int count = 1'000;
  int rounds = 50;
};

int64_t NowNs() { return RealClock().Now().boottime_ns; }

absl::StatusOr<std::shared_ptr<const rpc::Credentials>> LoadCredentials(const std::string& dir) {
  return rpc::Credentials::Load({.ca = absl::StrCat(dir, "/ca.pem"),
                                 .cert = absl::StrCat(dir, "/cert.pem"),
                                 .key = absl::StrCat(dir, "/key.pem")});
}

// Set by one thread, awaited by another.
class Arrival {
 public:
  void Set() ABSL_LOCKS_EXCLUDED(mu_) {
    const int64_t now_ns = NowNs();
    MutexLock lock(&mu_);
    at_ns_ = now_ns;
    changed_.NotifyAll();
  }
  // What `act` takes until Set, nanoseconds.
  absl::StatusOr<int64_t> After(const std::function<absl::Status()>& act,
                                absl::Duration patience = kPatience) ABSL_LOCKS_EXCLUDED(mu_) {
    {
      MutexLock lock(&mu_);
      at_ns_ = 0;
    }
    const int64_t begin_ns = NowNs();
    RIPS_RETURN_IF_ERROR(act());
    MutexLock lock(&mu_);
    for (int i = 0; i < absl::ToInt64Seconds(patience) && at_ns_ == 0; ++i) {
      changed_.WaitFor(lock, absl::Seconds(1));
    }
    if (at_ns_ == 0) return absl::DeadlineExceededError("nothing arrived");
    return at_ns_ - begin_ns;
  }

 private:
  Mutex mu_;
  CondVar changed_;
  int64_t at_ns_ ABSL_GUARDED_BY(mu_) = 0;
};

// Answers each message.
class EchoService final : public v1::ActuatorService::Service {
 public:
  grpc::Status Attach(
      grpc::ServerContext*,
      grpc::ServerReaderWriter<v1::ActuatorReply, v1::ActuatorMessage>* stream) override {
    for (v1::ActuatorMessage message; stream->Read(&message);) {
      v1::ActuatorReply reply;
      reply.mutable_command()->set_id(std::string(16, 'e'));
      if (!stream->Write(reply)) break;
    }
    return grpc::Status::OK;
  }
};

// A stream to an ActuatorService; `on_reply` is called on its thread.
class Stream {
 public:
  Stream(const std::string& address, const rpc::Credentials& credentials,
         std::function<void(const v1::ActuatorReply&)> on_reply)
      : stub_(v1::ActuatorService::NewStub(grpc::CreateChannel(address, credentials.ForClient()))),
        stream_(stub_->Attach(&context_)),
        reader_([this, on_reply = std::move(on_reply)] {
          for (v1::ActuatorReply reply; stream_->Read(&reply);) on_reply(reply);
        }) {}
  ~Stream() {
    context_.TryCancel();
    reader_.join();
  }
  void Write(const v1::ActuatorMessage& message) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    stream_->Write(message);
  }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<v1::ActuatorService::Stub> stub_;
  Mutex mu_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::ActuatorMessage, v1::ActuatorReply>> stream_;
  std::thread reader_;
};

v1::Clock ClockNow() {
  v1::Clock clock;
  clock.set_boottime_ns(static_cast<uint64_t>(NowNs()));
  clock.set_unix_ns(RealClock().Now().unix_ns);
  return clock;
}

// As rips-actuator speaks, and does all it is told at once.
class Actuator {
 public:
  Actuator(const std::string& address, const rpc::Credentials& credentials, Arrival* commanded)
      : commanded_(commanded),
        stream_(address, credentials, [this](const v1::ActuatorReply& reply) { OnReply(reply); }) {
    v1::ActuatorMessage message;
    v1::ActuatorHello* hello = message.mutable_hello();
    hello->mutable_hello()->set_protocol(1);
    hello->mutable_hello()->set_incarnation(std::string(16, 'b'));
    hello->mutable_hello()->set_host("base");
    *hello->mutable_hello()->mutable_clock() = ClockNow();
    for (const char* level : {"DEFAULT", "ALERT", "COMPROMISED", "HALT"}) hello->add_levels(level);
    hello->set_fail_safe_level("keep");
    hello->add_programs("note");
    hello->set_effective_level("DEFAULT");
    stream_.Write(message);
    heartbeats_ = std::thread([this] {
      for (; !stopping_; absl::SleepFor(kHeartbeat)) Heartbeat();
    });
  }
  ~Actuator() {
    stopping_ = true;
    heartbeats_.join();
  }

 private:
  void Heartbeat() {
    v1::ActuatorMessage message;
    v1::ActuatorHeartbeat* heartbeat = message.mutable_heartbeat();
    *heartbeat->mutable_heartbeat()->mutable_clock() = ClockNow();
    heartbeat->set_effective_level("DEFAULT");
    heartbeat->set_verified(true);
    stream_.Write(message);
  }
  void OnReply(const v1::ActuatorReply& reply) {
    if (!reply.has_command()) return;
    if (reply.command().has_run_program()) commanded_->Set();
    v1::ActuatorMessage message;
    v1::Receipt* receipt = message.mutable_receipt();
    receipt->set_command_id(reply.command().id());
    if (reply.command().has_set_level()) {
      *receipt->mutable_decision_id() = reply.command().set_level().decision_id();
      receipt->set_effective_level(reply.command().set_level().to());
    }
    for (const auto stage : {v1::Receipt::ACKNOWLEDGED, v1::Receipt::VERIFIED}) {
      receipt->set_stage(stage);
      stream_.Write(message);
    }
  }

  Arrival* const commanded_;  // Not owned; outlives this.
  std::atomic<bool> stopping_ = false;
  std::thread heartbeats_;
  Stream stream_;
};

class Latencies {
 public:
  void Add(int64_t ns) { us_.push_back(static_cast<double>(ns) * 1e-3); }
  nlohmann::json Json() {
    if (us_.empty()) return {{"p50_us", 0}, {"p99_us", 0}};
    std::sort(us_.begin(), us_.end());
    return {{"p50_us", us_[us_.size() / 2]}, {"p99_us", us_[us_.size() * 99 / 100]}};
  }

 private:
  std::vector<double> us_;
};

absl::Status WaitForReader(const dds::RawWriter& writer, const std::string& topic) {
  const int64_t end_ns = NowNs() + absl::ToInt64Nanoseconds(kPatience);
  while (writer.MatchedReaders() == 0) {
    if (NowNs() > end_ns) return absl::DeadlineExceededError(absl::StrCat("nobody reads ", topic));
    absl::SleepFor(absl::Milliseconds(10));
  }
  return absl::OkStatus();
}

// A new node with `count` writers on `topic`. The sensor's DDS reader knows them as a rule (what a
// volatile writer sends earlier is lost to it); its graph, which waits for 20 ms of quiet, does
// not.
absl::StatusOr<std::vector<dds::RawWriter*>> NewWriters(RosProcess& process,
                                                        const std::string& node,
                                                        const std::string& topic, int count) {
  RIPS_ASSIGN_OR_RETURN(RosNode * fresh, process.AddNode(node));
  std::vector<dds::RawWriter*> writers;
  for (int i = 0; i < count; ++i) {
    RIPS_ASSIGN_OR_RETURN(dds::RawWriter * writer,
                          fresh->Publish(topic, kType, robot_sim::DefaultQos(10)));
    writers.push_back(writer);
  }
  RIPS_RETURN_IF_ERROR(process.Announce());
  for (dds::RawWriter* writer : writers) RIPS_RETURN_IF_ERROR(WaitForReader(*writer, topic));
  absl::SleepFor(kReaderKnows);
  return writers;
}

struct GraphWaits {
  Latencies first, behind;
  int unseen = 0;
};

absl::StatusOr<GraphWaits> MeasureGraphWaits(RosProcess& process, dds::RawWriter& known,
                                             Arrival& commanded, int rounds) {
  const std::string payload(kPayload, sizeof(kPayload));
  GraphWaits waits;
  for (int i = 0; i < rounds; ++i) {
    RIPS_ASSIGN_OR_RETURN(const auto one,
                          NewWriters(process, absl::StrCat("/first_", i), "/probe", 1));
    const auto first_ns = commanded.After([&] { return one[0]->Write(payload); }, kSeen);
    if (first_ns.ok()) waits.first.Add(*first_ns);
    if (!first_ns.ok()) ++waits.unseen;
    RIPS_ASSIGN_OR_RETURN(const auto burst,
                          NewWriters(process, absl::StrCat("/burst_", i), "/other", kBurst));
    for (dds::RawWriter* writer : burst) RIPS_RETURN_IF_ERROR(writer->Write(payload));
    RIPS_ASSIGN_OR_RETURN(const int64_t behind_ns,
                          commanded.After([&] { return known.Write(payload); }));
    waits.behind.Add(behind_ns);
    absl::SleepFor(absl::Milliseconds(300));
  }
  return waits;
}

absl::Status Run(const Options& options) {
  RIPS_ASSIGN_OR_RETURN(const auto own, LoadCredentials(options.actuator));
  RIPS_ASSIGN_OR_RETURN(const auto server, LoadCredentials(options.floor_server));
  EchoService echo;
  RIPS_ASSIGN_OR_RETURN(
      const auto floor,
      rpc::RpcServer::Start({.listen = "127.0.0.1:0", .credentials = server->ForServer()},
                            {&echo}));
  RIPS_ASSIGN_OR_RETURN(const auto domain, dds::Domain::Create(options.domain));
  RIPS_ASSIGN_OR_RETURN(const auto process, RosProcess::Create(domain, ros2::GidBytes::k24));
  RIPS_ASSIGN_OR_RETURN(const auto other, RosProcess::Create(domain, ros2::GidBytes::k24));
  RIPS_ASSIGN_OR_RETURN(RosNode * node, process->AddNode("/probe_node"));
  const ros2::Qos qos = robot_sim::DefaultQos(10);
  RIPS_ASSIGN_OR_RETURN(dds::RawWriter * probe, node->Publish("/probe", kType, qos));
  RIPS_ASSIGN_OR_RETURN(dds::RawWriter * one_way, node->Publish("/floor", kType, qos));
  RIPS_ASSIGN_OR_RETURN(RosNode * reader, other->AddNode("/floor_node"));
  Arrival commanded, arrived, answered;
  RIPS_RETURN_IF_ERROR(
      reader->Subscribe("/floor", kType, qos, [&](const dds::RawSample&) { arrived.Set(); }));
  RIPS_RETURN_IF_ERROR(process->Announce());
  RIPS_RETURN_IF_ERROR(other->Announce());
  Stream round_trip(absl::StrCat("127.0.0.1:", floor->port()), *own,
                    [&](const v1::ActuatorReply&) { answered.Set(); });
  Actuator actuator(options.server, *own, &commanded);
  RIPS_RETURN_IF_ERROR(WaitForReader(*probe, "/probe"));
  RIPS_RETURN_IF_ERROR(WaitForReader(*one_way, "/floor"));
  // Attribution is over, and the first programs are no longer the first.
  absl::SleepFor(absl::Seconds(2));

  const std::string payload(kPayload, sizeof(kPayload));
  v1::ActuatorMessage ping;
  ping.mutable_receipt()->set_command_id(std::string(16, 'p'));
  Latencies command, dds, grpc;
  for (int i = 0; i < options.count; ++i) {
    absl::SleepFor(kPause);
    RIPS_ASSIGN_OR_RETURN(const int64_t dds_ns,
                          arrived.After([&] { return one_way->Write(payload); }));
    absl::SleepFor(kPause);
    RIPS_ASSIGN_OR_RETURN(const int64_t grpc_ns, answered.After([&] {
      round_trip.Write(ping);
      return absl::OkStatus();
    }));
    absl::SleepFor(kPause);
    RIPS_ASSIGN_OR_RETURN(const int64_t command_ns,
                          commanded.After([&] { return probe->Write(payload); }));
    dds.Add(dds_ns);
    grpc.Add(grpc_ns);
    command.Add(command_ns);
  }
  RIPS_ASSIGN_OR_RETURN(GraphWaits waits,
                        MeasureGraphWaits(*process, *probe, commanded, options.rounds));
  PrintEvent({{"event", "done"},
              {"command", command.Json()},
              {"dds", dds.Json()},
              {"grpc", grpc.Json()},
              {"first", waits.first.Json()},
              {"behind", waits.behind.Json()},
              {"unseen", waits.unseen}});
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("From an offending message to the command at an actuator.");
  app.add_option("--domain", options.domain.id)->required()->check(CLI::Range(0, 232));
  app.add_option("--server", options.server, "HOST:PORT")->required();
  app.add_option("--actuator", options.actuator, "its certificate's directory")->required();
  app.add_option("--floor-server", options.floor_server, "a server's certificate's directory")
      ->required();
  app.add_option("--count", options.count)->check(CLI::Range(1, 1'000'000));
  app.add_option("--rounds", options.rounds)->check(CLI::Range(1, 200));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  rpc::RequireTls13();
  const absl::Status status = Run(options);
  if (status.ok()) return 0;
  LogError("failed", {{"error", status.message()}});
  return 1;
}

}  // namespace
}  // namespace rips::bench

int main(int argc, char** argv) { return rips::bench::Main(argc, argv); }

// What the guard of the port costs those who do no harm: a message there and back on a stream, and
// connections on which nothing happens. `bare` is gRPC with a listener of its own.
#include <sys/resource.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "benchmark/benchmark.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/credentials.h"
#include "grpcpp/security/server_credentials.h"
#include "grpcpp/server_builder.h"
#include "rips/v1/sensor.grpc.pb.h"
#include "services/base/check.h"
#include "services/rpc/connection_guard.h"
#include "services/rpc/server_builder.h"
#include "services/runtime/metrics.h"
#include "services/runtime/real_clock.h"

namespace rips::rpc {
namespace {

constexpr int kIdleConnections = 200;
constexpr absl::Duration kIdle = absl::Seconds(4);

class Echo final : public v1::SensorService::Service {
 public:
  grpc::Status Observe(
      grpc::ServerContext* context,
      grpc::ServerReaderWriter<v1::SensorReply, v1::SensorMessage>* stream) override {
    std::shared_ptr<Connection> connection;
    if (guard != nullptr) {
      connection = guard->Find(context->peer());
      RIPS_CHECK(connection != nullptr, "the guard does not know its own connection");
    }
    v1::SensorMessage message;
    while (stream->Read(&message)) {
      if (connection != nullptr) connection->OnMessage(message.ByteSizeLong());
      if (!stream->Write(v1::SensorReply())) break;
    }
    return grpc::Status::OK;
  }

  ConnectionGuard* guard = nullptr;
};

// A server, guarded or bare, and channels to it, each a connection of its own.
class Port {
 public:
  explicit Port(bool guarded) {
    if (guarded) {
      ConnectionGuard::Options options;
      options.admission.per_address = 2 * kIdleConnections;
      options.admission.per_network = 2 * kIdleConnections;
      options.admission.total = 2 * kIdleConnections;
      options.admission.reserve = 0;
      options.admission.burst = 2 * kIdleConnections;
      options.budget.silent_ns = absl::ToInt64Nanoseconds(absl::Hours(1));
      auto guard = ConnectionGuard::Listen("127.0.0.1:0", options, &clock_, &metrics_);
      RIPS_CHECK(guard.ok(), guard.status().ToString().c_str());
      guard_ = *std::move(guard);
      echo_.guard = guard_.get();
      auto server = RpcServer::Start({.listen = "127.0.0.1:0",
                                      .guard = guard_.get(),
                                      .credentials = grpc::InsecureServerCredentials()},
                                     {&echo_});
      RIPS_CHECK(server.ok(), server.status().ToString().c_str());
      guarded_ = *std::move(server);
      address_ = guarded_->address();
    } else {
      int port = 0;
      grpc::ServerBuilder builder;
      builder.RegisterService(&echo_);
      builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
      // As RpcServer does it.
      const int keepalive_ms =
          static_cast<int>(absl::ToInt64Milliseconds(RpcServerOptions().keepalive_time));
      builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, keepalive_ms);
      builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
      builder.AddChannelArgument(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
      bare_ = builder.BuildAndStart();
      RIPS_CHECK(bare_ != nullptr, "the server does not start");
      address_ = "127.0.0.1:" + std::to_string(port);
    }
  }
  ~Port() {
    if (bare_ != nullptr) bare_->Shutdown(absl::ToChronoTime(absl::Now()));
  }

  std::shared_ptr<grpc::Channel> Connect() const {
    grpc::ChannelArguments arguments;
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    auto channel =
        grpc::CreateCustomChannel(address_, grpc::InsecureChannelCredentials(), arguments);
    RIPS_CHECK(channel->WaitForConnected(absl::ToChronoTime(absl::Now() + absl::Seconds(10))),
               "no connection");
    return channel;
  }

 private:
  RealClock clock_;
  Metrics metrics_;
  Echo echo_;
  std::unique_ptr<ConnectionGuard> guard_;
  std::unique_ptr<RpcServer> guarded_;
  std::unique_ptr<grpc::Server> bare_;
  std::string address_;
};

double ProcessSeconds() {
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

void RoundTrip(benchmark::State& state, bool guarded) {
  const Port port(guarded);
  const auto channel = port.Connect();
  const auto stub = v1::SensorService::NewStub(channel);
  grpc::ClientContext context;
  const auto stream = stub->Observe(&context);
  v1::SensorMessage message;
  message.mutable_heartbeat()->mutable_clock()->set_boottime_ns(1);
  v1::SensorReply reply;
  for (auto _ : state) {
    if (!stream->Write(message) || !stream->Read(&reply)) {
      state.SkipWithError("the stream has ended");
      break;
    }
  }
  stream->WritesDone();
  stream->Finish().error_code();
}
BENCHMARK_CAPTURE(RoundTrip, bare, false)->Name("Guard/round_trip/bare")->UseRealTime();
BENCHMARK_CAPTURE(RoundTrip, guarded, true)->Name("Guard/round_trip/guarded")->UseRealTime();

// Processor time of server and clients together, a second.
void IdleConnections(benchmark::State& state, bool guarded) {
  const Port port(guarded);
  std::vector<std::shared_ptr<grpc::Channel>> channels;
  for (int i = 0; i < kIdleConnections; ++i) channels.push_back(port.Connect());
  absl::SleepFor(absl::Seconds(1));
  for (auto _ : state) {
    const double before = ProcessSeconds();
    absl::SleepFor(kIdle);
    state.SetIterationTime((ProcessSeconds() - before) / absl::ToDoubleSeconds(kIdle));
  }
}
BENCHMARK_CAPTURE(IdleConnections, bare, false)
    ->Name("Guard/200_idle_connections/bare")
    ->UseManualTime()
    ->Iterations(1);
BENCHMARK_CAPTURE(IdleConnections, guarded, true)
    ->Name("Guard/200_idle_connections/guarded")
    ->UseManualTime()
    ->Iterations(1);

}  // namespace
}  // namespace rips::rpc

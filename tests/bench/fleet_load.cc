// A fleet of robots on one policy server, for the benchmark of what a server carries.
//   fleet_load --server HOST:PORT --pki DIR --robots N --rate R [--hostile H]
// DIR/{sensor,actuator}/rK/base hold the certificates of robot `rK`. Every tenth robot makes a rule
// raise its level, every tenth has rules act on a message each second; the last H are hostile.
// Prints {"event":"ready"} when all are connected, {"event":"sample",...} every second, and
// after SIGTERM {"event":"end",...} when everything is acknowledged, or after a minute. SIGUSR1 begins the
// latencies anew.
#include <atomic>
#include <csignal>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/tls_certificate_provider.h"
#include "grpcpp/security/tls_certificate_verifier.h"
#include "grpcpp/security/tls_credentials_options.h"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "services/rpc/credentials.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/shutdown.h"
#include "tests/bench/fleet_robot.h"
#include "tests/support/robot_sim/events.h"

namespace rips::bench {
namespace {

using Json = nlohmann::ordered_json;

constexpr size_t kPemBytesMax = 64 * 1024;
constexpr absl::Duration kTick = absl::Milliseconds(5);
constexpr int kTicksPerStep = 20;
constexpr absl::Duration kSample = absl::Seconds(1);
constexpr absl::Duration kPatience = absl::Minutes(1);
static_assert(FleetRobot::kStepNs == kTicksPerStep * 5'000'000);

struct Options {
  std::string server;
  std::string pki;
  int robots = 1;
  double rate = 100;
  int hostile = 0;
  int hostile_nodes = 1'000;
};

// Read once: the agents' own credentials watch their files, with a thread each. Whose server it is
// plays no part here.
absl::StatusOr<std::shared_ptr<grpc::Channel>> Connect(const std::string& server,
                                                       const std::string& dir) {
  RIPS_ASSIGN_OR_RETURN(std::string ca, ReadFile(absl::StrCat(dir, "/ca.pem"), kPemBytesMax));
  RIPS_ASSIGN_OR_RETURN(std::string cert, ReadFile(absl::StrCat(dir, "/cert.pem"), kPemBytesMax));
  RIPS_ASSIGN_OR_RETURN(std::string key, ReadFile(absl::StrCat(dir, "/key.pem"), kPemBytesMax));
  grpc::experimental::TlsChannelCredentialsOptions options;
  options.set_certificate_provider(
      std::make_shared<grpc::experimental::StaticDataCertificateProvider>(
          std::move(ca),
          std::vector<grpc::experimental::IdentityKeyCertPair>{{std::move(key), std::move(cert)}}));
  options.watch_root_certs();
  options.watch_identity_key_cert_pairs();
  options.set_check_call_host(false);
  options.set_certificate_verifier(std::make_shared<grpc::experimental::NoOpCertificateVerifier>());
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  arguments.SetInt(GRPC_ARG_HTTP2_BDP_PROBE, 0);  // as agents
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 500);
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 5'000);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 2'000);
  return grpc::CreateCustomChannel(server, grpc::experimental::TlsCredentials(options), arguments);
}

class Fleet {
 public:
  absl::Status Begin(const Options& options) {
    for (int i = 1; i <= options.robots; ++i) {
      RobotPlan plan{.id = absl::StrCat("r", i), .rate = options.rate};
      plan.hostile = i > options.robots - options.hostile;
      plan.raises = !plan.hostile && i % 10 == 0;
      plan.probes = !plan.hostile && i % 10 == 5;
      if (plan.hostile) plan.nodes = options.hostile_nodes;
      RIPS_ASSIGN_OR_RETURN(
          auto sensor,
          Connect(options.server, absl::StrCat(options.pki, "/sensor/", plan.id, "/base")));
      RIPS_ASSIGN_OR_RETURN(
          auto actuator,
          Connect(options.server, absl::StrCat(options.pki, "/actuator/", plan.id, "/base")));
      hostile_.push_back(plan.hostile);
      robots_.push_back(std::make_unique<FleetRobot>(std::move(plan), std::move(sensor),
                                                     std::move(actuator), &latencies_));
    }
    pump_ = std::thread([this] { Pump(); });
    return absl::OkStatus();
  }

  Json Sample(const char* event) {
    RobotCounts all;
    uint64_t connected = 0;
    uint64_t raised = 0;
    Json hostile = Json::object();
    for (size_t i = 0; i < robots_.size(); ++i) {
      const RobotCounts one = robots_[i]->counts();
      if (hostile_[i]) {
        hostile = {{"sent", one.sent}, {"acknowledged", one.acknowledged}, {"error", one.error}};
        continue;
      }
      connected += one.connected ? 1 : 0;
      raised += one.level == "ALERT" ? 1 : 0;
      all.sent += one.sent;
      all.acknowledged += one.acknowledged;
      all.waiting += one.waiting;
      all.connects += one.connects;
      all.lowered += one.lowered;
      if (!one.connected) all.error = one.error;
    }
    return {{"event", event},
            {"connected", connected},
            {"connects", all.connects},
            {"sent", all.sent},
            {"acknowledged", all.acknowledged},
            {"waiting", all.waiting},
            {"at_alert", raised},
            {"lowered", all.lowered},
            {"late_ms", late_ms_.exchange(0)},
            {"ack_ms", Shown(latencies_.acknowledged)},
            {"command_ms", Shown(latencies_.command)},
            {"hostile", hostile},
            {"error", all.error}};
  }

  bool connected() const {
    size_t count = 0;
    for (const auto& robot : robots_) count += robot->counts().connected ? 1 : 0;
    return count == robots_.size();
  }
  uint64_t waiting() const {
    uint64_t count = 0;
    for (size_t i = 0; i < robots_.size(); ++i) {
      if (!hostile_[i]) count += robots_[i]->counts().waiting;
    }
    return count;
  }
  void ClearLatencies() {
    latencies_.acknowledged.Clear();
    latencies_.command.Clear();
  }
  void Quiet() {
    for (const auto& robot : robots_) robot->Quiet();
  }
  void End() {
    stopping_ = true;
    if (pump_.joinable()) pump_.join();
    for (const auto& robot : robots_) robot->End();
  }

 private:
  static Json Shown(const Latencies& latencies) {
    return {{"count", latencies.count()},
            {"p50", latencies.Percentile(50)},
            {"p99", latencies.Percentile(99)},
            {"max", latencies.Percentile(100)}};
  }

  // Each robot once a step, spread over its ticks.
  void Pump() {
    absl::Time due = absl::Now();
    for (size_t tick = 0; !stopping_; ++tick) {
      for (size_t i = tick % kTicksPerStep; i < robots_.size(); i += kTicksPerStep) {
        robots_[i]->Step(RealClock().Now().boottime_ns);
      }
      due += kTick;
      const absl::Duration left = due - absl::Now();
      if (left > absl::ZeroDuration()) {
        absl::SleepFor(left);
      } else {
        const int64_t late = -absl::ToInt64Milliseconds(left);
        if (late > late_ms_) late_ms_ = late;
        if (late > 1'000) due = absl::Now();  // what is owed comes with the next step
      }
    }
  }

  FleetLatencies latencies_;
  std::vector<std::unique_ptr<FleetRobot>> robots_;
  std::vector<bool> hostile_;
  std::atomic<bool> stopping_ = false;
  // How far the pump was behind since the last sample: then latencies are partly its own.
  std::atomic<int64_t> late_ms_ = 0;
  std::thread pump_;
};

absl::Status Run(const Options& options, SignalWaiter& signals, Fleet& fleet) {
  RIPS_RETURN_IF_ERROR(fleet.Begin(options));
  std::atomic<bool> over = false;
  std::thread samples([&] {
    bool ready = false;
    for (int64_t i = 1; !over; ++i) {
      absl::SleepFor(absl::Milliseconds(200));
      if (!ready && fleet.connected()) {
        ready = true;
        robot_sim::PrintEvent({{"event", "ready"}});
      }
      if (i % (kSample / absl::Milliseconds(200)) == 0) {
        robot_sim::PrintEvent(fleet.Sample("sample"));
      }
    }
  });
  signals.WaitForShutdown();
  fleet.Quiet();
  const absl::Time until = absl::Now() + kPatience;
  while (fleet.waiting() > 0 && absl::Now() < until) absl::SleepFor(absl::Milliseconds(100));
  over = true;
  samples.join();
  robot_sim::PrintEvent(fleet.Sample("end"));
  fleet.End();
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("A fleet of robots on one policy server.");
  app.add_option("--server", options.server, "HOST:PORT")->required();
  app.add_option("--pki", options.pki, "directory of deploy/pki/mint")->required();
  app.add_option("--robots", options.robots)->check(CLI::Range(1, 2'000));
  app.add_option("--rate", options.rate, "messages a second of each robot");
  app.add_option("--hostile", options.hostile, "so many of them, the last ones, are hostile");
  app.add_option("--hostile-nodes", options.hostile_nodes, "in the graph of a hostile one");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  rpc::RequireTls13();
  rpc::TrustGrpcLockOrder();
  BlockSignals();
  Fleet fleet;
  SignalWaiter signals({{SIGUSR1, [&fleet] { fleet.ClearLatencies(); }}});
  const absl::Status status = Run(options, signals, fleet);
  if (status.ok()) return 0;
  LogError("failed", {{"error", status.message()}});
  return 1;
}

}  // namespace
}  // namespace rips::bench

int main(int argc, char** argv) { return rips::bench::Main(argc, argv); }

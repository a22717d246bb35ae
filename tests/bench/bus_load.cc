// Traffic for benchmarks of the sensor: one ROS 2 process over DDS that publishes or subscribes,
// and says what it sent, got and cost.
//   bus_load publish --domain D --rate HZ --size BYTES --seconds S [--readers N] [--reliable]
//   bus_load subscribe --domain D [--reliable] [--anonymous]     until SIGTERM
// One JSON object per line on stdout:
//   {"event":"ready"}                  publish: as many readers as asked for are matched
//   {"event":"done","sent":N,"cpu_s":S,"took_s":S}
//   {"event":"done","received":N,"lost":N,"p50_us":..,"p99_us":..,"cpu_s":S}
#include <sys/resource.h>
#include <time.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "CLI/CLI.hpp"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/ros2/ros_name.h"
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

struct Options {
  dds::DomainOptions domain = {.id = 0, .interface = "lo"};
  std::string topic = "/bench";
  std::string type = "std_msgs/msg/UInt8MultiArray";
  std::string node = "/bench_node";
  bool reliable = false;
  // Endpoints without a node, and none of what a node has beside them.
  bool anonymous = false;
  // Per second; 0 = as fast as it goes.
  double rate = 100;
  // Bytes of the serialized payload, CDR header included.
  size_t size = 100;
  double seconds = 5;
  size_t readers = 0;
};

// CDR header (little endian), then CLOCK_MONOTONIC of the write in nanoseconds.
constexpr char kCdrLittleEndian[4] = {0, 1, 0, 0};
constexpr size_t kStampOffset = sizeof(kCdrLittleEndian);
constexpr size_t kSizeMin = kStampOffset + sizeof(int64_t);

int64_t MonotonicNs() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kNanosPerSecond + now.tv_nsec;
}

void SleepUntil(int64_t monotonic_ns) {
  const timespec until{.tv_sec = monotonic_ns / kNanosPerSecond,
                       .tv_nsec = monotonic_ns % kNanosPerSecond};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
}

double CpuSeconds() {
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& value) {
    return static_cast<double>(value.tv_sec) + static_cast<double>(value.tv_usec) * 1e-6;
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

ros2::Qos QosOf(const Options& options) {
  return options.reliable ? robot_sim::DefaultQos(1'000) : robot_sim::SensorDataQos();
}

absl::StatusOr<RosNode*> AddNode(RosProcess& process, const Options& options,
                                 std::unique_ptr<RosNode>& bare) {
  if (!options.anonymous) return process.AddNode(options.node);
  RIPS_ASSIGN_OR_RETURN(bare, RosNode::CreateBare(process.participant(), options.node));
  return bare.get();
}

absl::Status Publish(const Options& options) {
  RIPS_ASSIGN_OR_RETURN(auto domain, dds::Domain::Create(options.domain));
  RIPS_ASSIGN_OR_RETURN(auto process, RosProcess::Create(domain, ros2::GidBytes::k24));
  std::unique_ptr<RosNode> bare;
  RIPS_ASSIGN_OR_RETURN(RosNode * node, AddNode(*process, options, bare));
  RIPS_ASSIGN_OR_RETURN(dds::RawWriter * writer,
                        node->Publish(options.topic, options.type, QosOf(options)));
  RIPS_RETURN_IF_ERROR(process->Announce());
  const int64_t patience_ns = MonotonicNs() + 30 * kNanosPerSecond;
  while (writer->MatchedReaders() < options.readers) {
    if (MonotonicNs() > patience_ns) return absl::DeadlineExceededError("too few readers");
    SleepUntil(MonotonicNs() + kNanosPerMilli);
  }
  // Discovery and attribution are over.
  SleepUntil(MonotonicNs() + kNanosPerSecond);
  PrintEvent({{"event", "ready"}});
  std::string payload(options.size, '\0');
  std::memcpy(payload.data(), kCdrLittleEndian, sizeof(kCdrLittleEndian));
  const double cpu = CpuSeconds();
  const int64_t start_ns = MonotonicNs();
  const auto end_ns = start_ns + static_cast<int64_t>(options.seconds * kNanosPerSecond);
  uint64_t sent = 0;
  for (int64_t now_ns = start_ns; now_ns < end_ns; now_ns = MonotonicNs()) {
    if (options.rate > 0) {
      const auto due_ns =
          start_ns + static_cast<int64_t>(static_cast<double>(sent) * 1e9 / options.rate);
      // Late ones go out at once; no finer than the kernel wakes.
      if (due_ns > now_ns) {
        SleepUntil(due_ns);
        now_ns = MonotonicNs();
      }
    }
    const int64_t stamp = now_ns;
    std::memcpy(payload.data() + kStampOffset, &stamp, sizeof(stamp));
    if (writer->Write(payload).ok()) ++sent;
  }
  PrintEvent({{"event", "done"},
              {"sent", sent},
              {"took_s", static_cast<double>(MonotonicNs() - start_ns) * 1e-9},
              {"cpu_s", CpuSeconds() - cpu}});
  // What is underway arrives before the writer goes.
  SleepUntil(MonotonicNs() + kNanosPerSecond);
  return absl::OkStatus();
}

// Calls for one reader never overlap; read when there are no more.
struct Received {
  static constexpr size_t kLatenciesMax = 10'000'000;

  uint64_t samples = 0;
  uint64_t lost = 0;
  uint64_t newest = 0;
  std::vector<uint32_t> latencies_ns;

  void Take(const dds::RawSample& sample) {
    const int64_t now_ns = MonotonicNs();
    ++samples;
    if (newest != 0 && sample.writer_sequence > newest + 1) {
      lost += sample.writer_sequence - newest - 1;
    }
    newest = std::max(newest, sample.writer_sequence);
    if (sample.payload.size() < kSizeMin || latencies_ns.size() >= kLatenciesMax) return;
    int64_t stamp = 0;
    std::memcpy(&stamp, sample.payload.data() + kStampOffset, sizeof(stamp));
    latencies_ns.push_back(
        static_cast<uint32_t>(std::clamp<int64_t>(now_ns - stamp, 0, UINT32_MAX)));
  }
  double PercentileUs(double percent) {
    if (latencies_ns.empty()) return 0;
    const auto at =
        static_cast<ptrdiff_t>(static_cast<double>(latencies_ns.size() - 1) * percent / 100);
    std::nth_element(latencies_ns.begin(), latencies_ns.begin() + at, latencies_ns.end());
    return static_cast<double>(latencies_ns[static_cast<size_t>(at)]) * 1e-3;
  }
};

absl::Status Subscribe(const Options& options, SignalWaiter& signals) {
  RIPS_ASSIGN_OR_RETURN(auto domain, dds::Domain::Create(options.domain));
  auto received = std::make_unique<Received>();
  received->latencies_ns.reserve(1 << 20);
  RIPS_ASSIGN_OR_RETURN(auto process, RosProcess::Create(domain, ros2::GidBytes::k24));
  std::unique_ptr<RosNode> bare;
  RIPS_ASSIGN_OR_RETURN(RosNode * node, AddNode(*process, options, bare));
  RIPS_RETURN_IF_ERROR(
      node->Subscribe(options.topic, options.type, QosOf(options),
                      [&](const dds::RawSample& sample) { received->Take(sample); }));
  RIPS_RETURN_IF_ERROR(process->Announce());
  PrintEvent({{"event", "ready"}});
  signals.WaitForShutdown();
  const double cpu = CpuSeconds();
  bare.reset();
  process.reset();
  PrintEvent({{"event", "done"},
              {"received", received->samples},
              {"lost", received->lost},
              {"p50_us", received->PercentileUs(50)},
              {"p99_us", received->PercentileUs(99)},
              {"cpu_s", cpu}});
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("Traffic for benchmarks of the sensor.");
  app.require_subcommand(1);
  CLI::App* publish = app.add_subcommand("publish", "write messages and say how many");
  CLI::App* subscribe = app.add_subcommand("subscribe", "read messages until SIGTERM");
  for (CLI::App* sub : {publish, subscribe}) {
    sub->add_option("--domain", options.domain.id)->required()->check(CLI::Range(0, 232));
    sub->add_option("--topic", options.topic);
    sub->add_option("--type", options.type);
    sub->add_option("--node", options.node);
    sub->add_flag("--reliable", options.reliable);
    sub->add_flag("--anonymous", options.anonymous);
  }
  publish->add_option("--rate", options.rate)->check(CLI::NonNegativeNumber);
  publish->add_option("--size", options.size)->check(CLI::Range(kSizeMin, size_t{8} << 20));
  publish->add_option("--seconds", options.seconds)->check(CLI::PositiveNumber);
  publish->add_option("--readers", options.readers);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  BlockSignals();
  SignalWaiter signals({});
  const absl::Status status = publish->parsed() ? Publish(options) : Subscribe(options, signals);
  if (status.ok()) return 0;
  LogError("failed", {{"error", status.message()}});
  return 1;
}

}  // namespace
}  // namespace rips::bench

int main(int argc, char** argv) { return rips::bench::Main(argc, argv); }

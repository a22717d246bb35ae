// How the sensor's host is doing, as gauges of the sensor's /metrics:
//
// | gauge                                    | from                                       |
// |------------------------------------------|--------------------------------------------|
// | rips_host_cpu_busy_ratio                 | /proc/stat, since the last reading         |
// | rips_host_memory[_available]_bytes       | /proc/meminfo                              |
// | rips_host_load_average{minutes}          | /proc/loadavg                              |
// | rips_host_disk[_available]_bytes         | the file system of state_dir               |
// | rips_host_temperature_celsius{zone,type} | /sys/class/thermal/thermal_zone*           |
//
// What cannot be read has no gauge; what cannot be read any more is NaN.
#ifndef RIPS_SENSOR_AGENT_HOST_METRICS_H_
#define RIPS_SENSOR_AGENT_HOST_METRICS_H_

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"

namespace rips::sensor {

// --- What the files say. Pure; nullopt or empty for anything that is not such a file.

// Of all processors together, in ticks since boot.
struct CpuTicks {
  uint64_t busy = 0;
  uint64_t all = 0;
};
std::optional<CpuTicks> ParseCpuTicks(absl::string_view proc_stat);
// 0 to 1; nullopt if no time has passed, or went back.
std::optional<double> BusyRatio(CpuTicks before, CpuTicks now);
// Bytes of `MemTotal`, `MemAvailable`, ...
std::optional<double> ParseMemory(absl::string_view proc_meminfo, absl::string_view key);
// Of the last 1, 5 and 15 minutes.
std::vector<double> ParseLoad(absl::string_view proc_loadavg);
std::optional<double> ParseMilliCelsius(absl::string_view temp);

class HostMetrics {
 public:
  struct Options {
    // A path on the file system to watch.
    std::string disk;
    absl::Duration interval = absl::Seconds(5);
    // In front of /proc and /sys; for tests.
    std::string root;
  };

  // More are not read.
  static constexpr int kThermalZonesMax = 64;

  // `metrics` is not owned and outlives this.
  HostMetrics(Options options, Metrics* metrics);
  ~HostMetrics();
  HostMetrics(const HostMetrics&) = delete;
  HostMetrics& operator=(const HostMetrics&) = delete;

  // Reads in a thread of its own, because a file system that hangs or a slow sensor of temperature
  // must not hold up anything else.
  void Start();
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  // Once; what the thread does each interval. Not while that runs.
  void Read();

 private:
  void ReadCpu();
  void ReadMemory();
  void ReadLoad();
  void ReadDisk();
  void ReadTemperatures();
  // No file, or not readable: empty.
  std::string File(const std::string& path) const;
  void Set(const std::string& name, const std::string& help, std::optional<double> value,
           const MetricLabels& labels = {});
  void Run() ABSL_LOCKS_EXCLUDED(mu_);

  const Options options_;
  Metrics* metrics_;
  // Those that had a value once.
  std::map<std::pair<std::string, MetricLabels>, Gauge> gauges_;
  std::optional<CpuTicks> cpu_;
  Mutex mu_;
  CondVar stop_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_HOST_METRICS_H_

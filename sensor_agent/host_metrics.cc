#include "sensor_agent/host_metrics.h"

#include <sys/statvfs.h>

#include <limits>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "absl/time/clock.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/atomic_file.h"

namespace rips::sensor {

namespace {

constexpr size_t kFileBytesMax = size_t{1} << 20;

std::vector<absl::string_view> Words(absl::string_view text) {
  return absl::StrSplit(text, absl::ByAnyChar(" \t"), absl::SkipEmpty());
}

}  // namespace

std::optional<CpuTicks> ParseCpuTicks(absl::string_view proc_stat) {
  // `cpu user nice system idle iowait irq softirq steal guest guest_nice`; the guests' time is in
  // user and nice, too.
  const std::vector<absl::string_view> words = Words(proc_stat.substr(0, proc_stat.find('\n')));
  constexpr size_t kIdle = 4;
  constexpr size_t kIoWait = 5;
  constexpr size_t kSteal = 8;
  if (words.size() <= kIdle || words[0] != "cpu") return std::nullopt;
  CpuTicks ticks;
  for (size_t i = 1; i < words.size() && i <= kSteal; ++i) {
    uint64_t value = 0;
    if (!absl::SimpleAtoi(words[i], &value)) return std::nullopt;
    ticks.all += value;
    if (i != kIdle && i != kIoWait) ticks.busy += value;
  }
  return ticks;
}

std::optional<double> BusyRatio(CpuTicks before, CpuTicks now) {
  // The kernel may take back some of what it counted as waiting for disks.
  if (now.all <= before.all || now.busy < before.busy) return std::nullopt;
  const uint64_t busy = now.busy - before.busy;
  const uint64_t all = now.all - before.all;
  return busy >= all ? 1.0 : static_cast<double>(busy) / static_cast<double>(all);
}

std::optional<double> ParseMemory(absl::string_view proc_meminfo, absl::string_view key) {
  for (absl::string_view line : absl::StrSplit(proc_meminfo, '\n')) {
    if (!absl::ConsumePrefix(&line, key) || !absl::ConsumePrefix(&line, ":")) continue;
    const std::vector<absl::string_view> words = Words(line);
    uint64_t kibibytes = 0;
    if (words.size() != 2 || words[1] != "kB" || !absl::SimpleAtoi(words[0], &kibibytes)) break;
    return static_cast<double>(kibibytes) * 1024;
  }
  return std::nullopt;
}

std::vector<double> ParseLoad(absl::string_view proc_loadavg) {
  const std::vector<absl::string_view> words = Words(proc_loadavg);
  std::vector<double> load(3);
  if (words.size() < load.size()) return {};
  for (size_t i = 0; i < load.size(); ++i) {
    if (!absl::SimpleAtod(words[i], &load[i])) return {};
  }
  return load;
}

std::optional<double> ParseMilliCelsius(absl::string_view temp) {
  int64_t value = 0;
  if (!absl::SimpleAtoi(absl::StripAsciiWhitespace(temp), &value)) return std::nullopt;
  return static_cast<double>(value) / 1000;
}

HostMetrics::HostMetrics(Options options, Metrics* metrics)
    : options_(std::move(options)), metrics_(metrics) {}

HostMetrics::~HostMetrics() { Stop(); }

void HostMetrics::Start() {
  thread_ = std::thread([this] { Run(); });
}

void HostMetrics::Stop() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    stop_cond_.NotifyOne();
  }
  if (thread_.joinable()) thread_.join();
}

void HostMetrics::Run() {
  while (true) {
    Read();
    const absl::Time next = absl::Now() + options_.interval;
    MutexLock lock(&mu_);
    while (!stopping_ && stop_cond_.WaitFor(lock, next - absl::Now())) {
    }
    if (stopping_) return;
  }
}

void HostMetrics::Read() {
  ReadCpu();
  ReadMemory();
  ReadLoad();
  ReadDisk();
  ReadTemperatures();
}

std::string HostMetrics::File(const std::string& path) const {
  return ReadFile(absl::StrCat(options_.root, path), kFileBytesMax).value_or("");
}

void HostMetrics::Set(const std::string& name, const std::string& help, std::optional<double> value,
                      const MetricLabels& labels) {
  auto it = gauges_.find({name, labels});
  if (it == gauges_.end()) {
    if (!value.has_value()) return;
    it = gauges_.emplace(std::pair(name, labels), metrics_->AddGauge(name, help, labels)).first;
  }
  it->second.Set(value.value_or(std::numeric_limits<double>::quiet_NaN()));
}

void HostMetrics::ReadCpu() {
  const std::optional<CpuTicks> now = ParseCpuTicks(File("/proc/stat"));
  std::optional<double> ratio;
  if (cpu_.has_value() && now.has_value()) ratio = BusyRatio(*cpu_, *now);
  cpu_ = now;
  Set("rips_host_cpu_busy_ratio", "Part of the processors' time not idle, 0 to 1", ratio);
}

void HostMetrics::ReadMemory() {
  const std::string meminfo = File("/proc/meminfo");
  Set("rips_host_memory_bytes", "Memory of the host", ParseMemory(meminfo, "MemTotal"));
  Set("rips_host_memory_available_bytes", "Memory that programs can get without swapping",
      ParseMemory(meminfo, "MemAvailable"));
}

void HostMetrics::ReadLoad() {
  constexpr const char* kMinutes[] = {"1", "5", "15"};
  const std::vector<double> load = ParseLoad(File("/proc/loadavg"));
  for (size_t i = 0; i < std::size(kMinutes); ++i) {
    std::optional<double> value;
    if (!load.empty()) value = load[i];
    Set("rips_host_load_average", "Programs that run or want to", value,
        {{"minutes", kMinutes[i]}});
  }
}

void HostMetrics::ReadDisk() {
  struct statvfs disk;
  std::optional<double> size;
  std::optional<double> available;
  if (statvfs(options_.disk.c_str(), &disk) == 0) {
    size = static_cast<double>(disk.f_blocks) * static_cast<double>(disk.f_frsize);
    available = static_cast<double>(disk.f_bavail) * static_cast<double>(disk.f_frsize);
  }
  Set("rips_host_disk_bytes", "Size of the file system with the sensor's state", size);
  Set("rips_host_disk_available_bytes", "Free space for the sensor's state", available);
}

void HostMetrics::ReadTemperatures() {
  for (int zone = 0; zone < kThermalZonesMax; ++zone) {
    const std::string folder = absl::StrCat("/sys/class/thermal/thermal_zone", zone);
    const std::string type = ros2::Printable(absl::StripAsciiWhitespace(File(folder + "/type")));
    // They are numbered without holes until one is unplugged; then those behind it are still there.
    if (type.empty()) continue;
    Set("rips_host_temperature_celsius", "What a sensor of temperature says",
        ParseMilliCelsius(File(folder + "/temp")), {{"zone", absl::StrCat(zone)}, {"type", type}});
  }
}

}  // namespace rips::sensor

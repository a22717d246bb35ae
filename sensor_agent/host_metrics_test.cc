#include "sensor_agent/host_metrics.h"

#include <stdlib.h>

#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::sensor {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::Optional;

TEST(CpuTicksTest, IdleAndWaitingForDisksAreNotBusy) {
  const auto ticks = ParseCpuTicks("cpu  10 20 30 400 50 6 7 8 900 1000\ncpu0 1 2 3 4\n");
  ASSERT_TRUE(ticks.has_value());
  EXPECT_EQ(ticks->busy, 10 + 20 + 30 + 6 + 7 + 8);
  EXPECT_EQ(ticks->all, ticks->busy + 400 + 50);
  EXPECT_TRUE(ParseCpuTicks("cpu 1 2 3 4").has_value()) << "as old kernels say it";
}

TEST(CpuTicksTest, OtherTextIsNone) {
  for (const char* text : {"", "cpu", "cpu 1 2 3", "cpu0 1 2 3 4", "cpu 1 2 x 4", "cpu 1 2 -3 4",
                           "cpu 1 2 3 99999999999999999999999", "\n"}) {
    EXPECT_FALSE(ParseCpuTicks(text).has_value()) << text;
  }
}

TEST(CpuTicksTest, RatioOfTheTimeBetween) {
  EXPECT_THAT(BusyRatio({10, 100}, {35, 200}), Optional(0.25));
  EXPECT_THAT(BusyRatio({10, 100}, {110, 200}), Optional(1.0));
  EXPECT_THAT(BusyRatio({10, 100}, {10, 200}), Optional(0.0));
  EXPECT_THAT(BusyRatio({10, 100}, {200, 190}), Optional(1.0)) << "counted at different moments";
  EXPECT_FALSE(BusyRatio({10, 100}, {10, 100}).has_value());
  EXPECT_FALSE(BusyRatio({10, 100}, {9, 200}).has_value());
  EXPECT_FALSE(BusyRatio({10, 100}, {11, 99}).has_value());
}

TEST(MemoryTest, OfOneKey) {
  constexpr char kText[] = "MemTotal:       24684084 kB\nMemFree: 7 kB\nMemAvailable:  5 kB\n";
  EXPECT_THAT(ParseMemory(kText, "MemTotal"), Optional(24684084.0 * 1024));
  EXPECT_THAT(ParseMemory(kText, "MemAvailable"), Optional(5.0 * 1024));
  EXPECT_FALSE(ParseMemory(kText, "Mem").has_value());
  for (const char* text : {"", "MemFree", "MemFree:", "MemFree: x kB", "MemFree: 7 MB"}) {
    EXPECT_FALSE(ParseMemory(text, "MemFree").has_value()) << text;
  }
}

TEST(LoadTest, ThreeNumbers) {
  EXPECT_THAT(ParseLoad("7.90 5.58 3.29 7/158 31421\n"), ElementsAre(7.9, 5.58, 3.29));
  for (const char* text : {"", "1 2", "1 2 x"}) EXPECT_THAT(ParseLoad(text), IsEmpty()) << text;
}

TEST(TemperatureTest, InMilliCelsius) {
  EXPECT_THAT(ParseMilliCelsius("45500\n"), Optional(45.5));
  EXPECT_THAT(ParseMilliCelsius("-2000"), Optional(-2.0));
  for (const char* text : {"", "hot", "1.5"}) {
    EXPECT_FALSE(ParseMilliCelsius(text).has_value()) << text;
  }
}

class HostMetricsTest : public testing::Test {
 protected:
  HostMetricsTest() {
    std::string name = testing::TempDir() + "/host_metrics_XXXXXX";
    root_ = mkdtemp(name.data());
  }
  ~HostMetricsTest() override { fs::remove_all(root_); }
  void Write(const std::string& path, const std::string& text) {
    fs::create_directories(fs::path(root_ + path).parent_path());
    std::ofstream(root_ + path) << text;
  }

  std::string root_;
  Metrics metrics_;
};

TEST_F(HostMetricsTest, WhatIsThereHasAGauge) {
  HostMetrics host({.disk = root_, .root = root_}, &metrics_);
  Write("/proc/stat", "cpu 10 0 0 90\n");
  Write("/proc/meminfo", "MemTotal: 4 kB\nMemAvailable: 2 kB\n");
  Write("/proc/loadavg", "1.5 2.5 3.5 1/2 3\n");
  Write("/sys/class/thermal/thermal_zone0/type", "cpu-\x1b[31mthermal\n");
  Write("/sys/class/thermal/thermal_zone0/temp", "45500\n");
  Write("/sys/class/thermal/thermal_zone3/type", "gpu\n");
  Write("/sys/class/thermal/thermal_zone3/temp", "30000\n");

  host.Read();

  EXPECT_THAT(metrics_.Text(),
              AllOf(HasSubstr("rips_host_memory_bytes 4096"),
                    HasSubstr("rips_host_memory_available_bytes 2048"),
                    HasSubstr("rips_host_load_average{minutes=\"15\"} 3.5"),
                    HasSubstr("rips_host_disk_available_bytes "), HasSubstr("zone=\"3\"} 30"),
                    HasSubstr("type=\"cpu-\\\\x1b[31mthermal\",zone=\"0\"} 45.5"),
                    Not(HasSubstr("busy_ratio"))));
  Write("/proc/stat", "cpu 40 0 0 160\n");
  host.Read();
  EXPECT_THAT(metrics_.Text(), HasSubstr("rips_host_cpu_busy_ratio 0.3"));
}

TEST_F(HostMetricsTest, WhatIsAbsentHasNone) {
  HostMetrics host({.disk = root_ + "/absent", .root = root_}, &metrics_);
  host.Read();
  host.Read();
  EXPECT_THAT(metrics_.Text(), Not(HasSubstr("rips_host")));
}

TEST_F(HostMetricsTest, WhatIsGoneIsNotANumber) {
  HostMetrics host({.disk = root_, .root = root_}, &metrics_);
  Write("/proc/loadavg", "1.5 2.5 3.5 1/2 3\n");
  host.Read();
  Write("/proc/loadavg", "");
  host.Read();
  EXPECT_THAT(metrics_.Text(), HasSubstr("rips_host_load_average{minutes=\"1\"} Nan"));
}

TEST_F(HostMetricsTest, OnlySoManyZonesAreRead) {
  HostMetrics host({.disk = root_, .root = root_}, &metrics_);
  for (const int zone : {HostMetrics::kThermalZonesMax - 1, HostMetrics::kThermalZonesMax}) {
    Write(absl::StrCat("/sys/class/thermal/thermal_zone", zone, "/type"), "x");
    Write(absl::StrCat("/sys/class/thermal/thermal_zone", zone, "/temp"), "1000");
  }
  host.Read();
  EXPECT_THAT(metrics_.Text(), AllOf(HasSubstr("zone=\"63\""), Not(HasSubstr("zone=\"64\""))));
}

TEST_F(HostMetricsTest, OfThisHost) {
  HostMetrics host({.disk = "/", .interval = absl::Milliseconds(1)}, &metrics_);
  host.Start();
  const absl::Time deadline = absl::Now() + absl::Seconds(30);
  while (metrics_.Text().find("rips_host_cpu_busy_ratio") == std::string::npos &&
         absl::Now() < deadline) {
    absl::SleepFor(absl::Milliseconds(1));
  }
  host.Stop();
  EXPECT_THAT(metrics_.Text(), AllOf(HasSubstr("rips_host_cpu_busy_ratio"),
                                     HasSubstr("rips_host_memory_available_bytes"),
                                     HasSubstr("rips_host_load_average{minutes=\"1\"}")));
}

}  // namespace
}  // namespace rips::sensor

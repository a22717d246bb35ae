#include "services/sensor_settings/sensor_settings.h"

#include <cstddef>
#include <cstdint>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/config_sections.h"

namespace rips {
namespace {

// Some segments.
constexpr int64_t kSpoolBytesMin = int64_t{16} << 20;
// Of a sensor; more would take memory that robots do not have.
constexpr size_t kGraphLimitMax = 65'536;

void ReadGraphLimits(const ConfigSection& section, ros2::GraphLimits& limits) {
  ReadCount(section, "participants", kGraphLimitMax, &limits.participants);
  ReadCount(section, "nodes", kGraphLimitMax, &limits.nodes);
  ReadCount(section, "endpoints", kGraphLimitMax, &limits.endpoints);
  ReadCount(section, "nodes_per_participant", kGraphLimitMax, &limits.nodes_per_participant);
  ReadCount(section, "endpoints_per_participant", kGraphLimitMax,
            &limits.endpoints_per_participant);
}

void ReadTopics(const ConfigSection& root, const char* key, std::vector<std::string>* topics) {
  root.Optional(key, topics);
  for (const std::string& topic : *topics) {
    if (absl::Status valid = ros2::ValidateTopicName(topic); !valid.ok()) {
      root.Problem(key, valid.message());
    }
  }
}

void ReadOutbox(const ConfigSection& outbox, SensorSettings& settings) {
  outbox.Optional("memory", &settings.outbox_memory,
                  {ByteSize{int64_t{1} << 20}, ByteSize{int64_t{4} << 30}});
  outbox.Optional("disk", &settings.outbox_disk, {ByteSize{0}, ByteSize{int64_t{64} << 30}});
  if (settings.outbox_disk.bytes != 0 && settings.outbox_disk.bytes < kSpoolBytesMin) {
    outbox.Problem("disk", "a spool needs at least 16MiB; `0B` = none");
  }
}

}  // namespace

void ReadSensorSettings(const ConfigSection& root, SensorSettings& settings) {
  root.OptionalEnum<bool>("observer", &settings.observer_hidden,
                          {{"counted", false}, {"hidden", true}});
  root.Optional("settle", &settings.settle, {absl::ZeroDuration(), absl::Seconds(10)});
  root.Optional("attribution_grace", &settings.attribution_grace,
                {absl::ZeroDuration(), absl::Seconds(10)});
  ReadGraphLimits(root.OptionalSection("graph_limits"), settings.graph_limits);
  ReadTopics(root, "unwatched", &settings.unwatched);
  ReadTopics(root, "raw_readers", &settings.raw_readers);
  ReadOutbox(root.OptionalSection("outbox"), settings);
  root.Optional("signals", &settings.signals);
}

const std::vector<std::string>& SettableNames() {
  static const auto& names = *new std::vector<std::string>{
      "observer",    "settle",        "attribution_grace", "graph_limits", "unwatched",
      "raw_readers", "outbox.memory", "outbox.disk",       "signals"};
  return names;
}

bool IsSettingOf(absl::string_view path, absl::string_view name) {
  return path == name || absl::StartsWith(path, absl::StrCat(name, "."));
}

}  // namespace rips

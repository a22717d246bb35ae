#include "sensor_agent/config.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "sensor_agent/wire/socket_address.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::sensor {

namespace {

// Some segments.
constexpr int64_t kSpoolBytesMin = int64_t{16} << 20;
std::vector<IdsLog> ReadIds(const ConfigSection& root) {
  std::vector<IdsLog> logs;
  for (const ConfigSection& source : root.Sections("ids")) {
    IdsLog& log = logs.emplace_back();
    source.RequiredEnum<IdsFormat>("format", &log.format,
                                   {{"eve", IdsFormat::kEve},
                                    {"fast", IdsFormat::kFast},
                                    {"snort3_json", IdsFormat::kSnort3Json}});
    ReadPath(source, "path", &log.path);
    const auto same = [&](const IdsLog& each) { return &each != &log && each.path == log.path; };
    if (std::any_of(logs.begin(), logs.end(), same)) {
      source.Problem("path", absl::StrCat("`", log.path, "` is read already"));
    }
  }
  if (logs.size() > kIdsLogsMax) {
    root.Problem("ids", absl::StrCat(logs.size(), " logs exceed the limit of ", kIdsLogsMax));
  }
  return logs;
}

void ReadSocket(const ConfigSection& section, std::string* path) {
  section.Optional("socket", path);
  if (absl::Status valid = wire::LocalAddress(*path).status(); !valid.ok()) {
    section.Problem("socket", valid.message());
  }
}

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

}  // namespace

absl::StatusOr<SensorConfig> ParseSensorConfig(absl::string_view file, absl::string_view text) {
  ConfigReader reader(file, text);
  const ConfigSection root = reader.root();
  SensorConfig config;
  ReadName(root, "robot", "robot id", &config.robot);
  ReadName(root, "host", "host id", &config.host);
  root.Required("servers", &config.servers);
  for (const std::string& server : config.servers) {
    if (IsHostPort(server)) continue;
    root.Problem("servers", absl::StrCat("`", server, "` is not HOST:PORT"));
  }
  config.tls = ReadTls(root);
  config.dds = ReadDds(root);
  root.OptionalEnum<bool>("observer", &config.observer_hidden,
                          {{"counted", false}, {"hidden", true}});
  root.Optional("settle", &config.settle, {absl::ZeroDuration(), absl::Seconds(10)});
  root.Optional("attribution_grace", &config.attribution_grace,
                {absl::ZeroDuration(), absl::Seconds(10)});
  ReadGraphLimits(root.OptionalSection("graph_limits"), config.graph_limits);
  ReadTopics(root, "unwatched", &config.unwatched);
  ReadTopics(root, "raw_readers", &config.raw_readers);
  root.Optional("state_dir", &config.state_dir);
  const ConfigSection outbox = root.OptionalSection("outbox");
  outbox.Optional("memory", &config.outbox_memory,
                  {ByteSize{int64_t{1} << 20}, ByteSize{int64_t{4} << 30}});
  outbox.Optional("disk", &config.outbox_disk, {ByteSize{0}, ByteSize{int64_t{64} << 30}});
  if (config.outbox_disk.bytes != 0 && config.outbox_disk.bytes < kSpoolBytesMin) {
    outbox.Problem("disk", "a spool needs at least 16MiB; `0B` = none");
  }
  config.spool_dir = absl::StrCat(config.state_dir, "/spool");
  outbox.Optional("dir", &config.spool_dir);
  if (config.spool_dir.front() != '/') outbox.Problem("dir", "needs an absolute path");
  config.ids = ReadIds(root);
  const ConfigSection wire = root.OptionalSection("wire");
  wire.Optional("enabled", &config.wire);
  ReadSocket(wire, &config.wire_socket);
  root.Optional("signals", &config.signals);
  root.Optional("metrics", &config.metrics);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  config.settings = reader.Settings();
  return config;
}

}  // namespace rips::sensor

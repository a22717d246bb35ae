#include "sensor_agent/config.h"

#include "absl/strings/str_cat.h"
#include "sensor_agent/wire/socket_address.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::sensor {

namespace {

constexpr char kNotAvailable[] = "not available in this version";

// Sections of later versions: their keys are known, their use is not.
void RefuseWhatIsNotAvailable(const ConfigSection& root, const ConfigSection& outbox) {
  for (const ConfigSection& source : root.Sections("ids")) {
    int format = 0;
    std::string path;
    source.RequiredEnum<int>("format", &format, {{"eve", 0}, {"fast", 1}, {"snort3_json", 2}});
    ReadPath(source, "path", &path);
    source.Problem("format", absl::StrCat("reading alerts of an intrusion detection system is ",
                                          kNotAvailable, "; remove `ids`"));
  }
  ByteSize disk;
  outbox.Optional("disk", &disk);
  if (disk.bytes != 0) {
    outbox.Problem("disk", absl::StrCat("a spool on disk is ", kNotAvailable, "; use `0B`"));
  }
  std::string dir = "/var/lib/rips/sensor/spool";
  outbox.Optional("dir", &dir);
}

void ReadSocket(const ConfigSection& section, std::string* path) {
  section.Optional("socket", path);
  if (absl::Status valid = wire::LocalAddress(*path).status(); !valid.ok()) {
    section.Problem("socket", valid.message());
  }
}

}  // namespace

absl::StatusOr<SensorConfig> ParseSensorConfig(absl::string_view file, absl::string_view text,
                                               std::string* effective) {
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
  if (!config.dds.keystore.empty()) {
    root.OptionalSection("dds").Problem("security",
                                        absl::StrCat("DDS security is ", kNotAvailable));
  }
  root.OptionalEnum<bool>("observer", &config.observer_hidden,
                          {{"counted", false}, {"hidden", true}});
  root.Optional("settle", &config.settle, {absl::ZeroDuration(), absl::Seconds(10)});
  root.Optional("attribution_grace", &config.attribution_grace,
                {absl::ZeroDuration(), absl::Seconds(10)});
  root.Optional("unwatched", &config.unwatched);
  for (const std::string& topic : config.unwatched) {
    if (absl::Status valid = ros2::ValidateTopicName(topic); !valid.ok()) {
      root.Problem("unwatched", valid.message());
    }
  }
  root.Optional("state_dir", &config.state_dir);
  const ConfigSection outbox = root.OptionalSection("outbox");
  outbox.Optional("memory", &config.outbox_memory,
                  {ByteSize{int64_t{1} << 20}, ByteSize{int64_t{4} << 30}});
  RefuseWhatIsNotAvailable(root, outbox);
  const ConfigSection wire = root.OptionalSection("wire");
  wire.Optional("enabled", &config.wire);
  ReadSocket(wire, &config.wire_socket);
  root.Optional("signals", &config.signals);
  root.Optional("metrics", &config.metrics);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  if (effective != nullptr) *effective = reader.Effective();
  return config;
}

}  // namespace rips::sensor

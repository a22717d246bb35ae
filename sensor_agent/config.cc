#include "sensor_agent/config.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "sensor_agent/wire/socket_address.h"
#include "services/base/cut_text.h"
#include "services/base/status_macros.h"

namespace rips::sensor {

namespace {

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

void ReadServerMaySet(const ConfigSection& root, std::vector<std::string>* names) {
  root.Optional("server_may_set", names);
  const std::vector<std::string>& known = SettableNames();
  for (const std::string& name : *names) {
    if (std::find(known.begin(), known.end(), name) != known.end()) continue;
    root.Problem("server_may_set",
                 absl::StrCat("`", name, "` is not the server's to set; it may be given `",
                              absl::StrJoin(known, "`, `"), "`"));
  }
}

absl::StatusOr<SensorConfig> Parse(absl::string_view file, absl::string_view text,
                                   const std::vector<ConfigSetting>& overrides) {
  ConfigReader reader(file, text, overrides);
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
  ReadSensorSettings(root, config.watch);
  ReadServerMaySet(root, &config.server_may_set);
  root.Optional("state_dir", &config.state_dir);
  const ConfigSection outbox = root.OptionalSection("outbox");
  config.spool_dir = absl::StrCat(config.state_dir, "/spool");
  outbox.Optional("dir", &config.spool_dir);
  if (config.spool_dir.front() != '/') outbox.Problem("dir", "needs an absolute path");
  config.ids = ReadIds(root);
  const ConfigSection wire = root.OptionalSection("wire");
  wire.Optional("enabled", &config.wire);
  ReadSocket(wire, &config.wire_socket);
  root.Optional("metrics", &config.metrics);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  config.settings = reader.Settings();
  return config;
}

// Of what a server that is not ours might send.
void LimitRefused(std::vector<std::string>& refused) {
  constexpr size_t kRefusedMax = 32;
  constexpr size_t kTextBytesMax = 512;
  if (refused.size() > kRefusedMax) {
    const size_t more = refused.size() - kRefusedMax + 1;
    refused.resize(kRefusedMax - 1);
    refused.push_back(absl::StrCat("and ", more, " more"));
  }
  for (std::string& text : refused) text = Shortened(text, kTextBytesMax);
}

}  // namespace

absl::StatusOr<SensorConfig> ParseSensorConfig(absl::string_view file, absl::string_view text,
                                               const std::vector<ConfigSetting>& from_server) {
  RIPS_ASSIGN_OR_RETURN(SensorConfig own, Parse(file, text, {}));
  std::vector<ConfigSetting> allowed;
  for (const ConfigSetting& each : from_server) {
    const auto covers = [&](const std::string& name) { return IsSettingOf(each.path, name); };
    if (std::any_of(own.server_may_set.begin(), own.server_may_set.end(), covers)) {
      allowed.push_back(each);
    } else {
      own.refused.push_back(absl::StrCat("`", each.path, ": ", each.value, "` (", each.source,
                                         "): `server_may_set` of ", file, " does not list it"));
    }
  }
  if (!allowed.empty()) {
    absl::StatusOr<SensorConfig> both = Parse(file, text, allowed);
    if (both.ok()) {
      both->refused = std::move(own.refused);
      own = *std::move(both);
    } else {
      std::vector<std::string> paths;
      for (const ConfigSetting& each : allowed) paths.push_back(each.path);
      own.refused.insert(own.refused.begin(),
                         absl::StrCat("`", absl::StrJoin(paths, "`, `"),
                                      "`: not all that the policy server sets is valid: ",
                                      both.status().message()));
    }
  }
  LimitRefused(own.refused);
  return own;
}

}  // namespace rips::sensor

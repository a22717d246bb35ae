#include "sensor_agent/server_settings.h"

#include <algorithm>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "rips/v1/session.pb.h"
#include "services/base/status_macros.h"
#include "services/model_proto/configuration_codec.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/log.h"

namespace rips::sensor {
namespace {

// Paths, values and sources, and what their fields take.
constexpr size_t kFileBytesMax = 4 * model_proto::kConfigurationBytesMax;

absl::StatusOr<std::vector<ConfigSetting>> Load(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(path, kFileBytesMax));
  rips::v1::Configuration configuration;
  if (!configuration.ParseFromString(bytes)) {
    return absl::DataLossError("it is not what a sensor has written");
  }
  return model_proto::Decode(model_proto::Bounded(configuration));
}

bool Same(const std::vector<ConfigSetting>& a, const std::vector<ConfigSetting>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const ConfigSetting& one, const ConfigSetting& other) {
                      return one.path == other.path && one.value == other.value;
                    });
}

}  // namespace

std::string ServerSettingsFile(const std::string& state_dir) {
  return absl::StrCat(state_dir, "/server_settings");
}

ServerSettings::ServerSettings(std::string path) : path_(std::move(path)) {
  absl::StatusOr<std::vector<ConfigSetting>> kept = Load(path_);
  if (kept.ok()) {
    MutexLock lock(&mu_);
    settings_ = *std::move(kept);
  } else if (!absl::IsNotFound(kept.status())) {
    LogWarning("cannot use the settings that the policy server made; following the file alone",
               {{"file", path_}, {"error", kept.status().ToString()}});
  }
}

void ServerSettings::Offer(std::vector<ConfigSetting> offered) {
  for (ConfigSetting& each : offered) {
    each.source = absl::StrCat("policy server, ", each.source);
  }
  {
    MutexLock lock(&mu_);
    if (settings_ == offered) return;
    settings_ = offered;
  }
  const rips::v1::Configuration wire = model_proto::Encode(offered);
  if (absl::Status saved = WriteFileAtomically(path_, wire.SerializeAsString()); !saved.ok()) {
    LogWarning("cannot keep the policy server's settings; they are lost at the next start",
               {{"file", path_}, {"error", saved.ToString()}});
  }
}

std::vector<ConfigSetting> ServerSettings::Get() const {
  MutexLock lock(&mu_);
  return settings_;
}

bool ServerSettings::Differ(const std::vector<ConfigSetting>& followed) const {
  MutexLock lock(&mu_);
  return !Same(settings_, followed);
}

}  // namespace rips::sensor

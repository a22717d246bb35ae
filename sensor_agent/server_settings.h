// What the policy server sets of the sensor's configuration, kept over restarts: a sensor that
// starts while the server is away watches as it did.
#ifndef RIPS_SENSOR_AGENT_SERVER_SETTINGS_H_
#define RIPS_SENSOR_AGENT_SERVER_SETTINGS_H_

#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "services/base/config_setting.h"
#include "services/runtime/mutex.h"

namespace rips::sensor {

// Any thread.
class ServerSettings {
 public:
  // Takes what `path` holds. A file that cannot be used is logged, and counts as none.
  explicit ServerSettings(std::string path);

  // The server says what it sets: all of it, each time. Kept if it is news.
  void Offer(std::vector<ConfigSetting> offered) ABSL_LOCKS_EXCLUDED(mu_);
  // What is to be followed.
  std::vector<ConfigSetting> Get() const ABSL_LOCKS_EXCLUDED(mu_);
  // True if the server has set something else than `followed`; where it stands in the inventory is
  // no matter.
  bool Differ(const std::vector<ConfigSetting>& followed) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  const std::string path_;
  mutable Mutex mu_;
  std::vector<ConfigSetting> settings_ ABSL_GUARDED_BY(mu_);
};

// In the directory of a sensor's state.
std::string ServerSettingsFile(const std::string& state_dir);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_SERVER_SETTINGS_H_

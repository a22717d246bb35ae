// One setting of a daemon, as it is in force.
#ifndef RIPS_SERVICES_BASE_CONFIG_SETTING_H_
#define RIPS_SERVICES_BASE_CONFIG_SETTING_H_

#include <string>

namespace rips {

struct ConfigSetting {
  // `outbox.memory`, `levels[1].enter[0].timeout`.
  std::string path;
  // As the file would have it: `64MiB`, `"r1"`, `["/rosout"]`.
  std::string value;
  // `FILE:LINE`; empty: no file says it, this is the default.
  std::string source;

  friend bool operator==(const ConfigSetting&, const ConfigSetting&) = default;
};

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_CONFIG_SETTING_H_

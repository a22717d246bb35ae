// An agent's effective configuration, in its hello and for operators.
#ifndef RIPS_SERVICES_MODEL_PROTO_CONFIGURATION_CODEC_H_
#define RIPS_SERVICES_MODEL_PROTO_CONFIGURATION_CODEC_H_

#include <cstddef>
#include <string>
#include <vector>

#include "rips/v1/session.pb.h"
#include "services/base/config_setting.h"

namespace rips::model_proto {

// Of paths, values and sources of one configuration, together: a server keeps one of each agent.
inline constexpr size_t kConfigurationBytesMax = 16 * 1024;
inline constexpr size_t kSettingsMax = 512;
// Of one of the three; of a longer one the start stands, with `...`.
inline constexpr size_t kSettingPathBytesMax = 256;
inline constexpr size_t kSettingTextBytesMax = 1'024;

inline constexpr size_t kRefusedMax = 64;

// The first settings that fit; the rest is counted. `refused` is cut to its limits.
rips::v1::Configuration Encode(const std::vector<ConfigSetting>& settings,
                               const std::vector<std::string>& refused = {});
std::vector<ConfigSetting> Decode(const rips::v1::Configuration& configuration);

// What a peer may have sent, within the same limits. All text is untrusted.
rips::v1::Configuration Bounded(const rips::v1::Configuration& configuration);

}  // namespace rips::model_proto

#endif  // RIPS_SERVICES_MODEL_PROTO_CONFIGURATION_CODEC_H_

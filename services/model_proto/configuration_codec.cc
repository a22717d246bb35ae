#include "services/model_proto/configuration_codec.h"

#include <algorithm>
#include <limits>
#include <string>
#include <utility>

#include "absl/strings/string_view.h"
#include "services/base/cut_text.h"
#include "services/text/escape.h"
#include "services/text/utf8.h"

namespace rips::model_proto {
namespace {

// As proto3 takes it: a peer that finds another byte refuses the whole message.
std::string AsUtf8(absl::string_view text, size_t bytes_max) {
  if (FindInvalidUtf8(text).has_value()) return Shortened(EscapeText(text), bytes_max);
  return Shortened(text, bytes_max);
}

// Adds it, or counts it if there is no room.
void Add(absl::string_view path, absl::string_view value, absl::string_view source, size_t& bytes,
         rips::v1::Configuration& out) {
  rips::v1::Setting setting;
  setting.set_path(AsUtf8(path, kSettingPathBytesMax));
  setting.set_value(AsUtf8(value, kSettingTextBytesMax));
  setting.set_source(AsUtf8(source, kSettingTextBytesMax));
  const size_t more = setting.path().size() + setting.value().size() + setting.source().size();
  // Once one is left out all are: what stands is the beginning.
  if (out.left_out() > 0 || static_cast<size_t>(out.settings_size()) == kSettingsMax ||
      bytes + more > kConfigurationBytesMax) {
    out.set_left_out(out.left_out() + 1);
    return;
  }
  bytes += more;
  *out.add_settings() = std::move(setting);
}

template <typename Texts>
void AddRefused(const Texts& refused, size_t& bytes, rips::v1::Configuration& out) {
  for (const std::string& each : refused) {
    std::string text = AsUtf8(each, kSettingTextBytesMax);
    const bool room = static_cast<size_t>(out.refused_size()) < kRefusedMax &&
                      bytes + text.size() <= kConfigurationBytesMax;
    if (!room) return;
    bytes += text.size();
    out.add_refused(std::move(text));
  }
}

}  // namespace

rips::v1::Configuration Encode(const std::vector<ConfigSetting>& settings,
                               const std::vector<std::string>& refused) {
  rips::v1::Configuration out;
  size_t bytes = 0;
  AddRefused(refused, bytes, out);
  for (const ConfigSetting& each : settings) Add(each.path, each.value, each.source, bytes, out);
  return out;
}

std::vector<ConfigSetting> Decode(const rips::v1::Configuration& configuration) {
  std::vector<ConfigSetting> settings;
  for (const rips::v1::Setting& each : configuration.settings()) {
    settings.push_back({.path = each.path(), .value = each.value(), .source = each.source()});
  }
  return settings;
}

rips::v1::Configuration Bounded(const rips::v1::Configuration& configuration) {
  rips::v1::Configuration out;
  size_t bytes = 0;
  AddRefused(configuration.refused(), bytes, out);
  for (const rips::v1::Setting& each : configuration.settings()) {
    Add(each.path(), each.value(), each.source(), bytes, out);
  }
  constexpr uint32_t kMost = std::numeric_limits<uint32_t>::max();
  const uint32_t room = kMost - out.left_out();
  out.set_left_out(out.left_out() + std::min(room, configuration.left_out()));
  return out;
}

}  // namespace rips::model_proto

// One line of an IDS log to an alert. Pure; any thread.
//
// | format        | written by                                                       |
// |---------------|------------------------------------------------------------------|
// | `eve`         | Suricata, `outputs: eve-log` with type alert                     |
// | `fast`        | Suricata `fast`, Snort 2 `-A fast`, Snort 3 `alert_fast`         |
// | `snort3_json` | Snort 3 `alert_json` with `fields` that name kSnort3FieldsNeeded |
#ifndef RIPS_SENSOR_AGENT_IDS_ALERT_PARSER_H_
#define RIPS_SENSOR_AGENT_IDS_ALERT_PARSER_H_

#include <optional>
#include <string>

#include "absl/strings/string_view.h"
#include "sensor_agent/outbox/observation.h"

namespace rips::sensor {

// Longer ones are cut between two characters.
inline constexpr size_t kIdsMessageBytesMax = 4 * 1024;
inline constexpr size_t kIdsLineBytesMax = 64 * 1024;

enum class IdsFormat { kEve, kFast, kSnort3Json };

// As in sensor.yaml.
absl::string_view IdsFormatName(IdsFormat format);

// What `fields` of Snort 3's alert_json must name; its default has no message and no signature id.
inline constexpr char kSnort3FieldsNeeded[] =
    "timestamp msg priority proto gid sid rev src_addr src_port dst_addr dst_port";

enum class IdsLineKind {
  kAlert,
  // Something else that belongs there: an event of another type, an empty line.
  kOther,
  kNotUnderstood,
};

struct IdsLine {
  IdsLineKind kind = IdsLineKind::kNotUnderstood;
  // If kAlert. All text is UTF-8; what was none in the log is U+FFFD here. Severity 0 = it does not
  // say. Addresses are `10.0.0.1`, `10.0.0.1:80`, `fe80::1` or `[fe80::1]:80`.
  IdsAlert alert;
  // snort3_json without message or signature id: what `fields` says is not enough. An alert if it
  // has one of the two.
  bool lacks_fields = false;
};

// `line` without its line break, any bytes.
IdsLine ParseIdsLine(IdsFormat format, absl::string_view line);

// The parts of ParseIdsLine. Not an alert: nullopt.
std::optional<IdsAlert> ParseFastAlert(absl::string_view line);
IdsLine ParseEveLine(absl::string_view line);
IdsLine ParseSnort3JsonLine(absl::string_view line);

// `text` with every byte that is no UTF-8 as U+FFFD, cut between two characters to at most
// `bytes_max` bytes.
std::string Utf8Only(absl::string_view text, size_t bytes_max);
// `10.0.0.1` and `80` to `10.0.0.1:80`, `fe80::1` and `80` to `[fe80::1]:80`, no port or 0 to the
// address alone. Empty if `address` is none.
std::string IdsEndpoint(absl::string_view address, absl::string_view port);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_IDS_ALERT_PARSER_H_

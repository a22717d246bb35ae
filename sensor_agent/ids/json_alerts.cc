// The formats with one JSON object a line.
#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/types/span.h"
#include "sensor_agent/ids/alert_parser.h"

namespace rips::sensor {

namespace {

// Takes the texts and numbers at some places of an object: `gid`, `alert.gid`. Of a place that is
// there twice the last. Nothing else is kept, however large or deep the line is.
class FieldReader {
 public:
  explicit FieldReader(absl::Span<const absl::string_view> wanted)
      : wanted_(wanted), values_(wanted.size()) {}

  // False if `line` is no JSON object.
  bool Read(absl::string_view line) {
    return nlohmann::json::sax_parse(line.begin(), line.end(), this) && object_;
  }

  // Empty if it is not there. Numbers as text.
  const std::string& Text(absl::string_view place) const {
    const auto it = std::find(wanted_.begin(), wanted_.end(), place);
    return values_[static_cast<size_t>(it - wanted_.begin())];
  }
  bool Has(absl::string_view place) const { return !Text(place).empty(); }
  // 0 if it is not there, or no number of that size.
  uint32_t Number(absl::string_view place) const {
    uint32_t number = 0;
    return absl::SimpleAtoi(Text(place), &number) ? number : 0;
  }

  // --- What the parser calls.
  bool null() { return true; }
  bool boolean(bool) { return true; }
  bool number_integer(int64_t value) { return Take(absl::StrCat(value)); }
  bool number_unsigned(uint64_t value) { return Take(absl::StrCat(value)); }
  bool number_float(double, const std::string&) { return true; }
  bool string(std::string& value) { return Take(std::move(value)); }
  bool binary(std::vector<uint8_t>&) { return true; }
  bool start_object(size_t) {
    if (depth_ == 0) object_ = true;
    ++depth_;
    return true;
  }
  bool key(std::string& name) {
    if (depth_ <= kDepth) keys_[depth_ - 1] = std::move(name);
    return true;
  }
  bool end_object() {
    --depth_;
    return true;
  }
  bool start_array(size_t) {
    ++depth_;
    ++arrays_;
    return true;
  }
  bool end_array() {
    --depth_;
    --arrays_;
    return true;
  }
  bool parse_error(size_t, const std::string&, const nlohmann::detail::exception&) { return false; }

 private:
  // Of the places that anybody wants.
  static constexpr size_t kDepth = 2;

  bool Take(std::string value) {
    if (arrays_ > 0 || depth_ == 0 || depth_ > kDepth) return true;
    const std::string place = depth_ == 1 ? keys_[0] : absl::StrCat(keys_[0], ".", keys_[1]);
    const auto it = std::find(wanted_.begin(), wanted_.end(), place);
    if (it != wanted_.end()) values_[static_cast<size_t>(it - wanted_.begin())] = std::move(value);
    return true;
  }

  const absl::Span<const absl::string_view> wanted_;
  std::vector<std::string> values_;
  std::array<std::string, kDepth> keys_;
  size_t depth_ = 0;
  size_t arrays_ = 0;
  bool object_ = false;
};

// What JSON allows in strings is UTF-8 only; an IDS may print the bytes of a rule as they are.
std::string Clean(absl::string_view line) {
  return Utf8Only(line, std::numeric_limits<size_t>::max());
}

// Without reading all of it: nearly all events of a busy network are of other types.
bool MayBeAlert(absl::string_view line) {
  constexpr absl::string_view kKey = "\"event_type\"";
  for (size_t at = line.find(kKey); at != absl::string_view::npos; at = line.find(kKey, at)) {
    at += kKey.size();
    const size_t value = line.find_first_not_of(" \t:", at);
    if (value != absl::string_view::npos && line.substr(value, 7) == "\"alert\"") return true;
  }
  return false;
}

constexpr absl::string_view kEvePlaces[] = {
    "event_type", "src_ip",    "src_port",           "dest_ip",         "dest_port",
    "alert.gid",  "alert.rev", "alert.signature_id", "alert.signature", "alert.severity"};

constexpr absl::string_view kSnort3Places[] = {"msg",      "priority", "gid",      "sid",
                                               "rev",      "rule",     "src_addr", "src_port",
                                               "dst_addr", "dst_port", "src_ap",   "dst_ap"};

// `address` and `port`, or both in one, `address:port`.
std::string Snort3Endpoint(const FieldReader& fields, absl::string_view address,
                           absl::string_view port, absl::string_view both) {
  if (fields.Has(address)) return IdsEndpoint(fields.Text(address), fields.Text(port));
  const absl::string_view text = fields.Text(both);
  const size_t colon = text.rfind(':');
  if (colon == absl::string_view::npos) return "";
  return IdsEndpoint(text.substr(0, colon), text.substr(colon + 1));
}

}  // namespace

IdsLine ParseEveLine(absl::string_view line) {
  if (!MayBeAlert(line)) {
    const bool object = absl::StripLeadingAsciiWhitespace(line).substr(0, 1) == "{";
    return {.kind = object ? IdsLineKind::kOther : IdsLineKind::kNotUnderstood};
  }
  FieldReader fields(kEvePlaces);
  if (!fields.Read(Clean(line))) return {.kind = IdsLineKind::kNotUnderstood};
  if (fields.Text("event_type") != "alert") return {.kind = IdsLineKind::kOther};
  if (fields.Number("alert.signature_id") == 0) return {.kind = IdsLineKind::kNotUnderstood};
  return {.kind = IdsLineKind::kAlert,
          .alert = {.source = "suricata",
                    .gid = fields.Number("alert.gid"),
                    .sid = fields.Number("alert.signature_id"),
                    .rev = fields.Number("alert.rev"),
                    .message = Utf8Only(fields.Text("alert.signature"), kIdsMessageBytesMax),
                    .severity = fields.Number("alert.severity"),
                    .src = IdsEndpoint(fields.Text("src_ip"), fields.Text("src_port")),
                    .dst = IdsEndpoint(fields.Text("dest_ip"), fields.Text("dest_port"))}};
}

IdsLine ParseSnort3JsonLine(absl::string_view line) {
  FieldReader fields(kSnort3Places);
  if (!fields.Read(Clean(line))) return {.kind = IdsLineKind::kNotUnderstood};
  IdsAlert alert{.source = "snort",
                 .gid = fields.Number("gid"),
                 .sid = fields.Number("sid"),
                 .rev = fields.Number("rev"),
                 .message = Utf8Only(fields.Text("msg"), kIdsMessageBytesMax),
                 .severity = fields.Number("priority"),
                 .src = Snort3Endpoint(fields, "src_addr", "src_port", "src_ap"),
                 .dst = Snort3Endpoint(fields, "dst_addr", "dst_port", "dst_ap")};
  // `gid:sid:rev`, in the default fields.
  const std::vector<std::string> rule = absl::StrSplit(fields.Text("rule"), ':');
  uint32_t numbers[3] = {};
  if (alert.sid == 0 && rule.size() == 3 && absl::SimpleAtoi(rule[0], &numbers[0]) &&
      absl::SimpleAtoi(rule[1], &numbers[1]) && absl::SimpleAtoi(rule[2], &numbers[2])) {
    alert.gid = numbers[0];
    alert.sid = numbers[1];
    alert.rev = numbers[2];
  }
  const bool lacks = alert.sid == 0 || !fields.Has("msg");
  if (alert.sid == 0 && alert.message.empty()) {
    return {.kind = IdsLineKind::kNotUnderstood, .lacks_fields = true};
  }
  return {.kind = IdsLineKind::kAlert, .alert = std::move(alert), .lacks_fields = lacks};
}

}  // namespace rips::sensor

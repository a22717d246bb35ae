#include "sensor_agent/ids/alert_parser.h"

#include <arpa/inet.h>

#include <algorithm>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"

namespace rips::sensor {

namespace {

constexpr absl::string_view kReplacement = "\xEF\xBF\xBD";  // U+FFFD

// Bytes of the UTF-8 character at the start of `text`; 0 if there is none (RFC 3629 §4).
size_t CharacterBytes(absl::string_view text) {
  const auto byte = [&](size_t i) { return static_cast<uint8_t>(text[i]); };
  const uint8_t first = byte(0);
  if (first < 0x80) return 1;
  const size_t bytes = first >= 0xF0 ? 4 : first >= 0xE0 ? 3 : 2;
  if (first < 0xC2 || first > 0xF4 || text.size() < bytes) return 0;
  for (size_t i = 1; i < bytes; ++i) {
    if ((byte(i) & 0xC0) != 0x80) return 0;
  }
  // Overlong forms, surrogates, and beyond U+10FFFF.
  const uint8_t second = byte(1);
  if ((first == 0xE0 && second < 0xA0) || (first == 0xED && second > 0x9F) ||
      (first == 0xF0 && second < 0x90) || (first == 0xF4 && second > 0x8F)) {
    return 0;
  }
  return bytes;
}

bool IsAddress(const std::string& text, int family) {
  unsigned char bytes[sizeof(in6_addr)];
  // What is behind a NUL would not be looked at.
  if (text.find('\0') != std::string::npos) return false;
  return inet_pton(family, text.c_str(), bytes) == 1;
}

// --- Lines of free text

// Takes `N` up to `after`, and that; false if there is no such number.
bool TakeNumber(absl::string_view& text, absl::string_view after, uint32_t& out) {
  const size_t end = text.find(after);
  if (end == absl::string_view::npos) return false;
  const absl::string_view digits = text.substr(0, end);
  if (digits.empty() || !std::all_of(digits.begin(), digits.end(), absl::ascii_isdigit)) {
    return false;
  }
  if (!absl::SimpleAtoi(digits, &out)) return false;
  text.remove_prefix(end + after.size());
  return true;
}

// `MM/DD[/YY[YY]]-HH:MM:SS.uuuuuu`; the digits of the year, or nullopt if it is none.
std::optional<size_t> YearDigits(absl::string_view stamp) {
  const size_t dash = stamp.find('-');
  if (dash == absl::string_view::npos) return std::nullopt;
  const absl::string_view date = stamp.substr(0, dash);
  const absl::string_view time = stamp.substr(dash + 1);
  const auto only = [](absl::string_view text, absl::string_view also) {
    return !text.empty() && absl::ascii_isdigit(static_cast<unsigned char>(text[0])) &&
           std::all_of(text.begin(), text.end(), [&](char c) {
             return absl::ascii_isdigit(static_cast<unsigned char>(c)) ||
                    also.find(c) != absl::string_view::npos;
           });
  };
  const auto slashes = std::count(date.begin(), date.end(), '/');
  if (!only(date, "/") || !only(time, ":.") || slashes < 1 || slashes > 2) return std::nullopt;
  return slashes == 1 ? 0 : date.size() - date.rfind('/') - 1;
}

// `address[:port]` as fast formats write it: an IPv6 address is not in brackets, so the port is
// behind the last colon. Protocols without ports have none, and then all of it may be the address.
std::string FastEndpoint(absl::string_view text, bool has_port) {
  const std::string whole(text);
  if (IsAddress(whole, AF_INET) || (!has_port && IsAddress(whole, AF_INET6))) return whole;
  const size_t colon = text.rfind(':');
  if (colon != absl::string_view::npos) {
    std::string split = IdsEndpoint(text.substr(0, colon), text.substr(colon + 1));
    if (!split.empty()) return split;
  }
  return IdsEndpoint(text, "");
}

// `[Priority: 3] {UDP} 10.0.0.1:1 -> 10.0.0.2:2`, each part if it is there.
void TakeTail(absl::string_view tail, IdsAlert& alert) {
  constexpr absl::string_view kPriority = "[Priority: ";
  if (const size_t at = tail.rfind(kPriority); at != absl::string_view::npos) {
    absl::string_view rest = tail.substr(at + kPriority.size());
    uint32_t priority = 0;
    if (TakeNumber(rest, "]", priority)) {
      alert.severity = priority;
      tail = rest;
    }
  }
  const size_t open = tail.rfind('{');
  if (open == absl::string_view::npos) return;
  const size_t close = tail.find("} ", open);
  if (close == absl::string_view::npos) return;
  const absl::string_view protocol = tail.substr(open + 1, close - open - 1);
  const bool has_port = protocol == "TCP" || protocol == "UDP" || protocol == "SCTP";
  const absl::string_view ends = absl::StripTrailingAsciiWhitespace(tail.substr(close + 2));
  const size_t arrow = ends.find(" -> ");
  if (arrow == absl::string_view::npos) return;
  alert.src = FastEndpoint(ends.substr(0, arrow), has_port);
  alert.dst = FastEndpoint(ends.substr(arrow + 4), has_port);
}

}  // namespace

absl::string_view IdsFormatName(IdsFormat format) {
  switch (format) {
    case IdsFormat::kEve:
      return "eve";
    case IdsFormat::kFast:
      return "fast";
    case IdsFormat::kSnort3Json:
      return "snort3_json";
  }
  return "";
}

std::string Utf8Only(absl::string_view text, size_t bytes_max) {
  std::string out;
  out.reserve(std::min(text.size(), bytes_max));
  while (!text.empty()) {
    const size_t bytes = CharacterBytes(text);
    const absl::string_view character = bytes == 0 ? kReplacement : text.substr(0, bytes);
    if (out.size() + character.size() > bytes_max) break;
    out.append(character.data(), character.size());
    text.remove_prefix(std::max<size_t>(bytes, 1));
  }
  return out;
}

std::string IdsEndpoint(absl::string_view address, absl::string_view port) {
  if (address.size() > INET6_ADDRSTRLEN) return "";
  const std::string text(address);
  const bool v6 = IsAddress(text, AF_INET6);
  if (!v6 && !IsAddress(text, AF_INET)) return "";
  if (port.empty() || port == "0") return text;
  uint32_t number = 0;
  if (!std::all_of(port.begin(), port.end(), absl::ascii_isdigit) ||
      !absl::SimpleAtoi(port, &number) || number > 65'535) {
    return "";
  }
  return v6 ? absl::StrCat("[", text, "]:", number) : absl::StrCat(text, ":", number);
}

std::optional<IdsAlert> ParseFastAlert(absl::string_view line) {
  constexpr absl::string_view kMark = "[**]";
  IdsAlert alert;
  const size_t space = line.find(' ');
  if (space == absl::string_view::npos) return std::nullopt;
  const std::optional<size_t> year = YearDigits(line.substr(0, space));
  if (!year.has_value()) return std::nullopt;
  alert.source = *year == 4 ? "suricata" : "snort";
  // Between the time and the first mark: `[Drop]`, `<eth0>`.
  const size_t first = line.find(kMark, space);
  if (first == absl::string_view::npos) return std::nullopt;
  absl::string_view rest = line.substr(first + kMark.size());
  if (!absl::ConsumePrefix(&rest, " [") || !TakeNumber(rest, ":", alert.gid) ||
      !TakeNumber(rest, ":", alert.sid) || !TakeNumber(rest, "]", alert.rev)) {
    return std::nullopt;
  }
  // The message is the rule author's and may hold anything; what follows it never holds a mark.
  const size_t last = rest.rfind(kMark);
  if (last == absl::string_view::npos) return std::nullopt;
  absl::string_view message = absl::StripAsciiWhitespace(rest.substr(0, last));
  // Snort 3 prints it as the rule has it.
  if (message.size() >= 2 && message.front() == '"' && message.back() == '"') {
    message = message.substr(1, message.size() - 2);
  }
  alert.message = Utf8Only(message, kIdsMessageBytesMax);
  TakeTail(rest.substr(last + kMark.size()), alert);
  alert.line = Utf8Only(line, kIdsLineBytesMax);
  return alert;
}

IdsLine ParseIdsLine(IdsFormat format, absl::string_view line) {
  if (absl::StripAsciiWhitespace(line).empty()) return {.kind = IdsLineKind::kOther};
  switch (format) {
    case IdsFormat::kEve:
      return ParseEveLine(line);
    case IdsFormat::kSnort3Json:
      return ParseSnort3JsonLine(line);
    case IdsFormat::kFast:
      break;
  }
  std::optional<IdsAlert> alert = ParseFastAlert(line);
  if (!alert.has_value()) return {.kind = IdsLineKind::kNotUnderstood};
  return {.kind = IdsLineKind::kAlert, .alert = *std::move(alert)};
}

}  // namespace rips::sensor

#include "mode_actuator/steps/firewall/fw_message.h"

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "mode_actuator/steps/firewall/target.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::actuator {
namespace {

constexpr absl::string_view kMagic = "rips-fw 1";
constexpr size_t kPathBytesMax = 4096;
constexpr size_t kTargetBytesMax = 48;

using Kind = FirewallStep::Kind;
constexpr std::pair<absl::string_view, FwVerb> kVerbs[] = {{"enter", FwVerb::kEnter},
                                                           {"check", FwVerb::kCheck},
                                                           {"try", FwVerb::kTry},
                                                           {"status", FwVerb::kStatus}};
constexpr std::pair<absl::string_view, Kind> kKinds[] = {
    {"rules", Kind::kRules},
    {"isolate_hosts", Kind::kIsolateHosts},
    {"isolate_participants", Kind::kIsolateParticipants},
    {"release", Kind::kRelease}};

template <typename Table, typename Value>
absl::string_view NameOf(const Table& table, Value value) {
  for (const auto& [name, each] : table) {
    if (each == value) return name;
  }
  return "";
}

template <typename Table, typename Value>
bool FindName(const Table& table, absl::string_view name, Value* value) {
  for (const auto& [each, found] : table) {
    if (each != name) continue;
    *value = found;
    return true;
  }
  return false;
}

absl::Status Malformed(absl::string_view why) {
  return absl::InvalidArgumentError(absl::StrCat("malformed request: ", why));
}

// `key value` lines below the first one. False if the packet has another shape.
bool SplitLines(absl::string_view packet,
                std::vector<std::pair<absl::string_view, absl::string_view>>* lines) {
  if (!absl::StartsWith(packet, kMagic) || !absl::EndsWith(packet, "\n")) return false;
  packet.remove_suffix(1);
  const std::vector<absl::string_view> rows = absl::StrSplit(packet, '\n');
  if (rows[0] != kMagic) return false;
  for (size_t i = 1; i < rows.size(); ++i) {
    const size_t space = rows[i].find(' ');
    if (space == 0 || space == absl::string_view::npos) return false;
    lines->emplace_back(rows[i].substr(0, space), rows[i].substr(space + 1));
  }
  return true;
}

absl::Status ReadFor(absl::string_view value, absl::Duration* hold_for) {
  int64_t ms = 0;
  if (!absl::SimpleAtoi(value, &ms) || ms < 1 || absl::Milliseconds(ms) > kFirewallForMax) {
    return Malformed(
        absl::StrCat("`for_ms` must be from 1 to ", absl::ToInt64Milliseconds(kFirewallForMax)));
  }
  *hold_for = absl::Milliseconds(ms);
  return absl::OkStatus();
}

absl::Status CheckShape(const FwRequest& request, bool has_verb, bool has_kind, bool has_for) {
  const FirewallStep& step = request.step;
  if (!has_verb) return Malformed("no verb");
  const bool status = request.verb == FwVerb::kStatus;
  if (has_kind == status) return Malformed(status ? "`status` takes no step" : "no kind");
  const bool rules = has_kind && step.kind == Kind::kRules;
  const bool targets =
      has_kind && (step.kind == Kind::kIsolateHosts || step.kind == Kind::kIsolateParticipants);
  if (rules == step.file.empty()) return Malformed("`file` is for `rules`, which needs it");
  if (targets == step.targets.empty())
    return Malformed("`target` is for isolation, which needs it");
  if (has_for != (rules || targets)) return Malformed("`for_ms` is for what ends by itself");
  return absl::OkStatus();
}

std::string Line(absl::string_view key, absl::string_view text) {
  if (text.empty()) return "";
  // One line of plain characters, whatever it was made from.
  std::string plain;
  for (const char c : text.substr(0, kFwTextBytesMax)) {
    plain.push_back(c == '\n' ? '|' : (c >= 0x20 && c < 0x7f ? c : '?'));
  }
  return absl::StrCat(key, " ", plain, "\n");
}

}  // namespace

std::string EncodeFwRequest(const FwRequest& request) {
  std::string packet = absl::StrCat(kMagic, "\nverb ", NameOf(kVerbs, request.verb), "\n");
  if (request.verb == FwVerb::kStatus) return packet;
  const FirewallStep& step = request.step;
  absl::StrAppend(&packet, "kind ", NameOf(kKinds, step.kind), "\n");
  if (step.kind == Kind::kRelease) return packet;
  if (step.kind == Kind::kRules) {
    absl::StrAppend(&packet, "file ", step.file, "\n");
  } else {
    for (const std::string& target : step.targets) {
      absl::StrAppend(&packet, "target ", target, "\n");
    }
  }
  absl::StrAppend(&packet, "for_ms ", absl::ToInt64Milliseconds(step.hold_for), "\n");
  return packet;
}

absl::StatusOr<FwRequest> DecodeFwRequest(absl::string_view packet) {
  if (packet.size() > kFwPacketBytesMax) {
    return Malformed(absl::StrCat("a packet exceeds limit ", kFwPacketBytesMax, " bytes"));
  }
  std::vector<std::pair<absl::string_view, absl::string_view>> lines;
  if (!SplitLines(packet, &lines)) return Malformed("no lines of `rips-fw 1`");
  FwRequest request;
  bool has_verb = false, has_kind = false, has_for = false;
  for (const auto& [key, value] : lines) {
    if (key == "verb" && !std::exchange(has_verb, true)) {
      if (!FindName(kVerbs, value, &request.verb)) return Malformed("unknown verb");
    } else if (key == "kind" && !std::exchange(has_kind, true)) {
      if (!FindName(kKinds, value, &request.step.kind)) return Malformed("unknown kind");
    } else if (key == "file" && request.step.file.empty()) {
      if (value.empty() || value.size() > kPathBytesMax) return Malformed("no file name");
      request.step.file = std::string(value);
    } else if (key == "target" && request.step.targets.size() < kTargetsMax) {
      if (value.empty() || value.size() > kTargetBytesMax) return Malformed("no target");
      request.step.targets.emplace_back(value);
    } else if (key == "for_ms" && !std::exchange(has_for, true)) {
      RIPS_RETURN_IF_ERROR(ReadFor(value, &request.step.hold_for));
    } else if (key == "target") {
      return Malformed(absl::StrCat("targets exceed limit ", kTargetsMax));
    } else {
      return Malformed(
          absl::StrCat("unknown or repeated line `", ros2::Printable(key.substr(0, 20)), "`"));
    }
  }
  RIPS_RETURN_IF_ERROR(CheckShape(request, has_verb, has_kind, has_for));
  // Strict by printing it again: order, forms of numbers.
  if (EncodeFwRequest(request) != packet) return Malformed("lines out of place");
  return request;
}

std::string EncodeFwResponse(const FwResponse& response) {
  return absl::StrCat(kMagic, "\ncode ", static_cast<int>(response.status.code()), "\n",
                      Line("message", response.status.message()),
                      Line("observed", response.observed), Line("note", response.note));
}

absl::StatusOr<FwResponse> DecodeFwResponse(absl::string_view packet) {
  const absl::Status bad = absl::DataLossError("rips-fw sent a malformed reply");
  std::vector<std::pair<absl::string_view, absl::string_view>> lines;
  if (packet.size() > kFwPacketBytesMax || !SplitLines(packet, &lines)) return bad;
  FwResponse response;
  int code = -1;
  std::string message;
  for (const auto& [key, value] : lines) {
    if (key == "code" && code < 0) {
      if (!absl::SimpleAtoi(value, &code) || code < 0 || code > 16) return bad;
    } else if (key == "message" && message.empty()) {
      message = std::string(value);
    } else if (key == "observed" && response.observed.empty()) {
      response.observed = std::string(value);
    } else if (key == "note" && response.note.empty()) {
      response.note = std::string(value);
    } else {
      return bad;
    }
  }
  if (code < 0) return bad;
  response.status = absl::Status(static_cast<absl::StatusCode>(code), message);
  // Strict by printing it again: order, forms of numbers, characters.
  if (EncodeFwResponse(response) != packet) return bad;
  return response;
}

}  // namespace rips::actuator

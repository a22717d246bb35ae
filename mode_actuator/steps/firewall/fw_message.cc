#include "mode_actuator/steps/firewall/fw_message.h"

#include <algorithm>
#include <cstdint>

#include "absl/strings/str_cat.h"
#include "mode_actuator/steps/firewall/target.h"
#include "rips/v1/helper.pb.h"
#include "services/base/status_macros.h"

namespace rips::actuator {
namespace {

using Kind = FirewallStep::Kind;

static_assert(static_cast<int>(FwVerb::kEnter) == v1::FW_VERB_ENTER);
static_assert(static_cast<int>(FwVerb::kCheck) == v1::FW_VERB_CHECK);
static_assert(static_cast<int>(FwVerb::kTry) == v1::FW_VERB_TRY);
static_assert(static_cast<int>(FwVerb::kStatus) == v1::FW_VERB_STATUS);
static_assert(static_cast<int>(Kind::kRules) == v1::FW_KIND_RULES);
static_assert(static_cast<int>(Kind::kIsolateHosts) == v1::FW_KIND_ISOLATE_HOSTS);
static_assert(static_cast<int>(Kind::kIsolateParticipants) == v1::FW_KIND_ISOLATE_PARTICIPANTS);
static_assert(static_cast<int>(Kind::kRelease) == v1::FW_KIND_RELEASE);
constexpr size_t kPathBytesMax = 4096;
constexpr size_t kTargetBytesMax = 48;
constexpr uint32_t kCodeMax = 16;  // the last of absl::StatusCode

absl::Status Malformed(absl::string_view why) {
  return absl::InvalidArgumentError(absl::StrCat("malformed request: ", why));
}

template <typename Wire>
bool Parse(absl::string_view packet, Wire* wire) {
  return wire->ParseFromArray(packet.data(), static_cast<int>(packet.size()));
}

// On one line, without bytes that a file's name or a target never has.
bool IsName(const std::string& text, size_t bytes_max) {
  return !text.empty() && text.size() <= bytes_max &&
         text.find_first_of("\n\0", 0, 2) == std::string::npos;
}

// One line of plain characters, whatever it was made from.
std::string Plain(absl::string_view text) {
  std::string plain(text.substr(0, kFwTextBytesMax));
  for (char& c : plain) c = c == '\n' ? '|' : (c >= 0x20 && c < 0x7f ? c : '?');
  return plain;
}

bool SourcesFit(const std::optional<DropCount>& dropped) {
  if (!dropped.has_value()) return true;
  return dropped->sources.size() <= model::kDropSourcesMax &&
         std::all_of(dropped->sources.begin(), dropped->sources.end(), [](const auto& source) {
           return source.address.size() <= model::kDropAddressBytesMax;
         });
}

absl::Status CheckStep(const FirewallStep& step) {
  if (step.kind == Kind::kRules && !IsName(step.file, kPathBytesMax)) {
    return Malformed("no file name");
  }
  if (step.targets.size() > kTargetsMax) {
    return Malformed(absl::StrCat("targets exceed limit ", kTargetsMax));
  }
  const auto is_target = [](const std::string& text) { return IsName(text, kTargetBytesMax); };
  const bool isolates = step.kind == Kind::kIsolateHosts || step.kind == Kind::kIsolateParticipants;
  if ((isolates && step.targets.empty()) ||
      !std::all_of(step.targets.begin(), step.targets.end(), is_target)) {
    return Malformed("no target");
  }
  if (step.kind != Kind::kRelease &&
      (step.hold_for <= absl::ZeroDuration() || step.hold_for > kFirewallForMax)) {
    return Malformed(
        absl::StrCat("`for_ms` must be from 1 to ", absl::ToInt64Milliseconds(kFirewallForMax)));
  }
  return absl::OkStatus();
}

absl::Status Decode(const v1::FwRequest& wire, FwRequest* request) {
  if (wire.verb() == v1::FW_VERB_UNSPECIFIED) return Malformed("no verb");
  if (!v1::FwVerb_IsValid(wire.verb())) return Malformed("unknown verb");
  request->verb = static_cast<FwVerb>(wire.verb());
  if (request->verb == FwVerb::kStatus) return absl::OkStatus();
  if (wire.kind() == v1::FW_KIND_UNSPECIFIED) return Malformed("no kind");
  if (!v1::FwKind_IsValid(wire.kind())) return Malformed("unknown kind");
  FirewallStep& step = request->step;
  step.kind = static_cast<Kind>(wire.kind());
  step.file = wire.file();
  step.targets = {wire.targets().begin(), wire.targets().end()};
  if (wire.has_for_ms()) step.hold_for = absl::Milliseconds(wire.for_ms());
  return CheckStep(step);
}

}  // namespace

std::string EncodeFwRequest(const FwRequest& request) {
  v1::FwRequest wire;
  wire.set_verb(static_cast<v1::FwVerb>(request.verb));
  if (request.verb == FwVerb::kStatus) return wire.SerializeAsString();
  const FirewallStep& step = request.step;
  wire.set_kind(static_cast<v1::FwKind>(step.kind));
  if (step.kind == Kind::kRelease) return wire.SerializeAsString();
  if (step.kind == Kind::kRules) {
    wire.set_file(step.file);
  } else {
    *wire.mutable_targets() = {step.targets.begin(), step.targets.end()};
  }
  wire.set_for_ms(absl::ToInt64Milliseconds(step.hold_for));
  return wire.SerializeAsString();
}

absl::StatusOr<FwRequest> DecodeFwRequest(absl::string_view packet) {
  if (packet.size() > kFwPacketBytesMax) {
    return Malformed(absl::StrCat("a packet exceeds limit ", kFwPacketBytesMax, " bytes"));
  }
  v1::FwRequest wire;
  if (!Parse(packet, &wire)) return Malformed("not an FwRequest");
  FwRequest request;
  RIPS_RETURN_IF_ERROR(Decode(wire, &request));
  // Strict by encoding it again: order, too.
  if (EncodeFwRequest(request) != packet) {
    return Malformed("a field is unknown, missing, repeated or out of place");
  }
  return request;
}

std::string EncodeFwResponse(const FwResponse& response) {
  v1::FwResponse wire;
  wire.set_code(static_cast<uint32_t>(response.status.code()));
  wire.set_message(Plain(response.status.message()));
  wire.set_observed(Plain(response.observed));
  wire.set_note(Plain(response.note));
  if (response.dropped.has_value()) {
    wire.set_dropped(response.dropped->packets);
    for (const model::DropSource& source : response.dropped->sources) {
      v1::FwSource& out = *wire.add_sources();
      out.set_address(Plain(source.address));
      out.set_packets(source.packets);
      out.set_quiet_s(source.quiet_s);
    }
    wire.set_more_sources(response.dropped->more_sources);
  }
  return wire.SerializeAsString();
}

absl::StatusOr<FwResponse> DecodeFwResponse(absl::string_view packet) {
  v1::FwResponse wire;
  if (packet.size() <= kFwPacketBytesMax && Parse(packet, &wire) && wire.code() <= kCodeMax) {
    const auto code = static_cast<absl::StatusCode>(wire.code());
    FwResponse response = {absl::Status(code, wire.message()), wire.observed(), wire.note(), {}};
    if (wire.has_dropped()) {
      response.dropped = {.packets = wire.dropped(), .more_sources = wire.more_sources()};
      for (const v1::FwSource& source : wire.sources()) {
        response.dropped->sources.push_back({source.address(), source.packets(), source.quiet_s()});
      }
    }
    // Strict by encoding it again: unknown, missing and repeated fields, order, characters.
    if (SourcesFit(response.dropped) && EncodeFwResponse(response) == packet) return response;
  }
  return absl::DataLossError("rips-fw sent a malformed reply");
}

}  // namespace rips::actuator

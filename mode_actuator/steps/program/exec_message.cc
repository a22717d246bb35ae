#include "mode_actuator/steps/program/exec_message.h"

#include <poll.h>

#include <algorithm>
#include <cstdint>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "rips/v1/helper.pb.h"
#include "services/base/status_macros.h"
#include "services/local_socket/helper_socket.h"

namespace rips::actuator {
namespace {

using Kind = ExecAnswer::Kind;

static_assert(static_cast<int>(ExecVerb::kStart) == v1::EXEC_VERB_START);
static_assert(static_cast<int>(ExecVerb::kCancel) == v1::EXEC_VERB_CANCEL);
static_assert(static_cast<int>(ExecVerb::kExamine) == v1::EXEC_VERB_EXAMINE);
static_assert(static_cast<int>(Kind::kExamined) == v1::EXEC_KIND_EXAMINED);
static_assert(static_cast<int>(Kind::kBegun) == v1::EXEC_KIND_BEGUN);
static_assert(static_cast<int>(Kind::kEnded) == v1::EXEC_KIND_ENDED);
constexpr uint32_t kCodeMax = 16;  // the last of absl::StatusCode
constexpr uint32_t kExitCodeMax = 255;

template <typename Wire>
bool Parse(absl::string_view message, Wire* wire) {
  return message.size() <= kExecMessageBytesMax &&
         wire->ParseFromArray(message.data(), static_cast<int>(message.size()));
}

std::string Cut(absl::string_view text) { return std::string(text.substr(0, kExecTextBytesMax)); }

bool IsName(const std::string& text) {
  return text.size() <= kProgramNameBytesMax && text.find('\0') == std::string::npos;
}

bool Decode(const v1::ExecCall& wire, ExecCall* call) {
  if (static_cast<size_t>(wire.args_size()) > kArgsMax) return false;
  call->verb = static_cast<ExecVerb>(wire.verb());
  ProgramRequest& program = call->program;
  program.name = wire.name();
  program.args = {wire.args().begin(), wire.args().end()};
  program.timeout =
      wire.has_timeout_ms() ? absl::Milliseconds(wire.timeout_ms()) : absl::InfiniteDuration();
  program.drill = wire.drill();
  program.level_from = wire.level_from();
  program.level_to = wire.level_to();
  return wire.verb() != v1::EXEC_VERB_UNSPECIFIED && v1::ExecVerb_IsValid(wire.verb()) &&
         IsName(program.name) && CheckProgramArgs(program.args).ok() &&
         IsName(program.level_from) && IsName(program.level_to);
}

bool Decode(const v1::ExecAnswer& wire, ExecAnswer* answer) {
  if (wire.code() > kCodeMax || wire.exit_code() > kExitCodeMax) return false;
  answer->kind = static_cast<Kind>(wire.kind());
  answer->timeout = absl::Milliseconds(wire.timeout_ms());
  answer->result = {
      .status = absl::Status(static_cast<absl::StatusCode>(wire.code()), wire.message()),
      .begun = wire.begun(),
      .exit_code = static_cast<int>(wire.exit_code()),
      .output_tail = wire.output_tail(),
      .note = wire.note(),
      .output_bytes = wire.output_bytes(),
      .took_ms = wire.took_ms()};
  return wire.kind() != v1::EXEC_KIND_UNSPECIFIED && v1::ExecKind_IsValid(wire.kind()) &&
         wire.output_bytes() <= INT64_MAX && wire.output_tail().size() <= kOutputBytesMax;
}

}  // namespace

absl::Status CheckProgramArgs(const std::vector<std::string>& args) {
  if (args.size() > kArgsMax) {
    return absl::InvalidArgumentError(
        absl::StrCat(args.size(), " arguments exceed limit ", kArgsMax));
  }
  for (const std::string& arg : args) {
    if (arg.size() > kArgBytesMax) {
      return absl::InvalidArgumentError(
          absl::StrCat("an argument of ", arg.size(), " bytes exceeds limit ", kArgBytesMax));
    }
    if (arg.find('\0') != std::string::npos) {
      return absl::InvalidArgumentError("an argument holds a NUL byte");
    }
  }
  return absl::OkStatus();
}

std::string EncodeExecCall(const ExecCall& call) {
  v1::ExecCall wire;
  wire.set_verb(static_cast<v1::ExecVerb>(call.verb));
  if (call.verb == ExecVerb::kCancel) return wire.SerializeAsString();
  const ProgramRequest& program = call.program;
  wire.set_name(program.name);
  if (call.verb == ExecVerb::kExamine) return wire.SerializeAsString();
  *wire.mutable_args() = {program.args.begin(), program.args.end()};
  if (program.timeout > absl::ZeroDuration() && program.timeout <= kExecTimeoutMax) {
    const int64_t ms = std::max<int64_t>(1, absl::ToInt64Milliseconds(program.timeout));
    wire.set_timeout_ms(static_cast<uint32_t>(ms));
  }
  wire.set_drill(program.drill);
  wire.set_level_from(program.level_from);
  wire.set_level_to(program.level_to);
  return wire.SerializeAsString();
}

absl::StatusOr<ExecCall> DecodeExecCall(absl::string_view message) {
  v1::ExecCall wire;
  ExecCall call;
  // Strict by encoding it again: fields that are unknown, missing, repeated or of another verb.
  if (!Parse(message, &wire) || !Decode(wire, &call) || EncodeExecCall(call) != message) {
    return absl::InvalidArgumentError("malformed: not a call of rips-exec");
  }
  return call;
}

std::string EncodeExecAnswer(const ExecAnswer& answer) {
  v1::ExecAnswer wire;
  wire.set_kind(static_cast<v1::ExecKind>(answer.kind));
  if (answer.kind == Kind::kBegun) {
    wire.set_timeout_ms(static_cast<uint32_t>(absl::ToInt64Milliseconds(
        std::clamp(answer.timeout, absl::ZeroDuration(), kExecTimeoutMax))));
    return wire.SerializeAsString();
  }
  const ProgramResult& result = answer.result;
  wire.set_code(static_cast<uint32_t>(result.status.code()));
  wire.set_message(Cut(result.status.message()));
  if (answer.kind == Kind::kExamined) return wire.SerializeAsString();
  wire.set_begun(result.begun);
  wire.set_exit_code(static_cast<uint32_t>(result.exit_code));
  wire.set_output_bytes(result.output_bytes);
  wire.set_output_tail(result.output_tail);
  wire.set_took_ms(result.took_ms);
  wire.set_note(Cut(result.note));
  return wire.SerializeAsString();
}

absl::StatusOr<ExecAnswer> DecodeExecAnswer(absl::string_view message) {
  v1::ExecAnswer wire;
  ExecAnswer answer;
  if (!Parse(message, &wire) || !Decode(wire, &answer) || EncodeExecAnswer(answer) != message) {
    return absl::DataLossError("rips-exec sent a malformed reply");
  }
  return answer;
}

std::vector<std::string> SplitIntoPackets(absl::string_view message) {
  std::vector<std::string> packets;
  do {
    const absl::string_view part = message.substr(0, kExecPacketBytesMax - 1);
    message.remove_prefix(part.size());
    packets.push_back(absl::StrCat(message.empty() ? "." : "+", part));
  } while (!message.empty());
  return packets;
}

absl::StatusOr<bool> PacketJoiner::Add(absl::string_view packet, std::string* message) {
  const bool last = absl::ConsumePrefix(&packet, ".");
  // A part that holds nothing would make a message of no end.
  if (!last && (!absl::ConsumePrefix(&packet, "+") || packet.empty())) {
    return absl::InvalidArgumentError("malformed: not a packet of rips-exec");
  }
  if (parts_.size() + packet.size() > kExecMessageBytesMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat("a message exceeds limit ", kExecMessageBytesMax, " bytes"));
  }
  parts_.append(packet.data(), packet.size());
  if (last) *message = std::exchange(parts_, "");
  return last;
}

void ExecChannel::Send(absl::string_view message) {
  for (std::string& packet : SplitIntoPackets(message)) out_.push_back(std::move(packet));
}

absl::Status ExecChannel::Flush() {
  while (!out_.empty()) {
    const absl::Status sent = SendPacket(fd_.get(), out_.front());
    if (absl::IsUnavailable(sent)) return absl::OkStatus();
    if (!sent.ok()) {
      out_.clear();
      return sent;
    }
    out_.pop_front();
  }
  return absl::OkStatus();
}

absl::StatusOr<std::optional<std::string>> ExecChannel::Receive() {
  while (true) {
    const absl::StatusOr<std::string> packet = ReceivePacket(fd_.get(), kExecPacketBytesMax);
    if (absl::IsUnavailable(packet.status())) return std::nullopt;
    RIPS_RETURN_IF_ERROR(packet.status());
    std::string message;
    RIPS_ASSIGN_OR_RETURN(const bool whole, joiner_.Add(*packet, &message));
    if (whole) return message;
  }
}

short ExecChannel::events() const {
  return static_cast<short>(POLLIN | POLLRDHUP | (out_.empty() ? 0 : POLLOUT));
}

}  // namespace rips::actuator

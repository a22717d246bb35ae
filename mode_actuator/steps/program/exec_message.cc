#include "mode_actuator/steps/program/exec_message.h"

#include <algorithm>
#include <cstdint>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "services/base/status_macros.h"

namespace rips::actuator {
namespace {

using Kind = ExecAnswer::Kind;

constexpr absl::string_view kMagic = "rips-exec 1\n";
constexpr std::pair<absl::string_view, ExecVerb> kVerbs[] = {
    {"start", ExecVerb::kStart}, {"cancel", ExecVerb::kCancel}, {"examine", ExecVerb::kExamine}};
constexpr std::pair<absl::string_view, Kind> kKinds[] = {
    {"examined", Kind::kExamined}, {"begun", Kind::kBegun}, {"ended", Kind::kEnded}};
constexpr int kCodeMax = 16;  // the last of absl::StatusCode

template <typename E, size_t N>
absl::string_view NameOf(const std::pair<absl::string_view, E> (&names)[N], E value) {
  for (const auto& [name, each] : names) {
    if (each == value) return name;
  }
  return "?";
}

template <typename E, size_t N>
bool FindName(const std::pair<absl::string_view, E> (&names)[N], absl::string_view text, E* value) {
  for (const auto& [name, each] : names) {
    if (name != text) continue;
    *value = each;
    return true;
  }
  return false;
}

void AddField(absl::string_view key, absl::string_view bytes, std::string* message) {
  absl::StrAppend(message, key, " ", bytes.size(), "\n", bytes, "\n");
}

void AddText(absl::string_view key, absl::string_view text, std::string* message) {
  AddField(key, text.substr(0, kExecTextBytesMax), message);
}

void AddNumber(absl::string_view key, int64_t number, std::string* message) {
  AddField(key, absl::StrCat(number), message);
}

// Takes the next field off `*rest`; false if there is none.
bool TakeField(absl::string_view* rest, absl::string_view* key, absl::string_view* bytes) {
  const size_t line = rest->find('\n');
  if (line == absl::string_view::npos) return false;
  const size_t space = rest->substr(0, line).find(' ');
  uint64_t size = 0;
  if (space == absl::string_view::npos ||
      !absl::SimpleAtoi(rest->substr(space + 1, line - space - 1), &size) ||
      size >= rest->size() - line - 1) {
    return false;
  }
  *key = rest->substr(0, space);
  *bytes = rest->substr(line + 1, size);
  if ((*rest)[line + 1 + size] != '\n') return false;
  rest->remove_prefix(line + 1 + size + 1);
  return true;
}

bool ReadNumber(absl::string_view bytes, int64_t min, int64_t max, int64_t* value) {
  return absl::SimpleAtoi(bytes, value) && *value >= min && *value <= max;
}

bool ReadCallField(absl::string_view key, absl::string_view bytes, ExecCall* call) {
  ProgramRequest& program = call->program;
  int64_t number = 0;
  if (key == "verb") return FindName(kVerbs, bytes, &call->verb);
  if (key == "drill") return program.drill = bytes == "1";
  if (key == "timeout_ms") {
    if (!ReadNumber(bytes, 1, absl::ToInt64Milliseconds(kExecTimeoutMax), &number)) return false;
    program.timeout = absl::Milliseconds(number);
    return true;
  }
  if (bytes.find('\0') != absl::string_view::npos) return false;
  if (key == "arg" && program.args.size() < kArgsMax && bytes.size() <= kArgBytesMax) {
    program.args.emplace_back(bytes);
    return true;
  }
  if (bytes.size() > kProgramNameBytesMax) return false;
  if (key == "name") program.name = std::string(bytes);
  if (key == "level_from") program.level_from = std::string(bytes);
  if (key == "level_to") program.level_to = std::string(bytes);
  return key == "name" || key == "level_from" || key == "level_to";
}

bool ReadAnswerField(absl::string_view key, absl::string_view bytes, ExecAnswer* answer) {
  ProgramResult& result = answer->result;
  int64_t number = 0;
  if (key == "kind") return FindName(kKinds, bytes, &answer->kind);
  if (key == "begun") {
    result.begun = bytes == "1";
    return true;
  }
  if (key == "timeout_ms") {
    if (!ReadNumber(bytes, 0, absl::ToInt64Milliseconds(kExecTimeoutMax), &number)) return false;
    answer->timeout = absl::Milliseconds(number);
    return true;
  }
  if (key == "code") {
    if (!ReadNumber(bytes, 0, kCodeMax, &number)) return false;
    result.status = absl::Status(static_cast<absl::StatusCode>(number), "");
    return true;
  }
  if (key == "message" && bytes.size() <= kExecTextBytesMax) {
    result.status = absl::Status(result.status.code(), bytes);
    return true;
  }
  if (key == "note" && bytes.size() <= kExecTextBytesMax) {
    result.note = std::string(bytes);
    return true;
  }
  if (key == "output" && bytes.size() <= kOutputBytesMax) {
    result.output_tail = std::string(bytes);
    return true;
  }
  if (key == "exit_code" && ReadNumber(bytes, 0, 255, &number)) {
    result.exit_code = static_cast<int>(number);
    return true;
  }
  if (key == "output_bytes" && ReadNumber(bytes, 0, INT64_MAX, &number)) {
    result.output_bytes = static_cast<uint64_t>(number);
    return true;
  }
  if (key == "took_ms" && ReadNumber(bytes, 0, UINT32_MAX, &number)) {
    result.took_ms = static_cast<uint32_t>(number);
    return true;
  }
  return false;
}

template <typename Message, typename Read>
bool ReadFields(absl::string_view text, Message* message, const Read& read) {
  if (text.size() > kExecMessageBytesMax || !absl::ConsumePrefix(&text, kMagic)) return false;
  while (!text.empty()) {
    absl::string_view key, bytes;
    if (!TakeField(&text, &key, &bytes) || !read(key, bytes, message)) return false;
  }
  return true;
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
  std::string message(kMagic);
  AddField("verb", NameOf(kVerbs, call.verb), &message);
  if (call.verb == ExecVerb::kCancel) return message;
  const ProgramRequest& program = call.program;
  AddField("name", program.name, &message);
  if (call.verb == ExecVerb::kExamine) return message;
  for (const std::string& arg : program.args) AddField("arg", arg, &message);
  if (program.timeout > absl::ZeroDuration() && program.timeout <= kExecTimeoutMax) {
    AddNumber("timeout_ms", std::max<int64_t>(1, absl::ToInt64Milliseconds(program.timeout)),
              &message);
  }
  if (program.drill) AddField("drill", "1", &message);
  AddText("level_from", program.level_from, &message);
  AddText("level_to", program.level_to, &message);
  return message;
}

absl::StatusOr<ExecCall> DecodeExecCall(absl::string_view message) {
  ExecCall call;
  call.program.timeout = absl::InfiniteDuration();
  // Strict by printing it again: order, repeats, what is missing, forms of numbers.
  if (!ReadFields(message, &call, ReadCallField) || EncodeExecCall(call) != message) {
    return absl::InvalidArgumentError("malformed: no message of `rips-exec 1`");
  }
  return call;
}

std::string EncodeExecAnswer(const ExecAnswer& answer) {
  std::string message(kMagic);
  AddField("kind", NameOf(kKinds, answer.kind), &message);
  if (answer.kind == Kind::kBegun) {
    AddNumber("timeout_ms", absl::ToInt64Milliseconds(std::min(answer.timeout, kExecTimeoutMax)),
              &message);
    return message;
  }
  const ProgramResult& result = answer.result;
  AddNumber("code", static_cast<int>(result.status.code()), &message);
  AddText("message", result.status.message(), &message);
  if (answer.kind == Kind::kExamined) return message;
  AddField("begun", result.begun ? "1" : "0", &message);
  AddNumber("exit_code", result.exit_code, &message);
  AddNumber("output_bytes", static_cast<int64_t>(result.output_bytes), &message);
  AddNumber("took_ms", result.took_ms, &message);
  AddText("note", result.note, &message);
  AddField("output", result.output_tail, &message);
  return message;
}

absl::StatusOr<ExecAnswer> DecodeExecAnswer(absl::string_view message) {
  ExecAnswer answer;
  if (!ReadFields(message, &answer, ReadAnswerField) || EncodeExecAnswer(answer) != message) {
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
    return absl::InvalidArgumentError("malformed: no packet of `rips-exec 1`");
  }
  if (parts_.size() + packet.size() > kExecMessageBytesMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat("a message exceeds limit ", kExecMessageBytesMax, " bytes"));
  }
  parts_.append(packet.data(), packet.size());
  if (last) *message = std::exchange(parts_, "");
  return last;
}

}  // namespace rips::actuator

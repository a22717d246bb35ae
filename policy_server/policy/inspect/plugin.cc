#include "policy_server/policy/inspect/plugin.h"

#include <algorithm>
#include <filesystem>
#include <optional>
#include <utility>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::inspect {
namespace {

using engine::Verdict;
using Io = ChildProcess::Io;

constexpr absl::string_view kGreeting = "rips-plugin 1\n";
constexpr int64_t kLogPauseNs = 60 * kNanosPerSecond;
// Exit statuses above this are the shells' words for "cannot be run" and "ended by a signal".
constexpr int kExitNoMax = 125;

enum class Greeting { kYes, kNo, kIncomplete };

Greeting UnderstandGreeting(absl::string_view output) {
  if (absl::StartsWith(output, kGreeting)) return Greeting::kYes;
  return absl::StartsWith(kGreeting, output) ? Greeting::kIncomplete : Greeting::kNo;
}

absl::StatusOr<Verdict> UnderstandAnswer(absl::string_view line) {
  if (line == "1\n") return Verdict::kYes;
  if (line == "0\n") return Verdict::kNo;
  if (line == "?\n") return Verdict::kUnscanned;
  return absl::DataLossError("answered none of `1`, `0` and `?`");
}

// How it ended, if it has, and what it wrote to its standard error.
std::string EndOf(ChildProcess& process) {
  const std::optional<ChildProcess::Exit> exit = process.Exited();
  std::vector<std::string> parts;
  if (exit) {
    parts.push_back(exit->status < 0 ? "ended by a signal"
                                     : absl::StrCat("exit status ", exit->status));
  }
  const std::string errors = process.Errors();
  if (!errors.empty()) parts.push_back(errors);
  return absl::StrJoin(parts, ": ");
}

// `why` a process failed, nullptr if there is none, with what it says about it.
std::string Explain(absl::string_view why, ChildProcess* process) {
  const std::string end = process == nullptr ? "" : EndOf(*process);
  return end.empty() ? std::string(why) : absl::StrCat(why, ": ", end);
}

// `process` has ended with `status`.
absl::StatusOr<Verdict> UnderstandExit(ChildProcess& process, int status) {
  if (status == 0) return Verdict::kYes;
  if (status > 0 && status <= kExitNoMax && process.Errors().empty()) return Verdict::kNo;
  return absl::AbortedError(EndOf(process));
}

absl::Status TooMuchOutput() {
  return absl::ResourceExhaustedError(
      absl::StrCat("wrote more than ", kPluginOutputBytesMax, " bytes"));
}

std::string LittleEndian32(uint32_t value) {
  std::string bytes;
  for (int shift = 0; shift < 32; shift += 8) bytes.push_back(static_cast<char>(value >> shift));
  return bytes;
}

int64_t After(int64_t now_ns, absl::Duration delay) {
  return now_ns + absl::ToInt64Nanoseconds(delay);
}

absl::StatusOr<std::unique_ptr<ChildProcess>> Run(const PluginSpec& spec,
                                                  const PluginOptions& options) {
  std::string root =
      spec.root.empty() ? std::filesystem::path(spec.path).parent_path().string() : spec.root;
  if (root == "/") root = spec.path;  // else it could read everything
  return ChildProcess::StartPlugin(spec.path, root, options.process, options.contain);
}

// InvalidArgument if it cannot start. One that does not greet is given all the time to show that.
absl::StatusOr<bool> Greets(ChildProcess& process, int64_t deadline_ns, const Clock& clock) {
  std::string output;
  while (true) {
    const std::optional<ChildProcess::Exit> exit = process.Exited();
    const Io io = process.Read(output, kPluginOutputBytesMax);
    if (exit) {
      const bool fit = exit->status >= 0 && exit->status <= kExitNoMax && process.Errors().empty();
      if (fit) return false;
      return absl::InvalidArgumentError(EndOf(process));
    }
    if (UnderstandGreeting(output) == Greeting::kYes) return true;
    if (io == Io::kDone || !process.Wait(false, deadline_ns, clock)) return false;
  }
}

}  // namespace

absl::Status ProbePlugins(std::vector<PluginSpec>& plugins, const PluginOptions& options,
                          const Clock& clock) {
  std::vector<std::unique_ptr<ChildProcess>> processes;
  for (const PluginSpec& plugin : plugins) {
    RIPS_ASSIGN_OR_RETURN(auto process, Run(plugin, options));
    processes.push_back(std::move(process));
  }
  const int64_t deadline_ns = After(clock.Now().boottime_ns, options.greeting_time);
  std::vector<std::string> problems;
  for (size_t i = 0; i < plugins.size(); ++i) {
    const absl::StatusOr<bool> greets = Greets(*processes[i], deadline_ns, clock);
    if (!greets.ok()) {
      problems.push_back(
          absl::StrCat("plugin `", plugins[i].id, "` does not start: ", greets.status().message()));
      continue;
    }
    plugins[i].protocol = *greets ? PluginProtocol::kFramed : PluginProtocol::kOneShot;
    if (*greets) continue;
    LogWarning("plugin sent no greeting; running it once per message (one-shot)",
               {{"plugin", plugins[i].id},
                {"greeting_time", absl::FormatDuration(options.greeting_time)}});
  }
  if (!problems.empty()) return absl::InvalidArgumentError(absl::StrJoin(problems, "\n"));
  return absl::OkStatus();
}

std::string PluginHeader(const Message& message) {
  const auto text = [](absl::string_view view) { return std::string(view); };
  nlohmann::ordered_json header;
  header["topic"] = text(message.topic);
  header["type"] = text(message.type);
  header["sender"] = text(message.sender);
  header["writer"] = text(message.writer_hex);
  header["time_unix_ns"] = message.time_unix_ns;
  header["payload_bytes"] = message.payload.size();
  header["size_bytes"] = message.size_bytes;
  return header.dump(/*indent=*/-1, ' ', /*ensure_ascii=*/true,
                     nlohmann::ordered_json::error_handler_t::replace);
}

Plugin::Plugin(PluginSpec spec, PluginOptions options, const Clock* clock)
    : spec_(std::move(spec)),
      options_(std::move(options)),
      clock_(clock),
      restart_(options_.restart) {}

Plugin::~Plugin() = default;

void Plugin::Warm() {
  if (spec_.protocol == PluginProtocol::kFramed && process_ == nullptr) StartProcess();
}

Verdict Plugin::Ask(const Message& message) {
  if (!message.available || message.payload.size() > kPluginPayloadBytesMax) {
    return Verdict::kUnscanned;
  }
  const int64_t now_ns = Now();
  if (!restart_.MayAsk(message.robot, now_ns)) return Verdict::kUnscanned;
  const int64_t deadline_ns = After(now_ns, options_.answer_time);
  return spec_.protocol == PluginProtocol::kFramed ? AskFramed(message)
                                                   : AskOneShot(message, deadline_ns);
}

void Plugin::AwaitWarm() {
  if (process_ != nullptr && !greeted_) AwaitGreeting();
}

Verdict Plugin::AskFramed(const Message& message) {
  DropIfUnfit();
  if (process_ == nullptr) {
    // Whoever made the last process unfit may be this robot.
    if (!restart_.MayAsk(message.robot, Now()) || !StartProcess()) return Verdict::kUnscanned;
  }
  if (!greeted_ && !AwaitGreeting()) return Verdict::kUnscanned;
  const std::string header = PluginHeader(message);
  if (header.size() > kPluginHeaderBytesMax) return Verdict::kUnscanned;
  last_robot_ = std::string(message.robot);
  const absl::StatusOr<Verdict> answer =
      Exchange(header, message.payload, After(Now(), options_.answer_time));
  if (answer.ok()) return *answer;
  AnswerFailed(message.robot, answer.status().message());
  return Verdict::kUnscanned;
}

bool Plugin::StartProcess() {
  const int64_t before_ns = Now();
  absl::StatusOr<std::unique_ptr<ChildProcess>> started = Run(spec_, options_);
  start_ns_ += Now() - before_ns;
  ++starts_;
  if (!started.ok()) {
    StartFailed(started.status().message());
    return false;
  }
  process_ = *std::move(started);
  greet_by_ns_ = After(Now(), options_.greeting_time);
  greeted_ = false;
  last_robot_.clear();
  output_.clear();
  return true;
}

bool Plugin::AwaitGreeting() {
  const int64_t before_ns = Now();
  const auto counted = absl::MakeCleanup([&] { start_ns_ += Now() - before_ns; });
  while (true) {
    const bool ended = process_->Exited().has_value();
    process_->Read(output_, kPluginOutputBytesMax);
    const Greeting greeting = UnderstandGreeting(output_);
    if (greeting == Greeting::kYes && output_.size() == kGreeting.size() && !ended) {
      greeted_ = true;
      output_.clear();
      return true;
    }
    if (greeting != Greeting::kIncomplete) {
      StartFailed("its first output is no greeting");
      return false;
    }
    if (ended) {
      StartFailed("ended before its greeting");
      return false;
    }
    if (Now() >= greet_by_ns_) {
      StartFailed("did not greet in time");
      return false;
    }
    process_->Wait(false, greet_by_ns_, *clock_);
  }
}

void Plugin::DropIfUnfit() {
  if (process_ == nullptr || !greeted_) return;
  const bool ended = process_->Exited().has_value();
  const Io io = process_->Read(output_, kPluginOutputBytesMax);
  if (!ended && io != Io::kClosed && output_.empty()) return;
  const absl::string_view why = output_.empty() ? "ended unasked" : "wrote unasked";
  if (last_robot_.empty()) {
    StartFailed(why);
    return;
  }
  AnswerFailed(last_robot_, why);
}

absl::StatusOr<Verdict> Plugin::Exchange(const std::string& header, absl::string_view payload,
                                         int64_t deadline_ns) {
  const std::string front =
      absl::StrCat(LittleEndian32(static_cast<uint32_t>(header.size())), header);
  absl::string_view front_rest = front;
  absl::string_view payload_rest = payload;
  while (true) {
    Io written = process_->Write(front_rest);
    if (written == Io::kDone) written = process_->Write(payload_rest);
    const bool ended = process_->Exited().has_value();
    const Io read = process_->Read(output_, kPluginOutputBytesMax);
    if (read == Io::kDone) return TooMuchOutput();
    const size_t line_end = output_.find('\n');
    if (line_end != std::string::npos && written == Io::kDone) {
      return UnderstandAnswer(std::exchange(output_, std::string()));
    }
    if (written == Io::kClosed || read == Io::kClosed || ended) {
      return absl::AbortedError("ended or closed its side without an answer");
    }
    if (!process_->Wait(written != Io::kDone, deadline_ns, *clock_)) {
      return absl::DeadlineExceededError("did not answer in time");
    }
  }
}

Verdict Plugin::AskOneShot(const Message& message, int64_t deadline_ns) {
  absl::StatusOr<std::unique_ptr<ChildProcess>> process = Run(spec_, options_);
  ++starts_;
  if (!process.ok()) {
    StartFailed(process.status().message());
    return Verdict::kUnscanned;
  }
  const absl::StatusOr<Verdict> answer = AwaitExit(**process, message.payload, deadline_ns);
  const bool late = absl::IsDeadlineExceeded(answer.status());
  late_in_a_row_ = late ? late_in_a_row_ + 1 : 0;
  if (answer.ok()) return *answer;
  if (late_in_a_row_ >= kPluginLateMax) restart_.AnswerFailed(message.robot, Now());
  CountFailure(answer.status().message());
  return Verdict::kUnscanned;
}

absl::StatusOr<Verdict> Plugin::AwaitExit(ChildProcess& process, absl::string_view payload,
                                          int64_t deadline_ns) {
  std::string output;
  while (true) {
    // A program may well decide without reading everything.
    const Io written = process.Write(payload);
    if (written != Io::kBlocked) process.CloseInput();
    const std::optional<ChildProcess::Exit> exit = process.Exited();
    if (process.Read(output, kPluginOutputBytesMax) == Io::kDone) return TooMuchOutput();
    if (UnderstandGreeting(output) == Greeting::kYes) {
      spec_.protocol = PluginProtocol::kFramed;
      return absl::FailedPreconditionError("greeted late; from now on it is kept running");
    }
    if (exit) return UnderstandExit(process, exit->status);
    if (!process.Wait(written == Io::kBlocked, deadline_ns, *clock_)) {
      return absl::DeadlineExceededError("did not end in time");
    }
  }
}

void Plugin::AnswerFailed(absl::string_view robot, absl::string_view why) {
  const std::string shown = Explain(why, process_.get());
  process_.reset();
  restart_.AnswerFailed(robot, Now());
  CountFailure(shown);
}

void Plugin::StartFailed(absl::string_view why) {
  const std::string shown = Explain(why, process_.get());
  process_.reset();
  restart_.StartFailed(Now());
  CountFailure(shown);
}

void Plugin::CountFailure(absl::string_view why) {
  ++failures_;
  const int64_t now_ns = Now();
  if (logged_ns_ != 0 && now_ns - logged_ns_ < kLogPauseNs) return;
  logged_ns_ = now_ns;
  LogWarning("plugin failed", {{"plugin", spec_.id}, {"why", why}, {"failures", failures_}});
}

}  // namespace rips::inspect

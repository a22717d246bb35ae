#include "mode_actuator/steps/program/exec_client.h"

#include <poll.h>

#include <algorithm>
#include <atomic>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "services/base/clock.h"
#include "services/base/status_macros.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

using Kind = ExecAnswer::Kind;

constexpr int kPollMsMax = 1000;

ProgramResult NotBegun(absl::Status why) {
  ProgramResult result;
  result.begun = false;
  result.status = std::move(why);
  return result;
}

absl::Status CheckRequest(const ProgramRequest& request) {
  if (request.name.size() > kProgramNameBytesMax) {
    return absl::PermissionDeniedError(
        absl::StrCat("a program name of ", request.name.size(), " bytes is not in the allow-list"));
  }
  if (request.name.find('\0') != std::string::npos) {
    return absl::PermissionDeniedError(
        absl::StrCat("program `", absl::CHexEscape(request.name), "` is not in the allow-list"));
  }
  return CheckProgramArgs(request.args);
}

}  // namespace

struct ExecClient::Call {
  explicit Call(UniqueFd fd) : channel(std::move(fd)) {}
  ExecChannel channel;
  Kind wanted = Kind::kEnded;
  Done done;
  bool begun = false;
  int64_t deadline_ns = 0;
  absl::Duration timeout;
  std::atomic<bool> cancel = false;  // any thread
  bool cancel_sent = false;
  bool over = false;
  ProgramResult result;

  void End(ProgramResult ended) {
    over = true;
    result = std::move(ended);
  }
  // Without a word of how the program ended, if it was begun.
  void EndUnknown(absl::string_view why) {
    ProgramResult unknown;
    unknown.status = absl::UnknownError(why);
    End(std::move(unknown));
  }
};

ExecClient::ExecClient(const Options& options)
    : options_(options), door_(options.socket, "rips-exec", options.run_as) {
  thread_ = std::thread([this] { Loop(); });
}

ExecClient::~ExecClient() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
  }
  wake_.Wake();
  thread_.join();
}

absl::StatusOr<std::shared_ptr<ExecClient::Call>> ExecClient::Ask(const ExecCall& call) const {
  RIPS_ASSIGN_OR_RETURN(UniqueFd fd, door_.Connect());
  auto asked = std::make_shared<Call>(std::move(fd));
  asked->channel.Send(EncodeExecCall(call));
  asked->deadline_ns = BoottimeAfter(options_.answer_timeout);
  return asked;
}

absl::StatusOr<uint64_t> ExecClient::Start(const ProgramRequest& request, Done done) {
  RIPS_RETURN_IF_ERROR(CheckRequest(request));
  ExecCall call;
  call.verb = ExecVerb::kStart;
  call.program = request;
  MutexLock lock(&mu_);
  if (stopping_) return absl::UnavailableError("stopping");
  RIPS_ASSIGN_OR_RETURN(std::shared_ptr<Call> asked, Ask(call));
  asked->done = std::move(done);
  const uint64_t id = next_++;
  calls_.emplace(id, std::move(asked));
  wake_.Wake();
  return id;
}

void ExecClient::Cancel(uint64_t run) {
  MutexLock lock(&mu_);
  const auto call = calls_.find(run);
  if (call == calls_.end()) return;
  call->second->cancel = true;
  wake_.Wake();
}

absl::Status ExecClient::Examine(absl::string_view name) {
  ExecCall call;
  call.verb = ExecVerb::kExamine;
  call.program.name = std::string(name);
  RIPS_RETURN_IF_ERROR(CheckRequest(call.program));
  RIPS_ASSIGN_OR_RETURN(const std::shared_ptr<Call> asked, Ask(call));
  asked->wanted = Kind::kExamined;
  while (!Step(*asked, BoottimeNow())) {
    pollfd poll_fd = {asked->channel.fd(), asked->channel.events(), 0};
    const int64_t left_ns = asked->deadline_ns - BoottimeNow();
    poll(&poll_fd, 1, static_cast<int>(std::max<int64_t>(left_ns / kNanosPerMilli + 1, 0)));
  }
  return asked->result.status;
}

void ExecClient::Loop() {
  while (true) {
    std::vector<std::shared_ptr<Call>> calls;
    {
      MutexLock lock(&mu_);
      if (stopping_) {
        for (auto& [id, call] : calls_) calls.push_back(std::move(call));
        calls_.clear();
      }
    }
    for (const std::shared_ptr<Call>& call : calls) {
      call->channel.Send(EncodeExecCall({}));
      call->channel.Flush().IgnoreError();
      ProgramResult cancelled;
      cancelled.status = absl::CancelledError("cancelled");
      cancelled.begun = call->begun;
      call->done(std::move(cancelled));
    }
    {
      MutexLock lock(&mu_);
      if (stopping_) return;
    }
    Poll(StepAll());
  }
}

int ExecClient::StepAll() {
  std::vector<std::pair<uint64_t, std::shared_ptr<Call>>> calls;
  {
    MutexLock lock(&mu_);
    calls.assign(calls_.begin(), calls_.end());
  }
  int wait_ms = kPollMsMax;
  for (const auto& [id, call] : calls) {
    const int64_t now_ns = BoottimeNow();
    if (!Step(*call, now_ns)) {
      const int64_t left_ms = (call->deadline_ns - now_ns) / kNanosPerMilli + 1;
      wait_ms = static_cast<int>(std::clamp<int64_t>(left_ms, 0, wait_ms));
      continue;
    }
    {
      MutexLock lock(&mu_);
      calls_.erase(id);
    }
    call->done(std::move(call->result));
  }
  return wait_ms;
}

bool ExecClient::Step(Call& call, int64_t now_ns) const {
  if (call.cancel && !call.cancel_sent) {
    call.cancel_sent = true;
    call.channel.Send(EncodeExecCall({}));
  }
  const bool had_unsent = call.channel.unsent();
  // Refused at the door: the answer is there before the question.
  const absl::Status sent = call.channel.Flush();
  while (!call.over && AcceptAnswer(call)) {
  }
  if (call.over) return true;
  if (!sent.ok() && had_unsent && !call.begun) {
    call.End(
        NotBegun(absl::UnavailableError("rips-exec went away before it had read the request")));
  } else if (now_ns >= call.deadline_ns) {
    if (call.begun) {
      call.EndUnknown(absl::StrCat("rips-exec did not report its end within ",
                                   absl::FormatDuration(call.timeout), " and more"));
    } else {
      call.EndUnknown(absl::StrCat("rips-exec did not answer within ",
                                   absl::FormatDuration(options_.answer_timeout)));
    }
  }
  return call.over;
}

bool ExecClient::AcceptAnswer(Call& call) const {
  absl::StatusOr<std::optional<std::string>> message = call.channel.Receive();
  if (absl::IsAborted(message.status())) {
    // It closed without reading the request, or a cancel; what it said before that comes now.
    message = call.channel.Receive();
    if (absl::IsOutOfRange(message.status()) && !call.begun && !call.cancel_sent) {
      call.End(
          NotBegun(absl::UnavailableError("rips-exec went away before it had read the request")));
      return true;
    }
  }
  if (absl::IsOutOfRange(message.status())) {
    call.EndUnknown(call.begun ? "rips-exec ended while it ran"
                               : "rips-exec ended before it said whether it began");
    return true;
  }
  if (!message.ok()) {
    call.EndUnknown(absl::StrCat("rips-exec: ", message.status().message()));
    return true;
  }
  if (!message->has_value()) return false;
  absl::StatusOr<ExecAnswer> answer = DecodeExecAnswer(**message);
  if (!answer.ok()) {
    call.EndUnknown(answer.status().message());
  } else if (answer->kind == Kind::kBegun && !call.begun && call.wanted == Kind::kEnded) {
    call.begun = true;
    call.timeout = answer->timeout;
    call.deadline_ns = BoottimeAfter(answer->timeout + kTermGrace + options_.end_slack);
  } else if (answer->kind == call.wanted || answer->kind == Kind::kEnded) {
    call.End(std::move(answer->result));
  } else {
    call.EndUnknown("rips-exec sent an answer without a request");
  }
  return true;
}

void ExecClient::Poll(int timeout_ms) {
  std::vector<std::shared_ptr<Call>> calls;  // keeps the descriptors open while polling
  {
    MutexLock lock(&mu_);
    for (const auto& [id, call] : calls_) calls.push_back(call);
  }
  std::vector<pollfd> fds = {{wake_.get(), POLLIN, 0}};
  for (const auto& call : calls) fds.push_back({call->channel.fd(), call->channel.events(), 0});
  poll(fds.data(), fds.size(), timeout_ms);
  wake_.Drain();
}

}  // namespace rips::actuator

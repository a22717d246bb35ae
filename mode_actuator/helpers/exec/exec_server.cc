#include "mode_actuator/helpers/exec/exec_server.h"

#include <poll.h>

#include <algorithm>
#include <optional>

#include "absl/strings/str_cat.h"
#include "services/base/clock.h"
#include "services/local_socket/helper_socket.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

using Kind = ExecAnswer::Kind;

constexpr int kPollMs = 500;

// True if the other side has closed; what it sent before may still be there to read.
bool IsGone(int fd) {
  pollfd poll_fd = {fd, POLLRDHUP, 0};
  return poll(&poll_fd, 1, 0) > 0;
}

void LogEnd(const std::string& program, const ProgramResult& result, bool told) {
  if (result.status.ok() && told && result.note.empty()) {
    LogInfo("ended", {{"program", ros2::Printable(program)}});
  } else {
    LogWarning("ended", {{"program", ros2::Printable(program)},
                         {"status", ros2::Printable(result.status.ToString())},
                         {"note", ros2::Printable(result.note)},
                         {"client", told ? "informed" : "disconnected"}});
  }
}

}  // namespace

ExecServer::ExecServer(UniqueFd listener, Options options, ProgramRunner* runner)
    : listener_(std::move(listener)), options_(std::move(options)), runner_(runner) {}

void ExecServer::Stop() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
  }
  wake_.Wake();
}

void ExecServer::Run() {
  while (true) {
    {
      MutexLock lock(&mu_);
      if (stopping_) return;
    }
    std::vector<pollfd> fds = {{wake_.get(), POLLIN, 0}, {listener_.get(), POLLIN, 0}};
    std::vector<uint64_t> ids;
    for (const auto& [id, each] : connections_) {
      fds.push_back({each.channel.fd(), each.channel.events(), 0});
      ids.push_back(id);
    }
    poll(fds.data(), fds.size(), connections_.empty() ? -1 : kPollMs);
    wake_.Drain();
    const int64_t now_ns = BoottimeNow();
    for (size_t i = 0; i < ids.size(); ++i) {
      Connection& each = connections_.at(ids[i]);
      const bool keep = fds[i + 2].revents == 0 || Serve(ids[i], each);
      if (!keep || TimedOut(each, now_ns)) connections_.erase(ids[i]);
    }
    ReportEnded();
    if (fds[1].revents != 0) Accept();
  }
}

bool ExecServer::TimedOut(const Connection& connection, int64_t now_ns) const {
  const bool waits = !connection.asked || connection.channel.unsent();
  if (!waits || now_ns < connection.patience_ns) return false;
  LogWarning("closed", {{"why", connection.asked ? "it does not read its answer"
                                                 : "it does not say what it wants"}});
  return true;
}

void ExecServer::Accept() {
  Accepted accepted = AcceptFrom(listener_.get(), options_.user);
  if (accepted.fd.get() < 0) return;
  absl::Status refused = accepted.peer;
  if (refused.ok() && connections_.size() >= kExecConnectionsMax) {
    refused = absl::ResourceExhaustedError(
        absl::StrCat("connections exceed limit ", kExecConnectionsMax));
  }
  Connection connection(std::move(accepted.fd));
  connection.patience_ns = BoottimeAfter(options_.peer_timeout);
  if (!refused.ok()) {
    LogWarning("refused", {{"why", refused.message()}});
    Refuse(connection, refused);
    return;
  }
  connections_.emplace(next_++, std::move(connection));
}

bool ExecServer::Serve(uint64_t id, Connection& connection) {
  while (true) {
    absl::StatusOr<std::optional<std::string>> message = connection.channel.Receive();
    if (absl::IsAborted(message.status())) continue;
    if (absl::IsOutOfRange(message.status())) return false;
    if (!message.ok()) {
      LogWarning("malformed request", {{"why", message.status().message()}});
      Refuse(connection, absl::InvalidArgumentError(message.status().message()));
      return false;
    }
    if (!message->has_value()) break;
    if (!Handle(id, connection, **message)) return false;
  }
  if (connection.channel.Flush().ok()) return !connection.answered || connection.channel.unsent();
  // The client has closed. A cancel that it sent before, perhaps while its program began, counts.
  while (true) {
    const absl::StatusOr<std::optional<std::string>> last = connection.channel.Receive();
    if (absl::IsAborted(last.status())) continue;
    if (!last.ok() || !last->has_value() || !Handle(id, connection, **last)) return false;
  }
}

bool ExecServer::Handle(uint64_t id, Connection& connection, const std::string& message) {
  const absl::StatusOr<ExecCall> call = DecodeExecCall(message);
  if (!call.ok()) {
    LogWarning("malformed request", {{"why", call.status().message()}});
    Refuse(connection, call.status());
    return false;
  }
  if (call->verb == ExecVerb::kCancel) {
    if (connection.run != 0) runner_->Cancel(connection.run);
    return true;
  }
  if (connection.asked) {
    Refuse(connection, absl::InvalidArgumentError("malformed: a second request on one connection"));
    return false;
  }
  connection.asked = true;
  if (call->verb == ExecVerb::kExamine) {
    connection.answered = true;
    ExecAnswer answer;
    answer.kind = Kind::kExamined;
    answer.result.status = runner_->Examine(call->program.name);
    return Answer(connection, answer);
  }
  if (IsGone(connection.channel.fd())) {
    // The client has disconnected; do not start its program.
    LogWarning("not started", {{"program", ros2::Printable(call->program.name)},
                               {"why", "its client has disconnected"}});
    return false;
  }
  return Start(id, connection, call->program);
}

bool ExecServer::Start(uint64_t id, Connection& connection, const ProgramRequest& request) {
  const absl::StatusOr<uint64_t> run = runner_->Start(request, [this, id](ProgramResult result) {
    {
      MutexLock lock(&mu_);
      ended_.emplace_back(id, std::move(result));
    }
    wake_.Wake();
  });
  if (!run.ok()) {
    LogWarning("not started", {{"program", ros2::Printable(request.name)},
                               {"why", ros2::Printable(run.status().message())}});
    return Refuse(connection, run.status());
  }
  LogInfo("begun", {{"program", ros2::Printable(request.name)},
                    {"arguments", request.args.size()},
                    {"drill", request.drill}});
  connection.run = *run;
  running_[id] = request.name;
  ExecAnswer answer;
  answer.kind = Kind::kBegun;
  answer.timeout = TimeoutOf(request);
  return Answer(connection, answer);
}

absl::Duration ExecServer::TimeoutOf(const ProgramRequest& request) const {
  const ProgramSpec* spec = FindNamed(options_.allowed, request.name);
  return spec == nullptr ? request.timeout : std::min(request.timeout, spec->timeout);
}

bool ExecServer::Answer(Connection& connection, const ExecAnswer& answer) {
  connection.channel.Send(EncodeExecAnswer(answer));
  connection.patience_ns = BoottimeAfter(options_.peer_timeout);
  return connection.channel.Flush().ok();
}

bool ExecServer::Refuse(Connection& connection, const absl::Status& why) {
  connection.answered = true;
  ExecAnswer answer;
  answer.result.begun = false;
  answer.result.status = why;
  return Answer(connection, answer);
}

void ExecServer::ReportEnded() {
  std::vector<std::pair<uint64_t, ProgramResult>> ended;
  {
    MutexLock lock(&mu_);
    ended.swap(ended_);
  }
  for (auto& [id, result] : ended) {
    const auto found = connections_.find(id);
    LogEnd(running_[id], result, found != connections_.end());
    running_.erase(id);
    if (found == connections_.end()) continue;
    Connection& connection = found->second;
    connection.answered = true;
    ExecAnswer answer;
    answer.result = std::move(result);
    if (!Answer(connection, answer) || !connection.channel.unsent()) connections_.erase(found);
  }
}

}  // namespace rips::actuator

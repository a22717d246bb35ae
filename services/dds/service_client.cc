#include "services/dds/service_client.h"

#include <algorithm>
#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/base/status_macros.h"
#include "services/dds/service_endpoints.h"
#include "services/ros2/service_header.h"
#include "services/runtime/log.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::dds {
namespace {

// Between looks at what is matched; discovery itself takes milliseconds.
constexpr absl::Duration kReadyPoll = absl::Milliseconds(2);
// Participants named in a message.
constexpr size_t kNamedMax = 3;
// Between two log lines about ignored replies.
constexpr absl::Duration kIgnoredLogPeriod = absl::Minutes(1);

int64_t NowNs() { return RealClock().Now().boottime_ns; }

int64_t DeadlineAfter(absl::Duration timeout) {
  return NowNs() + absl::ToInt64Nanoseconds(timeout);
}

absl::Status SeveralServers(absl::string_view service, const ServersFound& found) {
  if (found.truncated) {
    return absl::FailedPreconditionError(
        absl::StrCat("too many endpoints offer `", service, "` to tell its server"));
  }
  std::set<ros2::Guid> participants;
  for (const WholeServer& each : found.servers) {
    participants.insert(each.request_reader.Participant());
  }
  std::string named;
  size_t left = kNamedMax;
  for (const ros2::Guid& each : participants) {
    if (left-- == 0) {
      absl::StrAppend(&named, " and others");
      break;
    }
    absl::StrAppend(&named, named.empty() ? "" : ", ", ros2::ToString(each));
  }
  return absl::FailedPreconditionError(
      absl::StrCat(found.servers.size(), " servers offer `", service,
                   participants.size() == 1 ? "`, of participant " : "`, of participants ", named));
}

}  // namespace

struct ServiceClient::Impl {
  // The one reply that counts.
  struct Awaited {
    ros2::Guid from;    // the server's reply writer
    ros2::Guid client;  // the request writer
    ros2::ServiceHeader header;
    uint64_t sample = 0;  // of a call to rmw_fastrtps: the request's RTPS sequence number
    bool fastrtps = false;
  };

  // Keeps the reply that `awaited` waits for, drops every other one.
  void OnReply(const RawSample& sample) ABSL_LOCKS_EXCLUDED(mu) {
    MutexLock lock(&mu);
    if (!awaited.has_value()) return;
    if (sample.writer != awaited->from) {
      ++ignored;
      ignored_writer = sample.writer;
      return;
    }
    if (sample.size > sample.payload.size()) return;  // it was too long to be kept
    if (awaited->fastrtps) {
      if (sample.related_writer != awaited->client) return;
      if (sample.related_sequence != awaited->sample) return;
      AcceptReply(std::string(sample.payload));
      return;
    }
    absl::StatusOr<ros2::ServiceMessage> message = ros2::SplitServiceHeader(sample.payload);
    if (!message.ok() || message->header != awaited->header) return;
    AcceptReply(std::move(message->payload));
  }
  void AcceptReply(std::string payload) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) {
    reply = std::move(payload);
    awaited.reset();
    changed.NotifyAll();
  }

  absl::Status MakeEndpoints() ABSL_LOCKS_EXCLUDED(mu) {
    RIPS_ASSIGN_OR_RETURN(
        ServiceEndpoints made,
        CreateServiceEndpoints(*participant, options, ServiceSide::kClient,
                               [this](RawWriter&, const RawSample& sample) { OnReply(sample); }));
    auto fresh = std::make_shared<const ServiceEndpoints>(std::move(made));
    {
      MutexLock lock(&mu);
      fresh.swap(endpoints);
    }
    return absl::OkStatus();  // the old ones, if any, go without the lock: OnReply takes it
  }
  std::shared_ptr<const ServiceEndpoints> Endpoints() const ABSL_LOCKS_EXCLUDED(mu) {
    MutexLock lock(&mu);
    return endpoints;
  }

  // See kRenewPauseMin. Should it fail, the old endpoints stay.
  void RenewIfSuspect() ABSL_EXCLUSIVE_LOCKS_REQUIRED(calling) ABSL_LOCKS_EXCLUDED(mu) {
    {
      MutexLock lock(&mu);
      if (!suspect || NowNs() < renew_after_ns) return;
      suspect = false;
      renew_pause = std::clamp(2 * renew_pause, kRenewPauseMin, kRenewPauseMax);
      renew_after_ns = DeadlineAfter(renew_pause);
    }
    if (MakeEndpoints().ok()) written = 0;
  }

  // Sends the request as rmw_fastrtps or rmw_cyclonedds expects it.
  absl::Status Write(const ServiceEndpoints& to, absl::string_view request,
                     const ros2::ServiceHeader& header, bool fastrtps)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(calling) {
    if (fastrtps) {
      RIPS_RETURN_IF_ERROR(to.writer->Write(request));
    } else {
      RIPS_ASSIGN_OR_RETURN(const std::string payload, ros2::AddServiceHeader(request, header));
      RIPS_RETURN_IF_ERROR(to.writer->Write(payload));
    }
    ++written;
    return absl::OkStatus();
  }

  ros2::ServiceHeader NextHeader(const ServiceEndpoints& from)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(calling) {
    return {.client_id = from.writer->instance(), .sequence = ++last_sequence};
  }

  absl::Status SendToAll(const ServiceEndpoints& to, const ServersFound& found,
                         absl::string_view request) ABSL_EXCLUSIVE_LOCKS_REQUIRED(calling) {
    bool fast = found.truncated;
    bool other = found.truncated;
    for (const WholeServer& each : found.servers) (each.fastrtps ? fast : other) = true;
    if (other) RIPS_RETURN_IF_ERROR(Write(to, request, NextHeader(to), /*fastrtps=*/false));
    if (fast) RIPS_RETURN_IF_ERROR(Write(to, request, {}, /*fastrtps=*/true));
    return absl::OkStatus();
  }

  absl::StatusOr<std::string> Ask(const ServiceEndpoints& to, const WholeServer& server,
                                  absl::string_view request, int64_t deadline)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(calling) ABSL_LOCKS_EXCLUDED(mu) {
    const ros2::ServiceHeader header = NextHeader(to);
    {
      MutexLock lock(&mu);
      // rmw_fastrtps names the request by its RTPS sequence number, which counts writes from 1.
      awaited = Awaited{.from = server.reply_writer,
                        .client = to.writer->guid(),
                        .header = header,
                        .sample = written + 1,
                        .fastrtps = server.fastrtps};
      reply.reset();
      ignored = 0;
    }
    const absl::Status sent = Write(to, request, header, server.fastrtps);
    if (sent.ok()) return WaitForReply(deadline);
    MutexLock lock(&mu);
    awaited.reset();
    return sent;
  }

  absl::StatusOr<ServersFound> WaitForServers(int64_t deadline) ABSL_LOCKS_EXCLUDED(mu) {
    const std::shared_ptr<const ServiceEndpoints> mine = Endpoints();
    while (true) {
      ServersFound found = FindServers(*mine);
      if (!found.none()) return found;
      if (NowNs() >= deadline) {
        return absl::DeadlineExceededError(
            absl::StrCat("no server for `", options.service, "` in time"));
      }
      MutexLock lock(&mu);
      changed.WaitFor(lock, kReadyPoll);
    }
  }

  absl::StatusOr<std::string> WaitForReply(int64_t deadline) ABSL_EXCLUSIVE_LOCKS_REQUIRED(calling)
      ABSL_LOCKS_EXCLUDED(mu) {
    uint64_t foreign = 0;
    ros2::Guid foreign_writer;
    std::optional<std::string> got;
    {
      MutexLock lock(&mu);
      while (!reply.has_value() && NowNs() < deadline) changed.WaitUntil(lock, deadline);
      awaited.reset();
      got = std::exchange(reply, std::nullopt);
      foreign = ignored;
      foreign_writer = ignored_writer;
      if (got.has_value()) {
        suspect = false;
        renew_pause = absl::ZeroDuration();
        renew_after_ns = 0;
      } else {
        suspect = true;
      }
    }
    if (foreign > 0) LogIgnored(foreign, foreign_writer);
    if (!got.has_value()) {
      return absl::DeadlineExceededError(
          absl::StrCat("no reply from `", options.service, "` in time"));
    }
    return *std::move(got);
  }

  void LogIgnored(uint64_t count, const ros2::Guid& writer) ABSL_EXCLUSIVE_LOCKS_REQUIRED(calling) {
    if (NowNs() < log_ignored_after_ns) return;
    log_ignored_after_ns = DeadlineAfter(kIgnoredLogPeriod);
    LogWarning("ignored replies that the service's server did not send",
               {{"service", options.service},
                {"replies", count},
                {"writer", writer.none() ? "unknown" : ros2::ToString(writer)}});
  }

  const Participant* participant = nullptr;  // Not owned; outlives this.
  ServiceOptions options;
  Mutex calling;  // held for a whole call
  int64_t last_sequence ABSL_GUARDED_BY(calling) = 0;
  uint64_t written ABSL_GUARDED_BY(calling) = 0;
  int64_t log_ignored_after_ns ABSL_GUARDED_BY(calling) = 0;
  mutable Mutex mu;
  CondVar changed;
  std::optional<Awaited> awaited ABSL_GUARDED_BY(mu);  // nullopt = no call
  std::optional<std::string> reply ABSL_GUARDED_BY(mu);
  uint64_t ignored ABSL_GUARDED_BY(mu) = 0;  // replies of other writers during this call
  ros2::Guid ignored_writer ABSL_GUARDED_BY(mu);
  bool suspect ABSL_GUARDED_BY(mu) = false;
  absl::Duration renew_pause ABSL_GUARDED_BY(mu);
  int64_t renew_after_ns ABSL_GUARDED_BY(mu) = 0;
  // Last, so they go first: then OnReply runs no more.
  std::shared_ptr<const ServiceEndpoints> endpoints ABSL_GUARDED_BY(mu);
};

ServiceClient::ServiceClient(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ServiceClient::~ServiceClient() = default;

absl::StatusOr<std::unique_ptr<ServiceClient>> ServiceClient::Create(
    const Participant& participant, const ServiceOptions& options) {
  auto impl = std::make_unique<Impl>();
  impl->participant = &participant;
  impl->options = options;
  RIPS_RETURN_IF_ERROR(impl->MakeEndpoints());
  return std::unique_ptr<ServiceClient>(new ServiceClient(std::move(impl)));
}

bool ServiceClient::ServerReady() const { return !FindServers(*impl_->Endpoints()).none(); }

std::optional<ros2::Guid> ServiceClient::Server() const {
  const ServersFound found = FindServers(*impl_->Endpoints());
  const WholeServer* sole = found.sole();
  return sole == nullptr ? std::nullopt : std::optional(sole->request_reader);
}

absl::Status ServiceClient::WaitForServer(absl::Duration timeout) {
  return impl_->WaitForServers(DeadlineAfter(timeout)).status();
}

absl::StatusOr<std::string> ServiceClient::Call(absl::string_view request, absl::Duration timeout,
                                                IfSeveral if_several) {
  const int64_t deadline = DeadlineAfter(timeout);
  MutexLock calling(&impl_->calling);
  impl_->RenewIfSuspect();
  RIPS_ASSIGN_OR_RETURN(const ServersFound found, impl_->WaitForServers(deadline));
  const std::shared_ptr<const ServiceEndpoints> endpoints = impl_->Endpoints();
  if (const WholeServer* server = found.sole()) {
    return impl_->Ask(*endpoints, *server, request, deadline);
  }
  if (if_several == IfSeveral::kSendToAll) {
    RIPS_RETURN_IF_ERROR(impl_->SendToAll(*endpoints, found, request));
    Suspect();  // no reply tells whether the robot's own server heard it
  }
  return SeveralServers(impl_->options.service, found);
}

void ServiceClient::Suspect() {
  MutexLock lock(&impl_->mu);
  impl_->suspect = true;
}

const std::string& ServiceClient::service() const { return impl_->options.service; }
ros2::Guid ServiceClient::request_writer() const { return impl_->Endpoints()->writer->guid(); }
ros2::Guid ServiceClient::reply_reader() const { return impl_->Endpoints()->reader->guid(); }

}  // namespace rips::dds

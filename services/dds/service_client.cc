#include "services/dds/service_client.h"

#include <optional>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/dds/service_endpoints.h"
#include "services/ros2/service_header.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::dds {
namespace {

// Between looks at what is matched; discovery itself takes milliseconds.
constexpr absl::Duration kReadyPoll = absl::Milliseconds(2);

int64_t DeadlineAfter(absl::Duration timeout) {
  return RealClock().Now().boottime_ns + absl::ToInt64Nanoseconds(timeout);
}

}  // namespace

struct ServiceClient::Impl {
  // Keeps the reply that `awaited` waits for, drops every other one.
  void OnReply(const RawWriter& writer, const RawSample& sample) ABSL_LOCKS_EXCLUDED(mu) {
    if (!sample.related_writer.none()) {
      MutexLock lock(&mu);
      if (awaited_sample == 0 || sample.related_writer != writer.guid()) return;
      if (sample.related_sequence != awaited_sample) return;
      AcceptReply(std::string(sample.payload));
      return;
    }
    absl::StatusOr<ros2::ServiceMessage> message = ros2::SplitServiceHeader(sample.payload);
    if (!message.ok()) return;
    MutexLock lock(&mu);
    if (awaited == 0) return;
    if (message->header != ros2::ServiceHeader{writer.instance(), awaited}) return;
    AcceptReply(std::move(message->payload));
  }
  void AcceptReply(std::string payload) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) {
    reply = std::move(payload);
    awaited = 0;
    awaited_sample = 0;
    changed.NotifyAll();
  }

  // Sends the request in the words of the server that is there.
  absl::Status Send(absl::string_view request, bool fastrtps) ABSL_EXCLUSIVE_LOCKS_REQUIRED(calling)
      ABSL_LOCKS_EXCLUDED(mu) {
    const ros2::ServiceHeader header = {.client_id = endpoints.writer->instance(),
                                        .sequence = ++last_sequence};
    std::string payload(request);
    if (!fastrtps) {
      RIPS_ASSIGN_OR_RETURN(payload, ros2::AddServiceHeader(request, header));
    }
    {
      MutexLock lock(&mu);
      awaited = fastrtps ? 0 : header.sequence;
      // The server names the request by its RTPS sequence number, which counts writes from 1.
      awaited_sample = fastrtps ? written + 1 : 0;
      reply.reset();
    }
    RIPS_RETURN_IF_ERROR(endpoints.writer->Write(payload));
    ++written;
    return absl::OkStatus();
  }

  absl::Status WaitForServer(int64_t deadline) ABSL_LOCKS_EXCLUDED(mu) {
    while (!FindWholeServer(endpoints).has_value()) {
      if (RealClock().Now().boottime_ns >= deadline) {
        return absl::DeadlineExceededError(
            absl::StrCat("no server for `", options.service, "` in time"));
      }
      MutexLock lock(&mu);
      changed.WaitFor(lock, kReadyPoll);
    }
    return absl::OkStatus();
  }

  absl::StatusOr<std::string> WaitForReply(int64_t deadline) ABSL_LOCKS_EXCLUDED(mu) {
    MutexLock lock(&mu);
    while (!reply.has_value() && RealClock().Now().boottime_ns < deadline) {
      changed.WaitUntil(lock, deadline);
    }
    awaited = 0;
    awaited_sample = 0;
    if (!reply.has_value()) {
      return absl::DeadlineExceededError(
          absl::StrCat("no reply from `", options.service, "` in time"));
    }
    return *std::exchange(reply, std::nullopt);
  }

  ServiceOptions options;
  Mutex calling;  // held for a whole call
  int64_t last_sequence ABSL_GUARDED_BY(calling) = 0;
  uint64_t written ABSL_GUARDED_BY(calling) = 0;
  Mutex mu;
  CondVar changed;
  int64_t awaited ABSL_GUARDED_BY(mu) = 0;          // sequence; 0 = no call
  uint64_t awaited_sample ABSL_GUARDED_BY(mu) = 0;  // the same of a call to rmw_fastrtps
  std::optional<std::string> reply ABSL_GUARDED_BY(mu);
  ServiceEndpoints endpoints;  // last, so it goes first: then OnReply runs no more
};

ServiceClient::ServiceClient(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ServiceClient::~ServiceClient() = default;

absl::StatusOr<std::unique_ptr<ServiceClient>> ServiceClient::Create(
    const Participant& participant, const ServiceOptions& options) {
  auto impl = std::make_unique<Impl>();
  impl->options = options;
  RIPS_ASSIGN_OR_RETURN(
      impl->endpoints,
      CreateServiceEndpoints(participant, options, ServiceSide::kClient,
                             [self = impl.get()](RawWriter& writer, const RawSample& sample) {
                               self->OnReply(writer, sample);
                             }));
  return std::unique_ptr<ServiceClient>(new ServiceClient(std::move(impl)));
}

bool ServiceClient::ServerReady() const { return FindWholeServer(impl_->endpoints).has_value(); }

std::optional<ros2::Guid> ServiceClient::Server() const {
  const std::optional<WholeServer> server = FindWholeServer(impl_->endpoints);
  return server.has_value() ? std::optional(server->request_reader) : std::nullopt;
}

absl::Status ServiceClient::WaitForServer(absl::Duration timeout) {
  return impl_->WaitForServer(DeadlineAfter(timeout));
}

absl::StatusOr<std::string> ServiceClient::Call(absl::string_view request, absl::Duration timeout) {
  const int64_t deadline = DeadlineAfter(timeout);
  MutexLock calling(&impl_->calling);
  RIPS_RETURN_IF_ERROR(impl_->WaitForServer(deadline));
  const std::optional<WholeServer> server = FindWholeServer(impl_->endpoints);
  RIPS_RETURN_IF_ERROR(impl_->Send(request, server.has_value() && server->fastrtps));
  return impl_->WaitForReply(deadline);
}

const std::string& ServiceClient::service() const { return impl_->options.service; }
ros2::Guid ServiceClient::request_writer() const { return impl_->endpoints.writer->guid(); }
ros2::Guid ServiceClient::reply_reader() const { return impl_->endpoints.reader->guid(); }

}  // namespace rips::dds

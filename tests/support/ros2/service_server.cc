#include "tests/support/ros2/service_server.h"

#include <thread>
#include <utility>

#include "absl/time/time.h"
#include "services/base/status_macros.h"
#include "services/dds/service_endpoints.h"
#include "services/ros2/service_header.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::dds {
namespace {

// A client may ask before we have seen where it listens; its reply would then be lost.
constexpr absl::Duration kClientWait = absl::Milliseconds(100);
constexpr absl::Duration kClientPoll = absl::Milliseconds(1);

struct Request {
  ros2::ServiceMessage message;
  ros2::Guid client;
};

}  // namespace

struct ServiceServer::Impl {
  explicit Impl(ServiceHandler to_call) : handler(std::move(to_call)) {}

  ~Impl() {
    endpoints.reader.reset();  // nothing is pushed any more
    requests.Close();
    if (worker.joinable()) worker.join();
  }

  void OnRequest(const RawSample& sample) {
    absl::StatusOr<ros2::ServiceMessage> message = ros2::SplitServiceHeader(sample.payload);
    if (!message.ok()) return;
    requests.Push({.message = *std::move(message), .client = sample.writer});
  }

  void Run() {
    while (std::optional<Request> request = requests.Pop(absl::InfiniteDuration())) {
      Answer(*request);
    }
  }

  void Answer(const Request& request) {
    const std::optional<std::string> reply = handler(request.message.payload);
    if (!reply.has_value()) return;
    const absl::StatusOr<std::string> payload =
        ros2::AddServiceHeader(*reply, request.message.header);
    if (!payload.ok()) return;
    WaitForClient(request.client);
    // Nobody is left to tell; the client's deadline says it.
    endpoints.writer->Write(*payload).IgnoreError();
  }

  void WaitForClient(const ros2::Guid& client) ABSL_LOCKS_EXCLUDED(mu) {
    if (client.none()) return;
    const RealClock clock;
    const int64_t deadline = clock.Now().boottime_ns + absl::ToInt64Nanoseconds(kClientWait);
    while (!MatchesReaderOf(*endpoints.writer, client.Participant()) &&
           clock.Now().boottime_ns < deadline) {
      MutexLock lock(&mu);
      never.WaitFor(lock, kClientPoll);
    }
  }

  const ServiceHandler handler;
  BoundedQueue<Request> requests{{.capacity = kServiceQueueMax}};
  Mutex mu;
  CondVar never;  // only to wait on
  ServiceEndpoints endpoints;
  std::thread worker;
};

ServiceServer::ServiceServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ServiceServer::~ServiceServer() = default;

absl::StatusOr<std::unique_ptr<ServiceServer>> ServiceServer::Create(const Participant& participant,
                                                                     const ServiceOptions& options,
                                                                     ServiceHandler handler) {
  auto impl = std::make_unique<Impl>(std::move(handler));
  RIPS_ASSIGN_OR_RETURN(
      impl->endpoints,
      CreateServiceEndpoints(
          participant, options, ServiceSide::kServer,
          [self = impl.get()](RawWriter&, const RawSample& sample) { self->OnRequest(sample); }));
  impl->worker = std::thread([self = impl.get()] { self->Run(); });
  return std::unique_ptr<ServiceServer>(new ServiceServer(std::move(impl)));
}

ros2::Guid ServiceServer::request_reader() const { return impl_->endpoints.reader->guid(); }
ros2::Guid ServiceServer::reply_writer() const { return impl_->endpoints.writer->guid(); }

}  // namespace rips::dds

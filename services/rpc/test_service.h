// The sensor service as a script for this folder's tests: remembers who called and what came,
// answers as configured. Any thread.
#ifndef RIPS_SERVICES_RPC_TEST_SERVICE_H_
#define RIPS_SERVICES_RPC_TEST_SERVICE_H_

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "rips/v1/sensor.grpc.pb.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/peer.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/bounded_queue.h"

namespace rips::rpc {

inline constexpr absl::Duration kPatience = absl::Seconds(30);

class TestService final : public v1::SensorService::Service {
 public:
  struct Received {
    std::string peer;  // its URI
    v1::SensorMessage message;
  };

  grpc::Status Observe(
      grpc::ServerContext* context,
      grpc::ServerReaderWriter<v1::SensorReply, v1::SensorMessage>* stream) override {
    ++calls;
    const absl::StatusOr<Peer> peer = PeerOf(*context->auth_context());
    if (require_peer && !peer.ok()) return ToGrpc(peer.status());
    if (peer.ok()) peer_not_after = absl::ToUnixSeconds(peer->not_after);
    if (refuse_with != grpc::StatusCode::OK) return grpc::Status(refuse_with, "refused");
    if (hold) gate.Pop(kPatience);
    v1::SensorMessage message;
    while (stream->Read(&message)) {
      received.Push({peer.ok() ? ToString(peer->identity) : "", message});
      if (!answer) continue;
      v1::SensorReply reply;
      reply.mutable_heartbeat()->set_echo_boottime_ns(message.heartbeat().clock().boottime_ns());
      if (!stream->Write(reply)) break;
    }
    return grpc::Status::OK;
  }

  BoundedQueue<Received> received{{.capacity = 100000}};
  std::atomic<int> calls = 0;
  std::atomic<bool> require_peer = true;
  std::atomic<bool> answer = true;
  std::atomic<bool> hold = false;  // read nothing until something is pushed into `gate`
  BoundedQueue<int> gate{{.capacity = 1}};
  std::atomic<grpc::StatusCode> refuse_with = grpc::StatusCode::OK;
  std::atomic<int64_t> peer_not_after = 0;
};

inline std::shared_ptr<const Credentials> LoadOrDie(const TlsFiles& files) {
  auto credentials = Credentials::Load(files);
  RIPS_CHECK(credentials.ok(), credentials.status().ToString().c_str());
  return *credentials;
}

inline std::unique_ptr<RpcServer> StartOrDie(const std::string& listen, const TlsFiles& files,
                                             TestService* service) {
  auto server =
      RpcServer::Start({.listen = listen, .credentials = LoadOrDie(files)->ForServer()}, {service});
  RIPS_CHECK(server.ok(), server.status().ToString().c_str());
  return *std::move(server);
}

// A client whose events land in queues.
class TestClient {
 public:
  struct End {
    grpc::Status status;
    CloseClass close_class;
  };
  using Client = BidiClient<v1::SensorMessage, v1::SensorReply>;

  explicit TestClient(BidiClientOptions options)
      : client(std::move(options),
               Client::Callbacks{
                   .start_stream =
                       [](const auto& channel, auto* context) {
                         return v1::SensorService::NewStub(channel)->Observe(context);
                       },
                   .on_connected =
                       [this] {
                         v1::SensorMessage hello;
                         hello.mutable_hello()->set_domain(++connected);
                         return hello;
                       },
                   .on_message = [this](v1::SensorReply reply) { replies.Push(std::move(reply)); },
                   .on_disconnected =
                       [this](const grpc::Status& status, CloseClass close_class) {
                         ends.Push({status, close_class});
                       }}) {
    client.Start();
  }

  static v1::SensorMessage Heartbeat(uint64_t boottime_ns) {
    v1::SensorMessage message;
    message.mutable_heartbeat()->mutable_clock()->set_boottime_ns(boottime_ns);
    return message;
  }

  std::atomic<uint32_t> connected = 0;
  BoundedQueue<v1::SensorReply> replies{{.capacity = 100000}};
  BoundedQueue<End> ends{{.capacity = 100000}};
  Client client;  // last: its threads use the others
};

inline BidiClientOptions ClientOptions(const std::string& server, const TlsFiles& files) {
  return {.servers = {server},
          .credentials = LoadOrDie(files)->ForClient(),
          .backoff = {.initial = absl::Milliseconds(20), .max = absl::Milliseconds(100)},
          .connect_timeout = absl::Seconds(10)};
}

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_TEST_SERVICE_H_

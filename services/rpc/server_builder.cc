#include "services/rpc/server_builder.h"

#include <chrono>
#include <cstdint>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "grpc/impl/codegen/grpc_types.h"
#include "grpcpp/health_check_service_interface.h"
#include "grpcpp/server_builder.h"
#include "grpcpp/support/server_interceptor.h"
#include "services/base/status_macros.h"
#include "services/rpc/bidi_client.h"

namespace rips::rpc {
namespace {

// One connection carries one agent's stream, or an operator's few calls. A client over the limit
// hangs without an error, so it is generous; services refuse by status.
constexpr int kStreamsPerConnectionMax = 100;
// Bytes a peer may send ahead of our reading.
constexpr int kLookaheadBytes = 256 << 10;
constexpr absl::Duration kHandshakeTimeout = absl::Seconds(5);
// Of a connection without calls; an open header block is no call.
constexpr absl::Duration kIdleTimeout = absl::Minutes(5);

// Tells the gate of a call whose one request cannot be decoded: no handler sees it.
class RequestCheck final : public grpc::experimental::Interceptor {
 public:
  RequestCheck(CallGate* gate, const grpc::ServerContextBase& context)
      : gate_(gate), context_(context) {}
  void Intercept(grpc::experimental::InterceptorBatchMethods* methods) override {
    using Hook = grpc::experimental::InterceptionHookPoints;
    if (methods->QueryInterceptionHookPoint(Hook::POST_RECV_MESSAGE) &&
        methods->GetRecvMessage() == nullptr) {
      gate_->RefuseUndecodable(context_);
    }
    methods->Proceed();
  }

 private:
  CallGate* gate_;
  const grpc::ServerContextBase& context_;  // of the call, which owns this too
};

// Counts calls before anything is done for them, and checks those of one request. Streams are not
// intercepted, which would cost each message: ServerStream sees to theirs.
class CallCounter final : public grpc::experimental::ServerInterceptorFactoryInterface {
 public:
  CallCounter(ConnectionGuard* guard, CallGate* gate) : guard_(guard), gate_(gate) {}
  grpc::experimental::Interceptor* CreateServerInterceptor(
      grpc::experimental::ServerRpcInfo* info) override {
    guard_->OnCall(*info->server_context());
    using Type = grpc::experimental::ServerRpcInfo::Type;
    const bool one = info->type() == Type::UNARY || info->type() == Type::SERVER_STREAMING;
    if (gate_ == nullptr || !one) return nullptr;
    return new RequestCheck(gate_, *info->server_context());
  }

 private:
  ConnectionGuard* guard_;
  CallGate* gate_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<RpcServer>> RpcServer::Start(
    const RpcServerOptions& options, const std::vector<grpc::Service*>& services) {
  grpc::EnableDefaultHealthCheckService(true);
  std::unique_ptr<RpcServer> server(new RpcServer());
  server->guard_ = options.guard;
  if (options.guard == nullptr) {
    RIPS_ASSIGN_OR_RETURN(
        server->own_guard_,
        ConnectionGuard::Listen(options.listen,
                                {.budget = {.silent_ns = INT64_MAX, .unidentified_bytes = 1e12}},
                                &server->clock_, nullptr));
    server->guard_ = server->own_guard_.get();
  }
  grpc::ServerBuilder builder;
  using Acceptor = grpc::ServerBuilder::experimental_type::ExternalConnectionType;
  auto acceptor =
      builder.experimental().AddExternalConnectionAcceptor(Acceptor::FROM_FD, options.credentials);
  std::vector<std::unique_ptr<grpc::experimental::ServerInterceptorFactoryInterface>> counters;
  counters.push_back(std::make_unique<CallCounter>(server->guard_, options.gate));
  builder.experimental().SetInterceptorCreators(std::move(counters));
  builder.SetMaxReceiveMessageSize(kMessageBytesMax);
  builder.SetMaxSendMessageSize(kMessageBytesMax);
  const auto set = [&](const char* name, int64_t value) {
    builder.AddChannelArgument(name, static_cast<int>(value));
  };
  set(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, absl::ToInt64Milliseconds(kHandshakeTimeout));
  set(GRPC_ARG_MAX_CONNECTION_IDLE_MS, absl::ToInt64Milliseconds(kIdleTimeout));
  set(GRPC_ARG_MAX_METADATA_SIZE, kMetadataBytesMax);
  // A compressed message would be unpacked whole before its size is looked at: 2 MB become 2 GB.
  // None of ours compresses; what is compressed cannot be decoded then.
  set(GRPC_ARG_ENABLE_PER_MESSAGE_DECOMPRESSION, 0);
  set(GRPC_ARG_MAX_CONCURRENT_STREAMS, kStreamsPerConnectionMax);
  set(GRPC_ARG_KEEPALIVE_TIME_MS, absl::ToInt64Milliseconds(options.keepalive_time));
  set(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, absl::ToInt64Milliseconds(options.keepalive_timeout));
  set(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
  set(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  // Clients may ping as often as their configuration says; without this they are cut off for it.
  set(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, 500);
  set(GRPC_ARG_HTTP2_MAX_PING_STRIKES, 0);
  // A fixed window instead of one that grows to megabytes of what has not been judged yet.
  set(GRPC_ARG_HTTP2_BDP_PROBE, 0);
  set(GRPC_ARG_HTTP2_STREAM_LOOKAHEAD_BYTES, kLookaheadBytes);
  for (grpc::Service* service : services) builder.RegisterService(service);
  builder.RegisterCallbackGenericService(&server->unknown_methods_);
  server->server_ = builder.BuildAndStart();
  if (server->server_ == nullptr) {
    return absl::InternalError("gRPC could not build the server");
  }
  server->stopped_ = false;
  server->guard_->Start(std::move(acceptor));
  const absl::string_view listen = options.listen;
  server->address_ = absl::StrCat(listen.substr(0, listen.rfind(':')), ":", server->port());
  server->SetServing(true);
  return server;
}

RpcServer::~RpcServer() { Shutdown(absl::ZeroDuration()); }

void RpcServer::SetServing(bool serving) {
  server_->GetHealthCheckService()->SetServingStatus(serving);
}

void RpcServer::Shutdown(absl::Duration grace) {
  if (stopped_) return;
  stopped_ = true;
  SetServing(false);
  guard_->Stop();
  // Without a deadline one open stream would keep this waiting for ever.
  server_->Shutdown(std::chrono::system_clock::now() + absl::ToChronoMilliseconds(grace));
  server_->Wait();
}

}  // namespace rips::rpc

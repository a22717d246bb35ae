// The policy server's gRPC server, with this project's limits.
#ifndef RIPS_SERVICES_RPC_SERVER_BUILDER_H_
#define RIPS_SERVICES_RPC_SERVER_BUILDER_H_

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "grpcpp/generic/async_generic_service.h"
#include "grpcpp/impl/service_type.h"
#include "grpcpp/security/server_credentials.h"
#include "grpcpp/server.h"
#include "services/rpc/call_gate.h"
#include "services/rpc/connection_guard.h"
#include "services/runtime/real_clock.h"

namespace rips::rpc {

struct RpcServerOptions {
  std::string listen;  // `HOST:PORT`; port 0 = any
  // Listens already, and outlives the server; null = one of its own at `listen`,
  // which lets peers that no gate identifies send as much as they like.
  ConnectionGuard* guard = nullptr;
  // Hears of calls that end before a handler is asked; outlives the server. Null = none.
  CallGate* gate = nullptr;
  std::shared_ptr<grpc::ServerCredentials> credentials;
  absl::Duration keepalive_time = absl::Seconds(5);
  absl::Duration keepalive_timeout = absl::Seconds(5);
};

// Also answers grpc.health.v1.Health. Start and Shutdown on one thread.
class RpcServer {
 public:
  // `services` are not owned and outlive the server. Unavailable if it cannot listen (the port is
  // never shared with another process).
  static absl::StatusOr<std::unique_ptr<RpcServer>> Start(
      const RpcServerOptions& options, const std::vector<grpc::Service*>& services);
  // Shutdown(ZeroDuration) if that was not done.
  ~RpcServer();

  int port() const { return guard_->port(); }
  // `listen` with the real port.
  const std::string& address() const { return address_; }
  // What the health service says; serving from the start.
  void SetServing(bool serving);

  // Takes no new calls, waits up to `grace` for the running ones, then cancels them and waits for
  // their reactors' OnDone: each must Finish() in OnCancel, or this never returns. Not from a gRPC
  // callback. Idempotent.
  void Shutdown(absl::Duration grace);

 private:
  RpcServer() = default;

  RealClock clock_;
  std::unique_ptr<ConnectionGuard> own_guard_;
  ConnectionGuard* guard_ = nullptr;
  // Answers methods that there are not, so that they are counted as calls.
  grpc::CallbackGenericService unknown_methods_;
  std::unique_ptr<grpc::Server> server_;
  std::string address_;
  bool stopped_ = true;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_SERVER_BUILDER_H_

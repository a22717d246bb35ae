// Ends a watch when the certificate under which the server answered expires: the library does not.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_SERVER_EXPIRY_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_SERVER_EXPIRY_H_

#include <memory>
#include <utility>

#include "absl/time/time.h"
#include "grpcpp/client_context.h"
#include "services/rpc/peer.h"
#include "services/rpc/session_watch.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/real_clock.h"

namespace rips::ripsctl {

// Of one call; `context` is not owned and outlives this.
class ServerExpiry {
 public:
  explicit ServerExpiry(grpc::ClientContext* context) : context_(context) {}

  // A message has come. The first one counts; without TLS nothing is watched.
  void Received() {
    if (session_ != nullptr) return;
    const auto auth = context_->auth_context();
    if (auth == nullptr) return;
    absl::StatusOr<rpc::Peer> peer = rpc::PeerOf(*auth);
    if (!peer.ok()) return;
    session_ = watch_.Add(*std::move(peer), [this](const grpc::Status& status) {
      why_.Push(grpc::Status(status.error_code(), "the policy server: " + status.error_message()));
      context_->TryCancel();
    });
    session_->greeted = true;
  }
  // How the call ended, `status` being what the library says.
  grpc::Status End(const grpc::Status& status) {
    const auto why = why_.Pop(absl::ZeroDuration());
    return why.has_value() ? *why : status;
  }

 private:
  grpc::ClientContext* context_;
  const RealClock clock_;
  BoundedQueue<grpc::Status> why_{{.capacity = 1}};
  rpc::SessionWatch watch_{&clock_};
  std::shared_ptr<rpc::SessionWatch::Session> session_;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_SERVER_EXPIRY_H_

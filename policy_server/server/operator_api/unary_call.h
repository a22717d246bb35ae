// A unary call that is served: what its caller holds of its quota until it is over, and what is
// recorded if it comes to nothing.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_UNARY_CALL_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_UNARY_CALL_H_

#include <functional>
#include <utility>

#include "absl/status/status.h"
#include "grpcpp/support/server_callback.h"
#include "policy_server/server/operator_api/caller_quota.h"
#include "services/rpc/status_conversion.h"

namespace rips::operator_api {

// Deletes itself when the call is over.
class UnaryCall final : public grpc::ServerUnaryReactor {
 public:
  using OnRefused = std::function<void(const absl::Status&)>;

  // `on_refused` may be empty.
  UnaryCall(CallerQuota::Ticket ticket, OnRefused on_refused)
      : ticket_(std::move(ticket)), on_refused_(std::move(on_refused)) {}

  // Once, on any thread: answers the call.
  void End(const absl::Status& status) {
    if (!status.ok() && on_refused_) on_refused_(status);
    Finish(rpc::ToGrpc(status));
  }

 private:
  void OnDone() override { delete this; }

  CallerQuota::Ticket ticket_;
  OnRefused on_refused_;
};

// Ends a call that is not served.
inline grpc::ServerUnaryReactor* Refuse(grpc::CallbackServerContext* context,
                                        const absl::Status& status) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(rpc::ToGrpc(status));
  return reactor;
}

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_UNARY_CALL_H_

#include "policy_server/server/enrol/enrolment_service.h"

#include <utility>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "rips/v1/operator.pb.h"
#include "services/rpc/peer.h"
#include "services/rpc/status_conversion.h"
#include "services/wire_limits/field_limits.h"

namespace rips::enrol {

EnrolmentService::EnrolmentService(Enrolment* enrolment, rpc::SessionWatch* watch,
                                   audit::OrderAudit* audit)
    : enrolment_(enrolment), watch_(watch), audit_(audit) {}

void EnrolmentService::Record(const char* call, const rpc::Peer& peer, const std::string& address,
                              const absl::StatusOr<Fetched>& fetched) {
  if (audit_ == nullptr) return;
  // What came of it says more than the request, which is a key.
  rips::v1::IssuedState issued;
  std::string robot = peer.identity.robot;
  if (fetched.ok()) {
    const store::IssuedRecord& record = fetched->record;
    issued.set_uri(record.uri);
    issued.set_serial(record.serial);
    issued.set_not_after_unix_ns(record.not_after_unix_ns);
    issued.set_token(record.token);
    const auto identity = rpc::ParseSpiffeUri(record.uri);
    if (identity.ok()) robot = identity->robot;
  }
  audit_->Record({.caller = rpc::Describe(peer),
                  .address = address,
                  .call = call,
                  .request = issued,
                  .status = fetched.status(),
                  .robot = robot});
}

grpc::ServerUnaryReactor* EnrolmentService::Answer(
    grpc::CallbackServerContext* context, rpc::Role role, const char* call,
    const google::protobuf::Message& request, rips::v1::IssuedCertificate* response,
    std::function<absl::StatusOr<Fetched>(const rpc::Peer&)> fetch) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  const auto end = [reactor](const absl::Status& status) {
    reactor->Finish(rpc::ToGrpc(status));
    return reactor;
  };
  const absl::StatusOr<rpc::Peer> peer = watch_->Admit(*context, role);
  if (!peer.ok()) return end(peer.status());
  if (const auto hit = wire_limits::Check(request)) {
    return end(watch_->gate().Refuse({"limit", hit->ToStatus()}, &*peer, context->peer()));
  }
  if (enrolment_ == nullptr) {
    return end(absl::UnimplementedError(
        "this server issues no certificates: its configuration has no `enrolment`"));
  }
  const auto task = [this, context, end, call, response, peer = *peer, address = context->peer(),
                     fetch = std::move(fetch)] {
    if (context->IsCancelled()) {
      end(absl::CancelledError("the caller has gone; nothing was signed"));
      return;
    }
    absl::StatusOr<Fetched> fetched = fetch(peer);
    Record(call, peer, address, fetched);
    if (fetched.ok()) {
      response->set_certificates_pem(std::move(fetched->certificates_pem));
      response->set_authorities_pem(std::move(fetched->authorities_pem));
    }
    end(fetched.status());
  };
  if (!enrolment_->threads().Push(task)) {
    return end(absl::ResourceExhaustedError("too many robots ask for certificates; try again"));
  }
  return reactor;
}

grpc::ServerUnaryReactor* EnrolmentService::Enrol(grpc::CallbackServerContext* context,
                                                  const rips::v1::EnrolRequest* request,
                                                  rips::v1::IssuedCertificate* response) {
  return Answer(context, rpc::Role::kEnrolment, "Enrol", *request, response,
                [this, request](const rpc::Peer& peer) {
                  return enrolment_->Enrol(peer.identity, request->role(), request->request_pem());
                });
}

grpc::ServerUnaryReactor* EnrolmentService::Renew(grpc::CallbackServerContext* context,
                                                  const rips::v1::RenewRequest* request,
                                                  rips::v1::IssuedCertificate* response) {
  // What it may be; who it is, Admit says.
  const absl::StatusOr<rpc::Peer> peer = rpc::PeerOf(*context->auth_context());
  const bool actuator = peer.ok() && peer->identity.role == rpc::Role::kActuator;
  return Answer(context, actuator ? rpc::Role::kActuator : rpc::Role::kSensor, "Renew", *request,
                response, [this, request](const rpc::Peer& agent) {
                  return enrolment_->Renew(agent.identity, request->request_pem());
                });
}

}  // namespace rips::enrol

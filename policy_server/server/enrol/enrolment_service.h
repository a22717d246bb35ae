// EnrolmentService: what robots call for their certificates, on the server's one port. Its work
// runs on the enrolment's threads, so that a flood of requests, or a slow certificate authority,
// costs the others those threads alone. A call that its caller has given up is not begun.
#ifndef RIPS_POLICY_SERVER_SERVER_ENROL_ENROLMENT_SERVICE_H_
#define RIPS_POLICY_SERVER_SERVER_ENROL_ENROLMENT_SERVICE_H_

#include <functional>
#include <string>

#include "policy_server/server/audit/order_audit.h"
#include "policy_server/server/enrol/enrolment.h"
#include "rips/v1/enrolment.grpc.pb.h"
#include "services/rpc/session_watch.h"

namespace rips::enrol {

class EnrolmentService final : public rips::v1::EnrolmentService::CallbackService {
 public:
  // Nothing is owned; all outlive every call. `enrolment` null: all is UNIMPLEMENTED. `audit` may
  // be null.
  EnrolmentService(Enrolment* enrolment, rpc::SessionWatch* watch, audit::OrderAudit* audit);

  grpc::ServerUnaryReactor* Enrol(grpc::CallbackServerContext* context,
                                  const rips::v1::EnrolRequest* request,
                                  rips::v1::IssuedCertificate* response) override;
  grpc::ServerUnaryReactor* Renew(grpc::CallbackServerContext* context,
                                  const rips::v1::RenewRequest* request,
                                  rips::v1::IssuedCertificate* response) override;

 private:
  void Record(const char* call, const rpc::Peer& peer, const std::string& address,
              const absl::StatusOr<Fetched>& fetched);
  // Admits the peer, then runs `fetch` on a thread; records what came of it.
  grpc::ServerUnaryReactor* Answer(grpc::CallbackServerContext* context, rpc::Role role,
                                   const char* call, const google::protobuf::Message& request,
                                   rips::v1::IssuedCertificate* response,
                                   std::function<absl::StatusOr<Fetched>(const rpc::Peer&)> fetch);

  Enrolment* const enrolment_;
  rpc::SessionWatch* const watch_;
  audit::OrderAudit* const audit_;
};

}  // namespace rips::enrol

#endif  // RIPS_POLICY_SERVER_SERVER_ENROL_ENROLMENT_SERVICE_H_

// EnrolmentService: what robots call for their certificates, on the server's one port. Its work
// runs on a thread of its own, so that a flood of requests costs the others that thread alone.
#ifndef RIPS_POLICY_SERVER_SERVER_ENROL_ENROLMENT_SERVICE_H_
#define RIPS_POLICY_SERVER_SERVER_ENROL_ENROLMENT_SERVICE_H_

#include <functional>
#include <string>
#include <thread>

#include "policy_server/server/audit/order_audit.h"
#include "policy_server/server/enrol/enrolment.h"
#include "rips/v1/enrolment.grpc.pb.h"
#include "services/rpc/session_watch.h"
#include "services/runtime/bounded_queue.h"

namespace rips::enrol {

class EnrolmentService final : public rips::v1::EnrolmentService::CallbackService {
 public:
  // Calls that wait at most; one more is refused.
  static constexpr size_t kWaitingMax = 64;

  // Nothing is owned; all outlive every call. `enrolment` null: all is UNIMPLEMENTED. `audit` may
  // be null.
  EnrolmentService(Enrolment* enrolment, rpc::SessionWatch* watch, audit::OrderAudit* audit);
  // After the last call.
  ~EnrolmentService() override;

  grpc::ServerUnaryReactor* Enrol(grpc::CallbackServerContext* context,
                                  const rips::v1::EnrolRequest* request,
                                  rips::v1::IssuedCertificate* response) override;
  grpc::ServerUnaryReactor* Renew(grpc::CallbackServerContext* context,
                                  const rips::v1::RenewRequest* request,
                                  rips::v1::IssuedCertificate* response) override;

 private:
  void Record(const char* call, const rpc::Peer& peer, const std::string& address,
              const absl::StatusOr<Fetched>& fetched);
  // Admits the peer, then runs `fetch` on the thread; records what came of it.
  grpc::ServerUnaryReactor* Answer(grpc::CallbackServerContext* context, rpc::Role role,
                                   const char* call, const google::protobuf::Message& request,
                                   rips::v1::IssuedCertificate* response,
                                   std::function<absl::StatusOr<Fetched>(const rpc::Peer&)> fetch);

  Enrolment* const enrolment_;
  rpc::SessionWatch* const watch_;
  audit::OrderAudit* const audit_;
  BoundedQueue<std::function<void()>> tasks_{{.capacity = kWaitingMax}};
  std::thread thread_;
};

}  // namespace rips::enrol

#endif  // RIPS_POLICY_SERVER_SERVER_ENROL_ENROLMENT_SERVICE_H_

// The calls about tokens and certificates of a server that plays OperatorService for a test.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_FAKE_ENROL_OPERATOR_H_
#define RIPS_POLICY_SERVER_RIPSCTL_FAKE_ENROL_OPERATOR_H_

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/ripsctl/fake_rules_operator.h"
#include "rips/v1/operator.grpc.pb.h"

namespace rips::ripsctl {

class FakeEnrolOperator : public FakeRulesOperator {
 public:
  v1::ListEnrolmentsResponse enrolments;

  grpc::Status CreateEnrolmentToken(grpc::ServerContext*,
                                    const v1::CreateEnrolmentTokenRequest* request,
                                    v1::CreateEnrolmentTokenResponse* response) override {
    response->set_id("00112233aabbccdd");
    *response->mutable_roles() = request->roles();
    if (request->roles().empty()) response->add_roles("sensor");
    response->set_expires_unix_ns(1'700'000'000'000'000'000);
    response->set_certificates_pem("certificates");
    response->set_authorities_pem("authorities");
    return Remember(absl::StrCat("CreateEnrolmentToken ", request->robot(), " ", request->host(),
                                 " ", absl::StrJoin(request->roles(), ","), " ",
                                 request->valid_ms()));
  }
  grpc::Status RevokeEnrolmentToken(grpc::ServerContext*,
                                    const v1::RevokeEnrolmentTokenRequest* request,
                                    v1::RevokeEnrolmentTokenResponse*) override {
    return Remember("RevokeEnrolmentToken " + request->id());
  }
  grpc::Status ListEnrolments(grpc::ServerContext*, const v1::ListEnrolmentsRequest* request,
                              v1::ListEnrolmentsResponse* response) override {
    *response = enrolments;
    return Remember("ListEnrolments " + request->robot());
  }
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_FAKE_ENROL_OPERATOR_H_

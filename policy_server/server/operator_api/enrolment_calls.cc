// Calls about tokens and issued certificates; they run on the thread for reads, which may wait for
// the disk. One that signs runs on the enrolment's threads, which may wait for a program.
#include <algorithm>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/enrol/enrolment.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "services/base/status_macros.h"
#include "services/rpc/peer.h"
#include "services/runtime/log.h"

namespace rips::operator_api {
namespace {

constexpr int kListedMax = 1'000;

absl::Status NoEnrolment() {
  return absl::UnimplementedError(
      "this server issues no certificates: its configuration has no `enrolment`");
}

std::string RobotOf(absl::string_view uri) {
  const absl::StatusOr<rpc::PeerIdentity> identity = rpc::ParseSpiffeUri(uri);
  return identity.ok() ? identity->robot : "";
}

// Of each token the roles that it has fetched, by the URIs of what was issued.
std::map<std::string, std::vector<std::string>> UsedRoles(
    const std::vector<store::IssuedRecord>& issued) {
  std::map<std::string, std::vector<std::string>> used;
  for (const store::IssuedRecord& each : issued) {
    const absl::StatusOr<rpc::PeerIdentity> identity = rpc::ParseSpiffeUri(each.uri);
    if (each.token.empty() || !identity.ok()) continue;
    used[each.token].emplace_back(rpc::RoleName(identity->role));
  }
  return used;
}

absl::Status List(const std::string& robot, store::EnrolmentStore& store,
                  rips::v1::ListEnrolmentsResponse& response) {
  RIPS_ASSIGN_OR_RETURN(const std::vector<store::TokenRecord> tokens, store.ListTokens());
  RIPS_ASSIGN_OR_RETURN(const std::vector<store::IssuedRecord> issued, store.ListIssued(""));
  const auto used = UsedRoles(issued);
  for (const store::TokenRecord& token : tokens) {
    if (!robot.empty() && token.robot != robot) continue;
    if (response.tokens_size() == kListedMax) {
      response.set_cut(true);
      break;
    }
    rips::v1::TokenState& out = *response.add_tokens();
    out.set_id(token.id);
    out.set_robot(token.robot);
    out.set_host(token.host);
    for (absl::string_view role : absl::StrSplit(token.roles, ',')) {
      out.add_roles(std::string(role));
    }
    if (const auto roles = used.find(token.id); roles != used.end()) {
      for (const std::string& role : roles->second) out.add_used_roles(role);
    }
    out.set_by(token.by);
    out.set_time_unix_ns(token.time_unix_ns);
    out.set_expires_unix_ns(token.expires_unix_ns);
    out.set_revoked(token.revoked);
  }
  for (const store::IssuedRecord& each : issued) {
    if (!robot.empty() && RobotOf(each.uri) != robot) continue;
    if (response.issued_size() == kListedMax) {
      response.set_cut(true);
      break;
    }
    rips::v1::IssuedState& out = *response.add_issued();
    out.set_uri(each.uri);
    out.set_serial(each.serial);
    out.set_time_unix_ns(each.time_unix_ns);
    out.set_not_after_unix_ns(each.not_after_unix_ns);
    out.set_token(each.token);
  }
  return absl::OkStatus();
}

}  // namespace

grpc::ServerUnaryReactor* OperatorService::CreateEnrolmentToken(
    grpc::CallbackServerContext* context, const rips::v1::CreateEnrolmentTokenRequest* request,
    rips::v1::CreateEnrolmentTokenResponse* response) {
  const auto who =
      AuthorizeOrder(context, "CreateEnrolmentToken", *request, rpc::OperatorRole::kAdmin,
                     Use::kOrder, /*weight=*/1, /*effects_are_recorded=*/true);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.enrolment == nullptr) return Refuse(context, NoEnrolment());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  const auto task = [this, context, reactor, request, response, by = rpc::Describe(*who)] {
    if (context->IsCancelled()) {
      return reactor->End(absl::CancelledError("the caller has gone; nothing was made"));
    }
    const absl::StatusOr<enrol::NewToken> token = access_.enrolment->CreateToken(
        {.robot = request->robot(),
         .host = request->host(),
         .roles = {request->roles().begin(), request->roles().end()},
         .valid = absl::Milliseconds(static_cast<int64_t>(request->valid_ms())),
         .request_pem = request->request_pem(),
         .by = by});
    if (!token.ok()) return reactor->End(token.status());
    LogInfo("made an enrolment token", {{"operator", by},
                                        {"token", token->record.id},
                                        {"robot", token->record.robot},
                                        {"host", token->record.host},
                                        {"roles", token->record.roles}});
    if (access_.audit != nullptr) {
      rips::v1::TokenState made;
      made.set_id(token->record.id);
      made.set_robot(token->record.robot);
      made.set_host(token->record.host);
      made.add_roles(token->record.roles);
      made.set_expires_unix_ns(token->record.expires_unix_ns);
      access_.audit->Record({.caller = by,
                             .address = context->peer(),
                             .call = "CreateEnrolmentToken",
                             .request = made,
                             .status = absl::OkStatus()});
    }
    response->set_id(token->record.id);
    for (absl::string_view role : absl::StrSplit(token->record.roles, ',')) {
      response->add_roles(std::string(role));
    }
    response->set_expires_unix_ns(token->record.expires_unix_ns);
    response->set_certificates_pem(token->fetched.certificates_pem);
    response->set_authorities_pem(token->fetched.authorities_pem);
    reactor->End(absl::OkStatus());
  };
  if (!access_.enrolment->threads().Push(task)) {
    reactor->End(
        absl::ResourceExhaustedError("too many robots ask for certificates; try again later"));
  }
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::RevokeEnrolmentToken(
    grpc::CallbackServerContext* context, const rips::v1::RevokeEnrolmentTokenRequest* request,
    rips::v1::RevokeEnrolmentTokenResponse*) {
  const auto who =
      AuthorizeOrder(context, "RevokeEnrolmentToken", *request, rpc::OperatorRole::kAdmin);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.enrolment == nullptr) return Refuse(context, NoEnrolment());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  Read(reactor,
       [this, reactor, request] { reactor->End(access_.enrolment->RevokeToken(request->id())); });
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ListEnrolments(
    grpc::CallbackServerContext* context, const rips::v1::ListEnrolmentsRequest* request,
    rips::v1::ListEnrolmentsResponse* response) {
  const auto who = Authorize(context, *request, rpc::OperatorRole::kViewer, Use::kQuery);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.enrolment == nullptr) return Refuse(context, NoEnrolment());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  Read(reactor, [this, reactor, request, response] {
    reactor->End(List(request->robot(), access_.enrolment->store(), *response));
  });
  return reactor;
}

}  // namespace rips::operator_api

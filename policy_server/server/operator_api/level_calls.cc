// Raise, DeEscalate and Approve: a robot's level, changed by operators on the robot's thread.
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/server/operator_api/level_codec.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/operator_api/requesters.h"
#include "policy_server/server/operator_api/unary_call.h"
#include "services/model_proto/decision_id_codec.h"
#include "services/rpc/peer.h"
#include "services/runtime/log.h"

namespace rips::operator_api {
namespace {

using pipeline::Queue;
using pipeline::Robot;
using rpc::OperatorRole;

pipeline::LevelReply ReplyTo(UnaryCall* reactor, rips::v1::LevelResponse* response) {
  return [reactor, response](const pipeline::LevelAnswer& answer) {
    operator_api::Encode(answer, *response);
    reactor->End(answer.status);
  };
}

}  // namespace

void OperatorService::RecordRefusal(const grpc::CallbackServerContext& context,
                                    const std::string& robot, const std::string& to,
                                    const std::string& approval, const absl::Status& why) {
  const absl::StatusOr<rpc::Peer> peer = rpc::PeerOf(*context.auth_context());
  if (!peer.ok() || peer->identity.role != rpc::Role::kOperator) return;
  if (access_.quota != nullptr &&
      !access_.quota->Take(rpc::ToString(peer->identity), false, Use::kQuery).ok()) {
    return;  // one that asks again and again is on record
  }
  pipeline_
      ->Post(robot, Queue::kOrders,
             [order = pipeline::LevelOrder{.operator_name = OperatorName(*peer), .to = to},
              approval, why](Robot& each) mutable {
               // Of a lowering that does not wait there is no record, as of an unknown level.
               for (const pipeline::PendingApproval& pending : each.Status().pending_approvals) {
                 if (pending.id == approval) order.to = pending.to;
               }
               each.RecordRefusedOrder(order, why);
             })
      .IgnoreError();  // of an unknown robot there is no record
}

grpc::ServerUnaryReactor* OperatorService::DeEscalate(grpc::CallbackServerContext* context,
                                                      const rips::v1::LevelRequest* request,
                                                      rips::v1::LevelResponse* response) {
  return ChangeLevel(context, request, response, Direction::kLower);
}

grpc::ServerUnaryReactor* OperatorService::Raise(grpc::CallbackServerContext* context,
                                                 const rips::v1::LevelRequest* request,
                                                 rips::v1::LevelResponse* response) {
  return ChangeLevel(context, request, response, Direction::kRaise);
}

grpc::ServerUnaryReactor* OperatorService::ChangeLevel(grpc::CallbackServerContext* context,
                                                       const rips::v1::LevelRequest* request,
                                                       rips::v1::LevelResponse* response,
                                                       Direction direction) {
  const char* const call = direction == Direction::kRaise ? "Raise" : "DeEscalate";
  // Who only asks what would happen has tried nothing.
  const auto who = request->dry_run()
                       ? Authorize(context, *request, OperatorRole::kOperator, Use::kQuery)
                       : AuthorizeOrder(context, call, *request, OperatorRole::kOperator);
  if (!who.ok()) {
    if (!request->dry_run()) {
      RecordRefusal(*context, request->robot(), request->to(), "", who.status());
    }
    return Refuse(context, who.status());
  }
  LogInfo(direction == Direction::kRaise ? "operator raises" : "operator lowers",
          {{"operator", rpc::Describe(*who)},
           {"robot", request->robot()},
           {"to", request->to()},
           {"reason", request->reason()},
           {"dry_run", request->dry_run()}});
  pipeline::LevelOrder order{
      .operator_name = OperatorName(*who),
      .to = request->to(),
      .reason = request->reason(),
      .expected_level = request->expected_level(),
      .expected_decision_id = model_proto::Decode(request->expected_decision_id()),
      .dry_run = request->dry_run(),
      .accept_blind = request->accept_blind(),
      .request_id = RequestKey(*who, call, request->request_id()),
      .identity = IdentityOf(who->identity)};
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  pipeline::LevelReply reply = [reply = ReplyTo(reactor, response), this,
                                peer = rpc::Peer(*who)](const pipeline::LevelAnswer& answer) {
    if (!answer.pending_approval_id.empty()) requesters_.Add(answer.pending_approval_id, peer);
    reply(answer);
  };
  const absl::Status posted = pipeline_->Post(
      request->robot(), Queue::kOrders,
      [direction, order = std::move(order), reply = std::move(reply)](Robot& robot) {
        if (direction == Direction::kRaise) {
          robot.Raise(order, reply);
        } else {
          robot.DeEscalate(order, reply);
        }
      });
  if (!posted.ok()) reactor->End(posted);
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::Approve(grpc::CallbackServerContext* context,
                                                   const rips::v1::ApproveRequest* request,
                                                   rips::v1::LevelResponse* response) {
  const auto who = AuthorizeOrder(context, "Approve", *request, OperatorRole::kOperator);
  if (!who.ok()) {
    const absl::Status why(who.status().code(),
                           absl::StrCat(request->reject() ? "rejecting" : "approving",
                                        " an operator's request: ", who.status().message()));
    RecordRefusal(*context, request->robot(), "", request->pending_approval_id(), why);
    return Refuse(context, who.status());
  }
  LogInfo(request->reject() ? "operator rejects a lowering" : "operator approves a lowering",
          {{"operator", rpc::Describe(*who)},
           {"robot", request->robot()},
           {"lowering", request->pending_approval_id()},
           {"reason", request->reason()}});
  pipeline::ApprovalOrder order{.operator_name = OperatorName(*who),
                                .identity = IdentityOf(who->identity),
                                .id = request->pending_approval_id(),
                                .reason = request->reason(),
                                .reject = request->reject(),
                                .accept_blind = request->accept_blind(),
                                .accept_changes = request->accept_changes(),
                                .request_id = RequestKey(*who, "Approve", request->request_id())};
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  const absl::Status asked = requesters_.Check(order.id, access_.watch->gate());
  if (!order.reject && !asked.ok()) {
    reactor->End(asked);
    return reactor;
  }
  pipeline::LevelReply reply = ReplyTo(reactor, response);
  const absl::Status posted = pipeline_->Post(request->robot(), Queue::kOrders,
                                              [order = std::move(order), reply = std::move(reply)](
                                                  Robot& robot) { robot.Approve(order, reply); });
  if (!posted.ok()) reactor->End(posted);
  return reactor;
}

}  // namespace rips::operator_api

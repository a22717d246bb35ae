// Bundles: pushed, listed, rolled out and back. Orders run on the thread of BundleControl.
#include <atomic>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/operator_api/push_stream.h"
#include "policy_server/server/operator_api/rules_codec.h"
#include "services/base/status_macros.h"
#include "services/rpc/peer.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"
#include "services/wire_limits/field_limits.h"

namespace rips::operator_api {
namespace {

using rollout::BundleControl;
using rpc::OperatorRole;

constexpr size_t kReasonBytesMax = 1'000;
// They ask every robot.
constexpr double kBundlesWeight = 2;

absl::Status CheckReason(const std::string& reason) {
  if (!reason.empty() && reason.size() <= kReasonBytesMax) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("a reason of 1 to ", kReasonBytesMax, " bytes is required"));
}

absl::Status NoBundles() {
  return absl::UnimplementedError("this server does not roll out bundles");
}

absl::Status Busy() {
  return absl::ResourceExhaustedError("too many orders about bundles wait; try again later");
}

const Clock* SystemClock() {
  static const RealClock clock;
  return &clock;
}

// A stream that ends at once.
class RefusedPush final : public grpc::ServerReadReactor<rips::v1::PushBundleRequest> {
 public:
  explicit RefusedPush(const absl::Status& status) { Finish(rpc::ToGrpc(status)); }
  void OnDone() override { delete this; }
};

}  // namespace

// Runs `task` on the thread of BundleControl; its answer ends the call.
grpc::ServerUnaryReactor* OperatorService::OnBundles(
    grpc::CallbackServerContext* context, const absl::StatusOr<Caller>& who,
    std::function<absl::Status(BundleControl&)> task) {
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.bundles == nullptr) {
    return Refuse(context, NoBundles());
  }
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  const bool posted = access_.bundles->thread().Post(
      [reactor, context, control = access_.bundles, task = std::move(task)] {
        // An order must not be carried out behind the back of who gave it up.
        reactor->End(context->IsCancelled()
                         ? absl::CancelledError("the caller has gone; nothing was done")
                         : task(*control));
      });
  if (!posted) reactor->End(Busy());
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ListBundles(grpc::CallbackServerContext* context,
                                                       const rips::v1::ListBundlesRequest* request,
                                                       rips::v1::ListBundlesResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery, kBundlesWeight);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.bundles == nullptr) return Refuse(context, NoBundles());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  Read(reactor, [this, reactor, response] {
    const absl::StatusOr<std::vector<rollout::KeptBundle>> bundles = access_.bundles->List();
    const absl::StatusOr<rollout::RulesStatus> status = access_.bundles->Status("");
    if (!bundles.ok() || !status.ok()) {
      return reactor->End(bundles.ok() ? status.status() : bundles.status());
    }
    Encode(*bundles, *status, *response);
    reactor->End(absl::OkStatus());
  });
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::GetRulesStatus(
    grpc::CallbackServerContext* context, const rips::v1::GetRulesStatusRequest* request,
    rips::v1::GetRulesStatusResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery, kBundlesWeight);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.bundles == nullptr) return Refuse(context, NoBundles());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  Read(reactor, [this, reactor, request, response] {
    const absl::StatusOr<rollout::RulesStatus> status = access_.bundles->Status(request->robot());
    if (status.ok()) Encode(*status, *response);
    reactor->End(status.status());
  });
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ActivateBundle(
    grpc::CallbackServerContext* context, const rips::v1::ActivateBundleRequest* request,
    rips::v1::RolloutResponse* response) {
  const auto who = AuthorizeOrder(context, "ActivateBundle", *request, OperatorRole::kAdmin);
  rollout::ActivateOrder order = Decode(*request);
  if (who.ok()) order.operator_name = OperatorName(*who);
  return OnBundles(context, who, [order, response](BundleControl& control) -> absl::Status {
    RIPS_RETURN_IF_ERROR(CheckReason(order.reason));
    RIPS_ASSIGN_OR_RETURN(const rollout::RolloutAnswer answer, control.Activate(order));
    Encode(answer, *response);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* OperatorService::RollBackBundle(
    grpc::CallbackServerContext* context, const rips::v1::RollBackBundleRequest* request,
    rips::v1::RolloutResponse* response) {
  const auto who = AuthorizeOrder(context, "RollBackBundle", *request, OperatorRole::kAdmin);
  rollout::RollBackOrder order{.robots = Decode(request->robots()),
                               .reason = request->reason(),
                               .dry_run = request->dry_run()};
  if (who.ok()) order.operator_name = OperatorName(*who);
  return OnBundles(context, who, [order, response](BundleControl& control) -> absl::Status {
    RIPS_RETURN_IF_ERROR(CheckReason(order.reason));
    RIPS_ASSIGN_OR_RETURN(const rollout::RolloutAnswer answer, control.RollBack(order));
    Encode(answer, *response);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* OperatorService::StopRollout(grpc::CallbackServerContext* context,
                                                       const rips::v1::StopRolloutRequest* request,
                                                       rips::v1::RolloutResponse* response) {
  const auto who = AuthorizeOrder(context, "StopRollout", *request, OperatorRole::kAdmin);
  const std::string name = who.ok() ? OperatorName(*who) : "";
  return OnBundles(
      context, who,
      [name, reason = request->reason(), response](BundleControl& control) -> absl::Status {
        RIPS_RETURN_IF_ERROR(CheckReason(reason));
        RIPS_ASSIGN_OR_RETURN(const rollout::RolloutAnswer answer,
                              control.StopRollout(name, reason));
        Encode(answer, *response);
        return absl::OkStatus();
      });
}

grpc::ServerUnaryReactor* OperatorService::ShadowBundle(
    grpc::CallbackServerContext* context, const rips::v1::ShadowBundleRequest* request,
    rips::v1::ShadowBundleResponse* response) {
  const auto who = AuthorizeOrder(context, "ShadowBundle", *request, OperatorRole::kOperator);
  rollout::ShadowWish wish{.bundle = request->bundle_id(),
                           .robots = Decode(request->robots()),
                           .reason = request->reason()};
  if (who.ok()) wish.operator_name = OperatorName(*who);
  return OnBundles(context, who, [wish, response](BundleControl& control) -> absl::Status {
    RIPS_RETURN_IF_ERROR(CheckReason(wish.reason));
    RIPS_ASSIGN_OR_RETURN(const rollout::ShadowAnswer answer, control.Shadow(wish));
    for (const std::string& robot : answer.changed) response->add_changed(robot);
    for (const std::string& text : answer.left_out) response->add_left_out(text);
    for (const std::string& text : answer.notes) response->add_notes(text);
    return absl::OkStatus();
  });
}

grpc::ServerReadReactor<rips::v1::PushBundleRequest>* OperatorService::PushBundle(
    grpc::CallbackServerContext* context, rips::v1::PushBundleResponse* response) {
  // The audit record of a push that is refused later has no request either.
  const auto who =
      AuthorizeOrder(context, "PushBundle", rips::v1::PushBundleRequest::default_instance(),
                     OperatorRole::kAdmin, Use::kStream);
  if (!who.ok()) return new RefusedPush(who.status());
  if (access_.bundles == nullptr) {
    return new RefusedPush(NoBundles());
  }
  // One of all operators: an archive is held in memory until it is stored.
  if (pushing_->exchange(true)) {
    return new RefusedPush(
        absl::ResourceExhaustedError("another bundle is being pushed; try again later"));
  }
  std::shared_ptr<void> turn(nullptr, [pushing = pushing_](void*) { *pushing = false; });
  struct Held {
    std::shared_ptr<rpc::SessionWatch::Session> session;
    CallerQuota::Ticket ticket;
  };
  auto held = std::make_shared<Held>();
  held->ticket = who->ticket;
  LogInfo("operator pushes a bundle", {{"operator", rpc::Describe(*who)}});
  auto* stream = new PushStream(
      SystemClock(), response,
      [this, held = held.get()](const rips::v1::PushBundleRequest& piece) -> absl::Status {
        access_.watch->Heard(*held->session, piece.ByteSizeLong());
        const auto hit = wire_limits::Check(piece);
        return hit ? hit->ToStatus() : absl::OkStatus();
      },
      [control = access_.bundles, on_refused = who->on_refused, held = held.get()](
          std::string archive, const std::shared_ptr<PushStream::Answer>& answer) {
        // Its client has nothing more to say, however long the bundle takes.
        held->session->heard_boottime_ns = 0;
        const bool posted =
            control->pushes().Post([control, on_refused, answer, turn = answer->TakeTurn(),
                                    archive = std::move(archive)]() mutable {
              const auto added = control->Push(archive);
              if (added.ok()) {
                rips::v1::PushBundleResponse filled;
                filled.set_id(added->bundle.id);
                filled.set_name(added->bundle.name);
                filled.set_signed_by(added->bundle.signed_by);
                filled.set_known(added->known);
                filled.set_warnings(added->warnings);
                answer->Fill(filled);
              } else if (on_refused) {
                on_refused(added.status());
              }
              archive = std::string();
              turn.reset();
              answer->End(added.status());
            });
        if (!posted) answer->End(Busy());
      });
  stream->answer()->set_turn(std::move(turn));
  held->session = access_.watch->Add(*who, [answer = stream->answer()](const grpc::Status& status) {
    answer->End(rpc::FromGrpc(status));
  });
  held->session->greeted = true;
  held->session->connection = access_.watch->gate().ConnectionOf(context->peer());
  access_.watch->Heard(*held->session, 0);
  stream->set_held(std::move(held));
  stream->Begin();
  return stream;
}

}  // namespace rips::operator_api

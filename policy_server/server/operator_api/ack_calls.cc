// AckAlerts: found on the thread for reads, written by the committer with what else waits, and read
// back for the answer, so that it names who was first.
#include <algorithm>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/server/operator_api/alert_acks.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "services/rpc/peer.h"
#include "services/runtime/real_clock.h"

namespace rips::operator_api {
namespace {

// Alerts that count as one call of the quota.
constexpr double kAlertsPerCall = 20;

// An error of the store is none of the way to the server.
absl::Status NotWritten(const absl::Status& status) {
  if (store::IsOfBatch(status)) return status;
  return absl::AbortedError(
      absl::StrCat("the server's store cannot be written: ", status.message(),
                   "; the alerts may be acknowledged or not: look, or acknowledge them again"));
}

}  // namespace

grpc::ServerUnaryReactor* OperatorService::AckAlerts(grpc::CallbackServerContext* context,
                                                     const rips::v1::AckAlertsRequest* request,
                                                     rips::v1::AckAlertsResponse* response) {
  // Of the account of queries: who acknowledges without end can still raise.
  const auto who =
      AuthorizeOrder(context, "AckAlerts", *request, rpc::OperatorRole::kOperator, Use::kQuery,
                     std::max(1.0, request->alert_ids_size() / kAlertsPerCall),
                     /*effects_are_recorded=*/true);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  if (access_.acks == nullptr || access_.committer == nullptr) {
    reactor->End(NoAcks());
    return reactor;
  }
  Read(reactor, [this, context, reactor, request, response, by = rpc::Describe(*who)] {
    if (context->IsCancelled()) {
      return reactor->End(absl::CancelledError("the caller has gone; nothing was acknowledged"));
    }
    auto made = AckPlan::Make(*request, by, RealClock().Now().unix_ns, *store_, *access_.acks);
    if (!made.ok()) return reactor->End(made.status());
    const auto plan = std::make_shared<const AckPlan>(*std::move(made));
    const auto answer = [this, reactor, response, plan] {
      reactor->End(plan->Answer(*access_.acks, *response));
    };
    store::WriteBatch batch = plan->ToWrite();
    if (batch.empty()) return answer();
    const absl::Status submitted = access_.committer->Submit(
        std::move(batch), [this, reactor, answer](const absl::Status& written) {
          if (!written.ok()) return reactor->End(NotWritten(written));
          if (reads_.Push(answer)) return;
          reactor->End(
              absl::ResourceExhaustedError("it is done, but too many reads wait to say who was "
                                           "first; see `ripsctl alert list`"));
        });
    if (!submitted.ok()) reactor->End(NotWritten(submitted));
  });
  return reactor;
}

}  // namespace rips::operator_api

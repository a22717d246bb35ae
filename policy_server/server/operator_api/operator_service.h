// OperatorService: what people and their tools may ask. Roles come from the certificate.
//
//   call                                             role
//   ListRobots WatchRobots GetGraph GetInterest
//   GetCoverage GetLevel ListTransitions ListAlerts
//   WatchAlerts Explain ListReceipts ListAgents
//   ListBundles GetRulesStatus ListEnrolments        viewer
//   Raise DeEscalate Approve ResumeRules SendSignal
//   DrillRobot Record GetAlertRecording ShadowBundle
//   AckAlerts SetMaintenance GetConfiguration        operator
//   Ban Unban ResetTerm PushBundle ActivateBundle
//   RollBackBundle StopRollout
//   CreateEnrolmentToken RevokeEnrolmentToken        admin
//
// Each call on an open connection is judged anew, and streams for as long as they are open: an
// expired, revoked or banned certificate gets nothing (CallGate).
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_OPERATOR_SERVICE_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_OPERATOR_SERVICE_H_

#include <atomic>
#include <functional>
#include <memory>
#include <thread>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "google/protobuf/message.h"
#include "policy_server/server/operator_api/caller_quota.h"
#include "policy_server/server/operator_api/operator_access.h"
#include "policy_server/server/operator_api/requesters.h"
#include "policy_server/server/operator_api/status_broadcaster.h"
#include "policy_server/server/operator_api/unary_call.h"
#include "policy_server/server/operator_api/watch_stream.h"
#include "policy_server/server/rollout/bundle_control.h"
#include "policy_server/server/shard/pipeline.h"
#include "policy_server/server/store/store.h"
#include "rips/v1/operator.grpc.pb.h"
#include "services/rpc/identity.h"
#include "services/rpc/peer.h"
#include "services/rpc/session_watch.h"
#include "services/runtime/bounded_queue.h"

namespace rips::operator_api {

class OperatorService final : public rips::v1::OperatorService::CallbackService {
 public:
  // Reads of the store waiting for the one that runs; one more is refused at once.
  static constexpr size_t kReadsMax = 1'024;
  // Graphs waiting to be encoded behind the one that is.
  static constexpr size_t kGraphsMax = 64;

  using Access = OperatorAccess;

  // No pointer is owned; all outlive every call. Reads of the store run on a thread of their own,
  // and so does the encoding of graphs.
  // `patience`: how long robots are waited for in all when each is asked.
  OperatorService(pipeline::Pipeline* pipeline, store::Store* store, StatusBroadcaster* hub,
                  Access access, absl::Duration patience = pipeline::Pipeline::kPatience);
  ~OperatorService() override;

  // As rips/v1/operator.proto.
  grpc::ServerUnaryReactor* ListRobots(grpc::CallbackServerContext* context,
                                       const rips::v1::ListRobotsRequest* request,
                                       rips::v1::ListRobotsResponse* response) override;
  grpc::ServerWriteReactor<rips::v1::RobotStatus>* WatchRobots(
      grpc::CallbackServerContext* context, const rips::v1::WatchRobotsRequest* request) override;
  grpc::ServerUnaryReactor* GetGraph(grpc::CallbackServerContext* context,
                                     const rips::v1::GetGraphRequest* request,
                                     rips::v1::GetGraphResponse* response) override;
  grpc::ServerUnaryReactor* GetInterest(grpc::CallbackServerContext* context,
                                        const rips::v1::GetInterestRequest* request,
                                        rips::v1::GetInterestResponse* response) override;
  grpc::ServerUnaryReactor* GetCoverage(grpc::CallbackServerContext* context,
                                        const rips::v1::GetCoverageRequest* request,
                                        rips::v1::GetCoverageResponse* response) override;
  grpc::ServerUnaryReactor* GetConfiguration(grpc::CallbackServerContext* context,
                                             const rips::v1::GetConfigurationRequest* request,
                                             rips::v1::GetConfigurationResponse* response) override;
  grpc::ServerUnaryReactor* GetLevel(grpc::CallbackServerContext* context,
                                     const rips::v1::GetLevelRequest* request,
                                     rips::v1::GetLevelResponse* response) override;
  grpc::ServerUnaryReactor* ListTransitions(grpc::CallbackServerContext* context,
                                            const rips::v1::ListTransitionsRequest* request,
                                            rips::v1::ListTransitionsResponse* response) override;
  grpc::ServerUnaryReactor* ListAlerts(grpc::CallbackServerContext* context,
                                       const rips::v1::ListAlertsRequest* request,
                                       rips::v1::ListAlertsResponse* response) override;
  grpc::ServerUnaryReactor* Explain(grpc::CallbackServerContext* context,
                                    const rips::v1::ExplainRequest* request,
                                    rips::v1::ExplainResponse* response) override;
  grpc::ServerWriteReactor<rips::v1::Alert>* WatchAlerts(
      grpc::CallbackServerContext* context, const rips::v1::WatchAlertsRequest* request) override;
  grpc::ServerUnaryReactor* ListReceipts(grpc::CallbackServerContext* context,
                                         const rips::v1::ListReceiptsRequest* request,
                                         rips::v1::ListReceiptsResponse* response) override;
  grpc::ServerWriteReactor<rips::v1::Recording>* Record(
      grpc::CallbackServerContext* context, const rips::v1::RecordRequest* request) override;
  grpc::ServerWriteReactor<rips::v1::FilePiece>* GetAlertRecording(
      grpc::CallbackServerContext* context,
      const rips::v1::GetAlertRecordingRequest* request) override;
  grpc::ServerUnaryReactor* AckAlerts(grpc::CallbackServerContext* context,
                                      const rips::v1::AckAlertsRequest* request,
                                      rips::v1::AckAlertsResponse* response) override;
  grpc::ServerUnaryReactor* DeEscalate(grpc::CallbackServerContext* context,
                                       const rips::v1::LevelRequest* request,
                                       rips::v1::LevelResponse* response) override;
  grpc::ServerUnaryReactor* Raise(grpc::CallbackServerContext* context,
                                  const rips::v1::LevelRequest* request,
                                  rips::v1::LevelResponse* response) override;
  grpc::ServerUnaryReactor* Approve(grpc::CallbackServerContext* context,
                                    const rips::v1::ApproveRequest* request,
                                    rips::v1::LevelResponse* response) override;
  grpc::ServerUnaryReactor* ResumeRules(grpc::CallbackServerContext* context,
                                        const rips::v1::ResumeRulesRequest* request,
                                        rips::v1::ResumeRulesResponse* response) override;
  grpc::ServerUnaryReactor* SetMaintenance(grpc::CallbackServerContext* context,
                                           const rips::v1::SetMaintenanceRequest* request,
                                           rips::v1::SetMaintenanceResponse* response) override;
  grpc::ServerUnaryReactor* SendSignal(grpc::CallbackServerContext* context,
                                       const rips::v1::SendSignalRequest* request,
                                       rips::v1::SendSignalResponse* response) override;
  grpc::ServerUnaryReactor* DrillRobot(grpc::CallbackServerContext* context,
                                       const rips::v1::DrillRobotRequest* request,
                                       rips::v1::DrillRobotResponse* response) override;
  grpc::ServerUnaryReactor* ListAgents(grpc::CallbackServerContext* context,
                                       const rips::v1::ListAgentsRequest* request,
                                       rips::v1::ListAgentsResponse* response) override;
  grpc::ServerUnaryReactor* Ban(grpc::CallbackServerContext* context,
                                const rips::v1::BanRequest* request,
                                rips::v1::BanResponse* response) override;
  grpc::ServerUnaryReactor* Unban(grpc::CallbackServerContext* context,
                                  const rips::v1::UnbanRequest* request,
                                  rips::v1::UnbanResponse* response) override;
  grpc::ServerUnaryReactor* ResetTerm(grpc::CallbackServerContext* context,
                                      const rips::v1::ResetTermRequest* request,
                                      rips::v1::ResetTermResponse* response) override;
  grpc::ServerUnaryReactor* CreateEnrolmentToken(
      grpc::CallbackServerContext* context, const rips::v1::CreateEnrolmentTokenRequest* request,
      rips::v1::CreateEnrolmentTokenResponse* response) override;
  grpc::ServerUnaryReactor* RevokeEnrolmentToken(
      grpc::CallbackServerContext* context, const rips::v1::RevokeEnrolmentTokenRequest* request,
      rips::v1::RevokeEnrolmentTokenResponse* response) override;
  grpc::ServerUnaryReactor* ListEnrolments(grpc::CallbackServerContext* context,
                                           const rips::v1::ListEnrolmentsRequest* request,
                                           rips::v1::ListEnrolmentsResponse* response) override;
  grpc::ServerUnaryReactor* ListBundles(grpc::CallbackServerContext* context,
                                        const rips::v1::ListBundlesRequest* request,
                                        rips::v1::ListBundlesResponse* response) override;
  grpc::ServerUnaryReactor* GetRulesStatus(grpc::CallbackServerContext* context,
                                           const rips::v1::GetRulesStatusRequest* request,
                                           rips::v1::GetRulesStatusResponse* response) override;
  grpc::ServerReadReactor<rips::v1::PushBundleRequest>* PushBundle(
      grpc::CallbackServerContext* context, rips::v1::PushBundleResponse* response) override;
  grpc::ServerUnaryReactor* ActivateBundle(grpc::CallbackServerContext* context,
                                           const rips::v1::ActivateBundleRequest* request,
                                           rips::v1::RolloutResponse* response) override;
  grpc::ServerUnaryReactor* RollBackBundle(grpc::CallbackServerContext* context,
                                           const rips::v1::RollBackBundleRequest* request,
                                           rips::v1::RolloutResponse* response) override;
  grpc::ServerUnaryReactor* StopRollout(grpc::CallbackServerContext* context,
                                        const rips::v1::StopRolloutRequest* request,
                                        rips::v1::RolloutResponse* response) override;
  grpc::ServerUnaryReactor* ShadowBundle(grpc::CallbackServerContext* context,
                                         const rips::v1::ShadowBundleRequest* request,
                                         rips::v1::ShadowBundleResponse* response) override;

 private:
  enum class Direction { kRaise, kLower };
  // A peer that is served, and what it holds of its quota until the call is over.
  struct Caller : rpc::Peer {
    CallerQuota::Ticket ticket;
    // Records what an admitted order came to, if it is refused after all; else empty.
    UnaryCall::OnRefused on_refused;
  };
  grpc::ServerUnaryReactor* ChangeLevel(grpc::CallbackServerContext* context,
                                        const rips::v1::LevelRequest* request,
                                        rips::v1::LevelResponse* response, Direction direction);
  // Runs `task` on the thread for store reads; it finishes `reactor`. Beyond kReadsMax it is
  // finished at once with RESOURCE_EXHAUSTED.
  void Read(UnaryCall* reactor, std::function<void()> task);

  // The operator behind the call, if it is served, its role is enough, the request is within the
  // limits of its fields, and it is within its quota; refusals are counted. `weight` as
  // CallerQuota::Take.
  absl::StatusOr<Caller> Authorize(grpc::CallbackServerContext* context,
                                   const google::protobuf::Message& request,
                                   rpc::OperatorRole needed, Use use, double weight = 1);
  // As Authorize, for a call that changes something; recorded in the audit log. One whose effects
  // the log has of themselves is recorded only if it is refused.
  absl::StatusOr<Caller> AuthorizeOrder(grpc::CallbackServerContext* context,
                                        absl::string_view call,
                                        const google::protobuf::Message& request,
                                        rpc::OperatorRole needed, Use use = Use::kOrder,
                                        double weight = 1, bool effects_are_recorded = false);
  // Ends `stream` when its operator is not served any more.
  template <typename T>
  void Keep(rpc::StreamKind kind, WatchStream<T>* stream, const Caller& caller,
            grpc::CallbackServerContext* context);
  // Runs the task on the thread of BundleControl; what it returns ends the call.
  grpc::ServerUnaryReactor* OnBundles(grpc::CallbackServerContext* context,
                                      const absl::StatusOr<Caller>& who,
                                      std::function<absl::Status(rollout::BundleControl&)> task);
  // A robot's record and alert of what an operator asked of it and was not allowed to: its move to
  // the level `to`, or, if `to` is empty, the lowering that waits under the id `approval`.
  void RecordRefusal(const grpc::CallbackServerContext& context, const std::string& robot,
                     const std::string& to, const std::string& approval, const absl::Status& why);
  // The robot that `uri` is of, if any, gets an alert.
  void TellRobotOf(const std::string& uri, const std::string& text);
  // What the operator of that URI asked for waits for no second one any more, on any robot.
  void EndRequestsOf(const std::string& uri);

  pipeline::Pipeline* pipeline_;
  store::Store* store_;
  StatusBroadcaster* hub_;
  Access access_;
  const absl::Duration patience_;
  Requesters requesters_;
  // A bundle is on its way from an operator, or is being stored. An order of BundleControl may
  // outlive this.
  const std::shared_ptr<std::atomic<bool>> pushing_ = std::make_shared<std::atomic<bool>>(false);
  using Tasks = BoundedQueue<std::function<void()>>;
  Tasks reads_{{.capacity = kReadsMax}};
  Tasks graphs_{{.capacity = kGraphsMax}};
  std::thread reader_;
  std::thread encoder_;
};

template <typename T>
void OperatorService::Keep(rpc::StreamKind kind, WatchStream<T>* stream, const Caller& caller,
                           grpc::CallbackServerContext* context) {
  struct Kept {
    std::shared_ptr<rpc::SessionWatch::Session> session;
    CallerQuota::Ticket ticket;
  };
  const auto session = access_.watch->Guard(kind, caller, context, stream->outbound());
  session->greeted = true;
  stream->set_session(std::make_shared<Kept>(Kept{session, caller.ticket}));
}

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_OPERATOR_SERVICE_H_

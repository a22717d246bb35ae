#include "policy_server/operator_api/operator_service.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/operator_api/coverage_codec.h"
#include "policy_server/operator_api/receipt_codec.h"
#include "policy_server/operator_api/record_tap.h"
#include "policy_server/operator_api/watch_stream.h"
#include "services/ros2_proto/graph_codec.h"
#include "services/rpc/peer.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"

namespace rips::operator_api {
namespace {

using pipeline::Lane;
using pipeline::Robot;
using rpc::OperatorRole;

// Of one watch; beyond, it is told more when it has read. A page of the feed fits besides.
constexpr size_t kAlertsWaitingMax = 1'024;
constexpr size_t kBanReasonBytesMax = 1'000;
// Of a robot's transitions, to find the newest that was not refused.
constexpr int kNewestRead = 200;

void FillMark(const Mark& mark, rips::v1::Mark* out) {
  out->set_term(mark.term);
  out->set_epoch(mark.epoch);
}

rips::v1::RobotStatus Encode(const pipeline::RobotStatus& status) {
  rips::v1::RobotStatus out;
  out.set_robot(status.robot);
  out.set_decided_level(status.decided_level);
  out.set_effective_level(status.effective_level);
  out.set_stage(status.stage);
  FillMark(status.mark, out.mutable_mark());
  out.set_bundle_version(status.bundle_version);
  for (const std::string& reason : status.degraded) out.add_degraded(reason);
  return out;
}

rips::v1::Alert Encode(const store::AlertRecord& alert) {
  rips::v1::Alert out;
  out.set_id(alert.id);
  out.set_time_unix_ns(alert.time_unix_ns);
  out.set_robot(alert.robot);
  out.set_rule(alert.rule);
  out.set_severity(alert.severity);
  out.set_text(alert.text);
  out.set_level(alert.level);
  out.set_event(alert.event);
  FillMark(alert.mark, out.mutable_mark());
  return out;
}

rips::v1::Transition Encode(const store::TransitionRecord& record) {
  rips::v1::Transition out;
  out.set_id(record.id);
  out.set_robot(record.robot);
  out.set_time_unix_ns(record.time_unix_ns);
  out.set_from(record.from);
  out.set_to(record.to);
  out.set_cause(record.cause);
  out.set_reason(record.reason);
  if (!record.refused) FillMark(record.mark, out.mutable_mark());
  out.set_refused(record.refused);
  out.set_count(static_cast<uint32_t>(std::min<uint64_t>(record.count, UINT32_MAX)));
  out.set_stage(record.stage);
  out.set_detail(record.detail);
  return out;
}

// Who records name: `alice (spiffe://td/operator/admin/alice serial 0f)`.
std::string OperatorName(const rpc::Peer& peer) {
  return absl::StrCat(peer.identity.name, " (", rpc::Describe(peer), ")");
}

grpc::ServerUnaryReactor* Refuse(grpc::CallbackServerContext* context, const absl::Status& status) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(rpc::ToGrpc(status));
  return reactor;
}

template <typename T>
grpc::ServerWriteReactor<T>* RefuseWatch(const absl::Status& status) {
  auto* stream = new WatchStream<T>();
  stream->outbound()->Close(rpc::ToGrpc(status));
  return stream;
}

}  // namespace

OperatorService::OperatorService(pipeline::Pipeline* pipeline, store::Store* store, Hub* hub,
                                 Access access, absl::Duration patience)
    : pipeline_(pipeline),
      store_(store),
      hub_(hub),
      access_(access),
      patience_(patience),
      reader_([this] {
        while (true) {
          auto task = reads_.Pop(absl::InfiniteDuration());
          if (!task) return;
          (*task)();
        }
      }) {}

OperatorService::~OperatorService() {
  reads_.Close();
  reader_.join();
}

absl::StatusOr<rpc::Peer> OperatorService::Authorize(grpc::CallbackServerContext* context,
                                                     OperatorRole needed) {
  absl::StatusOr<rpc::Peer> peer = access_.watch->Admit(*context, rpc::Role::kOperator);
  if (!peer.ok() || peer->identity.operator_role >= needed) return peer;
  return access_.watch->gate().Refuse(
      {"role",
       absl::PermissionDeniedError(absl::StrCat(
           "this needs the role `", rpc::OperatorRoleName(needed), "`; the certificate is a `",
           rpc::OperatorRoleName(peer->identity.operator_role), "`'s"))},
      &*peer, context->peer());
}

template <typename T>
void OperatorService::Keep(WatchStream<T>* stream, const rpc::Peer& peer) {
  const auto session = access_.watch->Add(
      peer,
      [outbound = stream->outbound()](const grpc::Status& status) { outbound->Close(status); });
  session->greeted = true;
  stream->set_session(session);
}

void OperatorService::RecordRefusal(const grpc::CallbackServerContext& context,
                                    const rips::v1::LevelRequest& request,
                                    const absl::Status& why) {
  const absl::StatusOr<rpc::Peer> peer = rpc::PeerOf(*context.auth_context());
  if (!peer.ok() || peer->identity.role != rpc::Role::kOperator) return;
  pipeline_
      ->Post(
          request.robot(), Lane::kControl,
          [order = pipeline::LevelOrder{.operator_name = OperatorName(*peer), .to = request.to()},
           why](Robot& robot) { robot.RecordRefusedOrder(order, why); })
      .IgnoreError();  // of an unknown robot there is no record
}

void OperatorService::Read(grpc::ServerUnaryReactor* reactor, std::function<void()> task) {
  if (reads_.Push(std::move(task))) return;
  reactor->Finish(rpc::ToGrpc(absl::ResourceExhaustedError(
      absl::StrCat(kReadsMax, " reads of the store wait already, the limit; try again later"))));
}

grpc::ServerUnaryReactor* OperatorService::ListRobots(grpc::CallbackServerContext* context,
                                                      const rips::v1::ListRobotsRequest*,
                                                      rips::v1::ListRobotsResponse* response) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return Refuse(context, who.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  // Asks every robot on its own thread; must not be done on a gRPC thread, which may not block.
  Read(reactor, [this, reactor, response] {
    auto gathered = pipeline_->Gather<rips::v1::RobotStatus>(
        [](Robot& robot) { return Encode(robot.Status()); }, patience_);
    for (const pipeline::RobotStatus& held : pipeline_->held()) {
      gathered.answers.insert_or_assign(held.robot, Encode(held));
    }
    for (auto& [id, status] : gathered.answers) *response->add_robots() = std::move(status);
    for (const std::string& robot : gathered.silent) response->add_no_answer(robot);
    reactor->Finish(grpc::Status::OK);
  });
  return reactor;
}

grpc::ServerWriteReactor<rips::v1::RobotStatus>* OperatorService::WatchRobots(
    grpc::CallbackServerContext* context, const rips::v1::WatchRobotsRequest* request) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return RefuseWatch<rips::v1::RobotStatus>(who.status());
  const std::set<std::string> wanted(request->robots().begin(), request->robots().end());
  auto* stream = new WatchStream<rips::v1::RobotStatus>();
  Keep(stream, *who);
  auto outbound = stream->outbound();
  const absl::StatusOr<uint64_t> id =
      hub_->WatchStatus([outbound, wanted](const pipeline::RobotStatus& status) {
        if (!wanted.empty() && !wanted.contains(status.robot)) return outbound->open();
        return outbound->Send(Encode(status));
      });
  if (!id.ok()) {
    outbound->Close(rpc::ToGrpc(id.status()));
    return stream;
  }
  stream->set_on_ended([hub = hub_, id = *id] { hub->Unwatch(id); });
  for (const std::string& robot : pipeline_->robots()) {
    if (!wanted.empty() && !wanted.contains(robot)) continue;
    pipeline_
        ->Post(robot, Lane::kControl,
               [outbound](Robot& each) { outbound->Send(Encode(each.Status())); })
        .IgnoreError();  // the next change tells
  }
  for (const pipeline::RobotStatus& held : pipeline_->held()) {
    if (wanted.empty() || wanted.contains(held.robot)) outbound->Send(Encode(held));
  }
  return stream;
}

grpc::ServerUnaryReactor* OperatorService::GetGraph(grpc::CallbackServerContext* context,
                                                    const rips::v1::GetGraphRequest* request,
                                                    rips::v1::GetGraphResponse* response) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return Refuse(context, who.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  const absl::Status posted =
      pipeline_->Post(request->robot(), Lane::kControl, [reactor, response](Robot& robot) {
        response->mutable_graph()->set_settled(true);
        ros2_proto::EncodeGraph(robot.graph(), *response->mutable_graph());
        response->set_changed_unix_ns(robot.graph_changed_unix_ns());
        reactor->Finish(grpc::Status::OK);
      });
  if (!posted.ok()) reactor->Finish(rpc::ToGrpc(posted));
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::GetInterest(grpc::CallbackServerContext* context,
                                                       const rips::v1::GetInterestRequest* request,
                                                       rips::v1::GetInterestResponse* response) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return Refuse(context, who.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  const absl::Status posted =
      pipeline_->Post(request->robot(), Lane::kControl, [reactor, response](Robot& robot) {
        EncodeInterest(robot, *response);
        reactor->Finish(grpc::Status::OK);
      });
  if (!posted.ok()) reactor->Finish(rpc::ToGrpc(posted));
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::GetCoverage(grpc::CallbackServerContext* context,
                                                       const rips::v1::GetCoverageRequest* request,
                                                       rips::v1::GetCoverageResponse* response) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return Refuse(context, who.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  const absl::Status posted =
      pipeline_->Post(request->robot(), Lane::kControl, [reactor, response](Robot& robot) {
        EncodeCoverage(robot, *response);
        reactor->Finish(grpc::Status::OK);
      });
  if (!posted.ok()) reactor->Finish(rpc::ToGrpc(posted));
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::GetLevel(grpc::CallbackServerContext* context,
                                                    const rips::v1::GetLevelRequest* request,
                                                    rips::v1::GetLevelResponse* response) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return Refuse(context, who.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  for (const pipeline::RobotStatus& held : pipeline_->held()) {
    if (held.robot != request->robot()) continue;
    *response->mutable_status() = Encode(held);
    reactor->Finish(grpc::Status::OK);
    return reactor;
  }
  const absl::Status posted =
      pipeline_->Post(request->robot(), Lane::kControl,
                      [this, reactor, response, robot_id = request->robot()](Robot& robot) {
                        *response->mutable_status() = Encode(robot.Status());
                        for (int i = 0; i < robot.levels().size(); ++i) {
                          response->add_levels(robot.levels().name(i));
                          if (robot.levels().at(i).soft)
                            response->add_soft_levels(robot.levels().name(i));
                        }
                        Read(reactor, [this, reactor, response, robot_id] {
                          const auto newest = store_->ListTransitions(robot_id, kNewestRead);
                          if (newest.ok()) {
                            // What was refused changed nothing.
                            const auto last = std::find_if(
                                newest->begin(), newest->end(),
                                [](const auto& transition) { return !transition.refused; });
                            if (last != newest->end()) *response->mutable_last() = Encode(*last);
                          }
                          reactor->Finish(rpc::ToGrpc(newest.status()));
                        });
                      });
  if (!posted.ok()) reactor->Finish(rpc::ToGrpc(posted));
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ListTransitions(
    grpc::CallbackServerContext* context, const rips::v1::ListTransitionsRequest* request,
    rips::v1::ListTransitionsResponse* response) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return Refuse(context, who.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  Read(reactor, [this, reactor, request, response] {
    const auto records = store_->ListTransitions(request->robot(), request->limit());
    if (records.ok()) {
      for (const auto& record : *records) *response->add_transitions() = Encode(record);
    }
    reactor->Finish(rpc::ToGrpc(records.status()));
  });
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ListAlerts(grpc::CallbackServerContext* context,
                                                      const rips::v1::ListAlertsRequest* request,
                                                      rips::v1::ListAlertsResponse* response) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return Refuse(context, who.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  Read(reactor, [this, reactor, request, response] {
    const auto records = store_->ListAlerts(request->robot(), request->limit());
    if (records.ok()) {
      for (const auto& record : *records) *response->add_alerts() = Encode(record);
    }
    reactor->Finish(rpc::ToGrpc(records.status()));
  });
  return reactor;
}

grpc::ServerWriteReactor<rips::v1::Alert>* OperatorService::WatchAlerts(
    grpc::CallbackServerContext* context, const rips::v1::WatchAlertsRequest* request) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return RefuseWatch<rips::v1::Alert>(who.status());
  std::optional<Cursor> after;
  if (!request->after().empty()) {
    absl::StatusOr<Cursor> parsed = ParseCursor(request->after());
    if (!parsed.ok()) return RefuseWatch<rips::v1::Alert>(parsed.status());
    after = *std::move(parsed);
  }
  auto* stream = new WatchStream<rips::v1::Alert>();
  Keep(stream, *who);
  auto outbound = stream->outbound();
  const absl::StatusOr<uint64_t> id = hub_->WatchAlerts(
      std::move(after),
      {.robot = request->robot(),
       .room = [outbound] { return outbound->waiting() < kAlertsWaitingMax; },
       .alert =
           [outbound](const store::AlertRecord& alert) {
             rips::v1::Alert message = Encode(alert);
             message.set_cursor(FormatCursor({.sequence = alert.sequence, .id = alert.id}));
             return outbound->Send(std::move(message));
           },
       .position =
           [outbound](const Cursor& at) {
             rips::v1::Alert message;
             message.set_cursor(FormatCursor(at));
             return outbound->Send(std::move(message));
           },
       .gap =
           [outbound](const std::string& text) {
             rips::v1::Alert message;
             message.set_gap(text);
             return outbound->Send(std::move(message));
           }});
  if (!id.ok()) {
    outbound->Close(rpc::ToGrpc(id.status()));
    return stream;
  }
  stream->set_on_ended([hub = hub_, id = *id] { hub->Unwatch(id); });
  // One that could not be told all goes on.
  stream->set_on_drained([hub = hub_] { hub->feed().Wake(); });
  return stream;
}

grpc::ServerUnaryReactor* OperatorService::ListReceipts(
    grpc::CallbackServerContext* context, const rips::v1::ListReceiptsRequest* request,
    rips::v1::ListReceiptsResponse* response) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return Refuse(context, who.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  const absl::Status posted = pipeline_->Post(
      request->robot(), Lane::kControl,
      [reactor, response, limit = request->limit()](Robot& robot) {
        for (const pipeline::LoggedReceipt& receipt : robot.receipts().Newest(limit)) {
          Encode(receipt, response->add_receipts());
        }
        reactor->Finish(grpc::Status::OK);
      });
  if (!posted.ok()) reactor->Finish(rpc::ToGrpc(posted));
  return reactor;
}

grpc::ServerWriteReactor<rips::v1::Recording>* OperatorService::Record(
    grpc::CallbackServerContext* context, const rips::v1::RecordRequest* request) {
  const auto who = Authorize(context, OperatorRole::kOperator);
  if (!who.ok()) return RefuseWatch<rips::v1::Recording>(who.status());
  LogInfo("operator records", {{"operator", rpc::Describe(*who)}, {"robot", request->robot()}});
  auto* stream = new WatchStream<rips::v1::Recording>();
  Keep(stream, *who);
  auto outbound = stream->outbound();
  const absl::Status posted =
      pipeline_->Post(request->robot(), Lane::kControl, [outbound](Robot& robot) {
        auto tap = std::make_shared<RecordTap>(
            [outbound](rips::v1::Recording piece) { return outbound->Send(std::move(piece)); },
            [outbound] { return outbound->open(); });
        if (const absl::Status added = robot.AddTap(tap); !added.ok()) {
          return outbound->Close(rpc::ToGrpc(added));
        }
        const pipeline::RobotStatus status = robot.Status();
        rips::v1::RecordingHeader header;
        header.set_robot(robot.id());
        header.set_bundle_id(status.bundle_version);
        header.set_level(status.decided_level);
        header.set_start_unix_ns(RealClock().Now().unix_ns);
        header.set_rips_version(std::string(RipsVersion()));
        tap->Start(std::move(header), robot.shared_graph(), robot.graph_changed_unix_ns() != 0);
      });
  if (!posted.ok()) outbound->Close(rpc::ToGrpc(posted));
  return stream;
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
  const auto who = Authorize(context, OperatorRole::kOperator);
  if (!who.ok()) {
    RecordRefusal(*context, *request, who.status());
    return Refuse(context, who.status());
  }
  LogInfo(direction == Direction::kRaise ? "operator raises" : "operator lowers",
          {{"operator", rpc::Describe(*who)},
           {"robot", request->robot()},
           {"to", request->to()},
           {"reason", request->reason()},
           {"dry_run", request->dry_run()}});
  pipeline::LevelOrder order{.operator_name = OperatorName(*who),
                             .to = request->to(),
                             .reason = request->reason(),
                             .expected_level = request->expected_level(),
                             .expected_mark = {.term = request->expected_mark().term(),
                                               .epoch = request->expected_mark().epoch()},
                             .dry_run = request->dry_run(),
                             .accept_blind = request->accept_blind(),
                             .request_id = request->request_id()};
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  pipeline::LevelReply reply = [reactor, response](const pipeline::LevelAnswer& answer) {
    FillMark(answer.mark, response->mutable_mark());
    response->set_decided_level(answer.decided_level);
    for (const std::string& rule : answer.would_raise_again) {
      response->add_would_raise_again(rule);
    }
    for (const std::string& reason : answer.blind_because) response->add_blind_because(reason);
    reactor->Finish(rpc::ToGrpc(answer.status));
  };
  const absl::Status posted = pipeline_->Post(
      request->robot(), Lane::kControl,
      [direction, order = std::move(order), reply = std::move(reply)](Robot& robot) {
        if (direction == Direction::kRaise) {
          robot.Raise(order, reply);
        } else {
          robot.DeEscalate(order, reply);
        }
      });
  if (!posted.ok()) reactor->Finish(rpc::ToGrpc(posted));
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ResumeRules(grpc::CallbackServerContext* context,
                                                       const rips::v1::ResumeRulesRequest* request,
                                                       rips::v1::ResumeRulesResponse*) {
  const auto who = Authorize(context, OperatorRole::kOperator);
  if (!who.ok()) return Refuse(context, who.status());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  const absl::Status posted = pipeline_->Post(
      request->robot(), Lane::kControl,
      [reactor, name = OperatorName(*who), reason = request->reason()](Robot& robot) {
        reactor->Finish(rpc::ToGrpc(robot.ResumeRules(name, reason)));
      });
  if (!posted.ok()) reactor->Finish(rpc::ToGrpc(posted));
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::DrillRobot(grpc::CallbackServerContext* context,
                                                      const rips::v1::DrillRobotRequest* request,
                                                      rips::v1::DrillRobotResponse* response) {
  const auto who = Authorize(context, OperatorRole::kOperator);
  if (!who.ok()) return Refuse(context, who.status());
  LogInfo("operator drills", {{"operator", rpc::Describe(*who)},
                              {"robot", request->robot()},
                              {"level", request->level()}});
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  pipeline::DrillOrder order{.operator_name = OperatorName(*who), .level = request->level()};
  pipeline::DrillReply reply = [reactor, response](const pipeline::DrillAnswer& answer) {
    for (const pipeline::DrillEntry& drill : answer.drills) Encode(drill, response->add_drills());
    reactor->Finish(rpc::ToGrpc(answer.status));
  };
  const absl::Status posted =
      pipeline_->Post(request->robot(), Lane::kControl,
                      [order = std::move(order), reply = std::move(reply)](Robot& robot) {
                        robot.StartDrill(order, reply);
                      });
  if (!posted.ok()) reactor->Finish(rpc::ToGrpc(posted));
  return reactor;
}

// --- who is served

grpc::ServerUnaryReactor* OperatorService::ListAgents(grpc::CallbackServerContext* context,
                                                      const rips::v1::ListAgentsRequest*,
                                                      rips::v1::ListAgentsResponse* response) {
  const auto who = Authorize(context, OperatorRole::kViewer);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.bans == nullptr) return Refuse(context, absl::UnimplementedError("no deny list"));
  for (const rpc::Peer& peer : access_.certificates->peers()) {
    rips::v1::AgentCertificate* agent = response->add_agents();
    agent->set_uri(rpc::ToString(peer.identity));
    agent->set_serial(peer.serial);
    agent->set_not_after_unix_ns(absl::ToUnixNanos(peer.not_after));
  }
  for (const store::BanRecord& ban : access_.bans->bans()) {
    rips::v1::CertificateBan* out = response->add_bans();
    out->set_uri(ban.uri);
    out->set_serial(ban.serial);
    out->set_reason(ban.reason);
    out->set_by(ban.by);
    out->set_time_unix_ns(ban.time_unix_ns);
  }
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(grpc::Status::OK);
  return reactor;
}

void OperatorService::TellRobotOf(const std::string& uri, const std::string& text) {
  const absl::StatusOr<rpc::PeerIdentity> identity = rpc::ParseSpiffeUri(uri);
  if (!identity.ok() || identity->robot.empty()) return;
  pipeline_
      ->Post(identity->robot, Lane::kControl,
             [text](Robot& robot) { robot.Report(engine::Severity::kHigh, text); })
      .IgnoreError();  // an unknown robot may be banned, too
}

grpc::ServerUnaryReactor* OperatorService::Ban(grpc::CallbackServerContext* context,
                                               const rips::v1::BanRequest* request,
                                               rips::v1::BanResponse*) {
  const auto who = Authorize(context, OperatorRole::kAdmin);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.bans == nullptr) return Refuse(context, absl::UnimplementedError("no deny list"));
  if (request->reason().empty() || request->reason().size() > kBanReasonBytesMax) {
    return Refuse(context, absl::InvalidArgumentError(absl::StrCat(
                               "a reason of 1 to ", kBanReasonBytesMax, " bytes is required")));
  }
  if (request->uri() == rpc::ToString(who->identity)) {
    return Refuse(context, absl::InvalidArgumentError("this would ban the caller"));
  }
  LogInfo("operator bans", {{"operator", rpc::Describe(*who)},
                            {"uri", request->uri()},
                            {"serial", request->serial()},
                            {"reason", request->reason()}});
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  Read(reactor, [this, reactor, request, by = rpc::Describe(*who)] {
    const absl::Status status = access_.bans->Ban({.uri = request->uri(),
                                                   .serial = request->serial(),
                                                   .reason = request->reason(),
                                                   .by = by,
                                                   .time_unix_ns = RealClock().Now().unix_ns});
    if (!absl::IsInvalidArgument(status)) {
      access_.watch->Look();  // what is open ends now
      TellRobotOf(request->uri(),
                  absl::StrCat(request->uri(), " is banned by ", by, ": ", request->reason()));
    }
    reactor->Finish(rpc::ToGrpc(status));
  });
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::Unban(grpc::CallbackServerContext* context,
                                                 const rips::v1::UnbanRequest* request,
                                                 rips::v1::UnbanResponse*) {
  const auto who = Authorize(context, OperatorRole::kAdmin);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.bans == nullptr) return Refuse(context, absl::UnimplementedError("no deny list"));
  LogInfo(
      "operator lifts a ban",
      {{"operator", rpc::Describe(*who)}, {"uri", request->uri()}, {"serial", request->serial()}});
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  Read(reactor, [this, reactor, request, by = rpc::Describe(*who)] {
    const absl::Status status = access_.bans->Unban(request->uri(), request->serial());
    if (status.ok()) {
      TellRobotOf(request->uri(),
                  absl::StrCat("the ban of ", request->uri(), " is lifted by ", by));
    }
    reactor->Finish(rpc::ToGrpc(status));
  });
  return reactor;
}

}  // namespace rips::operator_api

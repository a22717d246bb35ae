#include "policy_server/server/operator_api/operator_service.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/operator_api/alert_acks.h"
#include "policy_server/server/operator_api/answer_limits.h"
#include "policy_server/server/operator_api/coverage_codec.h"
#include "policy_server/server/operator_api/level_codec.h"
#include "policy_server/server/operator_api/overtaken_states.h"
#include "policy_server/server/operator_api/receipt_codec.h"
#include "policy_server/server/operator_api/record_codec.h"
#include "policy_server/server/operator_api/requesters.h"
#include "policy_server/server/operator_api/robot_list.h"
#include "policy_server/server/operator_api/unary_call.h"
#include "policy_server/server/operator_api/watch_stream.h"
#include "services/base/cut_text.h"
#include "services/base/status_macros.h"
#include "services/model_proto/configuration_codec.h"
#include "services/ros2_proto/graph_codec.h"
#include "services/rpc/peer.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"
#include "services/wire_limits/field_limits.h"

namespace rips::operator_api {
namespace {

using pipeline::Queue;
using pipeline::Robot;
using rpc::OperatorRole;

// Of one watch; beyond, it is told more when it has read. A page of the feed fits besides.
constexpr size_t kAlertsWaitingMax = 1'024;
// Far below the limit at which a watch is ended: what it cannot read now follows later.
constexpr size_t kWatchBytesWaitingMax = size_t{1} << 20;
constexpr size_t kBanReasonBytesMax = 1'000;
// Calls that ask every robot, or that cost milliseconds for a large graph, as calls of a quota.
constexpr double kFleetWeight = 2;
constexpr double kGraphWeight = 5;
// A search that no index serves looks at thousands of alerts.
constexpr double kSearchWeight = 5;
constexpr int kNewestRead = 200;  // transitions, to find the newest that was not refused

void RunAll(BoundedQueue<std::function<void()>>& tasks) {
  while (auto task = tasks.Pop(absl::InfiniteDuration())) (*task)();
}

// A name that stands for no robot of the inventory: a typing error must not look like silence.
absl::Status CheckListed(const pipeline::Pipeline& pipeline, const std::set<std::string>& wanted) {
  std::set<std::string> unknown = wanted;
  for (const std::string& robot : pipeline.robots()) unknown.erase(robot);
  if (unknown.empty()) return absl::OkStatus();
  for (const pipeline::RobotStatus& held : pipeline.held()) unknown.erase(held.robot);
  if (unknown.empty()) return absl::OkStatus();
  return absl::NotFoundError(
      absl::StrCat("robot `", absl::CHexEscape(*unknown.begin()), "` is not in the inventory"));
}

// What robots hold that the store has not taken, which is not acknowledged. Waits for the robots.
void AddUnrecorded(pipeline::Pipeline& pipeline, absl::Duration patience,
                   const store::AlertQuery& query, rips::v1::ListAlertsResponse& response) {
  using Alerts = std::vector<store::AlertRecord>;
  AnswerRoom room(kAnswerBytesMax / 4);
  const auto gathered = pipeline.Gather<Alerts>(
      [](Robot& robot) { return robot.core().outbox().alerts(); }, patience);
  Alerts waiting;
  for (const auto& [robot, alerts] : gathered.answers) {
    if (!query.robot.empty() && query.robot != robot) continue;
    std::copy_if(alerts.begin(), alerts.end(), std::back_inserter(waiting),
                 [&query](const auto& alert) { return store::Matches(query, alert); });
  }
  std::stable_sort(waiting.begin(), waiting.end(),
                   [](const auto& a, const auto& b) { return a.time_unix_ns < b.time_unix_ns; });
  const size_t limit = store::ListLimit(query.limit);
  const size_t first = waiting.size() - std::min(waiting.size(), limit);
  for (size_t i = first; i < waiting.size(); ++i) {
    rips::v1::Alert alert = operator_api::Encode(waiting[i]);
    if (!room.Take(alert)) return response.set_cut(true);
    *response.add_unrecorded() = std::move(alert);
  }
}

// As many as there is room for behind those that are not recorded.
void AddRecorded(const std::vector<store::AlertRecord>& records,
                 const std::map<std::string, store::Ack>& acks, uint32_t limit,
                 rips::v1::ListAlertsResponse& response) {
  std::set<std::string> recorded;
  for (const store::AlertRecord& record : records) recorded.insert(record.id);
  auto& unrecorded = *response.mutable_unrecorded();
  unrecorded.erase(std::remove_if(unrecorded.begin(), unrecorded.end(),
                                  [&](const auto& alert) { return recorded.contains(alert.id()); }),
                   unrecorded.end());
  size_t left = store::ListLimit(limit) - static_cast<size_t>(unrecorded.size());
  AnswerRoom room;
  for (const store::AlertRecord& record : records) {
    if (left-- == 0) return;
    rips::v1::Alert alert = operator_api::Encode(record);
    if (const auto ack = acks.find(record.id); ack != acks.end()) {
      *alert.mutable_acknowledged() = operator_api::Encode(ack->second);
    }
    if (!room.Take(alert)) return response.set_cut(true);
    *response.add_alerts() = std::move(alert);
  }
}

}  // namespace

OperatorService::OperatorService(pipeline::Pipeline* pipeline, store::Store* store,
                                 StatusBroadcaster* hub, Access access, absl::Duration patience)
    : pipeline_(pipeline),
      store_(store),
      hub_(hub),
      access_(access),
      patience_(patience),
      reader_([this] { RunAll(reads_); }),
      encoder_([this] { RunAll(graphs_); }) {}

OperatorService::~OperatorService() {
  reads_.Close();
  graphs_.Close();
  reader_.join();
  encoder_.join();
}

absl::StatusOr<OperatorService::Caller> OperatorService::Authorize(
    grpc::CallbackServerContext* context, const google::protobuf::Message& request,
    OperatorRole needed, Use use, double weight) {
  absl::StatusOr<rpc::Peer> peer = access_.watch->Admit(*context, rpc::Role::kOperator);
  if (!peer.ok()) return peer.status();
  if (peer->identity.operator_role < needed) {
    return access_.watch->gate().Refuse(
        {"role",
         absl::PermissionDeniedError(absl::StrCat(
             "this needs the role `", rpc::OperatorRoleName(needed), "`; the certificate has `",
             rpc::OperatorRoleName(peer->identity.operator_role), "`"))},
        &*peer, context->peer());
  }
  if (const auto hit = wire_limits::Check(request)) {
    access_.fields_refused.Count(*hit);
    if (access_.on_refused_field) access_.on_refused_field(*peer, context->peer(), hit->Text());
    return access_.watch->gate().Refuse({"limit", hit->ToStatus()}, &*peer, context->peer());
  }
  Caller caller{*std::move(peer)};
  if (access_.quota != nullptr) {
    const bool privileged = caller.identity.operator_role >= OperatorRole::kOperator;
    auto ticket = access_.quota->Take(rpc::ToString(caller.identity), privileged, use, weight);
    if (!ticket.ok()) {
      return access_.watch->gate().Refuse({"quota", ticket.status()}, &caller, context->peer());
    }
    caller.ticket = *std::move(ticket);
  }
  return caller;
}

absl::StatusOr<OperatorService::Caller> OperatorService::AuthorizeOrder(
    grpc::CallbackServerContext* context, absl::string_view call,
    const google::protobuf::Message& request, OperatorRole needed, Use use, double weight,
    bool effects_are_recorded) {
  absl::StatusOr<Caller> who = Authorize(context, request, needed, use, weight);
  const absl::StatusOr<rpc::Peer> peer = rpc::PeerOf(*context->auth_context());
  const auto record = [audit = access_.audit, caller = peer.ok() ? rpc::Describe(*peer) : "",
                       address = context->peer(), call, &request](const absl::Status& status) {
    if (audit == nullptr) return;
    audit->Record(
        {.caller = caller, .address = address, .call = call, .request = request, .status = status});
  };
  if (!who.ok() || !effects_are_recorded) record(who.status());
  if (!who.ok()) return who;
  who->on_refused = [record, caller = rpc::Describe(*who), call](const absl::Status& why) {
    LogInfo("an order is refused", {{"operator", caller}, {"call", call}, {"why", why.message()}});
    record(why);
  };
  return who;
}

void OperatorService::Read(UnaryCall* reactor, std::function<void()> task) {
  if (reads_.Push(std::move(task))) return;
  reactor->End(absl::ResourceExhaustedError(
      absl::StrCat(kReadsMax, " reads of the store wait already, the limit; try again later")));
}

grpc::ServerUnaryReactor* OperatorService::ListRobots(grpc::CallbackServerContext* context,
                                                      const rips::v1::ListRobotsRequest* request,
                                                      rips::v1::ListRobotsResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery, kFleetWeight);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  // Asks every robot on its own thread; must not be done on a gRPC thread, which may not block.
  Read(reactor, [this, reactor, request, response] {
    auto gathered = pipeline_->Gather<rips::v1::RobotStatus>(
        [](Robot& robot) { return EncodeListed(robot); }, patience_);
    for (const pipeline::RobotStatus& held : pipeline_->held()) {
      gathered.answers.insert_or_assign(held.robot, EncodeStatus(held));
    }
    FillRobotList(*request, {.contacts = access_.contacts, .labels = access_.labels},
                  std::move(gathered.answers), gathered.silent, *response);
    FitStatuses(*response);
    reactor->End(absl::OkStatus());
  });
  return reactor;
}

grpc::ServerWriteReactor<rips::v1::RobotStatus>* OperatorService::WatchRobots(
    grpc::CallbackServerContext* context, const rips::v1::WatchRobotsRequest* request) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kStream);
  if (!who.ok()) return RefuseWatch<rips::v1::RobotStatus>(who.status());
  const std::set<std::string> wanted(request->robots().begin(), request->robots().end());
  const absl::Status listed = CheckListed(*pipeline_, wanted);
  if (!listed.ok()) return RefuseWatch<rips::v1::RobotStatus>(listed);
  auto* stream = new WatchStream<rips::v1::RobotStatus>();
  Keep(rpc::StreamKind::kWatch, stream, *who, context);
  auto outbound = stream->outbound();
  auto overtaken = std::make_shared<OvertakenStates>();
  const auto skip = [outbound, overtaken](const std::string& robot) {
    return overtaken->Skip(robot, [&] {
      const bool full = outbound->waiting_bytes() >= kWatchBytesWaitingMax;
      return full ? OvertakenStates::kWaitingMax : outbound->waiting();
    });
  };
  const auto tell = [pipeline = pipeline_, outbound, skip](const std::string& robot) {
    pipeline
        ->Post(robot, Queue::kOrders,
               [outbound, skip](Robot& each) {
                 if (!skip(each.id())) outbound->Send(EncodeStatus(each.Status()));
               })
        .IgnoreError();  // the next change tells
  };
  const absl::StatusOr<uint64_t> id = hub_->WatchStatus([=](const pipeline::RobotStatus& status) {
    if (!wanted.empty() && !wanted.contains(status.robot)) return outbound->open();
    return skip(status.robot) ? outbound->open() : outbound->Send(EncodeStatus(status));
  });
  if (!id.ok()) {
    outbound->Close(rpc::ToGrpc(id.status()));
    return stream;
  }
  stream->set_on_ended([hub = hub_, id = *id] { hub->Unwatch(id); });
  stream->set_on_drained([overtaken, tell] {
    for (const std::string& robot : overtaken->Take()) tell(robot);
  });
  for (const std::string& robot : pipeline_->robots()) {
    if (wanted.empty() || wanted.contains(robot)) tell(robot);
  }
  for (const pipeline::RobotStatus& held : pipeline_->held()) {
    if (wanted.empty() || wanted.contains(held.robot)) outbound->Send(EncodeStatus(held));
  }
  return stream;
}

grpc::ServerUnaryReactor* OperatorService::GetGraph(grpc::CallbackServerContext* context,
                                                    const rips::v1::GetGraphRequest* request,
                                                    rips::v1::GetGraphResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery, kGraphWeight);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  absl::StatusOr<pipeline::GraphView> view = pipeline_->Graph(request->robot());
  if (!view.ok()) {
    reactor->End(view.status());
    return reactor;
  }
  // Milliseconds for a large graph: neither on the robot's thread nor on a gRPC thread.
  const bool taken = graphs_.Push([reactor, response, view = *std::move(view)] {
    response->mutable_graph()->set_settled(true);
    if (view.graph != nullptr) {
      ros2_proto::EncodeGraph(*view.graph, *response->mutable_graph());
    }
    response->set_changed_unix_ns(view.changed_unix_ns);
    FitGraph(*response);
    reactor->End(absl::OkStatus());
  });
  if (!taken) {
    reactor->End(absl::ResourceExhaustedError(
        absl::StrCat(kGraphsMax, " graphs wait to be sent already, the limit; try again later")));
  }
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::GetInterest(grpc::CallbackServerContext* context,
                                                       const rips::v1::GetInterestRequest* request,
                                                       rips::v1::GetInterestResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery, kGraphWeight);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  const absl::Status posted =
      pipeline_->Post(request->robot(), Queue::kOrders, [reactor, response](Robot& robot) {
        EncodeInterest(robot, *response);
        reactor->End(absl::OkStatus());
      });
  if (!posted.ok()) reactor->End(posted);
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::GetCoverage(grpc::CallbackServerContext* context,
                                                       const rips::v1::GetCoverageRequest* request,
                                                       rips::v1::GetCoverageResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery,
                             request->findings_only() ? 1 : kGraphWeight);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  const absl::Status posted =
      pipeline_->Post(request->robot(), Queue::kOrders, [reactor, request, response](Robot& robot) {
        EncodeCoverage(robot, *request, *response);
        reactor->End(absl::OkStatus());
      });
  if (!posted.ok()) reactor->End(posted);
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::GetConfiguration(
    grpc::CallbackServerContext* context, const rips::v1::GetConfigurationRequest* request,
    rips::v1::GetConfigurationResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kOperator, Use::kQuery);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.settings == nullptr) {
    return Refuse(context, absl::UnimplementedError("no settings are known"));
  }
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  if (request->robot().empty()) {
    *response->mutable_server() = model_proto::Encode(access_.settings->own());
    reactor->End(absl::OkStatus());
    return reactor;
  }
  const auto listed = access_.settings->Of(request->robot());
  if (!listed.has_value()) {
    reactor->End(absl::NotFoundError(
        absl::StrCat("robot `", request->robot(), "` is not in the inventory")));
    return reactor;
  }
  *response->mutable_server() = model_proto::Encode(*listed);
  FillAgentConfigurations(*access_.contacts, request->robot(), *response);
  reactor->End(absl::OkStatus());
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::GetLevel(grpc::CallbackServerContext* context,
                                                    const rips::v1::GetLevelRequest* request,
                                                    rips::v1::GetLevelResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  for (const pipeline::RobotStatus& held : pipeline_->held()) {
    if (held.robot != request->robot()) continue;
    *response->mutable_status() = EncodeStatus(held);
    reactor->End(absl::OkStatus());
    return reactor;
  }
  const absl::Status posted =
      pipeline_->Post(request->robot(), Queue::kOrders,
                      [this, reactor, response, robot_id = request->robot(),
                       lowering_rules = request->lowering_rules()](Robot& robot) {
                        EncodeLevels(robot.core(), lowering_rules, *response);
                        Read(reactor, [this, reactor, response, robot_id] {
                          if (access_.contacts) NameAgents(*access_.contacts, *response);
                          const auto newest = store_->ListTransitions(robot_id, kNewestRead);
                          if (newest.ok()) {
                            // What was refused changed nothing.
                            const auto last = std::find_if(
                                newest->begin(), newest->end(),
                                [](const auto& transition) { return !transition.refused; });
                            if (last != newest->end()) *response->mutable_last() = Encode(*last);
                          }
                          reactor->End(newest.status());
                        });
                      });
  if (!posted.ok()) reactor->End(posted);
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ListTransitions(
    grpc::CallbackServerContext* context, const rips::v1::ListTransitionsRequest* request,
    rips::v1::ListTransitionsResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  Read(reactor, [this, reactor, request, response] {
    const auto records = store_->ListTransitions(request->robot(), request->limit());
    if (records.ok()) {
      AnswerRoom room;
      for (const auto& record : *records) {
        rips::v1::Transition transition = Encode(record);
        response->set_cut(!room.Take(transition));
        if (response->cut()) break;
        *response->add_transitions() = std::move(transition);
      }
    }
    // Also of a robot that was removed, as long as there is something.
    const bool none = records.ok() && records->empty();
    reactor->End(none ? CheckListed(*pipeline_, {request->robot()}) : records.status());
  });
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ListAlerts(grpc::CallbackServerContext* context,
                                                      const rips::v1::ListAlertsRequest* request,
                                                      rips::v1::ListAlertsResponse* response) {
  auto query = DecodeAlertQuery(*request, RealClock().Now().unix_ns);
  const bool searches = query.ok() && query->searches();
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery,
                             searches ? kSearchWeight : 1);
  if (!who.ok()) return Refuse(context, who.status());
  if (!query.ok()) return Refuse(context, query.status());
  const bool filtered = query->open || searches;
  if (filtered && access_.acks == nullptr) return Refuse(context, NoAcks());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  Read(reactor, [this, reactor, response, filtered, query = *std::move(query)] {
    // Asked first: what is recorded in between is in both, not in neither.
    if (access_.store_writable && !access_.store_writable()) {
      AddUnrecorded(*pipeline_, patience_, query, *response);
    }
    const auto listed = ListAlertsOf(query, *store_, filtered ? access_.acks : nullptr);
    if (!listed.ok()) return reactor->End(listed.status());
    response->set_older_not_searched(listed->older_not_searched);
    const auto acks = AcksOf(listed->alerts, access_.acks);
    if (!acks.ok()) return reactor->End(acks.status());
    AddRecorded(listed->alerts, *acks, query.limit, *response);
    const bool none = listed->alerts.empty() && response->unrecorded().empty();
    const bool of_one = !query.robot.empty() && query.robot != store::kServerRobot;
    if (!none || !of_one) return reactor->End(absl::OkStatus());
    const absl::Status of_robot = CheckListed(*pipeline_, {query.robot});
    // Also of a robot that was removed, as long as there is something.
    const auto any = store_->ListAlerts(query.robot, 1);
    reactor->End(any.ok() && !any->empty() ? absl::OkStatus() : of_robot);
  });
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::Explain(grpc::CallbackServerContext* context,
                                                   const rips::v1::ExplainRequest* request,
                                                   rips::v1::ExplainResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery, kGraphWeight);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  Read(reactor, [this, reactor, request, response] {
    auto explained = operator_api::Explain(*request, *store_);
    absl::Status status = explained.status();
    if (status.ok()) status = AddAcks(access_.acks, *explained);
    if (status.ok()) *response = *std::move(explained);
    reactor->End(status);
  });
  return reactor;
}

grpc::ServerWriteReactor<rips::v1::Alert>* OperatorService::WatchAlerts(
    grpc::CallbackServerContext* context, const rips::v1::WatchAlertsRequest* request) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kStream);
  if (!who.ok()) return RefuseWatch<rips::v1::Alert>(who.status());
  // What is stored of a robot that was removed can be watched from a cursor on.
  if (!request->robot().empty() && request->robot() != store::kServerRobot &&
      request->after().empty()) {
    const absl::Status listed = CheckListed(*pipeline_, {request->robot()});
    if (!listed.ok()) return RefuseWatch<rips::v1::Alert>(listed);
  }
  std::optional<Cursor> after;
  if (!request->after().empty()) {
    absl::StatusOr<Cursor> parsed = ParseCursor(request->after());
    if (!parsed.ok()) return RefuseWatch<rips::v1::Alert>(parsed.status());
    after = *std::move(parsed);
  }
  auto* stream = new WatchStream<rips::v1::Alert>();
  Keep(rpc::StreamKind::kWatch, stream, *who, context);
  auto outbound = stream->outbound();
  const absl::StatusOr<uint64_t> id = hub_->WatchAlerts(
      std::move(after),
      {.robot = request->robot(),
       .room =
           [outbound] {
             return outbound->waiting() < kAlertsWaitingMax &&
                    outbound->waiting_bytes() < kWatchBytesWaitingMax;
           },
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
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  using Receipts = std::vector<store::ReceiptRecord>;
  const auto answer = [this, reactor, request, response](const Receipts& newest) {
    Read(reactor, [this, reactor, request, response, newest] {
      const absl::StatusOr<Receipts> stored =
          store_->ListReceipts(request->robot(), store::kReceiptsPerRobotMax);
      if (stored.ok()) Encode(newest, *stored, request->limit(), *response);
      reactor->End(stored.status());
    });
  };
  const absl::Status posted = pipeline_->Post(
      request->robot(), Queue::kOrders,
      [answer](Robot& robot) { answer(robot.core().actuators().receipts().Newest(0)); });
  if (absl::IsFailedPrecondition(posted)) {
    answer({});  // nothing judges it; what was recorded before is there all the same
  } else if (!posted.ok()) {
    reactor->End(posted);
  }
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ResumeRules(grpc::CallbackServerContext* context,
                                                       const rips::v1::ResumeRulesRequest* request,
                                                       rips::v1::ResumeRulesResponse*) {
  const auto who = AuthorizeOrder(context, "ResumeRules", *request, OperatorRole::kOperator);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  const absl::Status posted =
      pipeline_->Post(request->robot(), Queue::kOrders,
                      [reactor, name = OperatorName(*who), reason = request->reason()](
                          Robot& robot) { reactor->End(robot.ResumeRules(name, reason)); });
  if (!posted.ok()) reactor->End(posted);
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::SendSignal(grpc::CallbackServerContext* context,
                                                      const rips::v1::SendSignalRequest* request,
                                                      rips::v1::SendSignalResponse* response) {
  const auto who = AuthorizeOrder(context, "SendSignal", *request, OperatorRole::kOperator);
  if (!who.ok()) return Refuse(context, who.status());
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  pipeline::SignalOrder order{OperatorName(*who), request->signal(), request->reason()};
  const absl::Status posted =
      pipeline_->Post(request->robot(), Queue::kOrders,
                      [reactor, response, order = std::move(order)](Robot& robot) {
                        const pipeline::LevelAnswer answer = robot.SendSignal(order);
                        response->set_level_before(answer.level_before);
                        response->set_decided_level(answer.decided_level);
                        reactor->End(answer.status);
                      });
  if (!posted.ok()) reactor->End(posted);
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::DrillRobot(grpc::CallbackServerContext* context,
                                                      const rips::v1::DrillRobotRequest* request,
                                                      rips::v1::DrillRobotResponse* response) {
  const auto who = AuthorizeOrder(context, "DrillRobot", *request, OperatorRole::kOperator);
  if (!who.ok()) return Refuse(context, who.status());
  LogInfo("operator starts a drill", {{"operator", rpc::Describe(*who)},
                                      {"robot", request->robot()},
                                      {"level", request->level()}});
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  pipeline::DrillOrder order{.operator_name = OperatorName(*who), .level = request->level()};
  pipeline::DrillReply reply = [reactor, response](const pipeline::DrillAnswer& answer) {
    for (const pipeline::DrillEntry& drill : answer.drills) Encode(drill, response->add_drills());
    reactor->End(answer.status);
  };
  const absl::Status posted =
      pipeline_->Post(request->robot(), Queue::kOrders,
                      [order = std::move(order), reply = std::move(reply)](Robot& robot) {
                        robot.StartDrill(order, reply);
                      });
  if (!posted.ok()) reactor->End(posted);
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ResetTerm(grpc::CallbackServerContext* context,
                                                     const rips::v1::ResetTermRequest* request,
                                                     rips::v1::ResetTermResponse* response) {
  const auto who = AuthorizeOrder(context, "ResetTerm", *request, OperatorRole::kAdmin);
  if (!who.ok()) return Refuse(context, who.status());
  LogInfo("operator resets a term", {{"operator", rpc::Describe(*who)},
                                     {"robot", request->robot()},
                                     {"host", request->host()},
                                     {"reason", request->reason()}});
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  pipeline::TermResetOrder order{
      .operator_name = OperatorName(*who), .host = request->host(), .reason = request->reason()};
  pipeline::LevelReply reply = [reactor, response](const pipeline::LevelAnswer& answer) {
    operator_api::Encode(answer, *response);
    reactor->End(answer.status);
  };
  const absl::Status posted = pipeline_->Post(request->robot(), Queue::kOrders,
                                              [order = std::move(order), reply = std::move(reply)](
                                                  Robot& robot) { robot.ResetTerm(order, reply); });
  if (!posted.ok()) reactor->End(posted);
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::ListAgents(grpc::CallbackServerContext* context,
                                                      const rips::v1::ListAgentsRequest* request,
                                                      rips::v1::ListAgentsResponse* response) {
  const auto who = Authorize(context, *request, OperatorRole::kViewer, Use::kQuery);
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
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  reactor->End(absl::OkStatus());
  return reactor;
}

void OperatorService::TellRobotOf(const std::string& uri, const std::string& text) {
  const absl::StatusOr<rpc::PeerIdentity> identity = rpc::ParseSpiffeUri(uri);
  if (!identity.ok() || identity->robot.empty()) return;
  pipeline_
      ->Post(identity->robot, Queue::kOrders,
             [text](Robot& robot) { robot.Report(engine::Severity::kHigh, text); })
      .IgnoreError();  // an unknown robot may be banned, too
}

void OperatorService::EndRequestsOf(const std::string& uri) {
  const absl::StatusOr<rpc::PeerIdentity> identity = rpc::ParseSpiffeUri(uri);
  if (!identity.ok() || identity->role != rpc::Role::kOperator) return;
  for (const std::string& robot : pipeline_->robots()) {
    pipeline_
        ->Post(robot, Queue::kOrders,
               [who = IdentityOf(*identity)](Robot& each) { each.OnOperatorBanned(who); })
        .IgnoreError();  // it is not judged any more
  }
}

grpc::ServerUnaryReactor* OperatorService::Ban(grpc::CallbackServerContext* context,
                                               const rips::v1::BanRequest* request,
                                               rips::v1::BanResponse*) {
  const auto who = AuthorizeOrder(context, "Ban", *request, OperatorRole::kAdmin);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.bans == nullptr) return Refuse(context, absl::UnimplementedError("no deny list"));
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  if (request->reason().empty() || request->reason().size() > kBanReasonBytesMax) {
    reactor->End(absl::InvalidArgumentError(
        absl::StrCat("a reason of 1 to ", kBanReasonBytesMax, " bytes is required")));
    return reactor;
  }
  if (request->uri() == rpc::ToString(who->identity)) {
    reactor->End(absl::InvalidArgumentError("this would ban the caller"));
    return reactor;
  }
  LogInfo("operator bans a certificate", {{"operator", rpc::Describe(*who)},
                                          {"uri", request->uri()},
                                          {"serial", request->serial()},
                                          {"reason", request->reason()}});
  Read(reactor, [this, reactor, request, by = rpc::Describe(*who)] {
    const absl::Status status = access_.bans->Ban({.uri = request->uri(),
                                                   .serial = request->serial(),
                                                   .reason = request->reason(),
                                                   .by = by,
                                                   .time_unix_ns = RealClock().Now().unix_ns});
    if (!absl::IsInvalidArgument(status)) {
      access_.watch->CheckSessions();  // what is open ends now
      EndRequestsOf(request->uri());
      TellRobotOf(request->uri(),
                  absl::StrCat(request->uri(), " is banned by ", by, ": ", request->reason()));
    }
    reactor->End(status);
  });
  return reactor;
}

grpc::ServerUnaryReactor* OperatorService::Unban(grpc::CallbackServerContext* context,
                                                 const rips::v1::UnbanRequest* request,
                                                 rips::v1::UnbanResponse*) {
  const auto who = AuthorizeOrder(context, "Unban", *request, OperatorRole::kAdmin);
  if (!who.ok()) return Refuse(context, who.status());
  if (access_.bans == nullptr) return Refuse(context, absl::UnimplementedError("no deny list"));
  LogInfo(
      "operator lifts a ban",
      {{"operator", rpc::Describe(*who)}, {"uri", request->uri()}, {"serial", request->serial()}});
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  Read(reactor, [this, reactor, request, by = rpc::Describe(*who)] {
    const absl::Status status = access_.bans->Unban(request->uri(), request->serial());
    if (status.ok()) {
      TellRobotOf(request->uri(),
                  absl::StrCat("the ban of ", request->uri(), " is lifted by ", by));
    }
    reactor->End(status);
  });
  return reactor;
}

}  // namespace rips::operator_api

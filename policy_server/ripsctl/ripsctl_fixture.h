// ripsctl as a test runs it, against a server that plays OperatorService on a loopback port.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RIPSCTL_FIXTURE_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RIPSCTL_FIXTURE_H_

#include <algorithm>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/server_credentials.h"
#include "grpcpp/server_builder.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/app.h"
#include "policy_server/ripsctl/fake_enrol_operator.h"
#include "policy_server/ripsctl/offline_run.h"
#include "policy_server/ripsctl/samples.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/mutex.h"

namespace rips::ripsctl {

// One robot `r1` at COMPROMISED (3.17). Remembers the last request; fails with `failure` if set.
class FakeOperator final : public FakeEnrolOperator {
 public:
  v1::ListReceiptsResponse receipts;
  std::optional<v1::ListReceiptsResponse> receipts_after_approval;
  uint32_t graph_left_out = 0;
  v1::GetConfigurationResponse configuration;
  v1::LevelResponse level_response;
  std::string alert_text = "unknown node /intruder";
  std::string unrecorded_alert, alert_recording = MakeAlertRecording();
  std::optional<v1::Acknowledgement> alert_ack;  // Of the alert, from before.
  // What each watch of alerts in turn is told, and how it ends; empty = one alert.
  struct AlertWatch {
    std::vector<v1::Alert> alerts;
    grpc::Status end;
  };
  std::vector<AlertWatch> alert_watches;
  std::vector<std::string> no_answer;
  std::function<void(v1::ListRobotsResponse&)> change_list;
  // How the next watch of robots ends; the later ones end well.
  grpc::Status robots_watch_end;
  // What GetLevel gives, one after the other, and the last one for ever; empty = COMPROMISED.
  std::vector<v1::RobotStatus> level_states;
  // Of the first robot that ListRobots gives.
  std::optional<v1::Maintenance> maintenance;
  // Of GetLevel.
  std::vector<v1::PendingApproval> pending;
  std::vector<v1::HostFirewall> firewalls;
  v1::GetCoverageResponse coverage = MakeFindings(0);
  std::vector<v1::Transition> newer_transitions;  // first in the history
  // Of Explain, by id or decision id (`r1@3.17`), and how all else fails.
  std::map<std::string, v1::ExplainResponse> explained;
  grpc::Status explain_failure{grpc::StatusCode::NOT_FOUND, "there is no record of it"};
  std::vector<std::string> unknown_robots;
  grpc::Status lower_failure;  // of a dry run, too

  v1::LevelRequest last_level_request() ABSL_LOCKS_EXCLUDED(mutex_) {
    MutexLock lock(&mutex_);
    return last_level_request_;
  }

  grpc::Status ListRobots(grpc::ServerContext*, const v1::ListRobotsRequest* request,
                          v1::ListRobotsResponse* response) override {
    *response = MakeRobotList(*request);
    if (maintenance) *response->mutable_robots(0)->mutable_maintenance() = *maintenance;
    for (const std::string& robot : no_answer) response->add_no_answer(robot);
    if (change_list) change_list(*response);
    return Remember(absl::StrCat("ListRobots", request->labels().empty() ? "" : " ",
                                 absl::StrJoin(request->labels(), " ")));
  }
  grpc::Status WatchRobots(grpc::ServerContext*, const v1::WatchRobotsRequest* request,
                           grpc::ServerWriter<v1::RobotStatus>* writer) override {
    const std::string robot = request->robots().empty() ? "r9" : request->robots(0);
    if (!failure.ok()) return Remember("WatchRobots");
    writer->Write(MakeStatus(robot, "ALERT"));
    writer->Write(MakeStatus(robot, "COMPROMISED"));
    Remember("WatchRobots");
    return std::exchange(robots_watch_end, grpc::Status::OK);
  }
  grpc::Status Record(grpc::ServerContext*, const v1::RecordRequest* request,
                      grpc::ServerWriter<v1::Recording>* writer) override {
    if (!failure.ok()) return Remember("Record");
    v1::Recording piece;
    piece.mutable_header()->set_robot(request->robot());
    writer->Write(piece);
    piece.mutable_event()->mutable_signal()->set_name("SIGUSR1");
    for (int i = 0; i < 2; ++i) {
      piece.mutable_event()->set_time_unix_ns(kNewYear + i);
      writer->Write(piece);
    }
    return Remember("Record");
  }
  grpc::Status GetAlertRecording(grpc::ServerContext*, const v1::GetAlertRecordingRequest* request,
                                 grpc::ServerWriter<v1::FilePiece>* writer) override {
    if (failure.ok()) SendInPieces(alert_recording, *writer);
    return Remember(absl::StrCat("GetAlertRecording ", request->alert_id()));
  }
  grpc::Status ListAgents(grpc::ServerContext*, const v1::ListAgentsRequest*,
                          v1::ListAgentsResponse* response) override {
    v1::AgentCertificate* agent = response->add_agents();
    agent->set_uri("spiffe://td/robot/r1/sensor/base");
    agent->set_serial("0f");
    agent->set_not_after_unix_ns(kNewYear);
    v1::CertificateBan* ban = response->add_bans();
    ban->set_uri("spiffe://td/robot/r2/sensor/base");
    ban->set_reason("stolen \x1b[2J");
    ban->set_by("spiffe://td/operator/admin/alice serial 0a");
    ban->set_time_unix_ns(kNewYear);
    return Remember("ListAgents");
  }
  grpc::Status Ban(grpc::ServerContext*, const v1::BanRequest* request, v1::BanResponse*) override {
    return Remember(
        absl::StrCat("Ban ", request->uri(), " ", request->serial(), " ", request->reason()));
  }
  grpc::Status Unban(grpc::ServerContext*, const v1::UnbanRequest* request,
                     v1::UnbanResponse*) override {
    return Remember(absl::StrCat("Unban ", request->uri(), " ", request->serial()));
  }
  grpc::Status ResetTerm(grpc::ServerContext*, const v1::ResetTermRequest* request,
                         v1::ResetTermResponse* response) override {
    response->mutable_decision_id()->set_term(2'000'000);
    response->mutable_decision_id()->set_epoch(8);
    response->set_decided_level("ALERT");
    return Remember(
        absl::StrCat("ResetTerm ", request->robot(), " ", request->host(), " ", request->reason()));
  }
  grpc::Status GetGraph(grpc::ServerContext*, const v1::GetGraphRequest*,
                        v1::GetGraphResponse* response) override {
    *response->mutable_graph() = MakeGraph();
    response->set_left_out(graph_left_out);
    response->set_changed_unix_ns(kNewYear);
    return Remember("GetGraph");
  }
  grpc::Status GetConfiguration(grpc::ServerContext*, const v1::GetConfigurationRequest* request,
                                v1::GetConfigurationResponse* response) override {
    *response = configuration;
    return Remember(absl::StrCat("GetConfiguration ", request->robot()));
  }
  grpc::Status GetInterest(grpc::ServerContext*, const v1::GetInterestRequest* request,
                           v1::GetInterestResponse*) override {
    return Remember(absl::StrCat("GetInterest ", request->robot()));
  }
  grpc::Status GetCoverage(grpc::ServerContext*, const v1::GetCoverageRequest* request,
                           v1::GetCoverageResponse* response) override {
    *response = coverage;
    const std::string about = request->has_finding() ? " of " + request->finding().topic() : "";
    return Remember(absl::StrCat(request->findings_only() ? "GetFindings " : "GetCoverage ",
                                 request->robot(), about));
  }
  grpc::Status ListReceipts(grpc::ServerContext*, const v1::ListReceiptsRequest* request,
                            v1::ListReceiptsResponse* response) override {
    *response = receipts;
    return Remember(absl::StrCat("ListReceipts ", request->robot()));
  }
  grpc::Status DrillRobot(grpc::ServerContext*, const v1::DrillRobotRequest* request,
                          v1::DrillRobotResponse*) override {
    return Remember(absl::StrCat("DrillRobot ", request->robot()));
  }
  grpc::Status GetLevel(grpc::ServerContext*, const v1::GetLevelRequest* request,
                        v1::GetLevelResponse* response) override {
    *response->mutable_status() = MakeStatus(request->robot(), "COMPROMISED");
    if (!level_states.empty()) {
      *response->mutable_status() = level_states.front();
      if (level_states.size() > 1) level_states.erase(level_states.begin());
    }
    if (std::count(unknown_robots.begin(), unknown_robots.end(), request->robot()) > 0) {
      return {grpc::StatusCode::NOT_FOUND, absl::StrCat("no robot `", request->robot(), "`")};
    }
    for (const char* level : {"DEFAULT", "ALERT", "COMPROMISED"}) response->add_levels(level);
    response->add_soft_levels("ALERT");
    for (const v1::PendingApproval& each : pending) *response->add_pending_approvals() = each;
    for (const v1::HostFirewall& each : firewalls) *response->add_firewalls() = each;
    *response->mutable_last() = MakeTransition();
    return Remember("GetLevel");
  }
  grpc::Status ListTransitions(grpc::ServerContext*, const v1::ListTransitionsRequest* request,
                               v1::ListTransitionsResponse* response) override {
    for (const v1::Transition& each : newer_transitions) *response->add_transitions() = each;
    *response->add_transitions() = MakeTransition();
    v1::Transition& refused = *response->add_transitions() = MakeTransition();
    refused.clear_decision_id();
    refused.set_refused(true);
    refused.set_count(request->limit());
    refused.set_reason("needs an operator");
    return Remember("ListTransitions");
  }
  grpc::Status ListAlerts(grpc::ServerContext*, const v1::ListAlertsRequest* request,
                          v1::ListAlertsResponse* response) override {
    *response->add_alerts() = MakeAlert(alert_text);
    if (alert_ack) *response->mutable_alerts(0)->mutable_acknowledged() = *alert_ack;
    response->set_older_not_searched(request->rule() == "old");
    if (!unrecorded_alert.empty()) *response->add_unrecorded() = MakeAlert(unrecorded_alert);
    return Remember("ListAlerts " + FilterText(*request));
  }
  grpc::Status AckAlerts(grpc::ServerContext*, const v1::AckAlertsRequest* request,
                         v1::AckAlertsResponse* response) override {
    for (const std::string& id : request->alert_ids()) {
      v1::AckedAlert& alert = *response->add_alerts();
      alert.set_alert_id(id);
      *alert.mutable_acknowledged() = alert_ack.value_or(v1::Acknowledgement());
      alert.set_already(alert_ack.has_value());
      alert.set_robot("r1");
      alert.set_rule("unknown_node");
    }
    return Remember(
        absl::StrCat("AckAlerts ", absl::StrJoin(request->alert_ids(), " "), " ", request->note()));
  }
  grpc::Status WatchAlerts(grpc::ServerContext*, const v1::WatchAlertsRequest* request,
                           grpc::ServerWriter<v1::Alert>* writer) override {
    if (alert_watches.empty()) {
      writer->Write(MakeAlert(alert_text));
      return Remember("WatchAlerts");
    }
    static_cast<void>(Remember(absl::StrCat("WatchAlerts after ", request->after())));
    AlertWatch watch;
    {
      MutexLock lock(&mutex_);
      watch = alert_watches[std::min(watched_++, alert_watches.size() - 1)];
    }
    for (const v1::Alert& alert : watch.alerts) writer->Write(alert);
    return watch.end;
  }
  grpc::Status Explain(grpc::ServerContext*, const v1::ExplainRequest* request,
                       v1::ExplainResponse* response) override {
    const std::string key = request->has_decision_id()
                                ? absl::StrCat(request->robot(), "@", request->decision_id().term(),
                                               ".", request->decision_id().epoch())
                                : request->id();
    const grpc::Status status = Remember("Explain " + key);
    const auto it = explained.find(key);
    if (!status.ok()) return status;
    if (it == explained.end()) return explain_failure;
    *response = it->second;
    return grpc::Status::OK;
  }
  grpc::Status DeEscalate(grpc::ServerContext*, const v1::LevelRequest* request,
                          v1::LevelResponse* response) override {
    if (!lower_failure.ok()) return lower_failure;
    return Change("DeEscalate", *request, response);
  }
  grpc::Status Raise(grpc::ServerContext*, const v1::LevelRequest* request,
                     v1::LevelResponse* response) override {
    return Change("Raise", *request, response);
  }
  grpc::Status Approve(grpc::ServerContext*, const v1::ApproveRequest* request,
                       v1::LevelResponse* response) override {
    *response = level_response;
    if (receipts_after_approval.has_value()) receipts = *receipts_after_approval;
    return Remember(absl::StrCat("Approve ", request->robot(), " ", request->pending_approval_id(),
                                 " ", request->reason(), request->reject() ? " reject" : "",
                                 request->accept_blind() ? " accept-blind" : "",
                                 request->accept_changes() ? " accept-changes" : ""));
  }

 private:
  grpc::Status Change(const std::string& call, const v1::LevelRequest& request,
                      v1::LevelResponse* response) ABSL_LOCKS_EXCLUDED(mutex_) {
    {
      MutexLock lock(&mutex_);
      last_level_request_ = request;
    }
    *response = level_response;
    if (!request.dry_run()) {
      response->set_decided_level(request.to());
      *response->mutable_decision_id() = MakeDecisionId(3, 18);
    }
    return Remember(call);
  }

  Mutex mutex_;
  v1::LevelRequest last_level_request_ ABSL_GUARDED_BY(mutex_);
  size_t watched_ ABSL_GUARDED_BY(mutex_) = 0;
};

class RipsctlTest : public testing::Test {
 protected:
  RipsctlTest() {
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    builder.RegisterService(&fake_);
    server_ = builder.BuildAndStart();
  }
  ~RipsctlTest() override { server_->Shutdown(); }

  Result Run(const std::vector<std::string>& args) {
    std::ostringstream out;
    std::ostringstream err;
    const int code = RunRipsctl(
        args, {.out = out,
               .err = err,
               .get_env = [this](const std::string& name) -> std::optional<std::string> {
                 if (name == "HOME") return home_;
                 const auto it = env_.find(name);
                 if (it == env_.end()) return std::nullopt;
                 return it->second;
               },
               .connect = [this](const RawSettings& settings) { return Connect(settings); },
               .sleep = [this](absl::Duration) { ++sleeps_; }});
    return Saved(args, {code, out.str(), err.str()});
  }
  absl::StatusOr<std::unique_ptr<v1::OperatorService::StubInterface>> Connect(
      const RawSettings& settings) {
    used_ = settings;
    if (tls_) return ConnectWithTls(settings);
    return std::unique_ptr<v1::OperatorService::StubInterface>(
        v1::OperatorService::NewStub(grpc::CreateChannel(absl::StrCat("127.0.0.1:", port_),
                                                         grpc::InsecureChannelCredentials())));
  }
  nlohmann::json RunJson(std::vector<std::string> args, int expected_code = 0) {
    args.insert(args.end(), {"--output", "json"});
    const Result result = Run(args);
    EXPECT_EQ(result.code, expected_code) << result.err;
    EXPECT_TRUE(result.out.ends_with('\n'));
    const nlohmann::json json = nlohmann::json::parse(result.out, nullptr, false);
    EXPECT_FALSE(json.is_discarded()) << result.out;
    return json;
  }
  std::string File(const std::string& name, const std::string& text) {
    return directory_.Write(name, text);
  }

  const TestDirectory directory_;
  const std::string home_ = directory_.path();
  std::map<std::string, std::string> env_;
  bool tls_ = false;
  int sleeps_ = 0;
  FakeOperator fake_;
  std::unique_ptr<grpc::Server> server_;
  int port_ = 0;
  RawSettings used_;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RIPSCTL_FIXTURE_H_

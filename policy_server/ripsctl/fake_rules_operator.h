// The calls about rules of a server that plays OperatorService for a test.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_FAKE_RULES_OPERATOR_H_
#define RIPS_POLICY_SERVER_RIPSCTL_FAKE_RULES_OPERATOR_H_

#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/ripsctl/samples.h"
#include "rips/v1/operator.grpc.pb.h"
#include "services/runtime/mutex.h"

namespace rips::ripsctl {

// Remembers the calls; each fails with `failure` if that is set, else gives what is set for it.
class FakeRulesOperator : public v1::OperatorService::Service {
 public:
  grpc::Status failure;
  v1::ListBundlesResponse bundles;
  // What GetRulesStatus gives, one after the other, and the last one for ever.
  std::vector<v1::GetRulesStatusResponse> rules_states;
  v1::PushBundleResponse pushed;
  v1::RolloutResponse rollout;
  v1::ShadowBundleResponse shadowed;

  std::vector<std::string> calls() ABSL_LOCKS_EXCLUDED(calls_mutex_) {
    MutexLock lock(&calls_mutex_);
    return calls_;
  }

  grpc::Status ListBundles(grpc::ServerContext*, const v1::ListBundlesRequest*,
                           v1::ListBundlesResponse* response) override {
    *response = bundles;
    return Remember("ListBundles");
  }
  grpc::Status GetRulesStatus(grpc::ServerContext*, const v1::GetRulesStatusRequest* request,
                              v1::GetRulesStatusResponse* response) override {
    if (!rules_states.empty()) {
      *response = rules_states.front();
      if (rules_states.size() > 1) rules_states.erase(rules_states.begin());
    }
    return Remember(absl::StrCat("GetRulesStatus ", request->robot()));
  }
  grpc::Status PushBundle(grpc::ServerContext*, grpc::ServerReader<v1::PushBundleRequest>* reader,
                          v1::PushBundleResponse* response) override {
    *response = pushed;
    size_t bytes = 0;
    v1::PushBundleRequest piece;
    while (reader->Read(&piece)) bytes += piece.data().size();
    return Remember(absl::StrCat("PushBundle ", bytes == piece.archive_bytes() ? "whole" : "torn"));
  }
  grpc::Status ActivateBundle(grpc::ServerContext*, const v1::ActivateBundleRequest* request,
                              v1::RolloutResponse* response) override {
    *response = rollout;
    return Remember(absl::StrCat("ActivateBundle ", request->ShortDebugString()));
  }
  grpc::Status RollBackBundle(grpc::ServerContext*, const v1::RollBackBundleRequest* request,
                              v1::RolloutResponse* response) override {
    *response = rollout;
    return Remember(absl::StrCat("RollBackBundle ", request->ShortDebugString()));
  }
  grpc::Status SetMaintenance(grpc::ServerContext*, const v1::SetMaintenanceRequest* request,
                              v1::SetMaintenanceResponse* response) override {
    if (request->for_ms() > 0) *response->mutable_maintenance() = MakeMaintenance();
    return Remember(absl::StrCat("SetMaintenance ", request->robot(), " ", request->for_ms(), " ",
                                 request->reason()));
  }
  grpc::Status ResumeRules(grpc::ServerContext*, const v1::ResumeRulesRequest* request,
                           v1::ResumeRulesResponse*) override {
    return Remember(absl::StrCat("ResumeRules ", request->robot(), " ", request->reason()));
  }
  grpc::Status SendSignal(grpc::ServerContext*, const v1::SendSignalRequest* request,
                          v1::SendSignalResponse* response) override {
    response->set_level_before("DEFAULT");
    response->set_decided_level(request->signal() == "SIGUSR1" ? "HALT" : "DEFAULT");
    return Remember(absl::StrCat("SendSignal ", request->robot(), " ", request->signal(), " ",
                                 request->reason()));
  }
  grpc::Status StopRollout(grpc::ServerContext*, const v1::StopRolloutRequest* request,
                           v1::RolloutResponse* response) override {
    *response = rollout;
    return Remember(absl::StrCat("StopRollout ", request->reason()));
  }
  grpc::Status ShadowBundle(grpc::ServerContext*, const v1::ShadowBundleRequest* request,
                            v1::ShadowBundleResponse* response) override {
    *response = shadowed;
    return Remember(absl::StrCat("ShadowBundle ", request->ShortDebugString()));
  }

 protected:
  grpc::Status Remember(const std::string& call) ABSL_LOCKS_EXCLUDED(calls_mutex_) {
    MutexLock lock(&calls_mutex_);
    calls_.push_back(call);
    return failure;
  }

 private:
  Mutex calls_mutex_;
  std::vector<std::string> calls_ ABSL_GUARDED_BY(calls_mutex_);
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_FAKE_RULES_OPERATOR_H_

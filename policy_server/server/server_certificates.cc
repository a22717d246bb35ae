// What the server does about certificates while it runs: its own and its peers' lives, and the
// revocation lists. The rest of it is in server.cc.
#include <string>

#include "policy_server/server/server.h"

namespace rips::server {

void Server::LookAtRevocations() {
  credentials_->Refresh();
  const absl::Status problem =
      credentials_->RevocationProblem(absl::FromUnixNanos(clock_.Now().unix_ns));
  revocation_problem_.Set(problem.ok() ? 0 : 1);
  {
    MutexLock lock(&revocation_mu_);
    if (revocation_told_ == problem.message()) return;
    revocation_told_ = std::string(problem.message());
  }
  if (!problem.ok()) OwnAlert(engine::Severity::kCritical, std::string(problem.message()));
}

void Server::OnCertificate(const rpc::CertificateMonitor::Notice& notice) {
  const engine::Severity severity = notice.stage == rpc::LifeStage::kThird
                                        ? engine::Severity::kMedium
                                    : notice.own ? engine::Severity::kCritical
                                                 : engine::Severity::kHigh;
  const std::string text = rpc::CertificateMonitor::Text(notice);
  if (notice.own) return OwnAlert(severity, text);
  const std::string& robot = notice.certificate.identity.robot;
  if (robot.empty()) return;  // an operator's: logged
  pipeline_
      ->Post(robot, pipeline::Queue::kOrders,
             [severity, text](pipeline::Robot& each) { each.Report(severity, text); })
      .IgnoreError();  // not of ours
}

}  // namespace rips::server

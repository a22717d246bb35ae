// How the server comes to sign certificates; the rest of it is in server.cc.
#include <map>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/server/server.h"

namespace rips::server {
namespace {

std::unique_ptr<enrol::ExternalCa> MakeExternalCa(const ExternalCaConfig& config, Metrics& metrics,
                                                  const Clock* clock) {
  std::map<absl::string_view, Counter> failures;
  for (const absl::string_view reason : enrol::kExternalCaFailures) {
    failures[reason] = metrics.AddCounter(
        "rips_enrolment_ca_failures_total",
        "Certificates that the external certificate authority did not sign as asked for.",
        {{"reason", std::string(reason)}});
  }
  // Without a program the counters stay at 0.
  if (config.program.empty()) return nullptr;
  return std::make_unique<enrol::ExternalCa>(
      enrol::ExternalCaOptions{
          .program = config.program,
          .timeout = config.timeout,
          .failed = [failures](absl::string_view reason) { failures.at(reason).Increment(); }},
      clock);
}

}  // namespace

void Server::OpenEnrolment() {
  const EnrolmentConfig& config = config_.enrolment;
  enrolling_.external_ca = MakeExternalCa(config.external_ca, metrics_, &clock_);
  if (!config.enabled()) return;
  const auto problem = [this](const absl::Status& why) {
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat("no certificates can be issued: ", why.message()));
  };
  auto opened = store::SqliteEnrolments::Open(config_.enrolment_path());
  if (!opened.ok()) return problem(opened.status());
  enrolling_.store = *std::move(opened);
  const enrol::IssuingFiles files = {.cert = config.cert, .key = config.key, .ca = config_.tls.ca};
  enrolling_.enrolment = std::make_unique<enrol::Enrolment>(
      enrol::EnrolmentOptions{.files = files,
                              .external_ca = enrolling_.external_ca.get(),
                              .trust_domain = config_.trust_domain,
                              .life = config.life},
      enrolling_.store.get(), &clock_,
      enrol::EnrolmentPorts{
          .is_banned =
              [this](const rpc::PeerIdentity& identity, const std::string& serial) {
                return bans_->Against({.identity = identity, .serial = serial}).has_value();
              },
          .tell = [this](const std::string& robot, engine::Severity severity,
                         const std::string& text) { alerts_->Raise(robot, severity, text); },
          .issued = [this](const rpc::Peer& agent) { certificates_->Seen(agent); }});
  const absl::Status usable = enrolling_.external_ca == nullptr
                                  ? enrol::CheckIssuingFiles(files)
                                  : enrol::CheckExternalCaProgram(config.external_ca.program[0]);
  if (!usable.ok()) problem(usable);
}

}  // namespace rips::server

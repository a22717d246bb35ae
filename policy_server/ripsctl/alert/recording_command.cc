// `ripsctl alert recording`: what the rules were given to judge before an alert, into a file for
// `rules replay`.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/match.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/recording_file.h"
#include "policy_server/ripsctl/cli/server_expiry.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

class AlertRecording final : public Command {
 public:
  AlertRecording()
      : Command({"alert", "recording",
                 "Fetch the events that led to an alert of severity high or critical"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("ID", id_, "Id of the alert, or its first digits, as `alert list` shows it")
        ->required();
    file_.AddFlags(app);
  }
  absl::Status Check() override { return file_.Check(); }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    grpc::ClientContext context;
    v1::GetAlertRecordingRequest request;
    request.set_alert_id(id_);
    const auto reader = env.server->GetAlertRecording(&context, request);
    ServerExpiry expiry(&context);
    const absl::Status written = file_.Write(*reader, expiry);
    if (!written.ok()) context.TryCancel();
    const grpc::Status ended = expiry.End(reader->Finish());
    RIPS_RETURN_IF_ERROR(written);
    RIPS_RETURN_IF_ERROR(rpc::FromGrpc(ended));
    RIPS_RETURN_IF_ERROR(FileError(file_.Finish()));
    return Print(env);
  }

 private:
  ExitCode Print(Env& env) const {
    const recording::RecordedOrigin& origin = file_.origin();
    if (env.json()) {
      Json alerts = Json::array();
      for (const recording::RecordedAlert& each : origin.alerts) {
        alerts.push_back({{"id", each.id},
                          {"rule", each.rule},
                          {"severity", each.severity},
                          {"text", each.text},
                          {"time", FullTime(each.time_unix_ns)}});
      }
      return PrintJson(env, {{"robot", origin.robot},
                             {"file", file_.path()},
                             {"events", file_.events()},
                             {"start", FullTime(origin.start_unix_ns)},
                             {"end", FullTime(file_.end_unix_ns())},
                             {"level", origin.level},
                             {"bundle", origin.bundle_id},
                             {"alerts", std::move(alerts)}});
    }
    const int64_t lasts_ns = file_.end_unix_ns() - origin.start_unix_ns;
    env.out << file_.events() << " events in "
            << absl::FormatDuration(absl::Trunc(absl::Nanoseconds(lasts_ns), absl::Milliseconds(1)))
            << " of " << EscapeText(origin.robot) << " from " << ShortTime(origin.start_unix_ns)
            << " on, at " << EscapeText(origin.level) << ", in " << file_.path() << "\n";
    for (const recording::RecordedAlert& each : origin.alerts) {
      if (!absl::StartsWith(each.id, id_)) continue;
      env.out << "with alert " << ShortId(each.id) << ", " << EscapeText(each.rule) << ": "
              << EscapeText(each.text) << "\n";
    }
    env.out << "what the rules did with them, with the directory of the robot's bundle ("
            << EscapeText(origin.bundle_id.substr(0, kBundleIdShown)) << "):\n"
            << "  ripsctl rules replay --rules BUNDLE --events " << file_.path() << "\n";
    return ExitCode::kDone;
  }

  // `sha256:` and the digits that tell bundles apart.
  static constexpr size_t kBundleIdShown = 15;
  std::string id_;
  RecordingFile file_;
};

}  // namespace

Commands AlertRecordingCommands() { return MakeCommands<AlertRecording>(); }

}  // namespace rips::ripsctl

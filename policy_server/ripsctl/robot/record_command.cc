// `ripsctl record`: what a robot's rules are given to judge, into a file for `rules replay`.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/recording_file.h"
#include "policy_server/ripsctl/cli/server_expiry.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

class Record final : public RobotCommand {
 public:
  Record()
      : RobotCommand({"record", "",
                      "Record the events a robot's rules are evaluated on, for `rules replay`"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    file_.AddFlags(app);
    app.add_option("--for", for_, "Duration, for example 60s; default: until interrupted");
  }
  absl::Status Check() override {
    if (!for_.empty() &&
        (!absl::ParseDuration(for_, &duration_) || duration_ <= absl::ZeroDuration())) {
      return absl::InvalidArgumentError(
          absl::StrCat("--for is `", for_, "`, not a time like `60s`"));
    }
    RIPS_RETURN_IF_ERROR(file_.Check());
    return RobotCommand::Check();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    grpc::ClientContext context;
    const bool limited = duration_ != absl::InfiniteDuration();
    if (limited) context.set_deadline(absl::ToChronoTime(absl::Now() + duration_));
    v1::RecordRequest request;
    request.set_robot(robot_);
    const auto reader = env.server->Record(&context, request);
    ServerExpiry expiry(&context);
    const absl::Status written = file_.Write(*reader, expiry);
    if (!written.ok()) context.TryCancel();
    const grpc::Status ended = expiry.End(reader->Finish());
    RIPS_RETURN_IF_ERROR(written);
    const bool in_time =
        ended.error_code() == grpc::StatusCode::DEADLINE_EXCEEDED && file_.begun() && limited;
    if (!in_time) RIPS_RETURN_IF_ERROR(rpc::FromGrpc(ended));
    RIPS_RETURN_IF_ERROR(FileError(file_.Finish()));
    if (env.json()) {
      return PrintJson(env,
                       {{"robot", robot_}, {"file", file_.path()}, {"events", file_.events()}});
    }
    env.out << file_.events() << " events of " << robot_ << " in " << file_.path() << "\n";
    return ExitCode::kDone;
  }

 private:
  RecordingFile file_;
  std::string for_;
  absl::Duration duration_ = absl::InfiniteDuration();
};

}  // namespace

Commands RecordCommands() { return MakeCommands<Record>(); }

}  // namespace rips::ripsctl

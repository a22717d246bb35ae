// `ripsctl record`: what a robot's rules are given to judge, into a file for `rules replay`.
#include <fcntl.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "policy_server/policy/recording/event_codec.h"
#include "policy_server/policy/recording/rips_writer.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/server_expiry.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"
#include "services/runtime/unique_fd.h"

namespace rips::ripsctl {
namespace {

absl::Status AlreadyThere(const std::string& path) {
  return absl::AlreadyExistsError(
      absl::StrCat("`", path, "` is there already; choose another file, or --force"));
}

absl::StatusOr<UniqueFd> CreateFile(const std::string& path, bool replace) {
  UniqueFd file(
      open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC | (replace ? O_TRUNC : O_EXCL), 0600));
  if (file.get() >= 0) return file;
  if (errno == EEXIST) return AlreadyThere(path);
  return absl::ErrnoToStatus(errno, absl::StrCat("cannot write `", path, "`"));
}

class Record final : public RobotCommand {
 public:
  Record()
      : RobotCommand({"record", "",
                      "Record the events a robot's rules are evaluated on, for `rules replay`"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_option("--out", path_, "File to write")->required();
    app.add_option("--for", for_, "Duration, for example 60s; default: until interrupted");
    app.add_flag("--force", force_, "Overwrite an existing file");
  }
  absl::Status Check() override {
    if (!for_.empty() &&
        (!absl::ParseDuration(for_, &duration_) || duration_ <= absl::ZeroDuration())) {
      return absl::InvalidArgumentError(
          absl::StrCat("--for is `", for_, "`, not a time like `60s`"));
    }
    if (!force_ && access(path_.c_str(), F_OK) == 0) return AlreadyThere(path_);
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
    const absl::Status written = Write(*reader, expiry);
    if (!written.ok()) context.TryCancel();
    const grpc::Status ended = expiry.End(reader->Finish());
    RIPS_RETURN_IF_ERROR(written);
    const bool in_time =
        ended.error_code() == grpc::StatusCode::DEADLINE_EXCEEDED && begun_ && limited;
    if (!in_time) RIPS_RETURN_IF_ERROR(rpc::FromGrpc(ended));
    if (fsync(file_.get()) != 0) {
      return absl::ErrnoToStatus(errno, absl::StrCat("cannot write `", path_, "`"));
    }
    if (env.json()) {
      return PrintJson(env, {{"robot", robot_}, {"file", path_}, {"events", events_}});
    }
    env.out << events_ << " events of " << robot_ << " in " << path_ << "\n";
    return ExitCode::kDone;
  }

 private:
  // Makes the file once the server has begun, so that a refused recording leaves none.
  absl::Status Write(grpc::ClientReaderInterface<v1::Recording>& reader, ServerExpiry& expiry) {
    v1::Recording piece;
    if (!reader.Read(&piece)) return absl::OkStatus();  // the status of the call says why
    expiry.Received();
    if (!piece.has_header()) return absl::InternalError("the server sent no header");
    RIPS_ASSIGN_OR_RETURN(file_, CreateFile(path_, force_));
    RIPS_ASSIGN_OR_RETURN(
        recording::RipsWriter writer,
        recording::RipsWriter::Create(file_.get(), recording::DecodeHeader(piece.header())));
    begun_ = true;
    while (reader.Read(&piece)) {
      RIPS_ASSIGN_OR_RETURN(const recording::Recorded event, recording::DecodeEvent(piece.event()));
      RIPS_RETURN_IF_ERROR(writer.Append(event));
      ++events_;
    }
    return absl::OkStatus();
  }

  std::string path_;
  std::string for_;
  absl::Duration duration_ = absl::InfiniteDuration();
  bool force_ = false;
  UniqueFd file_;
  bool begun_ = false;
  uint64_t events_ = 0;
};

}  // namespace

Commands RecordCommands() { return MakeCommands<Record>(); }

}  // namespace rips::ripsctl

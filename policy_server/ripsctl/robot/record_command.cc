#include "policy_server/ripsctl/robot/record_command.h"

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
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/server_expiry.h"
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

class Record final : public Command {
 public:
  absl::string_view noun() const override { return "record"; }
  absl::string_view verb() const override { return ""; }
  absl::string_view synopsis() const override {
    return "Record the events a robot's rules are evaluated on, for `rules replay`";
  }
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id")->required();
    app.add_option("--out", path_, "The file to write")->required();
    app.add_option("--for", duration_, "How long, for example 60s; without it, until interrupted");
    app.add_flag("--force", force_, "Replace the file if it is there");
  }
  ExitCode Run(Env& env) override {
    if (const absl::Status valid = CheckRobot(robot_); !valid.ok()) {
      return UsageError(env, valid.message());
    }
    absl::Duration duration = absl::InfiniteDuration();
    if (!duration_.empty() &&
        (!absl::ParseDuration(duration_, &duration) || duration <= absl::ZeroDuration())) {
      return UsageError(env, absl::StrCat("--for is `", duration_, "`, not a time like `60s`"));
    }
    if (!force_ && access(path_.c_str(), F_OK) == 0) {
      return UsageError(env, AlreadyThere(path_).message());
    }
    grpc::ClientContext context;
    if (duration != absl::InfiniteDuration()) {
      context.set_deadline(absl::ToChronoTime(absl::Now() + duration));
    }
    v1::RecordRequest request;
    request.set_robot(robot_);
    const auto reader = env.server->Record(&context, request);
    ServerExpiry expiry(&context);
    const absl::Status written = Write(*reader, expiry);
    if (!written.ok()) context.TryCancel();
    const grpc::Status ended = expiry.End(reader->Finish());
    if (!written.ok()) return Failed(env, written);
    const bool in_time = ended.error_code() == grpc::StatusCode::DEADLINE_EXCEEDED && begun_ &&
                         duration != absl::InfiniteDuration();
    if (!ended.ok() && !in_time) return Ended(env, ended);
    if (fsync(file_.get()) != 0) {
      return Failed(env, absl::ErrnoToStatus(errno, absl::StrCat("cannot write `", path_, "`")));
    }
    if (env.json()) {
      PrintJson({{"robot", robot_}, {"file", path_}, {"events", events_}}, env.out);
    } else {
      env.out << events_ << " events of " << robot_ << " in " << path_ << "\n";
    }
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

  std::string robot_;
  std::string path_;
  std::string duration_;
  bool force_ = false;
  UniqueFd file_;
  bool begun_ = false;
  uint64_t events_ = 0;
};

}  // namespace

Commands RecordCommands() {
  Commands commands;
  commands.push_back(std::make_unique<Record>());
  return commands;
}

}  // namespace rips::ripsctl

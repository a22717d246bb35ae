#include "policy_server/ripsctl/cli/recording_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <memory>
#include <optional>
#include <utility>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/recording/event_codec.h"
#include "policy_server/policy/recording/reader.h"
#include "policy_server/policy/recording/rips_writer.h"
#include "services/base/status_macros.h"

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

}  // namespace

void RecordingFile::AddFlags(CLI::App& app) {
  app.add_option("--out", path_, "File to write")->required();
  app.add_flag("--force", force_, "Overwrite an existing file");
}

absl::Status RecordingFile::Check() const {
  if (!force_ && access(path_.c_str(), F_OK) == 0) return AlreadyThere(path_);
  return absl::OkStatus();
}

absl::Status RecordingFile::Write(grpc::ClientReaderInterface<v1::Recording>& reader,
                                  ServerExpiry& expiry) {
  v1::Recording piece;
  if (!reader.Read(&piece)) return absl::OkStatus();
  expiry.Received();
  if (!piece.has_header()) return absl::InternalError("the server sent no header");
  origin_ = recording::DecodeHeader(piece.header());
  end_unix_ns_ = origin_.start_unix_ns;
  RIPS_ASSIGN_OR_RETURN(file_, CreateFile(path_, force_));
  RIPS_ASSIGN_OR_RETURN(recording::RipsWriter writer,
                        recording::RipsWriter::Create(file_.get(), origin_));
  while (reader.Read(&piece)) {
    RIPS_ASSIGN_OR_RETURN(const recording::Recorded event, recording::DecodeEvent(piece.event()));
    RIPS_RETURN_IF_ERROR(writer.Append(event));
    ++events_;
    end_unix_ns_ = std::max(end_unix_ns_, event.time_unix_ns.value_or(0));
  }
  return absl::OkStatus();
}

absl::Status RecordingFile::Write(grpc::ClientReaderInterface<v1::FilePiece>& reader,
                                  ServerExpiry& expiry) {
  v1::FilePiece piece;
  uint64_t bytes = 0;
  while (reader.Read(&piece)) {
    expiry.Received();
    if (!begun()) {
      RIPS_ASSIGN_OR_RETURN(file_, CreateFile(path_, force_));
    }
    absl::string_view left = piece.data();
    while (!left.empty()) {
      const ssize_t written = write(file_.get(), left.data(), left.size());
      if (written < 0 && errno == EINTR) continue;
      if (written < 0)
        return absl::ErrnoToStatus(errno, absl::StrCat("cannot write `", path_, "`"));
      left.remove_prefix(static_cast<size_t>(written));
    }
    bytes += piece.data().size();
  }
  if (!begun()) return absl::OkStatus();
  if (bytes != piece.file_bytes()) {
    return absl::DataLossError(absl::StrCat("the recording has ", piece.file_bytes(),
                                            " bytes, of which ", bytes, " came"));
  }
  return Verify();
}

absl::Status RecordingFile::Verify() {
  RIPS_ASSIGN_OR_RETURN(const std::unique_ptr<recording::Reader> reader,
                        recording::OpenFile(path_));
  if (reader->origin() == nullptr) {
    return absl::DataLossError("what the server sent is no recording");
  }
  origin_ = *reader->origin();
  end_unix_ns_ = origin_.start_unix_ns;
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const std::optional<recording::Recorded> event, reader->Next());
    if (!event.has_value()) return absl::OkStatus();
    ++events_;
    end_unix_ns_ = std::max(end_unix_ns_, event->time_unix_ns.value_or(0));
  }
}

void RecordingFile::Discard() {
  if (begun()) unlink(path_.c_str());
}

absl::Status RecordingFile::Sync() const {
  if (fsync(file_.get()) == 0) return absl::OkStatus();
  return absl::ErrnoToStatus(errno, absl::StrCat("cannot write `", path_, "`"));
}

}  // namespace rips::ripsctl

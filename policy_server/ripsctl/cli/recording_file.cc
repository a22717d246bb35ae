#include "policy_server/ripsctl/cli/recording_file.h"

#include <fcntl.h>
#include <sys/stat.h>
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
#include "policy_server/ripsctl/cli/command.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

absl::Status AlreadyThere(const std::string& path) {
  return absl::AlreadyExistsError(
      absl::StrCat("`", path, "` is there already; choose another file, or --force"));
}

absl::Status CannotWrite(const std::string& path) {
  return FileError(absl::ErrnoToStatus(errno, absl::StrCat("cannot write `", path, "`")));
}

}  // namespace

RecordingFile::~RecordingFile() {
  if (is_part_) Remove(part());
}

void RecordingFile::AddFlags(CLI::App& app) {
  app.add_option("--out", path_, "File to write")->required();
  app.add_flag("--force", force_, "Overwrite an existing file");
  app.add_option("--max-bytes", bytes_max_, "Maximum size of the file; what is longer is refused")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
}

absl::Status RecordingFile::Check() const {
  if (!force_ && access(path_.c_str(), F_OK) == 0) return AlreadyThere(path_);
  return absl::OkStatus();
}

absl::Status RecordingFile::Create(const std::string& path, bool replace) {
  file_ = UniqueFd(
      open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC | (replace ? O_TRUNC : O_EXCL), 0600));
  if (begun()) return absl::OkStatus();
  if (errno == EEXIST) return AlreadyThere(path);
  return CannotWrite(path);
}

void RecordingFile::Remove(const std::string& path) const {
  struct stat info {};
  // Not a device, a pipe or another file of that name.
  const bool ours = fstat(file_.get(), &info) == 0 && S_ISREG(info.st_mode);
  if (ours) unlink(path.c_str());
}

absl::Status RecordingFile::CreatePart() {
  struct stat info {};
  if (stat(path_.c_str(), &info) == 0 && !S_ISREG(info.st_mode)) {
    return absl::InternalError(absl::StrCat("`", path_, "` is not a regular file"));
  }
  unlink(part().c_str());  // what an earlier run left
  RIPS_RETURN_IF_ERROR(Create(part(), /*replace=*/false));
  is_part_ = true;
  return absl::OkStatus();
}

absl::Status RecordingFile::Append(absl::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t written = write(file_.get(), bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) return CannotWrite(path_);
    bytes.remove_prefix(static_cast<size_t>(written));
  }
  return absl::OkStatus();
}

absl::Status RecordingFile::MaxReached() const {
  return absl::ResourceExhaustedError(
      absl::StrCat("the recording exceeds --max-bytes ", bytes_max_));
}

absl::Status RecordingFile::Kept(const absl::Status& what, off_t bytes) const {
  // A frame that is cut must not stand at the end of a recording.
  const bool whole = ftruncate(file_.get(), bytes) == 0;
  return absl::InternalError(absl::StrCat(what.message(), "; `", path_, "` holds the ", events_,
                                          " events before that",
                                          whole ? "" : ", the last of them cut"));
}

absl::Status RecordingFile::Write(grpc::ClientReaderInterface<v1::Recording>& reader,
                                  ServerExpiry& expiry) {
  v1::Recording piece;
  if (!reader.Read(&piece)) return absl::OkStatus();
  expiry.Received();
  if (!piece.has_header()) return absl::InternalError("the server sent no header");
  origin_ = recording::DecodeHeader(piece.header());
  end_unix_ns_ = origin_.start_unix_ns;
  RIPS_RETURN_IF_ERROR(Create(path_, force_));
  absl::StatusOr<recording::RipsWriter> writer =
      recording::RipsWriter::Create(file_.get(), origin_);
  if (!writer.ok()) {
    Remove(path_);
    return FileError(writer.status());
  }
  off_t bytes = lseek(file_.get(), 0, SEEK_CUR);
  while (reader.Read(&piece)) {
    const absl::StatusOr<recording::Recorded> event = recording::DecodeEvent(piece.event());
    if (!event.ok()) return Kept(event.status(), bytes);
    if (const absl::Status status = writer->Append(*event); !status.ok()) {
      return Kept(status, bytes);
    }
    const off_t end = lseek(file_.get(), 0, SEEK_CUR);
    if (end > 0 && static_cast<uint64_t>(end) > bytes_max_) return Kept(MaxReached(), bytes);
    bytes = end;
    ++events_;
    end_unix_ns_ = std::max(end_unix_ns_, event->time_unix_ns.value_or(0));
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
      RIPS_RETURN_IF_ERROR(CreatePart());
    }
    bytes += piece.data().size();
    if (std::max<uint64_t>(bytes, piece.file_bytes()) > bytes_max_) return MaxReached();
    RIPS_RETURN_IF_ERROR(Append(piece.data()));
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
                        recording::OpenFile(is_part_ ? part() : path_));
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

absl::Status RecordingFile::Finish() {
  if (!begun()) return absl::OkStatus();
  // A pipe or a device cannot be synced.
  if (fsync(file_.get()) != 0 && errno != EINVAL) return CannotWrite(path_);
  if (!is_part_) return absl::OkStatus();
  // A hard link does not replace what came there meanwhile; some file systems have none.
  if (!force_ && link(part().c_str(), path_.c_str()) == 0) return absl::OkStatus();
  if (!force_ && errno == EEXIST) return AlreadyThere(path_);
  if (rename(part().c_str(), path_.c_str()) != 0) return CannotWrite(path_);
  is_part_ = false;
  return absl::OkStatus();
}

}  // namespace rips::ripsctl

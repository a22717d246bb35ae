// A recording that a server sends, on its way into a file for `rules replay`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_RECORDING_FILE_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_RECORDING_FILE_H_

#include <sys/types.h>

#include <CLI/CLI.hpp>
#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "grpcpp/support/sync_stream.h"
#include "policy_server/policy/recording/recorded.h"
#include "policy_server/ripsctl/cli/server_expiry.h"
#include "rips/v1/operator.pb.h"
#include "rips/v1/recording.pb.h"
#include "services/runtime/unique_fd.h"

namespace rips::ripsctl {

// Not thread-safe.
class RecordingFile {
 public:
  // Of a file without --max-bytes: a server must not fill the operator's disk.
  static constexpr uint64_t kBytesMax = uint64_t{4} << 30;

  RecordingFile() = default;
  // Removes what is not whole.
  ~RecordingFile();
  RecordingFile(const RecordingFile&) = delete;
  RecordingFile& operator=(const RecordingFile&) = delete;

  // --out, --force and --max-bytes.
  void AddFlags(CLI::App& app);
  // AlreadyExists: the file is there, and may not be replaced.
  absl::Status Check() const;
  // Until the server ends the call. Makes the file once the server has begun, so that a refused
  // recording leaves none. OK with begun() false: it sent nothing, and the status of the call says
  // why. After an error the file holds the events before it, none of them cut, and the error says
  // so: the disk is full, for example, or --max-bytes is reached.
  absl::Status Write(grpc::ClientReaderInterface<v1::Recording>& reader, ServerExpiry& expiry);
  // The same of a recording that comes as a file: DataLoss unless all of it came, and is whole. It
  // is beside the file's place, as `FILE.part`, until Finish.
  absl::Status Write(grpc::ClientReaderInterface<v1::FilePiece>& reader, ServerExpiry& expiry);
  // On the disk, and in its place, when it returns OK.
  absl::Status Finish();

  bool begun() const { return file_.get() >= 0; }
  const std::string& path() const { return path_; }
  const recording::RecordedOrigin& origin() const { return origin_; }
  uint64_t events() const { return events_; }
  // Of the events, nanoseconds since the Unix epoch; that of the start if there is none.
  int64_t end_unix_ns() const { return end_unix_ns_; }

 private:
  absl::Status Create(const std::string& path, bool replace);
  absl::Status CreatePart();
  void Remove(const std::string& path) const;
  absl::Status Append(absl::string_view bytes);
  // `what` came to nothing, after `bytes` bytes of whole events.
  absl::Status Kept(const absl::Status& what, off_t bytes) const;
  absl::Status MaxReached() const;
  // Reads what was written.
  absl::Status Verify();
  std::string part() const { return path_ + ".part"; }

  std::string path_;
  bool force_ = false;
  uint64_t bytes_max_ = kBytesMax;
  bool is_part_ = false;  // part() is the file, and is removed unless Finish takes it away
  UniqueFd file_;
  recording::RecordedOrigin origin_;
  uint64_t events_ = 0;
  int64_t end_unix_ns_ = 0;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_RECORDING_FILE_H_

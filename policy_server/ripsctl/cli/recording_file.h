// A recording that a server sends, on its way into a file for `rules replay`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_RECORDING_FILE_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_RECORDING_FILE_H_

#include <CLI/CLI.hpp>
#include <cstdint>
#include <string>

#include "absl/status/status.h"
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
  // --out and --force.
  void AddFlags(CLI::App& app);
  // AlreadyExists: the file is there, and may not be replaced.
  absl::Status Check() const;
  // Until the server ends the call. Makes the file once the server has begun, so that a refused
  // recording leaves none. OK with begun() false: it sent nothing, and the status of the call says
  // why.
  absl::Status Write(grpc::ClientReaderInterface<v1::Recording>& reader, ServerExpiry& expiry);
  // The same of a recording that comes as a file: DataLoss unless all of it came, and is whole.
  absl::Status Write(grpc::ClientReaderInterface<v1::FilePiece>& reader, ServerExpiry& expiry);
  // On the disk when it returns OK.
  absl::Status Sync() const;
  // What came is not whole: no one must take it for a recording.
  void Discard();

  bool begun() const { return file_.get() >= 0; }
  const std::string& path() const { return path_; }
  const recording::RecordedOrigin& origin() const { return origin_; }
  uint64_t events() const { return events_; }
  // Of the events, nanoseconds since the Unix epoch; that of the start if there is none.
  int64_t end_unix_ns() const { return end_unix_ns_; }

 private:
  // Reads what was written.
  absl::Status Verify();

  std::string path_;
  bool force_ = false;
  UniqueFd file_;
  recording::RecordedOrigin origin_;
  uint64_t events_ = 0;
  int64_t end_unix_ns_ = 0;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_RECORDING_FILE_H_

// Where the files of a policy are.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_FILE_SOURCE_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_FILE_SOURCE_H_

#include <cstddef>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::inspect {

// Paths are those of lang::Inspection.
class FileSource {
 public:
  virtual ~FileSource() = default;
  // The whole file. NotFound, PermissionDenied, Unavailable: not to be had; ResourceExhausted: more
  // than `bytes_max` bytes; other codes: not what it should be. Messages name the file.
  virtual absl::StatusOr<std::string> Read(absl::string_view path, size_t bytes_max) const = 0;
  // Absolute path of the program of `plugin`, which need not exist. It is looked at by
  // CheckedFiles and executed, so it stays what it is as long as the inspection is used.
  virtual absl::StatusOr<std::string> ProgramPath(const lang::Inspection& plugin) const = 0;
  // The directory that the program at `path` may read, with all below; empty: its own.
  virtual std::string ReadableRoot(absl::string_view /*path*/) const { return ""; }
};

// Paths as they are, relative ones from the working directory of the process.
class DiskFiles final : public FileSource {
 public:
  absl::StatusOr<std::string> Read(absl::string_view path, size_t bytes_max) const override;
  absl::StatusOr<std::string> ProgramPath(const lang::Inspection& plugin) const override;
  // Where the rule file is: the directory above `plugins`.
  std::string ReadableRoot(absl::string_view path) const override;
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_FILE_SOURCE_H_

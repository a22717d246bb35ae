// Checks the files that rules name for inspections, and keeps what it compiled for those who load
// them afterwards: what was checked is what is used.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_CHECKED_FILES_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_CHECKED_FILES_H_

#include <memory>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/inspect/file_source.h"
#include "policy_server/policy/inspect/yara_rules.h"
#include "policy_server/policy/lang/inspection_files.h"

namespace rips::inspect {

// Not thread-safe. Each YARA file is read and compiled once, however often it is asked about.
class CheckedFiles final : public lang::InspectionFiles {
 public:
  // `source` is not owned and outlives this.
  explicit CheckedFiles(const FileSource* source) : source_(source) {}

  // kPayload: as YaraRules::Compile. kPlugin: it must be a regular file that we may execute, and
  // so must be the interpreter that its first line may name; nothing is run.
  std::vector<lang::InspectionProblem> Check(const lang::Inspection& inspection) override;

  // The rules of a kPayload inspection, checked now if they were not before. InvalidArgument with
  // every problem.
  absl::StatusOr<std::shared_ptr<const YaraRules>> Rules(const lang::Inspection& inspection);
  // The program of a kPlugin inspection; it is looked at anew. InvalidArgument with every problem.
  absl::StatusOr<std::string> Program(const lang::Inspection& inspection);
  // As FileSource::ReadableRoot.
  std::string ReadableRoot(absl::string_view program) const {
    return source_->ReadableRoot(program);
  }

 private:
  const YaraCompiled& Compiled(const std::string& path);

  const FileSource* const source_;  // Not owned; outlives this.
  absl::btree_map<std::string, YaraCompiled> compiled_;
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_CHECKED_FILES_H_

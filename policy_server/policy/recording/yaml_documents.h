// Cuts a YAML stream into its documents. Internal to this folder.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_DOCUMENTS_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_DOCUMENTS_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/status/statusor.h"
#include "policy_server/policy/recording/input_file.h"

namespace rips::recording {

struct YamlDocument {
  // With its `---` line, if it has one.
  std::string text;
  // 1-based.
  uint64_t first_line = 0;
};

// Not thread-safe.
class YamlDocuments {
 public:
  explicit YamlDocuments(std::unique_ptr<InputFile> file) : file_(std::move(file)) {}

  // The next document that holds more than comments; nullopt at the end. DataLoss: the last one is
  // cut: not ended, after one that was ended by `...`, or in the middle of a line. InvalidArgument:
  // a byte 0. ResourceExhausted: longer than kYamlDocumentBytesMax. Messages start with the line.
  absl::StatusOr<std::optional<YamlDocument>> Next();

  const std::string& path() const { return file_->path(); }

 private:
  // False at the end.
  absl::StatusOr<bool> NextLine();
  absl::StatusOr<std::optional<YamlDocument>> Finish(YamlDocument document) const;

  const std::unique_ptr<InputFile> file_;
  uint64_t line_number_ = 0;
  std::string line_;
  // line_ starts the next document.
  bool held_ = false;
  bool ended_by_dots_ = false;
};

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_DOCUMENTS_H_

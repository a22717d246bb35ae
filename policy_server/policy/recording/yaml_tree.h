// One YAML document as a tree. Internal to this folder.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_TREE_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_TREE_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::recording {

// Inclusive, for one document.
inline constexpr size_t kYamlDepthMax = 16;
inline constexpr size_t kYamlNodesMax = 262'144;
// Keys of one mapping.
inline constexpr size_t kYamlKeysMax = 256;

struct YamlNode {
  enum class Kind { kNull, kScalar, kList, kMap };

  // Null if this is no mapping, there is no such key, or its value is null.
  const YamlNode* Find(absl::string_view wanted) const;

  Kind kind = Kind::kNull;
  // 1-based, in the file.
  uint64_t line = 0;
  // Of a value in a mapping; unique there.
  std::string key;
  std::string text;             // kScalar
  std::vector<YamlNode> items;  // kList, kMap: in order of the text
};

// Of an error at a line: "line 12: what".
absl::Status AtLine(absl::StatusCode code, uint64_t line, absl::string_view what);

// Parses the one document in `text`, whose first line is `first_line` of the file. Tags are
// ignored. InvalidArgument: not YAML, an alias or anchor, a key twice or not a text.
// ResourceExhausted: past a limit above.
absl::StatusOr<YamlNode> ParseYaml(const std::string& text, uint64_t first_line);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_TREE_H_

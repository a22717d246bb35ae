// What a bundle says of itself: manifest.yaml.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_MANIFEST_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_MANIFEST_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/policy/engine/interest/interest.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::bundle {

// Rule files of one bundle.
inline constexpr size_t kRuleFilesMax = 256;
// YARA files of one bundle, and plugins of one bundle.
inline constexpr size_t kInspectionFilesMax = 256;

struct ManifestPlugin {
  std::string id;
  // Of the program, inside the bundle.
  std::string path;
  // Of the program: 64 lower-case hex digits.
  std::string sha256;
};

struct Manifest {
  // A name as in IsValidName; equal to the directory's.
  std::string name;
  // Paths inside the bundle, compiled as one program, in this order; distinct.
  std::vector<std::string> rules;
  // Least restrictive first; must equal what the rule files declare.
  std::vector<std::string> levels;
  // One of `levels`; default: the first.
  std::string start_level;
  lang::CheckedRules::Dialect dialect = lang::CheckedRules::Dialect::kRips;
  // Of `levels`, neither the first nor soft: an operator lowers them only if a second one approves.
  std::vector<std::string> two_person;
  // How long the evidence must have been complete before a rule may lower a soft level; 500 ms to
  // 1 h.
  absl::Duration soft_hold = absl::Seconds(5);
  // YARA files that `payload` may name; paths inside the bundle, distinct.
  std::vector<std::string> yara;
  // Plugins that `plugin` may name; ids are distinct.
  std::vector<ManifestPlugin> plugins;
  // Bytes of payloads that inspections look at, by topic; kPayloadBytesLeast to kPayloadBytesHard.
  engine::PayloadLimits payload_limits;
  // What becomes of a rule whose value depends on an inspection that was not told.
  engine::OnInspectionError on_inspection_error = engine::OnInspectionError::kMatch;
};

// InvalidArgument with every problem and its place. Known, but refused unless empty, because this
// version would not keep what it promises: scope.
absl::StatusOr<Manifest> ParseManifest(absl::string_view file, absl::string_view text);

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_MANIFEST_H_

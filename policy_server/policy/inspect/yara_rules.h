// A YARA file, compiled once and shared by all threads that scan with it.
//
// Only the language of YARA 4.2 itself: no `include` (one file is one policy file, reviewed and
// hashed as such), no `import` (modules parse the payload, which is hostile, in C), no external
// variables.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_YARA_RULES_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_YARA_RULES_H_

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/inspection_files.h"

struct YR_RULES;

namespace rips::inspect {

inline constexpr size_t kYaraFileBytesMax = size_t{1} << 20;
// Problems reported of one file; one more says how many were left out.
inline constexpr size_t kYaraProblemsMax = 50;

struct YaraCompiled;

// Immutable; any thread.
class YaraRules {
 public:
  // Total: any bytes in, rules or at least one problem out. `name` starts each problem's message:
  // `name:LINE: libyara's text`. Errors are kBroken; so are a file over kYaraFileBytesMax, a NUL
  // byte, `include`, `import` and a file in which no rule can match (none, or private ones only).
  // libyara's warnings are kSlow, and so is a file that fails CheckSpeed (yara_speed.h).
  static YaraCompiled Compile(absl::string_view text, absl::string_view name);
  // As Compile; InvalidArgument with every problem on a line of its own.
  static absl::StatusOr<std::shared_ptr<const YaraRules>> Create(absl::string_view text,
                                                                 absl::string_view name);
  // Makes libyara ready, which the functions here do by themselves. Internal: it cannot be.
  static absl::Status Prepare();
  // What Serialize gave, of the same libyara: it is not checked, so of trusted origin only.
  // InvalidArgument if libyara does not take it.
  static absl::StatusOr<std::shared_ptr<const YaraRules>> Load(absl::string_view compiled);
  ~YaraRules();
  YaraRules(const YaraRules&) = delete;
  YaraRules& operator=(const YaraRules&) = delete;

  // For Load, in another process. Not while anybody scans with these rules: libyara changes them
  // and changes them back. Internal: libyara refuses, or memory is short.
  absl::StatusOr<std::string> Serialize() const;

  // For yr_scanner_create, which takes it unchanged. Valid as long as this.
  YR_RULES* raw() const { return rules_; }

 private:
  explicit YaraRules(YR_RULES* rules) : rules_(rules) {}

  YR_RULES* const rules_;
};

struct YaraCompiled {
  // nullptr if there is a problem.
  std::shared_ptr<const YaraRules> rules;
  std::vector<lang::InspectionProblem> problems;
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_YARA_RULES_H_

// What a rule file may grow to. Beyond each is an error that names the limit.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_LIMITS_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_LIMITS_H_

#include <cstddef>
#include <cstdint>

namespace rips::lang {

inline constexpr size_t kFileBytesMax = size_t{1} << 20;
inline constexpr size_t kIdentifierBytesMax = 255;
inline constexpr size_t kStringCodePointsMax = 4096;
// Parentheses, prefix operators and call arguments around one another; bounds recursion.
inline constexpr int kNestingMax = 256;
// Operators and operands of all files together; bounds what one event can cost.
inline constexpr size_t kProgramNodesMax = 500'000;
// Depth of a checked expression: a run such as `a - b - c` nests to the left when it is
// evaluated, so this bounds recursion for runs that `kNestingMax` calls flat.
inline constexpr int kExpressionDepthMax = 4096;
// Memory that RE2 may take for one pattern.
inline constexpr int64_t kRegexBytesMax = int64_t{1} << 20;
// Size of the compiled patterns of all `topicmatches` together; bounds the time to load a policy.
inline constexpr size_t kRegexInstructionsMax = 1'000'000;
// Longest time that `msgcount` and `sendercount` look back: an hour.
inline constexpr int64_t kWindowMsMax = 3'600'000;
// Distinct YARA files and plugins.
inline constexpr size_t kInspectionsMax = 256;
inline constexpr size_t kPluginIdBytesMax = 64;
inline constexpr size_t kLevelsMax = 64;
inline constexpr size_t kVariablesMax = 1000;
inline constexpr size_t kRulesMax = 10'000;
// Of each severity, in one file.
inline constexpr size_t kDiagnosticsMax = 50;

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_LIMITS_H_

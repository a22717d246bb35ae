// Finds YARA files that some payload makes slow. libyara's own warnings are about short strings;
// they miss patterns such as /a.{0,500}b.{0,500}c/, which cost half a second on 64 KiB of `a`.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_YARA_SPEED_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_YARA_SPEED_H_

#include <cstddef>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/policy/inspect/yara_rules.h"

namespace rips::inspect {

// Bytes of the largest trial, and the CPU time of this thread that is too much for a trial: it is
// scanned up to three times, and is too slow if each scan takes longer. Ordinary rules take less
// than a hundredth of it.
inline constexpr size_t kTrialBytes = size_t{16} << 10;
#ifdef RIPS_SANITIZED  // memory costs some ten times as much
inline constexpr int kTrialCostFactor = 10;
#else
inline constexpr int kTrialCostFactor = 1;
#endif
inline constexpr absl::Duration kTrialCpuMax = absl::Milliseconds(25 * kTrialCostFactor);
// All trials of one file together.
inline constexpr absl::Duration kTrialsCpuMax = absl::Seconds(2 * kTrialCostFactor);

// Scans runs of each byte value and pseudo-random bytes, first a little, then four times as much,
// and so on, so that a file whose cost grows with the square is refused within about a second; then
// repetitions of what stands in `text`, the file itself, which is what makes libyara try a pattern.
// ResourceExhausted, naming the trial, if one is too dear or fails. No proof: a payload made for
// the rules may cost more (see YaraScanner::Scan).
absl::Status CheckSpeed(const YaraRules& rules, absl::string_view text);

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_YARA_SPEED_H_

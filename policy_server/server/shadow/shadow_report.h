// What a policy that runs muted would have done: as ShadowReport of rips/v1/operator.proto.
#ifndef RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_REPORT_H_
#define RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_REPORT_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "policy_server/server/robot/model/judged_event.h"

namespace rips::shadow {

using ShadowCounts = pipeline::RuleCounts;

// Rules of a report.
inline constexpr size_t kRulesMax = 100;
// Examples that are kept: the first ones, and the newest ones.
inline constexpr size_t kFirstExamples = 8;
inline constexpr size_t kNewestExamples = 8;
// Of each text of an example, and of a problem, bytes.
inline constexpr size_t kTextBytesMax = 200;

struct ShadowRule {
  std::string rule;
  uint64_t fired = 0;
  uint64_t unscanned = 0;
  uint64_t undecidable = 0;

  friend bool operator==(const ShadowRule&, const ShadowRule&) = default;
};

struct ShadowExample {
  int64_t time_unix_ns = 0;
  std::string rule;
  // alert | raise | lowering | refusal | program | fault
  std::string kind;
  // Hostile text: escape before display.
  std::string text;

  friend bool operator==(const ShadowExample&, const ShadowExample&) = default;
};

struct ShadowReport {
  std::string bundle_id;
  std::string name;
  std::string operator_name;
  std::string reason;
  int64_t began_unix_ns = 0;
  // That it was given, and those that it was not because its queue was full.
  uint64_t events = 0;
  uint64_t missed = 0;
  // Why it does not run any more; empty = it does.
  std::string problem;
  // Names; empty until the robot has said where it begins.
  std::string level;
  std::string live_level;
  ShadowCounts would;
  // Of the policy in force, until the shadow ended.
  ShadowCounts live;
  // Of rules that fired or could not be evaluated, those that fired most first; at most kRulesMax.
  std::vector<ShadowRule> rules;
  // In the order of time.
  std::vector<ShadowExample> examples;
};

}  // namespace rips::shadow

#endif  // RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_REPORT_H_

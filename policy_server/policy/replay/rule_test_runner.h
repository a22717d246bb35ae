// Runs unit tests of rules.
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_TEST_RUNNER_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_TEST_RUNNER_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/policy/replay/rule_set.h"
#include "policy_server/policy/replay/rule_test_file.h"

namespace rips::replay {

// Something that came out otherwise than expected.
struct TestFailure {
  // Of the expectation, 1-based.
  int line = 0;
  // "alerts", "level", "variable `x`", ...; with "at the end" for those of the whole test.
  std::string what;
  // One line an entry; "(none)" for an empty list.
  std::vector<std::string> expected;
  std::vector<std::string> got;
  // What else may explain it; empty: nothing.
  std::string note;
};

struct TestOutcome {
  std::string name;
  int line = 0;
  std::vector<TestFailure> failures;
  // Rules that an inspection could not tell, and of which no `unscanned` says that they should, in
  // file order.
  std::vector<std::string> unscanned;

  bool passed() const { return failures.empty(); }
};

struct FileOutcome {
  std::vector<TestOutcome> tests;
  // Rules that fired in none of the tests, in file order; without those that never fire
  // (rule_facts.h).
  std::vector<std::string> not_exercised;
};

// `rules` are those that the file names, and were not refused. InvalidArgument with every name and
// value in the file that the rules do not have, and its line.
absl::StatusOr<FileOutcome> RunRuleTests(const RuleTestFile& file, const RuleSet& rules);

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_TEST_RUNNER_H_

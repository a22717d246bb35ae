// Trees to checked rules: names, types, event classes, levels, and what the whole program does.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_CHECK_CHECKER_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_CHECK_CHECKER_H_

#include <string>
#include <vector>

#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/policy/lang/diagnostic/diagnostic_sink.h"
#include "policy_server/policy/lang/inspection_files.h"
#include "policy_server/policy/lang/syntax/ast.h"

namespace rips::lang {

// Whether every file was read without an error. If not, the checker still looks for mistakes, but
// not for those that the unread parts may explain.
enum class Syntax { kClean, kBroken };

struct CheckInput {
  // One program, in this order, and what the files are called.
  const std::vector<ast::File>& files;
  const std::vector<std::string>& paths;
  CheckedRules::Dialect dialect = CheckedRules::Dialect::kRips;
  Syntax syntax = Syntax::kClean;
  // Not owned. Null: YARA files and plugins that rules name are not looked at.
  InspectionFiles* inspection_files = nullptr;
};

// The result is meaningful if neither `input.syntax` nor `sink` knows of an error.
CheckedRules Check(const CheckInput& input, DiagnosticSink& sink);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_CHECK_CHECKER_H_

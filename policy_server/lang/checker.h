// Trees to checked rules: names, types, event classes, levels, and what the whole program does.
#ifndef RIPS_POLICY_SERVER_LANG_CHECKER_H_
#define RIPS_POLICY_SERVER_LANG_CHECKER_H_

#include <vector>

#include "policy_server/lang/ast.h"
#include "policy_server/lang/checked_rules.h"
#include "policy_server/lang/diagnostic_sink.h"

namespace rips::lang {

// Whether every file was read without an error. If not, the checker still looks for mistakes, but
// not for those that the unread parts may explain.
enum class Syntax { kClean, kBroken };

// The files are one program, in this order. The result is meaningful if neither `syntax` nor
// `sink` knows of an error.
CheckedRules Check(const std::vector<ast::File>& files, CheckedRules::Dialect dialect,
                   Syntax syntax, DiagnosticSink& sink);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_LANG_CHECKER_H_

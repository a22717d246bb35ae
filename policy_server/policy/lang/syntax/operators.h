// The operators of the rule language: their tokens, spelling and precedence.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_OPERATORS_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_OPERATORS_H_

#include <optional>

#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/policy/lang/syntax/token.h"

namespace rips::lang {

// Between two operands; none if it is no such operator.
std::optional<BinaryOp> BinaryOpOf(TokenKind kind);
// Before an operand.
std::optional<UnaryOp> UnaryOpOf(TokenKind kind);
// Between two actions: `=>` and `→`, `!>` and `↛`, `,`; anything else ends a chain.
Connector ConnectorOf(TokenKind kind);

// From 1 (`||`) to 9 (`* / %`), RIPS paper's operators in C's order.
int Precedence(BinaryOp op);
absl::string_view Spelling(BinaryOp op);
absl::string_view Spelling(UnaryOp op);
// `=>`, `!>`, `,`; empty for kEnd.
absl::string_view Spelling(Connector connector);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_OPERATORS_H_

// What a token means where an operator may stand.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_TOKEN_OPERATOR_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_TOKEN_OPERATOR_H_

#include <optional>

#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/policy/lang/syntax/token.h"

namespace rips::lang {

// Between two operands; none if it is no such operator.
std::optional<BinaryOp> BinaryOpOf(TokenKind kind);
// Before an operand.
std::optional<UnaryOp> UnaryOpOf(TokenKind kind);
// Between two actions: `=>` and `→`, `!>` and `↛`, `,`; anything else ends a chain.
Connector ConnectorOf(TokenKind kind);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_TOKEN_OPERATOR_H_

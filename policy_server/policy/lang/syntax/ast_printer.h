// A tree back to text.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_AST_PRINTER_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_AST_PRINTER_H_

#include <string>

#include "policy_server/policy/lang/syntax/ast.h"

namespace rips::lang {

// One canonical spelling (no comments, decimal integers, ASCII connectors, `L soft`), which parses
// to a tree that prints the same. `file` must come from a parse without errors.
std::string Print(const ast::File& file);

// The expression in its parentheses, if it had any.
std::string Print(const ast::Expr& expr);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_AST_PRINTER_H_

// Tokens to a tree.
//
//   program  := section*
//   section  := 'levels' ':' level*
//             | 'consts' ':' decl*
//             | 'vars' ':' decl*
//             | 'rules' ID ':' rule*
//   level    := ID 'soft'? ';' | 'soft' ID ';'
//   decl     := ID ID '=' expr ';'
//             | ID 'set' 'string' '=' '{' expr (',' expr)* '}' ';'
//   rule     := ((ID | STRING) ':')? expr '?' body
//   body     := chain ';' | '{' (chain ';')+ '}'
//   chain    := action (connector action)*
//   connector := '=>' | '→' | '!>' | '↛' | ','
//   action   := ID args
//   args     := '(' (expr (',' expr)* ','?)? ')'
//   expr     := binary operators by Precedence, all grouped to the left, over unary
//   unary    := ('+' | '-' | '!' | '~') unary | primary
//   primary  := INTEGER | FLOAT | STRING | 'true' | 'false' | ID args? | '(' expr ')'
//
// `set` and `string` are ordinary names. An expression nests at most kNestingMax deep.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_PARSER_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_PARSER_H_

#include <optional>
#include <vector>

#include "policy_server/policy/lang/diagnostic/diagnostic_sink.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/syntax/ast.h"
#include "policy_server/policy/lang/syntax/token.h"

namespace rips::lang {

// `tokens` come from Lex(source). Every token becomes part of the tree or has an error in `sink`
// (kError tokens had theirs from the lexer): after a mistake parsing goes on at the next `;`, `}`
// or section, so that one run finds all mistakes.
ast::File Parse(const Source& source, const std::vector<Token>& tokens, DiagnosticSink& sink);

// The text is one expression; none, and reported, if it is not.
std::optional<ast::Expr> ParseExpression(const Source& source, const std::vector<Token>& tokens,
                                         DiagnosticSink& sink);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_PARSER_H_

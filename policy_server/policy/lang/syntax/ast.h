// What the parser makes of a file: as written, before names and types mean anything.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_AST_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_AST_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "policy_server/policy/lang/checked_rules.h"

namespace rips::lang::ast {

struct Name {
  std::string text;
  SourceRange range;
};

struct Expr {
  enum class Kind { kInteger, kFloat, kBool, kString, kName, kUnary, kRun, kCall };
  struct Operator {
    BinaryOp op;
    SourceRange range;
  };

  Kind kind = Kind::kBool;
  // Of the whole, without enclosing parentheses.
  SourceRange range;
  // Stands in parentheses of its own.
  bool parenthesized = false;
  uint64_t integer = 0;  // kInteger: magnitude; 2^63 only as the operand of a minus
  double floating = 0;   // kFloat
  bool boolean = false;  // kBool
  std::string text;      // kString: the value; kName, kCall: the name
  SourceRange name;      // kCall: where the name stands
  UnaryOp unary = UnaryOp::kPlus;
  // kUnary: one; kCall: the arguments; kRun: operands[0] operators[0] operands[1] ..., grouped to
  // the left. The operators of a run have one precedence.
  std::vector<Expr> operands;
  std::vector<Operator> operators;
};

struct LevelDecl {
  Name name;
  bool soft = false;
};

struct Decl {
  Name name;
  // `ID set string = {...}`
  bool is_set = false;
  // The name is known but the rest is not: uses of the name are not mistakes.
  bool broken = false;
  Name type;
  // The initialiser, or the members of a set.
  std::vector<Expr> values;
};

struct Action {
  Name name;
  std::vector<Expr> args;
  Connector next = Connector::kEnd;
  SourceRange range;
};

using Chain = std::vector<Action>;

struct Rule {
  std::optional<Name> name;
  // Absent when it could not be read; that has been reported.
  std::optional<Expr> condition;
  // Written with braces. Without them there is one chain.
  bool braces = false;
  std::vector<Chain> chains;
  SourceRange range;
};

struct Section {
  enum class Kind { kLevels, kConsts, kVars, kRules };
  Kind kind = Kind::kLevels;
  SourceRange keyword;
  Name event_type;  // kRules; empty when missing, which has been reported
  std::vector<LevelDecl> levels;
  std::vector<Decl> decls;  // kConsts, kVars
  std::vector<Rule> rules;
};

struct File {
  std::vector<Section> sections;
  // Tokens that became part of the tree. All but the end of the file, if there was no error.
  size_t understood = 0;
  // Expression nodes.
  size_t nodes = 0;
};

}  // namespace rips::lang::ast

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_AST_H_

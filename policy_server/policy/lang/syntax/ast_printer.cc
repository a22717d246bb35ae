#include "policy_server/policy/lang/syntax/ast_printer.h"

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/syntax/literal.h"
#include "policy_server/policy/lang/syntax/operators.h"
#include "policy_server/policy/lang/value_text.h"

namespace rips::lang {
namespace {

// Appends to one string, so that deep expressions cost no copies.
class Printer {
 public:
  void Print(const ast::Expr& expr) {
    if (expr.parenthesized) absl::StrAppend(&out_, "(");
    PrintBare(expr);
    if (expr.parenthesized) absl::StrAppend(&out_, ")");
  }

  void Print(const ast::Section& section) {
    switch (section.kind) {
      case ast::Section::Kind::kLevels:
        absl::StrAppend(&out_, "levels:\n");
        break;
      case ast::Section::Kind::kConsts:
        absl::StrAppend(&out_, "consts:\n");
        break;
      case ast::Section::Kind::kVars:
        absl::StrAppend(&out_, "vars:\n");
        break;
      case ast::Section::Kind::kRules:
        absl::StrAppend(&out_, "rules ", section.event_type.text, ":\n");
        break;
    }
    for (const ast::LevelDecl& level : section.levels) {
      absl::StrAppend(&out_, "  ", level.name.text, level.soft ? " soft;\n" : ";\n");
    }
    for (const ast::Decl& decl : section.decls) Print(decl);
    for (const ast::Rule& rule : section.rules) Print(rule);
  }

  std::string Take() { return std::move(out_); }

 private:
  void PrintBare(const ast::Expr& expr) {
    switch (expr.kind) {
      case ast::Expr::Kind::kInteger:
        absl::StrAppend(&out_, expr.integer);
        break;
      case ast::Expr::Kind::kFloat:
        PrintFloat(expr.floating);
        break;
      case ast::Expr::Kind::kBool:
        absl::StrAppend(&out_, expr.boolean ? "true" : "false");
        break;
      case ast::Expr::Kind::kString:
        absl::StrAppend(&out_, EncodeString(expr.text));
        break;
      case ast::Expr::Kind::kName:
        absl::StrAppend(&out_, expr.text);
        break;
      case ast::Expr::Kind::kUnary:
        absl::StrAppend(&out_, Spelling(expr.unary));
        Print(expr.operands[0]);
        break;
      case ast::Expr::Kind::kRun:
        Print(expr.operands[0]);
        for (size_t i = 0; i < expr.operators.size(); ++i) {
          absl::StrAppend(&out_, " ", Spelling(expr.operators[i].op), " ");
          Print(expr.operands[i + 1]);
        }
        break;
      case ast::Expr::Kind::kCall:
        absl::StrAppend(&out_, expr.text);
        PrintList("(", expr.operands, ")");
        break;
    }
  }

  // Never as an integer.
  void PrintFloat(double value) {
    const std::string text = FormatFloat(value);
    absl::StrAppend(&out_, text, text.find_first_of(".e") == std::string::npos ? ".0" : "");
  }

  void PrintList(absl::string_view open, const std::vector<ast::Expr>& list,
                 absl::string_view close) {
    absl::StrAppend(&out_, open);
    for (size_t i = 0; i < list.size(); ++i) {
      if (i > 0) absl::StrAppend(&out_, ", ");
      Print(list[i]);
    }
    absl::StrAppend(&out_, close);
  }

  void Print(const ast::Decl& decl) {
    absl::StrAppend(&out_, "  ", decl.name.text, decl.is_set ? " set " : " ", decl.type.text,
                    " = ");
    PrintList(decl.is_set ? "{" : "", decl.values, decl.is_set ? "};\n" : ";\n");
  }

  void Print(const ast::Rule& rule) {
    absl::StrAppend(&out_, "  ");
    if (rule.name) absl::StrAppend(&out_, EncodeString(rule.name->text), ": ");
    if (rule.condition) Print(*rule.condition);
    absl::StrAppend(&out_, " ?", rule.braces ? " {\n" : "\n");
    for (const ast::Chain& chain : rule.chains) {
      absl::StrAppend(&out_, "    ");
      for (const ast::Action& action : chain) {
        absl::StrAppend(&out_, action.name.text);
        PrintList("(", action.args, ")");
        if (action.next != Connector::kEnd) {
          absl::StrAppend(&out_, " ", Spelling(action.next), " ");
        }
      }
      absl::StrAppend(&out_, ";\n");
    }
    if (rule.braces) absl::StrAppend(&out_, "  }\n");
  }

  std::string out_;
};

}  // namespace

std::string Print(const ast::File& file) {
  Printer printer;
  for (const ast::Section& section : file.sections) printer.Print(section);
  return printer.Take();
}

std::string Print(const ast::Expr& expr) {
  Printer printer;
  printer.Print(expr);
  return printer.Take();
}

}  // namespace rips::lang

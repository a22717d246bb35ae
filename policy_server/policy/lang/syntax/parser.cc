#include "policy_server/policy/lang/syntax/parser.h"

#include <algorithm>
#include <string>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/syntax/foreign_syntax.h"
#include "policy_server/policy/lang/syntax/literal.h"
#include "policy_server/policy/lang/syntax/operators.h"
#include "services/text/nearest.h"
#include "services/text/quote.h"

namespace rips::lang {
namespace {

using ast::Expr;

bool StartsSection(TokenKind kind) {
  return kind == TokenKind::kLevels || kind == TokenKind::kConsts || kind == TokenKind::kVars ||
         kind == TokenKind::kRules;
}

// Counts one level of nesting while it lives.
class [[nodiscard]] NestingGuard {
 public:
  explicit NestingGuard(int& depth) : depth_(depth) { ++depth_; }
  ~NestingGuard() { --depth_; }
  NestingGuard(const NestingGuard&) = delete;
  NestingGuard& operator=(const NestingGuard&) = delete;

 private:
  int& depth_;
};

// One method per production. A method that returns false or nothing has reported why; the caller
// that owns a place to go on from skips to it.
class Parser {
 public:
  Parser(const Source& source, const std::vector<Token>& tokens, DiagnosticSink& sink)
      : source_(source), tokens_(tokens), sink_(sink) {}

  ast::File Run() {
    while (!At(TokenKind::kEndOfFile)) {
      if (StartsSection(Peek().kind)) {
        file_.sections.push_back(ParseSection());
        continue;
      }
      Unexpected("`levels`, `consts`, `vars` or `rules`",
                 NearestHint(TextOf(Peek()), {"levels", "consts", "vars", "rules"}));
      while (!AtSectionEnd()) ++at_;
    }
    return std::move(file_);
  }

  // The whole text as one expression.
  std::optional<Expr> RunExpression() {
    std::optional<Expr> out = ParseExpr();
    if (!out || At(TokenKind::kEndOfFile)) return out;
    Unexpected("the end of the expression");
    return std::nullopt;
  }

 private:
  // --- Tokens.
  const Token& Peek(size_t ahead = 0) const {
    return tokens_[std::min(at_ + ahead, tokens_.size() - 1)];
  }
  bool At(TokenKind kind) const { return Peek().kind == kind; }
  bool AtSectionEnd() const { return StartsSection(Peek().kind) || At(TokenKind::kEndOfFile); }
  SourceRange RangeOf(const Token& token) const {
    return {.file = source_.file(), .offset = token.offset, .length = token.length};
  }
  absl::string_view TextOf(const Token& token) const { return source_.Text(RangeOf(token)); }
  SourceRange RangeSince(uint32_t begin) const {
    const uint32_t end = at_ == 0 ? begin : tokens_[at_ - 1].end();
    return {.file = source_.file(), .offset = begin, .length = std::max(end, begin) - begin};
  }

  // The only way for a token to become part of the tree.
  const Token& Take() {
    ++file_.understood;
    return tokens_[at_++];
  }
  bool TakeIf(TokenKind kind) {
    if (!At(kind)) return false;
    Take();
    return true;
  }
  bool Expect(TokenKind kind, absl::string_view where, std::string hint = "") {
    if (TakeIf(kind)) return true;
    Unexpected(absl::StrCat(Describe(kind), where), std::move(hint));
    return false;
  }
  ast::Name TakeName() {
    const Token& token = Take();
    return {.text = std::string(TextOf(token)), .range = RangeOf(token)};
  }

  // Reports the token at hand. The lexer has reported kError tokens already.
  void Unexpected(absl::string_view expected, std::string hint = "") {
    if (At(TokenKind::kError) || aborted_) return;
    SourceRange range = RangeOf(Peek());
    std::string found = Describe(Peek().kind);
    if (At(TokenKind::kEndOfFile)) {
      range = {.file = source_.file(), .offset = at_ > 0 ? tokens_[at_ - 1].end() : range.offset};
    } else if (At(TokenKind::kIdentifier) || At(TokenKind::kInteger) || At(TokenKind::kFloat)) {
      found = Quote(TextOf(Peek()));
    }
    if (hint.empty()) hint = HintFor(expected);
    sink_.Add(DiagnosticKind::kSyntaxError, range,
              absl::StrCat("expected ", expected, ", found ", found), std::move(hint));
  }

  // What the author may have meant.
  std::string HintFor(absl::string_view expected) const {
    if (At(TokenKind::kEndOfFile) || at_ == 0) return "";
    const Token& token = Peek();
    const int line_before = source_.PositionOf(tokens_[at_ - 1].end()).line;
    if (absl::StartsWith(expected, "`;`") && !At(TokenKind::kSemicolon) &&
        source_.PositionOf(token.offset).line > line_before) {
      return absl::StrCat("is a `;` missing at the end of line ", line_before, "?");
    }
    if (absl::StartsWith(expected, "`?`") && At(TokenKind::kSemicolon)) {
      return "several chains of one rule stand in braces: `... ? { a(); b(); }`";
    }
    if (absl::StartsWith(expected, "`;` after the level") && At(TokenKind::kComma)) {
      return "each level ends with `;`";
    }
    absl::string_view hint = HabitHint(source_.text().substr(token.offset));
    const Token& before = tokens_[at_ - 1];
    // `not` and `if` look like names, so what follows them is the surprise.
    if (hint.empty() && before.kind == TokenKind::kIdentifier) hint = HabitHint(TextOf(before));
    return std::string(hint);
  }

  // Skips what is left of a statement: through the next `;`, or the `}` of its braces.
  void SkipStatement() {
    int braces = 0;
    while (!AtSectionEnd()) {
      const TokenKind kind = tokens_[at_++].kind;
      if (kind == TokenKind::kOpenBrace) ++braces;
      if (kind == TokenKind::kCloseBrace && --braces <= 0) {
        if (At(TokenKind::kSemicolon)) ++at_;
        return;
      }
      // A `}` right after belongs to braces that the mistake stands in.
      const bool ends = kind == TokenKind::kSemicolon && braces <= 0;
      if (ends && !At(TokenKind::kCloseBrace)) return;
    }
  }

  // --- Sections.
  ast::Section ParseSection() {
    ast::Section section;
    const Token& keyword = Take();
    section.keyword = RangeOf(keyword);
    const std::string after = absl::StrCat(" after ", Describe(keyword.kind));
    if (keyword.kind == TokenKind::kLevels) {
      section.kind = ast::Section::Kind::kLevels;
    } else if (keyword.kind == TokenKind::kConsts) {
      section.kind = ast::Section::Kind::kConsts;
    } else if (keyword.kind == TokenKind::kVars) {
      section.kind = ast::Section::Kind::kVars;
    } else {
      section.kind = ast::Section::Kind::kRules;
      if (At(TokenKind::kIdentifier)) {
        section.event_type = TakeName();
      } else {
        Unexpected("`Msg`, `Graph` or `External` after `rules`");
      }
    }
    const bool named =
        section.kind != ast::Section::Kind::kRules || !section.event_type.text.empty();
    if (named) {
      Expect(TokenKind::kColon, section.event_type.text.empty() ? after : " after the event type");
    } else {
      TakeIf(TokenKind::kColon);
    }
    while (!AtSectionEnd()) ParseItem(section);
    return section;
  }

  void ParseItem(ast::Section& section) {
    bool good = false;
    switch (section.kind) {
      case ast::Section::Kind::kLevels:
        good = ParseLevel(section.levels);
        break;
      case ast::Section::Kind::kConsts:
      case ast::Section::Kind::kVars:
        good = ParseDecl(section.decls);
        break;
      case ast::Section::Kind::kRules:
        good = ParseRule(section.rules);
        break;
    }
    if (!good) SkipStatement();
  }

  bool ParseLevel(std::vector<ast::LevelDecl>& out) {
    ast::LevelDecl level;
    level.soft = TakeIf(TokenKind::kSoft);
    if (!At(TokenKind::kIdentifier)) {
      Unexpected("the name of a level");
      return false;
    }
    level.name = TakeName();
    if (!level.soft) level.soft = TakeIf(TokenKind::kSoft);
    // Known even if what follows is wrong, so that its uses are not mistakes too.
    out.push_back(level);
    return Expect(TokenKind::kSemicolon, " after the level");
  }

  bool ParseDecl(std::vector<ast::Decl>& out) {
    if (!At(TokenKind::kIdentifier)) {
      Unexpected("a declaration like `name int = 0;`");
      return false;
    }
    ast::Decl decl;
    decl.name = TakeName();
    const bool good = ParseDeclTail(decl);
    decl.broken = !good;
    out.push_back(std::move(decl));
    return good;
  }

  bool ParseDeclTail(ast::Decl& decl) {
    if (At(TokenKind::kIdentifier) && TextOf(Peek()) == "set") {
      Take();
      decl.is_set = true;
    }
    if (!At(TokenKind::kIdentifier)) {
      Unexpected(decl.is_set ? "`string` after `set`"
                             : "a type (`int`, `float`, `bool`, `string`)");
      return false;
    }
    decl.type = TakeName();
    if (!Expect(TokenKind::kEqual, " after the type")) return false;
    if (!decl.is_set) {
      std::optional<Expr> value = ParseExpr();
      if (!value) return false;
      decl.values.push_back(std::move(*value));
      return Expect(TokenKind::kSemicolon, " after the declaration");
    }
    if (!Expect(TokenKind::kOpenBrace, " before the members of the set")) return false;
    do {
      std::optional<Expr> member = ParseExpr();
      if (!member) return false;
      decl.values.push_back(std::move(*member));
    } while (TakeIf(TokenKind::kComma));
    return Expect(TokenKind::kCloseBrace, " after the members of the set") &&
           Expect(TokenKind::kSemicolon, " after the declaration");
  }

  // --- Rules.
  bool ParseRule(std::vector<ast::Rule>& out) {
    ast::Rule rule;
    const uint32_t begin = Peek().offset;
    if (Peek(1).kind == TokenKind::kColon &&
        (At(TokenKind::kIdentifier) || At(TokenKind::kString))) {
      rule.name = TakeName();
      if (tokens_[at_ - 1].kind == TokenKind::kString) {
        rule.name->text = DecodeString(rule.name->text).value;
      }
      Take();
    }
    rule.condition = ParseExpr();
    if (!rule.condition && !SkipToBody()) return false;
    const bool good =
        Expect(TokenKind::kQuestion, " after the expression of a rule", HintForBadOperand()) &&
        ParseBody(rule);
    rule.range = RangeSince(begin);
    if (good) out.push_back(std::move(rule));
    return good;
  }

  // After a bad expression the actions can still be read, for their own mistakes.
  bool SkipToBody() {
    size_t ahead = at_;
    while (ahead < tokens_.size()) {
      const TokenKind kind = tokens_[ahead].kind;
      if (kind == TokenKind::kQuestion) {
        at_ = ahead;
        return true;
      }
      if (StartsSection(kind) || kind == TokenKind::kEndOfFile || kind == TokenKind::kSemicolon ||
          kind == TokenKind::kOpenBrace || kind == TokenKind::kCloseBrace) {
        return false;
      }
      ++ahead;
    }
    return false;
  }

  bool ParseBody(ast::Rule& rule) {
    rule.braces = TakeIf(TokenKind::kOpenBrace);
    if (!rule.braces) return ParseChain(rule.chains);
    if (At(TokenKind::kCloseBrace)) {
      Unexpected("an action", "a rule does at least one thing");
      return false;
    }
    while (!At(TokenKind::kCloseBrace)) {
      if (AtSectionEnd()) {
        Unexpected("`}` after the chains of a rule");
        return false;
      }
      if (!ParseChain(rule.chains)) SkipChain();
    }
    Take();
    return true;
  }

  // Skips through the next `;`, or up to the `}` of the rule.
  void SkipChain() {
    while (!AtSectionEnd() && !At(TokenKind::kCloseBrace)) {
      if (tokens_[at_++].kind == TokenKind::kSemicolon) return;
    }
  }

  bool ParseChain(std::vector<ast::Chain>& out) {
    ast::Chain chain;
    do {
      if (!ParseAction(chain)) return false;
      chain.back().next = ConnectorOf(Peek().kind);
      if (chain.back().next != Connector::kEnd) Take();
    } while (chain.back().next != Connector::kEnd);
    out.push_back(std::move(chain));
    return Expect(TokenKind::kSemicolon, " or a connector (`=>`, `!>`, `,`) after the action");
  }

  bool ParseAction(ast::Chain& chain) {
    if (!At(TokenKind::kIdentifier)) {
      Unexpected("an action");
      return false;
    }
    ast::Action action;
    const uint32_t begin = Peek().offset;
    action.name = TakeName();
    if (!ParseArgs(action.args, "an action")) return false;
    action.range = RangeSince(begin);
    chain.push_back(std::move(action));
    return true;
  }

  bool ParseArgs(std::vector<Expr>& out, absl::string_view owner) {
    if (!Expect(TokenKind::kOpenParen, absl::StrCat(" after the name of ", owner))) return false;
    while (!At(TokenKind::kCloseParen)) {
      std::optional<Expr> arg = ParseExpr();
      if (!arg) return false;
      out.push_back(std::move(*arg));
      if (!TakeIf(TokenKind::kComma)) break;
    }
    return Expect(TokenKind::kCloseParen, " or `,` after an argument");
  }

  // --- Expressions.
  std::optional<Expr> ParseExpr() { return ParseBinary(1); }

  std::optional<Expr> ParseBinary(int precedence_min) {
    const uint32_t begin = Peek().offset;
    std::optional<Expr> left = ParseUnary();
    while (left) {
      const std::optional<BinaryOp> op = BinaryOpOf(Peek().kind);
      if (!op || Precedence(*op) < precedence_min) return left;
      const SourceRange op_range = RangeOf(Take());
      std::optional<Expr> right = ParseBinary(Precedence(*op) + 1);
      if (!right || !Join(*left, {.op = *op, .range = op_range}, std::move(*right))) {
        return std::nullopt;
      }
      left->range = RangeSince(begin);
    }
    return std::nullopt;
  }

  // left := left op right, in one run where the precedence is the same.
  bool Join(Expr& left, Expr::Operator op, Expr right) {
    const bool extends = left.kind == Expr::Kind::kRun && !left.parenthesized &&
                         Precedence(left.operators[0].op) == Precedence(op.op);
    if (!extends) {
      if (!CountNode()) return false;
      Expr run;
      run.kind = Expr::Kind::kRun;
      run.operands.push_back(std::move(left));
      left = std::move(run);
    }
    left.operators.push_back(op);
    left.operands.push_back(std::move(right));
    return true;
  }

  std::optional<Expr> ParseUnary() {
    const std::optional<UnaryOp> op = UnaryOpOf(Peek().kind);
    if (!op) return ParsePrimary();
    const NestingGuard guard(nesting_);
    if (!CheckNesting() || !CountNode()) return std::nullopt;
    Expr out;
    out.kind = Expr::Kind::kUnary;
    out.unary = *op;
    const uint32_t begin = Take().offset;
    if (*op == UnaryOp::kMinus && At(TokenKind::kInteger)) {
      std::optional<Expr> integer = ParseInteger(kMinIntMagnitude);
      if (!integer) return std::nullopt;
      out.operands.push_back(std::move(*integer));
    } else {
      std::optional<Expr> operand = ParseUnary();
      if (!operand) return std::nullopt;
      out.operands.push_back(std::move(*operand));
    }
    out.range = RangeSince(begin);
    return out;
  }

  std::optional<Expr> ParsePrimary() {
    if (At(TokenKind::kInteger)) return ParseInteger(kMinIntMagnitude - 1);
    if (At(TokenKind::kIdentifier)) return ParseNameOrCall();
    if (At(TokenKind::kOpenParen)) return ParseParentheses();
    if (At(TokenKind::kFloat) || At(TokenKind::kString) || At(TokenKind::kTrue) ||
        At(TokenKind::kFalse)) {
      return ParseLiteral();
    }
    Unexpected("an expression", HintForBadOperand());
    return std::nullopt;
  }

  std::string HintForBadOperand() const {
    if (At(TokenKind::kEqual)) return "equality is written `==`";
    return "";
  }

  std::optional<Expr> ParseInteger(uint64_t magnitude_max) {
    if (!CountNode()) return std::nullopt;
    const Token& token = Take();
    Expr out;
    out.kind = Expr::Kind::kInteger;
    out.range = RangeOf(token);
    const IntegerValue value = DecodeInteger(TextOf(token));
    out.integer = value.magnitude;
    // The lexer knows no signs, so it lets 2^63 pass.
    if (!value.error && value.magnitude > magnitude_max) {
      sink_.Add(DiagnosticKind::kNumberOutOfRange, out.range,
                absl::StrCat("number ", Quote(TextOf(token)), " is out of range"),
                "integers have 64 bits, with a sign");
    }
    return out;
  }

  std::optional<Expr> ParseLiteral() {
    if (!CountNode()) return std::nullopt;
    const Token& token = Take();
    Expr out;
    out.range = RangeOf(token);
    if (token.kind == TokenKind::kFloat) {
      out.kind = Expr::Kind::kFloat;
      out.floating = DecodeFloat(TextOf(token)).value;
    } else if (token.kind == TokenKind::kString) {
      out.kind = Expr::Kind::kString;
      out.text = DecodeString(TextOf(token)).value;
    } else {
      out.kind = Expr::Kind::kBool;
      out.boolean = token.kind == TokenKind::kTrue;
    }
    return out;
  }

  std::optional<Expr> ParseNameOrCall() {
    if (!CountNode()) return std::nullopt;
    Expr out;
    ast::Name name = TakeName();
    out.text = std::move(name.text);
    out.name = name.range;
    out.range = name.range;
    out.kind = Expr::Kind::kName;
    if (!At(TokenKind::kOpenParen)) return out;
    out.kind = Expr::Kind::kCall;
    const NestingGuard guard(nesting_);
    if (!CheckNesting() || !ParseArgs(out.operands, "a builtin")) return std::nullopt;
    out.range = RangeSince(name.range.offset);
    return out;
  }

  std::optional<Expr> ParseParentheses() {
    const NestingGuard guard(nesting_);
    if (!CheckNesting()) return std::nullopt;
    Take();
    std::optional<Expr> out = ParseExpr();
    if (!out || !Expect(TokenKind::kCloseParen, " to close the parenthesis")) return std::nullopt;
    out->parenthesized = true;
    return out;
  }

  // Reports the token at hand as too deep.
  bool CheckNesting() {
    if (nesting_ <= kNestingMax) return true;
    sink_.Add(DiagnosticKind::kNestingTooDeep, RangeOf(Peek()),
              absl::StrCat("nesting depth ", nesting_, " exceeds limit ", kNestingMax));
    return false;
  }

  // Gives up the whole file when it is too large: what follows would not fit either.
  bool CountNode() {
    if (++file_.nodes <= kProgramNodesMax) return true;
    if (!aborted_) {
      sink_.Add(DiagnosticKind::kProgramTooLarge, RangeOf(Peek()),
                absl::StrCat("more than ", kProgramNodesMax, " operators and operands"),
                "split the policy");
    }
    aborted_ = true;
    at_ = tokens_.size() - 1;
    return false;
  }

  const Source& source_;
  const std::vector<Token>& tokens_;
  DiagnosticSink& sink_;
  ast::File file_;
  size_t at_ = 0;
  int nesting_ = 0;
  bool aborted_ = false;
};

}  // namespace

ast::File Parse(const Source& source, const std::vector<Token>& tokens, DiagnosticSink& sink) {
  return Parser(source, tokens, sink).Run();
}

std::optional<ast::Expr> ParseExpression(const Source& source, const std::vector<Token>& tokens,
                                         DiagnosticSink& sink) {
  return Parser(source, tokens, sink).RunExpression();
}

}  // namespace rips::lang

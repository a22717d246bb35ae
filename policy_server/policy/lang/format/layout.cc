#include "policy_server/policy/lang/format/layout.h"

#include <algorithm>
#include <cstddef>
#include <span>
#include <utility>

#include "policy_server/policy/lang/format/break_span.h"
#include "policy_server/policy/lang/format/line_writer.h"
#include "policy_server/policy/lang/format/trivia.h"
#include "policy_server/policy/lang/syntax/operators.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

constexpr int kIndent = 2;
// Of what a declaration could not hold on its line.
constexpr int kContinuation = 4;
// The members of a list stand under the first one up to this column, else indented on the next
// line.
constexpr int kListColumnMax = 40;

bool StartsSection(TokenKind kind) {
  return kind == TokenKind::kLevels || kind == TokenKind::kConsts || kind == TokenKind::kVars ||
         kind == TokenKind::kRules;
}

struct Chain {
  std::vector<Piece> actions;

  size_t first() const { return actions.front().first; }
  size_t semicolon() const { return actions.back().last + 1; }
};

struct Rule {
  size_t first = 0;
  bool named = false;
  Piece condition;
  bool braces = false;
  std::vector<Chain> chains;
  size_t last = 0;

  size_t question() const { return condition.last + 1; }
};

// Reads one item of a section after the other and writes it. A token's index names it; `indent` is
// where lines start that break inside what is being written.
class Layout {
 public:
  Layout(const Source& source, const std::vector<Token>& tokens)
      : source_(source), tokens_(tokens), gaps_(source, tokens), pieces_(tokens) {
    widths_.reserve(tokens.size());
    ends_.reserve(tokens.size());
  }

  std::string Run() {
    while (KindOf(at_) != TokenKind::kEndOfFile) WriteSection();
    WriteComments(at_, CommentsOfSectionEnd(at_));
    return writer_.Take();
  }

 private:
  // --- Tokens.
  TokenKind KindOf(size_t token) const { return tokens_[token].kind; }
  absl::string_view TextOf(size_t token) const {
    return source_.text().substr(tokens_[token].offset, tokens_[token].length);
  }
  // The first token of `kind` from `token` on.
  size_t Find(TokenKind kind, size_t token) const {
    while (KindOf(token) != kind) ++token;
    return token;
  }

  // After pieces_ knows the spaces of all tokens up to `last`.
  void Measure(size_t last) {
    while (widths_.size() <= last) {
      const size_t token = widths_.size();
      widths_.push_back(CountCodePoints(TextOf(token)));
      const size_t before = ends_.empty() ? 0 : ends_.back();
      ends_.push_back(before + widths_.back() + (pieces_.space_before(token) ? 1 : 0));
    }
  }
  // On one line, without a space before the first.
  size_t WidthOf(size_t first, size_t last) const {
    return ends_[last] - ends_[first] + widths_[first];
  }
  // May stand on the line at hand up to `column`, with `tail` columns after it.
  bool FitsAt(size_t column, size_t first, size_t last, size_t tail = 0) const {
    return gaps_.Clean(first, last) && column + WidthOf(first, last) + tail <= kLineColumnsMax;
  }
  bool Fits(size_t first, size_t last, size_t tail) const {
    const bool space = !writer_.at_start() && pieces_.space_before(first);
    return FitsAt(writer_.column() + (space ? 1 : 0), first, last, tail);
  }

  // --- Writing tokens.
  // The comments before the token, the token, the comments after it.
  void Put(size_t token, int indent) {
    const std::span<const Comment> comments = gaps_.Before(token);
    if (token != commented_ && !comments.empty()) {
      writer_.NewLineIfNoStart(indent);
      const int start = writer_.column();
      for (const Comment& comment : comments) {
        writer_.NewLine(start);
        writer_.Append(comment.text);
      }
      writer_.NewLine(start);
    }
    if (writer_.at_start()) {
      writer_.NewLineIfNoStart(indent);
    } else if (pieces_.space_before(token)) {
      writer_.Append(" ");
    }
    writer_.Append(TextOf(token));
    for (const Comment& comment : gaps_.After(token)) writer_.EndWithComment(comment.text);
  }
  void PutAll(size_t first, size_t last, int indent) {
    for (size_t token = first; token <= last; ++token) Put(token, indent);
  }

  // --- Comments and blank lines between items.
  struct CommentsBefore {
    // This many of the comments first, indented by `inner_indent`; the others by `indent`.
    size_t inner = 0;
    int inner_indent = 0;
    int indent = 0;
    bool keep_first_blank = true;
  };

  // Writes what stands before `token`, so that Put does not.
  void WriteComments(size_t token, const CommentsBefore& how) {
    const std::span<const Comment> comments = gaps_.Before(token);
    for (size_t i = 0; i < comments.size(); ++i) {
      if (comments[i].blank_before && (i > 0 || how.keep_first_blank)) writer_.BlankLine();
      writer_.NewLine(i < how.inner ? how.inner_indent : how.indent);
      writer_.Append(comments[i].text);
    }
    const bool keep = !comments.empty() || how.keep_first_blank;
    const TokenKind kind = KindOf(token);
    const bool ends = kind == TokenKind::kEndOfFile || kind == TokenKind::kCloseBrace;
    if (gaps_.BlankLineBefore(token) && keep && !ends) writer_.BlankLine();
    commented_ = token;
  }
  void StartItem(size_t token, int indent, bool is_first) {
    WriteComments(token, {.indent = indent, .keep_first_blank = !is_first});
    writer_.NewLine(indent);
  }

  // Before `token`, a section or the end: comments belong to the section before as long as they
  // are indented and a blank line parts them from a section that follows.
  CommentsBefore CommentsOfSectionEnd(size_t token) const {
    const std::span<const Comment> comments = gaps_.Before(token);
    CommentsBefore out{.inner_indent = kIndent};
    if (token == 0) return out;
    size_t end = comments.size();
    if (KindOf(token) != TokenKind::kEndOfFile && !gaps_.BlankLineBefore(token)) {
      while (end > 0 && !comments[--end].blank_before) continue;
    }
    while (out.inner < end && comments[out.inner].indented) ++out.inner;
    return out;
  }

  void StartSection(size_t token) {
    const std::span<const Comment> comments = gaps_.Before(token);
    const bool parted = gaps_.BlankLineBefore(token) ||
                        std::any_of(comments.begin(), comments.end(),
                                    [](const Comment& comment) { return comment.blank_before; });
    if (!parted) writer_.BlankLine();
    WriteComments(token, CommentsOfSectionEnd(token));
    writer_.NewLine(0);
  }

  // --- Sections.
  void WriteSection() {
    const TokenKind kind = KindOf(at_);
    const size_t colon = Find(TokenKind::kColon, at_);
    if (kind == TokenKind::kRules) pieces_.SetSpaceBefore(at_ + 1);
    Measure(colon);
    StartSection(at_);
    PutAll(at_, colon, kContinuation);
    at_ = colon + 1;
    for (bool first = true; !StartsSection(KindOf(at_)) && KindOf(at_) != TokenKind::kEndOfFile;
         first = false) {
      StartItem(at_, kIndent, first);
      if (kind == TokenKind::kRules) {
        WriteRule();
      } else if (kind == TokenKind::kLevels) {
        WriteLevel();
      } else {
        WriteDecl();
      }
    }
  }

  void WriteLevel() {
    const size_t semicolon = Find(TokenKind::kSemicolon, at_);
    if (semicolon == at_ + 2) pieces_.SetSpaceBefore(at_ + 1);
    Measure(semicolon);
    PutAll(at_, semicolon, kIndent + kContinuation);
    at_ = semicolon + 1;
  }

  void WriteDecl() {
    const size_t equal = Find(TokenKind::kEqual, at_);
    for (size_t token = at_ + 1; token <= equal + 1; ++token) pieces_.SetSpaceBefore(token);
    const bool braces = KindOf(equal + 1) == TokenKind::kOpenBrace;
    const Piece value = braces ? pieces_.ReadBraces(equal + 1) : pieces_.ReadExpr(equal + 1);
    const size_t semicolon = value.last + 1;
    Measure(semicolon);
    const int indent = kIndent + kContinuation;
    PutAll(at_, equal, indent);
    Write(value, braces ? kIndent : indent, 1);
    Put(semicolon, indent);
    at_ = semicolon + 1;
  }

  // --- Rules.
  Chain ReadChain(size_t first) {
    Chain chain;
    for (size_t at = first;;) {
      chain.actions.push_back(pieces_.ReadCall(at));
      const size_t next = chain.actions.back().last + 1;
      if (KindOf(next) == TokenKind::kSemicolon) return chain;
      if (KindOf(next) != TokenKind::kComma) pieces_.SetSpaceBefore(next);
      at = next + 1;
      pieces_.SetSpaceBefore(at);
    }
  }

  Rule ReadRule(size_t first) {
    Rule rule{.first = first, .named = KindOf(first + 1) == TokenKind::kColon};
    if (rule.named) pieces_.SetSpaceBefore(first + 2);
    rule.condition = pieces_.ReadExpr(rule.named ? first + 2 : first);
    size_t at = rule.question() + 1;
    pieces_.SetSpaceBefore(rule.question());
    pieces_.SetSpaceBefore(at);
    rule.braces = KindOf(at) == TokenKind::kOpenBrace;
    if (rule.braces) ++at;
    do {
      rule.chains.push_back(ReadChain(at));
      at = rule.chains.back().semicolon() + 1;
    } while (rule.braces && KindOf(at) != TokenKind::kCloseBrace);
    rule.last = rule.braces ? at : at - 1;
    return rule;
  }

  void WriteRule() {
    const Rule rule = ReadRule(at_);
    Measure(rule.last);
    at_ = rule.last + 1;
    const size_t body = rule.question() + 1;
    const bool name_apart = rule.named && gaps_.LineBreakBefore(rule.condition.first);
    const bool body_apart = !rule.braces && gaps_.LineBreakBefore(body);
    const size_t head = rule.braces ? body : rule.last;
    const bool fits = !name_apart && !body_apart && FitsAt(kIndent, rule.first, head);
    int indent = kIndent;
    if (rule.named) PutAll(rule.first, rule.first + 1, indent + kContinuation);
    if (rule.named && !fits) {
      indent += kIndent;
      writer_.NewLine(indent);
    }
    if (!rule.braces && !body_apart && Fits(rule.condition.first, rule.last, 0)) {
      PutAll(rule.condition.first, rule.last, indent);
      return;
    }
    Write(rule.condition, indent, rule.braces ? 4 : 2);
    Put(rule.question(), indent);
    if (rule.braces) {
      WriteBraces(rule, indent);
    } else {
      writer_.NewLine(indent + kIndent);
      WriteChain(rule.chains[0], indent + kIndent);
    }
  }

  void WriteBraces(const Rule& rule, int indent) {
    Put(rule.question() + 1, indent);
    const int inner = indent + kIndent;
    for (const Chain& chain : rule.chains) {
      StartItem(chain.first(), inner, &chain == &rule.chains.front());
      WriteChain(chain, inner);
    }
    WriteComments(rule.last, {.indent = inner});
    writer_.NewLine(indent);
    Put(rule.last, indent);
  }

  // At the start of a line.
  void WriteChain(const Chain& chain, int indent) {
    if (FitsAt(indent, chain.first(), chain.semicolon())) {
      PutAll(chain.first(), chain.semicolon(), indent);
      return;
    }
    const bool beside = ConnectorsFitBeside(chain, indent);
    Write(chain.actions[0], indent, chain.actions.size() == 1 ? 1 : 0);
    const int start = beside ? writer_.column() + 1 : indent + kIndent;
    for (size_t i = 1; i < chain.actions.size(); ++i) {
      const Piece& action = chain.actions[i];
      if (!beside || i > 1) writer_.NewLine(start);
      Put(action.first - 1, start);
      Write(action, start + kIndent, i + 1 == chain.actions.size() ? 1 : 0);
    }
    Put(chain.semicolon(), indent + kIndent);
  }

  // The first connector may stay on the line of the first action, with the others under it.
  bool ConnectorsFitBeside(const Chain& chain, int indent) const {
    const std::vector<Piece>& actions = chain.actions;
    if (!gaps_.Clean(chain.first(), chain.semicolon()) || actions.size() == 1) return false;
    if (KindOf(actions[0].last + 1) == TokenKind::kComma) return false;
    const size_t start = indent + WidthOf(actions[0].first, actions[0].last) + 1;
    return std::all_of(actions.begin() + 1, actions.end(), [&](const Piece& action) {
      return FitsAt(start, action.first - 1, action.last, 1);
    });
  }

  // --- Pieces, from where the line at hand has got to; `tail` columns follow the last token.
  void Write(const Piece& piece, int indent, size_t tail) {
    if (writer_.at_start() || !gaps_.Before(piece.first).empty()) writer_.NewLineIfNoStart(indent);
    if (piece.kind == Piece::Kind::kWord || Fits(piece.first, piece.last, tail)) {
      PutAll(piece.first, piece.last, indent);
      return;
    }
    switch (piece.kind) {
      case Piece::Kind::kWord:
        break;
      case Piece::Kind::kPrefix:
        Put(piece.first, indent);
        Write(piece.items[0], indent, tail);
        break;
      case Piece::Kind::kRun:
        WriteRun(piece, indent, tail);
        break;
      case Piece::Kind::kList:
        WriteList(piece, indent, tail);
        break;
    }
  }

  void WriteRun(const Piece& run, int indent, size_t tail) {
    // Deeper than the operators of this run, under the operands that follow them.
    const int inner = indent + static_cast<int>(widths_[run.items[1].first - 1]) + 1;
    Write(run.items[0], inner, 0);
    for (size_t i = 1; i < run.items.size(); ++i) {
      writer_.NewLine(indent);
      Put(run.items[i].first - 1, indent);
      Write(run.items[i], inner, i + 1 == run.items.size() ? tail : 0);
    }
  }

  void WriteList(const Piece& list, int indent, size_t tail) {
    PutAll(list.first, list.open, indent);
    const bool braces = KindOf(list.open) == TokenKind::kOpenBrace;
    const bool under = !braces && !writer_.at_start() && writer_.column() <= kListColumnMax;
    const int inner = under ? writer_.column() : indent + (braces ? kIndent : kContinuation);
    if (!under) writer_.NewLine(inner);
    for (size_t i = 0; i < list.items.size(); ++i) {
      const Piece& item = list.items[i];
      const bool last = i + 1 == list.items.size();
      if (i > 0) writer_.NewLine(inner);
      Write(item, inner, last ? tail + 1 : 1);
      if (item.last + 1 < list.last) Put(item.last + 1, inner);
    }
    if (braces) {
      WriteComments(list.last, {.indent = inner});
      writer_.NewLine(indent);
    }
    Put(list.last, inner);
  }

  const Source& source_;
  const std::vector<Token>& tokens_;
  Gaps gaps_;
  PieceReader pieces_;
  LineWriter writer_;
  std::vector<size_t> widths_;  // code points of each token measured
  std::vector<size_t> ends_;    // where it would end if the whole file were one line
  size_t at_ = 0;
  size_t commented_ = static_cast<size_t>(-1);  // its comments have been written
};

}  // namespace

std::string LayOut(const Source& source, const std::vector<Token>& tokens) {
  return Layout(source, tokens).Run();
}

}  // namespace rips::lang

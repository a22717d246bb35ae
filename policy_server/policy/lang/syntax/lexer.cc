#include "policy_server/policy/lang/syntax/lexer.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "policy_server/policy/lang/syntax/literal.h"
#include "re2/re2.h"
#include "services/text/quote.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

struct Spelling {
  TokenKind kind;
  absl::string_view text;
};

constexpr Spelling kKeywords[] = {
#define RIPS_KEYWORD(name, spelling) {TokenKind::k##name, spelling},
#include "policy_server/policy/lang/syntax/token_kind.def"
};

constexpr Spelling kSymbols[] = {
#define RIPS_SYMBOL(name, spelling) {TokenKind::k##name, spelling},
#include "policy_server/policy/lang/syntax/token_kind.def"
};

bool MatchesClass(absl::string_view text, const RE2& pattern) {
  return RE2::FullMatch(re2::StringPiece(text.data(), text.size()), pattern);
}

// `text` is one code point.
bool StartsIdentifier(absl::string_view text) {
  if (text.size() == 1) return absl::ascii_isalpha(text[0]) || text[0] == '_';
  static const RE2* const letter = new RE2("\\pL");
  return MatchesClass(text, *letter);
}

bool ContinuesIdentifier(absl::string_view text) {
  if (text.size() == 1) return absl::ascii_isalnum(text[0]) || text[0] == '_';
  static const RE2* const letter_or_digit = new RE2("[\\pL\\p{Nd}]");
  return MatchesClass(text, *letter_or_digit);
}

// One pass over the text. Each Take... starts at `at_` and leaves `at_` after what it took.
class Lexer {
 public:
  Lexer(const Source& source, DiagnosticSink& sink)
      : source_(source), text_(source.text()), at_(source.start()), sink_(sink) {}

  std::vector<Token> Run() {
    for (SkipTrivia(); at_ < text_.size(); SkipTrivia()) {
      const uint32_t begin = at_;
      const TokenKind kind = TakeToken();
      tokens_.push_back({.kind = kind, .offset = begin, .length = at_ - begin});
    }
    tokens_.push_back({.kind = TokenKind::kEndOfFile, .offset = at_, .length = 0});
    return std::move(tokens_);
  }

 private:
  char Peek(uint32_t ahead = 0) const {
    return at_ + ahead < text_.size() ? text_[at_ + ahead] : '\0';
  }
  bool PeekDigit(uint32_t ahead = 0) const { return absl::ascii_isdigit(Peek(ahead)); }
  absl::string_view PeekCodePoint() const {
    if (at_ >= text_.size()) return {};
    return text_.substr(at_, DecodeCodePoint(text_, at_).length);
  }

  void SkipTrivia() {
    while (at_ < text_.size()) {
      if (absl::ascii_isspace(text_[at_])) {
        ++at_;
      } else if (text_[at_] == '#') {
        const size_t end = text_.find('\n', at_);
        at_ = end == absl::string_view::npos ? text_.size() : end;
      } else {
        return;
      }
    }
  }

  TokenKind TakeToken() {
    const absl::string_view first = PeekCodePoint();
    if (StartsIdentifier(first)) return TakeWord();
    if (PeekDigit() || (Peek() == '.' && PeekDigit(1))) return TakeNumber();
    if (Peek() == '"') return TakeString();
    for (const Spelling& symbol : kSymbols) {
      if (absl::StartsWith(text_.substr(at_), symbol.text)) {
        at_ += symbol.text.size();
        return symbol.kind;
      }
    }
    return TakeUnexpected();
  }

  void TakeIdentifierTail() {
    for (absl::string_view c = PeekCodePoint(); !c.empty() && ContinuesIdentifier(c);
         c = PeekCodePoint()) {
      at_ += c.size();
    }
  }

  TokenKind TakeWord() {
    const uint32_t begin = at_;
    TakeIdentifierTail();
    const absl::string_view word = text_.substr(begin, at_ - begin);
    for (const Spelling& keyword : kKeywords) {
      if (word == keyword.text) return keyword.kind;
    }
    if (word.size() > kIdentifierBytesMax) {
      sink_.Add(
          DiagnosticKind::kIdentifierTooLong, RangeFrom(begin),
          absl::StrCat("a name of ", word.size(), " bytes exceeds limit ", kIdentifierBytesMax));
    }
    return TokenKind::kIdentifier;
  }

  TokenKind TakeNumber() {
    const uint32_t begin = at_;
    const bool decimal = !(Peek() == '0' && (Peek(1) == 'x' || Peek(1) == 'o' || Peek(1) == 'b'));
    const bool is_float = decimal && TakeDecimal();
    // Letters and digits that touch the number belong to it, so that `12ab` is one mistake.
    const uint32_t end_of_decimal = at_;
    TakeIdentifierTail();
    const absl::string_view number = text_.substr(begin, at_ - begin);
    const bool tail = decimal && at_ != end_of_decimal;
    std::optional<NumberError> error = NumberError::kMalformed;
    if (!tail) error = is_float ? DecodeFloat(number).error : DecodeInteger(number).error;
    if (error == NumberError::kMalformed) {
      sink_.Add(DiagnosticKind::kMalformedNumber, RangeFrom(begin),
                absl::StrCat("malformed number ", Quote(number)),
                "numbers are written like `12`, `0x1f`, `0o17`, `0b101`, `1.5`, `.5` or `1e9`");
      return TokenKind::kError;
    }
    if (error == NumberError::kOutOfRange) {
      sink_.Add(DiagnosticKind::kNumberOutOfRange, RangeFrom(begin),
                absl::StrCat("number ", Quote(number), " is out of range"),
                is_float ? "floats are IEEE doubles" : "integers have 64 bits, with a sign");
    } else if (!is_float && decimal && number.size() > 1 && number[0] == '0') {
      sink_.Add(DiagnosticKind::kLeadingZero, RangeFrom(begin),
                absl::StrCat(Quote(number), " is decimal"), "octal is written `0o17`");
    }
    return is_float ? TokenKind::kFloat : TokenKind::kInteger;
  }

  void TakeDigits() {
    while (PeekDigit()) ++at_;
  }

  // True if it is a float.
  bool TakeDecimal() {
    bool is_float = false;
    TakeDigits();
    if (Peek() == '.') {
      is_float = true;
      ++at_;
      TakeDigits();
    }
    if (Peek() == 'e' || Peek() == 'E') {
      const uint32_t sign = Peek(1) == '+' || Peek(1) == '-' ? 1 : 0;
      if (PeekDigit(1 + sign)) {
        is_float = true;
        at_ += 1 + sign;
        TakeDigits();
      }
    }
    return is_float;
  }

  TokenKind TakeString() {
    const uint32_t begin = at_;
    const SourceRange quote{.file = source_.file(), .offset = begin, .length = 1};
    for (++at_; at_ < text_.size() && text_[at_] != '"'; ++at_) {
      if (text_[at_] == '\\' && at_ + 1 < text_.size()) ++at_;
    }
    if (at_ >= text_.size()) {
      at_ = text_.size();
      sink_.Add(DiagnosticKind::kUnterminatedString, quote, "this string never ends",
                "close it with `\"`; inside a string a quote is written `\\\"`");
      return TokenKind::kError;
    }
    ++at_;
    const StringValue decoded = DecodeString(text_.substr(begin, at_ - begin));
    if (!decoded.bad_escape.empty()) {
      sink_.Add(DiagnosticKind::kBadEscape, quote,
                absl::StrCat("bad escape ", Quote(decoded.bad_escape), " in this string"),
                "escapes are \\a \\b \\f \\n \\r \\t \\v \\\\ \\\" \\xHH \\ooo (up to \\377) "
                "\\uHHHH \\UHHHHHHHH; a backslash is written \\\\");
    }
    const size_t length = CountCodePoints(decoded.value);
    if (length > kStringCodePointsMax) {
      sink_.Add(DiagnosticKind::kStringTooLong, quote,
                absl::StrCat("a string of ", length, " code points exceeds limit ",
                             kStringCodePointsMax));
    }
    return TokenKind::kString;
  }

  TokenKind TakeUnexpected() {
    const uint32_t begin = at_;
    const CodePoint point = DecodeCodePoint(text_, at_);
    at_ += point.length;
    const absl::string_view text = text_.substr(begin, point.length);
    std::string what = Quote(text);
    if (!point.valid || IsControl(point.value)) {
      what = absl::StrFormat(
          "%s%02X", point.valid ? "U+00" : "byte 0x",
          point.valid ? static_cast<uint32_t>(point.value) : static_cast<uint8_t>(text[0]));
    }
    const bool quote = text == "'" || text == "\u201C" || text == "\u201D" || text == "`";
    sink_.Add(DiagnosticKind::kUnexpectedCharacter, RangeFrom(begin),
              absl::StrCat("unexpected character ", what),
              quote ? "strings stand between double quotes, `\"`" : "");
    return TokenKind::kError;
  }

  SourceRange RangeFrom(uint32_t begin) const {
    return {.file = source_.file(), .offset = begin, .length = at_ - begin};
  }

  const Source& source_;
  absl::string_view text_;
  uint32_t at_;
  DiagnosticSink& sink_;
  std::vector<Token> tokens_;
};

}  // namespace

std::string Describe(TokenKind kind) {
  switch (kind) {
#define RIPS_TOKEN(name, description) \
  case TokenKind::k##name:            \
    return description;
#define RIPS_KEYWORD(name, spelling) \
  case TokenKind::k##name:           \
    return "`" spelling "`";
#define RIPS_SYMBOL(name, spelling) \
  case TokenKind::k##name:          \
    return "`" spelling "`";
#include "policy_server/policy/lang/syntax/token_kind.def"
  }
  return "";
}

std::vector<Token> Lex(const Source& source, DiagnosticSink& sink) {
  return Lexer(source, sink).Run();
}

bool IsTrivia(absl::string_view text) {
  while (!text.empty()) {
    if (absl::ascii_isspace(text[0])) {
      text.remove_prefix(1);
    } else if (text[0] == '#') {
      text.remove_prefix(std::min(text.find('\n'), text.size()));
    } else {
      return false;
    }
  }
  return true;
}

}  // namespace rips::lang

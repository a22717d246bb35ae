#include "mode_actuator/steps/firewall/fragment.h"

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "services/base/status_macros.h"
#include "services/text/quote.h"

namespace rips::actuator {
namespace {

// Words that would take a rule out of its chain, or name what is not the rule's.
constexpr std::array<absl::string_view, 12> kRefusedWords = {
    "jump",   "goto",     "comment", "include", "define", "undefine",
    "handle", "position", "meter",   "map",     "vmap",   "redefine"};
// `@ih,64,96` reads bytes of the packet; any other `@` names a set.
constexpr std::array<absl::string_view, 4> kRawBases = {"ih,", "nh,", "th,", "ll,"};

bool IsWordChar(char c) { return absl::ascii_isalnum(c) || c == '_'; }

// Where a `#` outside quotes begins a comment; the whole length if none does. nullopt: a quote is
// left open.
std::optional<size_t> CommentAt(absl::string_view line) {
  bool quoted = false;
  for (size_t i = 0; i < line.size(); ++i) {
    if (line[i] == '"') quoted = !quoted;
    if (line[i] == '#' && !quoted) return i;
  }
  if (quoted) return std::nullopt;
  return line.size();
}

absl::Status Refuse(absl::string_view why) { return absl::InvalidArgumentError(why); }

// Every word outside quotes, and every `@`.
absl::Status CheckWords(absl::string_view rule) {
  bool quoted = false;
  bool first = true;
  for (size_t i = 0; i < rule.size(); ++i) {
    if (rule[i] == '"') quoted = !quoted;
    if (quoted) continue;
    if (rule[i] == '@') {
      const absl::string_view rest = rule.substr(i + 1);
      const bool raw = std::any_of(kRawBases.begin(), kRawBases.end(), [&](absl::string_view base) {
        return absl::StartsWith(rest, base);
      });
      if (!raw) return Refuse("a rule cannot name a set");
    }
    if (!IsWordChar(rule[i])) continue;
    const size_t begin = i;
    while (i + 1 < rule.size() && IsWordChar(rule[i + 1])) ++i;
    const absl::string_view word = rule.substr(begin, i + 1 - begin);
    const bool refused =
        std::find(kRefusedWords.begin(), kRefusedWords.end(), word) != kRefusedWords.end();
    if (refused || (first && word == "index")) {
      return Refuse(absl::StrCat("a rule cannot use `", word, "`"));
    }
    first = false;
  }
  return absl::OkStatus();
}

absl::Status CheckRule(absl::string_view rule) {
  int depth = 0;
  for (const char c : rule) {
    // nft takes each of these for an end, a continuation or a variable.
    if (c == ';' || c == '\\' || c == '$' || c == '`') {
      return Refuse(absl::StrCat("a rule cannot hold `", absl::string_view(&c, 1), "`"));
    }
    if (c == '{') ++depth;
    if (c == '}' && --depth < 0) return Refuse("`}` without `{`");
  }
  if (depth != 0) return Refuse("`{` is not closed on its line");
  return CheckWords(rule);
}

class Parser {
 public:
  absl::Status Line(absl::string_view raw, int number) {
    if (raw.size() > kFragmentLineBytesMax) {
      return Refuse(
          absl::StrCat("a line of ", raw.size(), " bytes exceeds limit ", kFragmentLineBytesMax));
    }
    const bool printable = std::all_of(raw.begin(), raw.end(),
                                       [](char c) { return c == '\t' || absl::ascii_isprint(c); });
    if (!printable) return Refuse("only printable ASCII is allowed");
    const std::optional<size_t> end = CommentAt(raw);
    if (!end.has_value()) return Refuse("a quote is not closed on its line");
    const absl::string_view line = absl::StripAsciiWhitespace(raw.substr(0, *end));
    if (line.empty()) return absl::OkStatus();
    if (!open_) return Open(line);
    if (line == "}") {
      open_ = false;
      return absl::OkStatus();
    }
    RIPS_RETURN_IF_ERROR(CheckRule(line));
    if (rules_.size() >= kFragmentRulesMax) {
      return Refuse(absl::StrCat("rules exceed limit ", kFragmentRulesMax));
    }
    rules_.push_back({.hook = hook_, .text = std::string(line), .line = number});
    return absl::OkStatus();
  }

  absl::StatusOr<std::vector<FragmentRule>> Finish() {
    if (open_) return Refuse("the last chain is not closed");
    if (rules_.empty()) return Refuse("there is no rule in it");
    return std::move(rules_);
  }

 private:
  absl::Status Open(absl::string_view line) {
    const std::vector<absl::string_view> words =
        absl::StrSplit(line, absl::ByAnyChar(" \t"), absl::SkipEmpty());
    if (words.size() != 3 || words[0] != "chain" || words[2] != "{") {
      return Refuse(absl::StrCat(QuoteBytes(line),
                                 " is outside of a chain; write `chain input {`, "
                                 "`chain output {` or `chain forward {` first"));
    }
    open_ = true;
    if (words[1] == "input") {
      hook_ = Hook::kInput;
    } else if (words[1] == "output") {
      hook_ = Hook::kOutput;
    } else if (words[1] == "forward") {
      hook_ = Hook::kForward;
    } else {
      open_ = false;
    }
    if (open_) return absl::OkStatus();
    return Refuse(absl::StrCat("chain ", QuoteBytes(words[1]),
                               " is none of `input`, `output` and `forward`"));
  }

  bool open_ = false;  // inside a chain, of `hook_`
  Hook hook_ = Hook::kInput;
  std::vector<FragmentRule> rules_;
};

}  // namespace

absl::StatusOr<std::vector<FragmentRule>> ParseFragment(absl::string_view file,
                                                        absl::string_view text) {
  if (text.size() > kFragmentBytesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": ", text.size(), " bytes exceed limit ", kFragmentBytesMax));
  }
  Parser parser;
  int number = 0;
  for (const absl::string_view line : absl::StrSplit(text, '\n')) {
    ++number;
    if (const absl::Status status = parser.Line(line, number); !status.ok()) {
      return absl::InvalidArgumentError(absl::StrCat(file, ":", number, ": ", status.message()));
    }
  }
  absl::StatusOr<std::vector<FragmentRule>> rules = parser.Finish();
  if (!rules.ok()) {
    return absl::InvalidArgumentError(absl::StrCat(file, ": ", rules.status().message()));
  }
  return rules;
}

}  // namespace rips::actuator

#include "policy_server/policy/lang/format/formatter.h"

#include <algorithm>
#include <cstdint>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/policy/lang/diagnostic/diagnostic_sink.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/format/layout.h"
#include "policy_server/policy/lang/limits.h"
#include "policy_server/policy/lang/syntax/lexer.h"
#include "policy_server/policy/lang/syntax/parser.h"
#include "services/base/check.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

std::vector<Diagnostic> Errors(const DiagnosticSink& words, const DiagnosticSink& grammar) {
  std::vector<Diagnostic> out;
  for (const DiagnosticSink* sink : {&words, &grammar}) {
    for (const Diagnostic& diagnostic : sink->diagnostics()) {
      if (SeverityOf(diagnostic.kind) == DiagnosticSeverity::kError) out.push_back(diagnostic);
    }
  }
  return SortAndCut(std::move(out));
}

// Both texts have the same tokens. Comments stand between tokens, so a comment that swallowed one
// would show as well.
bool SameTokens(const Source& a, const std::vector<Token>& a_tokens, const Source& b) {
  DiagnosticSink sink;
  const std::vector<Token> b_tokens = Lex(b, sink);
  return std::equal(a_tokens.begin(), a_tokens.end(), b_tokens.begin(), b_tokens.end(),
                    [&](const Token& x, const Token& y) {
                      return x.kind == y.kind && a.text().substr(x.offset, x.length) ==
                                                     b.text().substr(y.offset, y.length);
                    });
}

}  // namespace

FormatResult Format(const SourceFile& file) {
  if (file.text.size() > kFileBytesMax || FindInvalidUtf8(file.text)) {
    return {.text = std::nullopt, .diagnostics = Compile({file}).diagnostics};
  }
  const Source source(0, file.text);
  DiagnosticSink words;
  const std::vector<Token> tokens = Lex(source, words);
  DiagnosticSink grammar;
  Parse(source, tokens, grammar);
  if (words.has_errors() || grammar.has_errors()) {
    return {.text = std::nullopt, .diagnostics = Errors(words, grammar)};
  }
  std::string text = LayOut(source, tokens);
  if (text.size() > kFileBytesMax) {
    return {.text = std::nullopt,
            .diagnostics = {{.kind = DiagnosticKind::kFileTooLarge,
                             .range = {},
                             .message = absl::StrCat("formatted, the file would have ", text.size(),
                                                     " bytes; this exceeds limit ", kFileBytesMax),
                             .hint = "split the policy"}}};
  }
  // What the caller may put in place of a policy must be that policy.
  RIPS_CHECK(SameTokens(source, tokens, Source(0, text)), "the layout changed the rules");
  return {.text = std::move(text), .diagnostics = {}};
}

}  // namespace rips::lang

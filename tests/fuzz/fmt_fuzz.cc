// For any bytes: what the formatter refuses has a reason; what it formats has the same tree and the
// same comments in the same order, and formatting it again changes nothing.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/ascii.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/format/formatter.h"
#include "policy_server/policy/lang/syntax/ast_printer.h"
#include "policy_server/policy/lang/syntax/lexer.h"
#include "policy_server/policy/lang/syntax/parser.h"
#include "services/base/check.h"

namespace {

using namespace rips::lang;  // One translation unit, nothing else in it.

struct Contents {
  std::string tree;
  std::vector<std::string> comments;

  friend bool operator==(const Contents&, const Contents&) = default;
};

// Nothing if there is an error.
std::optional<Contents> Read(const std::string& text) {
  const Source source(0, text);
  DiagnosticSink sink;
  const std::vector<Token> tokens = Lex(source, sink);
  const ast::File file = Parse(source, tokens, sink);
  if (sink.has_errors()) return std::nullopt;
  Contents out = {.tree = Print(file), .comments = {}};
  size_t at = source.start();
  for (const Token& token : tokens) {
    while ((at = text.find('#', at)) < token.offset) {
      const size_t end = std::min(text.find('\n', at), text.size());
      out.comments.emplace_back(absl::StripTrailingAsciiWhitespace(text.substr(at, end - at)));
      at = end;
    }
    at = token.end();
  }
  return out;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > 20'000) return 0;  // Larger inputs find nothing new, slowly.
  const SourceFile file = {.path = "fuzz.rul",
                           .text = std::string(reinterpret_cast<const char*>(data), size)};
  const FormatResult result = Format(file);
  RIPS_CHECK(result.text.has_value() == result.diagnostics.empty(), "refused without a reason");
  if (!result.text) {
    RenderText({file}, result.diagnostics);
    return 0;
  }
  const std::optional<Contents> before = Read(file.text);
  RIPS_CHECK(before, "formatted with errors");
  RIPS_CHECK(Read(*result.text) == before, "the rules or comments have changed");
  const FormatResult again = Format({.path = "fuzz.rul", .text = *result.text});
  RIPS_CHECK(again.text == result.text, "formatting twice is not formatting once");
  return 0;
}

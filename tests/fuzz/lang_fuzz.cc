// For any bytes: the tokens tile the text; a text that parses has no token left over, and what its
// tree prints to parses again to the same print; Compile ends with rules or with an error, and
// accepts only what the lexer and the parser read to the last byte; every diagnostic can be shown.
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/syntax/ast_printer.h"
#include "policy_server/policy/lang/syntax/lexer.h"
#include "policy_server/policy/lang/syntax/parser.h"
#include "services/base/check.h"

namespace {

using namespace rips::lang;  // One translation unit, nothing else in it.

// The canonical text, or nothing if there is an error.
std::optional<std::string> Canonical(const std::string& text) {
  const Source source(0, text);
  DiagnosticSink sink;
  const std::vector<Token> tokens = Lex(source, sink);
  uint32_t at = source.start();
  for (const Token& token : tokens) {
    RIPS_CHECK(token.offset >= at, "tokens overlap");
    RIPS_CHECK(IsTrivia(source.text().substr(at, token.offset - at)), "bytes were skipped");
    RIPS_CHECK(token.kind != TokenKind::kError || sink.has_errors(), "an error was not reported");
    at = token.end();
  }
  RIPS_CHECK(at == text.size() && tokens.back().kind == TokenKind::kEndOfFile, "text is left");
  const ast::File file = Parse(source, tokens, sink);
  if (sink.has_errors()) return std::nullopt;
  RIPS_CHECK(file.understood + 1 == tokens.size(), "tokens were skipped");
  return Print(file);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > 100'000) return 0;  // Larger inputs find nothing new, slowly.
  const std::string text(reinterpret_cast<const char*>(data), size);
  const std::optional<std::string> canonical = Canonical(text);
  if (canonical) RIPS_CHECK(Canonical(*canonical) == canonical, "the print reads differently");
  const std::vector<SourceFile> files = {{.path = "fuzz.rul", .text = text}};
  const CompileResult result = Compile(files);
  RIPS_CHECK(!result.rules || canonical, "accepted with errors");
  RIPS_CHECK(result.rules || !result.diagnostics.empty(), "refused without a reason");
  RenderText(files, result.diagnostics);
  RenderJson(files, result.diagnostics);
  return 0;
}

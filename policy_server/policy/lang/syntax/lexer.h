// Text to tokens.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_LEXER_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_LEXER_H_

#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/diagnostic/diagnostic_sink.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/syntax/token.h"

namespace rips::lang {

// Total: any bytes in, tokens out, the last one kEndOfFile (length 0, at the end of the text).
// Tokens are in order and do not overlap; the bytes between them are white space (ASCII space,
// tab, CR, LF, VT, FF), comments (`#` to the end of the line) and the byte order mark. What is not
// understood is a kError token, and every one of those has an error in `sink`.
//
//   identifier   [A-Za-z_] or a Unicode letter, then letters, decimal digits of any script, `_`
//   integer      decimal, 0x, 0o, 0b
//   float        decimal digits with a `.` or an exponent: .01  1.  1E9  1.02e-3
//   string       `"` to the next `"` that no `\` escapes; may span lines
//
// A string with a bad escape, or a name, string or number beyond its limit, keeps its kind and is
// reported.
std::vector<Token> Lex(const Source& source, DiagnosticSink& sink);

// The bytes between two tokens hold nothing but white space and comments. A comment must end
// within `text`, by a newline or by the end of the file.
bool IsTrivia(absl::string_view text);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_LEXER_H_

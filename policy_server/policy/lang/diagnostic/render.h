// Diagnostics as text and as JSON.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_RENDER_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_RENDER_H_

#include <string>
#include <vector>

#include "policy_server/policy/lang/diagnostic/diagnostic.h"

namespace rips::lang {

struct SourceFile {
  // As diagnostics name it.
  std::string path;
  std::string text;
};

// All diagnostics as text: `path:line:col: error: message`, the line, a caret, the hint.
std::string RenderText(const std::vector<SourceFile>& files,
                       const std::vector<Diagnostic>& diagnostics);

// Where each diagnostic is and of which kind, without anything of the text: for logs, which must
// not hold rules. One `path:line:col: error TypeMismatch` a line.
std::string RenderPlaces(const std::vector<SourceFile>& files,
                         const std::vector<Diagnostic>& diagnostics);

// One line of JSON, valid UTF-8 whatever the files hold:
// {"files":[{"path","ok":bool,"diagnostics":[{"line","column","severity","kind","message",
// "hint"?}]}]}; lines and columns from 1, columns in code points. A contract: fields may be added.
std::string RenderJson(const std::vector<SourceFile>& files,
                       const std::vector<Diagnostic>& diagnostics);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_RENDER_H_

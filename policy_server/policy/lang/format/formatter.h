// One layout for every rule file; comments stay.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_FORMATTER_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_FORMATTER_H_

#include <optional>
#include <string>
#include <vector>

#include "policy_server/policy/lang/diagnostic/diagnostic.h"
#include "policy_server/policy/lang/diagnostic/render.h"

namespace rips::lang {

struct FormatResult {
  // The file in the one layout. Absent if the file is refused.
  std::optional<std::string> text;
  // Why it is refused; sorted by position, at most 50 errors, then a note. Otherwise empty.
  std::vector<Diagnostic> diagnostics;
};

// Moves white space and nothing else: the tokens and comments of the result are those of the file,
// spelled and ordered as they were. Formatting the result changes nothing. The layout:
//
//   - Section keywords start in column 1, what they declare is indented by two, and a blank line
//     stands before every section. Other blank lines stay, one at most.
//   - A rule that fits stands on one line. One that does not, or whose author ended a line after
//     its name or its `?`, has its name on a line of its own, then the condition with the `?` at
//     its end, then the chain, indented. Braces hold one chain a line.
//   - Long conditions are broken before operators, the loosest first; long chains before
//     connectors, one under the other; long lists after commas, one member a line.
//   - A comment on a line of its own goes before what follows it; one at the end of a line stays
//     there, in one column with those of the lines around it. An indented comment at the end of a
//     section stays indented.
//   - Lines keep to 100 columns where they can be broken. Strings are never broken. Lines end with
//     a newline alone; a byte order mark goes.
//
// Refused, with diagnostics: text that is not UTF-8, does not parse, or has more than
// kFileBytesMax bytes now or would have them afterwards. What names and types mean is not looked
// at, so a file that needs another's names is as good as any.
FormatResult Format(const SourceFile& file);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_FORMATTER_H_

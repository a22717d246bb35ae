// The layout of the formatter: tokens and comments to lines.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_LAYOUT_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_LAYOUT_H_

#include <string>
#include <vector>

#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/syntax/token.h"

namespace rips::lang {

// `tokens` come from Lex(source) and parse without errors. Gives the text in the layout of
// Format (formatter.h).
std::string LayOut(const Source& source, const std::vector<Token>& tokens);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_LAYOUT_H_

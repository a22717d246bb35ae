// Hints for what other languages, and the paper's own listings, write differently.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_FOREIGN_SYNTAX_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_FOREIGN_SYNTAX_H_

#include "absl/strings/string_view.h"

namespace rips::lang {

// `rest` begins with what was not expected. Empty if nothing is known to say.
absl::string_view HabitHint(absl::string_view rest);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_FOREIGN_SYNTAX_H_

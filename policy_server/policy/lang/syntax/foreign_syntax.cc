#include "policy_server/policy/lang/syntax/foreign_syntax.h"

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"

namespace rips::lang {
namespace {

struct Habit {
  absl::string_view spelling;
  absl::string_view hint;
};

// The first that fits; words end where a name ends.
constexpr Habit kHabits[] = {
    {"and", "`&&` joins conditions that must both hold"},
    {"or", "`||` joins conditions of which one must hold"},
    {"not", "`!` negates a condition"},
    {"if", "a rule is written `condition ? action;`"},
    {"then", "a rule is written `condition ? action;`"},
    {"//", "a comment begins with `#`"},
    {"/*", "a comment begins with `#`"},
    {"->", "the next action after a success follows `=>`"},
    {"-/>", "the next action after a failure follows `!>`"},
    {"[", "a list stands in the parentheses of its builtin: `topicin(\"/a\", \"/b\")`"},
    {"{", "a list stands in the parentheses of its builtin: `topicin(\"/a\", \"/b\")`"},
    {"/", "text is written in quotes: `\"/cmd_vel\"`"},
    {"'", "text is written in double quotes"},
    {"=", "equality is written `==`; a variable is set by the action `set(x, 3)`"},
};

bool Begins(absl::string_view rest, absl::string_view spelling) {
  if (!absl::ascii_isalpha(spelling.front())) return absl::StartsWith(rest, spelling);
  if (!absl::StartsWithIgnoreCase(rest, spelling)) return false;
  const absl::string_view after = rest.substr(spelling.size());
  return after.empty() || !(absl::ascii_isalnum(after.front()) || after.front() == '_');
}

}  // namespace

absl::string_view HabitHint(absl::string_view rest) {
  for (const Habit& habit : kHabits) {
    if (Begins(rest, habit.spelling)) return habit.hint;
  }
  return "";
}

}  // namespace rips::lang

// Words that no robot can match: the part of ExprChecker that warns of slips in names. A security
// rule that silently never matches is worse than one that does not compile.
#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "policy_server/policy/lang/check/expr_checker.h"
#include "services/text/quote.h"

namespace rips::lang {
namespace {

// A part of a ROS 2 name (ROS 2 design, "Topic and Service name mapping to DDS").
bool IsToken(absl::string_view text) {
  return !text.empty() && !absl::ascii_isdigit(text.front()) &&
         std::all_of(text.begin(), text.end(),
                     [](char c) { return absl::ascii_isalnum(c) || c == '_'; });
}

bool AreTokens(const std::vector<absl::string_view>& parts) {
  return std::all_of(parts.begin(), parts.end(), IsToken);
}

// `/a/b`.
bool IsFullName(absl::string_view name) {
  return absl::ConsumePrefix(&name, "/") && AreTokens(absl::StrSplit(name, '/'));
}

// `std_msgs/msg/String`.
bool IsType(absl::string_view name) {
  const std::vector<absl::string_view> parts = absl::StrSplit(name, '/');
  return parts.size() == 3 && AreTokens(parts);
}

bool Fits(ParameterRole role, absl::string_view word) {
  switch (role) {
    case ParameterRole::kTopic:
    case ParameterRole::kService:
      return IsFullName(word);
    case ParameterRole::kNode:
      return absl::StrContains(word, '/') ? IsFullName(word) : IsToken(word);
    case ParameterRole::kPackage:
    case ParameterRole::kTypeName:
      return IsToken(word);
    default:
      return true;
  }
}

absl::string_view What(ParameterRole role) {
  switch (role) {
    case ParameterRole::kTopic:
      return "topic";
    case ParameterRole::kService:
      return "service";
    case ParameterRole::kNode:
      return "node";
    case ParameterRole::kPackage:
      return "package";
    default:
      return "type";
  }
}

std::string HintFor(ParameterRole role, absl::string_view word) {
  const std::vector<absl::string_view> parts = absl::StrSplit(word, '/', absl::SkipEmpty());
  if (role == ParameterRole::kPackage && !parts.empty()) {
    return absl::StrCat("write the package alone, as in ", Quote(parts.front()),
                        "; `msgsubtype(package, name)` asks for one type");
  }
  if (role == ParameterRole::kTypeName && !parts.empty()) {
    return absl::StrCat("write the name alone, as in ", Quote(parts.back()));
  }
  // `rt/` is how DDS spells ROS topics.
  const bool dds = !absl::StartsWith(word, "/") && parts.size() > 1 &&
                   (parts[0] == "rt" || parts[0] == "rq" || parts[0] == "rr");
  const std::string name =
      absl::StrCat("/", absl::StrJoin(parts.begin() + (dds ? 1 : 0), parts.end(), "/"));
  if (!IsFullName(name)) return "names of ROS 2 have letters, digits, `_` and single `/`";
  return absl::StrCat(dds ? "DDS spells it so; in ROS 2 it is " : "write the full name, as in ",
                      Quote(name));
}

}  // namespace

void ExprChecker::WarnName(const TypedExpr& arg, ParameterRole role) {
  const std::string* word = arg.constant_text();
  if (word == nullptr || Fits(role, *word)) return;
  const bool relative = !absl::StartsWith(*word, "/") &&
                        (role == ParameterRole::kTopic || role == ParameterRole::kService);
  sink_.Add(relative ? DiagnosticKind::kRelativeTopic : DiagnosticKind::kNeverMatches, arg.range,
            absl::StrCat(What(role), " ", Quote(*word), " never matches: it ",
                         relative ? "does not start with `/`" : "is no name that ROS 2 allows"),
            HintFor(role, *word));
}

void ExprChecker::WarnComparison(const TypedExpr& left, const TypedExpr& right) {
  const bool flipped = left.is_constant();
  const TypedExpr& name = flipped ? right : left;
  const std::string* text = (flipped ? left : right).constant_text();
  if (name.kind != TypedExpr::Kind::kPredefined || text == nullptr) return;
  std::string hint;
  switch (name.predefined) {
    case Predefined::kTopic:
      if (IsFullName(*text)) return;
      hint = HintFor(ParameterRole::kTopic, *text);
      break;
    case Predefined::kSender:
      if (text->empty() || IsFullName(*text)) return;
      hint = absl::StrCat(HintFor(ParameterRole::kNode, *text),
                          "; `senderin` also takes names without a name space");
      break;
    case Predefined::kMsgType:
      if (text->empty() || IsType(*text)) return;
      hint = "write the whole type, as in `std_msgs/msg/String`";
      break;
    case Predefined::kLevel: {
      std::vector<std::string> known;
      for (const levels::Level& level : levels_) known.push_back(level.name);
      const bool is_level = std::find(known.begin(), known.end(), *text) != known.end();
      if (is_level || scope_.DeclaredLater(*text)) return;
      hint = absl::StrCat("levels are `", absl::StrJoin(known, "`, `"), "`");
      break;
    }
    default:
      return;
  }
  sink_.Add(DiagnosticKind::kNeverMatches, (flipped ? left : right).range,
            absl::StrCat(Quote(PredefinedOf(name.predefined).name), " is never ", Quote(*text)),
            std::move(hint));
}

}  // namespace rips::lang

#include "policy_server/policy/lang/check/scope.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/check/signature.h"
#include "services/text/quote.h"

namespace rips::lang {
namespace {

// What a name already means in the language; empty if nothing.
absl::string_view LanguageMeaning(absl::string_view name, bool& extension) {
  extension = false;
  if (const Signature* signature = FindSignature(name)) {
    extension = signature->extension;
    return "a builtin";
  }
  if (FindAction(name) != nullptr) return "an action";
  if (const PredefinedName* predefined = FindPredefined(name)) {
    extension = predefined->extension;
    return "a predefined name";
  }
  return "";
}

}  // namespace

bool Scope::Declare(const ast::Name& name, Symbol symbol) {
  if (symbols_.contains(name.text)) {
    sink_.Add(DiagnosticKind::kRedeclared, name.range,
              absl::StrCat(Quote(name.text), " is declared already"),
              "a name is declared once, whatever it names; choose another");
    return false;
  }
  bool extension = false;
  const absl::string_view meaning = LanguageMeaning(name.text, extension);
  if (!meaning.empty() && !extension) {
    sink_.Add(DiagnosticKind::kHidesLanguageName, name.range,
              absl::StrCat(Quote(name.text), " is ", meaning, " of the language"),
              "choose another name");
    return false;
  }
  if (!meaning.empty()) {
    sink_.Add(DiagnosticKind::kOwnMeaning, name.range,
              absl::StrCat(Quote(name.text), " keeps the meaning given here; ", meaning,
                           " of the language has the same name"));
  }
  symbols_.emplace(name.text, std::move(symbol));
  return true;
}

const Symbol* Scope::Find(absl::string_view name) const {
  const auto found = symbols_.find(name);
  return found == symbols_.end() ? nullptr : &found->second;
}

std::vector<absl::string_view> Scope::names() const {
  std::vector<absl::string_view> out;
  for (const auto& [name, symbol] : symbols_) out.push_back(name);
  return out;
}

}  // namespace rips::lang

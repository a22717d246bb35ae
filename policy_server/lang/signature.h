// Every name of the language that a program does not declare, as data: the checker and the
// reference that `ripsctl rules builtins` prints read the same tables.
#ifndef RIPS_POLICY_SERVER_LANG_SIGNATURE_H_
#define RIPS_POLICY_SERVER_LANG_SIGNATURE_H_

#include <span>
#include <string>

#include "absl/strings/string_view.h"
#include "policy_server/lang/checked_rules.h"

namespace rips::lang {

// What a parameter means, beyond its type.
enum class ParameterRole {
  kPlain,
  kTopic,  // a topic's full name: one without a leading `/` never matches
  kRegex,  // RE2 syntax; must be constant
  kRangeMin,
  kRangeMax,
  kAnyType,  // the type does not matter
};

struct Parameter {
  absl::string_view name;
  ValueType type = ValueType::kString;
  ParameterRole role = ParameterRole::kPlain;
};

struct Signature {
  absl::string_view name;
  Builtin builtin;
  EventClass event_class;
  ValueType result;
  // In order, before `list`.
  std::span<const Parameter> parameters;
  // Any number of further arguments, none included; not there if its name is empty.
  Parameter list;
  // One of the forms whose meaning depends on the dialect.
  bool include_form = false;
  absl::string_view help;

  bool variadic() const { return !list.name.empty(); }
};

struct ActionSignature {
  absl::string_view name;
  ActionKind action;
  // For people: "alert(text [, severity])".
  absl::string_view usage;
  int args_min;
  // -1 if there is no limit.
  int args_max;
};

struct PredefinedName {
  absl::string_view name;
  Predefined predefined;
  ValueType type;
  // A program may declare the name as its own.
  bool extension;
};

// A name of the language that this version does not know how to judge.
struct UnavailableName {
  enum class Kind { kBuiltin, kAction, kPredefined };
  absl::string_view name;
  Kind kind;
  bool extension;
};

// In the order of enum Builtin.
std::span<const Signature> Signatures();
// In the order of enum ActionKind.
std::span<const ActionSignature> ActionSignatures();
// In the order of enum Predefined.
std::span<const PredefinedName> PredefinedNames();
std::span<const UnavailableName> UnavailableNames();

// Null if there is none of that name.
const Signature* FindSignature(absl::string_view name);
const ActionSignature* FindAction(absl::string_view name);
const PredefinedName* FindPredefined(absl::string_view name);
const UnavailableName* FindUnavailable(absl::string_view name);

const Signature& SignatureOf(Builtin builtin);

// "topicpublishercount(topic string, min int, max int)", "topicin(topics string...)".
std::string UsageOf(const Signature& signature);

// Severities of alerts, least severe first.
std::span<const absl::string_view> Severities();

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_LANG_SIGNATURE_H_

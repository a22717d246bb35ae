// Every name of the language that a program does not declare, as data: the checker and the
// reference that `ripsctl rules builtins` prints read the same tables.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_CHECK_SIGNATURE_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_CHECK_SIGNATURE_H_

#include <span>
#include <string>

#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::lang {

// What a parameter means, beyond its type.
enum class ParameterRole {
  kPlain,
  kTopic,     // a topic's full name: one without a leading `/` never matches
  kNode,      // a node's full name, or its base name
  kService,   // a service's full name
  kPackage,   // a package of message types
  kTypeName,  // a message type without its package
  kRegex,     // RE2 syntax; must be constant
  kRangeMin,
  kRangeMax,
  kAnyType,   // the type does not matter
  kWindow,    // milliseconds to look back; constant, 1 to kWindowMsMax
  kYaraFile,  // a path, seen from the rule file; constant
  kPluginId,  // constant
  kWord,      // one of Parameter::words, if it is constant
};

struct Parameter {
  absl::string_view name;
  ValueType type = ValueType::kString;
  ParameterRole role = ParameterRole::kPlain;
  // kWord: what it may be. Empty: it depends on the argument before.
  std::span<const absl::string_view> words = {};
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
  absl::string_view help;
  // Not in the paper's language: a program may declare the name as its own.
  bool extension = false;
  // One of the forms whose meaning depends on the dialect.
  bool include_form = false;

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
  // What it does, and when it has succeeded.
  absl::string_view help;
};

struct PredefinedName {
  absl::string_view name;
  Predefined predefined;
  EventClass event_class;
  ValueType type;
  // A program may declare the name as its own.
  bool extension;
  absl::string_view help;
};

// In the order of enum Builtin.
std::span<const Signature> Signatures();
// In the order of enum ActionKind.
std::span<const ActionSignature> ActionSignatures();
// In the order of enum Predefined.
std::span<const PredefinedName> PredefinedNames();

// Null if there is none of that name.
const Signature* FindSignature(absl::string_view name);
const ActionSignature* FindAction(absl::string_view name);
const PredefinedName* FindPredefined(absl::string_view name);

const Signature& SignatureOf(Builtin builtin);
const PredefinedName& PredefinedOf(Predefined predefined);

// "topicpublishercount(topic string, min int, max int)", "topicin(topics string...)".
std::string UsageOf(const Signature& signature);

// Severities of alerts, least severe first.
std::span<const absl::string_view> Severities();
// States that `agent(kind, state)` knows of that kind; empty for an unknown kind.
std::span<const absl::string_view> AgentStates(absl::string_view kind);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_CHECK_SIGNATURE_H_

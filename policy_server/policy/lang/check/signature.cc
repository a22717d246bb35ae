#include "policy_server/policy/lang/check/signature.h"

#include <algorithm>
#include <array>
#include <iterator>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/check/type.h"

namespace rips::lang {
namespace {

using enum EventClass;
constexpr ValueType kInt = ValueType::kInt;
constexpr ValueType kLevel = ValueType::kLevel;
constexpr ValueType kBool = ValueType::kBool;
constexpr ValueType kString = ValueType::kString;

constexpr absl::string_view kSignals[] = {"SIGUSR1", "SIGUSR2", "USR1", "USR2"};
constexpr absl::string_view kAgents[] = {"sensor", "actuator"};
constexpr absl::string_view kSensorStates[] = {"connected", "lost", "restarting", "overloaded",
                                               "clock_skew"};
constexpr absl::string_view kActuatorStates[] = {"connected", "lost", "drift", "failed",
                                                 "state_lost"};
constexpr absl::string_view kFindings[] = {
    "duplicate_node", "impostor",       "false_claim",     "foreign_mode_writer", "rival_server",
    "non_ros_writer", "non_ros_reader", "unauthenticated", "unicast_writer",      "spoofed_writer",
    "directed_data",  "two_contents",   "sequence_jump"};
// All of them together, then each.
constexpr auto kStandingFindings = [] {
  std::array<absl::string_view, std::size(kFindings) + 1> words = {"any"};
  std::copy(std::begin(kFindings), std::end(kFindings), words.begin() + 1);
  return words;
}();

constexpr Parameter kTopicParameter = {"topic", kString, ParameterRole::kTopic};
constexpr Parameter kMin = {"min", kInt, ParameterRole::kRangeMin};
constexpr Parameter kMax = {"max", kInt, ParameterRole::kRangeMax};
constexpr Parameter kNodeList = {"nodes", kString, ParameterRole::kNode};
constexpr Parameter kTopicList = {"topics", kString, ParameterRole::kTopic};
constexpr Parameter kServiceList = {"services", kString, ParameterRole::kService};
constexpr Parameter kEnclaveList = {"enclaves", kString};
constexpr Parameter kPackageList = {"packages", kString, ParameterRole::kPackage};
constexpr Parameter kNoList = {};

constexpr Parameter kRegex[] = {{"regex", kString, ParameterRole::kRegex}};
constexpr Parameter kRange[] = {kMin, kMax};
constexpr Parameter kSubtype[] = {{"package", kString, ParameterRole::kPackage},
                                  {"name", kString, ParameterRole::kTypeName}};
constexpr Parameter kPath[] = {{"path", kString, ParameterRole::kYaraFile}};
constexpr Parameter kId[] = {{"id", kString, ParameterRole::kPluginId}};
constexpr Parameter kWindowRange[] = {{"window_ms", kInt, ParameterRole::kWindow}, kMin, kMax};
constexpr Parameter kNode[] = {{"node", kString, ParameterRole::kNode}};
constexpr Parameter kTopic[] = {kTopicParameter};
constexpr Parameter kNodeRange[] = {{"node", kString, ParameterRole::kNode}, kMin, kMax};
constexpr Parameter kTopicRange[] = {kTopicParameter, kMin, kMax};
constexpr Parameter kNodeService[] = {{"node", kString, ParameterRole::kNode},
                                      {"service", kString, ParameterRole::kService}};
constexpr Parameter kText[] = {{"text", kString}};
constexpr Parameter kSignalName[] = {{"name", kString, ParameterRole::kWord, kSignals}};
constexpr Parameter kAgentState[] = {{"kind", kString, ParameterRole::kWord, kAgents},
                                     {"state", kString, ParameterRole::kWord}};
constexpr Parameter kFindingKind[] = {{"kind", kString, ParameterRole::kWord, kFindings}};
constexpr Parameter kStandingKind[] = {{"kind", kString, ParameterRole::kWord, kStandingFindings}};
constexpr Parameter kAtLeast[] = {{"min", kInt}};
constexpr Parameter kLevelArg[] = {{"level", kInt}};
constexpr Parameter kAny[] = {{"x", kInt, ParameterRole::kAnyType}};
constexpr Parameter kComparison[] = {{"var", kString}, {"operator", kString}, {"value", kString}};

constexpr std::span<const Parameter> kNone = {};
constexpr bool kExtension = true;
constexpr bool kPaper = false;

constexpr Signature kSignatures[] = {
#define RIPS_BUILTIN(name, spelling, event_class, result, parameters, list, origin, help) \
  {spelling, Builtin::k##name, event_class, result, parameters, list, help, origin},
#define RIPS_QUESTION(name, spelling, event_class, parameters, list, origin, help, source, \
                      subject, form, prototype)                                            \
  {spelling, Builtin::k##name, event_class,                                                \
   kBool,    parameters,       list,                                                       \
   help,     origin,           absl::string_view(#form) != absl::string_view(#prototype)},
#include "policy_server/policy/lang/builtin.def"
};

constexpr ActionSignature kActions[] = {
    {"alert", ActionKind::kAlert, "alert(text [, severity])", 1, 2,
     "records and publishes an alert; succeeds when it is accepted for recording"},
    {"set", ActionKind::kSet, "set(variable, value)", 2, 2,
     "assigns a variable a value of its type; always succeeds"},
    {"exec", ActionKind::kExec, "exec(program, args...)", 1, -1,
     "runs the program on the robot; succeeds when it exits 0 in time"},
    {"trigger", ActionKind::kTrigger, "trigger(level)", 1, 1,
     "asks for the level; succeeds when the robot is verified to be there"},
    {"True", ActionKind::kTrue, "True(args...)", 0, -1, "logs the values; always succeeds"},
    {"False", ActionKind::kFalse, "False(args...)", 0, -1, "logs the values; always fails"},
    {"crash", ActionKind::kCrash, "crash(text)", 1, 1,
     "critical alert, the last level, and no rule of this robot runs until an operator resumes "
     "them; never succeeds"},
};

constexpr PredefinedName kPredefined[] = {
#define RIPS_PREDEFINED(name, event_class, type, origin, help) \
  {#name, Predefined::k##name, event_class, type, origin, help},
#include "policy_server/policy/lang/predefined.def"
};

constexpr absl::string_view kSeverities[] = {"info", "low", "medium", "high", "critical"};

template <typename Entry>
const Entry* Find(std::span<const Entry> table, absl::string_view name) {
  for (const Entry& entry : table) {
    if (entry.name == name) return &entry;
  }
  return nullptr;
}

}  // namespace

std::span<const Signature> Signatures() { return kSignatures; }
std::span<const ActionSignature> ActionSignatures() { return kActions; }
std::span<const PredefinedName> PredefinedNames() { return kPredefined; }

const Signature* FindSignature(absl::string_view name) { return Find(Signatures(), name); }
const ActionSignature* FindAction(absl::string_view name) { return Find(ActionSignatures(), name); }
const PredefinedName* FindPredefined(absl::string_view name) {
  return Find(PredefinedNames(), name);
}

const PredefinedName& PredefinedOf(Predefined predefined) {
  return kPredefined[static_cast<size_t>(predefined)];
}

const Signature& SignatureOf(Builtin builtin) { return kSignatures[static_cast<size_t>(builtin)]; }

std::string UsageOf(const Signature& signature) {
  std::string out = absl::StrCat(signature.name, "(");
  absl::string_view separator;
  for (const Parameter& parameter : signature.parameters) {
    const bool any = parameter.role == ParameterRole::kAnyType;
    absl::StrAppend(&out, separator, parameter.name, any ? "" : " ",
                    any ? "" : Name(parameter.type));
    separator = ", ";
  }
  if (signature.variadic()) {
    absl::StrAppend(&out, separator, signature.list.name, " ", Name(signature.list.type), "...");
  }
  return out + ")";
}

std::span<const absl::string_view> Severities() { return kSeverities; }

std::span<const absl::string_view> AgentStates(absl::string_view kind) {
  if (kind == "sensor") return kSensorStates;
  if (kind == "actuator") return kActuatorStates;
  return {};
}

}  // namespace rips::lang

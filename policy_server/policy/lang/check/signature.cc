#include "policy_server/policy/lang/check/signature.h"

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/check/type.h"

namespace rips::lang {
namespace {

using enum EventClass;
constexpr ValueType kInt = ValueType::kInt;
constexpr ValueType kBool = ValueType::kBool;
constexpr ValueType kString = ValueType::kString;

constexpr absl::string_view kSignals[] = {"SIGUSR1", "SIGUSR2", "USR1", "USR2"};
constexpr absl::string_view kAgents[] = {"sensor", "actuator"};
constexpr absl::string_view kSensorStates[] = {"connected", "lost", "restarting", "overloaded",
                                               "clock_skew"};
constexpr absl::string_view kActuatorStates[] = {"connected", "lost", "drift", "failed",
                                                 "state_lost"};
constexpr absl::string_view kFindings[] = {
    "duplicate_node",  "impostor",       "false_claim",    "foreign_mode_writer", "non_ros_writer",
    "unauthenticated", "unicast_writer", "spoofed_writer", "directed_data"};

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
constexpr Parameter kAtLeast[] = {{"min", kInt}};
constexpr Parameter kLevelArg[] = {{"level", kInt}};
constexpr Parameter kAny[] = {{"x", kInt, ParameterRole::kAnyType}};
constexpr Parameter kComparison[] = {{"var", kString}, {"operator", kString}, {"value", kString}};

constexpr std::span<const Parameter> kNone = {};
constexpr bool kExtension = true;
constexpr bool kPaper = false;
constexpr bool kIncludeForm = true;

// RIPS paper, "Subexpressions for message events" and "Subexpressions for graph events".
constexpr Signature kSignatures[] = {
    {"topicin", Builtin::kTopicIn, kMsg, kBool, kNone, kTopicList,
     "the message's topic is one of them"},
    {"topicmatches", Builtin::kTopicMatches, kMsg, kBool, kRegex, kNoList,
     "RE2 search finds the pattern in the topic's full name"},
    {"publishercount", Builtin::kPublisherCount, kMsg, kBool, kRange, kNoList,
     "the number of publishers of this topic is in the range"},
    {"subscribercount", Builtin::kSubscriberCount, kMsg, kBool, kRange, kNoList,
     "the number of subscribers of this topic is in the range"},
    {"publishersinclude", Builtin::kPublishersInclude, kMsg, kBool, kNone, kNodeList,
     "every given node publishes to this topic"},
    {"subscribersinclude", Builtin::kSubscribersInclude, kMsg, kBool, kNone, kNodeList,
     "every given node subscribes to this topic", kPaper, kIncludeForm},
    {"publishers", Builtin::kPublishers, kMsg, kBool, kNone, kNodeList,
     "exactly those nodes publish to this topic"},
    {"subscribers", Builtin::kSubscribers, kMsg, kBool, kNone, kNodeList,
     "exactly those nodes subscribe to this topic"},
    {"msgtypein", Builtin::kMsgTypeIn, kMsg, kBool, kNone, kPackageList,
     "the package of the message's type is one of them"},
    {"msgsubtype", Builtin::kMsgSubtype, kMsg, kBool, kSubtype, kNoList,
     "the message's type is package/msg/name"},
    {"payload", Builtin::kPayload, kMsg, kBool, kPath, kNoList,
     "a YARA rule of that file matches the serialized payload"},
    {"plugin", Builtin::kPlugin, kMsg, kBool, kId, kNoList,
     "the plugin, given the message, says so"},
    {"senderenclave", Builtin::kSenderEnclave, kMsg, kBool, kNone, kEnclaveList,
     "the writer's authenticated SROS2 enclave is one of them", kExtension},
    {"senderin", Builtin::kSenderIn, kMsg, kBool, kNone, kNodeList,
     "the node that wrote this very message is one of them", kExtension},
    {"payloadsize", Builtin::kPayloadSize, kMsg, kBool, kRange, kNoList,
     "the serialized size in bytes is in the range", kExtension},
    {"msgcount", Builtin::kMsgCount, kMsg, kBool, kWindowRange, kNoList,
     "the number of messages on this topic in the last window_ms, this one included, is in the "
     "range",
     kExtension},
    {"sendercount", Builtin::kSenderCount, kMsg, kBool, kWindowRange, kNoList,
     "the number of messages of this message's writer on this topic in the last window_ms, this "
     "one included, is in the range",
     kExtension},
    {"nodes", Builtin::kNodes, kGraph, kBool, kNone, kNodeList, "the nodes are exactly those"},
    {"topics", Builtin::kTopics, kGraph, kBool, kNone, kTopicList, "the topics are exactly those"},
    {"services", Builtin::kServices, kGraph, kBool, kNode, kServiceList,
     "the node's services are exactly those"},
    {"topicpublishers", Builtin::kTopicPublishers, kGraph, kBool, kTopic, kNodeList,
     "exactly those nodes publish to the topic"},
    {"topicsubscribers", Builtin::kTopicSubscribers, kGraph, kBool, kTopic, kNodeList,
     "exactly those nodes subscribe to the topic"},
    {"nodecount", Builtin::kNodeCount, kGraph, kBool, kRange, kNoList,
     "the number of nodes is in the range"},
    {"topiccount", Builtin::kTopicCount, kGraph, kBool, kRange, kNoList,
     "the number of topics is in the range"},
    {"servicecount", Builtin::kServiceCount, kGraph, kBool, kNodeRange, kNoList,
     "the number of the node's services is in the range"},
    {"topicpublishercount", Builtin::kTopicPublisherCount, kGraph, kBool, kTopicRange, kNoList,
     "the number of the topic's publishers is in the range"},
    {"topicsubscribercount", Builtin::kTopicSubscriberCount, kGraph, kBool, kTopicRange, kNoList,
     "the number of the topic's subscribers is in the range"},
    {"service", Builtin::kService, kGraph, kBool, kNodeService, kNoList,
     "the node offers the service"},
    {"nodesinclude", Builtin::kNodesInclude, kGraph, kBool, kNone, kNodeList,
     "the current nodes are all among those", kPaper, kIncludeForm},
    {"topicsinclude", Builtin::kTopicsInclude, kGraph, kBool, kNone, kTopicList,
     "the current topics are all among those", kPaper, kIncludeForm},
    {"servicesinclude", Builtin::kServicesInclude, kGraph, kBool, kNode, kServiceList,
     "the node's services are all among those", kPaper, kIncludeForm},
    {"topicpublishersinclude", Builtin::kTopicPublishersInclude, kGraph, kBool, kTopic, kNodeList,
     "the topic's publishers are all among those", kPaper, kIncludeForm},
    {"topicsubscribersinclude", Builtin::kTopicSubscribersInclude, kGraph, kBool, kTopic, kNodeList,
     "the topic's subscribers are all among those", kPaper, kIncludeForm},
    {"nodesonly", Builtin::kNodesOnly, kGraph, kBool, kNone, kNodeList,
     "the current nodes are all among those, in either dialect", kExtension},
    {"topicsonly", Builtin::kTopicsOnly, kGraph, kBool, kNone, kTopicList,
     "the current topics are all among those, in either dialect", kExtension},
    {"servicesonly", Builtin::kServicesOnly, kGraph, kBool, kNode, kServiceList,
     "the node's services are all among those, in either dialect", kExtension},
    {"topicpublishersonly", Builtin::kTopicPublishersOnly, kGraph, kBool, kTopic, kNodeList,
     "the topic's publishers are all among those, in either dialect", kExtension},
    {"topicsubscribersonly", Builtin::kTopicSubscribersOnly, kGraph, kBool, kTopic, kNodeList,
     "the topic's subscribers are all among those, in either dialect", kExtension},
    {"hasnodes", Builtin::kHasNodes, kGraph, kBool, kNone, kNodeList,
     "those are all among the current nodes, in either dialect", kExtension},
    {"hastopics", Builtin::kHasTopics, kGraph, kBool, kNone, kTopicList,
     "those are all among the current topics, in either dialect", kExtension},
    {"hasservices", Builtin::kHasServices, kGraph, kBool, kNode, kServiceList,
     "those are all among the node's services, in either dialect", kExtension},
    {"hastopicpublishers", Builtin::kHasTopicPublishers, kGraph, kBool, kTopic, kNodeList,
     "those are all among the topic's publishers, in either dialect", kExtension},
    {"hastopicsubscribers", Builtin::kHasTopicSubscribers, kGraph, kBool, kTopic, kNodeList,
     "those are all among the topic's subscribers, in either dialect", kExtension},
    {"idsalert", Builtin::kIdsAlert, kExternal, kBool, kText, kNoList,
     "the event is an alert of the host's IDS whose signature id (`N` or `G:N`) or message "
     "contains the text"},
    {"signal", Builtin::kSignal, kExternal, kBool, kSignalName, kNoList,
     "the event is that signal: SIGUSR1 or SIGUSR2"},
    {"agent", Builtin::kAgent, kExternal, kBool, kAgentState, kNoList,
     "the event is that change of state of this robot's sensor or actuator", kExtension},
    {"finding", Builtin::kFinding, kExternal, kBool, kFindingKind, kNoList,
     "the event is that finding of a sensor", kExtension},
    {"lostevents", Builtin::kLostEvents, kExternal, kBool, kAtLeast, kNoList,
     "a sensor reports at least min events dropped since its last report", kExtension},
    {"levelname", Builtin::kLevelName, kUniversal, kString, kLevelArg, kNoList,
     "the name of the level at that position, empty when there is none"},
    {"string", Builtin::kString, kUniversal, kString, kAny, kNoList, "x as text"},
    {"eval", Builtin::kEval, kUniversal, kBool, kComparison, kNoList,
     "the same as writing `var operator value`; three string literals and one of the six "
     "comparisons"},
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
    {"CurrLevel", Predefined::kCurrLevel, kUniversal, ValueType::kLevel, kPaper,
     "the current level"},
    {"Level", Predefined::kLevel, kUniversal, kString, kExtension, "the name of the current level"},
    {"Time", Predefined::kTime, kUniversal, kInt, kPaper,
     "nanoseconds since the Unix epoch, of the event; never goes back"},
    {"Uptime", Predefined::kUptime, kUniversal, kInt, kPaper,
     "nanoseconds since the server began to judge this robot"},
    {"CurrRule", Predefined::kCurrRule, kUniversal, kString, kPaper, "the name of the rule"},
    {"Robot", Predefined::kRobot, kUniversal, kString, kExtension, "the robot's id"},
    {"Topic", Predefined::kTopic, kMsg, kString, kExtension, "the message's topic"},
    {"MsgType", Predefined::kMsgType, kMsg, kString, kExtension,
     "the message's type, `std_msgs/msg/String`"},
    {"Sender", Predefined::kSender, kMsg, kString, kExtension,
     "full name of the node that wrote the message, empty if it is not attributed"},
    {"SenderGuid", Predefined::kSenderGuid, kMsg, kString, kExtension,
     "GUID of the writer, `01104a3b.00000000.00000000.000003c1`"},
    {"IdsSource", Predefined::kIdsSource, kExternal, kString, kExtension,
     "source address of the IDS alert, empty for other events"},
    {"IdsTarget", Predefined::kIdsTarget, kExternal, kString, kExtension,
     "destination address of the IDS alert, empty for other events"},
};

// SignatureOf and NameOf use the enums as positions.
template <typename Row, size_t kSize, typename Key>
constexpr bool IsInOrder(const Row (&table)[kSize], Key Row::*key, Key last) {
  for (size_t i = 0; i < kSize; ++i) {
    if (static_cast<size_t>(table[i].*key) != i) return false;
  }
  return kSize == static_cast<size_t>(last) + 1;
}
static_assert(IsInOrder(kSignatures, &Signature::builtin, Builtin::kEval),
              "give each Builtin its row, in the order of the enum");
static_assert(IsInOrder(kActions, &ActionSignature::action, ActionKind::kCrash),
              "give each ActionKind its row, in the order of the enum");
static_assert(IsInOrder(kPredefined, &PredefinedName::predefined, Predefined::kIdsTarget),
              "give each Predefined its row, in the order of the enum");

constexpr EventClass BlockOf(Builtin builtin) {
  if (builtin < Builtin::kNodes) return kMsg;
  if (builtin < Builtin::kIdsAlert) return kGraph;
  return builtin < Builtin::kLevelName ? kExternal : kUniversal;
}
// External builtins count from kIdsAlert on: Reach::needs has one bit for each.
constexpr bool StandInTheirBlocks() {
  for (const Signature& each : kSignatures) {
    if (each.event_class != BlockOf(each.builtin)) return false;
  }
  return static_cast<int>(Builtin::kLevelName) - static_cast<int>(Builtin::kIdsAlert) <= 32;
}
static_assert(StandInTheirBlocks(), "put each Builtin into the block of its event class");

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

absl::string_view NameOf(Predefined predefined) {
  return kPredefined[static_cast<size_t>(predefined)].name;
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

#include "policy_server/lang/signature.h"

#include "absl/strings/str_cat.h"
#include "policy_server/lang/type.h"

namespace rips::lang {
namespace {

using enum EventClass;
constexpr ValueType kInt = ValueType::kInt;
constexpr ValueType kBool = ValueType::kBool;
constexpr ValueType kString = ValueType::kString;

constexpr Parameter kTopicParameter = {"topic", kString, ParameterRole::kTopic};
constexpr Parameter kMin = {"min", kInt, ParameterRole::kRangeMin};
constexpr Parameter kMax = {"max", kInt, ParameterRole::kRangeMax};
constexpr Parameter kNodeList = {"nodes", kString};
constexpr Parameter kTopicList = {"topics", kString, ParameterRole::kTopic};
constexpr Parameter kServiceList = {"services", kString};

constexpr Parameter kRegex[] = {{"regex", kString, ParameterRole::kRegex}};
constexpr Parameter kRange[] = {kMin, kMax};
constexpr Parameter kSubtype[] = {{"package", kString}, {"name", kString}};
constexpr Parameter kNode[] = {{"node", kString}};
constexpr Parameter kTopic[] = {kTopicParameter};
constexpr Parameter kNodeRange[] = {{"node", kString}, kMin, kMax};
constexpr Parameter kTopicRange[] = {kTopicParameter, kMin, kMax};
constexpr Parameter kNodeService[] = {{"node", kString}, {"service", kString}};
constexpr Parameter kLevelArg[] = {{"level", kInt}};
constexpr Parameter kAny[] = {{"x", kInt, ParameterRole::kAnyType}};

// RIPS paper, "Subexpressions for message events" and "Subexpressions for graph events".
constexpr Signature kSignatures[] = {
    {"topicin",
     Builtin::kTopicIn,
     kMsg,
     kBool,
     {},
     kTopicList,
     false,
     "the message's topic is one of them"},
    {"topicmatches",
     Builtin::kTopicMatches,
     kMsg,
     kBool,
     kRegex,
     {},
     false,
     "RE2 search finds the pattern in the topic's full name"},
    {"publishercount",
     Builtin::kPublisherCount,
     kMsg,
     kBool,
     kRange,
     {},
     false,
     "the number of publishers of this topic is in the range"},
    {"subscribercount",
     Builtin::kSubscriberCount,
     kMsg,
     kBool,
     kRange,
     {},
     false,
     "the number of subscribers of this topic is in the range"},
    {"publishersinclude",
     Builtin::kPublishersInclude,
     kMsg,
     kBool,
     {},
     kNodeList,
     false,
     "every given node publishes to this topic"},
    {"subscribersinclude",
     Builtin::kSubscribersInclude,
     kMsg,
     kBool,
     {},
     kNodeList,
     true,
     "every given node subscribes to this topic"},
    {"publishers",
     Builtin::kPublishers,
     kMsg,
     kBool,
     {},
     kNodeList,
     false,
     "exactly those nodes publish to this topic"},
    {"subscribers",
     Builtin::kSubscribers,
     kMsg,
     kBool,
     {},
     kNodeList,
     false,
     "exactly those nodes subscribe to this topic"},
    {"msgtypein",
     Builtin::kMsgTypeIn,
     kMsg,
     kBool,
     {},
     {"packages", kString},
     false,
     "the package of the message's type is one of them"},
    {"msgsubtype",
     Builtin::kMsgSubtype,
     kMsg,
     kBool,
     kSubtype,
     {},
     false,
     "the message's type is package/msg/name"},
    {"nodes", Builtin::kNodes, kGraph, kBool, {}, kNodeList, false, "the nodes are exactly those"},
    {"topics",
     Builtin::kTopics,
     kGraph,
     kBool,
     {},
     kTopicList,
     false,
     "the topics are exactly those"},
    {"services", Builtin::kServices, kGraph, kBool, kNode, kServiceList, false,
     "the node's services are exactly those"},
    {"topicpublishers", Builtin::kTopicPublishers, kGraph, kBool, kTopic, kNodeList, false,
     "exactly those nodes publish to the topic"},
    {"topicsubscribers", Builtin::kTopicSubscribers, kGraph, kBool, kTopic, kNodeList, false,
     "exactly those nodes subscribe to the topic"},
    {"nodecount",
     Builtin::kNodeCount,
     kGraph,
     kBool,
     kRange,
     {},
     false,
     "the number of nodes is in the range"},
    {"topiccount",
     Builtin::kTopicCount,
     kGraph,
     kBool,
     kRange,
     {},
     false,
     "the number of topics is in the range"},
    {"servicecount",
     Builtin::kServiceCount,
     kGraph,
     kBool,
     kNodeRange,
     {},
     false,
     "the number of the node's services is in the range"},
    {"topicpublishercount",
     Builtin::kTopicPublisherCount,
     kGraph,
     kBool,
     kTopicRange,
     {},
     false,
     "the number of the topic's publishers is in the range"},
    {"topicsubscribercount",
     Builtin::kTopicSubscriberCount,
     kGraph,
     kBool,
     kTopicRange,
     {},
     false,
     "the number of the topic's subscribers is in the range"},
    {"service",
     Builtin::kService,
     kGraph,
     kBool,
     kNodeService,
     {},
     false,
     "the node offers the service"},
    {"nodesinclude",
     Builtin::kNodesInclude,
     kGraph,
     kBool,
     {},
     kNodeList,
     true,
     "the current nodes are all among those"},
    {"topicsinclude",
     Builtin::kTopicsInclude,
     kGraph,
     kBool,
     {},
     kTopicList,
     true,
     "the current topics are all among those"},
    {"servicesinclude", Builtin::kServicesInclude, kGraph, kBool, kNode, kServiceList, true,
     "the node's services are all among those"},
    {"topicpublishersinclude", Builtin::kTopicPublishersInclude, kGraph, kBool, kTopic, kNodeList,
     true, "the topic's publishers are all among those"},
    {"topicsubscribersinclude", Builtin::kTopicSubscribersInclude, kGraph, kBool, kTopic, kNodeList,
     true, "the topic's subscribers are all among those"},
    {"levelname",
     Builtin::kLevelName,
     kUniversal,
     kString,
     kLevelArg,
     {},
     false,
     "the name of the level at that position, empty when there is none"},
    {"string", Builtin::kString, kUniversal, kString, kAny, {}, false, "x as text"},
};

constexpr ActionSignature kActions[] = {
    {"alert", ActionKind::kAlert, "alert(text [, severity])", 1, 2},
    {"set", ActionKind::kSet, "set(variable, value)", 2, 2},
    {"exec", ActionKind::kExec, "exec(program, args...)", 1, -1},
    {"trigger", ActionKind::kTrigger, "trigger(level)", 1, 1},
};

constexpr PredefinedName kPredefined[] = {
    {"CurrLevel", Predefined::kCurrLevel, ValueType::kLevel, false},
    {"Level", Predefined::kLevel, kString, true},
    {"Time", Predefined::kTime, kInt, false},
    {"Uptime", Predefined::kUptime, kInt, false},
    {"CurrRule", Predefined::kCurrRule, kString, false},
};

using Unavailable = UnavailableName::Kind;
constexpr UnavailableName kUnavailable[] = {
    {"payload", Unavailable::kBuiltin, false},
    {"plugin", Unavailable::kBuiltin, false},
    {"eval", Unavailable::kBuiltin, false},
    {"idsalert", Unavailable::kBuiltin, false},
    {"signal", Unavailable::kBuiltin, false},
    {"senderenclave", Unavailable::kBuiltin, true},
    {"senderin", Unavailable::kBuiltin, true},
    {"payloadsize", Unavailable::kBuiltin, true},
    {"msgcount", Unavailable::kBuiltin, true},
    {"sendercount", Unavailable::kBuiltin, true},
    {"agent", Unavailable::kBuiltin, true},
    {"finding", Unavailable::kBuiltin, true},
    {"lostevents", Unavailable::kBuiltin, true},
    {"nodesonly", Unavailable::kBuiltin, true},
    {"topicsonly", Unavailable::kBuiltin, true},
    {"servicesonly", Unavailable::kBuiltin, true},
    {"topicpublishersonly", Unavailable::kBuiltin, true},
    {"topicsubscribersonly", Unavailable::kBuiltin, true},
    {"hasnodes", Unavailable::kBuiltin, true},
    {"hastopics", Unavailable::kBuiltin, true},
    {"hasservices", Unavailable::kBuiltin, true},
    {"hastopicpublishers", Unavailable::kBuiltin, true},
    {"hastopicsubscribers", Unavailable::kBuiltin, true},
    {"True", Unavailable::kAction, false},
    {"False", Unavailable::kAction, false},
    {"crash", Unavailable::kAction, false},
    {"Robot", Unavailable::kPredefined, true},
    {"Topic", Unavailable::kPredefined, true},
    {"MsgType", Unavailable::kPredefined, true},
    {"Sender", Unavailable::kPredefined, true},
    {"SenderGuid", Unavailable::kPredefined, true},
    {"IdsSource", Unavailable::kPredefined, true},
    {"IdsTarget", Unavailable::kPredefined, true},
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
std::span<const UnavailableName> UnavailableNames() { return kUnavailable; }

const Signature* FindSignature(absl::string_view name) { return Find(Signatures(), name); }
const ActionSignature* FindAction(absl::string_view name) { return Find(ActionSignatures(), name); }
const PredefinedName* FindPredefined(absl::string_view name) {
  return Find(PredefinedNames(), name);
}
const UnavailableName* FindUnavailable(absl::string_view name) {
  return Find(UnavailableNames(), name);
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

}  // namespace rips::lang

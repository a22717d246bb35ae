#include "policy_server/policy/engine/builtins/builtins.h"

#include <algorithm>
#include <iterator>
#include <limits>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/match.h"
#include "policy_server/policy/engine/builtins/name_set.h"

namespace rips::engine {
namespace {

using lang::Builtin;
using Args = absl::Span<const Scalar>;

enum class Relation { kExactly, kCurrentInGiven, kGivenInCurrent };

std::optional<absl::string_view> Text(Args args, size_t i) {
  if (i >= args.size()) return std::nullopt;
  const auto* text = std::get_if<absl::string_view>(&args[i]);
  if (text == nullptr) return std::nullopt;
  return *text;
}

// The two last arguments, behind `from` others, as an inclusive range.
struct Range {
  int64_t min = 0;
  int64_t max = 0;
};

std::optional<Range> RangeOf(Args args, size_t from) {
  if (args.size() != from + 2) return std::nullopt;
  const auto* min = std::get_if<int64_t>(&args[from]);
  const auto* max = std::get_if<int64_t>(&args[from + 1]);
  if (min == nullptr || max == nullptr) return std::nullopt;
  return Range{.min = *min, .max = *max};
}

const std::string& NameOf(const std::string& name) { return name; }
const std::string& NameOf(const ros2::Node& node) { return node.full_name; }
const std::string& NameOf(const std::pair<const std::string, ros2::Topic>& topic) {
  return topic.first;
}

// How the names from args[from] on compare with those in `current`.
template <typename Range>
std::optional<bool> Compare(NameSet::Kind kind, Args args, size_t from, const Range& current,
                            Relation relation, bool truncated) {
  NameSet names(kind);
  for (size_t i = from; i < args.size(); ++i) {
    const std::optional<absl::string_view> name = Text(args, i);
    if (!name.has_value()) return std::nullopt;
    names.Add(*name);
  }
  names.Seal();
  for (const auto& item : current) names.See(NameOf(item));
  switch (relation) {
    case Relation::kExactly:
      return !truncated && names.AllCurrentGiven() && names.AllGivenCurrent();
    case Relation::kCurrentInGiven:
      return !truncated && names.AllCurrentGiven();
    case Relation::kGivenInCurrent:
      return names.AllGivenCurrent();
  }
  return std::nullopt;
}

// Services of every node that `name` means.
std::vector<std::string> ServicesOf(absl::string_view name, const ros2::RosGraph& graph) {
  std::vector<std::string> services;
  const std::string* last = nullptr;
  for (const ros2::Node& node : graph.nodes()) {
    // Nodes are sorted by name; those of one name are answered together.
    if (last != nullptr && *last == node.full_name) continue;
    if (!ros2::NodeNameMatches(name, node.full_name)) continue;
    last = &node.full_name;
    std::vector<std::string> more = graph.ServicesOf(node.full_name);
    services.insert(services.end(), std::make_move_iterator(more.begin()),
                    std::make_move_iterator(more.end()));
  }
  return services;
}

// What a set form asks. Nullopt for builtins that compare no sets.
std::optional<Relation> RelationOf(Builtin builtin, bool prototype) {
  switch (builtin) {
    case Builtin::kPublishers:
    case Builtin::kSubscribers:
    case Builtin::kNodes:
    case Builtin::kTopics:
    case Builtin::kServices:
    case Builtin::kTopicPublishers:
    case Builtin::kTopicSubscribers:
      return Relation::kExactly;
    case Builtin::kPublishersInclude:
      return Relation::kGivenInCurrent;
    case Builtin::kSubscribersInclude:
      return prototype ? Relation::kCurrentInGiven : Relation::kGivenInCurrent;
    case Builtin::kNodesInclude:
    case Builtin::kTopicsInclude:
    case Builtin::kServicesInclude:
    case Builtin::kTopicPublishersInclude:
    case Builtin::kTopicSubscribersInclude:
      return prototype ? Relation::kGivenInCurrent : Relation::kCurrentInGiven;
    case Builtin::kNodesOnly:
    case Builtin::kTopicsOnly:
    case Builtin::kServicesOnly:
    case Builtin::kTopicPublishersOnly:
    case Builtin::kTopicSubscribersOnly:
      return Relation::kCurrentInGiven;
    case Builtin::kHasNodes:
    case Builtin::kHasTopics:
    case Builtin::kHasServices:
    case Builtin::kHasTopicPublishers:
    case Builtin::kHasTopicSubscribers:
      return Relation::kGivenInCurrent;
    default:
      return std::nullopt;
  }
}

std::optional<bool> EvaluateServices(Builtin builtin, Args args, const EvalContext& scene) {
  const std::optional<absl::string_view> node = Text(args, 0);
  if (!node.has_value()) return std::nullopt;
  const std::vector<std::string> services = ServicesOf(*node, scene.graph);
  if (builtin == Builtin::kService) {
    const std::optional<absl::string_view> service = Text(args, 1);
    if (!service.has_value() || args.size() != 2) return std::nullopt;
    return std::find(services.begin(), services.end(), *service) != services.end();
  }
  const auto relation = RelationOf(builtin, scene.prototype());
  if (!relation.has_value()) return std::nullopt;
  return Compare(NameSet::Kind::kPlain, args, 1, services, *relation, scene.truncated());
}

const std::vector<std::string>& Nobody() {
  static const auto* const kNobody = new std::vector<std::string>();
  return *kNobody;
}
const std::vector<std::string>& Publishers(const ros2::Topic* topic) {
  return topic == nullptr ? Nobody() : topic->publishers;
}
const std::vector<std::string>& Subscribers(const ros2::Topic* topic) {
  return topic == nullptr ? Nobody() : topic->subscribers;
}

// Who publishes on, or subscribes to, the topic that is the first argument.
std::optional<bool> EvaluateTopic(Builtin builtin, Args args, const EvalContext& scene) {
  const std::optional<absl::string_view> name = Text(args, 0);
  if (!name.has_value()) return std::nullopt;
  const ros2::Topic* topic = scene.graph.FindTopic(*name);
  const auto relation = RelationOf(builtin, scene.prototype());
  if (!relation.has_value()) return std::nullopt;
  const bool publishers =
      builtin == Builtin::kTopicPublishers || builtin == Builtin::kTopicPublishersInclude ||
      builtin == Builtin::kTopicPublishersOnly || builtin == Builtin::kHasTopicPublishers;
  return Compare(NameSet::Kind::kNodes, args, 1,
                 publishers ? Publishers(topic) : Subscribers(topic), *relation, scene.truncated());
}

// Those that are there, of a builtin that counts; nullopt for others.
std::optional<size_t> Counted(Builtin builtin, Args args, const EvalContext& scene) {
  const absl::string_view subject = Text(args, 0).value_or(absl::string_view());
  switch (builtin) {
    case Builtin::kPublisherCount:
      return Publishers(scene.facts).size();
    case Builtin::kSubscriberCount:
      return Subscribers(scene.facts).size();
    case Builtin::kNodeCount:
      return scene.graph.nodes().size();
    case Builtin::kTopicCount:
      return scene.graph.topics().size();
    case Builtin::kServiceCount:
      return ServicesOf(subject, scene.graph).size();
    case Builtin::kTopicPublisherCount:
      return Publishers(scene.graph.FindTopic(subject)).size();
    case Builtin::kTopicSubscriberCount:
      return Subscribers(scene.graph.FindTopic(subject)).size();
    default:
      return std::nullopt;
  }
}

bool CountsOfSubject(Builtin builtin) {
  return builtin == Builtin::kServiceCount || builtin == Builtin::kTopicPublisherCount ||
         builtin == Builtin::kTopicSubscriberCount;
}

// The range of a builtin that counts.
std::optional<Range> CountRange(Builtin builtin, Args args) {
  const bool subject = CountsOfSubject(builtin);
  if (subject && !Text(args, 0).has_value()) return std::nullopt;
  return RangeOf(args, subject ? 1 : 0);
}

std::optional<bool> EvaluateCount(Builtin builtin, Args args, const EvalContext& scene) {
  const std::optional<Range> range = CountRange(builtin, args);
  const std::optional<size_t> count = Counted(builtin, args, scene);
  if (!range.has_value() || !count.has_value()) return std::nullopt;
  const auto n = static_cast<int64_t>(*count);
  return range->min <= n && n <= range->max;
}

// Between n and n + left_out are there.
bool CountLeftOpen(Builtin builtin, Args args, const EvalContext& scene) {
  const std::optional<Range> range = CountRange(builtin, args);
  const std::optional<size_t> count = Counted(builtin, args, scene);
  if (!range.has_value() || !count.has_value() || range->min > range->max) return false;
  const auto least = static_cast<int64_t>(*count);
  const auto room = static_cast<uint64_t>(std::numeric_limits<int64_t>::max() - least);
  const int64_t most = least + static_cast<int64_t>(std::min(scene.graph.left_out(), room));
  if (least > range->max || most < range->min) return false;
  return least < range->min || most > range->max;
}

// Is any of the arguments `text` (whole), or the package of one of the types?
std::optional<bool> AnyIs(Args args, absl::string_view text) {
  bool found = false;
  for (size_t i = 0; i < args.size(); ++i) {
    const std::optional<absl::string_view> arg = Text(args, i);
    if (!arg.has_value()) return std::nullopt;
    found |= *arg == text;
  }
  return found;
}

std::optional<bool> TypeIn(Args args, const EvalContext& scene) {
  bool found = false;
  for (const absl::string_view type : scene.types) {
    const std::optional<bool> is = AnyIs(args, type.substr(0, type.find('/')));
    if (!is.has_value()) return std::nullopt;
    found |= *is;
  }
  return found;
}

std::optional<bool> SubtypeIs(Args args, const EvalContext& scene) {
  const std::optional<absl::string_view> package = Text(args, 0);
  const std::optional<absl::string_view> name = Text(args, 1);
  if (!package.has_value() || !name.has_value() || args.size() != 2) return std::nullopt;
  constexpr absl::string_view kBetween = "/msg/";
  return std::any_of(scene.types.begin(), scene.types.end(), [&](absl::string_view type) {
    return type.size() == package->size() + kBetween.size() + name->size() &&
           absl::StartsWith(type, *package) && absl::EndsWith(type, *name) &&
           type.substr(package->size(), kBetween.size()) == kBetween;
  });
}

}  // namespace

bool LeftOpen(Builtin builtin, Args args, const EvalContext& scene) {
  if (!scene.graph.truncated()) return false;
  switch (builtin) {
    case Builtin::kTopicIn:
    case Builtin::kMsgTypeIn:
    case Builtin::kMsgSubtype:
      return false;
    case Builtin::kPublisherCount:
    case Builtin::kSubscriberCount:
    case Builtin::kNodeCount:
    case Builtin::kTopicCount:
    case Builtin::kServiceCount:
    case Builtin::kTopicPublisherCount:
    case Builtin::kTopicSubscriberCount:
      return CountLeftOpen(builtin, args, scene);
    case Builtin::kService:
      return !Ask(builtin, args, scene).value_or(true);
    default:
      break;
  }
  const auto relation = RelationOf(builtin, scene.prototype());
  if (!relation.has_value() || *relation == Relation::kExactly) return false;
  if (*relation == Relation::kGivenInCurrent) return !Ask(builtin, args, scene).value_or(true);
  EvalContext whole = scene;
  whole.as_if_whole = true;
  return Ask(builtin, args, whole).value_or(false);
}

bool NamesSubject(Builtin builtin) {
  switch (builtin) {
    case Builtin::kServices:
    case Builtin::kServicesInclude:
    case Builtin::kServicesOnly:
    case Builtin::kHasServices:
    case Builtin::kTopicPublishers:
    case Builtin::kTopicPublishersInclude:
    case Builtin::kTopicPublishersOnly:
    case Builtin::kHasTopicPublishers:
    case Builtin::kTopicSubscribers:
    case Builtin::kTopicSubscribersInclude:
    case Builtin::kTopicSubscribersOnly:
    case Builtin::kHasTopicSubscribers:
      return true;
    default:
      return false;
  }
}

std::optional<bool> Ask(Builtin builtin, Args args, const EvalContext& scene) {
  const auto compare = [&](NameSet::Kind kind, const auto& current) -> std::optional<bool> {
    const auto relation = RelationOf(builtin, scene.prototype());
    if (!relation.has_value()) return std::nullopt;
    return Compare(kind, args, 0, current, *relation, scene.truncated());
  };
  switch (builtin) {
    case Builtin::kTopicIn:
      return AnyIs(args, scene.topic);
    case Builtin::kMsgTypeIn:
      return TypeIn(args, scene);
    case Builtin::kMsgSubtype:
      return SubtypeIs(args, scene);
    case Builtin::kPublisherCount:
    case Builtin::kSubscriberCount:
    case Builtin::kNodeCount:
    case Builtin::kTopicCount:
    case Builtin::kServiceCount:
    case Builtin::kTopicPublisherCount:
    case Builtin::kTopicSubscriberCount:
      return EvaluateCount(builtin, args, scene);
    case Builtin::kPublishers:
    case Builtin::kPublishersInclude:
      return compare(NameSet::Kind::kNodes, Publishers(scene.facts));
    case Builtin::kSubscribers:
    case Builtin::kSubscribersInclude:
      return compare(NameSet::Kind::kNodes, Subscribers(scene.facts));
    case Builtin::kNodes:
    case Builtin::kNodesInclude:
    case Builtin::kNodesOnly:
    case Builtin::kHasNodes:
      return compare(NameSet::Kind::kNodes, scene.graph.nodes());
    case Builtin::kTopics:
    case Builtin::kTopicsInclude:
    case Builtin::kTopicsOnly:
    case Builtin::kHasTopics:
      return compare(NameSet::Kind::kPlain, scene.graph.topics());
    case Builtin::kServices:
    case Builtin::kServicesInclude:
    case Builtin::kServicesOnly:
    case Builtin::kHasServices:
    case Builtin::kService:
      return EvaluateServices(builtin, args, scene);
    default:
      return NamesSubject(builtin) ? EvaluateTopic(builtin, args, scene) : std::nullopt;
  }
}

}  // namespace rips::engine

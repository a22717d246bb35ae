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
#include "policy_server/policy/engine/builtins/question.h"

namespace rips::engine {
namespace {

using Args = absl::Span<const Scalar>;

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

std::optional<Range> RangeFrom(Args args, size_t from) {
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

// How the names from args[from] on compare with those in `current`. Nullopt for other forms.
template <typename Range>
std::optional<bool> Compare(NameSet::Kind kind, Args args, size_t from, const Range& current,
                            Form form, bool truncated) {
  NameSet names(kind);
  for (size_t i = from; i < args.size(); ++i) {
    const std::optional<absl::string_view> name = Text(args, i);
    if (!name.has_value()) return std::nullopt;
    names.Add(*name);
  }
  names.Seal();
  for (const auto& item : current) names.See(NameOf(item));
  switch (form) {
    case Form::kExactly:
      return !truncated && names.AllCurrentGiven() && names.AllGivenCurrent();
    case Form::kCurrentInGiven:
      return !truncated && names.AllCurrentGiven();
    case Form::kGivenInCurrent:
      return names.AllGivenCurrent();
    case Form::kHas:
      if (args.size() != from + 1) return std::nullopt;
      return names.AllGivenCurrent();
    case Form::kOneOf:
    case Form::kMatches:
    case Form::kIsType:
    case Form::kCount:
      break;
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

// Calls `look` with the names that are there and how they are compared.
template <typename Look>
auto Visit(const Question& question, Args args, const EvalContext& scene, const Look& look)
    -> decltype(look(NameSet::Kind::kPlain, Nobody())) {
  const absl::string_view name = Text(args, 0).value_or(absl::string_view());
  switch (question.subject) {
    case Subject::kPublishers:
      return look(NameSet::Kind::kNodes, Publishers(scene.facts));
    case Subject::kSubscribers:
      return look(NameSet::Kind::kNodes, Subscribers(scene.facts));
    case Subject::kNodes:
      return look(NameSet::Kind::kNodes, scene.graph.nodes());
    case Subject::kTopics:
      return look(NameSet::Kind::kPlain, scene.graph.topics());
    case Subject::kServicesOf:
      return look(NameSet::Kind::kPlain, ServicesOf(name, scene.graph));
    case Subject::kPublishersOf:
      return look(NameSet::Kind::kNodes, Publishers(scene.graph.FindTopic(name)));
    case Subject::kSubscribersOf:
      return look(NameSet::Kind::kNodes, Subscribers(scene.graph.FindTopic(name)));
    case Subject::kTopic:
    case Subject::kTypes:
      break;
  }
  return std::nullopt;
}

std::optional<int64_t> CountOf(const Question& question, Args args, const EvalContext& scene) {
  return Visit(question, args, scene, [](NameSet::Kind, const auto& current) {
    return std::optional<int64_t>(static_cast<int64_t>(current.size()));
  });
}

std::optional<Range> RangeOf(const Question& question, Args args) {
  if (question.names_subject() && !Text(args, 0).has_value()) return std::nullopt;
  return RangeFrom(args, question.names_subject() ? 1 : 0);
}

// Between n and n + left_out are there.
bool CountLeftOpen(const Question& question, Args args, const EvalContext& scene) {
  const std::optional<Range> range = RangeOf(question, args);
  const std::optional<int64_t> least = CountOf(question, args, scene);
  if (!range.has_value() || !least.has_value() || range->min > range->max) return false;
  const auto room = static_cast<uint64_t>(std::numeric_limits<int64_t>::max() - *least);
  const int64_t most = *least + static_cast<int64_t>(std::min(scene.graph.left_out(), room));
  if (*least > range->max || most < range->min) return false;
  return *least < range->min || most > range->max;
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

Form FormOf(const Question& question, const EvalContext& scene) {
  return scene.prototype() ? question.prototype : question.form;
}

std::optional<bool> Answer(const Question& question, Args args, const EvalContext& scene) {
  const Form form = FormOf(question, scene);
  switch (form) {
    case Form::kOneOf:
      return question.subject == Subject::kTopic ? AnyIs(args, scene.topic) : TypeIn(args, scene);
    case Form::kIsType:
      return SubtypeIs(args, scene);
    case Form::kCount: {
      const std::optional<Range> range = RangeOf(question, args);
      const std::optional<int64_t> count = CountOf(question, args, scene);
      if (!range.has_value() || !count.has_value()) return std::nullopt;
      return range->min <= *count && *count <= range->max;
    }
    case Form::kExactly:
    case Form::kCurrentInGiven:
    case Form::kGivenInCurrent:
    case Form::kHas: {
      const size_t from = question.names_subject() ? 1 : 0;
      if (from > 0 && !Text(args, 0).has_value()) return std::nullopt;
      return Visit(question, args, scene, [&](NameSet::Kind kind, const auto& current) {
        return Compare(kind, args, from, current, form, scene.truncated());
      });
    }
    case Form::kMatches:
      break;
  }
  return std::nullopt;
}

}  // namespace

std::optional<bool> Ask(lang::Builtin builtin, Args args, const EvalContext& scene) {
  const Question* question = QuestionOf(builtin);
  return question == nullptr ? std::nullopt : Answer(*question, args, scene);
}

bool LeftOpen(lang::Builtin builtin, Args args, const EvalContext& scene) {
  const Question* question = QuestionOf(builtin);
  if (question == nullptr || !scene.graph.truncated()) return false;
  switch (FormOf(*question, scene)) {
    case Form::kCount:
      return CountLeftOpen(*question, args, scene);
    case Form::kGivenInCurrent:
    case Form::kHas:
      return !Answer(*question, args, scene).value_or(true);
    case Form::kCurrentInGiven: {
      EvalContext whole = scene;
      whole.as_if_whole = true;
      return Answer(*question, args, whole).value_or(false);
    }
    case Form::kOneOf:
    case Form::kMatches:
    case Form::kIsType:
    case Form::kExactly:
      break;
  }
  return false;
}

std::optional<Difference> Differ(lang::Builtin builtin, Args args, const EvalContext& scene) {
  const Question* question = QuestionOf(builtin);
  if (question == nullptr) return std::nullopt;
  Difference out{.subject = question->subject, .form = FormOf(*question, scene)};
  const bool counts = out.form == Form::kCount;
  const auto add = [&out](std::vector<std::string>& list, absl::string_view name) {
    if (std::find(list.begin(), list.end(), name) != list.end()) return;
    if (list.size() >= Difference::kNamesMax) {
      out.cut = true;
    } else {
      list.emplace_back(name);
    }
  };
  return Visit(*question, args, scene,
               [&](NameSet::Kind kind, const auto& current) -> std::optional<Difference> {
                 NameSet names(kind);
                 const size_t from = question->names_subject() ? 1 : 0;
                 for (size_t i = from; i < args.size() && !counts; ++i) {
                   const std::optional<absl::string_view> name = Text(args, i);
                   if (!name.has_value()) return std::nullopt;
                   names.Add(*name);
                 }
                 names.Seal();
                 for (const auto& item : current) {
                   const std::string& name = NameOf(item);
                   add(counts || names.See(name) ? out.met : out.extra, name);
                 }
                 names.ForUnseen([&](absl::string_view name) { add(out.missing, name); });
                 out.count = static_cast<int64_t>(current.size());
                 return std::move(out);
               });
}

}  // namespace rips::engine

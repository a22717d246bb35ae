#include "policy_server/policy/engine/trace/tracer.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/builtins/builtins.h"
#include "policy_server/policy/engine/state/message_counts.h"
#include "policy_server/policy/lang/value_text.h"
#include "services/base/cut_text.h"

namespace rips::engine {
namespace {

using lang::BinaryOp;
using lang::Builtin;
using lang::TypedExpr;

constexpr char kNotEvaluated[] = "not evaluated";
constexpr char kNotThere[] = "is not there";
constexpr char kDuplicateNode[] = "duplicate_node";

std::string Cut(absl::string_view text) { return Shortened(text, kTracedTextBytesMax); }

bool IsLogical(const TypedExpr& expr) {
  return expr.kind == TypedExpr::Kind::kBinary &&
         (expr.binary == BinaryOp::kAnd || expr.binary == BinaryOp::kOr);
}

bool IsNot(const TypedExpr& expr) {
  return expr.kind == TypedExpr::Kind::kUnary && expr.unary == lang::UnaryOp::kNot;
}

// The compiled node of an operand.
const EvalNode& Operand(const EvalNode& node, size_t index) {
  if (!node.args.empty()) return *node.args[index];
  return index == 0 ? *node.left : *node.right;
}

// Who is on a topic, or in the graph, with what their processes say of themselves.
class Witnesses {
 public:
  Witnesses(const ros2::RosGraph& graph, Trace& trace, size_t subjects_max = kSubjectsMax)
      : graph_(graph), trace_(trace), subjects_max_(std::min(subjects_max, kSubjectsMax)) {}

  void Add(TracedSubject subject) {
    for (TracedSubject& known : trace_.subjects) {
      if (known.name != subject.name || known.guid != subject.guid) continue;
      if (!absl::StrContains(known.role, subject.role)) {
        known.role = Cut(absl::StrCat(known.role, ", ", subject.role));
      }
      return;
    }
    if (trace_.subjects.size() >= subjects_max_) {
      trace_.cut = true;
      return;
    }
    const auto participant = graph_.participants().find(subject.guid.Participant());
    if (participant != graph_.participants().end()) {
      subject.host = Cut(participant->second.host);
      subject.pid = participant->second.pid;
      subject.address = Cut(participant->second.address);
    }
    subject.name = Cut(subject.name);
    subject.role = Cut(subject.role);
    trace_.subjects.push_back(std::move(subject));
  }

  // Those of `names` that have an endpoint of that kind on the topic.
  void AddEndpoints(const std::vector<std::string>& names, ros2::EndpointKind kind,
                    absl::string_view topic) {
    const bool publishes = kind == ros2::EndpointKind::kPublisher;
    const std::string role = absl::StrCat(publishes ? "publishes " : "subscribes to ", topic);
    for (const auto& [guid, endpoint] : graph_.endpoints()) {
      if (endpoint.kind != kind || endpoint.name != topic || endpoint.pending) continue;
      const std::string name = endpoint.node.empty()
                                   ? absl::StrCat("(unattributed ", ToString(guid), ")")
                                   : endpoint.node;
      if (std::find(names.begin(), names.end(), name) == names.end()) continue;
      Add({.name = name, .role = role, .guid = guid});
    }
  }

  void AddNodes(const std::vector<std::string>& names) {
    for (const std::string& name : names) {
      bool found = false;
      for (auto node = graph_.nodes().lower_bound(ros2::Node{.full_name = name});
           node != graph_.nodes().end() && node->full_name == name; ++node) {
        Add({.name = name, .role = "is a node", .guid = node->participant});
        found = true;
      }
      if (!found) Add({.name = name, .role = "is a node"});
    }
  }

  void AddNames(const std::vector<std::string>& names, absl::string_view role) {
    for (const std::string& name : names) Add({.name = name, .role = std::string(role)});
  }

 private:
  const ros2::RosGraph& graph_;
  Trace& trace_;
  const size_t subjects_max_;
};

// What identifies it, and who it is about.
void AddFinding(const model::Finding& finding, Witnesses& witnesses, Trace& trace) {
  trace.finding = finding;
  trace.finding.detail.clear();
  const std::string& name = finding.node.empty() ? finding.topic : finding.node;
  if (name.empty() && finding.guid.none()) return;
  std::string role = absl::StrCat("finding ", finding.kind);
  if (!finding.node.empty() && !finding.topic.empty()) {
    absl::StrAppend(&role, " on ", finding.topic);
  }
  witnesses.Add({.name = name, .role = std::move(role), .guid = finding.guid});
  // Its GUID is of the last one that came.
  if (finding.kind == kDuplicateNode) witnesses.AddNodes({finding.node});
}

class Tracer {
 public:
  Tracer(Evaluation& run, const Event& event, Trace& trace, const lang::SourceRange& condition)
      : run_(run),
        event_(event),
        trace_(trace),
        condition_(condition),
        witnesses_(run.scene.graph, trace) {}

  // `want`: the value by which the expression makes the condition true; none = it does not.
  void Walk(const TypedExpr& expr, const EvalNode& node, uint32_t depth, std::optional<bool> want) {
    if (expr.is_constant()) return;
    if (IsNot(expr)) {
      if (want.has_value()) want = !*want;
      return Walk(expr.args[0], Operand(node, 0), depth, want);
    }
    if (IsLogical(expr)) return WalkLogical(expr, node, depth, want);
    const Answer answer = Evaluate(node);
    Note(expr, depth, TextOf(expr, node, answer));
    // What is not known makes the condition true, too.
    const bool told = answer.status == EvalStatus::kValue;
    const bool matters = node.type == lang::ValueType::kBool && want.has_value() &&
                         (!told || answer.value.truth == *want);
    if (expr.kind == TypedExpr::Kind::kCall && matters) AddWitnesses(node, told, *want);
    for (size_t i = 0; i < expr.args.size(); ++i) {
      Walk(expr.args[i], Operand(node, i), depth + 1, std::nullopt);
    }
  }

  void AddEvent() {
    if (const auto* message = std::get_if<MessageEvent>(&event_.what)) {
      witnesses_.Add(
          {.name = message->sender.empty() ? "(not attributed)" : std::string(message->sender),
           .role = "sent the message",
           .guid = message->writer});
      return;
    }
    const auto* external = std::get_if<ExternalEvent>(&event_.what);
    if (external == nullptr) return;
    if (const auto* finding = std::get_if<model::Finding>(external)) {
      AddFinding(*finding, witnesses_, trace_);
    } else if (const auto* ids = std::get_if<model::IdsAlert>(external)) {
      if (!ids->src.empty()) witnesses_.Add({.name = ids->src, .role = "sent what the IDS saw"});
      if (!ids->dst.empty()) witnesses_.Add({.name = ids->dst, .role = "was its target"});
    }
  }

 private:
  struct Answer {
    EvalStatus status = EvalStatus::kValue;
    Slot value;
    bool graph_open = false;

    // The operator takes nothing else into account.
    bool Is(bool truth) const { return status == EvalStatus::kValue && value.truth == truth; }
  };

  Answer Evaluate(const EvalNode& node) {
    Answer answer;
    run_.graph_open = false;
    answer.status = Eval(node, run_, answer.value);
    answer.graph_open = run_.graph_open;
    return answer;
  }

  void WalkLogical(const TypedExpr& expr, const EvalNode& node, uint32_t depth,
                   std::optional<bool> want) {
    const bool decides = expr.binary == BinaryOp::kOr;
    bool decided = false;
    for (size_t i = 0; i < expr.args.size(); ++i) {
      if (decided) {
        Skip(expr.args[i], depth);
        continue;
      }
      const Answer answer = Evaluate(Operand(node, i));
      decided = answer.Is(decides) || answer.status == EvalStatus::kFault;
      const bool against = want.has_value() && answer.Is(!*want);
      Walk(expr.args[i], Operand(node, i), depth, against ? std::nullopt : want);
    }
  }

  void Skip(const TypedExpr& expr, uint32_t depth) {
    if (expr.is_constant()) return;
    if (IsNot(expr) || IsLogical(expr)) {
      for (const TypedExpr& arg : expr.args) Skip(arg, depth);
      return;
    }
    Note(expr, depth, kNotEvaluated);
  }

  void Note(const TypedExpr& expr, uint32_t depth, std::string value) {
    const lang::SourceRange& range = expr.range;
    const bool inside = range.file == condition_.file && range.offset >= condition_.offset &&
                        range.offset - condition_.offset + range.length <= trace_.condition.size();
    if (!inside || trace_.values.size() >= kTracedValuesMax) {
      trace_.cut = true;
      return;
    }
    trace_.values.push_back({.offset = range.offset - condition_.offset,
                             .length = range.length,
                             .depth = depth,
                             .value = std::move(value)});
  }

  std::string TextOf(const TypedExpr& expr, const EvalNode& node, const Answer& answer) {
    switch (answer.status) {
      case EvalStatus::kUnscanned:
        return answer.graph_open ? "not known: the graph is truncated"
                                 : "not known: it was not inspected";
      case EvalStatus::kUndecidable:
        return "not known";
      case EvalStatus::kFault:
        return Cut(absl::StrCat("fault: ", run_.fault));
      case EvalStatus::kValue:
        break;
    }
    const lang::Value value = Own(answer.value, node.type);
    if (node.type == lang::ValueType::kString) {
      return Cut(absl::StrCat("\"", std::get<std::string>(value), "\""));
    }
    const levels::LevelTable& table = run_.program->rules().levels;
    if (expr.type == lang::ValueType::kLevel && answer.value.integer >= 0 &&
        answer.value.integer < table.size()) {
      return table.name(static_cast<levels::LevelIndex>(answer.value.integer));
    }
    if (expr.kind != TypedExpr::Kind::kCall) return lang::ToText(value);
    return Cut(absl::StrCat(lang::ToText(value), Measured(node)));
  }

  // What a call compared with its arguments.
  std::string Measured(const EvalNode& node) {
    const MessageEvent* message = run_.message;
    if (const auto difference = Ask(node); difference && difference->form == Form::kCount) {
      return difference->count == 1 ? ": there is 1"
                                    : absl::StrCat(": there are ", difference->count);
    }
    if (message == nullptr) return "";
    switch (node.builtin) {
      case Builtin::kPayloadSize:
        return absl::StrCat(": ", message->size_bytes, " bytes");
      case Builtin::kMsgCount:
        return absl::StrCat(
            ": ", CountOfTopic(*message, run_.time_ns, node.index, run_.state->internal()));
      case Builtin::kSenderCount:
        return absl::StrCat(
            ": ", CountOfSender(*message, run_.time_ns, node.index, run_.state->internal()));
      default:
        return "";
    }
  }

  std::optional<Difference> Ask(const EvalNode& node) {
    if (QuestionOf(node.builtin) == nullptr) return std::nullopt;
    std::vector<Scalar> args;
    for (const EvalNode* arg : node.args) {
      Slot value;
      if (Eval(*arg, run_, value) != EvalStatus::kValue) return std::nullopt;
      args.push_back(ToScalar(value, arg->type));
    }
    std::optional<Difference> difference = Differ(node.builtin, args, run_.scene);
    if (difference.has_value()) {
      asked_ = !args.empty() && std::holds_alternative<absl::string_view>(args[0])
                   ? std::string(std::get<absl::string_view>(args[0]))
                   : std::string();
    }
    return difference;
  }

  // Who made a question about names be what it is. `truth` is its answer if it is `told`.
  void AddWitnesses(const EvalNode& node, bool told, bool truth) {
    const std::optional<Difference> difference = Ask(node);
    if (!difference.has_value()) return;
    trace_.cut = trace_.cut || difference->cut;
    const bool holds = told && truth;
    switch (difference->form) {
      case Form::kCount:
        return AddThere(difference->subject, difference->met);
      case Form::kHas:
      case Form::kGivenInCurrent:
        if (holds) return AddThere(difference->subject, difference->met);
        return witnesses_.AddNames(difference->missing, kNotThere);
      case Form::kExactly:
        if (!holds) witnesses_.AddNames(difference->missing, kNotThere);
        [[fallthrough]];
      case Form::kCurrentInGiven:
        if (!holds) AddThere(difference->subject, difference->extra);
        return;
      case Form::kOneOf:
      case Form::kMatches:
      case Form::kIsType:
        return;
    }
  }

  void AddThere(Subject subject, const std::vector<std::string>& names) {
    using ros2::EndpointKind;
    const std::string topic(run_.scene.topic);
    switch (subject) {
      case Subject::kPublishers:
        return witnesses_.AddEndpoints(names, EndpointKind::kPublisher, topic);
      case Subject::kSubscribers:
        return witnesses_.AddEndpoints(names, EndpointKind::kSubscriber, topic);
      case Subject::kPublishersOf:
        return witnesses_.AddEndpoints(names, EndpointKind::kPublisher, asked_);
      case Subject::kSubscribersOf:
        return witnesses_.AddEndpoints(names, EndpointKind::kSubscriber, asked_);
      case Subject::kNodes:
        return witnesses_.AddNodes(names);
      case Subject::kTopics:
        return witnesses_.AddNames(names, "is a topic");
      case Subject::kServicesOf:
        return witnesses_.AddNames(names, absl::StrCat("is a service of ", asked_));
      case Subject::kTopic:
      case Subject::kTypes:
        return;
    }
  }

  Evaluation& run_;
  const Event& event_;
  Trace& trace_;
  const lang::SourceRange condition_;
  Witnesses witnesses_;
  // The topic or node of the question asked last.
  std::string asked_;
};

}  // namespace

Trace DescribeRule(const CompiledPolicy& program, uint32_t index) {
  const lang::TypedRule& rule = program.rules().rules[index];
  return {.place = rule.place,
          .condition = std::string(CutUtf8(rule.condition_text, kConditionBytesMax)),
          .bundle = program.options().bundle_id,
          .cut = rule.condition_text.size() > kConditionBytesMax};
}

Trace TraceRule(Frame& frame, uint32_t index, levels::LevelIndex level) {
  const lang::TypedRule& rule = frame.program().rules().rules[index];
  Trace trace = DescribeRule(frame.program(), index);
  trace.event = Cut(Describe(frame.event()));
  trace.event_unix_ns = frame.event().time_unix_ns;
  Evaluation& run = frame.Enter(rule, level);
  const uint64_t steps = run.steps;
  Tracer tracer(run, frame.event(), trace, rule.condition.range);
  tracer.Walk(rule.condition, *frame.program().compiled().conditions[index], 0, true);
  tracer.AddEvent();
  run.steps = steps;
  return trace;
}

Trace TraceFinding(const model::Finding& finding, const ros2::RosGraph& graph,
                   size_t subjects_max) {
  Trace trace;
  Witnesses witnesses(graph, trace, subjects_max);
  AddFinding(finding, witnesses, trace);
  return trace;
}

}  // namespace rips::engine

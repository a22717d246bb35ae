// Builds checked rules, a graph and a robot by hand, for tests of the engine.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_TEST_RULES_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_TEST_RULES_H_

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/policy/engine/evaluator.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "services/base/check.h"
#include "services/base/status_matchers.h"

namespace rips::engine {

using lang::BinaryOp;
using lang::Builtin;
using lang::Connector;
using lang::EventClass;
using lang::Predefined;
using lang::TypedAction;
using lang::TypedChain;
using lang::TypedExpr;
using lang::UnaryOp;
using lang::ValueType;

using Exprs = std::vector<TypedExpr>;

inline TypedExpr Constant(ValueType type, lang::Value value) {
  return {.kind = TypedExpr::Kind::kConstant, .type = type, .constant = std::move(value)};
}
inline TypedExpr I(int64_t value) { return Constant(ValueType::kInt, value); }
inline TypedExpr F(double value) { return Constant(ValueType::kFloat, value); }
inline TypedExpr B(bool value) { return Constant(ValueType::kBool, value); }
inline TypedExpr S(std::string value) { return Constant(ValueType::kString, std::move(value)); }
inline TypedExpr L(int64_t level) { return Constant(ValueType::kLevel, level); }
inline TypedExpr Name(Predefined name) {
  return {.kind = TypedExpr::Kind::kPredefined, .predefined = name};
}
inline TypedExpr Call(Builtin builtin, Exprs args) {
  return {.kind = TypedExpr::Kind::kCall, .builtin = builtin, .args = std::move(args)};
}
inline TypedExpr Op(TypedExpr left, BinaryOp op, TypedExpr right) {
  TypedExpr out{.kind = TypedExpr::Kind::kBinary, .binary = op};
  out.args.push_back(std::move(left));
  out.args.push_back(std::move(right));
  return out;
}
inline TypedExpr Op(UnaryOp op, TypedExpr operand) {
  TypedExpr out{.kind = TypedExpr::Kind::kUnary, .unary = op};
  out.args.push_back(std::move(operand));
  return out;
}
inline TypedExpr And(TypedExpr a, TypedExpr b) {
  return Op(std::move(a), BinaryOp::kAnd, std::move(b));
}
inline TypedExpr Or(TypedExpr a, TypedExpr b) {
  return Op(std::move(a), BinaryOp::kOr, std::move(b));
}
inline TypedExpr Not(TypedExpr a) { return Op(UnaryOp::kNot, std::move(a)); }
// A bool that faults.
inline TypedExpr Faulty() {
  return Op(Op(I(1), BinaryOp::kDiv, Op(I(1), BinaryOp::kSub, I(1))), BinaryOp::kEq, I(0));
}
inline Exprs Texts(const std::vector<std::string>& texts) {
  Exprs out;
  for (const std::string& text : texts) out.push_back(S(text));
  return out;
}
inline TypedExpr Text(TypedExpr of) { return Call(Builtin::kString, {std::move(of)}); }
inline TypedExpr Concat(TypedExpr a, TypedExpr b) {
  return Op(std::move(a), BinaryOp::kAdd, std::move(b));
}
// payload or plugin: the inspection of that index.
inline TypedExpr Inspect(uint32_t inspection) {
  return {.kind = TypedExpr::Kind::kCall, .builtin = Builtin::kPayload, .inspection = inspection};
}
inline TypedExpr V(uint32_t variable) {
  return {.kind = TypedExpr::Kind::kVariable, .variable = variable};
}

inline TypedAction Alert(TypedExpr text) { return {.args = {std::move(text)}}; }
inline TypedAction Alert(const std::string& text) { return Alert(S(text)); }
inline TypedAction Set(uint32_t variable, TypedExpr value) {
  return {.kind = lang::ActionKind::kSet, .args = {std::move(value)}, .variable = variable};
}
inline TypedAction Exec(const std::vector<std::string>& argv) {
  return {.kind = lang::ActionKind::kExec, .args = Texts(argv)};
}
inline TypedAction Crash(const std::string& text) {
  return {.kind = lang::ActionKind::kCrash, .args = Texts({text})};
}
inline TypedAction Show(lang::ActionKind kind, Exprs values) {
  return {.kind = kind, .args = std::move(values)};
}
inline TypedAction Trigger(TypedExpr level) {
  return {.kind = lang::ActionKind::kTrigger, .args = {std::move(level)}};
}
inline TypedAction Trigger(int64_t level) { return Trigger(L(level)); }
// `action` followed by `next`.
inline TypedAction operator>>(TypedAction action, Connector next) {
  action.next = next;
  return action;
}
constexpr Connector kThen = Connector::kIfSucceeded;
constexpr Connector kElse = Connector::kIfFailed;
constexpr Connector kAnyway = Connector::kAlways;

// Rules under construction. Levels A, B (soft), C (soft), D unless told otherwise.
struct TestRules {
  lang::CheckedRules rules{
      .levels = levels::LevelTable(
          {{"A"}, {.name = "B", .soft = true}, {.name = "C", .soft = true}, {"D"}})};

  uint32_t Var(const std::string& name, ValueType type, lang::Value initial) {
    rules.variables.push_back({.name = name, .type = type, .initial = std::move(initial)});
    return static_cast<uint32_t>(rules.variables.size() - 1);
  }
  // Files a, b, c, ... for Inspect.
  TestRules& Inspections(int count) {
    for (int i = 0; i < count; ++i) {
      rules.inspections.push_back({.name = std::string(1, static_cast<char>('a' + i))});
    }
    return *this;
  }
  uint32_t IntVar(const std::string& name, int64_t initial) {
    return Var(name, ValueType::kInt, initial);
  }
  TestRules& Rule(EventClass section, const std::string& name, TypedExpr condition,
                  std::vector<TypedChain> chains) {
    rules.rules.push_back({.name = name,
                           .section = section,
                           .condition = std::move(condition),
                           .chains = std::move(chains)});
    return *this;
  }
  TestRules& Tick(const std::string& name, TypedExpr condition, std::vector<TypedChain> chains) {
    return Rule(EventClass::kExternal, name, std::move(condition), std::move(chains));
  }
  TestRules& Msg(const std::string& name, TypedExpr condition, std::vector<TypedChain> chains) {
    return Rule(EventClass::kMsg, name, std::move(condition), std::move(chains));
  }
  TestRules& Graph(const std::string& name, TypedExpr condition, std::vector<TypedChain> chains) {
    return Rule(EventClass::kGraph, name, std::move(condition), std::move(chains));
  }
  std::shared_ptr<const CompiledPolicy> Build(CompiledPolicyOptions options = {}) const {
    absl::StatusOr<std::shared_ptr<const CompiledPolicy>> program =
        CompiledPolicy::Create(rules, options);
    RIPS_CHECK(program.ok(), "rules of a test are well formed");
    return *std::move(program);
  }
};

// Nodes and endpoints, each node in a participant of its own unless told otherwise.
class TestGraph {
 public:
  TestGraph& Node(const std::string& name) {
    const ros2::Guid participant = Guid(0x1c1);
    delta_.upsert_participants.push_back({.guid = participant});
    delta_.upsert_nodes.push_back({.full_name = name, .participant = participant});
    participant_of_[name] = participant;
    return *this;
  }
  TestGraph& Publishes(const std::string& node, const std::string& topic,
                       const std::string& type = "std_msgs/msg/String") {
    return Endpoint(ros2::EndpointKind::kPublisher, node, topic, type);
  }
  TestGraph& Subscribes(const std::string& node, const std::string& topic,
                        const std::string& type = "std_msgs/msg/String") {
    return Endpoint(ros2::EndpointKind::kSubscriber, node, topic, type);
  }
  TestGraph& Serves(const std::string& node, const std::string& service) {
    return Endpoint(ros2::EndpointKind::kService, node, service, "std_srvs/srv/Empty");
  }
  // `node` empty: not attributed, in the participant of the last node.
  TestGraph& Endpoint(ros2::EndpointKind kind, const std::string& node, const std::string& name,
                      const std::string& type) {
    ros2::Guid guid = node.empty() ? delta_.upsert_participants.back().guid : participant_of_[node];
    const uint16_t entity = ++last_entity_;
    guid.bytes[12] = 0;
    guid.bytes[13] = static_cast<uint8_t>(entity >> 8);
    guid.bytes[14] = static_cast<uint8_t>(entity);
    guid.bytes[15] = 0x03;
    delta_.upsert_endpoints.push_back(
        {.guid = guid, .kind = kind, .name = name, .type = type, .node = node});
    return *this;
  }
  ros2::RosGraph Build(ros2::GraphLimits limits = {}) const {
    ros2::RosGraph graph(limits);
    const absl::Status status = graph.Apply(delta_);
    EXPECT_THAT(status, IsOk());
    return graph;
  }

 private:
  ros2::Guid Guid(uint32_t entity) {
    const uint32_t prefix = ++last_prefix_;
    ros2::Guid guid;
    guid.bytes[0] = 1;
    guid.bytes[2] = static_cast<uint8_t>(prefix >> 8);
    guid.bytes[3] = static_cast<uint8_t>(prefix);
    guid.bytes[14] = static_cast<uint8_t>(entity >> 8);
    guid.bytes[15] = static_cast<uint8_t>(entity);
    return guid;
  }

  ros2::GraphDelta delta_;
  std::map<std::string, ros2::Guid> participant_of_;
  uint32_t last_prefix_ = 0;
  uint16_t last_entity_ = 0;
};

// A robot and its clock; events are stamped with the current time.
struct TestRobot {
  explicit TestRobot(std::shared_ptr<const CompiledPolicy> program, levels::LevelIndex level = 0,
                     StateLimits limits = {})
      : now({.boottime_ns = 1'000 * kNanosPerSecond, .unix_ns = 1'700'000'000 * kNanosPerSecond}),
        state(program, levels::LevelMachine(program->rules().levels, level, {1, 1}, 1), now,
              limits) {}
  explicit TestRobot(const TestRules& rules, levels::LevelIndex level = 0)
      : TestRobot(rules.Build(), level) {}

  Outcome Tick(levels::Lateness lateness = levels::Lateness::kTimely) {
    return Judge(ExternalEvent(std::in_place_type<TickEvent>), lateness);
  }
  Outcome Graph() { return Judge(GraphEvent{}); }
  Outcome Message(const std::string& topic, const std::string& type = "std_msgs/msg/String",
                  const std::string& sender = "/talker") {
    return Judge(MessageEvent{.topic = topic, .type = type, .sender = sender});
  }
  template <typename What>
  Outcome Judge(const What& what, levels::Lateness lateness = levels::Lateness::kTimely) {
    Event event{.time_unix_ns = now.unix_ns, .lateness = lateness};
    event.what.emplace<What>(what);
    return Evaluate(event, now, state);
  }
  Outcome Verified() {
    state.actuation = Actuation::kVerified;
    return OnActuation(now, state);
  }
  void Advance(int64_t ns) {
    now.boottime_ns += ns;
    now.unix_ns += ns;
  }
  int64_t Int(const std::string& name) const {
    return std::get<int64_t>(state.Variables().at(name));
  }

  Instant now;
  RobotState state;
};

// One line an effect: "alert r medium: text", "level r A->B 1.2", "refused r B->A blind x2",
// "run 1 r: program args".
inline std::vector<std::string> Lines(const Outcome& outcome, const RobotState& state) {
  std::vector<std::string> out;
  for (const Effect& effect : outcome.effects) {
    if (const auto* alert = std::get_if<AlertEffect>(&effect)) {
      out.push_back(
          absl::StrCat("alert ", alert->rule, " ", ToString(alert->severity), ": ", alert->text));
    } else if (const auto* change = std::get_if<TransitionEffect>(&effect)) {
      const levels::Transition& t = change->transition;
      const std::string way = absl::StrCat(t.cause.name, " ", state.level.table().name(t.from),
                                           "->", state.level.table().name(t.to), " ");
      out.push_back(t.refused()
                        ? absl::StrCat("refused ", way, ToString(t.refusal), " x", change->count)
                        : absl::StrCat("level ", way, ToString(t.decision_id)));
    } else if (const auto* run = std::get_if<RunProgramEffect>(&effect)) {
      std::string line = absl::StrCat("run ", run->run_id, " ", run->rule, ": ", run->program);
      for (const std::string& arg : run->args) absl::StrAppend(&line, " ", arg);
      out.push_back(std::move(line));
    } else if (const auto* log = std::get_if<LogEffect>(&effect)) {
      out.push_back(absl::StrCat("log ", log->rule, ": ", log->text));
    }
  }
  return out;
}

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_TEST_RULES_H_

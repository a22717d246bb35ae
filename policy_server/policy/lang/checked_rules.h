// What the checker hands to the engine: rules with names resolved and types fixed. Owns all it
// needs; of the source text it holds positions, and of each rule where it stands and its condition.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_CHECKED_RULES_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_CHECKED_RULES_H_

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "policy_server/policy/levels/level_table.h"

namespace rips::lang {

enum class ValueType { kInt, kFloat, kBool, kString, kLevel };
// Operators take a level as an int.
constexpr ValueType PlainType(ValueType type) {
  return type == ValueType::kLevel ? ValueType::kInt : type;
}

// What a piece of an expression speaks about; a section accepts only some (signature.h).
enum class EventClass { kUniversal, kMsg, kGraph, kExternal };
inline constexpr int kEventClassCount = 4;

// Alternatives in the order of ValueType; a level is its position, an int64_t.
using Value = std::variant<int64_t, double, bool, std::string>;

// Bytes of one of the compiled files.
struct SourceRange {
  uint32_t file = 0;
  uint32_t offset = 0;
  uint32_t length = 0;

  friend bool operator==(const SourceRange&, const SourceRange&) = default;
};

// What `payload` and `plugin` ask: a YARA file, or a plugin, about a message's payload.
struct Inspection {
  enum class Kind { kPayload, kPlugin };
  Kind kind = Kind::kPayload;
  // As the rule writes it: a path, or a plugin's id.
  std::string name;
  // kPayload: `name` seen from the directory of the rule file; kPlugin: `plugins/<name>` beside the
  // rule file, unless the bundle declares a plugin of that id. Without `.` and inner `..`.
  std::string path;

  friend bool operator==(const Inspection&, const Inspection&) = default;
};

// Builtins of expressions; builtin.def says what each is.
enum class Builtin {
#define RIPS_BUILTIN(name, ...) k##name,
#include "policy_server/policy/lang/builtin.def"
};
inline constexpr int kBuiltinCount = static_cast<int>(Builtin::kEval) + 1;

enum class Predefined {
#define RIPS_PREDEFINED(name, ...) k##name,
#include "policy_server/policy/lang/predefined.def"
};

enum class UnaryOp { kPlus, kMinus, kNot, kComplement };
enum class BinaryOp {
  kOr,
  kAnd,
  kBitOr,
  kBitXor,
  kBitAnd,
  kEq,
  kNe,
  kLt,
  kLe,
  kGt,
  kGe,
  kAdd,
  kSub,
  kMul,
  kDiv,
  kMod,
};

// A well-typed expression. Which members mean something depends on `kind`.
struct TypedExpr {
  enum class Kind { kConstant, kVariable, kPredefined, kUnary, kBinary, kCall };
  Kind kind = Kind::kConstant;
  ValueType type = ValueType::kBool;
  SourceRange range;
  Value constant;                                  // kConstant
  uint32_t variable = 0;                           // kVariable: index into CheckedRules::variables
  Predefined predefined = Predefined::kCurrLevel;  // kPredefined
  UnaryOp unary = UnaryOp::kPlus;                  // kUnary: one of args
  BinaryOp binary = BinaryOp::kOr;                 // kBinary: two of args
  Builtin builtin = Builtin::kTopicIn;             // kCall: the arguments in order
  uint32_t inspection = 0;                         // kCall of payload and plugin, without arguments
  std::vector<TypedExpr> args;

  bool is_constant() const { return kind == Kind::kConstant; }
  // The value of a constant string; null for anything else.
  const std::string* constant_text() const {
    return is_constant() ? std::get_if<std::string>(&constant) : nullptr;
  }
};

enum class ActionKind { kAlert, kSet, kExec, kTrigger, kTrue, kFalse, kCrash };

// Between an action and the next one of its chain (RIPS paper, "Actions").
enum class Connector { kEnd, kIfSucceeded, kIfFailed, kAlways };

struct TypedAction {
  ActionKind kind = ActionKind::kAlert;
  SourceRange range;
  // alert: text [, severity]; set: the value; exec: constant program, then strings; trigger: level;
  // True, False: any values; crash: text
  std::vector<TypedExpr> args;
  uint32_t variable = 0;  // set
  Connector next = Connector::kEnd;
};

// At least one action; the last one's `next` is kEnd.
using TypedChain = std::vector<TypedAction>;

struct TypedRule {
  // The given name, or sect_%05d:rule_%05d.
  std::string name;
  // kMsg, kGraph or kExternal.
  EventClass section = EventClass::kMsg;
  TypedExpr condition;
  std::vector<TypedChain> chains;
  SourceRange range;
  // `warehouse.rul:31`, without directories, and what stands at `condition.range`. Filled in by
  // Compile.
  std::string place;
  std::string condition_text;
};

struct Variable {
  std::string name;
  ValueType type = ValueType::kInt;
  Value initial;
};

struct CheckedRules {
  levels::LevelTable levels;
  std::vector<Variable> variables;
  // In file order; files in the order they were given.
  std::vector<TypedRule> rules;
  // Distinct, in the order of first use; TypedExpr::inspection is an index into them.
  std::vector<Inspection> inspections;
  // Programs named by exec, sorted, distinct.
  std::vector<std::string> programs;
  enum class Dialect { kRips, kPrototype };
  // Decides what the include forms mean.
  Dialect dialect = Dialect::kRips;
};

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_CHECKED_RULES_H_

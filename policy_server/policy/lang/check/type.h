// Types of values and classes of events.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_CHECK_TYPE_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_CHECK_TYPE_H_

#include <optional>

#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::lang {

// "int", ..., "level".
absl::string_view Name(ValueType type);
// "universal", "Msg", "Graph", "External".
absl::string_view Name(EventClass event_class);

// The type that a declaration names: int float bool string.
std::optional<ValueType> TypeNamed(absl::string_view name);
// The class of a `rules` section: Msg (also MsgGraph, Message), Graph, External.
std::optional<EventClass> SectionNamed(absl::string_view name);

// Which expressions a section takes:
//
//   section    universal   Msg   Graph   External
//   Msg        yes         yes   yes     no
//   Graph      yes         no    yes     no
//   External   yes         no    no      yes
bool Accepts(EventClass section, EventClass expression);

// A value of type `from` may stand where `to` is asked for: the same type, or a level for an int.
// There is no other conversion.
bool Converts(ValueType from, ValueType to);

// Type of `op x`; none if the operator does not take that type.
//
//   + -   int -> int, float -> float      !   bool -> bool      ~   int -> int
//
// A level counts as an int here and below.
std::optional<ValueType> ResultType(UnaryOp op, ValueType operand);

// Type of `left op right`; none if the operator does not take these types. Both sides have one
// type.
//
//   || &&              bool -> bool
//   | ^ & %            int -> int
//   + - * /            int -> int, float -> float; + also string -> string
//   == != < <= > >=    any type -> bool
std::optional<ValueType> ResultType(BinaryOp op, ValueType left, ValueType right);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_CHECK_TYPE_H_

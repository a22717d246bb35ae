// What the engine derives from checked rules once per policy. Immutable, shared between threads.
#ifndef RIPS_POLICY_SERVER_ENGINE_COMPILED_H_
#define RIPS_POLICY_SERVER_ENGINE_COMPILED_H_

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "policy_server/engine/program.h"
#include "policy_server/engine/scalar.h"
#include "re2/re2.h"

namespace rips::engine {

// A call with constant arguments whose answer depends only on the topic and its types.
struct TopicPredicate {
  lang::Builtin builtin = lang::Builtin::kTopicIn;
  // View the rules.
  std::vector<Scalar> args;
  // topicmatches only.
  std::unique_ptr<const RE2> regex;
};

struct Program::Compiled {
  // Indices of the rules of each class that are not constantly false, in file order.
  std::vector<uint32_t> message_rules;
  std::vector<uint32_t> graph_rules;
  std::vector<uint32_t> external_rules;

  // Equal calls share a predicate.
  std::vector<TopicPredicate> predicates;
  absl::flat_hash_map<const lang::TypedExpr*, uint32_t> predicate_of;

  absl::flat_hash_map<std::string, uint32_t> variable_of;
  // Variables that are handed to trigger: they hold a position in the level table.
  std::vector<bool> holds_level;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_ENGINE_COMPILED_H_

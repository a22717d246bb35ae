// The questions that expressions ask of a message and of the graph.
#ifndef RIPS_POLICY_SERVER_ENGINE_BUILTINS_H_
#define RIPS_POLICY_SERVER_ENGINE_BUILTINS_H_

#include <optional>

#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "policy_server/engine/scalar.h"
#include "policy_server/lang/checked_rules.h"
#include "services/ros2/ros_graph.h"

namespace rips::engine {

// What is looked at. Borrows all of it.
struct Scene {
  const ros2::RosGraph& graph;
  lang::CheckedRules::Dialect dialect = lang::CheckedRules::Dialect::kRips;
  // Of the message; empty for other events.
  absl::string_view topic;
  // All types of the topic, the message's among them.
  absl::Span<const absl::string_view> types;
  // Who publishes and subscribes to the topic; null if the graph knows nobody.
  const ros2::Topic* facts = nullptr;
};

// The include forms, by dialect ("given" are the arguments, "current" is what is there):
//
//   form                                              rips               prototype
//   nodesinclude, topicsinclude, servicesinclude,     current in given   given in current
//   topicpublishersinclude, topicsubscribersinclude
//   publishersinclude                                 given in current   given in current
//   subscribersinclude                                given in current   current in given
//
// "Exactly these" and "current in given" are false while the graph is truncated: what was left out
// could be anything.
//
// All builtins but topicmatches, levelname and string; nullopt for those, and if the arguments do
// not fit the builtin.
std::optional<bool> Ask(lang::Builtin builtin, absl::Span<const Scalar> args, const Scene& scene);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_ENGINE_BUILTINS_H_

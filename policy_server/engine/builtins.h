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
  // Ask as though nothing were left out of the graph.
  bool as_if_whole = false;

  bool prototype() const { return dialect == lang::CheckedRules::Dialect::kPrototype; }
  bool truncated() const { return graph.truncated() && !as_if_whole; }
};

// The include forms, by dialect ("given" are the arguments, "current" is what is there):
//
//   form                                              rips               prototype
//   nodesinclude, topicsinclude, servicesinclude,     current in given   given in current
//   topicpublishersinclude, topicsubscribersinclude
//   publishersinclude                                 given in current   given in current
//   subscribersinclude                                given in current   current in given
//   nodesonly, topicsonly, servicesonly,              current in given   current in given
//   topicpublishersonly, topicsubscribersonly
//   hasnodes, hastopics, hasservices,                 given in current   given in current
//   hastopicpublishers, hastopicsubscribers
//
// "Exactly these" and "current in given" are false while the graph is truncated: what was left out
// could be anything. LeftOpen says whether that is more than is known.
//
// What can be told from the graph, the topic and its types, but for topicmatches; nullopt for other
// builtins, and if the arguments do not fit the builtin.
std::optional<bool> Ask(lang::Builtin builtin, absl::Span<const Scalar> args, const Scene& scene);

// True if what was left out of a truncated graph may turn the answer of Ask:
//
//   form              false for good                       true for good           else
//   exactly           always                                                       -
//   current in given  what is there is not in given                                open
//   given in current                                       all of given is there   open
//   service                                                it is there             open
//   counts            more than the range are there                                open
bool LeftOpen(lang::Builtin builtin, absl::Span<const Scalar> args, const Scene& scene);

// The first argument is the node or topic that is asked about, the others are a set.
bool NamesSubject(lang::Builtin builtin);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_ENGINE_BUILTINS_H_

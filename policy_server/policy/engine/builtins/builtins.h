// The questions that expressions ask of a message and of the graph.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_BUILTINS_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_BUILTINS_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "policy_server/policy/engine/builtins/question.h"
#include "policy_server/policy/engine/builtins/scalar.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "services/ros2/ros_graph.h"

namespace rips::engine {

// What is looked at. Borrows all of it.
struct EvalContext {
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
// could be anything. LeftOpen says whether the answer is decided all the same.
//
// What can be told from the graph, the topic and its types, but for topicmatches; nullopt for other
// builtins, and if the arguments do not fit the builtin.
std::optional<bool> Ask(lang::Builtin builtin, absl::Span<const Scalar> args,
                        const EvalContext& scene);

// True if what was left out of a truncated graph may turn the answer of Ask. n are there, and L is
// at least what was left out (RosGraph::left_out), so between n and n + L are there in truth:
//
//   form              decided false                decided true                    else
//   exactly           always                       never                           -
//   current in given  some of n are not in given   never                           open
//   given in current  never                        all of given are there          open
//   service           never                        it is there                     open
//   counts            n > max, or n + L < min      min <= n and n + L <= max       open
//   senderin,         as of a whole graph if it shows the message's writer or      open if no
//   senderenclave     participant                                                  name fits
//   topicin, msgtypein, msgsubtype: as of a whole graph; they ask of the message
//
// An open answer is unscanned (CompiledPolicyOptions::on_inspection_error), and so is its negation;
// "exactly" is not, so its negation is true.
bool LeftOpen(lang::Builtin builtin, absl::Span<const Scalar> args, const EvalContext& scene);

// What the answer to a question about names, or about how many there are, turns on. Each name
// once; at most kNamesMax in a list.
struct Difference {
  static constexpr size_t kNamesMax = 16;
  Subject subject = Subject::kNodes;
  Form form = Form::kExactly;
  // How many are there; two endpoints of one node count as two.
  int64_t count = 0;
  // There and not given, given and not there, given and there. To count, all are given.
  std::vector<std::string> extra;
  std::vector<std::string> missing;
  std::vector<std::string> met;
  // A list would be longer.
  bool cut = false;
};

// Nullopt for other builtins, and if the arguments do not fit the builtin.
std::optional<Difference> Differ(lang::Builtin builtin, absl::Span<const Scalar> args,
                                 const EvalContext& scene);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_BUILTINS_H_

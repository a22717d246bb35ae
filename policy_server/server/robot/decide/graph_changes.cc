#include "policy_server/server/robot/decide/graph_changes.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {
namespace {

using Names = std::vector<std::string>;

// Those of `from`, sorted, that `without` lacks, each as often as it does.
Names Missing(const Names& from, const Names& without) {
  Names missing;
  std::set_difference(from.begin(), from.end(), without.begin(), without.end(),
                      std::back_inserter(missing));
  return missing;
}

Names NodesOf(const ros2::RosGraph& graph) {
  Names names;
  for (const ros2::Node& node : graph.nodes()) names.push_back(node.full_name);
  return names;
}

const ros2::Topic& TopicOf(const ros2::RosGraph& graph, absl::string_view name) {
  static const auto* const kNone = new ros2::Topic();
  const ros2::Topic* topic = graph.FindTopic(name);
  return topic == nullptr ? *kNone : *topic;
}

// Adds `topic /t: NODE publishes` for each of `names`.
void Add(absl::string_view topic, const Names& names, absl::string_view does, Names& out) {
  for (const std::string& name : names) {
    out.push_back(ros2::Printable(absl::StrCat("topic ", topic, ": ", name, " ", does)));
  }
}

void AddPublishers(absl::string_view name, const ros2::Topic& before, const ros2::Topic& now,
                   Names& out) {
  Add(name, Missing(now.publishers, before.publishers), "publishes", out);
  Add(name, Missing(before.publishers, now.publishers), "publishes no more", out);
  Add(name, Missing(now.types, before.types), "is a further type", out);
}

}  // namespace

Names GraphChanges(const ros2::RosGraph& before, const ros2::RosGraph& now) {
  Names out;
  const Names old_nodes = NodesOf(before);
  const Names new_nodes = NodesOf(now);
  for (const std::string& name : Missing(new_nodes, old_nodes)) {
    out.push_back(ros2::Printable(absl::StrCat("node ", name, " came")));
  }
  for (const std::string& name : Missing(old_nodes, new_nodes)) {
    out.push_back(ros2::Printable(absl::StrCat("node ", name, " left")));
  }
  std::set<absl::string_view> topics;
  for (const ros2::RosGraph* graph : {&before, &now}) {
    for (const auto& [name, topic] : graph->topics()) topics.insert(name);
  }
  for (const absl::string_view name : topics) {
    const ros2::Topic& old_topic = TopicOf(before, name);
    const ros2::Topic& new_topic = TopicOf(now, name);
    AddPublishers(name, old_topic, new_topic, out);
    Add(name, Missing(new_topic.subscribers, old_topic.subscribers), "subscribes", out);
    Add(name, Missing(old_topic.subscribers, new_topic.subscribers), "subscribes no more", out);
  }
  if (out.size() > kChangesMax) {
    const size_t more = out.size() - (kChangesMax - 1);
    out.resize(kChangesMax - 1);
    out.push_back(absl::StrCat("and ", more, " more"));
  }
  return out;
}

std::string PublisherChange(const ros2::RosGraph& before, const ros2::RosGraph& now,
                            const ros2::TopicNames& topics) {
  std::string first;
  for (const std::string& name : topics) {
    Names changes;
    AddPublishers(name, TopicOf(before, name), TopicOf(now, name), changes);
    if (!changes.empty() && (first.empty() || changes.front() < first)) first = changes.front();
  }
  return first;
}

}  // namespace rips::pipeline

#include "policy_server/ripsctl/robot/graph_view.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/btree_set.h"
#include "absl/container/flat_hash_map.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/printer.h"

namespace rips::ripsctl {
namespace {

// rmw_dds_common: the same name in every ROS 2 release, on every middleware.
constexpr absl::string_view kDiscoveryTopic = "ros_discovery_info";
// Of a GUID: the participant (DDSI-RTPS 2.5 §8.2.4.2).
constexpr size_t kPrefixBytes = 12;

using Participants = absl::flat_hash_map<std::string, const v1::Participant*>;  // by prefix

struct NodeView {
  std::vector<std::string> services;
  std::vector<const v1::Participant*> processes;
};

struct TopicView {
  absl::btree_set<std::string> types;
  std::vector<std::string> publishers;
  std::vector<std::string> subscribers;
};

struct Unattributed {
  std::string topic;
  std::string kind;
  std::string guid;
  const v1::Participant* process = nullptr;

  bool operator<(const Unattributed& other) const {
    return std::tie(topic, kind, guid) < std::tie(other.topic, other.kind, other.guid);
  }
};

// Points into the message that it was made of.
struct GraphView {
  absl::btree_map<std::string, NodeView> nodes;
  absl::btree_map<std::string, TopicView> topics;
  std::vector<Unattributed> unattributed;
};

const v1::Participant* FindProcess(const Participants& participants, const std::string& guid) {
  const auto found = participants.find(guid.substr(0, kPrefixBytes));
  return found == participants.end() ? nullptr : found->second;
}

void AddEndpoint(const v1::Endpoint& endpoint, const Participants& participants, GraphView& view) {
  if (endpoint.node().empty() || !endpoint.ros()) {
    view.unattributed.push_back({endpoint.name(), KindName(endpoint.kind()),
                                 GuidText(endpoint.guid()),
                                 FindProcess(participants, endpoint.guid())});
    return;
  }
  NodeView& node = view.nodes[endpoint.node()];
  if (endpoint.kind() == v1::Endpoint::SERVICE) node.services.push_back(endpoint.name());
  const bool publishes = endpoint.kind() == v1::Endpoint::PUBLISHER;
  if (!publishes && endpoint.kind() != v1::Endpoint::SUBSCRIBER) return;
  TopicView& topic = view.topics[endpoint.name()];
  topic.types.insert(endpoint.type());
  (publishes ? topic.publishers : topic.subscribers).push_back(endpoint.node());
}

GraphView MakeView(const v1::GraphSnapshot& graph) {
  Participants participants;
  for (const v1::Participant& each : graph.participants()) {
    participants.emplace(each.guid().substr(0, kPrefixBytes), &each);
  }
  GraphView view;
  for (const v1::Node& node : graph.nodes()) {
    std::vector<const v1::Participant*>& processes = view.nodes[node.full_name()].processes;
    const v1::Participant* const process = FindProcess(participants, node.participant_guid());
    if (process != nullptr) processes.push_back(process);
  }
  for (const v1::Endpoint& endpoint : graph.endpoints()) AddEndpoint(endpoint, participants, view);
  for (auto& [name, node] : view.nodes) {
    std::sort(node.services.begin(), node.services.end());
    std::sort(node.processes.begin(), node.processes.end(),
              [](const auto* a, const auto* b) { return a->guid() < b->guid(); });
  }
  for (auto& [name, topic] : view.topics) {
    std::sort(topic.publishers.begin(), topic.publishers.end());
    std::sort(topic.subscribers.begin(), topic.subscribers.end());
  }
  std::sort(view.unattributed.begin(), view.unattributed.end());
  return view;
}

Json ProcessJson(const v1::Participant& process) {
  return {{"address", process.address()},
          {"host", process.host()},
          {"pid", process.pid() == 0 ? Json(nullptr) : Json(process.pid())}};
}

// Cells of a table.
std::vector<std::string> ProcessCells(const v1::Participant* process) {
  if (process == nullptr) return {"", "", ""};
  return {process->address(), process->host(),
          process->pid() == 0 ? "" : absl::StrCat(process->pid())};
}

std::vector<std::string> Row(std::vector<std::string> front, const v1::Participant* process,
                             std::string last) {
  for (std::string& cell : ProcessCells(process)) front.push_back(std::move(cell));
  front.push_back(std::move(last));
  return front;
}

void PrintNodes(const GraphView& view, TextStream out) {
  Table nodes({"NODE", "ADDRESS", "HOST", "PID", "SERVICES"});
  for (const auto& [name, node] : view.nodes) {
    std::vector<const v1::Participant*> processes = node.processes;
    if (processes.empty()) processes.push_back(nullptr);
    // Once: a hostile host may give one node to every participant, and each many services.
    std::string services = absl::StrJoin(node.services, ", ");
    for (const v1::Participant* const each : processes) {
      nodes.Add(Row({name}, each, std::exchange(services, "(as above)")));
    }
  }
  nodes.Print(out);
}

void PrintTopics(const GraphView& view, TextStream out) {
  Table topics({"TOPIC", "TYPES", "PUBLISHERS", "SUBSCRIBERS"});
  for (const auto& [name, topic] : view.topics) {
    topics.Add({name, absl::StrJoin(topic.types, ", "), absl::StrJoin(topic.publishers, ", "),
                absl::StrJoin(topic.subscribers, ", ")});
  }
  topics.Print(out);
}

void PrintUnattributed(const GraphView& view, TextStream out) {
  Table others({"WITHOUT A NODE", "KIND", "ADDRESS", "HOST", "PID", "GUID"});
  size_t shown = 0;
  for (const Unattributed& each : view.unattributed) {
    if (each.topic == kDiscoveryTopic) continue;
    others.Add(Row({each.topic, each.kind}, each.process, each.guid));
    ++shown;
  }
  const size_t discovery = view.unattributed.size() - shown;
  if (shown > 0) {
    out << "\n";
    others.Print(out);
  }
  if (discovery > 0) {
    out << "\nand " << discovery << (discovery == 1 ? " endpoint" : " endpoints") << " of "
        << kDiscoveryTopic << ", by which each ROS 2 process tells its nodes\n";
  }
}

}  // namespace

Json GraphJson(const v1::GraphSnapshot& graph) {
  const GraphView view = MakeView(graph);
  Json json = {
      {"nodes", Json::array()}, {"topics", Json::array()}, {"unattributed", Json::array()}};
  for (const auto& [name, node] : view.nodes) {
    Json processes = Json::array();
    for (const v1::Participant* const each : node.processes) {
      processes.push_back(ProcessJson(*each));
    }
    json["nodes"].push_back(
        {{"name", name}, {"services", node.services}, {"processes", std::move(processes)}});
  }
  for (const auto& [name, topic] : view.topics) {
    json["topics"].push_back({{"name", name},
                              {"types", topic.types},
                              {"publishers", topic.publishers},
                              {"subscribers", topic.subscribers}});
  }
  for (const Unattributed& each : view.unattributed) {
    json["unattributed"].push_back(
        {{"guid", each.guid},
         {"topic", each.topic},
         {"kind", each.kind},
         {"process", each.process == nullptr ? Json(nullptr) : ProcessJson(*each.process)}});
  }
  return json;
}

void PrintGraph(const v1::GraphSnapshot& graph, TextStream out) {
  const GraphView view = MakeView(graph);
  out << "\n";
  PrintNodes(view, out);
  out << "\n";
  PrintTopics(view, out);
  PrintUnattributed(view, out);
  out << "\naddress, host and process id are what each process says of itself; it may lie\n";
}

}  // namespace rips::ripsctl

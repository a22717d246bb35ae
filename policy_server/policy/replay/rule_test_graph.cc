#include "policy_server/policy/replay/rule_test_graph.h"

#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"

namespace rips::replay {
namespace {

// Last byte of the entity id of a writer and of a reader without key (DDSI-RTPS 2.5 §9.3.1.2).
constexpr uint8_t kWriterKind = 0x03;
constexpr uint8_t kReaderKind = 0x04;
// RosGraph wants a type; this one is of no package.
constexpr char kNoType[] = "?";

bool Valid(const ConfigSection& section, absl::string_view key, const absl::Status& status) {
  if (!status.ok()) section.Problem(key, status.message());
  return status.ok();
}

}  // namespace

ros2::Guid RuleTestGraph::NewParticipant() {
  const uint32_t number = ++last_participant_;
  ros2::Guid guid;
  guid.bytes = {'t', 'e', 's', 't'};
  for (size_t i = 0; i < 4; ++i) guid.bytes[8 + i] = static_cast<uint8_t>(number >> (24 - 8 * i));
  return guid.Participant();
}

recording::RecordedGraph RuleTestGraph::Read(const ConfigSection& graph) {
  delta_ = {};
  nodes_.clear();
  writers_.clear();
  std::vector<std::string> names;
  graph.Optional("nodes", &names);
  for (const std::string& name : names) {
    if (!Valid(graph, "nodes", ros2::ValidateNodeName(name))) continue;
    const ros2::Guid participant = NewParticipant();
    nodes_[name].push_back(participant);
    delta_.upsert_participants.push_back({.guid = participant});
    delta_.upsert_nodes.push_back({.full_name = name, .participant = participant});
  }
  ReadTopics(graph.OptionalSection("topics"));
  ReadServices(graph.OptionalSection("services"));
  graph_.Clear();
  Valid(graph, "nodes", graph_.Apply(delta_));
  return {.content = delta_, .whole = true, .settled = true};
}

void RuleTestGraph::ReadTopics(const ConfigSection& topics) {
  for (const std::string& name : topics.Keys()) {
    const ConfigSection topic = topics.RequiredSection(name);
    // Without a name it is read and not added.
    const bool valid = Valid(topics, name, ros2::ValidateTopicName(name));
    std::string type;
    topic.Optional("type", &type);
    ros2::Endpoint pattern{.name = valid ? name : std::string(),
                           .type = type.empty() ? std::string(kNoType) : type};
    pattern.kind = ros2::EndpointKind::kPublisher;
    AddEndpoints(topic, "publishers", pattern);
    pattern.kind = ros2::EndpointKind::kSubscriber;
    AddEndpoints(topic, "subscribers", pattern);
  }
}

void RuleTestGraph::AddEndpoints(const ConfigSection& section, absl::string_view key,
                                 const ros2::Endpoint& pattern) {
  std::vector<std::string> names;
  section.Optional(key, &names);
  absl::btree_map<std::string, size_t> turns;
  for (const std::string& name : names) {
    const auto found = nodes_.find(name);
    if (found == nodes_.end()) {
      section.Problem(key, absl::StrCat("`", name, "` is not among `nodes`"));
      continue;
    }
    if (pattern.name.empty()) continue;
    const Participants& same = found->second;
    ros2::Endpoint endpoint = pattern;
    endpoint.node = name;
    AddEndpoint(same[turns[name]++ % same.size()], std::move(endpoint));
  }
}

void RuleTestGraph::AddEndpoint(const ros2::Guid& participant, ros2::Endpoint endpoint) {
  const uint32_t number = ++last_endpoint_;
  endpoint.guid = participant;
  for (size_t i = 0; i < 3; ++i) {
    endpoint.guid.bytes[12 + i] = static_cast<uint8_t>(number >> (16 - 8 * i));
  }
  const bool writes = endpoint.kind == ros2::EndpointKind::kPublisher;
  endpoint.guid.bytes[15] = writes ? kWriterKind : kReaderKind;
  if (writes) writers_.try_emplace({endpoint.node, endpoint.name}, endpoint.guid);
  delta_.upsert_endpoints.push_back(std::move(endpoint));
}

void RuleTestGraph::ReadServices(const ConfigSection& services) {
  for (const std::string& node : services.Keys()) {
    std::vector<std::string> names;
    services.Optional(node, &names);
    const auto found = nodes_.find(node);
    if (found == nodes_.end()) {
      services.Problem(node, absl::StrCat("`", node, "` is not among `nodes`"));
      continue;
    }
    for (const std::string& name : names) {
      if (!Valid(services, node, ros2::ValidateTopicName(name))) continue;
      AddEndpoint(found->second.front(), {.kind = ros2::EndpointKind::kService,
                                          .name = name,
                                          .type = "std_srvs/srv/Empty",
                                          .node = node});
    }
  }
}

std::string RuleTestGraph::TypeOf(absl::string_view topic) const {
  const ros2::Topic* found = graph_.FindTopic(topic);
  const bool known = found != nullptr && !found->types.empty() && found->types.front() != kNoType;
  return known ? found->types.front() : "";
}

ros2::Guid RuleTestGraph::WriterOf(absl::string_view node, absl::string_view topic) {
  if (node.empty()) return {};
  const auto [found, fresh] =
      writers_.try_emplace({std::string(node), std::string(topic)}, ros2::Guid());
  if (fresh) {
    found->second = NewParticipant();
    found->second.bytes[13] = 0;
    found->second.bytes[14] = 1;
    found->second.bytes[15] = kWriterKind;
  }
  return found->second;
}

}  // namespace rips::replay

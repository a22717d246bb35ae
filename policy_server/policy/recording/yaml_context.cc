#include "policy_server/policy/recording/yaml_context.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::recording {
namespace {

constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
// RosGraph wants a type; this one is of no package.
constexpr char kNoType[] = "?";

// Last byte of an entity id, of a writer and of a reader without key (DDSI-RTPS 2.5 §9.3.1.2).
constexpr uint8_t kWriterKind = 0x03;
constexpr uint8_t kReaderKind = 0x04;

ros2::Guid MakeParticipant(uint32_t number) {
  ros2::Guid guid;
  guid.bytes = {'r', 'e', 'c', 'o', 'r', 'd'};
  for (size_t i = 0; i < 4; ++i) guid.bytes[8 + i] = static_cast<uint8_t>(number >> (24 - 8 * i));
  return guid.Participant();
}

ros2::Guid MakeEndpoint(const ros2::Guid& participant, uint32_t number, bool writer) {
  ros2::Guid guid = participant;
  for (size_t i = 0; i < 3; ++i) guid.bytes[12 + i] = static_cast<uint8_t>(number >> (16 - 8 * i));
  guid.bytes[15] = writer ? kWriterKind : kReaderKind;
  return guid;
}

// "std_msgs/String" -> "std_msgs/msg/String"; other forms stay.
std::string FullType(const std::string& type, absl::string_view middle) {
  const std::vector<std::string> parts = absl::StrSplit(type, '/');
  if (parts.size() != 2) return type;
  return absl::StrCat(parts[0], "/", middle, "/", parts[1]);
}

absl::StatusOr<std::string> TextOf(const YamlNode& node, absl::string_view what) {
  if (node.kind == YamlNode::Kind::kScalar && !node.text.empty()) return node.text;
  return AtLine(kInvalid, node.line, absl::StrCat("`", what, "` is not a text"));
}

absl::StatusOr<std::string> RequiredText(const YamlNode& map, absl::string_view key) {
  if (map.kind != YamlNode::Kind::kMap) {
    return AtLine(kInvalid, map.line, absl::StrCat("a mapping with `", key, "` is expected"));
  }
  const YamlNode* node = map.Find(key);
  if (node == nullptr) return AtLine(kInvalid, map.line, absl::StrCat("no `", key, "`"));
  return TextOf(*node, key);
}

absl::StatusOr<std::string> NameOf(const std::string& text, uint64_t line) {
  const std::string name = InRoot(text);
  const absl::Status status = ros2::ValidateTopicName(name);
  if (!status.ok()) return AtLine(kInvalid, line, status.message());
  return name;
}

// The items under `key` that are not null.
absl::StatusOr<std::vector<const YamlNode*>> ListOf(const YamlNode& map, absl::string_view key) {
  std::vector<const YamlNode*> items;
  const YamlNode* list = map.Find(key);
  if (list == nullptr) return items;
  if (list->kind != YamlNode::Kind::kList) {
    return AtLine(kInvalid, list->line, absl::StrCat("`", key, "` is not a list"));
  }
  for (const YamlNode& item : list->items) {
    if (item.kind != YamlNode::Kind::kNull) items.push_back(&item);
  }
  return items;
}

// One type, or a list of them.
absl::StatusOr<std::vector<std::string>> TypesOf(const YamlNode& map, absl::string_view key,
                                                 absl::string_view middle) {
  std::vector<std::string> types;
  const YamlNode* node = map.Find(key);
  if (node != nullptr && node->kind == YamlNode::Kind::kScalar) {
    RIPS_ASSIGN_OR_RETURN(const std::string type, TextOf(*node, key));
    types.push_back(FullType(type, middle));
  } else {
    RIPS_ASSIGN_OR_RETURN(const auto items, ListOf(map, key));
    for (const YamlNode* item : items) {
      RIPS_ASSIGN_OR_RETURN(const std::string type, TextOf(*item, key));
      types.push_back(FullType(type, middle));
    }
  }
  for (const std::string& type : types) {
    if (type == ros2::Printable(type)) continue;
    return AtLine(kInvalid, node->line,
                  absl::StrCat("`", ros2::Printable(type), "` is not a type"));
  }
  return types;
}

}  // namespace

std::string InRoot(const std::string& name) {
  return name.find('/') == std::string::npos ? absl::StrCat("/", name) : name;
}

class YamlContexts::Builder {
 public:
  explicit Builder(YamlContexts* contexts) : contexts_(*contexts) {}

  absl::Status AddNode(const YamlNode& node);
  absl::Status AddTopic(const YamlNode& topic);
  ros2::GraphDelta Take() { return std::move(delta_); }

 private:
  struct Owner {
    ros2::Guid participant;
    uint32_t endpoints = 0;
  };

  absl::StatusOr<Owner*> NewOwner(const std::string& name, uint64_t line);
  absl::Status AddEndpoint(Owner* owner, uint64_t line, ros2::Endpoint endpoint);

  YamlContexts& contexts_;
  ros2::GraphDelta delta_;
  // Nodes by name.
  absl::flat_hash_map<std::string, std::vector<Owner>> owners_;
};

absl::StatusOr<YamlContexts::Builder::Owner*> YamlContexts::Builder::NewOwner(
    const std::string& name, uint64_t line) {
  std::vector<Owner>& same = owners_[name];
  auto& known = contexts_.participants_;
  const std::pair<std::string, uint32_t> key(name, static_cast<uint32_t>(same.size()));
  auto at = known.find(key);
  if (at == known.end()) {
    if (known.size() >= kYamlParticipantsMax) {
      return AtLine(absl::StatusCode::kResourceExhausted, line,
                    absl::StrCat("more nodes than the limit of ", kYamlParticipantsMax));
    }
    const auto number = static_cast<uint32_t>(known.size() + 1);
    at = known.emplace(key, MakeParticipant(number)).first;
  }
  same.push_back({.participant = at->second});
  delta_.upsert_participants.push_back({.guid = at->second});
  delta_.upsert_nodes.push_back({.full_name = name, .participant = at->second});
  return &same.back();
}

absl::Status YamlContexts::Builder::AddEndpoint(Owner* owner, uint64_t line,
                                                ros2::Endpoint endpoint) {
  if (delta_.upsert_endpoints.size() >= kYamlEndpointsMax) {
    return AtLine(absl::StatusCode::kResourceExhausted, line,
                  absl::StrCat("more endpoints than the limit of ", kYamlEndpointsMax));
  }
  endpoint.guid = MakeEndpoint(owner->participant, ++owner->endpoints,
                               endpoint.kind == ros2::EndpointKind::kPublisher);
  delta_.upsert_endpoints.push_back(std::move(endpoint));
  return absl::OkStatus();
}

absl::Status YamlContexts::Builder::AddNode(const YamlNode& node) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, RequiredText(node, "node"));
  RIPS_ASSIGN_OR_RETURN(const std::string name, NameOf(text, node.line));
  RIPS_ASSIGN_OR_RETURN(Owner * owner, NewOwner(name, node.line));
  RIPS_ASSIGN_OR_RETURN(const auto services, ListOf(node, "services"));
  for (const YamlNode* each : services) {
    RIPS_ASSIGN_OR_RETURN(const std::string service_text, RequiredText(*each, "service"));
    RIPS_ASSIGN_OR_RETURN(std::string service, NameOf(service_text, each->line));
    RIPS_ASSIGN_OR_RETURN(const auto types, TypesOf(*each, "params", "srv"));
    RIPS_RETURN_IF_ERROR(AddEndpoint(owner, each->line,
                                     {.kind = ros2::EndpointKind::kService,
                                      .name = std::move(service),
                                      .type = types.empty() ? kNoType : types[0],
                                      .node = name}));
  }
  return absl::OkStatus();
}

absl::Status YamlContexts::Builder::AddTopic(const YamlNode& topic) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, RequiredText(topic, "topic"));
  RIPS_ASSIGN_OR_RETURN(const std::string name, NameOf(text, topic.line));
  RIPS_ASSIGN_OR_RETURN(const auto types, TypesOf(topic, "parameters", "msg"));
  if (!types.empty()) contexts_.types_.try_emplace(name, types[0]);
  size_t endpoints = 0;
  for (const bool writers : {true, false}) {
    RIPS_ASSIGN_OR_RETURN(const auto nodes, ListOf(topic, writers ? "publishers" : "subscribers"));
    absl::flat_hash_map<std::string, size_t> turn;
    for (const YamlNode* each : nodes) {
      RIPS_ASSIGN_OR_RETURN(const std::string node_text, TextOf(*each, "node"));
      RIPS_ASSIGN_OR_RETURN(const std::string node, NameOf(node_text, each->line));
      std::vector<Owner>& same = owners_[node];
      if (same.empty()) RIPS_RETURN_IF_ERROR(NewOwner(node, each->line).status());
      Owner* owner = &same[turn[node]++ % same.size()];
      const auto kind = writers ? ros2::EndpointKind::kPublisher : ros2::EndpointKind::kSubscriber;
      RIPS_RETURN_IF_ERROR(
          AddEndpoint(owner, each->line,
                      {.kind = kind,
                       .name = name,
                       .type = types.empty() ? kNoType : types[endpoints++ % types.size()],
                       .node = node}));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<ros2::GraphDelta> YamlContexts::Decode(const YamlNode& context) {
  if (context.kind != YamlNode::Kind::kMap) {
    return AtLine(kInvalid, context.line, "`context` is not a mapping");
  }
  types_.clear();
  Builder builder(this);
  RIPS_ASSIGN_OR_RETURN(const auto nodes, ListOf(context, "nodes"));
  for (const YamlNode* node : nodes) RIPS_RETURN_IF_ERROR(builder.AddNode(*node));
  RIPS_ASSIGN_OR_RETURN(const auto topics, ListOf(context, "topics"));
  for (const YamlNode* topic : topics) RIPS_RETURN_IF_ERROR(builder.AddTopic(*topic));
  return builder.Take();
}

std::string YamlContexts::TypeOf(const std::string& topic) const {
  const auto at = types_.find(topic);
  return at == types_.end() ? std::string() : at->second;
}

}  // namespace rips::recording

#include "policy_server/ripsctl/robot/graph_view.h"

#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::ripsctl {
namespace {

using testing::HasSubstr;
using testing::Not;

// 16 bytes: the prefix of `participant`, and an entity.
std::string Guid(char participant, char entity) {
  return absl::StrCat(std::string("\x01\x10\x4a\x3b", 4), std::string(7, '\0'),
                      std::string(1, participant), std::string(3, '\0'), std::string(1, entity));
}

void AddProcess(char participant, const std::string& address, const std::string& host, uint32_t pid,
                v1::GraphSnapshot& graph) {
  v1::Participant& process = *graph.add_participants();
  process.set_guid(Guid(participant, '\xc1'));
  process.set_address(address);
  process.set_host(host);
  process.set_pid(pid);
}

void AddNode(const std::string& name, char participant, v1::GraphSnapshot& graph) {
  v1::Node& node = *graph.add_nodes();
  node.set_full_name(name);
  node.set_participant_guid(Guid(participant, '\xc1'));
}

void AddEndpoint(v1::Endpoint::Kind kind, const std::string& node, const std::string& name,
                 char participant, v1::GraphSnapshot& graph) {
  v1::Endpoint& endpoint = *graph.add_endpoints();
  endpoint.set_guid(Guid(participant, '\x03'));
  endpoint.set_kind(kind);
  endpoint.set_node(node);
  endpoint.set_name(name);
  endpoint.set_type("std_msgs/msg/String");
  endpoint.set_ros(name.starts_with("/"));
}

// Of a robot with a talker and a listener, a talker of the same name on another host, and a process
// that publishes /cmd_vel and announces no node.
v1::GraphSnapshot Graph() {
  v1::GraphSnapshot graph;
  AddProcess('2', "10.0.0.66", "vm", 0, graph);
  AddProcess('1', "10.0.0.11", "base", 4711, graph);
  AddNode("/talker", '2', graph);
  AddNode("/talker", '1', graph);
  AddNode("/listener", '1', graph);
  AddEndpoint(v1::Endpoint::SUBSCRIBER, "/rips", "/chatter", '9', graph);
  AddEndpoint(v1::Endpoint::SUBSCRIBER, "/listener", "/chatter", '1', graph);
  AddEndpoint(v1::Endpoint::PUBLISHER, "/talker", "/chatter", '2', graph);
  AddEndpoint(v1::Endpoint::PUBLISHER, "/talker", "/chatter", '1', graph);
  AddEndpoint(v1::Endpoint::SERVICE, "/talker", "/talker/get_parameters", '1', graph);
  AddEndpoint(v1::Endpoint::CLIENT, "/listener", "/talker/get_parameters", '1', graph);
  AddEndpoint(v1::Endpoint::PUBLISHER, "", "/cmd_vel", '2', graph);
  AddEndpoint(v1::Endpoint::SUBSCRIBER, "", "raw_topic", '9', graph);
  AddEndpoint(v1::Endpoint::PUBLISHER, "", "ros_discovery_info", '1', graph);
  AddEndpoint(v1::Endpoint::SUBSCRIBER, "", "ros_discovery_info", '1', graph);
  return graph;
}

std::string Text(const v1::GraphSnapshot& graph) {
  std::ostringstream out;
  PrintGraph(graph, out);
  return out.str();
}

TEST(GraphViewTest, TellsWhereEachNodeAndEachEndpointWithoutANodeIs) {
  EXPECT_EQ(
      Text(Graph()),
      "\n"
      "NODE       ADDRESS    HOST  PID   SERVICES\n"
      "/listener  10.0.0.11  base  4711  -\n"
      "/rips      -          -     -     -\n"
      "/talker    10.0.0.11  base  4711  /talker/get_parameters\n"
      "/talker    10.0.0.66  vm    -     (as above)\n"
      "\n"
      "TOPIC     TYPES                PUBLISHERS        SUBSCRIBERS\n"
      "/chatter  std_msgs/msg/String  /talker, /talker  /listener, /rips\n"
      "\n"
      "WITHOUT A NODE  KIND        ADDRESS    HOST  PID  GUID\n"
      "/cmd_vel        publisher   10.0.0.66  vm    -    01104a3b.00000000.00000032.00000003\n"
      "raw_topic       subscriber  -          -     -    01104a3b.00000000.00000039.00000003\n"
      "\n"
      "and 2 endpoints of ros_discovery_info, by which each ROS 2 process tells its nodes\n"
      "\n"
      "address, host and process id are what each process says of itself; it may lie\n");
}

TEST(GraphViewTest, AsJson) {
  EXPECT_EQ(nlohmann::json(GraphJson(Graph())), nlohmann::json::parse(R"({
    "nodes": [
      {"name": "/listener", "services": [],
       "processes": [{"address": "10.0.0.11", "host": "base", "pid": 4711}]},
      {"name": "/rips", "services": [], "processes": []},
      {"name": "/talker", "services": ["/talker/get_parameters"],
       "processes": [{"address": "10.0.0.11", "host": "base", "pid": 4711},
                     {"address": "10.0.0.66", "host": "vm", "pid": null}]}],
    "topics": [{"name": "/chatter", "types": ["std_msgs/msg/String"],
                "publishers": ["/talker", "/talker"], "subscribers": ["/listener", "/rips"]}],
    "unattributed": [
      {"guid": "01104a3b.00000000.00000032.00000003", "topic": "/cmd_vel", "kind": "publisher",
       "process": {"address": "10.0.0.66", "host": "vm", "pid": null}},
      {"guid": "01104a3b.00000000.00000039.00000003", "topic": "raw_topic", "kind": "subscriber",
       "process": null},
      {"guid": "01104a3b.00000000.00000031.00000003", "topic": "ros_discovery_info",
       "kind": "publisher", "process": {"address": "10.0.0.11", "host": "base", "pid": 4711}},
      {"guid": "01104a3b.00000000.00000031.00000003", "topic": "ros_discovery_info",
       "kind": "subscriber", "process": {"address": "10.0.0.11", "host": "base", "pid": 4711}}]
  })"));
}

TEST(GraphViewTest, AHealthyRobotHasNoTableOfTheRest) {
  v1::GraphSnapshot graph;
  AddProcess('1', "10.0.0.11", "base", 4711, graph);
  AddNode("/talker", '1', graph);
  AddEndpoint(v1::Endpoint::PUBLISHER, "", "ros_discovery_info", '1', graph);
  const std::string text = Text(graph);
  EXPECT_THAT(text, HasSubstr("and 1 endpoint of ros_discovery_info"));
  EXPECT_THAT(text, Not(HasSubstr("WITHOUT A NODE")));
}

TEST(GraphViewTest, WhatAHostileProcessSaysIsEscaped) {
  v1::GraphSnapshot graph;
  AddProcess('1', "10.0.0.66\n", "\x1b[2Jvm", 1, graph);
  AddNode("/a", '1', graph);
  AddEndpoint(v1::Endpoint::PUBLISHER, "", "/b", '1', graph);
  graph.add_endpoints()->set_guid("short");
  const std::string text = Text(graph);
  EXPECT_THAT(text, Not(HasSubstr("\x1b[2J")));
  EXPECT_THAT(text, HasSubstr("\\x1b[2Jvm"));
  EXPECT_THAT(text, HasSubstr("invalid"));
}

}  // namespace
}  // namespace rips::ripsctl

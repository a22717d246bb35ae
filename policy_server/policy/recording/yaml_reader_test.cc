#include "policy_server/policy/recording/yaml_reader.h"

#include "absl/strings/match.h"
#include "absl/strings/str_replace.h"
#include "policy_server/policy/recording/recording_test_data.h"
#include "policy_server/policy/recording/yaml_context.h"
#include "policy_server/policy/recording/yaml_tree.h"
#include "services/ros2/ros_graph.h"

namespace rips::recording {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr auto kDataLoss = absl::StatusCode::kDataLoss;
constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
constexpr auto kExhausted = absl::StatusCode::kResourceExhausted;

const char kStream[] = R"(---
event: message
fromtopic: /chatter
rawmsg: |
  AAEAAAYA
  AABoZWxsbwA=
msg: ignored
currentlevel: 2
currentgrav: 0.5
lastalert: ~
context:
  nodes:
    - node: talker
      gids: ["01.0f", 17]
      services:
        - service: /talker/get_parameters
          params: rcl_interfaces/GetParameters
    - node: /ns/listener
      gids: [~]
      services: [~]
  topics:
    - topic: /chatter
      parameters: [std_msgs/String]
      publishers: [talker]
      subscribers: [/ns/listener]
    - topic: /empty
      parameters: [~]
      publishers: [~]
      subscribers: [~]
...
---
event: tick
...
---
event: message
fromtopic: chatter
rawmsg: AAEAAA==
...
---
event: graph
context:
  nodes: [~]
  topics: [~]
...
)";

ros2::RosGraph GraphOf(const RecordedGraph& recorded) {
  ros2::RosGraph graph;
  EXPECT_THAT(graph.Apply(recorded.content), IsOk());
  return graph;
}

class YamlReaderTest : public testing::Test {
 protected:
  Reading Read(absl::string_view text) { return ReadAll(folder_.Write("events.yaml", text)); }
  // One graph event with this context, as flow text.
  Reading ReadContext(absl::string_view context) {
    return Read(absl::StrCat("---\nevent: graph\ncontext: ", context, "\n...\n"));
  }
  ros2::RosGraph ReadGraph(absl::string_view context) {
    const Reading reading = ReadContext(context);
    EXPECT_THAT(reading.status, IsOk());
    if (reading.events.size() != 1) return ros2::RosGraph();
    return GraphOf(std::get<RecordedGraph>(reading.events[0].what));
  }

  const TempFolder folder_;
};

TEST_F(YamlReaderTest, GivesEveryDocumentAsOneEvent) {
  const Reading reading = Read(kStream);

  ASSERT_THAT(reading.status, IsOk());
  ASSERT_THAT(reading.events, SizeIs(4));
  const std::string payload("\0\1\0\0\6\0\0\0hello\0", 14);
  EXPECT_EQ(MessageOf(reading.events[0]), (RecordedMessage{.topic = "/chatter",
                                                           .type = "std_msgs/msg/String",
                                                           .payload = payload,
                                                           .size_bytes = 14}));
  EXPECT_EQ(reading.events[0].time_unix_ns, std::nullopt);
  EXPECT_EQ(std::get<RecordedOther>(reading.events[1].what).what, "tick");
  EXPECT_FALSE(reading.events[1].context);
  EXPECT_FALSE(reading.events[2].context) << "the graph stays";
  EXPECT_EQ(MessageOf(reading.events[2]).topic, "/chatter");
  EXPECT_EQ(MessageOf(reading.events[2]).type, "std_msgs/msg/String");
  const auto& graph = std::get<RecordedGraph>(reading.events[3].what);
  EXPECT_TRUE(graph.whole);
  EXPECT_TRUE(graph.content.empty());
  EXPECT_FALSE(reading.events[3].context) << "of a graph event it is the event";
  EXPECT_TRUE((*Open(folder_.File("events.yaml")))->has_graph());
}

TEST_F(YamlReaderTest, TheContextIsAGraph) {
  const Reading reading = Read(kStream);

  ASSERT_TRUE(reading.events[0].context);
  EXPECT_TRUE(reading.events[0].context->whole);
  EXPECT_TRUE(reading.events[0].context->settled);
  const ros2::RosGraph graph = GraphOf(*reading.events[0].context);
  ASSERT_THAT(graph.nodes(), SizeIs(2));
  EXPECT_EQ(graph.nodes().begin()->full_name, "/ns/listener");
  EXPECT_EQ(graph.nodes().rbegin()->full_name, "/talker");
  EXPECT_THAT(graph.ServicesOf("/talker"), ElementsAre("/talker/get_parameters"));
  ASSERT_THAT(graph.topics(), SizeIs(1));
  const ros2::Topic& topic = *graph.FindTopic("/chatter");
  EXPECT_THAT(topic.publishers, ElementsAre("/talker"));
  EXPECT_THAT(topic.subscribers, ElementsAre("/ns/listener"));
  EXPECT_THAT(topic.types, ElementsAre("std_msgs/msg/String"));
}

TEST_F(YamlReaderTest, TwoNodesOfOneNameAreTwo) {
  const ros2::RosGraph graph = ReadGraph(
      "{nodes: [{node: a}, {node: /a}], topics: [{topic: /t, parameters: [p/msg/T, p/U], "
      "publishers: [a, a, a], subscribers: [~]}]}");
  EXPECT_THAT(graph.nodes(), SizeIs(2));
  EXPECT_THAT(graph.participants(), SizeIs(2));
  EXPECT_THAT(graph.FindTopic("/t")->publishers, ElementsAre("/a", "/a", "/a"));
  EXPECT_THAT(graph.FindTopic("/t")->types, ElementsAre("p/msg/T", "p/msg/U"));
}

TEST_F(YamlReaderTest, WhoPublishesIsANode) {
  const ros2::RosGraph graph =
      ReadGraph("{nodes: [~], topics: [{topic: /t, publishers: [b], subscribers: [b]}]}");
  EXPECT_THAT(graph.nodes(), SizeIs(1));
  EXPECT_THAT(graph.FindTopic("/t")->subscribers, ElementsAre("/b"));
}

TEST_F(YamlReaderTest, ANodeKeepsItsGuidThroughoutTheFile) {
  const Reading reading = Read(
      "---\nevent: graph\ncontext: {nodes: [{node: a}, {node: b}]}\n...\n"
      "---\nevent: graph\ncontext: {nodes: [{node: c}, {node: b}]}\n...\n");
  ASSERT_THAT(reading.status, IsOk());
  const auto first = std::get<RecordedGraph>(reading.events[0].what).content;
  const auto second = std::get<RecordedGraph>(reading.events[1].what).content;
  EXPECT_EQ(first.upsert_nodes[1], second.upsert_nodes[1]);
  EXPECT_NE(first.upsert_nodes[0].participant, second.upsert_nodes[0].participant);
}

TEST_F(YamlReaderTest, AMessageWithoutPayloadIsTruncated) {
  const Reading reading = Read(
      "event: message\nfromtopic: /t\n---\n"
      "event: message\nfromtopic: /t\nrawmsg: ''\n");
  ASSERT_THAT(reading.status, IsOk());
  EXPECT_TRUE(MessageOf(reading.events[0]).truncated);
  EXPECT_EQ(MessageOf(reading.events[0]).type, "");
  EXPECT_FALSE(MessageOf(reading.events[1]).truncated);
}

TEST_F(YamlReaderTest, TakesAnyWayToSeparateDocuments) {
  const std::pair<const char*, size_t> cases[] = {
      {"event: a\n", 1},
      {"# about\n---\n# more\nevent: a\n", 1},
      {"%YAML 1.2\n---\nevent: a\n...\n", 1},
      {"\xef\xbb\xbf---\nevent: a\n...\n", 1},
      {"event: a\n---\nevent: b\n---\n", 2},
      {"--- {event: a}\n... # end\n--- {event: b}\n...", 2},
      {"event: a\n...\nevent: b\n...\n", 2},
      {"---\n...\n---\n---\n~\n...\n---\nevent: a\n...\n\n# end\n", 1},
      {"---\r\nevent: a\r\n...\r\n---\r\nevent: b\r\n...\r\n", 2},
  };
  for (const auto& [text, count] : cases) {
    const Reading reading = Read(text);
    EXPECT_THAT(reading.status, IsOk()) << text;
    EXPECT_THAT(reading.events, SizeIs(count)) << text;
  }
}

TEST_F(YamlReaderTest, LineBreaksAndIndentationChangeNothing) {
  const std::vector<std::string> events = Print(Read(kStream).events);
  const std::string windows = absl::StrReplaceAll(kStream, {{"\n", "\r\n"}});
  EXPECT_EQ(Print(Read(windows).events), events);
  const std::string wide = absl::StrReplaceAll(kStream, {{"\n  ", "\n      "}});
  EXPECT_EQ(Print(Read(wide).events), events);
}

TEST_F(YamlReaderTest, ADocumentThatIsCutIsSeen) {
  const std::string stream = kStream;
  // Whole documents are a recording; so is a first document up to the end of any line.
  ExpectCutsAreSeen(stream.substr(stream.find("---\nevent: tick")), [&](size_t cut) {
    const std::string rest = stream.substr(stream.find("---\nevent: tick")).substr(0, cut);
    return absl::EndsWith(rest, "...\n") || absl::EndsWith(rest, "...") ||
           absl::EndsWith(rest, "\n---") || absl::EndsWith(rest, "---\n") ||
           rest == "---\nevent: tick\n";
  });
  const Reading reading = Read("---\nevent: a\n...\n---\nevent: b\n");
  EXPECT_THAT(reading.status,
              StatusIs(kDataLoss, HasSubstr("document 1: line 5: the file is cut")));
  EXPECT_THAT(Read("event: a").status, StatusIs(kDataLoss, HasSubstr("line 1")));
}

struct Malformed {
  const char* name;
  std::string text;
  absl::StatusCode code;
  const char* message;
};

TEST_F(YamlReaderTest, RefusesWhatIsMalformed) {
  const Malformed cases[] = {
      {"nothing", "# nothing\n", kInvalid, "no event in the whole file"},
      {"markers only", "---\n...\n---\n...\n", kInvalid, "no event"},
      {"not YAML", "event: a\nb: [\n---\n", kInvalid, "not YAML"},
      {"something after", "{event: a} b\n", kInvalid, "something follows"},
      {"list after", "event: a\n]\n", kInvalid, ""},
      {"text", "some words\n", kInvalid, "line 1: not an event"},
      {"list", "---\n- event\n...\n", kInvalid, "line 2: not an event"},
      {"no kind", "fromtopic: /a\n", kInvalid, "no `event`"},
      {"kind is a list", "event: [a]\n", kInvalid, "`event` is not a text"},
      {"no topic", "---\nevent: message\n...\n", kInvalid, "document 0: line 2: no `fromtopic`"},
      {"long topic", absl::StrCat("event: message\nfromtopic: ", std::string(1'025, 't'), "\n"),
       kExhausted, "limit of 1024"},
      {"base64", "event: message\nfromtopic: /a\nrawmsg: '*'\n", kInvalid, "not base64"},
      {"base64 list", "event: message\nfromtopic: /a\nrawmsg: [1]\n", kInvalid, "not base64"},
      {"alias", "event: &a x\nother: *a\n", kInvalid, "anchors are not supported"},
      {"alias alone", "event: *a\n", kInvalid, ""},
      {"key twice", "event: a\nevent: b\n", kInvalid, "line 2: key `event` is there twice"},
      {"key", "? [a]\n: b\n", kInvalid, "a key must be a text"},
      {"byte 0", std::string("event: a\n\0\n", 11), kInvalid, "line 2: a byte 0"},
      {"context", "event: a\ncontext: [a]\n", kInvalid, "`context` is not a mapping"},
      {"nodes", "event: a\ncontext: {nodes: a}\n", kInvalid, "`nodes` is not a list"},
      {"node", "event: a\ncontext: {nodes: [a]}\n", kInvalid, "a mapping with `node`"},
      {"node name", "event: a\ncontext: {nodes: [{node: 'a b'}]}\n", kInvalid, "line 2"},
      {"node without name", "event: a\ncontext: {nodes: [{x: a}]}\n", kInvalid, "no `node`"},
      {"service", "event: a\ncontext: {nodes: [{node: a, services: [b]}]}\n", kInvalid,
       "a mapping with `service`"},
      {"topic name", "event: a\ncontext: {topics: [{topic: ''}]}\n", kInvalid,
       "`topic` is not a text"},
      {"publisher", "event: a\ncontext: {topics: [{topic: t, publishers: [{a: b}]}]}\n", kInvalid,
       "`node` is not a text"},
      {"type", "event: a\ncontext: {topics: [{topic: t, parameters: [\"\\x01\"]}]}\n", kInvalid,
       "is not a type"},
      {"second", "---\nevent: a\n...\n---\nb: c\n...\n", kInvalid, "document 1: line 5"},
  };
  for (const Malformed& each : cases) {
    const Reading reading = Read(each.text);
    EXPECT_THAT(reading.status, StatusIs(each.code, HasSubstr(each.message))) << each.name;
    EXPECT_THAT(std::string(reading.status.message()), HasSubstr("events.yaml`: document "));
  }
}

TEST_F(YamlReaderTest, RefusesMoreThanItsLimits) {
  std::string deep = "event: a\nx: ";
  for (size_t i = 0; i < kYamlDepthMax; ++i) deep += "[";
  for (size_t i = 0; i < kYamlDepthMax; ++i) deep += "]";
  EXPECT_THAT(Read(deep + "\n").status, StatusIs(kExhausted, HasSubstr("nesting exceeds")));
  EXPECT_THAT(Read("event: a\nx: " + std::string(100'000, '[') + "\n").status,
              testing::Not(IsOk()));

  std::string keys = "event: a\n";
  for (size_t i = 0; i < kYamlKeysMax; ++i) absl::StrAppend(&keys, "k", i, ": 1\n");
  EXPECT_THAT(Read(keys).status, StatusIs(kExhausted, HasSubstr("limit of 256")));

  std::string values = "event: a\nx: [";
  for (size_t i = 0; i < kYamlNodesMax; ++i) values += "1,";
  EXPECT_THAT(Read(values + "]\n").status, StatusIs(kExhausted, HasSubstr("limit of 262144")));

  const std::string line = "# " + std::string(1'000, 'x') + "\n";
  std::string document = "event: a\n";
  while (document.size() <= kYamlDocumentBytesMax) document += line;
  EXPECT_THAT(Read(document).status, StatusIs(kExhausted, HasSubstr("limit of 16777216")));
  EXPECT_THAT(Read(std::string(kYamlDocumentBytesMax + 1, 'x')).status,
              StatusIs(kExhausted, HasSubstr("limit of 16777216")));

  std::string names = "{topics: [{topic: t, publishers: [";
  for (size_t i = 0; i <= kYamlParticipantsMax; ++i) absl::StrAppend(&names, "n", i, ",");
  EXPECT_THAT(ReadContext(names + "]}]}").status,
              StatusIs(kExhausted, HasSubstr("limit of 65536")));
  std::string endpoints = "{topics: [{topic: t, subscribers: [";
  for (size_t i = 0; i <= kYamlEndpointsMax; ++i) endpoints += "n,";
  EXPECT_THAT(ReadContext(endpoints + "]}]}").status,
              StatusIs(kExhausted, HasSubstr("more endpoints than the limit of 65536")));
}

TEST_F(YamlReaderTest, AlwaysGivesTheSame) {
  const auto first = Print(Read(kStream).events);
  EXPECT_THAT(first, testing::Not(IsEmpty()));
  EXPECT_EQ(Print(Read(kStream).events), first);
}

}  // namespace
}  // namespace rips::recording

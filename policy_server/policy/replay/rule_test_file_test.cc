#include "policy_server/policy/replay/rule_test_file.h"

#include <stdlib.h>

#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "services/base/status_matchers.h"
#include "services/ros2/cdr.h"
#include "services/runtime/config_reader.h"

namespace rips::replay {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

// One test with these events.
std::string WithEvents(const std::string& events) {
  return absl::StrCat("rules: [a.rul]\ntests:\n  - name: t\n    events:\n", events);
}

absl::Status ErrorOf(const std::string& text) {
  return ParseRuleTestFile("d/x_test.yaml", text).status();
}

TEST(RuleTestFileTest, ReadsAllOfIt) {
  const auto file = ParseRuleTestFile("d/x_test.yaml", R"(
rules: [a.rul, /b.rul]
dialect: prototype
robot: r1
start_level: A
on_inspection_error: ignore
tests:
  - name: one
    start_level: B
    variables: {n: 1, s: ""}
    exec_fail: [p]
    trigger_fail: [C]
    evidence: incomplete
    events:
      - graph:
          nodes: [/a, /b, /b]
          topics:
            /t: {type: p/msg/T, publishers: [/a, /b, /b], subscribers: [/b]}
          services: {/a: [/a/s]}
      - message: {topic: /t, sender: /a, payload_hex: 00ff, size: 7, repeat: 3, every_ms: 5}
      - message: {topic: /t, type: p/msg/U, sender: /x, payload_text: hello}
      - message: {topic: /u}
      - ids: {sid: 7, gid: 3, message: m, source: s, target: t}
      - signal: SIGUSR2
      - agent: [sensor, lost]
      - finding: impostor
      - lost: 12
      - tick: {repeat: 5}
      - tick:
      - wait_ms: 500
        expect: {level: A, alerts: [{rule: r}], execs: [{program: p, args: []}], fired: [],
                 faults: [], transitions: [{to: B}], variables: {n: 2}, unscanned: [r]}
      - operator: {lower: A}
      - operator: {raise: B}
      - evidence: complete
      - evidence: incomplete
    expect: {alerts: []}
)");
  ASSERT_THAT(file, IsOk());
  EXPECT_THAT(file->rules, ElementsAre("d/a.rul", "/b.rul"));
  EXPECT_EQ(file->options.dialect, lang::CheckedRules::Dialect::kPrototype);
  EXPECT_EQ(file->options.on_inspection_error, engine::OnInspectionError::kIgnore);
  EXPECT_EQ(file->robot, "r1");
  EXPECT_EQ(file->start_level.text, "A");
  ASSERT_EQ(file->tests.size(), 1u);
  const RuleTest& test = file->tests[0];
  EXPECT_EQ(test.line, 8);
  EXPECT_EQ(test.start_level.text, "B");
  EXPECT_EQ(test.variables.at("n").text, "1");
  EXPECT_EQ(test.variables.at("s").text, "");
  EXPECT_FALSE(test.evidence_complete);
  ASSERT_EQ(test.events.size(), 16u);

  const auto& graph = std::get<recording::RecordedGraph>(test.events[0].what);
  EXPECT_TRUE(graph.whole && graph.settled);
  EXPECT_EQ(graph.content.upsert_nodes.size(), 3u);
  ASSERT_EQ(graph.content.upsert_endpoints.size(), 5u);
  // The two nodes of one name take turns.
  EXPECT_NE(graph.content.upsert_endpoints[1].guid.Participant(),
            graph.content.upsert_endpoints[2].guid.Participant());

  const auto& first = std::get<recording::RecordedMessage>(test.events[1].what);
  EXPECT_EQ(first.type, "p/msg/T");
  EXPECT_EQ(first.writer, graph.content.upsert_endpoints[0].guid);
  EXPECT_EQ(first.payload, std::string("\x00\xff", 2));
  EXPECT_EQ(first.size_bytes, 7u);
  EXPECT_TRUE(first.truncated);
  EXPECT_EQ(test.events[1].repeat, 3);
  EXPECT_EQ(test.events[1].every_ns, 5 * kNanosPerMilli);
  const auto& second = std::get<recording::RecordedMessage>(test.events[2].what);
  EXPECT_EQ(second.type, "p/msg/U");
  EXPECT_FALSE(second.writer.none());
  EXPECT_EQ(second.size_bytes, 5u);
  EXPECT_FALSE(second.truncated);
  EXPECT_TRUE(std::get<recording::RecordedMessage>(test.events[3].what).writer.none());
  EXPECT_EQ(std::get<model::IdsAlert>(std::get<model::ExternalEvent>(test.events[4].what)),
            (model::IdsAlert{.gid = 3, .sid = 7, .message = "m", .src = "s", .dst = "t"}));
  EXPECT_EQ(std::get<model::Loss>(std::get<model::ExternalEvent>(test.events[8].what)).count, 12u);
  EXPECT_EQ(test.events[9].repeat, 5);
  EXPECT_EQ(test.events[9].every_ns, 200 * kNanosPerMilli);
  EXPECT_TRUE(std::holds_alternative<TickSpec>(test.events[10].what));
  EXPECT_EQ(test.events[11].every_ns, 500 * kNanosPerMilli);
  const Expectation& expect = test.events[11].expect;
  EXPECT_EQ(expect.level->text, "A");
  EXPECT_EQ(expect.alerts->entries[0].fields.at("rule"), "r");
  EXPECT_TRUE(expect.execs->entries[0].args->empty());
  EXPECT_TRUE(expect.fired->entries.empty());
  EXPECT_EQ(expect.unscanned->entries[0].fields.at("rule"), "r");
  EXPECT_EQ(expect.variables.at("n").text, "2");
  const auto& lower = std::get<OrderSpec>(test.events[12].what);
  EXPECT_FALSE(lower.raise);
  EXPECT_EQ(lower.level.text, "A");
  const auto& raise = std::get<OrderSpec>(test.events[13].what);
  EXPECT_TRUE(raise.raise);
  EXPECT_EQ(raise.level.text, "B");
  EXPECT_TRUE(std::get<EvidenceSpec>(test.events[14].what).complete);
  EXPECT_FALSE(std::get<EvidenceSpec>(test.events[15].what).complete);
  EXPECT_FALSE(test.expect.level.has_value());
  EXPECT_TRUE(test.expect.alerts.has_value());
}

TEST(RuleTestFileTest, ReadsPayloadsOfFiles) {
  std::string folder = testing::TempDir() + "/rips-replay-XXXXXX";
  ASSERT_NE(mkdtemp(folder.data()), nullptr);
  std::ofstream(folder + "/p.bin", std::ios::binary) << std::string("\0\1", 2);
  const auto parse = [&](const std::string& name) {
    return ParseRuleTestFile(
        folder + "/x_test.yaml",
        WithEvents(absl::StrCat("    - message: {topic: /t, payload_file: ", name, "}\n")));
  };

  const auto file = parse("p.bin");
  ASSERT_THAT(file, IsOk());
  EXPECT_EQ(std::get<recording::RecordedMessage>(file->tests[0].events[0].what).payload,
            std::string("\0\1", 2));
  EXPECT_THAT(parse("q.bin"), StatusIs(absl::StatusCode::kInvalidArgument,
                                       AllOf(HasSubstr("x_test.yaml:5:"), HasSubstr("q.bin"))));
  std::filesystem::resize_file(folder + "/p.bin", kTestPayloadBytesMax);
  EXPECT_THAT(parse("p.bin"), IsOk());
  std::filesystem::resize_file(folder + "/p.bin", kTestPayloadBytesMax + 1);
  EXPECT_THAT(parse("p.bin"), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("p.bin")));
  std::filesystem::remove_all(folder);
}

TEST(RuleTestFileTest, SaysWhatIsWrongAndWhere) {
  const std::pair<std::string, std::string> kCases[] = {
      {"", "missing key `rules`"},
      {"tests: [", "x_test.yaml:"},
      {"rules: []\ntests: [{name: t}]", "x_test.yaml:1:8: `rules` must not be empty"},
      {"rules: [a.rul]\n", "there is no test"},
      {"rules: [a.rul]\ntest: []\n", "unknown key `test`; did you mean `tests`"},
      {"rules: [a.rul]\ntests: [{events: []}]", "missing key `tests[0].name`"},
      {"rules: [a.rul]\ntests: [{name: t}, {name: t}]", "there is a test of that name on line 2"},
      {"rules: [a.rul]\ndialect: ros1\ntests: [{name: t}]", "write `rips` or `prototype`"},
      {WithEvents("    - {}\n"), "x_test.yaml:5:7: an event is one of `graph`"},
      {WithEvents("    - {signal: SIGUSR1, lost: 2}\n"), "x_test.yaml:5:7: an event is one of"},
      {WithEvents("    - {sginal: SIGUSR1}\n"), "unknown key `sginal`; did you mean `signal`"},
      {WithEvents("    - signal: SIGKILL\n"), "x_test.yaml:5:15: `signal` is `SIGKILL`"},
      {WithEvents("    - agent: [sensor]\n"), "`agent` is a list of two"},
      {WithEvents("    - agent: [motor, lost]\n"), "`agent` is a list of two"},
      {WithEvents("    - agent: [sensor, tired]\n"), "`tired` is no state of a sensor; write `"},
      {WithEvents("    - finding: ghost\n"), "`ghost` is no finding; write `"},
      {WithEvents("    - lost: 0\n"), "`lost` is 0; it must be from 1"},
      {WithEvents("    - wait_ms: 86400001\n"), "it must be from 0 to 86400000"},
      {WithEvents("    - tick: {repeat: 0}\n"), "it must be from 1 to 100000"},
      {WithEvents("    - tick: {repeat: 100001}\n"), "it must be from 1 to 100000"},
      {WithEvents("    - tick: {every_ms: 86400001}\n"), "it must be from 0 to 86400000"},
      {WithEvents("    - message: {}\n"), "missing key `tests[0].events[0].message.topic`"},
      {WithEvents("    - message: {topic: t}\n"), "x_test.yaml:5:24: "},
      {WithEvents("    - message: {topic: /t, sender: 'x y'}\n"), "x_test.yaml:5:"},
      {WithEvents("    - message: {topic: /t, payload_hex: 0}\n"), "even number of hexadecimal"},
      {WithEvents("    - message: {topic: /t, payload_hex: zz}\n"), "even number of hexadecimal"},
      {WithEvents("    - message: {topic: /t, payload_hex: '00', payload_text: a}\n"),
       "not several"},
      {WithEvents("    - message: {topic: /t, payload_hex: '00', payload_string: a}\n"),
       "not several"},
      {WithEvents("    - message: {topic: /t, payload_string: \"a\\0b\"}\n"), "x_test.yaml:5:44: "},
      {WithEvents("    - message: {topic: /t, payload_string: \"a\\0b\"}\n"),
       "`payload_string` contains a control character"},
      {WithEvents("    - message: {topic: /t, payload_string: " +
                  std::string(kTestStringBytesMax + 1, 'a') + "}\n"),
       "`payload_string` has 65537 bytes; it may have 65536"},
      {WithEvents("    - message: {topic: /t, payload_string: abc, size: 11}\n"),
       "from 12 to 4294967295"},
      {WithEvents("    - operator: {raise: B, approved: true}\n"), "only a lowering is approved"},
      {WithEvents("    - operator: {lower: B, approved: 2}\n"), "x_test.yaml:5:"},
      {WithEvents("    - message: {topic: /t, payload_text: abc, size: 2}\n"),
       "from 3 to 4294967295"},
      {WithEvents("    - message: {topic: /t, size: 4294967296}\n"), "from 0 to 4294967295"},
      {WithEvents("    - ids: {sid: -1}\n"), "`sid` is -1"},
      {WithEvents("    - graph: {nodes: [camera]}\n"), "x_test.yaml:5:"},
      {WithEvents("    - operator: {}\n"), "x_test.yaml:5:17: an order of the operator is"},
      {WithEvents("    - operator: {lower: A, raise: B}\n"), "an order of the operator is"},
      {WithEvents("    - operator: {loewr: A}\n"), "unknown key `loewr`; did you mean `lower`"},
      {WithEvents("    - operator: A\n"), "write a mapping"},
      {WithEvents("    - evidence: none\n"), "write `complete` or `incomplete`"},
      {"rules: [a.rul]\ntests: [{name: t, evidence: 1}]\n", "write `complete` or `incomplete`"},
      {WithEvents("    - graph: {topics: {/t: {type: a/msg/B, publishers: [/x]}}}\n"),
       "`/x` is not among `nodes`"},
      {WithEvents("    - graph: {services: {/x: [/s]}}\n"), "`/x` is not among `nodes`"},
      {WithEvents("    - graph: [a]\n"), "write a mapping"},
      {WithEvents("    - lost: 1\n      expect: {alert: []}\n"), "did you mean `alerts`"},
      {WithEvents("    - lost: 1\n      expect: {alerts: [{name: x}]}\n"), "unknown key"},
      {WithEvents("    - lost: 1\n      expect: {alerts: {rule: x}}\n"),
       "write a list of mappings"},
  };
  for (const auto& [text, problem] : kCases) {
    EXPECT_THAT(ErrorOf(text), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(problem)))
        << text;
  }
}

TEST(RuleTestFileTest, AStringIsSerializedAsRosDoes) {
  const std::string longest(kTestStringBytesMax, 'a');
  const auto file = ParseRuleTestFile(
      "d/x_test.yaml",
      WithEvents("    - message: {topic: /t, payload_string: hello}\n"
                 "    - message: {topic: /t, type: a/msg/B, payload_string: '', size: 20}\n"
                 "    - message: {topic: /t, payload_string: " +
                 longest + "}\n"));
  ASSERT_THAT(file, IsOk());
  const auto message = [&](size_t i) {
    return std::get<recording::RecordedMessage>(file->tests[0].events[i].what);
  };
  EXPECT_EQ(message(0).payload, std::string("\0\1\0\0\6\0\0\0hello\0\0\0", 16));
  EXPECT_EQ(message(0).type, "std_msgs/msg/String");
  EXPECT_FALSE(message(0).truncated);
  EXPECT_EQ(message(1).payload, std::string("\0\1\0\0\1\0\0\0\0\0\0\0", 12));
  EXPECT_EQ(message(1).type, "a/msg/B");
  EXPECT_TRUE(message(1).truncated);
  const std::string payload = message(2).payload;
  ros2::CdrReader reader(payload);
  EXPECT_EQ(reader.String(), longest);
  EXPECT_TRUE(reader.Finish().ok());
}

TEST(RuleTestFileTest, ATopicNeedsNoType) {
  const auto file = ParseRuleTestFile(
      "d/x_test.yaml",
      WithEvents("    - graph: {nodes: [/a], topics: {/t: {publishers: [/a]}, /u: {}}}\n"
                 "    - message: {topic: /t, sender: /a}\n"));
  ASSERT_THAT(file, IsOk());
  const auto& graph = std::get<recording::RecordedGraph>(file->tests[0].events[0].what);
  EXPECT_EQ(graph.content.upsert_endpoints.size(), 1u);
  const auto& message = std::get<recording::RecordedMessage>(file->tests[0].events[1].what);
  EXPECT_EQ(message.type, "");
  EXPECT_EQ(message.writer, graph.content.upsert_endpoints[0].guid);
}

TEST(RuleTestFileTest, OneMistakeDoesNotMakeItsSiblingsWrong) {
  for (const char* events :
       {"    - graph: {nodes: [/a], topics: {t: {type: a/msg/B, publishers: [/a]}}}\n",
        "    - message: {sender: /a, type: a/msg/B, size: 3, repeat: 2}\n",
        "    - operator: {lower: A, raise: B}\n",
        "    - message: {topic: /t, payload_hex: '00', payload_text: a, payload_file: b}\n"}) {
    const std::string message(ErrorOf(WithEvents(events)).message());
    EXPECT_THAT(message, HasSubstr("x_test.yaml:5:")) << events;
    EXPECT_THAT(message, Not(HasSubstr("\nx_test.yaml"))) << message;
    EXPECT_THAT(message, Not(HasSubstr("unknown key"))) << message;
  }
  const std::string no_name(
      ErrorOf("rules: [a.rul]\ntests: [{start_level: A, events: []}]").message());
  EXPECT_THAT(no_name, Not(HasSubstr("unknown key")));
}

TEST(RuleTestFileTest, TextsHaveALimit) {
  const std::string good = WithEvents("    - lost: 1\n");
  const std::string padded = good + std::string(kConfigBytesMax - good.size() - 1, '#') + "\n";
  EXPECT_THAT(ErrorOf(padded), IsOk());
  EXPECT_THAT(ErrorOf(padded + "\n"), StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST(RuleTestFileTest, SurvivesATextCutAnywhere) {
  const std::string text = WithEvents(
      "    - graph: {nodes: [/a], topics: {/t: {type: a/msg/B, publishers: [/a]}}}\n"
      "    - message: {topic: /t, sender: /a, payload_hex: '00ff', repeat: 2}\n"
      "      expect: {alerts: [{rule: r}], variables: {n: 1}}\n");
  ASSERT_THAT(ErrorOf(text), IsOk());
  for (size_t cut = 0; cut < text.size(); ++cut) {
    ErrorOf(text.substr(0, cut)).IgnoreError();  // it ends; some starts are whole files
    std::string broken = text;
    broken[cut] = '\xff';
    ErrorOf(broken).IgnoreError();
  }
}

}  // namespace
}  // namespace rips::replay

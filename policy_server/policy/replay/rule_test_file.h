// Unit tests of rules, as a YAML file:
//
//   rules: [warehouse.rul]        relative to this file; one program, in this order;
//                                 or [DIRECTORY], a bundle, whose manifest then sets dialect,
//                                 start_level and on_inspection_error
//   dialect: rips                 or prototype; optional, as all below up to `tests`
//   robot: r1
//   start_level: DEFAULT          the first level of the rules
//   on_inspection_error: match    or alert, ignore
//   tests:
//     - name: a stranger raises the level
//       start_level: ALERT        optional, as all of a test but its name and events
//       variables: {stranger: true}         a level's name stands for its position
//       exec_fail: [usb_alarm]    programs whose runs fail
//       trigger_fail: [HALT]      levels that the robot does not reach
//       evidence: incomplete      or complete, as it is unless said: may soft levels be lowered,
//                                 and have the sensors told of all findings?
//       events:                   each is one of the following, and may have an `expect`
//         - graph:                the graph is this and nothing else
//             nodes: [/camera, /base]             a name twice is two nodes
//             topics:
//               /cmd_vel: {type: geometry_msgs/msg/Twist, publishers: [/base], subscribers: []}
//             services: {/base: [/base/stop]}
//         - message: {topic: /cmd_vel, type: geometry_msgs/msg/Twist, sender: /base,
//                     payload_hex: "00010000", repeat: 10, every_ms: 5}
//         - ids: {gid: 1, sid: 2001, message: "...", source: 10.0.0.9, target: 10.0.0.2}
//         - signal: SIGUSR1
//         - agent: [sensor, lost]
//         - finding: impostor                      it stands until
//         - finding_over: impostor                  as many are over, which is no event for rules
//         - lost: 12
//         - tick: {repeat: 5, every_ms: 200}
//         - operator: {lower: DEFAULT}               or raise: a level; with `approved: true`, a
//                                                     second operator approves the lowering
//         - evidence: complete                        or incomplete, from here on
//         - wait_ms: 500
//           expect:                               what this event, repeats included, brings about
//             alerts: [{rule: r, text: t, severity: high}]
//             transitions: [{rule: r, from: A, to: B, result: refused, reason: blind}]
//             execs: [{rule: r, program: p, args: [x], result: ok}]
//             faults: [{rule: r, text: t}]
//             fired: [r]                          rules that fired, each once, in file order
//             unscanned: [r]                      rules that an inspection could not tell, likewise
//             level: ALERT                        afterwards
//             variables: {stranger: true}         afterwards, these of them
//       expect: {...}                             the same, of all events of the test
//
// What `expect` does not name is not checked. Lists must be exactly these, in this order; of their
// entries the keys that are given.
//
// Messages: the type is that of the topic in the graph unless given; `payload_text`, `payload_hex`
// or `payload_file` (relative to this file) is the serialized payload; `payload_string` is the text
// of a std_msgs/msg/String, which is also the type unless another one is known. `size`, its length
// by default, may be given for one that is longer, or not there at all. The writer is the endpoint
// of `sender` on that topic, or one of its own.
//
// Time starts at kTestStartNs. An event takes 1 ms, a repeated one `every_ms` each (1, for ticks
// 200).
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_TEST_FILE_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_TEST_FILE_H_

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/recording/recorded.h"
#include "policy_server/policy/replay/rule_set.h"

namespace rips::replay {

// 2026-01-01T00:00:00Z: some time, as on a robot, so that what happened at 0 is long ago.
inline constexpr int64_t kTestStartNs = 1'767'225'600 * kNanosPerSecond;
// Inclusive. The text as a whole is limited by kConfigBytesMax.
inline constexpr int64_t kTestRepeatMax = 100'000;
inline constexpr int64_t kTestWaitMsMax = 24 * 3'600 * 1'000;
inline constexpr size_t kTestPayloadBytesMax = size_t{16} << 20;
// Of a `payload_string`, without its terminator.
inline constexpr size_t kTestStringBytesMax = size_t{64} << 10;

// One entry of an expected list: the keys that are given, by name.
struct WantedEntry {
  // As in the text; `args` stand apart.
  absl::btree_map<std::string, std::string> fields;
  std::optional<std::vector<std::string>> args;
};

struct WantedList {
  // 1-based.
  int line = 0;
  std::vector<WantedEntry> entries;
};

struct WantedText {
  int line = 0;
  std::string text;
};

// What is not there is not checked.
struct Expectation {
  std::optional<WantedList> alerts;
  std::optional<WantedList> transitions;
  std::optional<WantedList> execs;
  std::optional<WantedList> faults;
  // Each entry has the field `rule` alone.
  std::optional<WantedList> fired;
  std::optional<WantedList> unscanned;
  std::optional<WantedText> level;
  absl::btree_map<std::string, WantedText> variables;
};

struct TickSpec {};
struct WaitSpec {};
// What an operator orders.
struct OrderSpec {
  bool raise = false;
  // A lowering that a second operator approves at once.
  bool approved = false;
  WantedText level;
};
struct EvidenceSpec {
  bool complete = true;
};
// A finding of that kind is over. No event for rules.
struct FindingOverSpec {
  std::string kind;
};

struct TestEvent {
  int line = 0;
  std::variant<recording::RecordedMessage, recording::RecordedGraph, model::ExternalEvent, TickSpec,
               WaitSpec, OrderSpec, EvidenceSpec, FindingOverSpec>
      what;
  int64_t repeat = 1;
  // From one to the next.
  int64_t every_ns = kNanosPerMilli;
  Expectation expect;
};

struct RuleTest {
  int line = 0;
  std::string name;
  // Empty: that of the file.
  WantedText start_level;
  absl::btree_map<std::string, WantedText> variables;
  std::vector<std::string> exec_fail;
  int exec_fail_line = 0;
  std::vector<std::string> trigger_fail;
  int trigger_fail_line = 0;
  bool evidence_complete = true;
  std::vector<TestEvent> events;
  Expectation expect;
};

struct RuleTestFile {
  std::string path;
  // As the file has them, seen from where its path is seen from.
  std::vector<std::string> rules;
  RuleSetOptions options;
  // Of the first key that gives one of `options`; 0 = none does.
  int options_line = 0;
  std::string robot;
  WantedText start_level;
  std::vector<RuleTest> tests;
};

// InvalidArgument with every problem and its place; files of payloads are read here.
absl::StatusOr<RuleTestFile> ParseRuleTestFile(const std::string& path, absl::string_view text);

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_TEST_FILE_H_

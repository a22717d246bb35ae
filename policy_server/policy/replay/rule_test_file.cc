#include "policy_server/policy/replay/rule_test_file.h"

#include <algorithm>
#include <filesystem>
#include <limits>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/replay/rule_test_graph.h"
#include "services/base/status_macros.h"
#include "services/ros2/cdr.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/config_reader.h"

namespace rips::replay {
namespace {

constexpr int64_t kUint32Max = std::numeric_limits<uint32_t>::max();
constexpr int64_t kTickMs = 200;
constexpr char kStringType[] = "std_msgs/msg/String";

// `words` as they stand in a message.
std::string Choices(std::span<const absl::string_view> words) {
  return absl::StrCat("`", absl::StrJoin(words, "` or `"), "`");
}

bool Among(std::span<const absl::string_view> words, absl::string_view word) {
  return std::find(words.begin(), words.end(), word) != words.end();
}

WantedText ReadText(const ConfigSection& section, absl::string_view key) {
  WantedText out{.line = section.LineOf(key)};
  section.Optional(key, &out.text);
  return out;
}

absl::btree_map<std::string, WantedText> ReadTexts(const ConfigSection& section) {
  absl::btree_map<std::string, WantedText> out;
  for (const std::string& key : section.Keys()) out[key] = ReadText(section, key);
  return out;
}

// A list of mappings with these keys, `args` being a list.
std::optional<WantedList> ReadList(const ConfigSection& section, absl::string_view key,
                                   const std::vector<std::string>& fields) {
  const std::vector<ConfigSection> sections = section.Sections(key);
  if (!section.Has(key)) return std::nullopt;
  WantedList list{.line = section.LineOf(key)};
  for (const ConfigSection& one : sections) {
    WantedEntry entry;
    for (const std::string& field : fields) {
      if (field == "args") {
        std::vector<std::string> args;
        one.Optional(field, &args);
        if (one.Has(field)) entry.args = std::move(args);
        continue;
      }
      std::string text;
      one.Optional(field, &text);
      if (one.Has(field)) entry.fields[field] = std::move(text);
    }
    list.entries.push_back(std::move(entry));
  }
  return list;
}

std::optional<WantedList> ReadNames(const ConfigSection& section, absl::string_view key) {
  std::vector<std::string> names;
  section.Optional(key, &names);
  if (!section.Has(key)) return std::nullopt;
  WantedList list{.line = section.LineOf(key)};
  for (std::string& name : names) list.entries.push_back({.fields = {{"rule", std::move(name)}}});
  return list;
}

Expectation ReadExpectation(const ConfigSection& section) {
  Expectation out;
  if (!section.present()) return out;
  out.alerts = ReadList(section, "alerts", {"rule", "text", "severity"});
  out.transitions = ReadList(section, "transitions", {"rule", "from", "to", "result", "reason"});
  out.execs = ReadList(section, "execs", {"rule", "program", "args", "result"});
  out.faults = ReadList(section, "faults", {"rule", "text"});
  out.fired = ReadNames(section, "fired");
  out.unscanned = ReadNames(section, "unscanned");
  WantedText level = ReadText(section, "level");
  if (section.Has("level")) out.level = std::move(level);
  out.variables = ReadTexts(section.OptionalSection("variables"));
  return out;
}

// True if `key` is there. Makes it known, so that others are told apart from it.
bool Ask(const ConfigSection& section, absl::string_view key) {
  if (section.Has(key)) return true;
  std::string absent;
  section.Optional(key, &absent);
  return false;
}

bool ReadEvidence(const ConfigSection& section) {
  bool complete = true;
  section.OptionalEnum<bool>("evidence", &complete, {{"complete", true}, {"incomplete", false}});
  return complete;
}

OrderSpec ReadOrder(const ConfigSection& section) {
  OrderSpec order{.raise = Ask(section, "raise")};
  if (Ask(section, "lower") == order.raise) {
    section.Problem("", "an order of the operator is `lower` or `raise`, and a level");
  }
  for (const absl::string_view key : {"lower", "raise"}) {
    if (section.Has(key)) section.Required(key, &order.level.text);
  }
  order.level.line = section.LineOf(order.raise ? "raise" : "lower");
  section.Optional("approved", &order.approved);
  if (order.approved && order.raise) {
    section.Problem("approved", "only a lowering is approved; remove `approved`");
  }
  return order;
}

// The events of one test.
class EventReader {
 public:
  explicit EventReader(const std::string& folder) : folder_(folder) {}

  TestEvent Read(const ConfigSection& section);

 private:
  // What is left out of `section` stays as it is in `event`.
  void ReadRepeat(const ConfigSection& section, TestEvent& event);
  void ReadMessage(const ConfigSection& section, TestEvent& event);
  std::string ReadPayload(const ConfigSection& section);
  model::IdsAlert ReadIds(const ConfigSection& section);
  model::AgentEvent ReadAgent(const ConfigSection& section);
  std::string ReadFinding(const ConfigSection& section, absl::string_view key);
  model::Loss ReadLoss(const ConfigSection& section, uint64_t count);

  const std::string& folder_;  // Not owned; outlives this.
  RuleTestGraph graph_;
};

TestEvent EventReader::Read(const ConfigSection& section) {
  constexpr absl::string_view kKinds[] = {"graph",   "message",  "ids",      "signal",
                                          "agent",   "finding",  "lost",     "tick",
                                          "wait_ms", "operator", "evidence", "finding_over"};
  TestEvent event{.line = section.LineOf("")};
  const auto has = [&](absl::string_view kind) { return Ask(section, kind); };
  if (std::count_if(std::begin(kKinds), std::end(kKinds), has) != 1) {
    section.Problem("", absl::StrCat("an event is one of ", Choices(kKinds)));
  }
  int64_t count = 0;
  if (has("graph")) event.what = graph_.Read(section.RequiredSection("graph"));
  if (has("message")) ReadMessage(section.RequiredSection("message"), event);
  if (has("ids")) event.what = ReadIds(section.RequiredSection("ids"));
  if (has("agent")) event.what = ReadAgent(section);
  if (has("finding")) event.what = model::Finding{.kind = ReadFinding(section, "finding")};
  if (has("finding_over")) event.what = FindingOverSpec{ReadFinding(section, "finding_over")};
  if (has("signal")) {
    std::string name;
    section.RequiredEnum<std::string>("signal", &name,
                                      {{"SIGUSR1", "SIGUSR1"}, {"SIGUSR2", "SIGUSR2"}});
    event.what = model::SignalSeen{.name = name};
  }
  if (has("lost")) {
    section.Required<int64_t>("lost", &count, {1, std::numeric_limits<int64_t>::max()});
    event.what = ReadLoss(section, static_cast<uint64_t>(count));
  }
  if (has("tick")) {
    event.every_ns = kTickMs * kNanosPerMilli;
    ReadRepeat(section.OptionalSection("tick"), event);
    event.what = TickSpec{};
  }
  if (has("wait_ms")) {
    section.Required<int64_t>("wait_ms", &count, {0, kTestWaitMsMax});
    event.every_ns = count * kNanosPerMilli;
    event.what = WaitSpec{};
  }
  if (has("operator")) event.what = ReadOrder(section.RequiredSection("operator"));
  if (has("evidence")) event.what = EvidenceSpec{.complete = ReadEvidence(section)};
  event.expect = ReadExpectation(section.OptionalSection("expect"));
  return event;
}

model::Loss EventReader::ReadLoss(const ConfigSection& section, uint64_t count) {
  model::Loss loss{.count = count};
  section.Optional("lost_on", &loss.topic);
  if (loss.topic.empty()) return loss;
  const absl::Status valid = ros2::ValidateTopicName(loss.topic);
  if (!valid.ok()) section.Problem("lost_on", valid.message());
  loss.type = graph_.TypeOf(loss.topic);
  return loss;
}

void EventReader::ReadRepeat(const ConfigSection& section, TestEvent& event) {
  int64_t every_ms = event.every_ns / kNanosPerMilli;
  section.Optional<int64_t>("repeat", &event.repeat, {1, kTestRepeatMax});
  section.Optional<int64_t>("every_ms", &every_ms, {0, kTestWaitMsMax});
  event.every_ns = every_ms * kNanosPerMilli;
}

void EventReader::ReadMessage(const ConfigSection& section, TestEvent& event) {
  recording::RecordedMessage message;
  section.Required("topic", &message.topic);
  if (!message.topic.empty()) {
    const absl::Status valid = ros2::ValidateTopicName(message.topic);
    if (!valid.ok()) section.Problem("topic", valid.message());
  }
  message.type = graph_.TypeOf(message.topic);
  section.Optional("type", &message.type);
  section.Optional("sender", &message.sender);
  if (!message.sender.empty()) {
    const absl::Status valid = ros2::ValidateNodeName(message.sender);
    if (!valid.ok()) section.Problem("sender", valid.message());
  }
  message.writer = graph_.WriterOf(message.sender, message.topic);
  message.payload = ReadPayload(section);
  if (message.type.empty() && section.Has("payload_string")) message.type = kStringType;
  const auto length = static_cast<int64_t>(message.payload.size());
  int64_t size = length;
  section.Optional<int64_t>("size", &size, {length, kUint32Max});
  message.size_bytes = static_cast<uint32_t>(size);
  message.truncated = size > length;
  ReadRepeat(section, event);
  event.what = std::move(message);
}

// The payload of a std_msgs/msg/String. The reader of configurations has refused a NUL.
std::string ReadString(const ConfigSection& section) {
  std::string text;
  section.Optional("payload_string", &text);
  if (text.size() > kTestStringBytesMax) {
    section.Problem("payload_string", absl::StrCat("`payload_string` has ", text.size(),
                                                   " bytes; it may have ", kTestStringBytesMax));
    return "";
  }
  ros2::CdrWriter writer;
  writer.String(text);
  return std::move(writer).Finish();
}

std::string EventReader::ReadPayload(const ConfigSection& section) {
  const bool string = Ask(section, "payload_string");
  const bool text = Ask(section, "payload_text");
  const bool hex = Ask(section, "payload_hex");
  const bool file = Ask(section, "payload_file");
  std::string given;
  if (text) section.Optional("payload_text", &given);
  if (hex) section.Optional("payload_hex", &given);
  if (file) section.Required("payload_file", &given);
  if (string + text + hex + file > 1) {
    section.Problem("",
                    "give `payload_string`, `payload_text`, `payload_hex` or `payload_file`, not "
                    "several");
    return "";
  }
  if (string) return ReadString(section);
  if (hex) {
    const bool digits = given.find_first_not_of("0123456789abcdefABCDEF") == std::string::npos;
    if (!digits || given.size() % 2 != 0) {
      section.Problem("payload_hex", "`payload_hex` is not an even number of hexadecimal digits");
      return "";
    }
    return absl::HexStringToBytes(given);
  }
  if (!file || given.empty()) return given;
  const auto path = std::filesystem::path(folder_) / given;
  absl::StatusOr<std::string> bytes = ReadFile(path.string(), kTestPayloadBytesMax);
  if (bytes.ok()) return *std::move(bytes);
  section.Problem("payload_file", bytes.status().message());
  return "";
}

model::IdsAlert EventReader::ReadIds(const ConfigSection& section) {
  model::IdsAlert ids;
  int64_t gid = 1;
  int64_t sid = 0;
  section.Optional<int64_t>("gid", &gid, {0, kUint32Max});
  section.Optional<int64_t>("sid", &sid, {0, kUint32Max});
  section.Optional("message", &ids.message);
  section.Optional("source", &ids.src);
  section.Optional("target", &ids.dst);
  section.Optional("line", &ids.line);
  ids.gid = static_cast<uint32_t>(gid);
  ids.sid = static_cast<uint32_t>(sid);
  return ids;
}

model::AgentEvent EventReader::ReadAgent(const ConfigSection& section) {
  std::vector<std::string> words;
  section.Required("agent", &words);
  if (words.empty()) return {};  // reported
  const auto states = lang::AgentStates(words[0]);
  if (words.size() != 2 || states.empty()) {
    section.Problem("agent", "`agent` is a list of two: `sensor` or `actuator`, and a state");
    return {};
  }
  if (!Among(states, words[1])) {
    section.Problem("agent", absl::StrCat("`", words[1], "` is no state of a ", words[0],
                                          "; write ", Choices(states)));
  }
  return {.agent = words[0], .state = words[1]};
}

std::string EventReader::ReadFinding(const ConfigSection& section, absl::string_view key) {
  std::string kind;
  section.Required(key, &kind);
  const auto kinds = lang::SignatureOf(lang::Builtin::kFinding).parameters[0].words;
  if (!kind.empty() && !Among(kinds, kind)) {
    section.Problem(key, absl::StrCat("`", kind, "` is no finding; write ", Choices(kinds)));
  }
  return kind;
}

RuleTest ReadTest(const ConfigSection& section, const std::string& folder) {
  RuleTest test{.line = section.LineOf("")};
  section.Required("name", &test.name);
  test.start_level = ReadText(section, "start_level");
  test.variables = ReadTexts(section.OptionalSection("variables"));
  section.Optional("exec_fail", &test.exec_fail);
  test.exec_fail_line = section.LineOf("exec_fail");
  section.Optional("trigger_fail", &test.trigger_fail);
  test.trigger_fail_line = section.LineOf("trigger_fail");
  test.evidence_complete = ReadEvidence(section);
  EventReader events(folder);
  for (const ConfigSection& event : section.Sections("events")) {
    test.events.push_back(events.Read(event));
  }
  test.expect = ReadExpectation(section.OptionalSection("expect"));
  return test;
}

}  // namespace

absl::StatusOr<RuleTestFile> ParseRuleTestFile(const std::string& path, absl::string_view text) {
  using engine::OnInspectionError;
  const std::string folder = std::filesystem::path(path).parent_path().string();
  ConfigReader reader(path, text);
  const ConfigSection root = reader.root();
  RuleTestFile file{.path = path};
  std::vector<std::string> rules;
  root.Required("rules", &rules);
  for (const std::string& rule : rules) {
    file.rules.push_back((std::filesystem::path(folder) / rule).string());
  }
  using Dialect = lang::CheckedRules::Dialect;
  root.OptionalEnum<Dialect>("dialect", &file.options.dialect,
                             {{"rips", Dialect::kRips}, {"prototype", Dialect::kPrototype}});
  root.OptionalEnum<OnInspectionError>("on_inspection_error", &file.options.on_inspection_error,
                                       {{"match", OnInspectionError::kMatch},
                                        {"alert", OnInspectionError::kAlert},
                                        {"ignore", OnInspectionError::kIgnore}});
  for (const char* key : {"dialect", "on_inspection_error"}) {
    if (file.options_line == 0 && root.Has(key)) file.options_line = root.LineOf(key);
  }
  root.Optional("robot", &file.robot);
  file.start_level = ReadText(root, "start_level");
  absl::btree_map<std::string, int> lines;
  for (const ConfigSection& section : root.Sections("tests")) {
    RuleTest test = ReadTest(section, folder);
    const auto [first, fresh] = lines.try_emplace(test.name, test.line);
    if (!fresh && !test.name.empty()) {
      section.Problem("name", absl::StrCat("there is a test of that name on line ", first->second));
    }
    file.tests.push_back(std::move(test));
  }
  if (file.tests.empty()) root.Problem("tests", "there is no test; write `tests:` and a list");
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return file;
}

}  // namespace rips::replay

#include "services/runtime/config_reader.h"

#include <string>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_macros.h"
#include "services/base/status_matchers.h"

namespace rips {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

enum class Observer { kCounted, kHidden };

struct Step {
  std::string name;
  uint32_t retries = 0;
  friend bool operator==(const Step&, const Step&) = default;
};

struct Config {
  std::string robot;
  std::string note = "none";
  Observer observer = Observer::kCounted;
  bool signals = true;
  int32_t offset = 7;
  absl::Duration settle = absl::Seconds(2);
  ByteSize memory = {64 << 20};
  std::vector<std::string> servers = {"localhost:7443"};
  std::vector<Step> steps;
};

// Reads `text` as `f.yaml`; `settings` may be null.
absl::StatusOr<Config> Parse(absl::string_view text,
                             std::vector<ConfigSetting>* settings = nullptr) {
  Config config;
  ConfigReader reader("f.yaml", text);
  const ConfigSection root = reader.root();
  root.Required("robot", &config.robot);
  root.Optional("note", &config.note);
  root.OptionalEnum("observer", &config.observer,
                    {{"counted", Observer::kCounted}, {"hidden", Observer::kHidden}});
  root.Optional("signals", &config.signals);
  root.Optional("offset", &config.offset, {-5, 10});
  root.Optional("settle", &config.settle, {absl::Milliseconds(100), absl::Minutes(1)});
  const ConfigSection outbox = root.OptionalSection("outbox");
  outbox.Required("memory", &config.memory, {ByteSize{1024}, ByteSize{1 << 30}});
  root.Required("servers", &config.servers);
  for (const ConfigSection& section : root.Sections("steps")) {
    Step step;
    section.Required("name", &step.name);
    section.Optional("retries", &step.retries, {0, 9});
    config.steps.push_back(step);
  }
  RIPS_RETURN_IF_ERROR(reader.Finish());
  if (settings != nullptr) *settings = reader.Settings();
  return config;
}

constexpr absl::string_view kGood = "robot: r1\nservers: [a:1]\n";

TEST(ConfigReaderTest, FillsAStruct) {
  const auto config = Parse(
      "# a comment\n"
      "robot: r1\n"
      "observer: hidden\n"
      "signals: false\n"
      "offset: -5\n"
      "settle: 500ms\n"
      "outbox: {memory: 1KiB}\n"
      "servers: [\"a:1\", b:2]\n"
      "steps:\n"
      "  - {name: one, retries: 2}\n"
      "  - name: two\n");

  ASSERT_THAT(config, IsOk());
  EXPECT_EQ(config->robot, "r1");
  EXPECT_EQ(config->note, "none");
  EXPECT_EQ(config->observer, Observer::kHidden);
  EXPECT_FALSE(config->signals);
  EXPECT_EQ(config->offset, -5);
  EXPECT_EQ(config->settle, absl::Milliseconds(500));
  EXPECT_EQ(config->memory, ByteSize{1024});
  EXPECT_THAT(config->servers, ElementsAre("a:1", "b:2"));
  EXPECT_THAT(config->steps, ElementsAre(Step{"one", 2}, Step{"two", 0}));
}

TEST(ConfigReaderTest, QuotesNoLineThatMayHoldASecret) {
  for (const char* text :
       {"secret: hunter2\n", "password: hunter2\n", "url: https://u:hunter2@h/\n"}) {
    ConfigReader reader("f.yaml", text);
    reader.root().Problem("", "it is wrong");
    const absl::Status status = reader.Finish();
    EXPECT_THAT(status, StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("f.yaml:1:1")));
    EXPECT_THAT(std::string(status.message()), Not(HasSubstr("hunter2")));
  }
}

TEST(ConfigReaderTest, QuotesNothingOfATextThatHoldsAPrivateKey) {
  for (const char* text : {"-----BEGIN PRIVATE KEY-----\nhidden\n-----END PRIVATE KEY-----\n",
                           "robot: r1\nnonsense: |\n  -----BEGIN EC PRIVATE KEY-----\n  hidden\n",
                           "robot: \"-----BEGIN PRIVATE KEY-----\\nhidden\"\nhidden: 1\n"}) {
    ConfigReader reader("f.yaml", text);
    std::string robot;
    reader.root().Required("robot", &robot);
    reader.root().Problem("robot", robot);

    const absl::Status status = reader.Finish();

    EXPECT_THAT(status, StatusIs(absl::StatusCode::kInvalidArgument,
                                 AllOf(HasSubstr("f.yaml:"), HasSubstr("holds a private key"),
                                       Not(HasSubstr("hidden")))));
  }
}

TEST(ConfigReaderTest, KeepsDefaultsOfWhatIsAbsentOrANullSection) {
  const auto config = Parse(absl::StrCat(kGood, "outbox: null\n"));

  ASSERT_THAT(config, IsOk());
  EXPECT_EQ(config->memory, ByteSize{64 << 20});
  EXPECT_EQ(config->settle, absl::Seconds(2));
}

TEST(ConfigReaderTest, ReportsAnUnknownKeyWithPlaceAndNearestKey) {
  EXPECT_THAT(Parse("robot: r1\nsevrers: [a:1]\nservers: [a:1]\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       "f.yaml:2:1: unknown key `sevrers`; did you mean `servers`\n"
                       "  sevrers: [a:1]\n"
                       "  ^"));
}

TEST(ConfigReaderTest, ListsTheKnownKeysIfNoneIsNear) {
  EXPECT_THAT(Parse(absl::StrCat(kGood, "outbox: {memory: 1KiB, colour: red}\n")),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("f.yaml:3:24: unknown key `colour`; known keys are `memory`\n")));
}

TEST(ConfigReaderTest, ReportsAllProblemsInTheOrderOfTheText) {
  const auto config = Parse(
      "settle: 15\n"
      "steps: [{nmae: x, retries: 10}]\n"
      "signals: yes\n");

  ASSERT_FALSE(config.ok());
  EXPECT_EQ(config.status().message(),
            "f.yaml:1:1: missing key `robot`\n  settle: 15\n  ^\n"
            "f.yaml:1:1: missing key `servers`\n  settle: 15\n  ^\n"
            "f.yaml:1:9: `settle`: `15` is not a duration; write a number and a unit, such as "
            "`500ms`, `15s`, `10min`, `2h`\n  settle: 15\n          ^\n"
            "f.yaml:2:9: missing key `steps[0].name`\n  steps: [{nmae: x, retries: 10}]\n"
            "          ^\n"
            "f.yaml:2:10: unknown key `nmae`; did you mean `name`\n"
            "  steps: [{nmae: x, retries: 10}]\n           ^\n"
            "f.yaml:2:28: `retries` is 10; it must be from 0 to 9\n"
            "  steps: [{nmae: x, retries: 10}]\n                             ^\n"
            "f.yaml:3:10: `signals` is `yes`; write `true` or `false`\n"
            "  signals: yes\n           ^");
}

TEST(ConfigReaderTest, RefusesWrongValues) {
  struct Case {
    std::string line;
    std::string message;
  };
  const Case cases[] = {
      {"note: [x]", "`note` is a list; write a text"},
      {"note: {x: y}", "`note` is a mapping; write a text"},
      {"note:", "`note` is empty; write a text or leave the key out"},
      {"note: \"a\\u0007\"", "`note` contains a control character"},
      {"note: !!binary aGk=", "tag `tag:yaml.org,2002:binary` is not supported"},
      {"note: !thing x", "tag `!thing` is not supported"},
      {"note: &a x", "anchors are not supported"},
      {"note: &a x\noffset: *a", "aliases are not supported; write the value out"},
      {"note: x\nnote: y", "duplicate key `note`; it is also on line 3"},
      {"[a]: x", "a key must be a text"},
      {"~: x", "a key must be a text"},
      {"observer: hiden", "`observer` is `hiden`; write `counted` or `hidden`"},
      {"signals: \"true\"", "`signals` is `true`; write `true` or `false`"},
      {"offset: 11", "`offset` is 11; it must be from -5 to 10"},
      {"offset: -6", "`offset` is -6; it must be from -5 to 10"},
      {"offset: 1.5", "`offset` is `1.5`; write a whole number"},
      {"offset: 010", "`offset` is `010`; write a whole number"},
      {"offset: 0x1", "`offset` is `0x1`; write a whole number"},
      {"offset: +1", "`offset` is `+1`; write a whole number"},
      {"offset: \"1\"", "`offset` is `1`; write a whole number"},
      {"offset: 99999999999999999999", "write a whole number"},
      {"settle: 99ms", "`settle` is 99ms; it must be from 100ms to 1min"},
      {"settle: 61s", "`settle` is 61s; it must be from 100ms to 1min"},
      {"settle: 1 s", "`1 s` is not a duration"},
      {"settle: -1s", "`-1s` is not a duration"},
      {"outbox: 5", "`outbox` is a single value; write a mapping"},
      {"outbox: {memory: 64}", "`64` is not a size"},
      {"outbox: {memory: 1023B}", "`memory` is 1023B; it must be from 1KiB to 1GiB"},
      {"outbox: {}", "missing key `outbox.memory`"},
      {"steps: x", "`steps` is a single value; write a list of mappings"},
      {"steps: [x]", "`steps` must be a list of mappings; this is a single value"},
      {"note: [", "not valid YAML: "},
      {"note: \"x", "not valid YAML: "},
      {"\tnote: x", "not valid YAML: "},
      {"--- \nrobot: r2", "there are several documents (`---`); keep one"},
      {"servers: []", "duplicate key `servers`"},
  };
  for (const Case& c : cases) {
    EXPECT_THAT(Parse(absl::StrCat(kGood, c.line, "\n")),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(c.message)))
        << c.line;
  }
  EXPECT_THAT(Parse("robot: \"\"\nservers: []\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       "f.yaml:1:8: `robot` must not be empty\n  robot: \"\"\n         ^\n"
                       "f.yaml:2:10: `servers` must not be empty\n  servers: []\n           ^"));
  EXPECT_THAT(Parse("- a\n"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("the text is not a mapping")));
  EXPECT_THAT(Parse(""),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       "f.yaml:1:1: missing key `robot`\nf.yaml:1:1: missing key `servers`"));
}

TEST(ConfigReaderTest, CountsColumnsInCodePoints) {
  EXPECT_THAT(Parse("robot: r1\nservers: [a:1]\nsteps: [{name: \"grün\", wet: 1}]\n"),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("f.yaml:3:24: unknown key `wet`; known keys are")));
}

TEST(ConfigReaderTest, BoundsTheText) {
  const std::string padding(kConfigBytesMax - kGood.size() - 2, 'x');

  EXPECT_THAT(Parse(absl::StrCat(kGood, "#", padding, "\n")), IsOk());
  EXPECT_THAT(Parse(absl::StrCat(kGood, "#", padding, "x\n")),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       "f.yaml:1:1: the text is longer than the limit of 1048576 bytes\n"
                       "  robot: r1\n  ^"));
}

TEST(ConfigReaderTest, BoundsNesting) {
  const auto nested = [](int depth) {
    return absl::StrCat(kGood, "deep: ", std::string(depth, '['), std::string(depth, ']'), "\n");
  };

  EXPECT_THAT(Parse(nested(kConfigDepthMax - 1)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("unknown key `deep`")));
  EXPECT_THAT(
      Parse(nested(kConfigDepthMax)),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("nesting exceeds the limit of 32")));
  EXPECT_THAT(Parse(absl::StrCat("a: ", std::string(100000, '['))),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST(ConfigReaderTest, BoundsTheListOfProblems) {
  std::string text(kGood);
  for (int i = 0; i < kConfigProblemsMax + 1; ++i) absl::StrAppend(&text, "unknown", i, ": 1\n");

  const auto config = Parse(text);

  EXPECT_THAT(config, StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("unknown49")));
  EXPECT_THAT(config, StatusIs(absl::StatusCode::kInvalidArgument, Not(HasSubstr("unknown50"))));
  EXPECT_TRUE(absl::EndsWith(config.status().message(), "and 1 more problems"));
}

TEST(ConfigReaderTest, SurvivesATextCutOrBrokenAnywhere) {
  const std::string text =
      "robot: r1\nservers: [\"a:1\", b:2]\nsteps:\n  - {name: one, retries: 2}\n"
      "  - name: 'two'\noutbox: {memory: 64KiB}\nnote: |\n  text\n";
  for (size_t i = 0; i < text.size(); ++i) {
    Parse(absl::string_view(text).substr(0, i)).status().IgnoreError();
    for (const char c : {'\0', '\t', '[', '}', '"', '\xff', '&', '%', ':'}) {
      std::string broken = text;
      broken[i] = c;
      Parse(broken).status().IgnoreError();
    }
  }
}

TEST(ConfigReaderTest, ShowsTheEffectiveConfiguration) {
  std::vector<ConfigSetting> settings;

  ASSERT_THAT(Parse("robot: r1\nservers:\n  - a:1\n  - b:2\nsteps: [{name: one}]\n", &settings),
              IsOk());

  EXPECT_EQ(FormatSettings(settings),
            "robot: \"r1\"  # f.yaml:1\n"
            "note: \"none\"  # default\n"
            "observer: counted  # default\n"
            "signals: true  # default\n"
            "offset: 7  # default\n"
            "settle: 2s  # default\n"
            "outbox.memory: 64MiB  # default\n"
            "servers: [\"a:1\", \"b:2\"]  # f.yaml:3\n"
            "steps[0].name: \"one\"  # f.yaml:5\n"
            "steps[0].retries: 0  # default\n");
}

TEST(ConfigReaderTest, OverridesTakeThePlaceOfWhatTheTextSays) {
  const auto read = [](const std::string& path, const std::string& value) {
    ConfigReader reader("f.yaml", "settle: 1s\nmixed: [1]\noutbox: {memory: 8MiB, disk: 0B}\n",
                        {{path, value, "elsewhere:4"}});
    absl::Duration settle;
    ByteSize memory;
    ByteSize disk;
    std::vector<std::string> mixed;
    reader.root().Optional("settle", &settle, {absl::ZeroDuration(), absl::Seconds(9)});
    reader.root().Optional("mixed", &mixed);
    reader.root().OptionalSection("outbox").Optional("memory", &memory);
    reader.root().OptionalSection("outbox").Optional("disk", &disk);
    const absl::Status status = reader.Finish();
    return status.ok() ? FormatSettings(reader.Settings()) : std::string(status.message());
  };
  EXPECT_EQ(read("settle", "2s"),
            "settle: 2s  # elsewhere:4\nmixed: [\"1\"]  # f.yaml:2\n"
            "outbox.memory: 8MiB  # f.yaml:3\noutbox.disk: 0B  # f.yaml:3\n");
  EXPECT_THAT(read("outbox.disk", "1MiB"),
              HasSubstr("outbox.memory: 8MiB  # f.yaml:3\noutbox.disk: 1MiB  # elsewhere:4\n"));
  EXPECT_THAT(read("mixed", "[a, b]"), HasSubstr("mixed: [\"a\", \"b\"]  # elsewhere:4\n"));

  EXPECT_EQ(read("settle", "10s"), "elsewhere:4: `settle` is 10s; it must be from 0s to 9s");
  EXPECT_EQ(read("settel", "2s"), "elsewhere:4: unknown key `settel`; did you mean `settle`");
  EXPECT_EQ(read("outbox.more", "2s"),
            "elsewhere:4: unknown key `more`; known keys are `memory`, `disk`");
  EXPECT_EQ(read("settle.more", "2s"), "elsewhere:4: `settle` of the file is not a mapping");
  for (const char* value : {"{", "1s\nmixed: []", "&a 1s", "- 1s", "*a", "'1s"}) {
    EXPECT_EQ(read("settle", value), "elsewhere:4: `settle` is not a value in YAML") << value;
  }
}

TEST(ConfigReaderTest, ReportsAProblemOfTheCallerAtTheValue) {
  ConfigReader reader("f.yaml", "a: 1\nb: 2\n");
  const ConfigSection root = reader.root();
  int32_t a = 0;
  int32_t b = 0;
  root.Required("a", &a);
  root.Required("b", &b);

  root.Problem("b", "`b` must not exceed `a`");

  EXPECT_THAT(reader.Finish(), StatusIs(absl::StatusCode::kInvalidArgument,
                                        "f.yaml:2:4: `b` must not exceed `a`\n  b: 2\n     ^"));
}

TEST(ConfigReaderTest, TellsTheKeysAndLinesOfAMapping) {
  ConfigReader reader("x.yaml", "names:\n  /b: 1\n  /a:\n    [2]\n");
  const ConfigSection names = reader.root().RequiredSection("names");

  EXPECT_THAT(names.Keys(), ElementsAre("/b", "/a"));
  EXPECT_EQ(names.LineOf("/b"), 2);
  EXPECT_EQ(names.LineOf("/a"), 4);
  EXPECT_EQ(names.LineOf("/c"), 2);
  const ConfigSection absent = names.OptionalSection("/c");
  EXPECT_THAT(absent.Keys(), IsEmpty());
  EXPECT_EQ(absent.LineOf("/b"), 0);
  // Listing them does not make them known.
  EXPECT_THAT(reader.Finish(),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("unknown key `/b`")));
}

TEST(ConfigDurationTest, RoundTrips) {
  for (const char* text : {"0s", "250us", "500ms", "15s", "10min", "36h", "30d"}) {
    const auto duration = ParseConfigDuration(text);
    ASSERT_THAT(duration, IsOk()) << text;
    EXPECT_EQ(*ParseConfigDuration(FormatConfigDuration(*duration)), *duration);
  }
  EXPECT_EQ(FormatConfigDuration(absl::Seconds(90)), "90s");
  EXPECT_EQ(FormatConfigDuration(absl::Milliseconds(1000)), "1s");
  for (const char* text : {"", "0", "15", "s", "1.5s", "1S", "1m", "s1", " 1s", "1s ", "1e3s",
                           "01s", "99999999999999999999s", "9223372036854775807d"}) {
    EXPECT_FALSE(ParseConfigDuration(text).ok()) << text;
  }
}

TEST(ByteSizeTest, RoundTrips) {
  for (const char* text : {"0B", "1B", "1023B", "64KiB", "3MiB", "2GiB"}) {
    EXPECT_EQ(FormatByteSize(*ParseByteSize(text)), text);
  }
  EXPECT_EQ(FormatByteSize(*ParseByteSize("1024KiB")), "1MiB");
  for (const char* text : {"", "64", "64KB", "64kib", "-1B", "1.5MiB", "9223372036854775807KiB"}) {
    EXPECT_FALSE(ParseByteSize(text).ok()) << text;
  }
}

}  // namespace
}  // namespace rips

// The shipped udev rules give exactly the devices that there are drivers for to one group, and the
// shipped service may open their nodes.
#include <fstream>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/decide/alarm_state.h"

namespace rips::actuator {
namespace {

// One rule: key with operator -> value, as in `GROUP=` -> `rips-alarm`.
using Rule = std::map<std::string, std::string>;

std::vector<Rule> ReadRules() {
  std::ifstream file(RIPS_SOURCE_DIR "/deploy/udev/70-rips-alarm.rules");
  EXPECT_TRUE(file.is_open());
  std::vector<Rule> rules;
  for (std::string line; std::getline(file, line);) {
    if (line.empty() || line[0] == '#') continue;
    Rule rule;
    for (const std::string& part : std::vector<std::string>(absl::StrSplit(line, ", "))) {
      const size_t quote = part.find('"');
      EXPECT_NE(quote, std::string::npos) << line;
      EXPECT_TRUE(absl::EndsWith(part, "\"")) << line;
      rule[part.substr(0, quote)] = part.substr(quote + 1, part.size() - quote - 2);
    }
    rules.push_back(std::move(rule));
  }
  return rules;
}

// `SUBSYSTEM` of the device nodes of a bus.
absl::string_view SubsystemOf(AlarmBus bus) {
  switch (bus) {
    case AlarmBus::kHidraw:
      return "hidraw";
    case AlarmBus::kTty:
      return "tty";
  }
  return "?";
}

// What DeviceAllow= calls the device nodes of a bus, as in /proc/devices.
std::set<std::string> DevicesOf(AlarmBus bus) {
  switch (bus) {
    case AlarmBus::kHidraw:
      return {"char-hidraw"};
    case AlarmBus::kTty:
      return {"char-ttyUSB", "char-ttyACM"};
  }
  return {"?"};
}

TEST(UdevRulesTest, CoverEveryKindAndNothingElse) {
  std::set<std::string> expected;
  for (const auto& [name, kind] : AlarmKinds()) {
    const UsbId id = UsbIdOf(kind);
    expected.insert(
        absl::StrFormat("%s %04x:%04x", SubsystemOf(BusOf(kind)), id.vendor, id.product));
  }
  std::set<std::string> covered;
  for (Rule& rule : ReadRules()) {
    covered.insert(absl::StrFormat("%s %s:%s", rule["SUBSYSTEM=="], rule["ATTRS{idVendor}=="],
                                   rule["ATTRS{idProduct}=="]));
  }
  EXPECT_EQ(covered, expected);
}

TEST(UdevRulesTest, TheServiceMayOpenTheNodesOfEveryKindAndNoOther) {
  std::set<std::string> needed;
  for (const auto& [name, kind] : AlarmKinds()) needed.merge(DevicesOf(BusOf(kind)));
  std::ifstream file(RIPS_SOURCE_DIR "/deploy/systemd/rips-actuator.service");
  ASSERT_TRUE(file.is_open());
  std::set<std::string> allowed;
  for (std::string line; std::getline(file, line);) {
    absl::string_view rest = line;
    if (!absl::ConsumePrefix(&rest, "DeviceAllow=")) continue;
    EXPECT_TRUE(absl::ConsumeSuffix(&rest, " rw")) << line;
    allowed.emplace(rest);
  }
  EXPECT_EQ(allowed, needed);
}

TEST(UdevRulesTest, NobodyOutsideTheGroup) {
  for (Rule& rule : ReadRules()) {
    EXPECT_EQ(rule["GROUP="], "rips-alarm");
    EXPECT_EQ(rule["MODE="], "0660");
  }
}

TEST(UdevRulesTest, TheSharedIdNeedsTheProductString) {
  bool seen = false;
  for (Rule& rule : ReadRules()) {
    if (rule["ATTRS{idVendor}=="] != "16c0") continue;
    seen = true;
    EXPECT_EQ(rule["ATTRS{product}=="], "USBRelay[1-8]");
  }
  EXPECT_TRUE(seen);
}

}  // namespace
}  // namespace rips::actuator

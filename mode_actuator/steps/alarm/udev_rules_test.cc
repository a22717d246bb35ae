// The shipped udev rules give exactly the devices that there are drivers for to one group.
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

TEST(UdevRulesTest, CoverEveryKindAndNothingElse) {
  std::set<std::string> expected;
  for (const auto& [name, kind] : AlarmKinds()) {
    const UsbId id = UsbIdOf(kind);
    expected.insert(absl::StrFormat(
        "%s %04x:%04x", kind == AlarmKind::kLcusSerial ? "tty" : "hidraw", id.vendor, id.product));
  }
  std::set<std::string> covered;
  for (Rule& rule : ReadRules()) {
    covered.insert(absl::StrFormat("%s %s:%s", rule["SUBSYSTEM=="], rule["ATTRS{idVendor}=="],
                                   rule["ATTRS{idProduct}=="]));
  }
  EXPECT_EQ(covered, expected);
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

// What is shipped for people to start from is accepted by the programs it is for.
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <string>

#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "mode_actuator/config.h"
#include "policy_server/bundle/bundle.h"
#include "policy_server/bundle/inventory.h"
#include "policy_server/config/config.h"
#include "policy_server/lang/compile.h"
#include "sensor_agent/config.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips {
namespace {

using ::testing::HasSubstr;
using ::testing::IsSupersetOf;
using ::testing::Not;

std::string Read(const std::string& name) {
  std::ifstream in(RIPS_SOURCE_DIR "/" + name);
  EXPECT_TRUE(in) << name;
  return std::string(std::istreambuf_iterator<char>(in), {});
}

TEST(ShippedFilesTest, ExampleConfigurationsAreAccepted) {
  const std::string dir = "deploy/config/";
  EXPECT_THAT(server::ParseServerConfig("policy-server.yaml", Read(dir + "policy-server.yaml")),
              IsOk());
  EXPECT_THAT(bundle::ParseInventory("robots.yaml", Read(dir + "robots.yaml")), IsOk());
  EXPECT_THAT(sensor::ParseSensorConfig("sensor.yaml", Read(dir + "sensor.yaml")), IsOk());
  const auto actuator = actuator::ParseConfig("actuator.yaml", Read(dir + "actuator.yaml"));
  ASSERT_THAT(actuator, IsOk());
  const auto smh = actuator::ParseSmh(Read(dir + "smh.yaml"), "smh.yaml");
  ASSERT_THAT(smh, IsOk());
  EXPECT_THAT(actuator::CheckLevelsAgainstSmh(actuator->config, *smh), IsOk());
}

// Certificates have times; but a robot that does not know the time is watched and kept safe, too.
TEST(ShippedFilesTest, AgentsAreOrderedAfterTheClockAndDoNotDependOnIt) {
  for (const char* name : {"rips-actuator", "rips-sensor"}) {
    std::istringstream unit(Read(std::string("deploy/systemd/") + name + ".service"));
    bool ordered = false;
    for (std::string line; std::getline(unit, line);) {
      if (line.find("time-sync.target") == std::string::npos) continue;
      EXPECT_EQ(line.rfind("After=", 0), 0u) << name << ": " << line;
      ordered = true;
    }
    EXPECT_TRUE(ordered) << name;
  }
}

// A policy with a plugin is complete only where the build has put it together.
std::filesystem::path BundleOf(const std::filesystem::path& policy) {
  if (!std::filesystem::exists(policy / "manifest.yaml.in")) return policy;
  const std::string name = absl::StrReplaceAll(policy.filename().string(), {{"_", "-"}});
  return std::filesystem::path(RIPS_BIN_DIR) / "../bundles" / name;
}

TEST(ShippedFilesTest, PoliciesCompileWithoutWarnings) {
  const RealClock clock;
  std::set<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(RIPS_SOURCE_DIR "/rules")) {
    if (!entry.is_directory()) continue;
    const std::filesystem::path folder = BundleOf(entry.path());
    const auto loaded = bundle::LoadBundle(folder, &clock);
    ASSERT_THAT(loaded, IsOk()) << folder;
    EXPECT_THAT(loaded->warnings, Not(HasSubstr("warning:"))) << folder;
    EXPECT_EQ(loaded->manifest.name, folder.filename());
    EXPECT_TRUE(std::filesystem::exists(entry.path() / (loaded->manifest.name + "_test.yaml")));
    names.insert(loaded->manifest.name);
  }
  EXPECT_THAT(names, IsSupersetOf({"camera-guard", "flood-guard", "graph-allowlist", "paper",
                                   "payload-guard", "warehouse"}));
}

// The rules in README.md are what a newcomer tries first.
TEST(ShippedFilesTest, TheFirstRuleOfTheReadmeCompiles) {
  const std::string text = Read("README.md");
  const size_t begin = text.find("```rul\nlevels:");
  ASSERT_NE(begin, std::string::npos);
  const size_t end = text.find("```", begin + 7);
  const std::vector<lang::SourceFile> files = {
      {.path = "README.md", .text = text.substr(begin + 7, end - begin - 7)}};

  const lang::CompileResult result = lang::Compile(files);

  EXPECT_TRUE(result.rules) << lang::RenderText(files, result.diagnostics);
  EXPECT_THAT(lang::RenderText(files, result.diagnostics), Not(HasSubstr("warning:")));
}

}  // namespace
}  // namespace rips

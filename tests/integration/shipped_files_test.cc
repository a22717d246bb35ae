// What is shipped for people to start from is accepted by the programs it is for.
#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <sstream>
#include <string>

#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "mode_actuator/config/config.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/inventory.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/server/config/config.h"
#include "sensor_agent/config.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips {
namespace {

using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using ::testing::IsSupersetOf;
using ::testing::Key;
using ::testing::MatchesRegex;
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
TEST(ShippedFilesTest, DaemonsAreOrderedAfterTheClockAndDoNotDependOnIt) {
  for (const char* name : {"rips-actuator", "rips-sensor", "rips-policy-server"}) {
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

// The lines `KEY=VALUE` of a unit, in order; the last one of a key counts for most keys.
std::multimap<std::string, std::string> UnitOf(const std::filesystem::path& path) {
  std::multimap<std::string, std::string> keys;
  std::ifstream unit(path);
  for (std::string line; std::getline(unit, line);) {
    const size_t equals = line.find('=');
    if (line.empty() || line[0] == '#' || line[0] == '[' || equals == std::string::npos) continue;
    keys.emplace(line.substr(0, equals), line.substr(equals + 1));
  }
  return keys;
}

std::string Only(const std::multimap<std::string, std::string>& unit, const std::string& key) {
  EXPECT_EQ(unit.count(key), 1u) << key;
  const auto found = unit.find(key);
  return found == unit.end() ? "" : found->second;
}

using Units = std::map<std::string, std::multimap<std::string, std::string>>;

// Daemons; or what a timer starts and then ends.
Units Services(bool jobs = false) {
  Units services;
  for (const auto& entry : std::filesystem::directory_iterator(RIPS_SOURCE_DIR "/deploy/systemd")) {
    if (entry.path().extension() != ".service") continue;
    auto unit = UnitOf(entry.path());
    const auto type = unit.find("Type");
    const bool job = type != unit.end() && type->second == "oneshot";
    if (job == jobs) services[entry.path().stem()] = std::move(unit);
  }
  return services;
}

void ExpectConfined(const std::multimap<std::string, std::string>& unit) {
  EXPECT_THAT(Only(unit, "MemoryMax"), MatchesRegex("[1-9][0-9]*[MG]"));
  EXPECT_THAT(Only(unit, "TasksMax"), MatchesRegex("[1-9][0-9]*"));
  EXPECT_EQ(Only(unit, "NoNewPrivileges"), "yes");
  EXPECT_EQ(Only(unit, "ProtectSystem"), "strict");
  EXPECT_EQ(Only(unit, "ProtectHome"), "yes");
  EXPECT_EQ(Only(unit, "LimitCORE"), "0");
  EXPECT_EQ(Only(unit, "UMask"), "0077");
}

TEST(ShippedFilesTest, EveryServiceIsStartedAnewAndBoundedAndConfined) {
  const auto services = Services();
  EXPECT_THAT(services,
              IsSupersetOf({Key("rips-policy-server"), Key("rips-actuator"), Key("rips-exec"),
                            Key("rips-fw"), Key("rips-sensor"), Key("rips-wire")}));
  for (const auto& [name, unit] : services) {
    SCOPED_TRACE(name);
    EXPECT_EQ(Only(unit, "Restart"), "always");
    EXPECT_EQ(Only(unit, "StartLimitIntervalSec"), "0") << "else it is given up after some starts";
    EXPECT_EQ(Only(unit, "RestartPreventExitStatus"), "2");
    ExpectConfined(unit);
  }
  for (const auto& [name, unit] : Services(/*jobs=*/true)) {
    SCOPED_TRACE(name);
    ExpectConfined(unit);
    const std::string timer = "deploy/systemd/" + name + ".timer";
    EXPECT_TRUE(std::filesystem::exists(std::string(RIPS_SOURCE_DIR "/") + timer));
  }
}

// The reason of the number stands above it.
TEST(ShippedFilesTest, EveryMemoryMaxSaysWhy) {
  Units all = Services();
  all.merge(Services(/*jobs=*/true));
  for (const auto& [name, unit] : all) {
    std::istringstream text(Read("deploy/systemd/" + name + ".service"));
    std::string before;
    for (std::string line; std::getline(text, line); before = line) {
      if (line.rfind("MemoryMax=", 0) != 0) continue;
      EXPECT_EQ(before.rfind("# ", 0), 0u) << name;
    }
  }
}

TEST(ShippedFilesTest, NoTwoDaemonsShareAUser) {
  std::map<std::string, std::string> daemon_of;
  const std::string sysusers = Read("deploy/sysusers/rips.conf");
  for (const auto& [name, unit] : Services()) {
    const std::string user = Only(unit, "User");
    EXPECT_THAT(sysusers, ContainsRegex("(^|\n)u " + user + " +- ")) << name;
    EXPECT_NE(user, "root") << name;
    // The tap reports only to the sensor beside it: one trust, two processes.
    if (name == "rips-wire") continue;
    const auto [other, fresh] = daemon_of.emplace(user, name);
    EXPECT_TRUE(fresh) << name << " and " << other->second << " both run as " << user;
  }
  EXPECT_EQ(daemon_of.count(server::kPluginUser), 0u) << "plugins would own what a daemon owns";
}

// They say when they are ready; those whose main loop must not hang are watched, but not so closely
// that a loaded host ends them.
TEST(ShippedFilesTest, DaemonsNotifyTheServiceManager) {
  const std::set<std::string> unwatched = {"rips-exec", "rips-fw"};
  for (const auto& [name, unit] : Services()) {
    SCOPED_TRACE(name);
    EXPECT_EQ(Only(unit, "Type"), "notify");
    EXPECT_EQ(Only(unit, "NotifyAccess"), "main");
    EXPECT_EQ(Only(unit, "Restart"), "always");
    if (unwatched.contains(name)) {
      EXPECT_EQ(unit.count("WatchdogSec"), 0u);
    } else {
      EXPECT_GE(std::stoi(Only(unit, "WatchdogSec")), 60);
    }
  }
}

TEST(ShippedFilesTest, TheServerMayOpenWhatItsConnectionsNeed) {
  const auto unit = Services().at("rips-policy-server");
  EXPECT_GE(std::stoi(Only(unit, "LimitNOFILE")), 2 * rpc::AdmissionLimits().total + 512);
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

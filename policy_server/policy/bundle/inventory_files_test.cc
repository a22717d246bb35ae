#include "policy_server/policy/bundle/inventory_files.h"

#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <map>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::bundle {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Pair;
using ::testing::SizeIs;

class InventoryFilesTest : public ::testing::Test {
 protected:
  InventoryFilesTest() {
    std::string name = (fs::temp_directory_path() / "rips-inventory-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    root_ = name;
    dir_ = name + "/robots.d";
    fs::create_directory(dir_);
  }
  ~InventoryFilesTest() override { fs::remove_all(root_); }

  std::string Path(const std::string& name) const { return dir_ + "/" + name; }
  void Write(const std::string& name, const std::string& text) const {
    std::ofstream(Path(name), std::ios::binary) << text;
  }
  void List(const std::string& name, const std::vector<std::string>& robots) const {
    std::string text = robots.empty() ? "robots: []\n" : "robots:\n";
    for (const std::string& robot : robots) {
      absl::StrAppend(&text, "  - {id: ", robot,
                      ", bundle: warehouse, sensors: [{host: base, primary: true}]}\n");
    }
    Write(name, text);
  }
  std::vector<std::string> Robots() const {
    const auto read = ReadInventory(dir_);
    EXPECT_THAT(read, IsOk());
    std::vector<std::string> ids;
    if (!read.ok()) return ids;
    for (const InventoryRobot& robot : read->inventory.robots) ids.push_back(robot.id);
    return ids;
  }

  std::string root_;
  std::string dir_;
};

TEST_F(InventoryFilesTest, ReadsASingleFile) {
  List("one.yaml", {"r2", "r1"});
  const auto read = ReadInventory(Path("one.yaml"));
  ASSERT_THAT(read, IsOk());
  EXPECT_THAT(read->inventory.robots, SizeIs(2));
  EXPECT_THAT(read->files, ElementsAre(Pair(Path("one.yaml"), 2)));
}

TEST_F(InventoryFilesTest, SettingsNameTheFileOfEachRobot) {
  List("20-hall.yaml", {"r1"});
  List("10-dock.yaml", {"r2", "r3"});
  const auto read = ReadInventory(dir_);
  ASSERT_THAT(read, IsOk());
  ASSERT_THAT(read->inventory.settings, SizeIs(3));
  EXPECT_EQ(read->inventory.settings.at("r1").front().source, Path("20-hall.yaml") + ":2");
  EXPECT_EQ(read->inventory.settings.at("r3").front().source, Path("10-dock.yaml") + ":3");
}

TEST_F(InventoryFilesTest, ReadsTheFilesOfADirectoryInTheOrderOfTheirNames) {
  List("20-hall.yaml", {"r1"});
  List("10-yard.yaml", {"r9", "r3"});
  List("30-empty.yaml", {});
  const auto read = ReadInventory(dir_);
  ASSERT_THAT(read, IsOk());
  EXPECT_THAT(read->files, ElementsAre(Pair(Path("10-yard.yaml"), 2), Pair(Path("20-hall.yaml"), 1),
                                       Pair(Path("30-empty.yaml"), 0)));
  EXPECT_NE(read->inventory.Find("r9"), nullptr);
  EXPECT_EQ(Robots(), (std::vector<std::string>{"r1", "r3", "r9"})) << "sorted over all files";
}

TEST_F(InventoryFilesTest, IgnoresWhatEditorsAndBackupsLeave) {
  List("a.yaml", {"r1"});
  for (const char* name : {".a.yaml", ".a.yaml.swp", "#a.yaml#", "#a.yaml", "a.yaml~", "a.yaml.bak",
                           "a.bak", "a.yaml.tmp", "4913", "a.yaml.dpkg-old", "README"}) {
    Write(name, "robots: [");
  }
  fs::create_symlink("user@host.1234:1", Path(".#a.yaml"));
  EXPECT_EQ(Robots(), std::vector<std::string>{"r1"});
}

TEST_F(InventoryFilesTest, ARobotInTwoFilesIsAnErrorThatNamesBoth) {
  List("a.yaml", {"r1", "r2"});
  List("b.yaml", {"r3", "r1"});
  EXPECT_THAT(ReadInventory(dir_),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       absl::StrCat("robot `r1` is listed in `", Path("a.yaml"), "` and in `",
                                    Path("b.yaml"), "`; remove one of both")));
}

TEST_F(InventoryFilesTest, OneFileThatIsMalformedOrUnreadableRefusesAll) {
  List("a.yaml", {"r1"});
  for (const std::string& text : {std::string("robots: ["), std::string("robots:\n  - {id: r2}\n"),
                                  std::string(), std::string("\xff\xfe\0", 3)}) {
    Write("b.yaml", text);
    EXPECT_THAT(ReadInventory(dir_),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(Path("b.yaml"))));
  }
  fs::remove(Path("b.yaml"));
  fs::create_symlink("nowhere.yaml", Path("b.yaml"));
  EXPECT_THAT(ReadInventory(dir_),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(Path("b.yaml"))));
  fs::remove(Path("b.yaml"));
  fs::create_directory(Path("b.yaml"));
  EXPECT_THAT(ReadInventory(dir_),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is not a regular file")));
}

TEST_F(InventoryFilesTest, TheProblemsOfEveryFileAreNamed) {
  Write("a.yaml", "robots: [");
  Write("b.yaml", "robots: {}x");
  EXPECT_THAT(ReadInventory(dir_),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr(Path("a.yaml")), HasSubstr(Path("b.yaml")))));
}

TEST_F(InventoryFilesTest, FollowsLinksAsOfTheSingleFile) {
  List("real", {"r1"});
  fs::create_symlink("real", Path("a.yaml"));
  fs::create_directory_symlink(dir_, root_ + "/linked.d");
  EXPECT_EQ(Robots(), std::vector<std::string>{"r1"});
  EXPECT_THAT(ReadInventory(root_ + "/linked.d"), IsOk());
}

TEST_F(InventoryFilesTest, WhatEveryUserMayWriteIsRefused) {
  List("a.yaml", {"r1"});
  const auto everybody = fs::perms::others_write;
  for (const std::string& path : {dir_, Path("a.yaml")}) {
    fs::permissions(path, everybody, fs::perm_options::add);
    EXPECT_THAT(ReadInventory(dir_), StatusIs(absl::StatusCode::kInvalidArgument,
                                              HasSubstr("every user may write to `" + path + "`")));
    fs::permissions(path, everybody, fs::perm_options::remove);
  }
  EXPECT_THAT(ReadInventory(dir_), IsOk());
  fs::permissions(Path("a.yaml"), everybody, fs::perm_options::add);
  EXPECT_THAT(ReadInventory(Path("a.yaml")), StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST_F(InventoryFilesTest, ADirectoryThatIsEmptyOrGoneIsAnError) {
  EXPECT_THAT(ReadInventory(dir_),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("has no file `*.yaml`")));
  Write("a.yml", "robots: []\n");
  EXPECT_THAT(ReadInventory(dir_), StatusIs(absl::StatusCode::kInvalidArgument));
  fs::remove_all(dir_);
  EXPECT_FALSE(ReadInventory(dir_).ok());
}

TEST_F(InventoryFilesTest, ANameThatForgesLinesIsRefused) {
  List("a\nERROR forged.yaml", {"r1"});
  const auto read = ReadInventory(dir_);
  EXPECT_THAT(read, StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("printable ASCII")));
  EXPECT_THAT(std::string(read.status().message()), ::testing::Not(HasSubstr("\n")));
}

TEST_F(InventoryFilesTest, ReadsAThousandFiles) {
  for (int i = 0; i < 1'000; ++i) {
    List(absl::StrFormat("%04d.yaml", i), {absl::StrCat("r", i)});
  }
  const auto read = ReadInventory(dir_);
  ASSERT_THAT(read, IsOk());
  EXPECT_THAT(read->files, SizeIs(1'000));
  EXPECT_THAT(read->inventory.robots, SizeIs(1'000));
}

TEST_F(InventoryFilesTest, TheLimitOfRobotsIsOfAllFilesTogether) {
  for (const char* file : {"a", "b", "c"}) {
    std::vector<std::string> robots;
    for (size_t i = 0; i < kRobotsMax / 2; ++i) robots.push_back(absl::StrCat(file, i));
    List(absl::StrCat(file, ".yaml"), robots);
    if (file[0] == 'b') {
      ASSERT_THAT(ReadInventory(dir_), IsOk());
    }
  }
  EXPECT_THAT(ReadInventory(dir_),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("exceed limit 2000")));
}

TEST_F(InventoryFilesTest, ADirectoryOfTooManyEntriesIsRefused) {
  for (size_t i = 0; i <= kInventoryEntriesMax; ++i) {
    fs::create_hard_link(i == 0 ? (Write("x", ""), Path("x")) : Path("x"),
                         Path(absl::StrCat("x", i)));
  }
  EXPECT_THAT(ReadInventory(dir_),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("the limit")));
}

TEST_F(InventoryFilesTest, AFileThatOnlyLooksLikeOneIsAnError) {
  List("a.yaml", {"r1"});
  List("b.yml", {"r2"});
  EXPECT_THAT(ReadInventory(dir_),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("has a file `b.yml`, which is not read; end its name with "
                                 "`.yaml`")));
}

class BundlesByLabelTest : public InventoryFilesTest {
 protected:
  // `id`, its bundle or "", its labels.
  static std::string Robot(const std::string& id, const std::string& bundle,
                           const std::string& labels) {
    return absl::StrCat("  - {id: ", id, bundle.empty() ? "" : ", bundle: ", bundle,
                        ", sensors: [{host: base, primary: true}], labels: {", labels, "}}\n");
  }
  std::map<std::string, std::string> Bundles() const {
    const auto read = ReadInventory(dir_);
    EXPECT_THAT(read, IsOk());
    std::map<std::string, std::string> bundles;
    if (!read.ok()) return bundles;
    for (const InventoryRobot& each : read->inventory.robots) bundles[each.id] = each.bundle;
    return bundles;
  }
};

TEST_F(BundlesByLabelTest, TheFirstEntryWhoseLabelsFitDecidesUnlessTheRobotDoes) {
  Write("00-bundles.yaml",
        "bundles:\n  - {labels: {site: hall, ring: canary}, bundle: next}\n"
        "  - {labels: {site: hall}, bundle: hall}\n");
  Write("10-robots.yaml",
        absl::StrCat("robots:\n", Robot("r1", "", "site: hall"),
                     Robot("r2", "", "site: hall, ring: canary"), Robot("r3", "own", "site: hall"),
                     Robot("r4", "", "ring: canary")));
  Write("20-rest.yaml", "bundles: [{bundle: rest}]\nrobots: []\n");
  EXPECT_THAT(Bundles(), ElementsAre(Pair("r1", "hall"), Pair("r2", "next"), Pair("r3", "own"),
                                     Pair("r4", "rest")));
}

TEST_F(BundlesByLabelTest, ARobotThatNoEntryFitsRefusesTheInventory) {
  Write("a.yaml", absl::StrCat("bundles: [{labels: {site: hall}, bundle: hall}]\nrobots:\n",
                               Robot("r1", "", "site: yard"), Robot("r2", "", "")));
  EXPECT_THAT(ReadInventory(dir_),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("without `bundle`, and no entry of `bundles` has labels that "
                                 "fit: robot `r1`, `r2`; give it a `bundle: NAME`, or add an "
                                 "entry")));
  EXPECT_THAT(ReadInventory(Path("a.yaml")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a.yaml`: without `bundle`")));
}

TEST_F(BundlesByLabelTest, EntriesAreCheckedAndBounded) {
  for (const char* entry : {"{}", "{labels: {site: hall}}", "{bundle: ../b}",
                            "{bundle: b, label: {site: hall}}", "{bundle: b, labels: {S: hall}}"}) {
    Write("a.yaml", absl::StrCat("bundles: [", entry, "]\nrobots: []\n"));
    EXPECT_THAT(ReadInventory(dir_), StatusIs(absl::StatusCode::kInvalidArgument)) << entry;
  }
  for (const char* empty : {"{}", "~", ""}) {
    Write("a.yaml", absl::StrCat("bundles: [{labels: ", empty, ", bundle: b}]\nrobots: []\n"));
    EXPECT_THAT(ReadInventory(dir_), StatusIs(absl::StatusCode::kInvalidArgument,
                                              HasSubstr("leave it out for an entry that fits all")))
        << empty;
  }
  Write("a.yaml", "bundles: [{bundle: all}, {labels: {site: hall}, bundle: hall}]\n");
  EXPECT_THAT(ReadInventory(dir_),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("the entry without labels for `all` is not the last")));
  std::string entries;
  for (size_t i = 0; i < kLabelEntriesMax; ++i) {
    absl::StrAppend(&entries, "{labels: {n: n", i, "}, bundle: b},");
  }
  Write("a.yaml", absl::StrCat("bundles: [", entries, "]\n"));
  EXPECT_THAT(ReadInventory(dir_), IsOk());
  Write("b.yaml", "bundles: [{bundle: b}]\n");
  EXPECT_THAT(ReadInventory(dir_), StatusIs(absl::StatusCode::kInvalidArgument,
                                            HasSubstr("257 `bundles` exceed limit 256")));

  entries.clear();
  for (size_t i = 0; i < kLabelEntriesMax; ++i) absl::StrAppend(&entries, "{set: {settle: 3s}},");
  Write("a.yaml", absl::StrCat("sensor_settings: [", entries, "]\n"));
  Write("b.yaml", "sensor_settings: [{set: {settle: 3s}}]\n");
  EXPECT_THAT(ReadInventory(dir_), StatusIs(absl::StatusCode::kInvalidArgument,
                                            HasSubstr("257 `sensor_settings` exceed limit 256")));
}

}  // namespace
}  // namespace rips::bundle

#include "policy_server/policy/bundle/bundle.h"

#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/policy/lang/limits.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips::bundle {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::MatchesRegex;
using ::testing::Not;

namespace fs = std::filesystem;

constexpr char kManifest[] = R"(name: warehouse
rules: [base.rul, more/nodes.rul]
levels: [DEFAULT, ALERT, HALT]
)";
class BundleTest : public testing::Test {
 protected:
  BundleTest() {
    std::string name = (fs::temp_directory_path() / "rips-bundle-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    root_ = name;
    dir_ = root_ / "warehouse";
    Write("manifest.yaml", kManifest);
    Write("base.rul", "levels:\n  DEFAULT;\n  ALERT soft;\n  HALT;\n");
    Write("more/nodes.rul", kNodes);
  }
  ~BundleTest() override {
    std::error_code ignored;
    fs::remove_all(root_, ignored);
  }
  void Write(const std::string& path, const std::string& text) {
    fs::create_directories((dir_ / path).parent_path());
    std::ofstream(dir_ / path, std::ios::binary) << text;
  }
  absl::StatusOr<Bundle> Load() { return LoadBundle(dir_.string(), &clock_); }
  // The bundle's id when the manifest is `text`; or the error.
  absl::StatusOr<Bundle> LoadWith(const std::string& manifest) {
    Write("manifest.yaml", manifest);
    return Load();
  }
  static std::string With(const std::string& from, const std::string& to) {
    return absl::StrReplaceAll(kManifest, {{from, to}});
  }

  static constexpr char kNodes[] =
      "rules Graph:\n  unknown_node: !nodes(\"/talker\") ? alert(\"unknown node\") => "
      "trigger(ALERT) "
      "=> trigger(HALT);\n";
  fs::path root_;
  fs::path dir_;
  RealClock clock_;
};

TEST_F(BundleTest, CompilesTheFilesAsOneProgram) {
  const auto bundle = Load();
  ASSERT_THAT(bundle, IsOk());
  EXPECT_THAT(bundle->id, MatchesRegex("sha256:[0-9a-f]*"));
  EXPECT_EQ(bundle->id.size(), 7u + 64u);
  EXPECT_EQ(bundle->manifest.name, "warehouse");
  EXPECT_THAT(bundle->levels().names(), ElementsAre("DEFAULT", "ALERT", "HALT"));
  EXPECT_EQ(bundle->start_level, 0);
  EXPECT_EQ(bundle->manifest.soft_hold, absl::Seconds(5));
  ASSERT_EQ(bundle->program->rules().rules.size(), 1u);
  EXPECT_EQ(bundle->program->rules().rules[0].name, "unknown_node");
  EXPECT_THAT(bundle->warnings, IsEmpty());
}

TEST_F(BundleTest, TheIdIsKnownWithoutCompiling) {
  EXPECT_EQ(*BundleIdOf(dir_.string()), Load()->id);
  Write("base.rul", "levels: nonsense(");
  EXPECT_FALSE(Load().ok());
  const auto broken = BundleIdOf(dir_.string());
  ASSERT_THAT(broken, IsOk());
  Write("base.rul", "levels: nonsense{");
  EXPECT_NE(*BundleIdOf(dir_.string()), *broken);
  fs::remove(dir_ / "base.rul");
  EXPECT_THAT(BundleIdOf(dir_.string()), StatusIs(absl::StatusCode::kNotFound));
}

TEST_F(BundleTest, TheIdIsTheHashOfTheDocumentedListing) {
  const auto bundle = Load();
  ASSERT_THAT(bundle, IsOk());
  const std::string listing =
      absl::StrCat("rips-bundle 1\nmanifest.yaml ", Sha256Hex(kManifest), "\nbase.rul ",
                   Sha256Hex("levels:\n  DEFAULT;\n  ALERT soft;\n  HALT;\n"), "\nmore/nodes.rul ",
                   Sha256Hex(kNodes), "\n");
  EXPECT_EQ(bundle->id, absl::StrCat("sha256:", Sha256Hex(listing)));
  // FIPS 180-4: the hash of "abc".
  EXPECT_EQ(Sha256Hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST_F(BundleTest, TheIdChangesWithEveryFileItNames) {
  const auto before = Load();
  ASSERT_THAT(before, IsOk());
  Write("unlisted.rul", "anything");
  EXPECT_EQ(Load()->id, before->id);
  Write("base.rul", "levels:\n  DEFAULT;\n  ALERT soft;\n  HALT;\n# a comment\n");
  const auto rules_changed = Load();
  ASSERT_THAT(rules_changed, IsOk());
  EXPECT_NE(rules_changed->id, before->id);
  const auto manifest_changed = LoadWith(absl::StrCat(kManifest, "soft_hold: 6s\n"));
  ASSERT_THAT(manifest_changed, IsOk());
  EXPECT_NE(manifest_changed->id, rules_changed->id);
}

TEST_F(BundleTest, TakesEveryKeyOfThisVersion) {
  const auto bundle = LoadWith(absl::StrCat(kManifest, R"(yara: []
plugins: []
start_level: ALERT
dialect: prototype
on_inspection_error: alert
two_person: [HALT]
soft_hold: 2s
scope: {namespaces: [], hosts: []}
payload_limits:
  - {topics: "^/camera/", bytes: 4MiB}
  - {topics: scan, bytes: 1KiB}
)"));
  ASSERT_THAT(bundle, IsOk());
  EXPECT_EQ(bundle->start_level, 1);
  EXPECT_EQ(bundle->program->rules().dialect, lang::CheckedRules::Dialect::kPrototype);
  EXPECT_EQ(bundle->manifest.soft_hold, absl::Seconds(2));
  EXPECT_THAT(bundle->manifest.two_person, ElementsAre("HALT"));
  EXPECT_EQ(bundle->manifest.on_inspection_error, engine::OnInspectionError::kAlert);
  EXPECT_EQ(bundle->manifest.payload_limits,
            (engine::PayloadLimits{{.topic_regex = "^/camera/", .bytes = 4 << 20},
                                   {.topic_regex = "scan", .bytes = 1 << 10}}));
}

TEST_F(BundleTest, RefusesWhatThisVersionWouldNotKeep) {
  for (const char* text : {"scope: {namespaces: [/a]}", "scope: {hosts: [h]}"}) {
    EXPECT_THAT(
        LoadWith(absl::StrCat(kManifest, text, "\n")),
        StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is not available in this version")))
        << text;
  }
}

TEST_F(BundleTest, RefusesABadManifest) {
  const struct {
    std::string manifest;
    std::string message;
  } cases[] = {
      {"", "manifest.yaml"},
      {With("name: warehouse", "name: Ware House"), "is not a valid bundle name"},
      {With("rules:", "rule:"), "unknown key `rule`"},
      {With("[base.rul, more/nodes.rul]", "[]"), "`rules` must not be empty"},
      {With("more/nodes.rul", "base.rul"), "rule file `base.rul` is listed twice"},
      {With("[DEFAULT, ALERT, HALT]", "[]"), "`levels` must not be empty"},
      {absl::StrCat(kManifest, "start_level: GONE\n"), "start level `GONE` is not one of `levels`"},
      {absl::StrCat(kManifest, "soft_hold: 0s\n"), "soft_hold"},
      {absl::StrCat(kManifest, "soft_hold: 2h\n"), "soft_hold"},
      {absl::StrCat(kManifest, "two_person: [GONE]\n"), "`GONE` is not one of `levels`"},
      {absl::StrCat(kManifest, "two_person: [DEFAULT]\n"), "no level is below `DEFAULT`"},
      {absl::StrCat(kManifest, "two_person: [HALT, HALT]\n"), "`HALT` is listed twice"},
      {absl::StrCat(kManifest, "two_person: [ALERT]\n"), "with no person at all"},
      {With("more/nodes.rul", "signature"),
       "`signature` is where the bundle's signature is written"},
      {With("more/nodes.rul", "signature.tmp"), "give the file another name"},
      {absl::StrCat(kManifest, "yara: [signature/x]\n"), "give the file another name"},
      {absl::StrCat(kManifest, "dialect: ours\n"), "write `rips` or `prototype`"},
  };
  for (const auto& each : cases) {
    EXPECT_THAT(LoadWith(each.manifest),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(each.message)))
        << each.manifest;
  }
}

TEST_F(BundleTest, RefusesPayloadLimitsThatNoSensorKeeps) {
  const auto limits = [](const std::string& list) {
    return absl::StrCat(kManifest, "payload_limits: [", list, "]\n");
  };
  std::string many;
  for (int i = 0; i < 65; ++i) absl::StrAppend(&many, "{topics: a", i, ", bytes: 1MiB},");
  std::string large;
  for (int i = 0; i < 60; ++i) absl::StrAppend(&large, "{topics: \"x{900}", i, "\", bytes: 1MiB},");
  const struct {
    std::string list;
    std::string message;
  } cases[] = {
      {"{topics: a, bytes: 4097KiB}", "4MiB"},
      {"{topics: a, bytes: 1GiB}", "4MiB"},
      {"{topics: a, bytes: 1023B}", "1KiB"},
      {"{topics: a, bytes: 0B}", "1KiB"},
      {"{topics: a, bytes: 70000}", "bytes"},
      {"{topics: a, bytes: much}", "bytes"},
      {"{topics: a}", "bytes"},
      {"{bytes: 1MiB}", "topics"},
      {"{topics: a, byte: 1MiB}", "unknown key `byte`"},
      {"{topics: \"(\", bytes: 1MiB}", "bad pattern: missing )"},
      {"{topics: \"(x{100}){100}\", bytes: 1MiB}", "bad pattern"},
      {"{topics: a, bytes: 1MiB}, {topics: a, bytes: 2MiB}", "`a` is listed twice"},
      {many, "65 payload limits exceed limit 64"},
      {large, "exceed the limit of 50000 instructions"},
  };
  for (const auto& each : cases) {
    EXPECT_THAT(LoadWith(limits(each.list)),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(each.message)))
        << each.list;
  }
  EXPECT_THAT(LoadWith(absl::StrCat(kManifest, "payload_limits: 1MiB\n")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("payload_limits")));
}

TEST_F(BundleTest, LevelsMustEqualTheDeclaredOnes) {
  for (const char* levels : {"[DEFAULT, ALERT]", "[DEFAULT, HALT, ALERT]",
                             "[DEFAULT, ALERT, HALT, MORE]", "[default, ALERT, HALT]"}) {
    EXPECT_THAT(
        LoadWith(With("[DEFAULT, ALERT, HALT]", levels)),
        StatusIs(absl::StatusCode::kInvalidArgument,
                 HasSubstr("the rule files declare [DEFAULT, ALERT, HALT]; make them equal")))
        << levels;
  }
}

TEST_F(BundleTest, ReportsMistakesInRulesWithTheirPlace) {
  Write("more/nodes.rul", "rules Graph:\n  nodes(\"/a\") ? trigger(GONE);\n");
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument,
                               AllOf(HasSubstr("more/nodes.rul:2:25: error UnknownName\n"),
                                     HasSubstr("ripsctl rules check"))));
}

TEST_F(BundleTest, WhatEndsUpInLogsHoldsNothingOfTheRules) {
  const std::string levels = "rules Graph:\n  false ? trigger(ALERT), trigger(HALT);\n";
  Write("more/nodes.rul", levels + "  hidden: topics(\"hidden\") ? alert(\"hidden\");\n");
  const auto warned = Load();
  ASSERT_THAT(warned, IsOk());
  EXPECT_EQ(warned->warnings,
            absl::StrCat(dir_.string(), "/more/nodes.rul:3:18: warning RelativeTopic\n"));

  Write("more/nodes.rul", levels + "  hidden: topics(\"/a\") ? hidden(\"hidden\");\n");
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument,
                               AllOf(HasSubstr("more/nodes.rul:3:26: error UnknownName\n"),
                                     Not(HasSubstr("hidden")))));
}

TEST_F(BundleTest, SaysWhatIsMissing) {
  EXPECT_THAT(LoadBundle((root_ / "none").string(), &clock_),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("none` does not exist")));
  fs::remove(dir_ / "more/nodes.rul");
  EXPECT_THAT(Load(),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("`more/nodes.rul` does not exist")));
  fs::remove(dir_ / "manifest.yaml");
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kNotFound, HasSubstr("manifest.yaml")));
}

TEST_F(BundleTest, IsNotLedOutOfItsDirectory) {
  std::ofstream(root_ / "outside.rul") << kNodes;
  for (const char* path : {"../outside.rul", "more/../../outside.rul", "/etc/passwd", "./base.rul",
                           "more//nodes.rul", "more/nodes.rul/", "\"\"", "\"a b\""}) {
    EXPECT_THAT(LoadWith(With("more/nodes.rul", path)),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("path `")))
        << path;
  }
  fs::create_symlink(root_ / "outside.rul", dir_ / "link.rul");
  EXPECT_THAT(LoadWith(With("more/nodes.rul", "link.rul")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("symbolic link")));
  fs::create_directory_symlink(root_, dir_ / "up");
  EXPECT_THAT(LoadWith(With("more/nodes.rul", "up/outside.rul")), Not(IsOk()));
  fs::create_directory(dir_ / "folder.rul");
  EXPECT_THAT(LoadWith(With("more/nodes.rul", "folder.rul")), Not(IsOk()));
  ASSERT_EQ(mkfifo((dir_ / "pipe.rul").c_str(), 0600), 0);
  EXPECT_THAT(LoadWith(With("more/nodes.rul", "pipe.rul")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("not a regular file")));
}

TEST_F(BundleTest, TheDirectoryItselfMayBeALink) {
  fs::create_directory_symlink(dir_, root_ / "current");
  EXPECT_THAT(LoadBundle((root_ / "current").string(), &clock_), IsOk());
}

TEST_F(BundleTest, IsCheckedWithoutBeingLoaded) {
  const BundleCheck check = CheckBundle(dir_.string());

  EXPECT_TRUE(check.ok());
  EXPECT_EQ(check.name, "warehouse");
  EXPECT_EQ(check.id, Load()->id);
  EXPECT_EQ(check.rules, 1u);
  EXPECT_EQ(check.levels, 3u);
  ASSERT_EQ(check.files.size(), 2u);
  EXPECT_EQ(check.files[1].path, (dir_ / "more/nodes.rul").string());
  EXPECT_THAT(check.diagnostics, IsEmpty());
  EXPECT_THAT(check.problems, IsEmpty());
  EXPECT_THAT(check.warnings, IsEmpty());
}

TEST_F(BundleTest, ACheckNamesEveryFileThatIsMissing) {
  fs::remove(dir_ / "base.rul");
  fs::remove(dir_ / "more/nodes.rul");

  const BundleCheck check = CheckBundle(dir_.string());

  EXPECT_FALSE(check.ok());
  EXPECT_EQ(check.name, "warehouse");
  EXPECT_THAT(check.problems, ElementsAre(HasSubstr("`base.rul` does not exist"),
                                          HasSubstr("`more/nodes.rul` does not exist")));
  EXPECT_THAT(check.files, IsEmpty());
  EXPECT_THAT(check.diagnostics, IsEmpty());
}

TEST_F(BundleTest, ACheckRefusesWhatLoadingRefuses) {
  const struct {
    std::string manifest;
    std::string problem;
  } cases[] = {
      {With("rules:", "rule:"), "unknown key `rule`"},
      {With("more/nodes.rul", "../nodes.rul"), "leaves the bundle directory"},
      {With("[DEFAULT, ALERT, HALT]", "[DEFAULT, HALT]"), "make them equal"},
      {absl::StrCat(kManifest, "yara: [gone.yar]\n"), "`gone.yar` does not exist"},
      {absl::StrCat(kManifest, "#", std::string(kManifestBytesMax, 'x')), "manifest.yaml"},
  };
  for (const auto& each : cases) {
    const auto loaded = LoadWith(each.manifest);
    const BundleCheck check = CheckBundle(dir_.string());
    EXPECT_FALSE(check.ok()) << each.problem;
    EXPECT_THAT(check.problems, ElementsAre(HasSubstr(each.problem)));
    ASSERT_THAT(loaded, Not(IsOk()));
    EXPECT_EQ(loaded.status().message(), check.problems[0]);
  }
  EXPECT_THAT(CheckBundle((root_ / "none").string()).problems,
              ElementsAre(HasSubstr("none` does not exist")));
}

TEST_F(BundleTest, ACheckOfBadRulesHasTheirDiagnostics) {
  Write("more/nodes.rul", "rules Graph:\n  nodes(\"/a\") ? trigger(GONE);\n");

  const BundleCheck check = CheckBundle(dir_.string());

  EXPECT_FALSE(check.ok());
  EXPECT_EQ(check.name, "warehouse");
  ASSERT_EQ(check.diagnostics.size(), 1u);
  EXPECT_EQ(check.diagnostics[0].kind, lang::DiagnosticKind::kUnknownName);
  EXPECT_THAT(check.problems, IsEmpty());
}

TEST_F(BundleTest, ACheckWarnsOfADirectoryOfAnotherName) {
  fs::create_directory_symlink(dir_, root_ / "current");

  const BundleCheck check = CheckBundle((root_ / "current/").string());

  EXPECT_TRUE(check.ok());
  EXPECT_THAT(check.warnings,
              ElementsAre(AllOf(HasSubstr("calls it `warehouse`, its directory is `current`"))));
}

TEST_F(BundleTest, HasLimits) {
  Write("base.rul", absl::StrCat("levels:\n  DEFAULT;\n  ALERT soft;\n  HALT;\n#",
                                 std::string(lang::kFileBytesMax, 'x')));
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kResourceExhausted,
                               HasSubstr("`base.rul` has more than 1048576 bytes")));

  EXPECT_THAT(LoadWith(absl::StrCat(kManifest, "#", std::string(kManifestBytesMax, 'x'))),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("manifest.yaml")));

  EXPECT_THAT(CheckBundlePath(std::string(kBundlePathBytesMax, 'x')), IsOk());
  EXPECT_THAT(CheckBundlePath(std::string(kBundlePathBytesMax + 1, 'x')),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("256 bytes, limit 255")));

  std::string many = "f0.rul";
  for (size_t i = 1; i <= kRuleFilesMax; ++i) absl::StrAppend(&many, ", f", i, ".rul");
  EXPECT_THAT(
      LoadWith(With("base.rul, more/nodes.rul", many)),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("257 rule files exceed limit 256")));
}

TEST_F(BundleTest, AllFilesTogetherHaveALimit) {
  const std::string filler = absl::StrCat("#", std::string(lang::kFileBytesMax - 2, 'x'), "\n");
  std::string names = "base.rul";
  for (int i = 0; i < 16; ++i) {
    Write(absl::StrCat("f", i, ".rul"), filler);
    absl::StrAppend(&names, ", f", i, ".rul");
  }
  EXPECT_THAT(LoadWith(With("base.rul, more/nodes.rul", names)),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("16777216 bytes together")));
}

constexpr char kInspects[] =
    "rules Msg:\n  topicin(\"/a\") && (payload(\"x.yar\") || plugin(\"p\")) ? alert(\"bad\") => "
    "trigger(ALERT) => trigger(HALT);\n";
constexpr char kYara[] = "rule r { strings: $a = \"evil\" condition: $a }\n";

class InspectingBundleTest : public BundleTest {
 protected:
  InspectingBundleTest() {
    Write("more/nodes.rul", kInspects);
    Write("more/x.yar", kYara);
    Write("p", "#!/bin/sh\nexit 0\n");
    fs::permissions(dir_ / "p", fs::perms::owner_all);
  }
  static std::string Manifest(const std::string& sha256) {
    return absl::StrCat(kManifest, "yara: [more/x.yar]\nplugins: [{id: p, path: p, sha256: \"",
                        sha256, "\"}]\non_inspection_error: alert\n");
  }
  static std::string Hash() { return Sha256Hex("#!/bin/sh\nexit 0\n"); }
  // What a check says of the bundle with this manifest, which the server refuses.
  std::string WhyRefused(const std::string& manifest) {
    EXPECT_THAT(LoadWith(manifest), StatusIs(absl::StatusCode::kInvalidArgument, ::testing::_));
    const BundleCheck check = CheckBundle(dir_.string());
    EXPECT_FALSE(check.ok());
    return lang::RenderText(check.files, check.diagnostics);
  }
};

TEST_F(InspectingBundleTest, LoadsWhatItsManifestLists) {
  const auto bundle = LoadWith(Manifest(Hash()));
  ASSERT_THAT(bundle, IsOk());
  ASSERT_NE(bundle->inspections, nullptr);
  EXPECT_EQ(bundle->inspections->size(), 2u);
  EXPECT_EQ(bundle->program->options().on_inspection_error, engine::OnInspectionError::kAlert);
  Write("more/x.yar", absl::StrCat("// changed\n", kYara));
  const auto changed = Load();
  ASSERT_THAT(changed, IsOk());
  EXPECT_NE(changed->id, bundle->id);
}

TEST_F(InspectingBundleTest, RefusesWhatItDoesNotList) {
  EXPECT_THAT(WhyRefused(kManifest), AllOf(HasSubstr("`more/x.yar` is not listed under `yara`"),
                                           HasSubstr("plugin `p` is not listed under `plugins`")));
  EXPECT_THAT(WhyRefused(Manifest(std::string(64, '0'))),
              HasSubstr(absl::StrCat("has SHA-256 ", Hash(), ", the manifest says 000")));
  EXPECT_THAT(LoadWith(Manifest("00")), StatusIs(absl::StatusCode::kInvalidArgument,
                                                 HasSubstr("64 lower-case hexadecimal digits")));
}

TEST_F(InspectingBundleTest, FindsItsFilesHoweverTheDirectoryIsWritten) {
  Write("manifest.yaml", Manifest(Hash()));
  for (const std::string& dir :
       {absl::StrCat(dir_.string(), "/"), absl::StrCat(dir_.string(), "//."),
        absl::StrCat(root_.string(), "/./warehouse"), absl::StrCat(dir_.string(), "/more/../"),
        fs::relative(dir_).string(), absl::StrCat("./", fs::relative(dir_).string())}) {
    EXPECT_THAT(LoadBundle(dir, &clock_), IsOk()) << dir;
    const BundleCheck check = CheckBundle(dir);
    EXPECT_TRUE(check.ok()) << dir << lang::RenderText(check.files, check.diagnostics);
    EXPECT_THAT(check.warnings, IsEmpty()) << dir;
  }
}

TEST_F(InspectingBundleTest, ACheckRunsNoPlugin) {
  const std::string plugin = absl::StrCat("#!/bin/sh\ntouch ", (root_ / "ran").string(), "\n");
  Write("p", plugin);
  Write("manifest.yaml", Manifest(Sha256Hex(plugin)));

  EXPECT_TRUE(CheckBundle(dir_.string()).ok());

  EXPECT_FALSE(fs::exists(root_ / "ran"));
}

TEST_F(InspectingBundleTest, ACheckLooksAtWhatRulesInspectWith) {
  const struct {
    std::string manifest;
    std::string message;
  } cases[] = {
      {kManifest, "`more/x.yar` is not listed under `yara`"},
      {kManifest, "plugin `p` is not listed under `plugins`"},
      {Manifest(std::string(64, '0')), "the manifest says 000"},
      {absl::StrReplaceAll(Manifest(Hash()), {{"path: p", "path: q"}}), "`q` does not exist"},
  };
  for (const auto& each : cases) {
    Write("manifest.yaml", each.manifest);
    const BundleCheck check = CheckBundle(dir_.string());
    EXPECT_FALSE(check.ok());
    EXPECT_THAT(lang::RenderText(check.files, check.diagnostics), HasSubstr(each.message));
  }
}

TEST_F(InspectingBundleTest, ACheckWarnsOfWhatIsListedInVain) {
  Write("more/nodes.rul", kNodes);
  Write("manifest.yaml", Manifest(Hash()));

  const BundleCheck check = CheckBundle(dir_.string());

  EXPECT_TRUE(check.ok());
  EXPECT_THAT(check.warnings, ElementsAre("YARA file `more/x.yar` is listed, and no rule names it",
                                          "plugin `p` is listed, and no rule names it"));
}

TEST_F(InspectingBundleTest, RefusesFilesThatAreBrokenOrGone) {
  Write("more/x.yar", "rule r { condition: nonsense }");
  EXPECT_THAT(WhyRefused(Manifest(Hash())), HasSubstr("nonsense"));
  fs::remove(dir_ / "more/x.yar");
  EXPECT_THAT(WhyRefused(Manifest(Hash())), HasSubstr("x.yar"));
}

}  // namespace
}  // namespace rips::bundle

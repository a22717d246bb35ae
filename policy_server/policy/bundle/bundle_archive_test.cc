#include "policy_server/policy/bundle/bundle_archive.h"

#include <stdlib.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_contents.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/policy/bundle/bundle_signature.h"
#include "policy_server/policy/bundle/inspection_source.h"
#include "policy_server/policy/lang/limits.h"
#include "rips/v1/operator.pb.h"
#include "services/base/status_matchers.h"

namespace rips::bundle {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

namespace fs = std::filesystem;

constexpr char kArchivedRules[] = "levels:\n  DEFAULT;\n  HALT;\n";
constexpr char kArchivedPlugin[] = "#!/bin/sh\nexit 0\n";

class ArchiveTest : public testing::Test {
 protected:
  ArchiveTest() {
    std::string name = (fs::temp_directory_path() / "rips-archive-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    root_ = name;
    Write("manifest.yaml", ManifestText());
    Write("base.rul", kArchivedRules);
    Write("more/nodes.rul", "rules Graph:\n  r: !nodes(\"/talker\") ? trigger(HALT);\n");
    Write("y/x.yar", "rule x { condition: false }");
    Write("plugins/p", kArchivedPlugin);
    fs::permissions(root_ / "source/plugins/p", fs::perms::owner_all);
    Write("notes.txt", "no part of the bundle");
  }
  ~ArchiveTest() override {
    std::error_code ignored;
    fs::remove_all(root_, ignored);
  }
  static std::string ManifestText() {
    return absl::StrCat(
        "name: warehouse\nrules: [base.rul, more/nodes.rul]\nlevels: [DEFAULT, HALT]\n"
        "yara: [y/x.yar]\nplugins: [{id: p, path: plugins/p, sha256: \"",
        Sha256Hex(kArchivedPlugin), "\"}]\n");
  }
  std::string source() const { return root_ / "source"; }
  std::string target() const { return root_ / "unpacked/target"; }
  void Write(const std::string& path, const std::string& text) {
    fs::create_directories((root_ / "source" / path).parent_path());
    std::ofstream(root_ / "source" / path, std::ios::binary) << text;
  }
  v1::BundleArchive Pack() {
    const auto bytes = PackBundle(source());
    EXPECT_THAT(bytes, IsOk());
    v1::BundleArchive archive;
    EXPECT_TRUE(archive.ParseFromString(bytes.value_or("\xff")));
    return archive;
  }
  std::vector<std::string> PackedPaths() {
    std::vector<std::string> paths;
    const v1::BundleArchive archive = Pack();
    for (const v1::BundleFile& file : archive.files()) paths.push_back(file.path());
    return paths;
  }
  // Expects that it is refused with `why` and that nothing is left.
  void ExpectRefused(const std::string& archive, const std::string& why) {
    EXPECT_THAT(UnpackBundle(archive, target()),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(why)));
    EXPECT_FALSE(fs::exists(target())) << why;
  }
  static void Add(v1::BundleArchive& archive, const std::string& path, const std::string& data) {
    v1::BundleFile* file = archive.add_files();
    file->set_path(path);
    file->set_data(data);
  }
  mode_t ModeOf(const std::string& path) {
    struct stat info = {};
    EXPECT_EQ(stat(absl::StrCat(target(), "/", path).c_str(), &info), 0) << path;
    return info.st_mode & 07777;
  }

  fs::path root_;
};

TEST_F(ArchiveTest, UnpackedItIsTheSameBundle) {
  EXPECT_THAT(PackedPaths(),
              ElementsAre("manifest.yaml", "base.rul", "more/nodes.rul", "y/x.yar", "plugins/p"));
  const mode_t mask = umask(022);
  EXPECT_THAT(UnpackBundle(*PackBundle(source()), target()), IsOk());
  umask(mask);
  EXPECT_EQ(CheckBundle(target()).id, CheckBundle(source()).id);
  EXPECT_NE(CheckBundle(target()).id, "");
  EXPECT_EQ(ModeOf("plugins/p"), 0755u);
  EXPECT_EQ(ModeOf("plugins"), 0755u);
  for (const char* path : {"manifest.yaml", "base.rul", "more/nodes.rul", "y/x.yar"}) {
    EXPECT_EQ(ModeOf(path), 0640u) << path;
  }
  EXPECT_FALSE(fs::exists(target() + "/notes.txt"));
  EXPECT_EQ(*PackBundle(target()), *PackBundle(source()));
}

TEST_F(ArchiveTest, HasTheSignatureAtItsEnd) {
  Write("signature", "any text\n");
  EXPECT_THAT(PackedPaths(), ElementsAre("manifest.yaml", "base.rul", "more/nodes.rul", "y/x.yar",
                                         "plugins/p", "signature"));
  ASSERT_THAT(UnpackBundle(*PackBundle(source()), target()), IsOk());
  EXPECT_EQ(*ReadSignature(target()), "any text\n");
  Write("signature", std::string(kSignatureBytesMax + 1, 'x'));
  EXPECT_THAT(PackBundle(source()), StatusIs(absl::StatusCode::kResourceExhausted));
}

TEST_F(ArchiveTest, HasAFileThatIsListedTwiceOnce) {
  Write("manifest.yaml",
        absl::StrReplaceAll(ManifestText(), {{"yara: [y/x.yar]", "yara: [plugins/p, base.rul]"}}));
  EXPECT_THAT(PackedPaths(),
              ElementsAre("manifest.yaml", "base.rul", "more/nodes.rul", "plugins/p"));
  ASSERT_THAT(UnpackBundle(*PackBundle(source()), target()), IsOk());
  EXPECT_EQ(ModeOf("plugins/p") & 0700, 0700u);
}

TEST_F(ArchiveTest, PackingSaysWhatCannotBeRead) {
  EXPECT_THAT(PackBundle(root_ / "none"), StatusIs(absl::StatusCode::kNotFound));
  Write("base.rul", std::string(lang::kFileBytesMax + 1, ' '));
  EXPECT_THAT(PackBundle(source()),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("`base.rul`")));
  fs::remove(root_ / "source/base.rul");
  EXPECT_THAT(PackBundle(source()),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("`base.rul` does not exist")));
  fs::create_symlink("/etc/passwd", root_ / "source/base.rul");
  EXPECT_THAT(PackBundle(source()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("symbolic link")));
  Write("manifest.yaml", "name: warehouse\n");
  EXPECT_THAT(PackBundle(source()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("missing key `rules`")));
}

TEST_F(ArchiveTest, PackingEndsAtTheLimit) {
  std::string plugins;
  for (int i = 0; i < 2; ++i) {
    Write(absl::StrCat("p", i), "");
    fs::resize_file(root_ / absl::StrCat("source/p", i), kPluginBytesMax);
    absl::StrAppend(&plugins, "{id: p", i, ", path: p", i, ", sha256: \"", std::string(64, '0'),
                    "\"},");
  }
  Write("manifest.yaml", absl::StrCat("name: a\nrules: [base.rul]\nlevels: [DEFAULT, HALT]\n",
                                      "plugins: [", plugins, "]\n"));
  EXPECT_THAT(PackBundle(source()), StatusIs(absl::StatusCode::kResourceExhausted,
                                             HasSubstr("has more than 100663296 bytes")));
  EXPECT_THAT(UnpackBundle(std::string(kArchiveBytesMax + 1, '\n'), target()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("limit 100663296")));
}

TEST_F(ArchiveTest, RefusesAnyOtherPath) {
  const struct {
    std::string path;
    std::string why;
  } cases[] = {
      {"", "is empty"},
      {"/etc/passwd", "is absolute"},
      {"../outside", "leaves the bundle directory"},
      {"more/../../outside", "leaves the bundle directory"},
      {"..", "leaves the bundle directory"},
      {".", "has an empty or `.` component"},
      {"./base.rul", "has an empty or `.` component"},
      {"more//nodes.rul", "has an empty or `.` component"},
      {"more/", "has an empty or `.` component"},
      {"a b", "may only contain"},
      {std::string("base.rul\0x", 10), "may only contain"},
      {"\x1b[2J", "path `\\x1b[2J` may only contain"},
      {"\xc3\xa9", "path `\\xc3\\xa9` may only contain"},
      {std::string(256, 'x'), "has 256 bytes, limit 255"},
      {std::string(1 << 20, 'x'), "has 1048576 bytes, limit 255"},
      {"notes.txt", "`notes.txt` is not listed by the manifest"},
      {"signature.tmp", "`signature.tmp` is not listed by the manifest"},
      {"base.rul", "`base.rul` is there twice"},
      {"manifest.yaml", "`manifest.yaml` is there twice"},
      {"base.rul/x", "`base.rul` is a file, and the directory of `base.rul/x`"},
      {"base.rul/x/y/z", "`base.rul` is a file, and the directory of"},
      {"more", "`more` is a file, and the directory of `more/nodes.rul`"},
      {"manifest.yaml/x", "`manifest.yaml` is a file, and the directory of"},
      {"signature/x", "`signature/x` is not listed by the manifest"},
  };
  for (const auto& each : cases) {
    v1::BundleArchive archive = Pack();
    Add(archive, each.path, "x");
    std::string bytes;
    // Not UTF-8 in a string: only a warning of protobuf's.
    archive.SerializeToString(&bytes);
    ExpectRefused(bytes, each.why);
  }
  EXPECT_THAT(UnpackBundle(*PackBundle(source()), target()), IsOk());
}

TEST_F(ArchiveTest, RefusesAManifestThatLeadsOut) {
  for (const char* path : {"../outside", "/tmp/outside", "signature", "signature/x",
                           "signature.tmp", "more/nodes.rul/x"}) {
    v1::BundleArchive archive;
    Add(archive, "manifest.yaml",
        absl::StrReplaceAll(ManifestText(), {{"y/x.yar", absl::StrCat("\"", path, "\"")}}));
    Add(archive, "base.rul", kArchivedRules);
    Add(archive, "more/nodes.rul", "");
    Add(archive, "plugins/p", kArchivedPlugin);
    Add(archive, path, "");
    EXPECT_THAT(UnpackBundle(archive.SerializeAsString(), target()),
                StatusIs(absl::StatusCode::kInvalidArgument))
        << path;
    EXPECT_FALSE(fs::exists(target()));
  }
}

TEST_F(ArchiveTest, HasTheManifestFirstAndEveryFileOfIt) {
  ExpectRefused("", "does not begin with `manifest.yaml`");
  v1::BundleArchive swapped = Pack();
  swapped.mutable_files()->SwapElements(0, 1);
  ExpectRefused(swapped.SerializeAsString(), "does not begin with `manifest.yaml`");
  for (int i = 1; i < Pack().files_size(); ++i) {
    v1::BundleArchive archive = Pack();
    const std::string path = archive.files(i).path();
    archive.mutable_files()->DeleteSubrange(i, 1);
    ExpectRefused(archive.SerializeAsString(),
                  absl::StrCat("`", path, "` is listed by the manifest and missing"));
  }
  v1::BundleArchive other_order = Pack();
  other_order.mutable_files()->SwapElements(1, 4);
  EXPECT_THAT(UnpackBundle(other_order.SerializeAsString(), target()), IsOk());
}

TEST_F(ArchiveTest, RefusesABadManifest) {
  const struct {
    std::string text;
    std::string why;
  } cases[] = {
      {"", "manifest.yaml"},
      {"\xff\xfe", "manifest.yaml"},
      {"a: &a [b]\nc: *a\n", "manifest.yaml"},
      {std::string(1000, '['), "manifest.yaml"},
      {ManifestText() + "nme: x\n", "manifest.yaml:6:1: unknown key `nme`"},
      {ManifestText() + "#" + std::string(kManifestBytesMax, 'x'),
       "`manifest.yaml` has more than 65536 bytes"},
  };
  for (const auto& each : cases) {
    v1::BundleArchive archive = Pack();
    archive.mutable_files(0)->set_data(each.text);
    ExpectRefused(archive.SerializeAsString(), each.why);
  }
}

TEST_F(ArchiveTest, EachKindOfFileHasALimit) {
  const std::map<std::string, size_t> limits = {{"base.rul", lang::kFileBytesMax},
                                                {"y/x.yar", kBundleBytesMax},
                                                {"plugins/p", kPluginBytesMax},
                                                {"signature", kSignatureBytesMax}};
  Write("signature", "x");
  for (const auto& [path, limit] : limits) {
    for (const size_t more : {0, 1}) {
      v1::BundleArchive archive = Pack();
      for (v1::BundleFile& file : *archive.mutable_files()) {
        if (file.path() == path) file.mutable_data()->assign(limit + more, 'x');
      }
      if (more == 1) {
        ExpectRefused(archive.SerializeAsString(),
                      absl::StrCat("`", path, "` has more than ", limit, " bytes"));
      } else {
        EXPECT_THAT(UnpackBundle(archive.SerializeAsString(), target()), IsOk()) << path;
        EXPECT_EQ(fs::file_size(absl::StrCat(target(), "/", path)), limit);
        fs::remove_all(target());
      }
    }
  }
}

TEST_F(ArchiveTest, RefusesWhatIsNoArchive) {
  const std::string good = *PackBundle(source());
  for (size_t cut = 0; cut < good.size(); ++cut) {
    EXPECT_THAT(UnpackBundle(good.substr(0, cut), target()),
                StatusIs(absl::StatusCode::kInvalidArgument))
        << cut;
  }
  EXPECT_FALSE(fs::exists(target()));
  const std::pair<std::string, std::string> cases[] = {
      {std::string(1, '\0'), "is not a serialized BundleArchive"},
      {std::string("\x08\x01", 2), "is not a serialized BundleArchive"},
      {good + std::string(1, '\0'), "is not a serialized BundleArchive"},
      {good + "\x0a", "is not a serialized BundleArchive"},
      {good + "\x0a\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01", "ends in the middle of a file"},
      {good + "\x0a\x7f", "ends in the middle of a file"},
      {good + std::string("\x12\x00", 2), "it has the unknown field 2"},
      {good + "\x0b\x0c", "is not a serialized BundleArchive"},
      {std::string("\x0a\x02\x1a\x00", 4), "a file has the unknown field 3"},
      {std::string("\x0a\x04\x0a\x00\x0a\x00", 6), "two paths or two contents"},
      {std::string("\x0a\x04\x12\x00\x12\x00", 6), "two paths or two contents"},
      {std::string("\x0a\x06\x0a\x00\x12\x00\x0a\x00", 8), "more than 2 fields of a file"},
      {std::string("\x0a\x02\x10\x01", 4), "is not a serialized BundleArchive"},
  };
  for (const auto& [bytes, why] : cases) ExpectRefused(bytes, why);
}

TEST_F(ArchiveTest, AFlippedBitIsRefusedOrMakesAnotherBundle) {
  v1::BundleArchive smallest;
  Add(smallest, "manifest.yaml", "name: a\nrules: [b]\nlevels: [C]\n");
  Add(smallest, "b", "");
  Add(smallest, "signature", "d");
  const std::string good = smallest.SerializeAsString();
  EXPECT_THAT(UnpackBundle(good, target()), IsOk());
  fs::remove_all(target());
  for (size_t i = 0; i < good.size() * 8; ++i) {
    std::string other = good;
    other[i / 8] = static_cast<char>(other[i / 8] ^ (1 << (i % 8)));
    const absl::Status status = UnpackBundle(other, target());
    if (!status.ok()) {
      EXPECT_THAT(status, StatusIs(absl::StatusCode::kInvalidArgument)) << i;
      EXPECT_FALSE(fs::exists(target())) << i;
      continue;
    }
    EXPECT_NE(*PackBundle(target()), good) << i;
    fs::remove_all(target());
  }
}

TEST_F(ArchiveTest, AnyNumberOfSmallFilesIsRefused) {
  std::string many("\x0a\x00", 2);
  while (many.size() < kArchiveBytesMax / 2) many += many;
  many += many.substr(0, kArchiveBytesMax - many.size());
  EXPECT_EQ(many.size(), kArchiveBytesMax);
  ExpectRefused(many, "it has more than 770 files");
}

TEST_F(ArchiveTest, LeavesWhatIsThereAlone) {
  fs::create_directories(target());
  std::ofstream(target() + "/mine") << "x";
  EXPECT_THAT(UnpackBundle(*PackBundle(source()), target()),
              StatusIs(absl::StatusCode::kAlreadyExists, HasSubstr("target` exists")));
  EXPECT_TRUE(fs::exists(target() + "/mine"));
  fs::remove_all(target());
  fs::create_symlink(root_ / "nowhere", target());
  EXPECT_THAT(UnpackBundle(*PackBundle(source()), target()),
              StatusIs(absl::StatusCode::kAlreadyExists));
  EXPECT_FALSE(fs::exists(root_ / "nowhere"));
}

TEST_F(ArchiveTest, WhatCannotBeWrittenLeavesNothing) {
  const std::string archive = *PackBundle(source());
  std::ofstream(root_ / "file") << "x";
  EXPECT_THAT(UnpackBundle(archive, root_ / "file/target"),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("file/target")));

  // Files of this process may have 40 bytes for now, less than the manifest has.
  struct rlimit before = {};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const struct rlimit small = {40, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  const absl::Status status = UnpackBundle(archive, target());
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);
  std::signal(SIGXFSZ, handler);
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kUnavailable, HasSubstr("writing")));
  EXPECT_FALSE(fs::exists(target()));
}

TEST_F(ArchiveTest, TheDirectoryMayBeRelative) {
  const fs::path before = fs::current_path();
  const std::string archive = *PackBundle(source());
  fs::current_path(root_);
  EXPECT_THAT(UnpackBundle(archive, "here"), IsOk());
  fs::current_path(before);
  EXPECT_EQ(CheckBundle(root_ / "here").id, CheckBundle(source()).id);
}

}  // namespace
}  // namespace rips::bundle

#include "policy_server/policy/bundle/bundle_keep.h"

#include <filesystem>
#include <fstream>
#include <set>
#include <string>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/policy/bundle/bundle_signature.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips::bundle {
namespace {

namespace fs = std::filesystem;

class BundleKeepTest : public testing::Test {
 protected:
  BundleKeepTest() {
    std::string name = (fs::temp_directory_path() / "rips-keep-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    root_ = name;
    Write("manifest.yaml",
          "name: warehouse\nrules: [base.rul, more/nodes.rul]\nlevels: [DEFAULT, HALT]\n");
    Write("base.rul", "levels:\n  DEFAULT;\n  HALT;\n");
    Write("more/nodes.rul", "rules Graph:\n  r: !nodes(\"/talker\") ? trigger(HALT);\n");
    Write("notes.txt", "no part of the bundle");
  }
  ~BundleKeepTest() override {
    std::error_code ignored;
    fs::remove_all(root_, ignored);
  }
  std::string dir() const { return root_ / "source"; }
  std::string keep() const { return root_ / "kept"; }
  void Write(const std::string& path, const std::string& text) {
    const fs::path file = fs::path(dir()) / path;
    fs::create_directories(file.parent_path());
    std::ofstream(file, std::ios::binary) << text;
  }
  std::string Id() { return CheckBundle(dir()).id; }

  fs::path root_;
  RealClock clock_;
};

TEST_F(BundleKeepTest, TheCopyIsTheBundleWhateverBecomesOfTheSource) {
  const std::string id = Id();
  ASSERT_THAT(KeepBundle(dir(), id, keep()), IsOk());
  fs::remove_all(dir());

  const auto path = KeptBundlePath(keep(), id);
  ASSERT_THAT(path, IsOk());
  const auto loaded = LoadBundle(*path, &clock_);
  ASSERT_THAT(loaded, IsOk());
  EXPECT_EQ(loaded->id, id);
  EXPECT_FALSE(fs::exists(fs::path(*path) / "notes.txt"));
}

TEST_F(BundleKeepTest, ASourceThatHasChangedMeanwhileIsNotKept) {
  const std::string id = Id();
  Write("base.rul", "levels:\n  DEFAULT;\n  HALT;\n  // changed\n");
  EXPECT_THAT(KeepBundle(dir(), id, keep()), StatusIs(absl::StatusCode::kAborted));
  EXPECT_FALSE(fs::exists(*KeptBundlePath(keep(), id)));
  EXPECT_TRUE(fs::is_empty(keep())) << "nothing half made";
}

TEST_F(BundleKeepTest, ADamagedCopyIsMadeAnew) {
  const std::string id = Id();
  ASSERT_THAT(KeepBundle(dir(), id, keep()), IsOk());
  const std::string path = *KeptBundlePath(keep(), id);
  std::ofstream(path + "/base.rul") << "levels: DEFAULT;";
  ASSERT_THAT(KeepBundle(dir(), id, keep()), IsOk());
  EXPECT_EQ(CheckBundle(path).id, id);
}

TEST_F(BundleKeepTest, TheCopyGetsTheSignatureAlsoWhenItComesLaterOrChanges) {
  const std::string id = Id();
  const std::string path = *KeptBundlePath(keep(), id);
  ASSERT_THAT(KeepBundle(dir(), id, keep()), IsOk());
  EXPECT_EQ(*ReadSignature(path), "");
  for (const char* text : {"first\n", "second\n"}) {
    Write("signature", text);
    EXPECT_EQ(Id(), id) << "it is no part of the id";
    ASSERT_THAT(KeepBundle(dir(), id, keep()), IsOk());
    EXPECT_EQ(*ReadSignature(path), text);
  }
  EXPECT_FALSE(fs::exists(path + "/signature.tmp"));
  EXPECT_EQ(CheckBundle(path).id, id);

  fs::remove_all(keep());
  ASSERT_THAT(KeepBundle(dir(), id, keep()), IsOk());
  EXPECT_EQ(*ReadSignature(path), "second\n") << "of a new copy";
}

TEST_F(BundleKeepTest, ACopysSignatureIsNotRemoved) {
  const std::string id = Id();
  const std::string path = *KeptBundlePath(keep(), id);
  Write("signature", "text\n");
  ASSERT_THAT(KeepBundle(dir(), id, keep()), IsOk());
  fs::remove(fs::path(dir()) / "signature");
  ASSERT_THAT(KeepBundle(dir(), id, keep()), IsOk());
  EXPECT_EQ(*ReadSignature(path), "text\n");
  std::ofstream(path + "/base.rul") << "levels: DEFAULT;";
  ASSERT_THAT(KeepBundle(dir(), id, keep()), IsOk());
  EXPECT_EQ(CheckBundle(path).id, id);
  EXPECT_EQ(*ReadSignature(path), "text\n") << "of a damaged copy";
  ASSERT_THAT(KeepBundle(path, id, keep()), IsOk()) << "of itself";
  EXPECT_EQ(*ReadSignature(path), "text\n");
}

TEST_F(BundleKeepTest, ASignatureThatCannotBeReadLeavesTheRestKept) {
  const std::string id = Id();
  const std::string path = *KeptBundlePath(keep(), id);
  const fs::path signature = fs::path(dir()) / "signature";
  fs::create_symlink("base.rul", signature);
  for (int i = 0; i < 2; ++i) {
    EXPECT_THAT(KeepBundle(dir(), id, keep()),
                StatusIs(absl::StatusCode::kInvalidArgument, ::testing::HasSubstr("symbolic")));
    EXPECT_EQ(CheckBundle(path).id, id);
    EXPECT_EQ(*ReadSignature(path), "");
  }
  fs::remove(signature);
  Write("signature", std::string(kSignatureBytesMax + 1, 'x'));
  EXPECT_THAT(KeepBundle(dir(), id, keep()), StatusIs(absl::StatusCode::kResourceExhausted));
}

TEST_F(BundleKeepTest, TakesNoIdThatIsAPath) {
  for (const char* id : {"", "sha256:", "sha256:../../etc", "../../etc"}) {
    EXPECT_THAT(KeptBundlePath(keep(), id), StatusIs(absl::StatusCode::kInvalidArgument)) << id;
    EXPECT_THAT(KeepBundle(dir(), id, keep()), StatusIs(absl::StatusCode::kInvalidArgument)) << id;
  }
}

TEST_F(BundleKeepTest, ADirectoryThatCannotBeMadeIsAnError) {
  std::ofstream(keep()) << "a file";
  EXPECT_THAT(KeepBundle(dir(), Id(), keep()), StatusIs(absl::StatusCode::kUnavailable));
}

TEST_F(BundleKeepTest, ForgetsWhatIsHalfMadeAndTheOldestUnusedBeyondTheLimit) {
  std::set<std::string> in_use;
  for (size_t i = 0; i < kUnusedKeptMax + 5; ++i) {
    const std::string id = absl::StrCat("sha256:", Sha256Hex(absl::StrCat(i)));
    const std::string path = *KeptBundlePath(keep(), id);
    fs::create_directories(path);
    fs::last_write_time(path, fs::file_time_type() + std::chrono::hours(i));
    if (i == 0) in_use.insert(id);
  }
  fs::create_directories(keep() + "/.new-x");
  fs::create_directories(keep() + "/not-ours");
  ForgetBundles(keep(), in_use);
  size_t left = 0;
  for ([[maybe_unused]] const auto& entry : fs::directory_iterator(keep())) ++left;
  EXPECT_EQ(left, kUnusedKeptMax + 2) << "the one in use, and what is not ours";
  EXPECT_TRUE(fs::exists(*KeptBundlePath(keep(), *in_use.begin())));
  ForgetBundles(root_ / "no such directory", in_use);
}

}  // namespace
}  // namespace rips::bundle

#include "policy_server/server/rollout/bundle_library.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "policy_server/policy/bundle/bundle_archive.h"
#include "policy_server/server/rollout/bundle_files_for_test.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/status_matchers.h"

namespace rips::rollout {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

class BundleLibraryTest : public ::testing::Test {
 protected:
  std::string Archive(const std::string& name, const std::string& rules = "") {
    const std::string source = dir_.File("source/" + name);
    std::filesystem::remove_all(source);
    WriteBundle(source, name, rules);
    const auto packed = bundle::PackBundle(source);
    EXPECT_THAT(packed, IsOk());
    return *packed;
  }
  BundleLibrary Library() {
    return BundleLibrary(dir_.File("kept"), LoadForTest,
                         [this](const std::string&, const std::string&) { return signed_by_; });
  }
  size_t Entries() const {
    size_t entries = 0;
    for (const auto& entry : std::filesystem::directory_iterator(dir_.File("kept"))) {
      ++entries;
      (void)entry;
    }
    return entries;
  }

  store::TempDir dir_;
  absl::StatusOr<std::string> signed_by_ = std::string("alice");
  BundleLibrary library_ = Library();
};

TEST_F(BundleLibraryTest, KeepsWhatIsPushedAndFindsItByItsFirstDigits) {
  EXPECT_THAT(*library_.List(), IsEmpty());
  const auto added = library_.Add(Archive("warehouse"));
  ASSERT_THAT(added, IsOk());
  EXPECT_FALSE(added->known);
  EXPECT_EQ(added->bundle.name, "warehouse");
  EXPECT_EQ(added->warnings, "r.rul:1:1: warning NoRules\n") << "without the server's directory";
  EXPECT_EQ(added->bundle.signed_by, "alice");
  const std::string& id = added->bundle.id;
  for (const std::string& name : {id, id.substr(7), id.substr(7, 8), id.substr(0, 15)}) {
    const auto found = library_.Find(name);
    ASSERT_THAT(found, IsOk()) << name;
    EXPECT_EQ(found->id, id);
    EXPECT_GT(found->stored_unix_ns, 0);
  }
  EXPECT_THAT(library_.Find(id.substr(7, 7)), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(library_.Find("../../etc"), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(library_.Find("0123456789abcdef"), StatusIs(absl::StatusCode::kNotFound));
  const auto again = library_.Add(Archive("warehouse"));
  ASSERT_THAT(again, IsOk());
  EXPECT_TRUE(again->known);
  EXPECT_THAT(*library_.List(), SizeIs(1));
  EXPECT_EQ(Entries(), 1u);
}

TEST_F(BundleLibraryTest, RefusesWhatDoesNotCompileAndKeepsNothingOfIt) {
  ASSERT_THAT(library_.Add(Archive("warehouse")), IsOk());
  const auto refused = library_.Add(Archive("broken", "rules Msg:\n  r: nonsense( -> ;\n"));
  EXPECT_THAT(refused,
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("the bundle is refused: ")));
  EXPECT_THAT(std::string(refused.status().message()), Not(HasSubstr(".new-")));
  EXPECT_THAT(library_.Add("no archive at all"), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(library_.Add(""), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_EQ(Entries(), 1u);
}

TEST_F(BundleLibraryTest, ListsTheOneStoredLastFirstAndWhatIsWrongWithIt) {
  const auto first = library_.Add(Archive("first"));
  const auto second = library_.Add(Archive("second"));
  ASSERT_THAT(second, IsOk());
  const std::string path = dir_.File("kept/") + first->bundle.id.substr(7);
  std::ofstream(path + "/manifest.yaml") << "name: [";
  std::filesystem::last_write_time(
      path, std::filesystem::file_time_type::clock::now() - std::chrono::hours(1));
  const auto bundles = library_.List();
  ASSERT_THAT(*bundles, SizeIs(2));
  EXPECT_EQ(bundles->at(0).name, "second");
  EXPECT_EQ(bundles->at(0).problem, "");
  EXPECT_THAT(bundles->at(1).problem, HasSubstr("its copy is damaged"));
  signed_by_ = absl::PermissionDeniedError("it has no signature");
  EXPECT_EQ(library_.Find(second->bundle.id)->problem, "it has no signature");
}

}  // namespace
}  // namespace rips::rollout

#include "services/runtime/needed_directories.h"

#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips {
namespace {

class NeededDirectoriesTest : public ::testing::Test {
 protected:
  NeededDirectoriesTest() {
    char name[] = "/tmp/rips-test-XXXXXX";
    dir_ = mkdtemp(name);
  }
  ~NeededDirectoriesTest() override { std::filesystem::remove_all(dir_); }

  std::string dir_;
};

TEST(ParentDirectoryTest, IsThatWhichHoldsThePath) {
  EXPECT_EQ(ParentDirectory("/a/b"), "/a");
  EXPECT_EQ(ParentDirectory("/a/b//"), "/a");
  EXPECT_EQ(ParentDirectory("/a//b"), "/a");
  EXPECT_EQ(ParentDirectory("/a"), "/");
  EXPECT_EQ(ParentDirectory("/"), "/");
}

TEST_F(NeededDirectoriesTest, AreThere) {
  std::filesystem::create_symlink(dir_, dir_ + "/link");
  EXPECT_THAT(CheckDirectories("x.yaml", {{"a", dir_}, {"b", dir_ + "/link"}, {"c", "/"}}), IsOk());
  EXPECT_THAT(CheckDirectories("x.yaml", {}), IsOk());
}

TEST_F(NeededDirectoriesTest, EachThatIsMissingIsNamed) {
  std::ofstream(dir_ + "/file") << "x";
  std::filesystem::create_symlink(dir_ + "/gone", dir_ + "/dangling");
  EXPECT_THAT(CheckDirectories("x.yaml", {{"a", dir_ + "/no"},
                                          {"b", dir_},
                                          {"c.d", dir_ + "/file"},
                                          {"e", dir_ + "/dangling"},
                                          {"f", dir_ + "/file/below"},
                                          {"g", dir_ + "/" + std::string(300, 'x')}}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       "x.yaml: `a` needs the directory `" + dir_ +
                           "/no`, which does not exist; create it\n" +
                           "x.yaml: `c.d` needs the directory `" + dir_ +
                           "/file`, which is no directory\n" + "x.yaml: `e` needs the directory `" +
                           dir_ + "/dangling`, which does not exist; create it\n" +
                           "x.yaml: `f` needs the directory `" + dir_ +
                           "/file/below`, which does not exist; create it\n" +
                           "x.yaml: `g` needs the directory `" + dir_ + "/" +
                           std::string(300, 'x') + "`, which does not exist; create it"));
}

}  // namespace
}  // namespace rips

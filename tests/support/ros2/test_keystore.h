// A keystore for tests, minted by deploy/security/keystore into a temporary directory. Test code
// only.
#ifndef RIPS_TESTS_SUPPORT_ROS2_TEST_KEYSTORE_H_
#define RIPS_TESTS_SUPPORT_ROS2_TEST_KEYSTORE_H_

#include <stdlib.h>

#include <cstdlib>
#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "absl/time/clock.h"
#include "gtest/gtest.h"
#include "services/base/check.h"
#include "services/dds/security.h"

namespace rips::dds {

// One authority. A failure of the script ends the process: no test can go on without.
class TestKeystore {
 public:
  // `options` as of the script.
  explicit TestKeystore(absl::string_view options = "") {
    char name[] = "/tmp/rips-keystore-XXXXXX";
    RIPS_CHECK(mkdtemp(name) != nullptr, "mkdtemp");
    dir_ = name;
    Script(absl::StrCat(options, " init"));
  }
  ~TestKeystore() { std::filesystem::remove_all(dir_); }
  TestKeystore(const TestKeystore&) = delete;
  TestKeystore& operator=(const TestKeystore&) = delete;

  const std::string& dir() const { return dir_; }
  std::string File(absl::string_view enclave, absl::string_view file) const {
    return absl::StrCat(dir_, "/enclaves", enclave, "/", file);
  }
  // `kind` is sensor, actuator or node, or the path of a file of permissions.
  void Mint(absl::string_view enclave, absl::string_view kind, absl::string_view options = "") {
    Script(absl::StrCat(options, " enclave ", enclave, " ", kind));
  }
  Enclave Load(absl::string_view enclave) const {
    const auto loaded = LoadEnclave(dir_, enclave, absl::Now());
    EXPECT_TRUE(loaded.ok()) << loaded.status();
    return loaded.value_or(Enclave{});
  }

  static void Run(const std::string& command) {
    RIPS_CHECK(std::system(command.c_str()) == 0, command.c_str());
  }

 private:
  void Script(absl::string_view arguments) {
    Run(absl::StrCat(RIPS_SOURCE_DIR, "/deploy/security/keystore --dir ", dir_, " ", arguments,
                     " >/dev/null"));
  }

  std::string dir_;
};

}  // namespace rips::dds

#endif  // RIPS_TESTS_SUPPORT_ROS2_TEST_KEYSTORE_H_

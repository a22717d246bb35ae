// Runs ripsctl in this process without a server, in a directory of the test's own.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_OFFLINE_RUN_H_
#define RIPS_POLICY_SERVER_RIPSCTL_OFFLINE_RUN_H_

#include <stdlib.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <system_error>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/app.h"

namespace rips::ripsctl {

// What a run of ripsctl came to.
struct Result {
  int code = -1;
  std::string out;
  std::string err;
};

// For the test `ripsctl_json`: if RIPS_JSON_SAMPLES names a directory, leaves what was printed as
// JSON in a file of its own there, below a line {"args":[..],"code":N}. Gives `result` back.
inline Result Saved(const std::vector<std::string>& args, Result result) {
  const char* directory = std::getenv("RIPS_JSON_SAMPLES");
  const bool is_json = std::find(args.begin(), args.end(), "json") != args.end();
  if (directory == nullptr || !is_json || result.out.empty()) return result;
  static std::atomic<int> number = 0;
  std::ofstream(absl::StrCat(directory, "/", getpid(), "-", ++number, ".jsonl"), std::ios::binary)
      << nlohmann::json({{"args", args}, {"code", result.code}}).dump() << "\n"
      << result.out;
  return result;
}

// Removed with all that is in it.
class TestDirectory {
 public:
  TestDirectory() {
    std::string name = (std::filesystem::temp_directory_path() / "ripsctl-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    path_ = name;
  }
  ~TestDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TestDirectory(const TestDirectory&) = delete;
  TestDirectory& operator=(const TestDirectory&) = delete;

  const std::string& path() const { return path_; }
  // The file's path.
  std::string Write(const std::string& name, const std::string& text) const {
    const std::string path = absl::StrCat(path_, "/", name);
    std::filesystem::create_directories(std::filesystem::path(path).parent_path());
    std::ofstream(path, std::ios::binary) << text;
    return path;
  }

 private:
  std::string path_;
};

// Connecting fails the test.
inline Result RunOffline(const std::vector<std::string>& args, const std::string& input = "") {
  std::istringstream in(input);
  std::ostringstream out;
  std::ostringstream err;
  const int code =
      RunRipsctl(args, {.out = out,
                        .err = err,
                        .get_env = [](const std::string&) { return std::optional<std::string>(); },
                        .connect = [](const RawSettings&)
                            -> absl::StatusOr<std::unique_ptr<v1::OperatorService::StubInterface>> {
                          ADD_FAILURE() << "connected";
                          return absl::InternalError("connected");
                        },
                        .in = &in});
  return Saved(args, {code, out.str(), err.str()});
}

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_OFFLINE_RUN_H_

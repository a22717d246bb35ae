// What the tests of this folder share.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_STORE_TEST_DATA_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_STORE_TEST_DATA_H_

#include <stdlib.h>

#include <filesystem>
#include <string>
#include <system_error>

#include "gmock/gmock.h"
#include "policy_server/server/store/store.h"
#include "services/base/ids.h"
#include "services/base/status_matchers.h"

namespace rips::store {

// A directory that goes with the test.
class TempDir {
 public:
  TempDir() {
    std::string name = (std::filesystem::temp_directory_path() / "rips-store-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    path_ = name;
  }
  ~TempDir() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TempDir(const TempDir&) = delete;
  TempDir& operator=(const TempDir&) = delete;

  std::string File(const std::string& name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

MATCHER_P(IsOkAndHolds, value, "") {
  *result_listener << StatusOf(arg).ToString();
  return arg.ok() && *arg == value;
}

// Of a robot that was acquired once.
inline WriteBatch Decide(const std::string& robot, DecisionId decision_id, const std::string& from,
                         const std::string& to, const std::string& id = NewId()) {
  WriteBatch batch{.robot = robot, .tenure = 1};
  batch.decisions.push_back(
      {.id = id,
       .decision_id = decision_id,
       .based_on = {decision_id.term, decision_id.epoch == 0 ? 0 : decision_id.epoch - 1},
       .from = from,
       .to = to,
       .cause = "rule intruder",
       .time_unix_ns = 10});
  return batch;
}

inline AlertRecord MakeAlert(const std::string& robot, const std::string& text) {
  return {.id = NewId(),
          .time_unix_ns = 1'767'225'600'000'000'007,
          .robot = robot,
          .rule = "intruder",
          .severity = "high",
          .text = text,
          .level = "ALERT",
          .event = "graph change",
          .decision_id = {3, 17}};
}

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_STORE_TEST_DATA_H_

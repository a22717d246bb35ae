// Ids of what a robot's core makes: alerts, transitions, commands. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ID_SOURCE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ID_SOURCE_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace rips::pipeline {

class IdSource {
 public:
  // `seed`: 32 hex digits, drawn at random; another one for each start of a robot.
  explicit IdSource(absl::string_view seed)
      : prefix_(seed.substr(seed.size() - std::min(seed.size(), kPrefixDigits))) {}

  // The end of the seed, and a count of 16 hex digits.
  std::string Next() { return absl::StrCat(prefix_, absl::Hex(++count_, absl::kZeroPad16)); }

 private:
  static constexpr size_t kPrefixDigits = 16;

  std::string prefix_;
  uint64_t count_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ID_SOURCE_H_

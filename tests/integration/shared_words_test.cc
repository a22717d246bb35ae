// Words that one daemon says and another must know.
#include <set>

#include "absl/strings/string_view.h"
#include "gmock/gmock.h"
#include "policy_server/policy/lang/check/signature.h"
#include "sensor_agent/findings/findings.h"
#include "sensor_agent/wire/wire_watch.h"

namespace rips {
namespace {

TEST(SharedWordsTest, RulesCanNameEveryKindOfFindingAndNoOther) {
  std::set<absl::string_view> told;
  for (const char* kind : sensor::Findings::Kinds()) told.insert(kind);
  for (const char* kind : wire::WireWatch::Kinds()) told.insert(kind);

  const auto& named = lang::SignatureOf(lang::Builtin::kFinding).parameters[0].words;

  EXPECT_EQ(told, std::set<absl::string_view>(named.begin(), named.end()));
}

}  // namespace
}  // namespace rips

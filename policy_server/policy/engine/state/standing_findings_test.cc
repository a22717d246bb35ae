#include "policy_server/policy/engine/state/standing_findings.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/lang/check/signature.h"

namespace rips::engine {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

TEST(StandingFindingsTest, OfWhatIsNotAllToldOnlyWhatStandsIsKnown) {
  StandingFindings some;
  EXPECT_EQ(some.Stands("impostor"), std::nullopt);
  EXPECT_EQ(some.Stands("any"), std::nullopt);
  some.Add("impostor");
  EXPECT_EQ(some.Stands("impostor"), true);
  EXPECT_EQ(some.Stands("any"), true);
  EXPECT_EQ(some.Stands("non_ros_reader"), std::nullopt);
  EXPECT_FALSE(some.told_all());
}

TEST(StandingFindingsTest, OnceAllIsToldWhatIsMissingDoesNotStand) {
  StandingFindings all(/*told_all=*/true);
  EXPECT_EQ(all.Stands("any"), false);
  EXPECT_THAT(all.Kinds(), IsEmpty());
  all.Add("impostor");
  EXPECT_EQ(all.Stands("any"), true);
  EXPECT_EQ(all.Stands("non_ros_reader"), false);
}

TEST(StandingFindingsTest, KindsThatRulesCannotNameStandTogether) {
  StandingFindings all(/*told_all=*/true);
  all.Add("a_kind_of_tomorrow");
  EXPECT_EQ(all.Stands("any"), true);
  EXPECT_EQ(all.Stands("impostor"), false);
  all.Add("impostor");
  EXPECT_THAT(all.Kinds(), ElementsAre("impostor", StandingFindings::kOther));
  StandingFindings again(/*told_all=*/true);
  for (const absl::string_view kind : all.Kinds()) again.Add(kind);
  EXPECT_EQ(again, all);
}

TEST(StandingFindingsTest, EachKindOfRulesIsAnotherOne) {
  for (const absl::string_view one :
       lang::SignatureOf(lang::Builtin::kFinding).parameters[0].words) {
    StandingFindings all(/*told_all=*/true);
    all.Add(one);
    EXPECT_THAT(all.Kinds(), ElementsAre(one));
  }
}

}  // namespace
}  // namespace rips::engine

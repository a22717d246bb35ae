#include "policy_server/server/robot/sight/finding_registry.h"

#include <initializer_list>
#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/robot/sight/finding_samples.h"
#include "services/model/finding_digest.h"

namespace rips::pipeline {
namespace {

using Asked = FindingRegistry::Asked;
using News = FindingRegistry::News;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

TEST(FindingRegistryTest, IsNewsOnceUntilNobodySaysSo) {
  FindingRegistry registry;
  registry.OnHello("base", "i1", 0);
  registry.OnHello("laptop", "j1", 0);
  EXPECT_EQ(registry.Apply("base", "i1", Impostor(1), 0), News::kBegins);
  EXPECT_EQ(registry.Apply("base", "i1", Impostor(1), 0), News::kKnown);
  EXPECT_EQ(registry.Apply("laptop", "j1", Impostor(1), 0), News::kKnown);
  EXPECT_EQ(registry.Apply("base", "i1", Impostor(2), 0), News::kBegins) << "another GUID";
  EXPECT_EQ(registry.Apply("base", "i1", Impostor(1, "/ns/rips"), 0), News::kBegins)
      << "another node";
  EXPECT_THAT(registry.standing(), SizeIs(3));
  EXPECT_EQ(registry.standing()[1].guid, Impostor(2).guid) << "oldest first";

  EXPECT_EQ(registry.Apply("base", "i1", Over(Impostor(1)), 0), News::kKnown) << "laptop says so";
  EXPECT_EQ(registry.Apply("laptop", "j1", Over(Impostor(1)), 0), News::kEnds);
  EXPECT_EQ(registry.Apply("laptop", "j1", Over(Impostor(1)), 0), News::kKnown);
  EXPECT_THAT(registry.standing(), SizeIs(2));
}

TEST(FindingRegistryTest, SensorThatWasStartedAgainMustTellItAgain) {
  FindingRegistry registry({.confirm_ns = 100});
  registry.OnHello("base", "i1", 0);
  registry.Apply("base", "i1", Impostor(1), 0);
  registry.Apply("base", "i1", Impostor(2), 0);
  registry.OnHello("base", "i1", 5);
  EXPECT_THAT(registry.Expire(1'000), IsEmpty()) << "a reconnect is no restart";

  registry.OnHello("base", "i2", 1'000);
  EXPECT_EQ(registry.Apply("base", "i2", Impostor(2), 1'050), News::kKnown);
  EXPECT_THAT(registry.Expire(1'099), IsEmpty());
  const std::vector<FindingRegistry::Entry> gone = registry.Expire(1'100);
  ASSERT_THAT(gone, SizeIs(1));
  EXPECT_EQ(gone[0].finding.guid, Impostor(1).guid);
  EXPECT_THAT(registry.standing(), SizeIs(1));
  // What the dead incarnation saw comes late from a spool.
  EXPECT_EQ(registry.Apply("base", "i1", Impostor(3), 2'000), News::kBegins);
  EXPECT_EQ(registry.Apply("base", "i1", Impostor(2), 2'000), News::kKnown);
  EXPECT_THAT(registry.Expire(2'100), SizeIs(1));
  EXPECT_THAT(registry.standing(), SizeIs(1)) << "the live one tells of the other";
}

TEST(FindingRegistryTest, PastTheLimitFindingsAreNotKept) {
  FindingRegistry registry({.standing = 2});
  EXPECT_EQ(registry.Apply("base", "i", Impostor(1), 0), News::kBegins);
  EXPECT_EQ(registry.Apply("base", "i", Impostor(2), 0), News::kBegins);
  EXPECT_EQ(registry.Apply("base", "i", Impostor(3), 0), News::kTooMany);
  EXPECT_THAT(registry.standing(), SizeIs(2));
  EXPECT_EQ(registry.Apply("base", "i", Over(Impostor(3)), 0), News::kKnown);
  registry.Apply("base", "i", Over(Impostor(1)), 0);
  EXPECT_EQ(registry.Apply("base", "i", Impostor(3), 0), News::kBegins);
}

uint64_t DigestOf(std::initializer_list<FindingSeen> findings) {
  uint64_t sum = 0;
  for (const FindingSeen& finding : findings) sum += model::DigestOf(finding);
  return sum;
}

TEST(FindingRegistryTest, ASensorHasToldAllWhenItSaysSoOfWhatStandsHere) {
  FindingRegistry registry;
  EXPECT_EQ(registry.NotToldAll("base"), "has not said yet which findings stand");
  registry.OnHello("base", "i1", 1'000);
  EXPECT_EQ(registry.NotToldAll("base"), "has not said yet which findings stand");
  registry.OnState("base", std::nullopt, false);
  EXPECT_EQ(registry.NotToldAll("base"), "is of a version that does not say which findings stand");
  registry.OnState("base", 0, false);
  EXPECT_THAT(registry.NotToldAll("base"), HasSubstr("may find more"));
  registry.OnState("base", 0, true);
  EXPECT_EQ(registry.NotToldAll("base"), "");
  registry.Apply("base", "i1", Impostor(1), 2'000);
  EXPECT_EQ(registry.NotToldAll("base"), "has not confirmed yet what it has reported last");
  registry.OnState("base", DigestOf({Impostor(1)}), true);
  EXPECT_EQ(registry.NotToldAll("base"), "");
  registry.Apply("base", "i1", Over(Impostor(1)), 3'000);
  EXPECT_NE(registry.NotToldAll("base"), "");
  registry.OnState("base", 0, true);
  EXPECT_EQ(registry.NotToldAll("base"), "");
  registry.OnHello("base", "i1", 4'000);
  EXPECT_NE(registry.NotToldAll("base"), "") << "in each session anew";
}

TEST(FindingRegistryTest, ASensorThatFindsSomethingElseIsAskedAndWhatItDoesNotRepeatEnds) {
  FindingRegistry registry({.confirm_ns = 60 * kNanosPerSecond});
  const auto at = [](int64_t seconds) { return seconds * kNanosPerSecond; };
  registry.OnHello("base", "i1", at(1));
  registry.OnHello("laptop", "j1", at(1));
  registry.Apply("base", "i1", Impostor(1), at(1));
  registry.Apply("laptop", "j1", Impostor(1), at(1));
  registry.Apply("base", "i1", Impostor(2), at(1));
  // The end of the second one was lost, and the begin of a third.
  registry.OnState("base", DigestOf({Impostor(1), Impostor(3)}), true);
  EXPECT_EQ(registry.Ask("base", at(2)), Asked::kNo);
  EXPECT_EQ(registry.Ask("base", at(6)), Asked::kNo) << "its next state may be on its way";
  EXPECT_EQ(registry.NotToldAll("base"), "has not confirmed yet what it has reported last");
  EXPECT_EQ(registry.Ask("base", at(7)), Asked::kYes);
  EXPECT_THAT(registry.NotToldAll("base"), HasSubstr("finds something else"));
  EXPECT_EQ(registry.Ask("base", at(66)), Asked::kNo) << "at most once a minute";
  registry.Apply("base", "i1", Impostor(1), at(8));
  registry.Apply("base", "i1", Impostor(3), at(8));
  EXPECT_NE(registry.NotToldAll("base"), "");
  ASSERT_THAT(registry.Expire(at(67)), SizeIs(1));
  EXPECT_EQ(registry.NotToldAll("base"), "");
  EXPECT_EQ(registry.Ask("base", at(100)), Asked::kNo);
  EXPECT_THAT(registry.standing(), SizeIs(2));
}

TEST(FindingRegistryTest, ThatASensorWasAskedInVainIsToldOnce) {
  FindingRegistry registry;
  const auto at = [](int64_t seconds) { return seconds * kNanosPerSecond; };
  registry.OnHello("base", "i1", 0);
  const auto disagree = [&](int64_t from) {
    registry.OnState("base", 1, true);
    EXPECT_EQ(registry.Ask("base", at(from)), Asked::kNo);
    EXPECT_EQ(registry.Ask("base", at(from + 5)), Asked::kYes);
    // A new session makes it no other process.
    registry.OnHello("base", "i1", at(from + 30));
    EXPECT_EQ(registry.Ask("base", at(from + 30)), Asked::kNo);
    registry.OnState("base", 1, true);
    EXPECT_EQ(registry.Ask("base", at(from + 65)), Asked::kYesInVain);
    EXPECT_EQ(registry.Ask("base", at(from + 125)), Asked::kYes);
  };
  disagree(1);
  registry.OnState("base", 0, true);
  EXPECT_EQ(registry.Ask("base", at(200)), Asked::kNo);
  disagree(201);
}

TEST(FindingRegistryTest, ASensorThatBeginsAnewWasNotAskedInVain) {
  FindingRegistry registry;
  const auto at = [](int64_t seconds) { return seconds * kNanosPerSecond; };
  registry.OnHello("base", "i1", 0);
  registry.OnState("base", 1, true);
  EXPECT_EQ(registry.Ask("base", at(1)), Asked::kNo);
  EXPECT_EQ(registry.Ask("base", at(6)), Asked::kYes);
  registry.OnHello("base", "i2", at(20));
  registry.OnState("base", 1, true);
  EXPECT_EQ(registry.Ask("base", at(70)), Asked::kNo) << "its next state may be on its way";
  EXPECT_EQ(registry.Ask("base", at(75)), Asked::kYes);
}

TEST(FindingRegistryTest, ASensorIsNotAskedInVainBecauseAnotherOneFillsTheTable) {
  FindingRegistry registry({.standing = 2});
  const auto at = [](int64_t seconds) { return seconds * kNanosPerSecond; };
  for (const char* host : {"base", "laptop"}) registry.OnHello(host, "i1", 0);
  registry.Apply("base", "i1", Impostor(1), 0);
  registry.Apply("base", "i1", Impostor(2), 0);
  EXPECT_EQ(registry.Apply("laptop", "i1", Impostor(3), 0), News::kTooMany);
  registry.OnState("laptop", DigestOf({Impostor(3)}), true);
  for (int64_t from = 10; from < 500; from += 100) {
    EXPECT_EQ(registry.Ask("laptop", at(from)), Asked::kNo);
    registry.Apply("base", "i1", Over(Impostor(1)), at(from + 1));
    EXPECT_EQ(registry.Ask("laptop", at(from + 2)), Asked::kNo);
    EXPECT_EQ(registry.Ask("laptop", at(from + 6)), Asked::kYes);
    // What it tells comes too late.
    registry.Apply("base", "i1", Impostor(1), at(from + 7));
    EXPECT_EQ(registry.Apply("laptop", "i1", Impostor(3), at(from + 8)), News::kTooMany);
    EXPECT_EQ(registry.Ask("laptop", at(from + 70)), Asked::kNo);
  }
}

TEST(FindingRegistryTest, AnOldEndDoesNotPassForANewOne) {
  FindingRegistry registry;
  registry.OnHello("base", "i2", 0);
  registry.Apply("base", "i2", Impostor(1), 0);
  registry.OnState("base", DigestOf({Impostor(1)}), true);
  // Of an older incarnation, from the spool.
  registry.Apply("base", "i1", Over(Impostor(1)), 1);
  EXPECT_THAT(registry.standing(), IsEmpty());
  EXPECT_NE(registry.NotToldAll("base"), "");
  EXPECT_EQ(registry.Ask("base", kNanosPerSecond), Asked::kNo);
  EXPECT_EQ(registry.Ask("base", 6 * kNanosPerSecond), Asked::kYes);
}

TEST(FindingRegistryTest, PastTheLimitNotAllIsTold) {
  FindingRegistry registry({.standing = 1});
  registry.OnHello("base", "i1", 0);
  registry.Apply("base", "i1", Impostor(1), 0);
  EXPECT_EQ(registry.Apply("base", "i1", Impostor(2), 0), News::kTooMany);
  registry.OnState("base", DigestOf({Impostor(1), Impostor(2)}), true);
  EXPECT_EQ(registry.NotToldAll("base"), "has reported more findings than the 1 that are kept");
  EXPECT_EQ(registry.Ask("base", kNanosPerSecond), Asked::kNo);
  EXPECT_EQ(registry.Ask("base", 10 * kNanosPerSecond), Asked::kNo) << "in vain";
  registry.Apply("base", "i1", Over(Impostor(1)), 10 * kNanosPerSecond);
  EXPECT_NE(registry.NotToldAll("base"), "") << "the other one stands";
  EXPECT_EQ(registry.Ask("base", 20 * kNanosPerSecond), Asked::kYes);
}

TEST(FindingRegistryTest, WhatASensorSaidThatIsNotListedAnyMoreEnds) {
  FindingRegistry registry;
  for (const char* host : {"base", "laptop"}) registry.OnHello(host, "i1", 0);
  registry.Apply("base", "i1", Impostor(1), 0);
  registry.Apply("laptop", "i1", Impostor(1), 0);
  registry.Apply("laptop", "i1", Impostor(2), 0);
  registry.KeepOnly([](const std::string& host) { return host == "base"; }, 5);
  EXPECT_THAT(registry.Expire(5), SizeIs(1));
  ASSERT_THAT(registry.standing(), SizeIs(1));
  EXPECT_EQ(registry.standing()[0].guid, Impostor(1).guid);
  registry.OnHello("laptop", "i1", 6);
  registry.OnState("laptop", 0, true);
  EXPECT_EQ(registry.NotToldAll("laptop"), "") << "listed again, it has told nothing";
}

TEST(FindingRegistryTest, KindsStandUntilTheirLastFindingEnds) {
  FindingRegistry registry;
  EXPECT_FALSE(registry.HasKind("impostor"));
  registry.Apply("base", "i1", Impostor(1), 0);
  registry.Apply("base", "i1", Impostor(2), 0);
  registry.Apply("base", "i1", {.kind = "impostors"}, 0);
  registry.Apply("base", "i1", Over(Impostor(1)), 0);
  EXPECT_TRUE(registry.HasKind("impostor"));
  registry.Apply("base", "i1", Over(Impostor(2)), 0);
  EXPECT_FALSE(registry.HasKind("impostor"));
  EXPECT_TRUE(registry.HasKind("impostors"));
  EXPECT_FALSE(registry.HasKind(""));
}

TEST(FindingRegistryTest, RemembersTheLatestEnds) {
  FindingRegistry registry({.ended = 2});
  registry.OnHello("base", "i1", 0);
  registry.Apply("base", "i1", Impostor(1), 0);
  registry.Find(FindingRegistry::KeyOf(Impostor(1)))->named = true;
  registry.Apply("base", "i1", Over(Impostor(1)), 5);
  ASSERT_THAT(registry.ended(), SizeIs(1));
  EXPECT_EQ(registry.ended().back().key, FindingRegistry::KeyOf(Impostor(1)));
  EXPECT_EQ(registry.ended().back().at_ns, 5);
  EXPECT_TRUE(registry.ended().back().named);
  registry.Apply("base", "i1", Over(Impostor(2)), 6);
  EXPECT_FALSE(registry.ended().back().named) << "it began before the server did";
  for (uint8_t i = 3; i < 200; ++i) registry.Apply("base", "i1", Over(Impostor(i)), i);
  EXPECT_THAT(registry.ended(), SizeIs(2));
  EXPECT_EQ(registry.ended().back().at_ns, 199);
}

}  // namespace
}  // namespace rips::pipeline

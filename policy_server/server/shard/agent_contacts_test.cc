#include "policy_server/server/shard/agent_contacts.h"

#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::pipeline {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::SizeIs;

class StepClock final : public Clock {
 public:
  Instant Now() const override { return now; }
  Instant now = {.boottime_ns = 50 * kNanosPerSecond, .unix_ns = 1'000 * kNanosPerSecond};
};

class AgentContactsTest : public testing::Test {
 protected:
  AgentContactsTest() { contacts_.SetListed({base_, arm_, other_}); }
  void Pass(int64_t ns) {
    clock_.now.boottime_ns += ns;
    clock_.now.unix_ns += ns;
  }

  const AgentId base_ = {"r1", AgentKind::kSensor, "base"};
  const AgentId arm_ = {"r1", AgentKind::kActuator, "arm"};
  const AgentId other_ = {"r10", AgentKind::kSensor, "base"};
  StepClock clock_;
  AgentContacts contacts_{&clock_};
};

TEST_F(AgentContactsTest, AnAgentThatHasNotSaidHelloIsListedAsNeverHeard) {
  const std::vector<AgentContacts::Contact> found = contacts_.Of("r1");
  ASSERT_THAT(found, SizeIs(2)) << "r10 is another robot";
  EXPECT_EQ(found[0].agent, base_);
  EXPECT_EQ(found[1].agent, arm_);
  EXPECT_EQ(found[0].version, "");
  EXPECT_EQ(found[0].heard_unix_ns, 0);
  EXPECT_THAT(contacts_.Of("r2"), IsEmpty());
}

TEST_F(AgentContactsTest, TheConfigurationIsOfTheLastHelloAndGoesWithTheAgent) {
  rips::v1::Configuration configuration;
  configuration.add_settings()->set_path("settle");
  contacts_.Greeted(base_, {"1", "", configuration.SerializeAsString()});
  contacts_.Greeted(arm_, {"0.9", "", ""});
  contacts_.Greeted(other_, {"1", "", "\xff"});
  const auto found = contacts_.ConfigurationsOf("r1");
  ASSERT_THAT(found, SizeIs(1)) << "the actuator is of an older version";
  EXPECT_EQ(found[0].agent, base_);
  EXPECT_EQ(found[0].configuration.settings(0).path(), "settle");
  EXPECT_EQ(found[0].unix_ns, 1'000 * kNanosPerSecond);
  EXPECT_THAT(contacts_.ConfigurationsOf("r10"), IsEmpty()) << "it cannot be decoded";
  contacts_.Greeted(base_, {"1", "", ""});
  EXPECT_THAT(contacts_.ConfigurationsOf("r1"), IsEmpty());
  contacts_.SetListed({arm_});
  EXPECT_THAT(contacts_.ConfigurationsOf("r1"), IsEmpty());
}

TEST_F(AgentContactsTest, TheLastMessageStaysWhenTheStreamHasEnded) {
  {
    const auto heard = contacts_.Greeted(base_, {"0.9.0", "10.0.0.7"});
    ASSERT_NE(heard, nullptr);
    Pass(kNanosPerSecond);
    *heard = clock_.now.boottime_ns;
  }
  Pass(3 * kNanosPerSecond);
  const AgentContacts::Contact found = contacts_.Of("r1")[0];
  EXPECT_EQ(found.version, "0.9.0");
  EXPECT_EQ(found.heard_ago_ns, 3 * kNanosPerSecond);
  EXPECT_EQ(found.heard_unix_ns, 1'001 * kNanosPerSecond);
}

TEST_F(AgentContactsTest, AWallClockThatJumpsChangesNoAge) {
  contacts_.Greeted(base_, {"1", "10.0.0.7"});
  Pass(2 * kNanosPerSecond);
  clock_.now.unix_ns = 7 * kNanosPerSecond;
  EXPECT_EQ(contacts_.Of("r1")[0].heard_ago_ns, 2 * kNanosPerSecond);
  EXPECT_EQ(contacts_.Of("r1")[0].heard_unix_ns, 5 * kNanosPerSecond);
}

TEST_F(AgentContactsTest, AMessageThatCameDuringTheQuestionIsNoNegativeAge) {
  *contacts_.Greeted(base_, {"1", "10.0.0.7"}) = clock_.now.boottime_ns + 1;
  EXPECT_EQ(contacts_.Of("r1")[0].heard_ago_ns, 0);
}

TEST_F(AgentContactsTest, AnAgentThatIsNotListedIsNotKept) {
  EXPECT_EQ(contacts_.Greeted({"r1", AgentKind::kActuator, "base"}, {"1", "10.0.0.7"}), nullptr);
  EXPECT_EQ(contacts_.Greeted({"r2", AgentKind::kSensor, "base"}, {"1", "10.0.0.7"}), nullptr);
  EXPECT_THAT(contacts_.Of("r1"), SizeIs(2));
}

TEST_F(AgentContactsTest, AnotherInventoryKeepsWhatIsKnownOfAgentsThatStay) {
  const auto heard = contacts_.Greeted(base_, {"0.9.0", "10.0.0.7"});
  contacts_.Greeted(arm_, {"0.9.0", "10.0.0.7"});
  contacts_.SetListed({base_});
  Pass(kNanosPerSecond);
  *heard = clock_.now.boottime_ns;
  ASSERT_THAT(contacts_.Of("r1"), SizeIs(1));
  EXPECT_EQ(contacts_.Of("r1")[0].version, "0.9.0");
  EXPECT_EQ(contacts_.Of("r1")[0].heard_ago_ns, 0) << "its open stream still counts";
  contacts_.SetListed({base_, arm_});
  EXPECT_EQ(contacts_.Of("r1")[1].version, "");
}

TEST_F(AgentContactsTest, TheirAddressLeadsToThoseThatCameFromIt) {
  contacts_.Greeted(base_, {"1", "10.0.0.7"});
  contacts_.Greeted(arm_, {"1", "10.0.0.7"});
  EXPECT_THAT(contacts_.At("10.0.0.7", 4), ElementsAre(base_, arm_));
  EXPECT_THAT(contacts_.At("10.0.0.7", 1), ElementsAre(base_));
  contacts_.Greeted(arm_, {"1", "10.0.0.8"});
  EXPECT_THAT(contacts_.At("10.0.0.7", 4), ElementsAre(base_));
  contacts_.SetListed({arm_});
  EXPECT_THAT(contacts_.At("10.0.0.7", 4), IsEmpty());
}

TEST_F(AgentContactsTest, AnUnknownAddressIsThatOfNoAgent) {
  contacts_.Greeted(base_, {"1", ""});
  EXPECT_THAT(contacts_.At("", 4), IsEmpty());
}

TEST_F(AgentContactsTest, AHugeOrMalformedVersionIsCut) {
  contacts_.Greeted(base_, {std::string(1 << 20, 'v'), ""});
  EXPECT_EQ(contacts_.Of("r1")[0].version, std::string(61, 'v') + "...");
  std::string umlauts;
  for (int i = 0; i < 64; ++i) umlauts += "\xC3\xA4";
  contacts_.Greeted(base_, {umlauts, ""});
  EXPECT_EQ(contacts_.Of("r1")[0].version, umlauts.substr(0, 60) + "...") << "between characters";
}

}  // namespace
}  // namespace rips::pipeline

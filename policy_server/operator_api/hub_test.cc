#include "policy_server/operator_api/hub.h"

#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::operator_api {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

bool Interested(const store::AlertRecord&) { return true; }
bool InterestedInStatus(const pipeline::RobotStatus&) { return true; }

TEST(HubTest, TellsEveryWatcherOfItsKind) {
  Hub hub(nullptr);
  std::vector<std::string> told;
  ASSERT_THAT(hub.WatchAlerts([&](const store::AlertRecord& alert) {
    told.push_back("first " + alert.id);
    return true;
  }),
              IsOk());
  ASSERT_THAT(hub.WatchAlerts([&](const store::AlertRecord& alert) {
    told.push_back("second " + alert.id);
    return true;
  }),
              IsOk());
  ASSERT_THAT(hub.WatchStatus([&](const pipeline::RobotStatus& status) {
    told.push_back("status " + status.robot);
    return true;
  }),
              IsOk());

  hub.OnAlert({.id = "a1"});
  hub.OnStatus({.robot = "r1"});

  EXPECT_THAT(told, ElementsAre("first a1", "second a1", "status r1"));
}

TEST(HubTest, RefusesOneWatcherMoreThanTheLimitOfBothKindsTogether) {
  Hub hub(nullptr);
  uint64_t first = 0;
  for (size_t i = 0; i < Hub::kWatchersMax; ++i) {
    const absl::StatusOr<uint64_t> id =
        i % 2 == 0 ? hub.WatchAlerts(Interested) : hub.WatchStatus(InterestedInStatus);
    ASSERT_THAT(id, IsOk()) << i;
    if (i == 0) first = *id;
  }

  const auto refusal =
      StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("256 operators watch already"));
  EXPECT_THAT(hub.WatchAlerts(Interested), refusal);
  EXPECT_THAT(hub.WatchStatus(InterestedInStatus), refusal);

  hub.Unwatch(first);
  hub.Unwatch(first);  // a second time frees nothing
  EXPECT_THAT(hub.WatchStatus(InterestedInStatus), IsOk());
  EXPECT_THAT(hub.WatchAlerts(Interested), refusal);
}

TEST(HubTest, AWatcherThatIsNoLongerInterestedFreesItsPlace) {
  Hub hub(nullptr);
  int told = 0;
  ASSERT_THAT(hub.WatchAlerts([&](const store::AlertRecord&) {
    ++told;
    return false;
  }),
              IsOk());
  for (size_t i = 1; i < Hub::kWatchersMax; ++i) ASSERT_THAT(hub.WatchAlerts(Interested), IsOk());

  hub.OnAlert({.id = "a1"});
  hub.OnAlert({.id = "a2"});

  EXPECT_EQ(told, 1);
  EXPECT_THAT(hub.WatchAlerts(Interested), IsOk());
}

TEST(HubTest, AWatcherThatLeftIsToldNothing) {
  Hub hub(nullptr);
  int told = 0;
  const auto id = hub.WatchStatus([&](const pipeline::RobotStatus&) {
    ++told;
    return true;
  });
  ASSERT_THAT(id, IsOk());
  hub.OnStatus({.robot = "r1"});

  hub.Unwatch(*id);
  hub.OnStatus({.robot = "r1"});

  EXPECT_EQ(told, 1);
}

TEST(HubTest, AWatcherMayLeaveWhileItIsTold) {
  Hub hub(nullptr);
  uint64_t id = 0;
  int told = 0;
  const auto watching = hub.WatchAlerts([&](const store::AlertRecord&) {
    ++told;
    hub.Unwatch(id);
    return true;
  });
  ASSERT_THAT(watching, IsOk());
  id = *watching;

  hub.OnAlert({.id = "a1"});
  hub.OnAlert({.id = "a2"});

  EXPECT_EQ(told, 1);
}

}  // namespace
}  // namespace rips::operator_api

#include "policy_server/server/operator_api/status_broadcaster.h"

#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/status_matchers.h"

namespace rips::operator_api {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

// One that follows and does nothing.
AlertWatcher Interested(std::function<bool(const store::AlertRecord&)> alert = nullptr) {
  if (!alert) alert = [](const store::AlertRecord&) { return true; };
  return {.room = [] { return true; },
          .alert = std::move(alert),
          .position = [](const Cursor&) { return true; },
          .gap = [](const std::string&) { return true; }};
}
bool InterestedInStatus(const pipeline::RobotStatus&) { return true; }

TEST(StatusBroadcasterTest, TellsEveryWatcherOfItsKind) {
  store::FakeStore store;
  StatusBroadcaster hub(&store, nullptr, {}, absl::InfiniteDuration());
  const auto raise = [&](const std::string& id) {
    store::WriteBatch batch{.robot = "r1"};
    batch.alerts.push_back({.id = id, .robot = "r1"});
    ASSERT_THAT(store.Commit(batch), IsOk());
    hub.feed().Look();
  };
  std::vector<std::string> told;
  for (const char* name : {"first ", "second "}) {
    ASSERT_THAT(hub.WatchAlerts(std::nullopt, Interested([&told, name](const auto& alert) {
                                  told.push_back(name + alert.id);
                                  return true;
                                })),
                IsOk());
  }
  hub.feed().Look();
  ASSERT_THAT(hub.WatchStatus([&](const pipeline::RobotStatus& status) {
    told.push_back("status " + status.robot);
    return true;
  }),
              IsOk());

  raise("a1");
  hub.OnStatus({.robot = "r1"});

  EXPECT_THAT(told, ElementsAre("first a1", "second a1", "status r1"));
}

TEST(StatusBroadcasterTest, RefusesOneWatcherMoreThanTheLimitOfBothKindsTogether) {
  store::FakeStore store;
  StatusBroadcaster hub(&store, nullptr, {}, absl::InfiniteDuration());
  uint64_t first = 0;
  for (size_t i = 0; i < StatusBroadcaster::kWatchersMax; ++i) {
    const absl::StatusOr<uint64_t> id = i % 2 == 0 ? hub.WatchAlerts(std::nullopt, Interested())
                                                   : hub.WatchStatus(InterestedInStatus);
    ASSERT_THAT(id, IsOk()) << i;
    if (i == 0) first = *id;
  }

  const auto refusal =
      StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("256 operators watch already"));
  EXPECT_THAT(hub.WatchAlerts(std::nullopt, Interested()), refusal);
  EXPECT_THAT(hub.WatchStatus(InterestedInStatus), refusal);

  hub.Unwatch(first);
  hub.Unwatch(first);  // a second time frees nothing
  EXPECT_THAT(hub.WatchStatus(InterestedInStatus), IsOk());
  EXPECT_THAT(hub.WatchAlerts(std::nullopt, Interested()), refusal);
}

TEST(StatusBroadcasterTest, AWatcherThatIsNoLongerInterestedFreesItsPlace) {
  store::FakeStore store;
  StatusBroadcaster hub(&store, nullptr, {}, absl::InfiniteDuration());
  const auto raise = [&](const std::string& id) {
    store::WriteBatch batch{.robot = "r1"};
    batch.alerts.push_back({.id = id, .robot = "r1"});
    ASSERT_THAT(store.Commit(batch), IsOk());
    hub.feed().Look();
  };
  int told = 0;
  ASSERT_THAT(hub.WatchAlerts(std::nullopt, Interested([&](const auto&) {
                                ++told;
                                return false;
                              })),
              IsOk());
  for (size_t i = 1; i < StatusBroadcaster::kWatchersMax; ++i) {
    ASSERT_THAT(hub.WatchAlerts(std::nullopt, Interested()), IsOk());
  }
  hub.feed().Look();

  raise("a1");
  raise("a2");

  EXPECT_EQ(told, 1);
  EXPECT_THAT(hub.WatchAlerts(std::nullopt, Interested()), IsOk());
}

TEST(StatusBroadcasterTest, AWatcherThatLeftIsToldNothing) {
  store::FakeStore store;
  StatusBroadcaster hub(&store, nullptr, {}, absl::InfiniteDuration());
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

TEST(StatusBroadcasterTest, CountsAlertsWhoseTraceIsCut) {
  store::FakeStore store;
  int cut = 0;
  StatusBroadcaster hub(&store, nullptr, {.cut_traces = [&] { ++cut; }}, absl::InfiniteDuration());

  hub.OnAlert({.id = "a1"});
  hub.OnAlert({.id = "a2", .trace = {.cut = true}});

  EXPECT_EQ(cut, 1);
}

TEST(StatusBroadcasterTest, AWatcherMayLeaveWhileItIsTold) {
  store::FakeStore store;
  StatusBroadcaster hub(&store, nullptr, {}, absl::InfiniteDuration());
  const auto raise = [&](const std::string& id) {
    store::WriteBatch batch{.robot = "r1"};
    batch.alerts.push_back({.id = id, .robot = "r1"});
    ASSERT_THAT(store.Commit(batch), IsOk());
    hub.feed().Look();
  };
  uint64_t id = 0;
  int told = 0;
  const auto watching = hub.WatchAlerts(std::nullopt, Interested([&](const auto&) {
                                          ++told;
                                          hub.Unwatch(id);
                                          return true;
                                        }));
  ASSERT_THAT(watching, IsOk());
  id = *watching;
  hub.feed().Look();

  raise("a1");
  raise("a2");

  EXPECT_EQ(told, 1);
}

}  // namespace
}  // namespace rips::operator_api

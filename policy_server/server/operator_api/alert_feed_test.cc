#include "policy_server/server/operator_api/alert_feed.h"

#include <sys/resource.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/server/store/fake_store.h"
#include "policy_server/server/store/sqlite_store.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/status_matchers.h"

namespace rips::operator_api {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// Watches as an operator's stream does, with room for so many.
struct FakeWatch {
  AlertWatcher Watcher(const std::string& robot = "") {
    return {.robot = robot,
            .room = [this] { return told.size() < room; },
            .alert =
                [this](const store::AlertRecord& alert) {
                  told.push_back(alert.text);
                  cursor = FormatCursor({.sequence = alert.sequence, .id = alert.id});
                  return interested;
                },
            .position =
                [this](const Cursor& at) {
                  cursor = FormatCursor(at);
                  return true;
                },
            .gap =
                [this](const std::string& text) {
                  told.push_back("gap: " + text);
                  return true;
                }};
  }
  size_t room = 1'000'000;
  bool interested = true;
  std::vector<std::string> told;
  std::string cursor;
};

class AlertFeedTest : public ::testing::Test {
 protected:
  void Raise(store::Store& store, const std::string& text, const std::string& robot = "r1") {
    store::WriteBatch batch{.robot = robot};
    batch.alerts.push_back(store::MakeAlert(robot, text));
    ASSERT_THAT(store.Commit(batch), IsOk());
  }
  void Raise(const std::string& text, const std::string& robot = "r1") {
    Raise(store_, text, robot);
  }
  std::unique_ptr<AlertFeed> Open(store::Store* store = nullptr) {
    log_ = *store::AlertLog::Open(path_);
    return std::make_unique<AlertFeed>(
        store != nullptr ? store : &store_, log_.get(),
        FeedCounts{.file_failures = [this](uint64_t by) { file_failures_ += by; }},
        absl::InfiniteDuration());
  }
  std::vector<std::string> File() {
    std::vector<std::string> texts;
    std::ifstream file(path_);
    for (std::string line; std::getline(file, line);) {
      const auto json = nlohmann::json::parse(line, nullptr, false);
      texts.push_back(json.is_object() ? json["text"].get<std::string>() : "?");
    }
    return texts;
  }

  store::TempDir dir_;
  const std::string path_ = dir_.File("alerts.jsonl");
  store::FakeStore store_;
  std::unique_ptr<store::AlertLog> log_;
  uint64_t file_failures_ = 0;
};

TEST_F(AlertFeedTest, ANoticeIsToldOnceThoughTheStoreCannotBeRead) {
  const auto feed = Open();
  FakeWatch watch;
  feed->Watch(1, std::nullopt, watch.Watcher());
  feed->Look();
  store_.FailReads(absl::UnavailableError("disk on fire"));
  feed->Notify("cannot write the store");
  feed->Look();
  feed->Look();
  EXPECT_THAT(watch.told, ElementsAre("gap: cannot write the store"));
}

TEST_F(AlertFeedTest, TheFileHasNoHoleAfterAFailedAppend) {
  const auto feed = Open();
  Raise("one");
  feed->Look();
  rlimit unlimited = {};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &unlimited), 0);
  const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit tight = {std::filesystem::file_size(path_) + 20, unlimited.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &tight), 0);
  Raise("two");
  feed->Look();
  Raise("three");
  feed->Look();
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &unlimited), 0);
  std::signal(SIGXFSZ, old_handler);
  EXPECT_EQ(file_failures_, 2u);
  EXPECT_THAT(File(), ElementsAre("one"));

  Raise("four");
  feed->Look();
  EXPECT_THAT(File(), ElementsAre("one", "two", "three", "four"));
  EXPECT_EQ(file_failures_, 2u);
}

TEST_F(AlertFeedTest, TheFileGoesOnAfterACrashWhereItStopped) {
  Raise("one");
  Open()->Look();
  Raise("two");
  Raise("three");
  std::ofstream(path_, std::ios::app) << "{\"id\":\"torn";  // the crash
  Open()->Look();
  EXPECT_THAT(File(), ElementsAre("one", "two", "three"));
  Open()->Look();
  EXPECT_THAT(File(), ElementsAre("one", "two", "three")) << "nothing twice";
}

TEST_F(AlertFeedTest, TheFileGoesOnInANewFileAfterARotationWhileTheServerWasAway) {
  Raise("one");
  {
    const auto feed = Open();
    feed->Look();
    feed->Stop();
  }
  std::filesystem::rename(path_, path_ + ".1");
  Raise("two");
  Open()->Look();
  EXPECT_THAT(File(), ElementsAre("two"));
}

TEST_F(AlertFeedTest, AFileOfAnotherStoreGoesOnWithWhatComes) {
  Raise("one");
  Open()->Look();
  store::FakeStore restored;
  Raise(restored, "of a backup");
  const auto feed = Open(&restored);
  feed->Look();
  EXPECT_THAT(File(), ElementsAre("one"));
  Raise(restored, "new");
  feed->Look();
  EXPECT_THAT(File(), ElementsAre("one", "new"));
}

TEST_F(AlertFeedTest, AFailingReadIsTriedAgain) {
  const auto feed = Open();
  Raise("one");
  store_.FailReads(absl::UnavailableError("disk on fire"));
  feed->Look();
  EXPECT_EQ(file_failures_, 1u);
  store_.FailReads(absl::OkStatus());
  feed->Look();
  EXPECT_THAT(File(), ElementsAre("one"));
}

TEST_F(AlertFeedTest, AWatchBeginsNowAndResumesWithoutGapOrDuplicate) {
  const auto feed = Open();
  Raise("before");
  FakeWatch first;
  feed->Watch(1, std::nullopt, first.Watcher());
  feed->Look();
  EXPECT_THAT(first.told, IsEmpty());
  EXPECT_NE(first.cursor, "");
  Raise("one");
  feed->Look();
  Raise("two");
  feed->Look();
  EXPECT_THAT(first.told, ElementsAre("one", "two"));
  feed->Unwatch(1);
  Raise("three");
  feed->Look();
  Raise("four");

  FakeWatch second;
  feed->Watch(2, *ParseCursor(first.cursor), second.Watcher());
  feed->Look();
  EXPECT_THAT(second.told, ElementsAre("three", "four"));
  FakeWatch all;
  feed->Watch(3, *ParseCursor("0"), all.Watcher());
  FakeWatch of_one;
  feed->Watch(4, *ParseCursor("0"), of_one.Watcher("r2"));
  Raise("five", "r2");
  feed->Look();
  EXPECT_THAT(all.told, ElementsAre("before", "one", "two", "three", "four", "five"));
  EXPECT_THAT(of_one.told, ElementsAre("five"));
}

TEST_F(AlertFeedTest, ASlowWatchIsToldTheRestWhenItHasRoom) {
  const auto feed = Open();
  FakeWatch slow;
  slow.room = 300;
  feed->Watch(1, *ParseCursor("0"), slow.Watcher());
  for (int i = 0; i < 1'000; ++i) Raise(absl::StrCat(i));
  feed->Look();
  EXPECT_EQ(slow.told.size(), 2 * AlertFeed::kPage) << "a page more than there is room for";
  slow.room = 1'000'000;
  feed->Look();
  ASSERT_EQ(slow.told.size(), 1'000u);
  for (int i = 0; i < 1'000; ++i) EXPECT_EQ(slow.told[static_cast<size_t>(i)], absl::StrCat(i));
}

TEST_F(AlertFeedTest, ACursorOfAnotherStoreIsAGap) {
  const auto feed = Open();
  Raise("one");
  for (const char* cursor : {"1-0123456789abcdef", "99-0123456789abcdef"}) {
    FakeWatch watch;
    feed->Watch(1, *ParseCursor(cursor), watch.Watcher());
    feed->Look();
    ASSERT_EQ(watch.told.size(), 1u) << cursor;
    EXPECT_THAT(watch.told[0], HasSubstr("gap: the cursor is of another store"));
    Raise("next");
    feed->Look();
    EXPECT_EQ(watch.told.back(), "next");
  }
}

TEST_F(AlertFeedTest, WhatTheLimitHasForgottenIsAGap) {
  const auto store = store::SqliteStore::Open(dir_.File("state.db"), {.alerts_per_robot_max = 3});
  ASSERT_THAT(store, IsOk());
  const auto feed = Open(store->get());
  FakeWatch watch;
  feed->Watch(1, *ParseCursor("0"), watch.Watcher());
  Raise(**store, "0");
  feed->Look();
  feed->Unwatch(1);
  for (int i = 1; i < 9; ++i) Raise(**store, absl::StrCat(i));

  FakeWatch later;
  feed->Watch(2, *ParseCursor(watch.cursor), later.Watcher());
  feed->Look();
  ASSERT_EQ(later.told.size(), 4u);
  EXPECT_THAT(later.told[0], HasSubstr("gap: alerts before this one were forgotten"));
  EXPECT_EQ(later.told[1], "6");
}

TEST_F(AlertFeedTest, WhoIsNoLongerInterestedIsToldNothingMore) {
  const auto feed = Open();
  std::vector<uint64_t> left;
  feed->set_on_left([&](uint64_t id) { left.push_back(id); });
  FakeWatch watch;
  watch.interested = false;
  feed->Watch(7, std::nullopt, watch.Watcher());
  feed->Look();
  Raise("one");
  feed->Look();
  Raise("two");
  feed->Look();
  EXPECT_THAT(watch.told, ElementsAre("one"));
  EXPECT_THAT(left, ElementsAre(7u));
}

TEST(CursorTest, RefusesWhatIsNone) {
  for (const char* text : {"", "x", "1", "-1", "0-abc", "1-", "01-abc", "1 -abc",
                           "99999999999999999999-abc", "18446744073709551615-abc"}) {
    EXPECT_THAT(ParseCursor(text), StatusIs(absl::StatusCode::kInvalidArgument)) << text;
  }
  EXPECT_EQ(FormatCursor(*ParseCursor("17-abc")), "17-abc");
  EXPECT_EQ(ParseCursor("0")->sequence, 0u);
}

}  // namespace
}  // namespace rips::operator_api

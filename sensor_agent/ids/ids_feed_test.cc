#include "sensor_agent/ids/ids_feed.h"

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/fake_clock.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::sensor {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::ElementsAreArray;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

std::string Line(int sid) {
  return absl::StrCat("11/21/2026-10:11:12.123456  [**] [1:", sid,
                      ":1] scan [**] [Priority: 1] {TCP} 10.0.0.9:4444 -> 10.0.0.1:80\n");
}

// What a policy server behind an outbox does.
class FakeServer {
 public:
  IdsSink Sink() {
    return {.ready = [this] { return ready; },
            .take =
                [this](std::vector<ControlObservation> alerts, std::vector<Loss> lost) {
                  MutexLock lock(&mu);
                  for (const ControlObservation& each : alerts) {
                    taken.push_back(std::get<IdsAlert>(each.what).sid);
                    times.push_back(each.boottime_ns);
                  }
                  for (Loss& each : lost) losses.push_back(std::move(each));
                  if (acknowledges) acknowledged = taken.size();
                },
            .acknowledged =
                [this] {
                  MutexLock lock(&mu);
                  return acknowledged;
                },
            .blind = [this](std::vector<std::string> reasons) { blind.push_back(reasons); }};
  }
  // As told last.
  std::vector<std::string> blind_now() const {
    return blind.empty() ? std::vector<std::string>() : blind.back();
  }
  size_t taken_size() {
    MutexLock lock(&mu);
    return taken.size();
  }
  uint64_t lost(LossCause cause) const {
    uint64_t count = 0;
    for (const Loss& each : losses) count += each.cause == cause ? each.count : 0;
    return count;
  }

  bool ready = true;
  bool acknowledges = true;
  Mutex mu;
  std::vector<uint32_t> taken;
  std::vector<int64_t> times;
  std::vector<Loss> losses;
  uint64_t acknowledged = 0;
  // Each time it was told.
  std::vector<std::vector<std::string>> blind;
};

class IdsFeedTest : public testing::Test {
 protected:
  IdsFeedTest() {
    std::string name = testing::TempDir() + "/ids_feed_XXXXXX";
    dir_ = mkdtemp(name.data());
    path_ = dir_ + "/fast.log";
    options_ = {.logs = {{IdsFormat::kFast, path_}}, .offsets_file = dir_ + "/ids-offsets"};
  }
  ~IdsFeedTest() override { fs::remove_all(dir_); }

  void Append(const std::string& path, absl::string_view text) {
    std::ofstream(path, std::ios::app | std::ios::binary) << text;
  }
  void Append(absl::string_view text) { Append(path_, text); }

  // A process of the sensor that begins; the one before is gone without a word.
  void Begin() {
    server_ = std::make_unique<FakeServer>();
    metrics_ = std::make_unique<Metrics>();
    feed_ = std::make_unique<IdsFeed>(options_, server_->Sink(), &clock_, metrics_.get());
  }
  // Turns, and time for whatever has an interval.
  void Pass(int64_t ns = 2 * kNanosPerSecond) {
    for (int i = 0; i < 3; ++i) {
      while (feed_->Turn()) {
      }
      clock_.Advance(ns);
    }
    feed_->Turn();
  }

  std::string dir_;
  std::string path_;
  IdsFeedOptions options_;
  FakeClock clock_;
  std::unique_ptr<FakeServer> server_;
  std::unique_ptr<Metrics> metrics_;
  std::unique_ptr<IdsFeed> feed_;
};

TEST_F(IdsFeedTest, HandsNewAlertsOnOnce) {
  Append(Line(1));
  Begin();
  Pass();
  Append(absl::StrCat(Line(2), Line(3)));
  Pass();
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(2, 3));
  EXPECT_THAT(server_->losses, IsEmpty());
  EXPECT_THAT(metrics_->Text(),
              HasSubstr(absl::StrCat("rips_sensor_ids_alerts_total{log=\"", path_, "\"} 2")));
}

TEST_F(IdsFeedTest, AfterACrashNothingComesTwiceAndNothingIsSkipped) {
  Begin();
  Pass();
  std::vector<uint32_t> all;
  std::vector<uint32_t> expected;
  for (int i = 1; i <= 20; ++i) {
    Append(Line(i));
    expected.push_back(static_cast<uint32_t>(i));
    if (i % 3 == 0) Pass();
    if (i % 4 == 0) {
      all.insert(all.end(), server_->taken.begin(), server_->taken.end());
      EXPECT_THAT(server_->losses, IsEmpty()) << i;
      Begin();
    }
  }
  Pass();
  all.insert(all.end(), server_->taken.begin(), server_->taken.end());
  EXPECT_THAT(all, ElementsAreArray(expected));
}

TEST_F(IdsFeedTest, InDoubtAfterACrashIsALoss) {
  Begin();
  Pass();
  server_->acknowledges = false;
  Append(absl::StrCat(Line(1), Line(2)));
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(1, 2));
  Append(Line(3));
  Begin();
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(3));
  EXPECT_EQ(server_->lost(LossCause::kOutboxShed), 2);
  // Told once.
  Begin();
  Pass();
  EXPECT_THAT(server_->losses, IsEmpty());
}

TEST_F(IdsFeedTest, WhileTheServerIsAwayAlertsStayInTheLog) {
  Begin();
  Pass();
  server_->ready = false;
  const int64_t written_ns = clock_.Now().boottime_ns;
  Append(absl::StrCat(Line(1), Line(2)));
  Pass();
  EXPECT_THAT(server_->taken, IsEmpty());
  server_->ready = true;
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(1, 2));
  EXPECT_THAT(server_->times, ElementsAre(written_ns, written_ns)) << "when it was read";

  server_->ready = false;
  Append(absl::StrCat(Line(3), Line(4)));
  Pass(60 * kNanosPerSecond);
  Begin();  // crashed while the server was away
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(3, 4));
  EXPECT_THAT(server_->losses, IsEmpty());
}

TEST_F(IdsFeedTest, WhileTheServerIsAwayRotatedLogsAreFoundAgain) {
  Begin();
  Pass();
  server_->ready = false;
  Append(Line(1));
  Pass(60 * kNanosPerSecond);
  fs::rename(path_, path_ + ".1");
  Append(Line(2));
  Pass(60 * kNanosPerSecond);
  Begin();
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(1, 2));
  EXPECT_THAT(server_->losses, IsEmpty());
}

TEST_F(IdsFeedTest, ACleanStopLeavesNothingInDoubtThatIsAcknowledged) {
  Begin();
  Pass();
  Append(Line(1));
  feed_->Turn();
  clock_.Advance(kNanosPerSecond);
  feed_->Turn();
  feed_->SaveAtEnd();
  Begin();
  Pass();
  EXPECT_THAT(server_->taken, IsEmpty());
  EXPECT_THAT(server_->losses, IsEmpty());
}

TEST_F(IdsFeedTest, AnOutboxThatSurvivesAStopLeavesNothingInDoubt) {
  options_.outbox_survives_stop = true;
  Begin();
  Pass();
  server_->acknowledges = false;
  Append(Line(1));
  Pass();
  feed_->SaveAtEnd();
  Begin();
  Pass();
  EXPECT_THAT(server_->losses, IsEmpty());
}

TEST_F(IdsFeedTest, TooManyWaitingAreALoss) {
  options_.limits.queued = 3;
  Begin();
  Pass();
  server_->ready = false;
  for (int i = 1; i <= 5; ++i) Append(Line(i));
  Pass();
  EXPECT_EQ(server_->lost(LossCause::kLimit), 2);
  EXPECT_THAT(metrics_->Text(), HasSubstr("rips_sensor_ids_dropped_total 2"));
  server_->ready = true;
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(1, 2, 3));
  Append(Line(6));
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(1, 2, 3, 6));
}

TEST_F(IdsFeedTest, TooManyBytesWaitingAreALoss) {
  options_.limits.queued_bytes = 2'000;
  Begin();
  Pass();
  server_->ready = false;
  for (int i = 1; i <= 20; ++i) Append(Line(i));
  Pass();
  EXPECT_GT(server_->lost(LossCause::kLimit), 10);
  EXPECT_LT(server_->lost(LossCause::kLimit), 20);
}

TEST_F(IdsFeedTest, OnlySoManyAreInFlight) {
  options_.limits.in_flight = 2;
  Begin();
  Pass();
  server_->acknowledges = false;
  for (int i = 1; i <= 5; ++i) Append(Line(i));
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(1, 2));
  server_->acknowledged = 1;
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(1, 2, 3));
  server_->acknowledged = 3;
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(1, 2, 3, 4, 5));
}

TEST_F(IdsFeedTest, TheFirstIsHandedOverAtOnceAndOthersTogether) {
  Begin();
  Pass();
  Append(Line(1));
  feed_->Turn();
  EXPECT_THAT(server_->taken, ElementsAre(1));
  Append(Line(2));
  feed_->Turn();
  Append(Line(3));
  feed_->Turn();
  EXPECT_THAT(server_->taken, ElementsAre(1));
  clock_.Advance(options_.limits.save_interval_ns);
  feed_->Turn();
  EXPECT_THAT(server_->taken, ElementsAre(1, 2, 3));
}

TEST_F(IdsFeedTest, CorruptOffsetsBeginAtTheEndWithALoss) {
  Append(Line(1));
  for (const char* text : {"", "garbage", "rips ids-offsets 1\nunacknowledged 0\n"}) {
    std::ofstream(options_.offsets_file) << text;
    Begin();
    Pass();
    EXPECT_EQ(server_->lost(LossCause::kLimit), 1) << text;
    EXPECT_THAT(server_->taken, IsEmpty());
    Append(Line(2));
    Pass();
    EXPECT_THAT(server_->taken, ElementsAre(2));
  }
  fs::remove(options_.offsets_file);
  fs::create_directory(options_.offsets_file);
  Begin();
  Pass();
  EXPECT_EQ(server_->lost(LossCause::kLimit), 1) << "a directory";
}

TEST_F(IdsFeedTest, WithoutAPlaceForOffsetsAlertsStillCome) {
  options_.offsets_file = dir_ + "/state/ids-offsets";
  std::ofstream(dir_ + "/state") << "no directory";
  Begin();
  Pass();
  EXPECT_EQ(server_->lost(LossCause::kLimit), 1) << "where to go on is not known";
  Append(Line(1));
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(1));
  EXPECT_THAT(metrics_->Text(), HasSubstr("rips_sensor_ids_unsaved 1"));
  fs::remove(dir_ + "/state");
  fs::create_directory(dir_ + "/state");
  Pass(60 * kNanosPerSecond);
  EXPECT_THAT(metrics_->Text(), HasSubstr("rips_sensor_ids_unsaved 0"));
}

TEST_F(IdsFeedTest, MakesTheDirectoryOfItsOffsets) {
  options_.offsets_file = dir_ + "/a/b/ids-offsets";
  Begin();
  Pass();
  EXPECT_TRUE(fs::exists(options_.offsets_file));
  EXPECT_THAT(server_->losses, IsEmpty());
}

TEST_F(IdsFeedTest, SeveralLogsKeepTheirOwnPlaces) {
  const std::string eve = dir_ + "/eve.json";
  const std::string json = dir_ + "/alert_json.txt";
  options_.logs.push_back({IdsFormat::kEve, eve});
  options_.logs.push_back({IdsFormat::kSnort3Json, json});
  Begin();
  Pass();
  Append(Line(1));
  Append(eve,
         "{\"event_type\":\"alert\",\"alert\":{\"signature_id\":2}}\n{\"event_type\":\"x\"}\n");
  Append(json, "{\"msg\":\"m\",\"sid\":3}\n");
  Pass();
  EXPECT_THAT(std::multiset<uint32_t>(server_->taken.begin(), server_->taken.end()),
              ElementsAre(1, 2, 3));
  Append(eve, "{\"event_type\":\"alert\",\"alert\":{\"signature_id\":4}}\n");
  Begin();
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(4));
}

TEST_F(IdsFeedTest, LinesThatMakeNoSenseAreCountedLosses) {
  options_.limits.tail.line_bytes = 1'000;
  Begin();
  Pass();
  Append(absl::StrCat("garbage\n\n", Line(1), "\x1b[31mmore garbage\n", std::string(2'000, 'x'),
                      "\n", Line(2)));
  Pass();
  EXPECT_THAT(server_->taken, ElementsAre(1, 2));
  EXPECT_EQ(server_->lost(LossCause::kUndecodable), 2);
  EXPECT_THAT(server_->losses, SizeIs(2)) << "one record of each cause";
  EXPECT_EQ(server_->lost(LossCause::kLimit), 1);
  EXPECT_THAT(
      metrics_->Text(),
      HasSubstr(absl::StrCat("rips_sensor_ids_not_understood_total{log=\"", path_, "\"} 2")));
  EXPECT_THAT(metrics_->Text(),
              HasSubstr(absl::StrCat("rips_sensor_ids_too_long_total{log=\"", path_, "\"} 1")));
}

TEST_F(IdsFeedTest, ALogThatIsGoneShows) {
  Append("");
  Begin();
  Pass();
  const std::string open = absl::StrCat("rips_sensor_ids_open{log=\"", path_, "\"} ");
  EXPECT_THAT(metrics_->Text(), HasSubstr(open + "1"));
  fs::remove(path_);
  Pass(20 * kNanosPerSecond);
  EXPECT_THAT(metrics_->Text(), HasSubstr(open + "0"));
  Append(Line(1));
  Pass();
  EXPECT_THAT(metrics_->Text(), HasSubstr(open + "1"));
  EXPECT_THAT(server_->taken, ElementsAre(1));
}

TEST_F(IdsFeedTest, ALogThatWasNeverThereIsToldAtOnce) {
  Begin();
  feed_->Turn();
  EXPECT_THAT(server_->blind_now(), ElementsAre(absl::StrCat("IDS log (fast): cannot open `", path_,
                                                             "`: No such file or directory")));
  Pass(60 * kNanosPerSecond);
  EXPECT_THAT(server_->blind, SizeIs(1)) << "as long as nothing changes";
  Append(Line(1));
  feed_->Turn();
  EXPECT_THAT(server_->blind_now(), IsEmpty());
  EXPECT_THAT(server_->blind, SizeIs(2));
}

TEST_F(IdsFeedTest, ALogThatCannotBeReadIsToldAndRecovers) {
  fs::create_directory(path_);
  Begin();
  feed_->Turn();
  EXPECT_THAT(server_->blind_now(),
              ElementsAre(absl::StrCat("IDS log (fast): `", path_, "` is no regular file")));
  fs::remove(path_);
  Append("");
  if (geteuid() != 0) {
    fs::permissions(path_, fs::perms::none);
    feed_->Turn();
    EXPECT_THAT(server_->blind_now(), ElementsAre(HasSubstr("Permission denied")));
    fs::permissions(path_, fs::perms::owner_all);
  }
  feed_->Turn();
  EXPECT_THAT(server_->blind_now(), IsEmpty());
}

TEST_F(IdsFeedTest, ALogThatVanishesIsToldWhenItIsNoRotation) {
  Append("");
  Begin();
  Pass();
  fs::rename(path_, path_ + ".1");
  feed_->Turn();
  clock_.Advance(9 * kNanosPerSecond);
  feed_->Turn();
  EXPECT_THAT(server_->blind, IsEmpty()) << "the IDS may be rotating it";
  clock_.Advance(kNanosPerSecond);
  feed_->Turn();
  EXPECT_THAT(server_->blind_now(), ElementsAre(HasSubstr("No such file or directory")));
  Append(Line(1));
  Pass();
  EXPECT_THAT(server_->blind_now(), IsEmpty());
  EXPECT_THAT(server_->taken, ElementsAre(1));
}

TEST_F(IdsFeedTest, ALogOfAnotherFormatIsTold) {
  options_.logs[0].format = IdsFormat::kEve;
  Begin();
  Append("");
  Pass();
  Append(absl::StrCat(Line(1), "\n", Line(2), "\n"));
  Pass();
  EXPECT_THAT(server_->blind_now(), IsEmpty()) << "two may be damaged";
  Append(absl::StrCat("\n", Line(3)));
  Pass();
  EXPECT_THAT(server_->blind_now(),
              ElementsAre(absl::StrCat("IDS log (eve): no line of `", path_,
                                       "` makes sense; is its format right?")));
  Append("\n");
  Pass();
  EXPECT_THAT(server_->blind_now(), SizeIs(1)) << "an empty line makes no sense either";
  Append("{\"event_type\":\"stats\"}\n");
  Pass();
  EXPECT_THAT(server_->blind_now(), IsEmpty());
}

TEST_F(IdsFeedTest, EachLogHasItsOwnReason) {
  options_.logs.push_back({IdsFormat::kEve, dir_ + "/eve.json"});
  Append("");
  Begin();
  Pass();
  EXPECT_THAT(server_->blind_now(), ElementsAre(HasSubstr("IDS log (eve): cannot open")));
  fs::remove(path_);
  Pass(20 * kNanosPerSecond);
  EXPECT_THAT(server_->blind_now(),
              ElementsAre(HasSubstr("IDS log (fast)"), HasSubstr("IDS log (eve)")));
}

TEST_F(IdsFeedTest, AGapIsALoss) {
  Begin();
  Append(Line(1));
  Pass();
  fs::remove(path_);
  Append(Line(2));
  Begin();
  Pass();
  EXPECT_EQ(server_->lost(LossCause::kLimit), 1);
  EXPECT_THAT(server_->taken, ElementsAre(2));
}

TEST_F(IdsFeedTest, ATruncationIsALossOnlyIfSomethingWasUnread) {
  Begin();
  Pass();
  Append(Line(1));
  Pass();
  fs::resize_file(path_, 0);
  Append(Line(2));
  Pass();
  EXPECT_EQ(server_->lost(LossCause::kLimit), 0);
  Append(Line(3));  // unread
  fs::resize_file(path_, 0);
  Append(Line(4));
  Pass();
  EXPECT_EQ(server_->lost(LossCause::kLimit), 1);
  EXPECT_THAT(server_->taken, ElementsAre(1, 2, 4));
  const std::string of_log = absl::StrCat("{log=\"", path_, "\"} ");
  EXPECT_THAT(
      metrics_->Text(),
      testing::AllOf(HasSubstr(absl::StrCat("rips_sensor_ids_gaps_total", of_log, 1)),
                     HasSubstr(absl::StrCat("rips_sensor_ids_truncated_total", of_log, 2))));
}

TEST_F(IdsFeedTest, TheThreadReadsAsItComes) {
  const RealClock clock;
  Metrics metrics;
  FakeServer server;
  Append("");
  options_.limits.save_interval_ns = kNanosPerMilli;
  IdsFeed feed(options_, server.Sink(), &clock, &metrics);
  feed.Start();
  std::vector<uint32_t> expected;
  const absl::Time deadline = absl::Now() + absl::Seconds(30);
  // What was there when it began is old.
  while (!fs::exists(options_.offsets_file) && absl::Now() < deadline) {
    absl::SleepFor(absl::Milliseconds(1));
  }
  for (int i = 1; i <= 300; ++i) {
    const std::string line = Line(i);
    Append(line.substr(0, static_cast<size_t>(i) % line.size()));
    Append(line.substr(static_cast<size_t>(i) % line.size()));
    if (i % 50 == 0) fs::rename(path_, absl::StrCat(path_, ".", i));
    expected.push_back(static_cast<uint32_t>(i));
  }
  while (server.taken_size() < expected.size() && absl::Now() < deadline) {
    absl::SleepFor(absl::Milliseconds(1));
  }
  feed.Stop();
  EXPECT_THAT(server.taken, ElementsAreArray(expected));
  EXPECT_THAT(server.losses, IsEmpty());
}

}  // namespace
}  // namespace rips::sensor

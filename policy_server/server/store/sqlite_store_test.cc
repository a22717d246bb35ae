// What only a file can do: survive, and be damaged.
#include "policy_server/server/store/sqlite_store.h"

#include <sched.h>
#include <signal.h>
#include <sqlite3.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/status_matchers.h"

namespace rips::store {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::SizeIs;

class SqliteStoreTest : public testing::Test {
 protected:
  // Opens, commits two decisions and an alert, closes.
  void MakeHistory() {
    auto store = SqliteStore::Open(path_);
    ASSERT_THAT(store, IsOk());
    ASSERT_EQ((*store)->Acquire("r1")->tenure, 1u);
    WriteBatch batch = Decide("r1", {1, 1}, "DEFAULT", "ALERT");
    batch.alerts.push_back(MakeAlert("r1", "kept"));
    ASSERT_THAT((*store)->Commit(batch), IsOk());
    ASSERT_THAT((*store)->Commit(Decide("r1", {1, 2}, "ALERT", "HALT")), IsOk());
  }
  void Execute(const std::string& sql) {
    sqlite3* db = nullptr;
    ASSERT_EQ(sqlite3_open(path_.c_str(), &db), SQLITE_OK);
    EXPECT_EQ(sqlite3_exec(db, sql.c_str(), nullptr, nullptr, nullptr), SQLITE_OK)
        << sqlite3_errmsg(db);
    sqlite3_close(db);
  }

  TempDir dir_;
  std::string path_ = dir_.File("state.db");
};

TEST_F(SqliteStoreTest, RemembersAcrossAReopen) {
  MakeHistory();
  auto store = SqliteStore::Open(path_);
  ASSERT_THAT(store, IsOk());

  auto record = (*store)->Load("r1");
  ASSERT_THAT(record, IsOk());
  EXPECT_EQ(record->level, "HALT");
  EXPECT_EQ(record->decision_id, (DecisionId{1, 2}));
  EXPECT_THAT((*store)->Commit(Decide("r1", {1, 3}, "HALT", "ALERT")), IsOk()) << "still its owner";
  EXPECT_EQ((*store)->Acquire("r1")->tenure, 2u);
  EXPECT_THAT((*store)->Commit(Decide("r1", {1, 4}, "ALERT", "DEFAULT")),
              StatusIs(absl::StatusCode::kAborted));
  EXPECT_TRUE((*store)->FindDecision("r1", {1, 1})->has_value());
  EXPECT_THAT(*(*store)->ListTransitions("r1", 0), SizeIs(3));
}

TEST_F(SqliteStoreTest, TheFileIsForItsOwnerOnly) {
  MakeHistory();
  struct stat info = {};
  ASSERT_EQ(stat(path_.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600u);
}

TEST_F(SqliteStoreTest, OneProcessAtATime) {
  auto store = SqliteStore::Open(path_);
  ASSERT_THAT(store, IsOk());
  EXPECT_THAT(SqliteStore::Open(path_), StatusIs(absl::StatusCode::kFailedPrecondition,
                                                 HasSubstr("in use by another policy server")));
  store->reset();
  EXPECT_THAT(SqliteStore::Open(path_), IsOk());
}

TEST_F(SqliteStoreTest, WritesNothingWhileItsFileIsAway) {
  MakeHistory();
  auto store = SqliteStore::Open(path_);
  ASSERT_THAT(store, IsOk());
  const uint64_t tenure = (*store)->Acquire("r1")->tenure;
  const auto decide = [&](uint64_t epoch) {
    WriteBatch batch = Decide("r1", {tenure, epoch}, "HALT", "ALERT");
    batch.tenure = tenure;
    return (*store)->Commit(batch);
  };
  ASSERT_THAT(decide(3), IsOk());
  for (const char* suffix : {"", "-wal"}) {
    const std::string file = path_ + suffix;
    SCOPED_TRACE(file);
    std::filesystem::rename(file, file + ".away");
    EXPECT_THAT(decide(4),
                StatusIs(absl::StatusCode::kUnavailable, HasSubstr("put the file back")));
    EXPECT_THAT((*store)->SetNote("a", "b"), StatusIs(absl::StatusCode::kUnavailable));
    // An administrator restores a backup, and the server runs.
    std::filesystem::copy_file(file + ".away", file);
    EXPECT_THAT(decide(4), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("replaced")));
    std::filesystem::rename(file + ".away", file);
    EXPECT_THAT((*store)->SetNote("a", "b"), IsOk());
  }
  EXPECT_THAT(decide(4), IsOk());
}

TEST_F(SqliteStoreTest, NeedsADirectory) {
  EXPECT_THAT(SqliteStore::Open(dir_.File("none/state.db")),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("does not exist; make it")));
  EXPECT_THAT(SqliteStore::Open(dir_.File("")), testing::Not(IsOk()));
}

TEST_F(SqliteStoreTest, StartsFromAHalfMadeFile) {
  std::ofstream(path_ + ".new") << "half";
  MakeHistory();
  EXPECT_FALSE(std::filesystem::exists(path_ + ".new"));
}

TEST_F(SqliteStoreTest, RefusesAnEmptyFile) {
  std::ofstream(path_) << "";
  EXPECT_THAT(SqliteStore::Open(path_),
              StatusIs(absl::StatusCode::kDataLoss,
                       AllOf(HasSubstr("is empty"), HasSubstr("restore it from a backup"))));
  EXPECT_EQ(std::filesystem::file_size(path_), 0u);
}

TEST_F(SqliteStoreTest, RefusesAFileThatIsNotOurs) {
  std::ofstream(path_) << std::string(5'000, 'x');
  EXPECT_THAT(SqliteStore::Open(path_), StatusIs(absl::StatusCode::kDataLoss, HasSubstr(path_)));
  std::filesystem::remove(path_);
  Execute("CREATE TABLE other (x)");
  EXPECT_THAT(SqliteStore::Open(path_),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("not a state file")));
}

TEST_F(SqliteStoreTest, RefusesALogWithoutItsFile) {
  std::ofstream(path_ + "-wal") << "left over";
  EXPECT_THAT(SqliteStore::Open(path_),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("write-ahead log")));
  EXPECT_FALSE(std::filesystem::exists(path_));
}

TEST_F(SqliteStoreTest, RefusesANewerSchema) {
  MakeHistory();
  Execute("PRAGMA user_version = 11");
  EXPECT_THAT(SqliteStore::Open(path_),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       HasSubstr("schema version 11, this program knows up to 10")));
  Execute("PRAGMA user_version = 0");
  EXPECT_THAT(SqliteStore::Open(path_), StatusIs(absl::StatusCode::kDataLoss));
}

TEST_F(SqliteStoreTest, TakesAnOlderSchemaForward) {
  MakeHistory();
  const auto load = [&] {
    const auto store = SqliteStore::Open(path_);
    EXPECT_THAT(store, IsOk());
    return *(*store)->Load("r1");
  };
  const RobotRecord before = load();
  const auto drop_maintenance = [&] {
    Execute("DROP TABLE maintenance");
    Execute("ALTER TABLE alerts DROP COLUMN maintenance");
  };
  drop_maintenance();
  Execute("PRAGMA user_version = 9");
  EXPECT_EQ(load(), before);
  const auto drop_acks = [&] {
    drop_maintenance();
    Execute("DROP INDEX alerts_open");
    Execute("DROP INDEX alerts_robot_open");
    Execute("DROP INDEX alerts_grave");
    for (const char* column : {"ack_by", "ack_note", "ack_unix_ns"}) {
      Execute(absl::StrCat("ALTER TABLE alerts DROP COLUMN ", column));
    }
  };
  drop_acks();
  Execute("PRAGMA user_version = 8");
  EXPECT_EQ(load(), before);
  drop_acks();
  Execute("DROP TABLE receipts");
  Execute("PRAGMA user_version = 7");
  EXPECT_EQ(load(), before);
  drop_acks();
  Execute("DROP TABLE receipts");
  Execute("ALTER TABLE robots DROP COLUMN tenure");
  Execute("PRAGMA user_version = 6");
  EXPECT_EQ(load(), before);
  bool only_traces = true;
  const auto undo_newest = [&] {
    drop_acks();
    Execute("DROP TABLE receipts");
    Execute("ALTER TABLE robots DROP COLUMN tenure");
    Execute("ALTER TABLE alerts DROP COLUMN trace");
    Execute("ALTER TABLE transitions DROP COLUMN trace");
    if (std::exchange(only_traces, false)) return;
    Execute("ALTER TABLE robots DROP COLUMN resumed_term");
    Execute("ALTER TABLE robots DROP COLUMN resumed_epoch");
    Execute("DROP TABLE generations");
  };
  undo_newest();
  Execute("PRAGMA user_version = 5");
  EXPECT_EQ(load(), before);
  undo_newest();
  Execute("PRAGMA user_version = 4");
  EXPECT_EQ(load(), before);
  undo_newest();
  Execute("ALTER TABLE robots DROP COLUMN bundle");
  Execute("ALTER TABLE robots DROP COLUMN alerts_forgotten");
  Execute("DROP TABLE notes");
  Execute("PRAGMA user_version = 3");
  EXPECT_EQ(load(), before);
  undo_newest();
  Execute("ALTER TABLE robots DROP COLUMN bundle");
  Execute("ALTER TABLE robots DROP COLUMN alerts_forgotten");
  Execute("DROP TABLE notes");
  Execute("ALTER TABLE robots DROP COLUMN rules_halted");
  Execute("DROP TABLE bans");
  Execute("PRAGMA user_version = 1");
  EXPECT_EQ(load(), before);
  EXPECT_EQ(load(), before) << "once is enough";
  const auto store = SqliteStore::Open(path_);
  ASSERT_THAT(store, IsOk());
  EXPECT_THAT((*store)->Commit(Decide("r1", {1, 3}, "HALT", "DEFAULT")),
              StatusIs(absl::StatusCode::kAborted))
      << "no owner is known";
  EXPECT_EQ((*store)->Acquire("r1")->tenure, 2u);
}

// The server runs on after a backup, an agent works with it, and the backup is restored.
TEST_F(SqliteStoreTest, ABackupIsToldFromWhatItWasMadeOf) {
  const std::string backup = dir_.File("backup");
  StorePoint before, after;
  {
    auto store = SqliteStore::Open(path_);
    ASSERT_THAT(store, IsOk());
    ASSERT_THAT((*store)->BeginGeneration(std::string(16, 'a')), IsOk());
    ASSERT_THAT((*store)->Acquire("r1"), IsOk());
    ASSERT_THAT((*store)->Commit(Decide("r1", {1, 1}, "DEFAULT", "ALERT")), IsOk());
    before = {.generation = std::string(16, 'a'), .commit = (*store)->newest_commit()};
    Execute(absl::StrCat("VACUUM INTO '", backup, "'"));
    ASSERT_THAT((*store)->Commit(Decide("r1", {1, 2}, "ALERT", "HALT")), IsOk());
    after = {.generation = std::string(16, 'a'), .commit = (*store)->newest_commit()};
  }
  // The same server starts on `file`, and works until it has made as many commits.
  const auto goes_on_from = [&](const std::string& file, const StorePoint& seen) {
    auto store = SqliteStore::Open(file);
    EXPECT_THAT(store, IsOk());
    EXPECT_THAT((*store)->BeginGeneration(NewId().substr(0, 16)), IsOk());
    for (uint64_t i = 1; i <= 4; ++i) {
      WriteBatch alert{.robot = "r1"};
      alert.alerts.push_back(MakeAlert("r1", "later"));
      EXPECT_THAT((*store)->Commit(alert), IsOk());
    }
    return GoesOnFrom(*(*store)->Generations(), (*store)->newest_commit(), seen);
  };
  EXPECT_TRUE(goes_on_from(path_, before));
  EXPECT_TRUE(goes_on_from(path_, after));
  EXPECT_TRUE(goes_on_from(backup, before)) << "it holds what the agent was told";
  EXPECT_FALSE(goes_on_from(backup, after));
  EXPECT_FALSE(goes_on_from(dir_.File("new.db"), after));
}

TEST_F(SqliteStoreTest, NoticesATruncatedFileWhereverItIsCut) {
  MakeHistory();
  const std::uintmax_t size = std::filesystem::file_size(path_);
  std::filesystem::copy_file(path_, path_ + ".whole");
  for (std::uintmax_t cut = 512; cut < size; cut += 512) {
    std::filesystem::copy_file(path_ + ".whole", path_,
                               std::filesystem::copy_options::overwrite_existing);
    std::filesystem::resize_file(path_, cut);
    EXPECT_THAT(SqliteStore::Open(path_), StatusIs(absl::StatusCode::kDataLoss)) << cut;
    EXPECT_EQ(std::filesystem::file_size(path_), cut) << "a damaged file is left as it is";
  }
}

TEST_F(SqliteStoreTest, NeverAnswersWronglyFromAnOverwrittenPage) {
  MakeHistory();
  const std::uintmax_t size = std::filesystem::file_size(path_);
  std::filesystem::copy_file(path_, path_ + ".whole");
  int refused = 0;
  for (std::uintmax_t page = 0; page < size; page += 4'096) {
    std::filesystem::copy_file(path_ + ".whole", path_,
                               std::filesystem::copy_options::overwrite_existing);
    std::fstream file(path_, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(static_cast<std::streamoff>(page));
    file << std::string(4'096, '\xa5');
    file.close();
    const auto store = SqliteStore::Open(path_);
    EXPECT_THAT(store, StatusIs(absl::StatusCode::kDataLoss)) << page;
    refused += store.ok() ? 0 : 1;
  }
  EXPECT_GT(refused, 10);
}

TEST_F(SqliteStoreTest, ForgetsTheOldestAlertsBeyondTheLimit) {
  auto store = SqliteStore::Open(path_, {.alerts_per_robot_max = 3});
  ASSERT_THAT(store, IsOk());
  const std::vector<std::string> robots = {"r1", "quiet", "noisy"};
  ASSERT_THAT((*store)->Acquire(robots), IsOk());
  for (int i = 1; i <= 5; ++i) {
    WriteBatch batch{.robot = "r1", .tenure = 1};
    batch.alerts.push_back(MakeAlert("r1", absl::StrCat(i)));
    ASSERT_THAT((*store)->Commit(batch), IsOk());
  }
  std::vector<std::string> texts;
  const auto alerts = (*store)->ListAlerts("", 0);
  ASSERT_THAT(alerts, IsOk());
  for (const AlertRecord& alert : *alerts) texts.push_back(alert.text);
  EXPECT_THAT(texts, ElementsAre("5", "4", "3"));
}

TEST_F(SqliteStoreTest, AFloodOfSmallAlertsPushesOutNoGraveOnes) {
  auto store = SqliteStore::Open(path_, {.alerts_per_robot_max = 20});
  ASSERT_THAT(store, IsOk());
  const auto write = [&](const std::string& text, const std::string& severity) {
    WriteBatch batch{.robot = "r1"};
    batch.alerts.push_back(MakeAlert("r1", text));
    batch.alerts.back().severity = severity;
    ASSERT_THAT((*store)->Commit(batch), IsOk());
  };
  write("first", "critical");
  write("second", "high");
  write("third", "critical");
  for (int i = 0; i < 200; ++i) write(absl::StrCat(i), "low");
  const auto alerts = *(*store)->ListAlerts("r1", 1'000);
  ASSERT_THAT(alerts, SizeIs(22)) << "two, a tenth, beyond the limit";
  EXPECT_EQ(alerts[20].text, "third");
  EXPECT_EQ(alerts[21].text, "second");
  const auto grave = (*store)->SearchAlerts({.severities = {"critical"}});
  EXPECT_THAT(grave->alerts, SizeIs(1));
  EXPECT_TRUE((*store)->AlertsAfter("r1", 0, 0)->forgotten);
  EXPECT_EQ((*store)->AlertsAfter("r1", 0, 0)->alerts.front().text, "second");
}

TEST_F(SqliteStoreTest, ARobotsAlertsPushOutNoOtherRobots) {
  auto store = SqliteStore::Open(path_, {.alerts_per_robot_max = 3});
  ASSERT_THAT(store, IsOk());
  const std::vector<std::string> robots = {"r1", "quiet", "noisy"};
  ASSERT_THAT((*store)->Acquire(robots), IsOk());
  const auto write = [&](const std::string& robot, const std::string& text) {
    WriteBatch batch{.robot = robot, .tenure = 1};
    batch.alerts.push_back(MakeAlert(robot, text));
    ASSERT_THAT((*store)->Commit(batch), IsOk());
  };
  write("quiet", "the only one");
  for (int i = 0; i < 50; ++i) write("noisy", absl::StrCat(i));

  EXPECT_THAT(*(*store)->ListAlerts("quiet", 0), SizeIs(1));
  EXPECT_THAT(*(*store)->ListAlerts("noisy", 0), SizeIs(3));
  const auto of_quiet = (*store)->AlertsAfter("quiet", 0, 0);
  ASSERT_THAT(of_quiet, IsOk());
  EXPECT_FALSE(of_quiet->forgotten);
  const auto of_all = (*store)->AlertsAfter("", 0, 0);
  ASSERT_THAT(of_all, IsOk());
  EXPECT_TRUE(of_all->forgotten);
  ASSERT_THAT(of_all->alerts, SizeIs(4));
  EXPECT_EQ(of_all->alerts.back().sequence, 51u);
  EXPECT_FALSE((*store)->AlertsAfter("noisy", 48, 0)->forgotten);
  EXPECT_TRUE((*store)->AlertsAfter("noisy", 47, 0)->forgotten);
}

// A small disk of its own, if this process may mount one.
class FullDiskTest : public SqliteStoreTest {
 protected:
  void SetUp() override {
    SqliteStoreTest::SetUp();
    disk_ = dir_.File("disk");
    std::filesystem::create_directory(disk_);
    if (unshare(CLONE_NEWNS) != 0 ||
        mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        mount("tmpfs", disk_.c_str(), "tmpfs", 0, "size=4m") != 0) {
      GTEST_SKIP() << "needs the right to mount a file system";
    }
    path_ = disk_ + "/state.db";
  }
  void TearDown() override {
    umount2(disk_.c_str(), MNT_DETACH);
    SqliteStoreTest::TearDown();
  }
  void FillDisk() {
    std::ofstream filler(disk_ + "/filler", std::ios::app);
    for (const size_t piece : {64 << 10, 4 << 10, 1}) {
      const std::string bytes(piece, 'x');
      while (filler.write(bytes.data(), static_cast<std::streamsize>(piece)).flush()) {
      }
      filler.clear();
    }
  }
  std::string disk_;
};

TEST_F(FullDiskTest, RecordsRaisesAndTermsFromTheReserveAndNothingElse) {
  auto store = SqliteStore::Open(path_, {.reserve_bytes = 2 << 20});
  ASSERT_THAT(store, IsOk());
  ASSERT_THAT((*store)->Acquire("r1"), IsOk());
  ASSERT_THAT((*store)->Commit(Decide("r1", {1, 1}, "", "DEFAULT", "d1")), IsOk());
  FillDisk();
  WriteBatch chatter{.robot = "r1", .tenure = 1};
  for (int i = 0; i < 2'000; ++i) {
    chatter.alerts.push_back(MakeAlert("r1", std::string(200, 'x')));
  }
  ASSERT_THAT((*store)->Commit(chatter), StatusIs(absl::StatusCode::kResourceExhausted));

  for (uint64_t i = 2; i < 12; ++i) {
    WriteBatch raise = Decide("r1", {1, i}, "DEFAULT", "HALT", absl::StrCat("d", i));
    raise.uses_reserve = true;
    ASSERT_THAT((*store)->Commit(raise), IsOk()) << i;
    if (i == 4) FillDisk();  // others take what is given up
  }
  EXPECT_THAT((*store)->NextTerm("r1", 1, 0), IsOk());
  EXPECT_EQ((*store)->Load("r1")->level, "HALT");
  WriteBatch alert{.robot = "r1", .tenure = 1};
  alert.alerts.push_back(MakeAlert("r1", "small"));
  EXPECT_THAT((*store)->Commit(alert), StatusIs(absl::StatusCode::kResourceExhausted))
      << "the reserve is not for others";

  std::filesystem::remove(disk_ + "/filler");
  EXPECT_THAT((*store)->Commit(alert), IsOk());
  EXPECT_EQ(std::filesystem::file_size(path_ + ".reserve"), 2u << 20) << "made again";
  store->reset();
  store = SqliteStore::Open(path_, {.reserve_bytes = 2 << 20});
  ASSERT_THAT(store, IsOk());
  EXPECT_EQ((*store)->Load("r1")->decision_id, (DecisionId{1, 11}));
}

TEST_F(FullDiskTest, OpensOnAFullDiskByItsReserve) {
  auto store = SqliteStore::Open(path_, {.reserve_bytes = 2 << 20});
  ASSERT_THAT(store, IsOk());
  ASSERT_THAT((*store)->Acquire("r1"), IsOk());
  ASSERT_THAT((*store)->Commit(Decide("r1", {1, 1}, "", "HALT", "d1")), IsOk());
  store->reset();
  FillDisk();

  store = SqliteStore::Open(path_, {.reserve_bytes = 2 << 20});

  ASSERT_THAT(store, IsOk());
  EXPECT_THAT((*store)->BeginGeneration(std::string(16, 'g')), IsOk());
  EXPECT_EQ((*store)->Load("r1")->level, "HALT");
  EXPECT_THAT((*store)->Acquire("r1"), IsOk());
}

TEST_F(SqliteStoreTest, RefusesAReserveForOtherThanDecisions) {
  auto store = SqliteStore::Open(path_);
  ASSERT_THAT(store, IsOk());
  WriteBatch batch{.robot = "r1", .tenure = 1, .uses_reserve = true};
  batch.alerts.push_back(MakeAlert("r1", "text"));
  EXPECT_THAT((*store)->Commit(batch), StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST_F(SqliteStoreTest, ForgetsOldRefusalsButNoDecision) {
  auto store = SqliteStore::Open(path_, {.refusals_max = 3});
  ASSERT_THAT(store, IsOk());
  ASSERT_THAT((*store)->Acquire("r1"), IsOk());
  ASSERT_THAT((*store)->Commit(Decide("r1", {1, 1}, "A", "B", "decision")), IsOk());
  for (int i = 1; i <= 5; ++i) {
    WriteBatch batch{.robot = "r1", .tenure = 1};
    batch.refusals.push_back({.id = absl::StrCat("f", i)});
    ASSERT_THAT((*store)->Commit(batch), IsOk());
  }
  std::vector<std::string> ids;
  const auto transitions = (*store)->ListTransitions("r1", 0);
  ASSERT_THAT(transitions, IsOk());
  for (const TransitionRecord& each : *transitions) ids.push_back(each.id);
  EXPECT_THAT(ids, ElementsAre("f5", "f4", "f3", "decision"));
  EXPECT_TRUE((*store)->FindDecision("r1", {1, 1})->has_value());
}

TEST_F(SqliteStoreTest, ABusyFileIsUnavailableAndLaterWorks) {
  auto store = SqliteStore::Open(path_);
  ASSERT_THAT(store, IsOk());
  ASSERT_THAT((*store)->Acquire("r1"), IsOk());
  sqlite3* other = nullptr;
  ASSERT_EQ(sqlite3_open(path_.c_str(), &other), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(other, "BEGIN IMMEDIATE", nullptr, nullptr, nullptr), SQLITE_OK);

  EXPECT_THAT((*store)->Commit(Decide("r1", {1, 1}, "A", "B")),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("locked")));
  EXPECT_THAT((*store)->Load("r1"), IsOkAndHolds(RobotRecord{.highest_term = 1}))
      << "reads do not wait";

  ASSERT_EQ(sqlite3_exec(other, "ROLLBACK", nullptr, nullptr, nullptr), SQLITE_OK);
  sqlite3_close(other);
  EXPECT_THAT((*store)->Commit(Decide("r1", {1, 1}, "A", "B")), IsOk());
}

TEST_F(SqliteStoreTest, ACommitThatTheDiskBreaksOffIsInDoubt) {
  auto store = SqliteStore::Open(path_);
  ASSERT_THAT(store, IsOk());
  ASSERT_THAT((*store)->Acquire("r1"), IsOk());
  // The log cannot grow.
  signal(SIGXFSZ, SIG_IGN);
  rlimit before = {};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  rlimit small = before;
  small.rlim_cur = std::filesystem::file_size(path_ + "-wal");
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  const absl::Status status = (*store)->Commit(Decide("r1", {1, 1}, "DEFAULT", "ALERT"));
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kUnknown, HasSubstr("it is not known whether")));

  EXPECT_THAT((*store)->Commit(Decide("r1", {1, 2}, "DEFAULT", "HALT")), IsOk());
  EXPECT_EQ((*store)->Load("r1")->level, "HALT");
}

// Commits decisions 1, 2, ... through a Committer and writes each number to `out` once its callback
// has been told OK. Does not return.
[[noreturn]] void CommitForEver(const std::string& path, int out) {
  auto store = SqliteStore::Open(path);
  if (!store.ok() || !(*store)->Acquire("r1").ok()) _exit(2);
  Committer committer(store->get());
  for (uint64_t epoch = 1;; ++epoch) {
    WriteBatch batch = Decide("r1", {1, epoch}, "A", absl::StrCat("L", epoch));
    batch.checkpoint.variables = Variables{{"n", static_cast<int64_t>(epoch)}};
    auto done = [out, epoch](const absl::Status& status) {
      if (!status.ok() || write(out, &epoch, sizeof(epoch)) != sizeof(epoch)) _exit(3);
    };
    while (!committer.Submit(batch, done).ok()) std::this_thread::yield();
  }
}

TEST_F(SqliteStoreTest, WhatWasConfirmedSurvivesKill) {
  for (int round = 0; round < 3; ++round) {
    const std::string path = dir_.File(absl::StrCat("round", round, ".db"));
    int ends[2] = {-1, -1};
    ASSERT_EQ(pipe(ends), 0);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      close(ends[0]);
      CommitForEver(path, ends[1]);
    }
    close(ends[1]);
    uint64_t confirmed = 0;
    uint64_t epoch = 0;
    const uint64_t enough = 5 + 40 * static_cast<uint64_t>(round);
    bool killed = false;
    while (read(ends[0], &epoch, sizeof(epoch)) == sizeof(epoch)) {
      EXPECT_EQ(epoch, confirmed + 1) << "callbacks come in order";
      confirmed = epoch;
      if (!killed && confirmed >= enough) {
        kill(child, SIGKILL);
        killed = true;
      }
    }
    close(ends[0]);
    int how = 0;
    ASSERT_EQ(waitpid(child, &how, 0), child);
    ASSERT_TRUE(WIFSIGNALED(how)) << how;

    auto store = SqliteStore::Open(path);
    ASSERT_THAT(store, IsOk());
    auto record = (*store)->Load("r1");
    ASSERT_THAT(record, IsOk());
    EXPECT_GE(record->decision_id.epoch, confirmed);
    EXPECT_EQ(record->level, absl::StrCat("L", record->decision_id.epoch));
    EXPECT_EQ(record->variables,
              (Variables{{"n", static_cast<int64_t>(record->decision_id.epoch)}}))
        << "a batch is all or nothing";
    for (uint64_t i = 1; i <= confirmed; ++i) {
      EXPECT_TRUE((*store)->FindDecision("r1", {1, i})->has_value()) << i;
    }
    EXPECT_GE(confirmed, enough);
  }
}

}  // namespace
}  // namespace rips::store

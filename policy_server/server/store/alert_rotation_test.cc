// Rotation of the alert file by size, on a real file system.
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/alert_log.h"
#include "policy_server/server/store/store_test_data.h"

namespace rips::store {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// Each line of these tests has so many bytes.
const size_t kLineBytes = FormatAlertLine(MakeAlert("r1", "n00")).size() + 1;

class AlertRotationTest : public testing::Test {
 protected:
  // Rotates after `lines` lines.
  std::unique_ptr<AlertLog> Open(size_t lines, int keep, RenameFile rename_file = nullptr) {
    auto log = AlertLog::Open(path_, {.rotate_bytes = lines * kLineBytes,
                                      .keep = keep,
                                      .on_rotation_failure = [this] { ++failures_; },
                                      .rename_file = std::move(rename_file)});
    EXPECT_THAT(log, IsOk());
    return log.ok() ? *std::move(log) : nullptr;
  }
  // n`first` and so on, in one call; how many were written.
  static absl::StatusOr<size_t> Append(AlertLog& log, int first, int count = 1) {
    std::vector<AlertRecord> alerts;
    for (int i = first; i < first + count; ++i) {
      alerts.push_back(MakeAlert("r1", absl::StrCat("n", i / 10, i % 10)));
    }
    return log.Append(alerts);
  }
  // The texts of FILE.`number`, `?` for a line that is not whole; FILE itself is 0.
  std::vector<std::string> Texts(int number) const {
    std::ifstream in(RotatedName(path_, number), std::ios::binary);
    const std::string all(std::istreambuf_iterator<char>(in), {});
    std::vector<std::string> texts;
    for (absl::string_view line : absl::StrSplit(all, '\n', absl::SkipEmpty())) {
      const auto alert = nlohmann::json::parse(line, nullptr, /*allow_exceptions=*/false);
      texts.push_back(alert.is_object() ? alert.value("text", "?") : "?");
    }
    return texts;
  }
  // Of all files, the oldest first.
  std::vector<std::string> AllTexts(int keep) const {
    std::vector<std::string> all;
    for (int number = keep; number >= 0; --number) {
      for (std::string& text : Texts(number)) all.push_back(std::move(text));
    }
    return all;
  }
  bool Exists(int number) const {
    return std::filesystem::exists(std::filesystem::symlink_status(RotatedName(path_, number)));
  }

  const TempDir dir_;
  const std::string path_ = dir_.File("alerts.jsonl");
  int failures_ = 0;
};

TEST_F(AlertRotationTest, MovesAFullFileAndKeepsSoMany) {
  const auto log = Open(2, 2);
  for (int i = 0; i < 7; ++i) EXPECT_THAT(Append(*log, i), IsOkAndHolds(1u));

  EXPECT_THAT(Texts(0), ElementsAre("n06"));
  EXPECT_THAT(Texts(1), ElementsAre("n04", "n05"));
  EXPECT_THAT(Texts(2), ElementsAre("n02", "n03"));
  EXPECT_FALSE(Exists(3));
  EXPECT_EQ(failures_, 0);
  struct stat info = {};
  ASSERT_EQ(stat(path_.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 07777 & ~0640u, 0u);
}

TEST_F(AlertRotationTest, SplitsManyAlertsBetweenLinesOnly) {
  const auto log = Open(3, 9);
  EXPECT_THAT(Append(*log, 0, 20), IsOkAndHolds(20u));
  EXPECT_THAT(Texts(0), ElementsAre("n18", "n19"));
  for (int number = 1; number <= 6; ++number) {
    EXPECT_EQ(std::filesystem::file_size(RotatedName(path_, number)), 3 * kLineBytes);
  }
  EXPECT_EQ(AllTexts(9).size(), 20u);
}

TEST_F(AlertRotationTest, FillsAFileToTheLastByte) {
  const auto log = Open(2, 1);
  ASSERT_THAT(Append(*log, 0, 2), IsOk());
  EXPECT_FALSE(Exists(1)) << "just as long as allowed";
  ASSERT_THAT(Append(*log, 2), IsOk());
  EXPECT_THAT(Texts(1), ElementsAre("n00", "n01"));
}

TEST_F(AlertRotationTest, ALineThatIsTooLongHasAFileOfItsOwn) {
  const auto log = Open(1, 5);
  const AlertRecord alerts[] = {MakeAlert("r1", "n00"), MakeAlert("r1", std::string(5000, 'x')),
                                MakeAlert("r1", "n02")};
  EXPECT_THAT(log->Append(alerts), IsOkAndHolds(3u));
  EXPECT_THAT(AllTexts(5), ElementsAre("n00", std::string(5000, 'x'), "n02"));
  EXPECT_THAT(Texts(1), ElementsAre(std::string(5000, 'x')));
}

TEST_F(AlertRotationTest, IsOffUnlessAskedFor) {
  const auto log = AlertLog::Open(path_);
  ASSERT_THAT(log, IsOk());
  EXPECT_THAT(Append(**log, 0, 99), IsOkAndHolds(99u));
  EXPECT_FALSE(Exists(1));
}

TEST_F(AlertRotationTest, RotatesWhatAnEarlierRunLeft) {
  ASSERT_THAT(Append(*Open(9, 2), 0, 9), IsOk());
  const auto log = Open(3, 2);
  ASSERT_THAT(Append(*log, 9), IsOk());
  EXPECT_EQ(Texts(1).size(), 9u);
  EXPECT_THAT(Texts(0), ElementsAre("n09"));
}

TEST_F(AlertRotationTest, ADirectoryInTheWayIsSaidAndTheFileGrows) {
  std::filesystem::create_directory(RotatedName(path_, 2));
  std::ofstream(RotatedName(path_, 1)) << "older\n";
  const auto log = Open(2, 3);
  testing::internal::CaptureStderr();
  for (int i = 0; i < 5; ++i) EXPECT_THAT(Append(*log, i), IsOkAndHolds(1u));
  EXPECT_THAT(Append(*log, 5, 3), IsOkAndHolds(3u));
  const std::string said = testing::internal::GetCapturedStderr();

  EXPECT_EQ(Texts(0).size(), 8u);
  EXPECT_THAT(Texts(1), ElementsAre("?")) << "nothing has moved";
  EXPECT_EQ(failures_, 4);
  EXPECT_THAT(said, HasSubstr(absl::StrCat(path_, ".2` is in the way")));
  EXPECT_EQ(said.find("cannot rotate"), said.rfind("cannot rotate")) << said;

  std::filesystem::remove(RotatedName(path_, 2));
  EXPECT_THAT(Append(*log, 8), IsOkAndHolds(1u));
  EXPECT_THAT(Texts(0), ElementsAre("n08"));
  EXPECT_EQ(Texts(1).size(), 8u);
  EXPECT_THAT(Texts(2), ElementsAre("?"));
  EXPECT_EQ(failures_, 4);
}

TEST_F(AlertRotationTest, FollowsNoLink) {
  const std::string victim = dir_.File("victim");
  std::ofstream(victim) << "precious\n";
  std::filesystem::create_symlink(victim, RotatedName(path_, 1));
  const auto log = Open(1, 1);
  ASSERT_THAT(Append(*log, 0, 3), IsOkAndHolds(3u));
  EXPECT_EQ(Texts(0).size(), 3u);
  EXPECT_TRUE(std::filesystem::is_symlink(RotatedName(path_, 1)));
  EXPECT_EQ(std::filesystem::file_size(victim), 9u);

  std::filesystem::rename(RotatedName(path_, 1), path_);
  EXPECT_THAT(AlertLog::Open(path_, {.rotate_bytes = 1000}),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("is a symbolic link")));
  EXPECT_THAT(log->Append({}), IsOkAndHolds(0u));
  EXPECT_THAT(Append(*log, 3), StatusIs(absl::StatusCode::kUnavailable));
  EXPECT_EQ(std::filesystem::file_size(victim), 9u);
}

TEST_F(AlertRotationTest, AFailedRenameLosesNothing) {
  // The third rename fails, when all numbers are taken: of FILE.1 to FILE.2.
  int renames = 0;
  bool fail = false;
  const auto log = Open(1, 3, [&](const char* from, const char* to) {
    if (fail && ++renames == 2) {
      errno = EIO;
      return -1;
    }
    return rename(from, to);
  });
  ASSERT_THAT(Append(*log, 0, 4), IsOk());
  fail = true;
  EXPECT_THAT(Append(*log, 4), IsOkAndHolds(1u));
  EXPECT_EQ(failures_, 1);
  // FILE.3 had its time; all others are there.
  EXPECT_THAT(AllTexts(3), ElementsAre("n01", "n02", "n03", "n04"));
  fail = false;
  EXPECT_THAT(Append(*log, 5), IsOkAndHolds(1u));
  EXPECT_THAT(AllTexts(3), ElementsAre("n01", "n02", "n03", "n04", "n05"));
}

TEST_F(AlertRotationTest, AProcessThatIsKilledBetweenRenamesLosesNothing) {
  // Four renames with all numbers taken; the process ends before each of them, and after the last.
  for (int stop = 0; stop <= 4; ++stop) {
    for (int number = 0; number <= 4; ++number) {
      std::filesystem::remove(RotatedName(path_, number));
    }
    ASSERT_THAT(Append(*Open(1, 4), 0, 5), IsOk());
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      int renames = 0;
      const auto log = Open(1, 4, [&](const char* from, const char* to) {
        if (renames == stop) _exit(9);
        const int done = rename(from, to);
        if (++renames == 4) _exit(9);
        return done;
      });
      Append(*log, 5).status().IgnoreError();
      _exit(0);
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_EQ(WEXITSTATUS(status), 9);

    const auto log = Open(1, 4);
    EXPECT_THAT(log->LastId(), IsOk());
    ASSERT_THAT(Append(*log, 5), IsOk());
    EXPECT_THAT(AllTexts(4), ElementsAre("n01", "n02", "n03", "n04", "n05")) << stop;
  }
}

TEST_F(AlertRotationTest, KnowsTheLastAlertWhenTheFileIsNew) {
  const auto log = Open(1, 2);
  const AlertRecord last = MakeAlert("r1", "n00");
  ASSERT_THAT(log->Append({&last, 1}), IsOk());
  // As a process that was killed between the rename and the first line.
  std::filesystem::rename(path_, RotatedName(path_, 1));
  EXPECT_EQ(*Open(1, 2)->LastId(), last.id);
  EXPECT_EQ(*(*AlertLog::Open(path_))->LastId(), "") << "what logrotate leaves is not looked at";
  for (const bool pipe : {false, true}) {
    std::filesystem::remove(RotatedName(path_, 1));
    if (pipe) {
      ASSERT_EQ(mkfifo(RotatedName(path_, 1).c_str(), 0600), 0);
    } else {
      std::filesystem::create_symlink("/etc/passwd", RotatedName(path_, 1));
    }
    EXPECT_EQ(*Open(1, 2)->LastId(), "");
  }
}

TEST_F(AlertRotationTest, SaysHowManyWereWrittenWhenTheNextFileCannotBe) {
  // In the place of the new file there is a directory, at once.
  const auto log = Open(2, 2, [&](const char* from, const char* to) {
    const int done = rename(from, to);
    std::filesystem::create_directory(from);
    return done;
  });
  EXPECT_THAT(Append(*log, 0, 5), IsOkAndHolds(2u));
  EXPECT_THAT(Append(*log, 2, 3), StatusIs(absl::StatusCode::kUnavailable));
  std::filesystem::remove(path_);
  EXPECT_THAT(Append(*log, 2, 2), IsOkAndHolds(2u));
  EXPECT_THAT(AllTexts(2), ElementsAre("n00", "n01", "n02", "n03"));
}

}  // namespace
}  // namespace rips::store

#include "policy_server/policy/recording/reader.h"

#include <sys/stat.h>

#include "policy_server/policy/recording/input_file.h"
#include "policy_server/policy/recording/recording_test_data.h"

namespace rips::recording {
namespace {

using ::testing::HasSubstr;

class ReaderTest : public testing::Test {
 protected:
  const TempFolder folder_;
};

TEST_F(ReaderTest, RefusesWhatIsNoFile) {
  EXPECT_THAT(Open(folder_.File("none")), StatusIs(absl::StatusCode::kNotFound, HasSubstr("none")));
  EXPECT_THAT(Open(""), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(OpenFile(folder_.path()), StatusIs(absl::StatusCode::kFailedPrecondition));
  ASSERT_EQ(mkfifo(folder_.File("fifo").c_str(), 0600), 0);
  EXPECT_THAT(Open(folder_.File("fifo")),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("not a regular file")));
}

TEST_F(ReaderTest, RefusesAnEmptyFile) {
  EXPECT_THAT(
      Open(folder_.Write("empty", "")),
      StatusIs(absl::StatusCode::kDataLoss, HasSubstr("empty`: byte 0: the file is empty")));
}

TEST_F(ReaderTest, ContentDecidesNotTheName) {
  const std::string mcap = absl::StrCat(McapHeader(), McapDataEnd(), McapFooter());
  EXPECT_THAT(ReadAll(folder_.Write("a.db3", mcap)).status, IsOk());
  EXPECT_THAT(ReadAll(folder_.Write("a.mcap", "event: a\n")).status, IsOk());
}

TEST_F(ReaderTest, AWrongMagicIsNoRecording) {
  for (const char* magic :
       {"\x89MCAP1\r\n", "\x89RIPS\x02\r\n", "\x89RIPS\x01\n", "SQLite format 4",
        "\x7f"
        "ELF",
        "PK\3\4"}) {
    const std::string bytes = absl::StrCat(magic, std::string(100, '\0'), "\n");
    EXPECT_FALSE(ReadAll(folder_.Write("file", bytes)).status.ok()) << magic;
  }
}

TEST_F(ReaderTest, AFileThatBecomesShorterIsAnError) {
  std::string text;
  while (text.size() < 200'000) text += "event: a\n---\n";
  const std::string path = folder_.Write("events", text);
  const auto reader = Open(path);
  ASSERT_THAT(reader, IsOk());
  ASSERT_THAT((*reader)->Next(), IsOk());
  std::filesystem::resize_file(path, 70'000);
  absl::Status status;
  while (status.ok()) {
    const auto event = (*reader)->Next();
    status = event.status();
    ASSERT_TRUE(!event.ok() || *event) << "the end was given";
  }
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kDataLoss, HasSubstr("became shorter")));
}

TEST(InputFileTest, ReadsAcrossItsBuffer) {
  const TempFolder folder;
  std::string bytes;
  for (int i = 0; bytes.size() < 200'000; ++i) absl::StrAppend(&bytes, i, "\n");
  const auto file = InputFile::Open(folder.Write("file", bytes));
  ASSERT_THAT(file, IsOk());
  std::string all;
  std::string part;
  for (const uint64_t count : {0, 1, 65'535, 1, 70'000}) {
    ASSERT_THAT((*file)->Read(count, &part), IsOk());
    all += part;
  }
  while (true) {
    const auto more = (*file)->ReadLine(100, &part);
    ASSERT_THAT(more, IsOk());
    if (!*more) break;
    all += part;
  }
  EXPECT_EQ(all, bytes);
  EXPECT_EQ((*file)->remaining(), 0u);
  EXPECT_THAT((*file)->Read(1, &part), StatusIs(absl::StatusCode::kDataLoss));
  (*file)->Rewind();
  EXPECT_THAT((*file)->ReadLine(1, &part), StatusIs(absl::StatusCode::kResourceExhausted));
}

}  // namespace
}  // namespace rips::recording

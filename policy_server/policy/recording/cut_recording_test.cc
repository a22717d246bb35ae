// Recordings that a power failure, a full disk or a copy has cut, or that are still being written:
// every whole message is given, and the end is named.
#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>

#include "policy_server/policy/recording/bag_folder.h"
#include "policy_server/policy/recording/recording_test_data.h"

namespace rips::recording {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::ElementsAreArray;
using ::testing::HasSubstr;
using ::testing::SizeIs;

constexpr auto kDataLoss = absl::StatusCode::kDataLoss;
constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;

std::string Zstd(absl::string_view bytes) {
  std::string out(ZSTD_compressBound(bytes.size()), '\0');
  out.resize(ZSTD_compress(out.data(), out.size(), bytes.data(), bytes.size(), 1));
  return out;
}
std::string Lz4(absl::string_view bytes) {
  std::string out(LZ4F_compressFrameBound(bytes.size(), nullptr), '\0');
  out.resize(LZ4F_compressFrame(out.data(), out.size(), bytes.data(), bytes.size(), nullptr));
  return out;
}
std::string Chunk(absl::string_view compression, absl::string_view records) {
  const std::string stored = compression == "zstd"  ? Zstd(records)
                             : compression == "lz4" ? Lz4(records)
                                                    : std::string(records);
  return McapChunk(compression, stored, records.size(), Crc32(0, records));
}
std::string Definitions() {
  return McapSchema(1, "std_msgs/msg/String") + McapChannel(1, 1, "/chatter");
}
// Of one message each, at these times; without an end.
std::string Chunks(const std::vector<uint64_t>& times) {
  std::string file = McapHeader();
  for (const uint64_t time : times) {
    file += Chunk("zstd", Definitions() + McapMessage(1, time, absl::StrCat(time)));
  }
  return file;
}
std::string Whole(absl::string_view data) {
  return absl::StrCat(data, McapDataEnd(), McapFooter());
}

std::vector<std::string> Payloads(const Reading& reading) {
  std::vector<std::string> payloads;
  for (const Recorded& event : reading.events) payloads.push_back(MessageOf(event).payload);
  return payloads;
}
// What is missing before each event; as many as there are events.
std::vector<std::string> Missing(const Reading& reading) {
  std::vector<std::string> texts;
  for (const Recorded& event : reading.events) texts.push_back(event.missing_before);
  return texts;
}

class CutRecordingTest : public testing::Test {
 protected:
  CutRecordingTest() { setenv("TMPDIR", temporary_.path().c_str(), /*overwrite=*/1); }
  ~CutRecordingTest() override {
    unsetenv("TMPDIR");
    EXPECT_TRUE(fs::is_empty(temporary_.path())) << "a copy is left";
  }
  Reading Read(absl::string_view bytes) { return ReadAll(folder_.Write("bag.mcap", bytes)); }

  const TempFolder folder_;
  const TempFolder temporary_;
};

// --- MCAP

TEST_F(CutRecordingTest, McapGivesEachMessageOnceItIsWhole) {
  std::string file = McapHeader();
  // Where each message ends, unless only the end of a compressed chunk shows it.
  std::vector<size_t> ends;
  const auto plain_chunk = [&](const std::vector<std::string>& messages) {
    std::string records = ends.empty() ? Definitions() : "";
    std::vector<size_t> in_chunk;
    for (const std::string& message : messages) {
      records += message;
      in_chunk.push_back(records.size());
    }
    file += Chunk("", records);
    for (const size_t end : in_chunk) ends.push_back(file.size() - records.size() + end);
  };
  plain_chunk({McapMessage(1, 10, "one"), McapMessage(1, 20, ""), McapMessage(1, 30, "three")});
  file += McapMessage(1, 40, "outside of chunks");
  ends.push_back(file.size());
  for (const char* compression : {"zstd", "lz4"}) {
    file += Chunk(compression, McapMessage(1, 50, "five") + McapMessage(1, 60, "six"));
    ends.insert(ends.end(), 2, file.size());
  }
  plain_chunk({McapMessage(1, 70, "seven")});
  file = Whole(file);
  const std::vector<std::string> all = Print(Read(file).events);
  ASSERT_THAT(all, SizeIs(ends.size()));

  ExpectCutsAreSeen(file);
  for (size_t cut = 0; cut < file.size(); ++cut) {
    const Reading part = Read(file.substr(0, cut));
    const auto whole = static_cast<size_t>(
        std::count_if(ends.begin(), ends.end(), [&](size_t end) { return end <= cut; }));
    ASSERT_GE(part.events.size(), whole) << "cut at " << cut;
    if (cut >= kMcapMagic.size()) {
      ASSERT_THAT(part.status, StatusIs(kDataLoss, HasSubstr("bag.mcap`: byte "))) << cut;
    }
  }
}

TEST_F(CutRecordingTest, McapWithoutFooterNamesItsEnd) {
  const std::string cut = Chunks({10, 20});
  EXPECT_THAT(Read(cut).status,
              StatusIs(kDataLoss, HasSubstr(absl::StrCat("bag.mcap`: byte ", cut.size(),
                                                         ": the file ends without a footer"))));
  EXPECT_THAT(Payloads(Read(cut)), ElementsAre("10", "20"));
}

// As file systems leave a file whose last blocks were not written.
TEST_F(CutRecordingTest, McapThatEndsInZerosGivesWhatIsBeforeThem) {
  const Reading reading = Read(Chunks({10, 20}) + std::string(5'000, '\0'));
  EXPECT_THAT(Payloads(reading), ElementsAre("10", "20"));
  EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("kind 0")));

  const std::string records = Definitions() + McapMessage(1, 1, "a") + McapMessage(1, 2, "b");
  std::string chunk = Chunk("", records);
  chunk.resize(chunk.size() - 20);  // into `b`
  const Reading zeros = Read(McapHeader() + chunk + std::string(10, '\0'));
  EXPECT_THAT(Payloads(zeros), ElementsAre("a"));
}

TEST_F(CutRecordingTest, McapStopsAtADamagedChunk) {
  const std::string records = Definitions() + McapMessage(1, 15, "rotten");
  const std::string before = Chunks({10});
  const Reading reading = Read(Whole(before + McapChunk("", records, records.size(), 77) +
                                     Chunk("", McapMessage(1, 20, "behind"))));
  EXPECT_THAT(Payloads(reading), ElementsAre("10"));
  EXPECT_THAT(
      reading.status,
      StatusIs(kDataLoss, HasSubstr(absl::StrCat("byte ", before.size(), ": the checksum"))));
}

TEST_F(CutRecordingTest, McapThatGrowsIsReadAsItWas) {
  const std::string path = folder_.Write("bag.mcap", Chunks({10}));
  const auto reader = Open(path);
  ASSERT_THAT(reader, IsOk());
  folder_.Write("bag.mcap", Whole(Chunks({10, 20})));
  ASSERT_THAT((*reader)->Next(), IsOk());
  EXPECT_THAT((*reader)->Next(), StatusIs(kDataLoss, HasSubstr("or is still being written")));
  EXPECT_THAT(ReadAll(path).status, IsOk());
}

TEST_F(CutRecordingTest, ADeclaredSizeTakesNoRoom) {
  // A chunk that says of itself that it holds much, in a file that does not.
  for (const uint64_t size : {uint64_t{1} << 28, uint64_t{1} << 40, UINT64_MAX}) {
    const std::string record =
        absl::StrCat(Number(6, 1), Number(uint64_t{1} << 27, 8), Number(0, 16), Number(size, 8),
                     Number(0, 4), Text("zstd"), Number(1 << 20, 8), Zstd(Definitions()));
    EXPECT_THAT(Read(Chunks({10}) + record).status,
                StatusIs(kDataLoss, HasSubstr("cut within a chunk")));
  }
}

TEST_F(CutRecordingTest, CompressedFilesAreRefusedWithTheCommand) {
  const std::pair<std::string, const char*> cases[] = {
      {Zstd("x"), "zstd -dc FILE > RESULT"},
      {Lz4("x"), "lz4 -dc FILE > RESULT"},
      {std::string("\x1f\x8b\x08"), "gzip -dc FILE > RESULT"}};
  for (const auto& [bytes, command] : cases) {
    EXPECT_THAT(Read(bytes).status, StatusIs(kInvalid, HasSubstr(command)));
  }
  EXPECT_THAT(Read(Whole(McapHeader() + Definitions() + McapMessage(1, 1, Zstd("x")))).status,
              StatusIs(kInvalid, HasSubstr("a message is compressed; `ros2 bag convert`")));
}

// --- Directories

TEST_F(CutRecordingTest, ADirectoryWithoutMetadataGivesItsFilesInOrder) {
  std::vector<std::string> expected;
  for (uint64_t i = 0; i < 12; ++i) {
    folder_.Write(absl::StrCat("bag_", i, ".mcap"),
                  i < 11 ? Whole(Chunks({i + 100})) : Chunks({i + 100}));
    expected.push_back(absl::StrCat(i + 100));
  }
  folder_.Write("notes.txt", "not a file of the bag");
  fs::create_directory(folder_.File("dir.mcap"));

  const Reading reading = ReadAll(folder_.path());

  EXPECT_THAT(Payloads(reading), ElementsAreArray(expected));
  EXPECT_THAT(reading.status, StatusIs(kDataLoss, AllOf(HasSubstr("bag_11.mcap`: byte "),
                                                        HasSubstr("ends without a footer"),
                                                        HasSubstr("has no metadata.yaml"))));
  EXPECT_THAT(Missing(reading), ElementsAreArray(std::vector<std::string>(12)));
}

class CutBagTest : public CutRecordingTest {
 protected:
  void WriteMetadata(absl::string_view files, absl::string_view more = "") {
    folder_.Write("metadata.yaml", absl::StrCat("rosbag2_bagfile_information:\n  version: 5\n"
                                                "  relative_file_paths: ",
                                                files, "\n", more));
  }
  void WriteFile(absl::string_view name, uint64_t time) {
    folder_.Write(name, Whole(Chunks({time})));
  }
};

TEST_F(CutBagTest, FilesThatAreMissingAreNamedInTheirPlace) {
  WriteFile("bag_0.mcap", 10);
  WriteFile("bag_2.mcap", 30);
  WriteMetadata("[bag_0.mcap, bag_1.mcap, bag_2.mcap, bag_3.mcap]");

  const Reading reading = ReadAll(folder_.path());

  EXPECT_THAT(Payloads(reading), ElementsAre("10", "30"));
  EXPECT_THAT(Missing(reading),
              ElementsAre("", HasSubstr("bag_1.mcap`, which metadata.yaml names, is not there")));
  EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("bag_3.mcap`, which")));
}

TEST_F(CutBagTest, FilesThatTheMetadataLacksAreReadInTheirPlaceAndNamed) {
  WriteFile("bag_0.mcap", 10);
  WriteFile("bag_1.mcap", 20);
  WriteFile("bag_10.mcap", 40);
  WriteFile("bag_2.mcap", 30);
  WriteMetadata("[bag_0.mcap, bag_2.mcap]");
  Reading reading = ReadAll(folder_.path());
  EXPECT_THAT(Payloads(reading), ElementsAre("10", "20", "30", "40"));
  EXPECT_THAT(reading.status,
              StatusIs(kDataLoss, AllOf(HasSubstr("bag_1.mcap` is read, but metadata.yaml does"),
                                        HasSubstr("bag_10.mcap` is read, but"))));
  // An order of its own is kept; the others follow.
  WriteMetadata("[bag_2.mcap, bag_0.mcap]");
  reading = ReadAll(folder_.path());
  EXPECT_THAT(Payloads(reading), ElementsAre("30", "10", "20", "40"));
}

TEST_F(CutBagTest, AFileThatIsCutDamagedOrEmptyHidesNoneBehindIt) {
  folder_.Write("bag_0.mcap", "");
  folder_.Write("bag_1.mcap", Chunks({10}));
  WriteFile("bag_2.mcap", 20);
  folder_.Write("bag_3.mcap", McapHeader().substr(0, 12));
  WriteMetadata("[bag_0.mcap, bag_1.mcap, bag_2.mcap, bag_3.mcap]");

  const Reading reading = ReadAll(folder_.path());

  EXPECT_THAT(Payloads(reading), ElementsAre("10", "20"));
  EXPECT_THAT(Missing(reading),
              ElementsAre(HasSubstr("bag_0.mcap`: byte 0: the file is empty"),
                          AllOf(HasSubstr("bag_1.mcap`: byte "), HasSubstr("without a footer"))));
  EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("bag_3.mcap`: byte 8: the file is")));
}

TEST_F(CutBagTest, UnusableMetadataIsNamedAndTheFilesAreRead) {
  WriteFile("bag_0.mcap", 10);
  for (const char* metadata :
       {"", "{{{", "other: 1\n", "rosbag2_bagfile_information:\n  version: 5\n", "\0\0\0\0"}) {
    folder_.Write("metadata.yaml", metadata);
    const Reading reading = ReadAll(folder_.path());
    EXPECT_THAT(Payloads(reading), ElementsAre("10")) << metadata;
    EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("metadata.yaml`: "))) << metadata;
  }
}

TEST_F(CutBagTest, CompressedFilesAreReadOnceTheyAreDecompressed) {
  const std::string whole = Whole(Chunks({10}));
  folder_.Write("bag_0.mcap.zstd", Zstd(whole));
  WriteMetadata("[bag_0.mcap.zstd]", "  compression_format: zstd\n  compression_mode: FILE\n");
  EXPECT_THAT(ReadAll(folder_.path()).status,
              StatusIs(kInvalid, AllOf(HasSubstr("bag_0.mcap.zstd` is compressed"),
                                       HasSubstr("zstd -dc FILE > FILE_WITHOUT_ENDING"))));
  // As that command does.
  folder_.Write("bag_0.mcap", whole);
  Reading reading = ReadAll(folder_.path());
  EXPECT_THAT(Payloads(reading), ElementsAre("10"));
  EXPECT_THAT(reading.status, IsOk());

  // rosbag2 compresses a file when it begins the next one.
  fs::remove(folder_.File("bag_0.mcap"));
  fs::remove(folder_.File("metadata.yaml"));
  folder_.Write("bag_1.mcap", Chunks({20}));
  reading = ReadAll(folder_.path());
  EXPECT_THAT(Payloads(reading), ElementsAre("20"));
  EXPECT_THAT(Missing(reading), ElementsAre(HasSubstr("bag_0.mcap.zstd` is compressed")));

  WriteMetadata("[bag_1.mcap]", "  compression_format: zstd\n  compression_mode: MESSAGE\n");
  EXPECT_THAT(ReadAll(folder_.path()).status,
              StatusIs(kInvalid, HasSubstr("each message of the bag is compressed")));
}

TEST_F(CutBagTest, PathsMayBeginWithTheDirectory) {
  WriteFile("bag_0.mcap", 10);
  WriteMetadata("[bag/bag_0.mcap]");
  const Reading reading = ReadAll(folder_.path());
  EXPECT_THAT(Payloads(reading), ElementsAre("10"));
  EXPECT_THAT(reading.status, IsOk());
}

TEST_F(CutBagTest, ManyMissingFilesAreCounted) {
  WriteFile("bag.mcap", 10);
  std::string files = "[";
  for (int i = 0; i < 100; ++i) absl::StrAppend(&files, "f", i, ".mcap,");
  WriteMetadata(files + "bag.mcap]");
  const Reading reading = ReadAll(folder_.path());
  EXPECT_THAT(Missing(reading), ElementsAre(AllOf(HasSubstr("f9.mcap"), HasSubstr("and 90 more"))));
  EXPECT_THAT(reading.status, IsOk());
}

TEST_F(CutBagTest, ADirectoryOfTooManyFilesIsRefused) {
  for (size_t i = 0; i <= kBagFilesMax; ++i) {
    fs::create_symlink("nothing", folder_.File(absl::StrCat(i)));
  }
  EXPECT_THAT(Open(folder_.path()),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("limit of 10000")));
}

// --- SQLite

constexpr char kTables[] =
    "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,"
    "serialization_format TEXT NOT NULL);"
    "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,"
    "timestamp INTEGER NOT NULL, data BLOB);"
    "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
    "INSERT INTO topics VALUES(1,'/chatter','std_msgs/msg/String','cdr')";

// Messages [begin, end), of `bytes` bytes.
std::string Insert(int begin, int end, int bytes) {
  return absl::StrCat("WITH RECURSIVE n(i) AS (SELECT ", begin, " UNION ALL SELECT i+1 FROM n ",
                      "WHERE i<", end - 1, ") INSERT INTO messages SELECT i,1,i*10,randomblob(",
                      bytes, ") FROM n");
}

class CutSqliteTest : public CutRecordingTest {
 protected:
  ~CutSqliteTest() override { sqlite3_close(database_); }
  // A writer that keeps its file `live.db3` open.
  void Do(const std::string& statement) {
    if (database_ == nullptr) {
      ASSERT_EQ(sqlite3_open(folder_.File("live.db3").c_str(), &database_), SQLITE_OK);
    }
    ASSERT_EQ(sqlite3_exec(database_, statement.c_str(), nullptr, nullptr, nullptr), SQLITE_OK)
        << sqlite3_errmsg(database_) << "\n"
        << statement;
  }
  // What a power failure leaves now, as `bag.db3`.
  void PowerFails(const std::string& beside) {
    for (const std::string& suffix : {std::string(), beside}) {
      fs::copy_file(folder_.File(absl::StrCat("live.db3", suffix)),
                    folder_.File(absl::StrCat("bag.db3", suffix)),
                    fs::copy_options::overwrite_existing);
    }
  }
  std::string BagBytes(const std::string& suffix = "") {
    return ReadBytes(folder_.File(absl::StrCat("bag.db3", suffix)));
  }

  sqlite3* database_ = nullptr;
};

TEST_F(CutSqliteTest, EveryCutGivesTheRowsThatAreWhole) {
  const std::string path = folder_.File("whole.db3");
  MakeSqlite(path, {"PRAGMA page_size=512", kTables, Insert(1, 40, 60), Insert(40, 50, 900)});
  const std::string bytes = ReadBytes(path);
  ASSERT_GT(bytes.size(), 20 * 512u);
  // What is between two ends of pages is not read: see bag_copy.h.
  ExpectCutsAreSeen(
      bytes, [](size_t) { return false; }, /*step=*/128);

  std::vector<size_t> counts;
  for (size_t pages = bytes.size() / 512 - 1; pages > 4; --pages) {
    for (const int more : {0, 1, 511}) {
      const Reading reading =
          ReadAll(folder_.Write("bag.db3", bytes.substr(0, pages * 512 + more)));
      EXPECT_THAT(reading.status,
                  StatusIs(kDataLoss, HasSubstr(absl::StrCat("bag.db3`: byte ", pages * 512 + more,
                                                             ": the file is cut"))));
      counts.push_back(reading.events.size());
    }
  }
  EXPECT_GT(counts.front(), 40u);
  EXPECT_THAT(counts, testing::Contains(AllOf(testing::Gt(5u), testing::Lt(20u))));
  EXPECT_THAT(ReadAll(folder_.Write("bag.db3", bytes.substr(0, 300))).status,
              StatusIs(kDataLoss, HasSubstr("byte 300: the file is cut")));
}

TEST_F(CutSqliteTest, AWriteAheadLogIsReadAndNothingIsWritten) {
  Do("PRAGMA journal_mode=WAL; PRAGMA wal_autocheckpoint=0");
  Do(kTables);
  Do(Insert(1, 50, 100));
  Do("BEGIN");
  Do(Insert(50, 60, 100));  // never committed
  PowerFails("-wal");
  const std::string file = BagBytes();
  const std::string log = BagBytes("-wal");
  const Reading reading = ReadAll(folder_.File("bag.db3"));

  EXPECT_THAT(reading.events, SizeIs(49));
  EXPECT_THAT(reading.status,
              StatusIs(kDataLoss, AllOf(HasSubstr("bag.db3`: the file was not closed"),
                                        HasSubstr("bag.db3-wal` is there, and was read too"))));
  EXPECT_EQ(BagBytes(), file);
  EXPECT_EQ(BagBytes("-wal"), log);
  EXPECT_FALSE(fs::exists(folder_.File("bag.db3-shm")));
}

TEST_F(CutSqliteTest, AWriteAheadLogThatIsCutGivesTheTransactionsBeforeThat) {
  Do("PRAGMA page_size=512; PRAGMA journal_mode=WAL; PRAGMA wal_autocheckpoint=0");
  Do(kTables);
  for (int i = 1; i < 20; ++i) Do(Insert(i, i + 1, 100));
  PowerFails("-wal");
  const std::string log = BagBytes("-wal");
  size_t before = 0;
  for (size_t cut = 0; cut < log.size(); cut += 199) {
    folder_.Write("bag.db3-wal", log.substr(0, cut));
    const Reading reading = ReadAll(folder_.File("bag.db3"));
    EXPECT_FALSE(reading.status.ok() && cut > 0) << cut;
    EXPECT_GE(reading.events.size(), before) << cut;
    before = reading.events.size();
  }
  EXPECT_GE(before, 17u);
  // Damaged where it is not the end.
  std::string rotten = log;
  rotten[log.size() / 2] ^= 1;
  folder_.Write("bag.db3-wal", rotten);
  EXPECT_LT(ReadAll(folder_.File("bag.db3")).events.size(), before);
}

TEST_F(CutSqliteTest, ATransactionThatWasUnderWayIsRolledBack) {
  Do("PRAGMA page_size=512; PRAGMA cache_size=1");
  Do(kTables);
  Do(Insert(1, 50, 100));
  Do("BEGIN");
  Do("UPDATE messages SET data = x'00' WHERE id < 20");
  Do(Insert(50, 400, 300));  // more than the cache holds: half of it is in the file
  PowerFails("-journal");
  const std::string file = BagBytes();
  const Reading reading = ReadAll(folder_.File("bag.db3"));

  EXPECT_THAT(reading.events, SizeIs(49));
  EXPECT_EQ(MessageOf(reading.events[0]).size_bytes, 100u);
  EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("-journal` is there, and was read")));
  EXPECT_EQ(BagBytes(), file);

  // It cannot have SQLite delete another file, as a journal of several databases could.
  const std::string victim = folder_.Write("victim", "mine");
  uint32_t sum = 0;
  for (const char c : victim) sum += static_cast<uint8_t>(c);
  const auto big = [](uint32_t number) {
    std::string text = Number(number, 4);
    std::reverse(text.begin(), text.end());
    return text;
  };
  std::string journal = BagBytes("-journal");
  journal += big(1) + victim + big(static_cast<uint32_t>(victim.size())) + big(sum) +
             std::string("\xd9\xd5\x05\xf9\x20\xa1\x63\xd7", 8);
  folder_.Write("bag.db3-journal", journal);
  EXPECT_THAT(ReadAll(folder_.File("bag.db3")).status,
              StatusIs(kDataLoss, HasSubstr("one of several databases, and was not applied")));
  EXPECT_TRUE(fs::exists(victim));
}

TEST_F(CutSqliteTest, WhatATransactionThatHasEndedLeftIsNotRead) {
  Do("PRAGMA journal_mode=PERSIST");
  Do(kTables);
  Do(Insert(1, 5, 10));
  PowerFails("-journal");
  ASSERT_GT(BagBytes("-journal").size(), 0u);
  const Reading reading = ReadAll(folder_.File("bag.db3"));
  EXPECT_THAT(reading.events, SizeIs(4));
  EXPECT_THAT(reading.status, IsOk());
}

TEST_F(CutSqliteTest, ADamagedPageEndsItAndTheRowsBeforeItAreGiven) {
  const std::string path = folder_.File("bag.db3");
  MakeSqlite(path,
             {"PRAGMA page_size=512", kTables, "DROP INDEX timestamp_idx", Insert(1, 100, 100)});
  const std::string bytes = ReadBytes(path);
  const size_t pages = bytes.size() / 512;
  std::string rotten = bytes;
  rotten.replace(pages / 2 * 512, 512, std::string(512, '\xff'));
  const Reading reading = ReadAll(folder_.Write("bag.db3", rotten));
  EXPECT_GT(reading.events.size(), 20u);
  EXPECT_LT(reading.events.size(), 80u);
  EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("disk image is malformed")));
}

TEST_F(CutSqliteTest, WithoutRoomForACopyItSaysWhere) {
  Do("PRAGMA journal_mode=WAL");
  Do(kTables);
  PowerFails("-wal");
  setenv("TMPDIR", folder_.File("none").c_str(), 1);
  EXPECT_THAT(
      Open(folder_.File("bag.db3")),
      StatusIs(absl::StatusCode::kUnavailable,
               AllOf(HasSubstr("bag.db3`: cannot make a directory"), HasSubstr("set TMPDIR"))));
}

}  // namespace
}  // namespace rips::recording

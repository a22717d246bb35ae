#include "policy_server/policy/recording/bag_reader.h"

#include "policy_server/policy/recording/bag_folder.h"
#include "policy_server/policy/recording/recording_test_data.h"

namespace rips::recording {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::SizeIs;

constexpr auto kDataLoss = absl::StatusCode::kDataLoss;
constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
constexpr auto kExhausted = absl::StatusCode::kResourceExhausted;

// Schema version 1, without what later versions added.
const char kTopics[] =
    "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,"
    "serialization_format TEXT NOT NULL)";
const char kMessages[] =
    "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,"
    "timestamp INTEGER NOT NULL, data BLOB)";
const char kIndex[] = "CREATE INDEX timestamp_idx ON messages (timestamp ASC)";
const char kChatter[] = "INSERT INTO topics VALUES(1,'/chatter','std_msgs/msg/String','cdr')";

std::string Insert(int64_t id, int64_t topic, const std::string& time, const std::string& data) {
  return absl::StrCat("INSERT INTO messages VALUES(", id, ",", topic, ",", time, ",", data, ")");
}

class BagReaderTest : public testing::Test {
 protected:
  // A file of the usual tables and then `statements`.
  std::string Make(const std::vector<std::string>& statements, absl::string_view name = "bag.db3") {
    std::vector<std::string> all = {"PRAGMA page_size=512", kTopics, kMessages, kIndex, kChatter};
    all.insert(all.end(), statements.begin(), statements.end());
    std::filesystem::remove(folder_.File(name));
    MakeSqlite(folder_.File(name), all);
    return folder_.File(name);
  }
  // A file of these statements alone.
  std::string MakeBare(const std::vector<std::string>& statements) {
    std::filesystem::remove(folder_.File("bare.db3"));
    MakeSqlite(folder_.File("bare.db3"), statements);
    return folder_.File("bare.db3");
  }

  const TempFolder folder_;
};

std::vector<std::string> Payloads(const Reading& reading) {
  std::vector<std::string> payloads;
  for (const Recorded& event : reading.events) payloads.push_back(MessageOf(event).payload);
  return payloads;
}

TEST_F(BagReaderTest, GivesMessagesByTimeThenId) {
  const std::string path = Make({Insert(1, 1, "30", "x'63'"), Insert(2, 1, "20", "x'62'"),
                                 Insert(3, 1, "20", "x'6232'"), Insert(4, 1, "-5", "x''")});

  const Reading reading = ReadAll(path);

  ASSERT_THAT(reading.status, IsOk());
  EXPECT_THAT(Payloads(reading), ElementsAre("", "b", "b2", "c"));
  EXPECT_EQ(reading.events[0].time_unix_ns, -5);
  EXPECT_EQ(
      MessageOf(reading.events[3]),
      (RecordedMessage{
          .topic = "/chatter", .type = "std_msgs/msg/String", .payload = "c", .size_bytes = 1}));
  EXPECT_FALSE((*Open(path))->has_graph());
}

TEST_F(BagReaderTest, NeedsNoIndexAndIgnoresMoreColumns) {
  const std::string path =
      Make({"DROP INDEX timestamp_idx", "ALTER TABLE topics ADD COLUMN offered_qos_profiles TEXT",
            "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY)", Insert(1, 1, "2", "x'62'"),
            Insert(2, 1, "1", "x'61'")});
  EXPECT_THAT(Payloads(ReadAll(path)), ElementsAre("a", "b"));
}

TEST_F(BagReaderTest, AnEmptyBagHasNoEvents) {
  const Reading reading = ReadAll(Make({}));
  EXPECT_THAT(reading.status, IsOk());
  EXPECT_THAT(reading.events, SizeIs(0));
}

TEST_F(BagReaderTest, TakesAnyFileName) {
  const std::string path = Make({Insert(1, 1, "2", "x'62'")}, "a b?c#d%41&immutable=0.db3");
  EXPECT_THAT(ReadAll(path).events, SizeIs(1));
}

struct Malformed {
  const char* name;
  std::vector<std::string> statements;
  absl::StatusCode code;
  const char* text;
};

TEST_F(BagReaderTest, RefusesWhatIsMalformed) {
  const std::string long_name(kNameBytesMax + 1, 'n');
  const Malformed cases[] = {
      {"format", {"INSERT INTO topics VALUES(2,'/j','t','json')"}, kInvalid, "only `cdr`"},
      {"null data", {Insert(1, 1, "1", "NULL")}, kDataLoss, "data of message 1 is not a blob"},
      {"text data", {Insert(1, 1, "1", "'text'")}, kDataLoss, "not a blob"},
      {"text time", {Insert(1, 1, "'soon'", "x'61'")}, kDataLoss, "not a number"},
      {"real time", {Insert(1, 1, "1.5", "x'61'")}, kDataLoss, "not a number"},
      {"unknown topic", {Insert(1, 9, "1", "x'61'")}, kDataLoss, "topic 9, which the bag does not"},
      {"blob name", {"INSERT INTO topics VALUES(2,x'00','t','cdr')"}, kDataLoss, "not a text"},
      {"long name",
       {absl::StrCat("INSERT INTO topics VALUES(2,'", long_name, "','t','cdr')")},
       kExhausted,
       "limit of 1024"},
      {"compressed", {Insert(1, 1, "1", "x'28b52ffd00'")}, kInvalid, "is compressed"},
      {"large",
       {Insert(1, 1, "1", absl::StrCat("zeroblob(", kMessageBytesMax + 1, ")"))},
       kExhausted,
       "limit of 67108864"},
      {"larger",
       {Insert(1, 1, "1", absl::StrCat("zeroblob(", kMessageBytesMax + 200'000, ")"))},
       kExhausted,
       "limit of 67108864"},
      {"no messages", {"DROP TABLE messages"}, kInvalid, "no table `messages`"},
      {"view",
       {"ALTER TABLE messages RENAME TO m", "CREATE VIEW messages AS SELECT * FROM m"},
       kInvalid,
       "not a plain table"},
      {"computed",
       {"ALTER TABLE topics ADD COLUMN x AS (upper(name))"},
       kInvalid,
       "column `x` of `topics`"},
      {"column", {"ALTER TABLE messages RENAME COLUMN data TO date"}, kInvalid, "lacks one of"},
      {"too many topics",
       {absl::StrCat("WITH RECURSIVE n(i) AS (SELECT 2 UNION ALL SELECT i+1 FROM n WHERE i<=",
                     kBagTopicsMax, ") INSERT INTO topics SELECT i,'/t','t','cdr' FROM n")},
       kExhausted,
       "more topics than the limit of 65536"},
  };
  for (const Malformed& each : cases) {
    const Reading reading = ReadAll(Make(each.statements));
    EXPECT_THAT(reading.status, StatusIs(each.code, HasSubstr(each.text))) << each.name;
    EXPECT_THAT(std::string(reading.status.message()), HasSubstr("bag.db3`: ")) << each.name;
  }
  EXPECT_THAT(ReadAll(MakeBare({"CREATE TABLE other(x)"})).status,
              StatusIs(kInvalid, HasSubstr("not a rosbag2 bag")));
  EXPECT_THAT(
      ReadAll(MakeBare({kTopics, "CREATE TABLE messages(id, topic_id, timestamp, data)"})).status,
      StatusIs(kInvalid, HasSubstr("column `id` of `messages`")));
}

TEST_F(BagReaderTest, NamesABagThatIsStillBeingWritten) {
  const std::string path = Make({Insert(1, 1, "1", "x'61'")});
  std::ofstream(path + "-wal") << "left";
  const Reading reading = ReadAll(path);
  EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("or is still being written")));
  EXPECT_THAT(Payloads(reading), ElementsAre("a"));
  std::ofstream(path + "-wal", std::ios::trunc).close();
  EXPECT_THAT(ReadAll(path).status, IsOk()) << "an empty one holds nothing";
}

TEST_F(BagReaderTest, WritesNothingBesideTheFile) {
  const std::string path = Make({Insert(1, 1, "1", "x'61'")});
  ReadAll(path);
  const std::filesystem::directory_iterator files(folder_.path());
  EXPECT_EQ(std::distance(begin(files), end(files)), 1);
}

TEST_F(BagReaderTest, AnIndexThatTellsSomethingElseIsNotRead) {
  // The index holds the topic's id where the time is expected.
  const std::string path =
      Make({"DROP INDEX timestamp_idx", "CREATE INDEX timestamp_idx ON messages (topic_id)",
            Insert(1, 1, "30", "x'61'"), Insert(2, 1, "20", "x'62'"), "PRAGMA writable_schema=1",
            absl::StrCat("UPDATE sqlite_master SET sql='", kIndex, "' WHERE type='index'")});
  const Reading reading = ReadAll(path);
  EXPECT_THAT(reading.status, IsOk());
  EXPECT_THAT(Payloads(reading), ElementsAre("b", "a"));
}

// Its page says that it has one entry; the table has two.
TEST_F(BagReaderTest, AnIndexThatLacksARowHidesNothing) {
  std::string bytes = ReadBytes(Make({Insert(1, 1, "1", "x'61'"), Insert(2, 1, "2", "x'62'")}));
  const size_t index = 512 * 3;
  ASSERT_EQ(bytes[index], 10) << "page 4 is a leaf of the index";
  ASSERT_EQ(bytes[index + 4], 2);
  bytes[index + 4] = 1;
  const Reading reading = ReadAll(folder_.Write("index.db3", bytes));
  EXPECT_THAT(reading.status, IsOk());
  EXPECT_THAT(Payloads(reading), ElementsAre("a", "b"));
}

TEST_F(BagReaderTest, SeesEveryCut) {
  const std::string path = Make({Insert(1, 1, "1", "x'61'"), Insert(2, 1, "2", "x'6262'")});
  ExpectCutsAreSeen(
      ReadBytes(path), [](size_t) { return false; }, /*step=*/16);
}

TEST_F(BagReaderTest, EndsWhateverBytesAreChanged) {
  const std::string path = Make({Insert(1, 1, "1", "x'61'"), Insert(2, 1, "2", "zeroblob(600)")});
  const size_t size = std::filesystem::file_size(path);
  // Every byte of the headers and cell pointers, and one of seven elsewhere.
  for (size_t at = 0; at < size; at += at % 512 < 100 ? 1 : 7) {
    for (const int mask : {0x01, 0xff}) {
      FlipBits(path, at, mask);
      EXPECT_LE(ReadAll(path).events.size(), 2u) << at;
      FlipBits(path, at, mask);
    }
  }
}

// An inner page of a table (SQLite file format, 1.6) of 512 bytes, all of whose children are
// `child`.
std::string InnerPage(uint32_t child) {
  constexpr size_t kCells = 60;
  std::string number = {static_cast<char>(child >> 24), static_cast<char>(child >> 16),
                        static_cast<char>(child >> 8), static_cast<char>(child)};
  std::string cells;
  std::string pointers;
  for (size_t i = 0; i < kCells; ++i) {
    const size_t at = 512 - 5 * (i + 1);
    pointers += {static_cast<char>(at >> 8), static_cast<char>(at)};
    cells = absl::StrCat(number, std::string(1, static_cast<char>(i + 1)), cells);
  }
  const size_t start = 512 - cells.size();
  std::string page = {5, 0, 0, 0, kCells, static_cast<char>(start >> 8), static_cast<char>(start),
                      0};
  page += number + pointers;
  return page + std::string(start - page.size(), '\0') + cells;
}

TEST_F(BagReaderTest, AFileThatWalksInCirclesIsLeft) {
  // The table's root leads 60 times to page 10, that 60 times to page 11, and so on: 60^6 leaves.
  const std::string path =
      Make({"DROP INDEX timestamp_idx", Insert(1, 1, "1", "x'61'"), "CREATE TABLE room(data BLOB)",
            "INSERT INTO room VALUES(zeroblob(20000))"});
  std::string bytes = ReadBytes(path);
  ASSERT_EQ(bytes[512 * 2], 13) << "the root of `messages`, page 3, is a leaf";
  const std::string leaf = bytes.substr(512 * 2, 512);
  bytes.replace(512 * 2, 512, InnerPage(10));
  for (uint32_t page = 10; page < 15; ++page) {
    bytes.replace(512 * (page - 1), 512, InnerPage(page + 1));
  }
  bytes.replace(512 * 14, 512, leaf);

  const Reading reading = ReadAll(folder_.Write("circles.db3", bytes));

  EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("more steps than")));
}

// The number of an inner cell may begin where its page ends. SQLite would read it in the memory
// behind the page, and find now this row and now that.
TEST_F(BagReaderTest, ACellAtTheEndOfADamagedPageIsNotReadBeyondIt) {
  std::vector<std::string> inserts = {"DROP INDEX timestamp_idx"};
  for (int id = 1; id <= 20; ++id) {
    inserts.push_back(Insert(id, 1, absl::StrCat(id), "zeroblob(100)"));
  }
  std::string bytes = ReadBytes(Make(inserts));
  const size_t root = 512 * 2;
  ASSERT_EQ(bytes[root], 5) << "the root of `messages`, page 3, is an inner page";
  const size_t cell =
      static_cast<uint8_t>(bytes[root + 12]) * 256u + static_cast<uint8_t>(bytes[root + 13]);
  bytes.replace(root + 508, 4, bytes.substr(root + cell, 4));
  bytes.replace(root + 12, 2, "\x01\xfc");

  const Reading reading = ReadAll(folder_.Write("beyond.db3", bytes));

  EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("disk image is malformed")));
  EXPECT_THAT(reading.events, SizeIs(0));
}

class BagFolderTest : public BagReaderTest {
 protected:
  void WriteMetadata(absl::string_view files, absl::string_view more = "") {
    folder_.Write("metadata.yaml",
                  absl::StrCat("rosbag2_bagfile_information:\n  version: 5\n"
                               "  storage_identifier: sqlite3\n  relative_file_paths: ",
                               files, "\n", more));
  }
};

TEST_F(BagFolderTest, GivesOneFileAfterTheOther) {
  Make({Insert(1, 1, "10", "x'61'")}, "bag_0.db3");
  Make({Insert(1, 1, "5", "x'62'")}, "bag_1.db3");
  folder_.Write("bag_2.mcap", absl::StrCat(McapHeader(), McapChannel(1, 0, "/c"),
                                           McapMessage(1, 1, "c"), McapDataEnd(), McapFooter()));
  WriteMetadata("[bag_0.db3, bag_1.db3, bag_2.mcap]", "  compression_format: \"\"\n");

  const Reading reading = ReadAll(folder_.path());

  ASSERT_THAT(reading.status, IsOk());
  EXPECT_THAT(Payloads(reading), ElementsAre("a", "b", "c"));
}

TEST_F(BagFolderTest, AFileThatCannotBeReplayedIsAnErrorWhenItIsReached) {
  Make({Insert(1, 1, "10", "x'61'")}, "bag_0.db3");
  Make({"INSERT INTO topics VALUES(2,'/j','t','json')"}, "bag_1.db3");
  WriteMetadata("[bag_0.db3, bag_1.db3]");
  const Reading reading = ReadAll(folder_.path());
  EXPECT_THAT(reading.status, StatusIs(kInvalid, HasSubstr("only `cdr`")));
  EXPECT_THAT(reading.events, SizeIs(1));
}

TEST_F(BagFolderTest, RefusesWhatIsMalformed) {
  EXPECT_THAT(Open(folder_.path()), StatusIs(absl::StatusCode::kFailedPrecondition,
                                             HasSubstr("directory without metadata.yaml")));
  for (const char* files :
       {"[../other.db3]", "[/etc/passwd]", "[a/../../b]", "[\"\"]", "[a/]", "[[a]]", "[~]"}) {
    WriteMetadata(files);
    EXPECT_THAT(Open(folder_.path()), StatusIs(kInvalid, HasSubstr("not a file of the bag")))
        << files;
  }
  WriteMetadata("bag.db3");
  EXPECT_THAT(Open(folder_.path()), StatusIs(kInvalid, HasSubstr("no list")));
  WriteMetadata("[none.db3]");
  EXPECT_THAT(Open(folder_.path()), StatusIs(kInvalid, HasSubstr("none.db3`, which metadata")));
  folder_.Write("metadata.yaml", "other: 1\n");
  EXPECT_THAT(Open(folder_.path()), StatusIs(kInvalid, HasSubstr("line 1: no `rosbag2_")));
  folder_.Write("metadata.yaml", "{{{");
  EXPECT_THAT(Open(folder_.path()), StatusIs(kInvalid, HasSubstr("metadata.yaml`: line")));
}

TEST_F(BagFolderTest, RefusesMoreFilesThanItsLimit) {
  std::string files = "[";
  for (size_t i = 0; i <= kBagFilesMax; ++i) absl::StrAppend(&files, "f,");
  WriteMetadata(files + "]");
  EXPECT_THAT(Open(folder_.path()), StatusIs(kExhausted, HasSubstr("limit of 10000")));
  WriteMetadata("[]", std::string(kBagMetadataBytesMax, '\n'));
  EXPECT_THAT(Open(folder_.path()), StatusIs(kExhausted, HasSubstr("limit of 4194304")));
}

}  // namespace
}  // namespace rips::recording

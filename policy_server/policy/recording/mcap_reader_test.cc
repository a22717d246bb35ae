#include "policy_server/policy/recording/mcap_reader.h"

#include <lz4frame.h>
#include <zstd.h>

#include <functional>

#include "policy_server/policy/recording/decompress.h"
#include "policy_server/policy/recording/recording_test_data.h"

namespace rips::recording {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::SizeIs;

constexpr auto kDataLoss = absl::StatusCode::kDataLoss;
constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
constexpr auto kExhausted = absl::StatusCode::kResourceExhausted;

std::string Definitions() {
  return McapSchema(1, "std_msgs/msg/String") + McapChannel(1, 1, "/chatter") +
         McapChannel(2, 0, "/untyped");
}

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
std::string Stored(absl::string_view compression, absl::string_view bytes) {
  if (compression == "zstd") return Zstd(bytes);
  return compression == "lz4" ? Lz4(bytes) : std::string(bytes);
}
std::string Chunk(absl::string_view compression, absl::string_view records) {
  return McapChunk(compression, Stored(compression, records), records.size(), Crc32(0, records));
}
// A whole file around `data`, with its checksum from the first byte.
std::string File(absl::string_view data) {
  const std::string begin = absl::StrCat(McapHeader(), data);
  return absl::StrCat(begin, McapDataEnd(Crc32(0, begin)), McapSchema(1, "std_msgs/msg/String"),
                      McapRecord(11, "statistics"), McapFooter());
}

std::vector<std::string> Payloads(const Reading& reading) {
  std::vector<std::string> payloads;
  for (const Recorded& event : reading.events) payloads.push_back(MessageOf(event).payload);
  return payloads;
}

class McapReaderTest : public testing::Test {
 protected:
  Reading Read(absl::string_view bytes) { return ReadAll(folder_.Write("bag.mcap", bytes)); }

  const TempFolder folder_;
};

TEST_F(McapReaderTest, GivesWhatMessagesSay) {
  const Reading reading =
      Read(File(Definitions() + McapMessage(1, 10, "hello") + McapMessage(2, 20, "")));

  ASSERT_THAT(reading.status, IsOk());
  ASSERT_THAT(reading.events, SizeIs(2));
  EXPECT_EQ(reading.events[0].time_unix_ns, 10);
  EXPECT_EQ(MessageOf(reading.events[0]), (RecordedMessage{.topic = "/chatter",
                                                           .type = "std_msgs/msg/String",
                                                           .payload = "hello",
                                                           .size_bytes = 5}));
  EXPECT_EQ(MessageOf(reading.events[1]).type, "") << "a channel without schema";
}

TEST_F(McapReaderTest, DoesNotKnowTheGraph) {
  const auto reader = Open(folder_.Write("bag.mcap", File("")));
  ASSERT_THAT(reader, IsOk());
  EXPECT_FALSE((*reader)->has_graph());
  EXPECT_EQ((*reader)->origin(), nullptr);
}

TEST_F(McapReaderTest, ReadsChunksOfEveryCompression) {
  for (const char* compression : {"", "lz4", "zstd"}) {
    const std::string large(3'000'000, 'x');
    const std::string file =
        File(Chunk(compression, Definitions() + McapMessage(1, 10, "a")) +
             Chunk(compression, McapMessage(1, 20, large)) + Chunk(compression, ""));

    const Reading reading = Read(file);

    ASSERT_THAT(reading.status, IsOk()) << compression;
    EXPECT_EQ(Payloads(reading), (std::vector<std::string>{"a", large})) << compression;
  }
}

TEST_F(McapReaderTest, SortsWithinAChunkAndKeepsTheOrderOfEqualTimes) {
  const std::string chunk = Chunk("", Definitions() + McapMessage(1, 30, "c") +
                                          McapMessage(1, 20, "a") + McapMessage(1, 20, "b"));
  const std::string later = Chunk("", McapMessage(1, 25, "d"));

  const Reading reading = Read(File(chunk + later + McapMessage(1, 5, "e")));

  ASSERT_THAT(reading.status, IsOk());
  EXPECT_THAT(Payloads(reading), ElementsAre("a", "b", "c", "d", "e"));
}

TEST_F(McapReaderTest, SkipsWhatItDoesNotKnow) {
  const std::string strange = McapRecord(0x80, std::string(200'000, 's')) + McapRecord(9, "at");
  const Reading reading = Read(File(
      strange + Chunk("zstd", Definitions() + McapRecord(0xff, "new") + McapMessage(1, 1, "m")) +
      strange));
  ASSERT_THAT(reading.status, IsOk());
  EXPECT_THAT(Payloads(reading), ElementsAre("m"));
}

TEST_F(McapReaderTest, TheSameDefinitionMayComeAgain) {
  const Reading reading = Read(File(Definitions() + Definitions() + McapMessage(1, 1, "m")));
  EXPECT_THAT(reading.status, IsOk());
}

TEST_F(McapReaderTest, TakesADataChecksumOfEitherKindOrNone) {
  const std::string data = Definitions() + McapMessage(1, 1, "m");
  for (const uint32_t crc : {0u, Crc32(0, data), Crc32(0, McapHeader() + data)}) {
    EXPECT_THAT(Read(McapHeader() + data + McapDataEnd(crc) + McapFooter()).status, IsOk());
  }
  const Reading reading = Read(McapHeader() + data + McapDataEnd(1) + McapFooter());
  EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("checksum of the data is 00000001")));
  EXPECT_THAT(reading.events, SizeIs(1)) << "it is known only at the end";
}

TEST_F(McapReaderTest, GivesNothingOfAChunkWithAWrongChecksum) {
  const std::string records = Definitions() + McapMessage(1, 1, "m");
  const Reading reading = Read(File(McapChunk("", records, records.size(), 77)));
  EXPECT_THAT(reading.status, StatusIs(kDataLoss, HasSubstr("the chunk is 0000004d")));
  EXPECT_THAT(reading.events, SizeIs(0));
  EXPECT_THAT(Read(File(McapChunk("", records, records.size(), 0))).status, IsOk()) << "0 = none";
}

struct Malformed {
  const char* name;
  std::string data;
  absl::StatusCode code;
  const char* text;
};

TEST_F(McapReaderTest, RefusesWhatIsMalformedOrTooLarge) {
  const std::string long_name(kNameBytesMax + 1, 'n');
  const std::string records = Definitions() + McapMessage(1, 1, "m");
  const Malformed cases[] = {
      {"json", McapChannel(1, 0, "/a", "json"), kInvalid, "encoded as `json`; only `cdr`"},
      {"no such channel", McapMessage(1, 1, "m"), kDataLoss, "channel 1, which is not defined"},
      {"no such schema", McapChannel(1, 3, "/a"), kDataLoss, "schema 3, which is not defined"},
      {"schema 0", McapSchema(0, "a"), kDataLoss, "id 0"},
      {"schema changes", McapSchema(1, "a") + McapSchema(1, "b"), kDataLoss, "twice"},
      {"channel changes", McapChannel(1, 0, "/a") + McapChannel(1, 0, "/b"), kDataLoss, "twice"},
      {"schema cut", McapRecord(3, "\1"), kDataLoss, "schema is cut"},
      {"channel cut", McapRecord(4, Number(1, 4) + Number(1'000, 4)), kDataLoss, "channel is cut"},
      {"message cut", Definitions() + McapRecord(5, Number(1, 2)), kDataLoss, "message is cut"},
      {"topic", McapChannel(1, 0, long_name), kExhausted, "limit of 1024"},
      {"type", McapSchema(1, long_name), kExhausted, "limit of 1024"},
      {"time", Definitions() + McapMessage(1, UINT64_MAX, "m"), kDataLoss, "has the time"},
      {"chunk cut", McapRecord(6, "short"), kDataLoss, "chunk is cut"},
      {"chunk in chunk", Chunk("", Chunk("", records)), kDataLoss, "kind 6 in a chunk"},
      {"kind 0 in chunk", Chunk("", McapRecord(0, "")), kDataLoss, "kind 0 in a chunk"},
      {"record cut in chunk", Chunk("", records.substr(0, records.size() - 1)), kDataLoss,
       "cut within its chunk"},
      {"kind 0", McapRecord(0, ""), kDataLoss, "kind 0"},
      {"second header", McapRecord(1, ""), kDataLoss, "second header"},
      {"early footer", McapFooter(), kDataLoss, "footer before"},
      {"compression", McapChunk("xz", "", 0, 0), kInvalid, "`xz`: unknown compression"},
      {"announced too much", McapChunk("zstd", Zstd("x"), kChunkBytesMax + 1, 0), kExhausted,
       "limit of 268435456"},
      {"announced 2^64-1", McapChunk("zstd", Zstd("x"), UINT64_MAX, 0), kExhausted, "limit"},
      {"bomb", McapChunk("zstd", Zstd(std::string(9'000'000, '0')), 1'000, 0), kDataLoss,
       "more than the 1000 bytes"},
      {"lz4 bomb", McapChunk("lz4", Lz4(std::string(9'000'000, '0')), 1'000, 0), kDataLoss,
       "more than the 1000 bytes"},
      {"less", McapChunk("zstd", Zstd("abc"), kChunkBytesMax, 0), kDataLoss, "less than"},
      {"other length", McapChunk("", "abc", 4, 0), kDataLoss, "3 bytes, 4 announced"},
      {"damaged zstd", McapChunk("zstd", "abcdefgh", 4, 0), kDataLoss, "zstd: "},
      {"damaged lz4", McapChunk("lz4", "abcdefgh", 4, 0), kDataLoss, "lz4: "},
      {"cut zstd", McapChunk("zstd", Zstd(records).substr(0, 12), records.size(), 0), kDataLoss,
       "cut"},
      {"cut lz4", McapChunk("lz4", Lz4(records).substr(0, 12), records.size(), 0), kDataLoss,
       "cut"},
      {"empty zstd", McapChunk("zstd", "", 0, 0), kDataLoss, "cut"},
      {"data after the end", McapDataEnd() + McapMessage(1, 1, ""), kDataLoss, "after the end"},
      {"end cut", McapRecord(15, "ab"), kDataLoss, "end of the data is cut"},
      {"footer cut", McapDataEnd() + McapRecord(2, "ab"), kDataLoss, "footer is cut"},
      {"length 2^64-1", Number(5, 1) + Number(UINT64_MAX, 8), kDataLoss, "cut within a message"},
      {"length 2^63 to skip", Number(99, 1) + Number(uint64_t{1} << 63, 8), kDataLoss,
       "cut within a record"},
  };
  for (const Malformed& each : cases) {
    const Reading reading = Read(File(each.data));
    EXPECT_THAT(reading.status, StatusIs(each.code, HasSubstr(each.text))) << each.name;
    EXPECT_THAT(std::string(reading.status.message()), HasSubstr("bag.mcap`: byte "));
  }
}

TEST_F(McapReaderTest, RefusesRecordsPastTheirLimits) {
  const std::pair<uint8_t, size_t> cases[] = {{3, kDefinitionBytesMax},
                                              {4, kDefinitionBytesMax},
                                              {5, kMessageBytesMax + 22},
                                              {6, kChunkBytesMax + 64}};
  for (const auto& [op, limit] : cases) {
    const std::string begin = McapHeader() + Number(op, 1) + Number(limit + 1, 8);
    const std::string path = folder_.Write("large.mcap", begin);
    std::filesystem::resize_file(path, begin.size() + limit + 1);  // takes no room
    EXPECT_THAT(ReadAll(path).status, StatusIs(kExhausted, HasSubstr("exceeds the limit")))
        << int{op};
  }
}

TEST_F(McapReaderTest, RefusesALargeMessageInAChunk) {
  const std::string message = McapMessage(1, 1, std::string(kMessageBytesMax + 1, '0'));
  EXPECT_THAT(Read(File(Chunk("zstd", Definitions() + message))).status,
              StatusIs(kExhausted, HasSubstr("limit of 67108864")));
}

TEST_F(McapReaderTest, RefusesWhatFollowsTheEnd) {
  const std::string file = File("");
  EXPECT_THAT(Read(file + "x").status, StatusIs(kDataLoss, HasSubstr("magic at the end")));
  std::string other = file;
  other.back() = 'x';
  EXPECT_THAT(Read(other).status, StatusIs(kDataLoss, HasSubstr("magic at the end")));
  EXPECT_THAT(Read(std::string(kMcapMagic) + McapSchema(1, "a")).status,
              StatusIs(kDataLoss, HasSubstr("not the header")));
}

TEST_F(McapReaderTest, SeesEveryCutAndEveryFlippedBitOfTheData) {
  const std::string data = Chunk("zstd", Definitions() + McapMessage(1, 10, "one")) +
                           McapMessage(2, 20, "two") + Chunk("lz4", McapMessage(1, 30, "three"));
  const std::string file = File(data);
  ExpectCutsAreSeen(file);
  const size_t begin = McapHeader().size();
  ExpectFlipsAreSeen(file, begin, begin + data.size());
}

TEST(DecompressTest, HoldsNoMoreThanWhatComesOut) {
  std::string out;
  EXPECT_THAT(Decompress("zstd", Zstd("abc"), kChunkBytesMax, &out), StatusIs(kDataLoss));
  EXPECT_LT(out.capacity(), 1'000'000u);
  EXPECT_THAT(Decompress("zstd", Zstd("abc") + Zstd("def"), 6, &out), IsOk());
  EXPECT_EQ(out, "abcdef") << "frames in a row";
  EXPECT_THAT(Decompress("lz4", Lz4("abc") + Lz4("def"), 6, &out), IsOk());
  EXPECT_EQ(out, "abcdef");
}

}  // namespace
}  // namespace rips::recording

#include "policy_server/server/ingest/chunk_assembler.h"

#include <string>

#include "gmock/gmock.h"
#include "services/base/status_matchers.h"

namespace rips::ingest {
namespace {

using ::testing::HasSubstr;

constexpr absl::StatusCode kInvalid = absl::StatusCode::kInvalidArgument;
constexpr absl::StatusCode kExhausted = absl::StatusCode::kResourceExhausted;
constexpr size_t kChunk = kPayloadChunkBytes;

absl::Status Add(ChunkAssembler& assembler, uint64_t id, size_t offset, const std::string& data) {
  rips::v1::PayloadChunk chunk;
  chunk.set_chunked_payload_id(id);
  chunk.set_offset(static_cast<uint32_t>(offset));
  chunk.set_data(data);
  return assembler.Add(chunk);
}

// A payload of that many bytes, each chunk of another letter.
absl::Status AddWhole(ChunkAssembler& assembler, uint64_t id, size_t bytes) {
  char letter = 'a';
  for (size_t at = 0; at < bytes; at += kChunk) {
    const absl::Status added =
        Add(assembler, id, at, std::string(std::min(kChunk, bytes - at), letter++));
    if (!added.ok()) return added;
  }
  return absl::OkStatus();
}

TEST(ChunkAssemblerTest, PutsPayloadsTogetherInTheOrderOfTheirIds) {
  ChunkAssembler assembler;
  ASSERT_THAT(AddWhole(assembler, 1, 2 * kChunk + 1), IsOk());
  ASSERT_THAT(AddWhole(assembler, 2, kChunk), IsOk());
  ASSERT_THAT(AddWhole(assembler, 3, 1), IsOk());
  EXPECT_EQ(assembler.pending_bytes(), 3 * kChunk + 2);

  const absl::StatusOr<std::string> first = assembler.Claim(1);
  ASSERT_THAT(first, IsOk());
  EXPECT_TRUE(*first == std::string(kChunk, 'a') + std::string(kChunk, 'b') + "c");
  EXPECT_EQ(assembler.Claim(3).value(), "a");
  EXPECT_EQ(assembler.FinishBatch(), 3 * kChunk + 2) << "with the one that was not named";
  EXPECT_EQ(assembler.pending_bytes(), 0u);

  // The next batch has others.
  ASSERT_THAT(AddWhole(assembler, 4, kPayloadBytesHard), IsOk());
  EXPECT_EQ(assembler.Claim(4)->size(), kPayloadBytesHard);
  EXPECT_EQ(assembler.FinishBatch(), kPayloadBytesHard);
  EXPECT_EQ(assembler.FinishBatch(), 0u);
}

TEST(ChunkAssemblerTest, RefusesChunksOutOfPlace) {
  struct Case {
    const char* name;
    uint64_t id;
    size_t offset;
    std::string data;
    absl::StatusCode code;
    const char* text;
  };
  const Case cases[] = {
      {"no id", 0, 0, "x", kInvalid, "chunk of payload 0 after payload 2"},
      {"an old id", 1, kChunk, "x", kInvalid, "chunk of payload 1 after payload 2"},
      {"an id left out", 4, 0, "x", kInvalid, "chunk of payload 4 after payload 2"},
      {"the last id", UINT64_MAX, 0, "x", kInvalid, "after payload 2"},
      {"a hole", 2, kChunk + 1, "x", kInvalid, "at offset 65537; 65536 bytes came before it"},
      {"an overlap", 2, kChunk - 1, "x", kInvalid, "at offset 65535; 65536 bytes came before it"},
      {"the same again", 2, 0, std::string(kChunk, 'x'), kInvalid, "at offset 0; 65536 bytes"},
      {"a start that is none", 3, 1, "x", kInvalid, "at offset 1; 0 bytes came before it"},
      {"nothing", 2, kChunk, "", kInvalid, "empty chunk"},
      {"too much", 2, kChunk, std::string(kChunk + 1, 'x'), kExhausted,
       "chunk of 65537 bytes exceeds the limit of 65536"},
  };
  for (const Case& each : cases) {
    ChunkAssembler assembler;
    ASSERT_THAT(AddWhole(assembler, 1, kChunk), IsOk());
    ASSERT_THAT(AddWhole(assembler, 2, kChunk), IsOk());
    EXPECT_THAT(Add(assembler, each.id, each.offset, each.data),
                StatusIs(each.code, HasSubstr(each.text)))
        << each.name;
    EXPECT_EQ(assembler.pending_bytes(), 2 * kChunk) << each.name;
  }
}

TEST(ChunkAssemblerTest, OnlyTheLastChunkOfAPayloadMayBeShort) {
  ChunkAssembler assembler;
  ASSERT_THAT(Add(assembler, 1, 0, "short"), IsOk());
  EXPECT_THAT(Add(assembler, 1, 5, "x"), StatusIs(kInvalid, HasSubstr("was not full")));
}

TEST(ChunkAssemblerTest, AChunkAfterItsBatchIsRefused) {
  ChunkAssembler assembler;
  EXPECT_THAT(Add(assembler, 0, 0, "x"), StatusIs(kInvalid, HasSubstr("after payload 0")));
  ASSERT_THAT(AddWhole(assembler, 1, kChunk), IsOk());
  assembler.FinishBatch();
  EXPECT_THAT(Add(assembler, 1, kChunk, "x"), StatusIs(kInvalid, HasSubstr("after payload 1")));
}

TEST(ChunkAssemblerTest, BoundsWhatMayWaitForABatch) {
  ChunkAssembler assembler;
  ASSERT_THAT(AddWhole(assembler, 1, kPayloadBytesHard), IsOk());
  EXPECT_THAT(Add(assembler, 1, kPayloadBytesHard, "x"),
              StatusIs(kExhausted, HasSubstr("payload 1 of 4194305 bytes exceeds the limit of "
                                             "4194304")));
  ASSERT_THAT(AddWhole(assembler, 2, kPayloadBytesHard), IsOk());
  EXPECT_THAT(Add(assembler, 3, 0, "x"), StatusIs(kExhausted, HasSubstr("8388608 bytes")));
  assembler.FinishBatch();
  for (uint64_t id = 3; id < 3 + ChunkAssembler::kPendingMax; ++id) {
    ASSERT_THAT(Add(assembler, id, 0, "x"), IsOk());
  }
  EXPECT_THAT(Add(assembler, 3 + ChunkAssembler::kPendingMax, 0, "x"),
              StatusIs(kExhausted, HasSubstr("more than 256 payloads")));
}

TEST(ChunkAssemblerTest, EachPayloadIsNamedOnceAndInOrder) {
  ChunkAssembler assembler;
  for (const uint64_t id : {1, 2, 3}) ASSERT_THAT(Add(assembler, id, 0, "x"), IsOk());
  for (const uint64_t id : {uint64_t{0}, uint64_t{4}, UINT64_MAX}) {
    EXPECT_THAT(assembler.Claim(id), StatusIs(kInvalid, HasSubstr("did not come before")));
  }
  ASSERT_THAT(assembler.Claim(2), IsOk());
  EXPECT_THAT(assembler.Claim(2), StatusIs(kInvalid, HasSubstr("payload 2 after payload 2")));
  EXPECT_THAT(assembler.Claim(1), StatusIs(kInvalid, HasSubstr("payload 1 after payload 2")));
  assembler.FinishBatch();
  EXPECT_THAT(assembler.Claim(3), StatusIs(kInvalid, HasSubstr("did not come before")))
      << "dropped with its batch";
}

}  // namespace
}  // namespace rips::ingest

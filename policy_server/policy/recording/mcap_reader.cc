#include "policy_server/policy/recording/mcap_reader.h"

#include <algorithm>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "policy_server/policy/recording/decompress.h"
#include "policy_server/policy/recording/little_endian.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::recording {
namespace {

// Channel, sequence and two times of a message.
constexpr size_t kMessageHeaderBytes = 22;
constexpr size_t kChunkHeaderBytesMax = 64;
constexpr size_t kFooterBytes = 20;
constexpr uint64_t kSkipBytes = 64 * 1024;

// Record opcodes (MCAP specification, "Records").
enum class McapOp : uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kDataEnd = 0x0f,
};

// Opcode and content length.
constexpr size_t kMcapRecordHeaderBytes = 9;

struct McapMessage {
  uint16_t channel = 0;
  int64_t log_time_ns = 0;
  // Into the record's content.
  absl::string_view payload;
};

// Not thread-safe. Every function takes the content of one record; messages of errors say what is
// wrong, not where.
class McapChannels {
 public:
  // DataLoss: cut, an id of 0, another schema or channel under a known id, a schema that was not
  // defined. InvalidArgument: message encoding not `cdr`. ResourceExhausted: a long name.
  absl::Status AddSchema(absl::string_view content);
  absl::Status AddChannel(absl::string_view content);

  // DataLoss: cut, unknown channel, a time beyond int64. ResourceExhausted: a large payload.
  // InvalidArgument: a compressed one.
  absl::StatusOr<McapMessage> Parse(absl::string_view content) const;
  // `message` was parsed by this.
  Recorded Resolve(const McapMessage& message) const;

 private:
  struct Channel {
    uint16_t schema = 0;
    std::string topic;
    std::string type;

    friend bool operator==(const Channel&, const Channel&) = default;
  };

  // Names by schema id.
  absl::flat_hash_map<uint16_t, std::string> schemas_;
  absl::flat_hash_map<uint16_t, Channel> channels_;
};

absl::Status CutWithin(absl::string_view what, uint64_t bytes, uint64_t left) {
  return absl::DataLossError(absl::StrCat("the file is cut within ", what, " of ", bytes,
                                          " bytes, of which ", left, " are left"));
}

absl::Status CheckName(absl::string_view what, absl::string_view name) {
  if (name.size() <= kNameBytesMax) return absl::OkStatus();
  return absl::ResourceExhaustedError(
      absl::StrCat(what, " name of ", name.size(), " bytes exceeds the limit of ", kNameBytesMax));
}

absl::Status McapChannels::AddSchema(absl::string_view content) {
  Cursor cursor(content);
  const uint16_t id = cursor.U16();
  const absl::string_view name = cursor.Text();
  cursor.Text();  // how the definition is written
  cursor.Text();  // the definition
  if (!cursor.ok()) return absl::DataLossError("a schema is cut");
  if (id == 0) return absl::DataLossError("a schema has the id 0");
  RIPS_RETURN_IF_ERROR(CheckName("schema", name));
  const auto [at, added] = schemas_.try_emplace(id, name);
  if (!added && at->second != name) {
    return absl::DataLossError(absl::StrCat("schema ", id, " is defined twice, differently"));
  }
  return absl::OkStatus();
}

absl::Status McapChannels::AddChannel(absl::string_view content) {
  Cursor cursor(content);
  const uint16_t id = cursor.U16();
  Channel channel{.schema = cursor.U16()};
  const absl::string_view topic = cursor.Text();
  const absl::string_view encoding = cursor.Text();
  cursor.Text();  // metadata
  if (!cursor.ok()) return absl::DataLossError("a channel is cut");
  RIPS_RETURN_IF_ERROR(CheckName("topic", topic));
  channel.topic = std::string(topic);
  if (encoding != "cdr") {
    return absl::InvalidArgumentError(absl::StrCat("topic `", ros2::Printable(topic),
                                                   "` is encoded as `", ros2::Printable(encoding),
                                                   "`; only `cdr` can be replayed"));
  }
  if (channel.schema != 0) {
    const auto schema = schemas_.find(channel.schema);
    if (schema == schemas_.end()) {
      return absl::DataLossError(
          absl::StrCat("channel ", id, " has schema ", channel.schema, ", which is not defined"));
    }
    channel.type = schema->second;
  }
  const auto [at, added] = channels_.try_emplace(id, channel);
  if (!added && at->second != channel) {
    return absl::DataLossError(absl::StrCat("channel ", id, " is defined twice, differently"));
  }
  return absl::OkStatus();
}

absl::StatusOr<McapMessage> McapChannels::Parse(absl::string_view content) const {
  Cursor cursor(content);
  McapMessage message{.channel = cursor.U16()};
  cursor.U32();  // sequence
  const uint64_t log_time = cursor.U64();
  cursor.U64();  // publish time
  if (!cursor.ok()) return absl::DataLossError("a message is cut");
  message.payload = cursor.rest();
  if (!channels_.contains(message.channel)) {
    return absl::DataLossError(
        absl::StrCat("a message is on channel ", message.channel, ", which is not defined"));
  }
  if (log_time > static_cast<uint64_t>(std::numeric_limits<int64_t>::max())) {
    return absl::DataLossError(absl::StrCat("a message has the time ", log_time));
  }
  if (message.payload.size() > kMessageBytesMax) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "message of ", message.payload.size(), " bytes exceeds the limit of ", kMessageBytesMax));
  }
  if (absl::StartsWith(message.payload, kZstdMagic)) {
    return absl::InvalidArgumentError(absl::StrCat("a message ", kCompressedMessage));
  }
  message.log_time_ns = static_cast<int64_t>(log_time);
  return message;
}

Recorded McapChannels::Resolve(const McapMessage& message) const {
  const Channel& channel = channels_.at(message.channel);
  return {.time_unix_ns = message.log_time_ns,
          .what = RecordedMessage{.topic = channel.topic,
                                  .type = channel.type,
                                  .payload = std::string(message.payload),
                                  .size_bytes = static_cast<uint32_t>(message.payload.size())}};
}

// The messages of one chunk, in order of time. Not thread-safe.
class McapChunk {
 public:
  // Finds the messages in `records`, and adds the definitions to `channels`. After an error (as of
  // that, and DataLoss) it has those before it.
  absl::Status Index(McapChannels& channels);
  // The content of the next message; it is in `records`.
  std::optional<absl::string_view> Next() {
    if (next_ == places_.size()) return std::nullopt;
    const Place& place = places_[next_++];
    return absl::string_view(records).substr(place.offset, place.bytes);
  }

  // Not compressed.
  std::string records;

 private:
  struct Place {
    int64_t log_time_ns;
    uint32_t offset;
    uint32_t bytes;
  };

  absl::Status FindPlaces(McapChannels& channels);

  std::vector<Place> places_;
  size_t next_ = 0;
};

absl::Status McapChunk::Index(McapChannels& channels) {
  places_.clear();
  next_ = 0;
  const absl::Status found = FindPlaces(channels);
  std::stable_sort(places_.begin(), places_.end(), [](const Place& left, const Place& right) {
    return left.log_time_ns < right.log_time_ns;
  });
  return found;
}

absl::Status McapChunk::FindPlaces(McapChannels& channels) {
  Cursor cursor(records);
  while (!cursor.rest().empty()) {
    const McapOp op{cursor.U8()};
    const absl::string_view content = cursor.Bytes(cursor.U64());
    if (!cursor.ok()) return absl::DataLossError("a record is cut within its chunk");
    if (op == McapOp::kSchema) {
      RIPS_RETURN_IF_ERROR(channels.AddSchema(content));
    } else if (op == McapOp::kChannel) {
      RIPS_RETURN_IF_ERROR(channels.AddChannel(content));
    } else if (op == McapOp::kMessage) {
      RIPS_ASSIGN_OR_RETURN(const McapMessage message, channels.Parse(content));
      places_.push_back({.log_time_ns = message.log_time_ns,
                         .offset = static_cast<uint32_t>(content.data() - records.data()),
                         .bytes = static_cast<uint32_t>(content.size())});
    } else if (op <= McapOp::kChunk || op == McapOp::kDataEnd) {
      return absl::DataLossError(
          absl::StrCat("a record of kind ", static_cast<int>(op), " in a chunk"));
    }
  }
  return absl::OkStatus();
}

class McapReader final : public Reader {
 public:
  explicit McapReader(std::unique_ptr<InputFile> file) : file_(std::move(file)) {}

  absl::Status ReadHeader();
  bool has_graph() const override { return false; }

 private:
  // In the order they follow each other.
  enum class Section { kData, kSummary, kEnd };

  absl::StatusOr<std::optional<Recorded>> Read() override;
  // One record; gives what it holds, if that is a message outside of chunks.
  absl::StatusOr<std::optional<Recorded>> ReadRecord();
  absl::StatusOr<std::optional<Recorded>> InData(McapOp op, uint64_t length);
  absl::Status InSummary(McapOp op, uint64_t length);

  absl::Status TakeChunk();
  // The whole messages of a chunk of `length` bytes that the end of the file cuts; then cut_.
  void TakeCutChunk(uint64_t length);
  absl::Status TakeDataEnd(uint64_t length, uint32_t crc_before);
  absl::Status TakeFooter(uint64_t length);

  // The next bytes into content_, at most `limit`.
  absl::Status Take(uint64_t count, uint64_t limit, absl::string_view what);
  absl::Status Skip(uint64_t count);
  // `status` with the place of the record.
  absl::Status At(const absl::Status& status) const;

  const std::unique_ptr<InputFile> file_;
  McapChannels channels_;
  Section section_ = Section::kData;
  uint64_t record_at_ = 0;
  std::string content_;
  // CRC-32 of magic and header; of what was read after them.
  uint32_t header_crc_ = 0;
  uint32_t data_crc_ = 0;
  uint64_t data_at_ = 0;

  McapChunk chunk_;
  // What comes after the messages of a cut chunk; OK = none was cut.
  absl::Status cut_;
};

absl::Status McapReader::At(const absl::Status& status) const {
  if (status.ok()) return status;
  return absl::Status(status.code(), absl::StrCat("`", file_->path(), "`: byte ", record_at_, ": ",
                                                  status.message()));
}

absl::Status McapReader::Take(uint64_t count, uint64_t limit, absl::string_view what) {
  if (count > file_->remaining()) return At(CutWithin(what, count, file_->remaining()));
  if (count > limit) {
    return At(absl::ResourceExhaustedError(
        absl::StrCat(what, " of ", count, " bytes exceeds the limit of ", limit)));
  }
  RIPS_RETURN_IF_ERROR(file_->Read(count, &content_));
  data_crc_ = Crc32(data_crc_, content_);
  return absl::OkStatus();
}

absl::Status McapReader::Skip(uint64_t count) {
  if (count > file_->remaining()) return Take(count, count, "a record");
  for (; count > kSkipBytes; count -= kSkipBytes) {
    RIPS_RETURN_IF_ERROR(Take(kSkipBytes, kSkipBytes, "a record"));
  }
  return Take(count, kSkipBytes, "a record");
}

absl::Status McapReader::ReadHeader() {
  RIPS_RETURN_IF_ERROR(Take(kMcapMagic.size(), kMcapMagic.size(), "the magic"));
  if (content_ != kMcapMagic) return file_->Damaged(0, "not MCAP");
  record_at_ = file_->offset();
  RIPS_RETURN_IF_ERROR(Take(kMcapRecordHeaderBytes, kMcapRecordHeaderBytes, "a record"));
  Cursor cursor(content_);
  if (McapOp{cursor.U8()} != McapOp::kHeader) {
    return At(absl::DataLossError("the first record is not the header"));
  }
  RIPS_RETURN_IF_ERROR(Take(cursor.U64(), kDefinitionBytesMax, "the header"));
  header_crc_ = std::exchange(data_crc_, 0);
  data_at_ = file_->offset();
  return absl::OkStatus();
}

absl::StatusOr<std::optional<Recorded>> McapReader::Read() {
  while (true) {
    if (const auto next = chunk_.Next(); next.has_value()) {
      const auto message = channels_.Parse(*next);
      if (!message.ok()) return At(message.status());
      return channels_.Resolve(*message);
    }
    RIPS_RETURN_IF_ERROR(cut_);
    if (section_ == Section::kEnd) return std::nullopt;
    RIPS_ASSIGN_OR_RETURN(std::optional<Recorded> event, ReadRecord());
    if (event) return event;
  }
}

absl::StatusOr<std::optional<Recorded>> McapReader::ReadRecord() {
  record_at_ = file_->offset();
  if (file_->remaining() == 0) {
    return At(absl::DataLossError(
        "the file ends without a footer: it was cut, or is still being written"));
  }
  const uint32_t crc_before = data_crc_;
  RIPS_RETURN_IF_ERROR(Take(kMcapRecordHeaderBytes, kMcapRecordHeaderBytes, "a record"));
  Cursor cursor(content_);
  const McapOp op{cursor.U8()};
  const uint64_t length = cursor.U64();
  if (static_cast<uint8_t>(op) == 0) return At(absl::DataLossError("a record of kind 0"));
  if (section_ == Section::kSummary) {
    RIPS_RETURN_IF_ERROR(InSummary(op, length));
    return std::nullopt;
  }
  if (op == McapOp::kDataEnd) {
    RIPS_RETURN_IF_ERROR(TakeDataEnd(length, crc_before));
    return std::nullopt;
  }
  return InData(op, length);
}

absl::StatusOr<std::optional<Recorded>> McapReader::InData(McapOp op, uint64_t length) {
  switch (op) {
    case McapOp::kSchema:
      RIPS_RETURN_IF_ERROR(Take(length, kDefinitionBytesMax, "a schema"));
      RIPS_RETURN_IF_ERROR(At(channels_.AddSchema(content_)));
      return std::nullopt;
    case McapOp::kChannel:
      RIPS_RETURN_IF_ERROR(Take(length, kDefinitionBytesMax, "a channel"));
      RIPS_RETURN_IF_ERROR(At(channels_.AddChannel(content_)));
      return std::nullopt;
    case McapOp::kMessage: {
      RIPS_RETURN_IF_ERROR(Take(length, kMessageBytesMax + kMessageHeaderBytes, "a message"));
      const auto message = channels_.Parse(content_);
      if (!message.ok()) return At(message.status());
      return channels_.Resolve(*message);
    }
    case McapOp::kChunk:
      if (length > file_->remaining()) {
        TakeCutChunk(length);
        return std::nullopt;
      }
      RIPS_RETURN_IF_ERROR(Take(length, kChunkBytesMax + kChunkHeaderBytesMax, "a chunk"));
      RIPS_RETURN_IF_ERROR(At(TakeChunk()));
      return std::nullopt;
    case McapOp::kHeader:
      return At(absl::DataLossError("a second header"));
    case McapOp::kFooter:
      return At(absl::DataLossError("a footer before the end of the data"));
    case McapOp::kDataEnd:
      break;  // the caller's
  }
  RIPS_RETURN_IF_ERROR(Skip(length));
  return std::nullopt;
}

absl::Status McapReader::InSummary(McapOp op, uint64_t length) {
  if (op == McapOp::kFooter) return TakeFooter(length);
  if (op == McapOp::kMessage || op == McapOp::kChunk || op == McapOp::kDataEnd) {
    return At(absl::DataLossError("data after the end of the data"));
  }
  return Skip(length);
}

absl::Status McapReader::TakeChunk() {
  Cursor cursor(content_);
  cursor.U64();  // first and last time
  cursor.U64();
  const uint64_t size = cursor.U64();
  const uint32_t crc = cursor.U32();
  const absl::string_view compression = cursor.Text();
  const absl::string_view stored = cursor.Bytes(cursor.U64());
  if (!cursor.ok()) return absl::DataLossError("a chunk is cut");
  if (size > kChunkBytesMax || stored.size() > kChunkBytesMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat("chunk of ", std::max<uint64_t>(size, stored.size()),
                     " bytes exceeds the limit of ", kChunkBytesMax));
  }
  const absl::Status status =
      Decompress(compression, stored, static_cast<size_t>(size), &chunk_.records);
  if (!status.ok()) {
    return absl::Status(status.code(),
                        absl::StrCat("chunk compressed with `", ros2::Printable(compression),
                                     "`: ", status.message()));
  }
  const uint32_t actual = crc == 0 ? 0 : Crc32(0, chunk_.records);
  if (actual != crc) {
    return absl::DataLossError(
        absl::StrFormat("the checksum of the chunk is %08x, its content has %08x", crc, actual));
  }
  content_ = std::string();  // the stored form, which may be large
  return chunk_.Index(channels_);
}

void McapReader::TakeCutChunk(uint64_t length) {
  const uint64_t left = file_->remaining();
  cut_ = At(CutWithin("a chunk", length, left));
  if (length > kChunkBytesMax + kChunkHeaderBytesMax) return;
  if (const absl::Status read = Take(left, left, "a chunk"); !read.ok()) {
    cut_ = read;
    return;
  }
  Cursor cursor(content_);
  cursor.U64();  // first and last time
  cursor.U64();
  const uint64_t size = cursor.U64();
  cursor.U32();  // checksum of all of it
  const absl::string_view compression = cursor.Text();
  cursor.U64();  // bytes stored
  if (!cursor.ok() || size > kChunkBytesMax) return;
  // Both end early, and give what is whole until then.
  Decompress(compression, cursor.rest(), static_cast<size_t>(size), &chunk_.records).IgnoreError();
  content_ = std::string();
  chunk_.Index(channels_).IgnoreError();
}

absl::Status McapReader::TakeDataEnd(uint64_t length, uint32_t crc_before) {
  RIPS_RETURN_IF_ERROR(Take(length, kDefinitionBytesMax, "the end of the data"));
  Cursor cursor(content_);
  const uint32_t crc = cursor.U32();
  if (!cursor.ok()) return At(absl::DataLossError("the end of the data is cut"));
  const uint32_t whole = CombineCrc32(header_crc_, crc_before, record_at_ - data_at_);
  if (crc != 0 && crc != crc_before && crc != whole) {
    return At(absl::DataLossError(
        absl::StrFormat("the checksum of the data is %08x, the file has %08x", crc, whole)));
  }
  section_ = Section::kSummary;
  return absl::OkStatus();
}

absl::Status McapReader::TakeFooter(uint64_t length) {
  if (length < kFooterBytes) return At(absl::DataLossError("the footer is cut"));
  RIPS_RETURN_IF_ERROR(Take(length, kDefinitionBytesMax, "the footer"));
  RIPS_RETURN_IF_ERROR(Take(kMcapMagic.size(), kMcapMagic.size(), "the magic at the end"));
  if (content_ != kMcapMagic || file_->remaining() != 0) {
    return At(absl::DataLossError("the magic at the end is missing or something follows it"));
  }
  section_ = Section::kEnd;
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::unique_ptr<Reader>> OpenMcap(std::unique_ptr<InputFile> file) {
  auto reader = std::make_unique<McapReader>(std::move(file));
  RIPS_RETURN_IF_ERROR(reader->ReadHeader());
  return reader;
}

}  // namespace rips::recording

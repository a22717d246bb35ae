#include "policy_server/policy/recording/rips_reader.h"

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "policy_server/policy/recording/event_codec.h"
#include "policy_server/policy/recording/little_endian.h"
#include "policy_server/policy/recording/rips_format.h"
#include "services/base/status_macros.h"

namespace rips::recording {
namespace {

class RipsReader final : public Reader {
 public:
  explicit RipsReader(std::unique_ptr<InputFile> file) : file_(std::move(file)) {}

  absl::Status ReadOrigin();
  bool has_graph() const override { return true; }
  const RecordedOrigin* origin() const override { return &origin_; }

 private:
  absl::StatusOr<std::optional<Recorded>> Read() override;
  // The body of the next frame, whose first byte is at `at`.
  absl::Status ReadFrame(uint64_t at);

  const std::unique_ptr<InputFile> file_;
  RecordedOrigin origin_;
  std::string body_;
};

absl::Status RipsReader::ReadFrame(uint64_t at) {
  if (file_->remaining() < kFrameHeaderBytes) {
    return file_->Damaged(at, "the recording is cut within a frame");
  }
  RIPS_RETURN_IF_ERROR(file_->Read(kFrameHeaderBytes, &body_));
  Cursor header(body_);
  const uint32_t length = header.U32();
  const uint32_t crc = header.U32();
  if (length == 0 || length > kFrameBytesMax) {
    return file_->Damaged(
        at, absl::StrCat("a frame of ", length, " bytes; possible are 1 to ", kFrameBytesMax));
  }
  if (length > file_->remaining()) {
    return file_->Damaged(at, absl::StrCat("the recording is cut within a frame of ", length,
                                           " bytes, of which ", file_->remaining(), " are left"));
  }
  RIPS_RETURN_IF_ERROR(file_->Read(length, &body_));
  const uint32_t actual = Crc32(0, body_);
  if (actual == crc) return absl::OkStatus();
  return file_->Damaged(
      at, absl::StrFormat("the frame's checksum is %08x, its content has %08x", crc, actual));
}

absl::Status RipsReader::ReadOrigin() {
  RIPS_RETURN_IF_ERROR(file_->Read(kRipsMagic.size(), &body_));
  if (body_ != kRipsMagic) return file_->Damaged(0, "not a recording of RIPS");
  const uint64_t at = file_->offset();
  RIPS_RETURN_IF_ERROR(ReadFrame(at));
  rips::v1::RecordingHeader wire;
  if (!wire.ParseFromString(body_)) return file_->Damaged(at, "the header cannot be decoded");
  origin_ = DecodeHeader(wire);
  return absl::OkStatus();
}

absl::StatusOr<std::optional<Recorded>> RipsReader::Read() {
  if (file_->remaining() == 0) return std::nullopt;
  const uint64_t at = file_->offset();
  RIPS_RETURN_IF_ERROR(ReadFrame(at));
  rips::v1::RecordedEvent wire;
  if (!wire.ParseFromString(body_)) return file_->Damaged(at, "the event cannot be decoded");
  absl::StatusOr<Recorded> event = DecodeEvent(wire);
  if (!event.ok()) return file_->Damaged(at, event.status().message());
  return *std::move(event);
}

}  // namespace

absl::StatusOr<std::unique_ptr<Reader>> OpenRips(std::unique_ptr<InputFile> file) {
  auto reader = std::make_unique<RipsReader>(std::move(file));
  RIPS_RETURN_IF_ERROR(reader->ReadOrigin());
  return reader;
}

}  // namespace rips::recording

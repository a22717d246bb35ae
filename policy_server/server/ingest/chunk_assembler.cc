#include "policy_server/server/ingest/chunk_assembler.h"

#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::ingest {

absl::Status ChunkAssembler::Add(rips::v1::PayloadChunk& chunk) {
  const uint64_t id = chunk.chunked_payload_id();
  const size_t size = chunk.data().size();
  if (size == 0) return absl::InvalidArgumentError(absl::StrCat("payload ", id, ": empty chunk"));
  if (size > kPayloadChunkBytes) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "payload ", id, ": chunk of ", size, " bytes exceeds the limit of ", kPayloadChunkBytes));
  }
  const bool begins = id == newest_id_ + 1;
  if (!begins && (id != newest_id_ || pending_.empty())) {
    return absl::InvalidArgumentError(
        absl::StrCat("chunk of payload ", id, " after payload ", newest_id_));
  }
  const Payload* current = begins ? nullptr : &pending_.back();
  const size_t held = begins ? 0 : current->bytes;
  if (chunk.offset() != held) {
    return absl::InvalidArgumentError(absl::StrCat(
        "payload ", id, ": chunk at offset ", chunk.offset(), "; ", held, " bytes came before it"));
  }
  if (!begins && current->chunks.back().size() < kPayloadChunkBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("payload ", id, ": a chunk after one that was not full"));
  }
  if (held + size > kPayloadBytesHard) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "payload ", id, " of ", held + size, " bytes exceeds the limit of ", kPayloadBytesHard));
  }
  if (pending_bytes_ + size > kPendingBytesMax || (begins && pending_.size() >= kPendingMax)) {
    return absl::ResourceExhaustedError(
        absl::StrCat("more than ", kPendingMax, " payloads or ", kPendingBytesMax,
                     " bytes of payloads before a batch that names them"));
  }
  if (begins) {
    pending_.emplace_back();
    ++newest_id_;
  }
  pending_.back().chunks.push_back(std::move(*chunk.mutable_data()));
  pending_.back().bytes += size;
  pending_bytes_ += size;
  return absl::OkStatus();
}

absl::StatusOr<std::string> ChunkAssembler::Claim(uint64_t id) {
  const uint64_t oldest_id = newest_id_ - pending_.size() + 1;
  if (id < oldest_id || id > newest_id_) {
    return absl::InvalidArgumentError(
        absl::StrCat("a message names payload ", id, ", which did not come before its batch"));
  }
  if (id <= claimed_id_) {
    return absl::InvalidArgumentError(
        absl::StrCat("a message names payload ", id, " after payload ", claimed_id_));
  }
  claimed_id_ = id;
  Payload payload = std::exchange(pending_[id - oldest_id], {});
  if (payload.chunks.size() == 1) return std::move(payload.chunks[0]);
  std::string whole;
  whole.reserve(payload.bytes);
  for (const std::string& chunk : payload.chunks) whole += chunk;
  return whole;
}

size_t ChunkAssembler::FinishBatch() {
  pending_.clear();
  claimed_id_ = 0;
  return std::exchange(pending_bytes_, 0);
}

}  // namespace rips::ingest

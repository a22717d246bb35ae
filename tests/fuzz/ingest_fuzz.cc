// Whatever a sensor's stream holds: decoding ends with a batch within its limits or a refusal, the
// same the second time; every view of a batch can be read after the decoder is gone. No message
// takes more memory than its bytes foretell.
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "absl/strings/string_view.h"
#include "google/protobuf/io/zero_copy_stream_impl_lite.h"
#include "policy_server/server/ingest/observation_decoder.h"
#include "services/base/check.h"
#include "services/wire_limits/field_limits.h"
#include "services/wire_limits/parsed_size.h"

namespace rips::ingest {
namespace {

constexpr size_t kMessagesMax = 32;

size_t Touch(absl::string_view text) {
  size_t sum = 0;
  for (const char c : text) sum += static_cast<unsigned char>(c);
  return sum;
}

size_t Read(const pipeline::Batch& batch) {
  size_t sum = Touch(batch.incarnation);
  const bool control = batch.lane == pipeline::Lane::kControl;
  for (const pipeline::Observation& each : batch.observations) {
    RIPS_CHECK(each.boottime_ns >= 0, "a time before the host was started");
    const auto* message = std::get_if<pipeline::MessageSeen>(&each.what);
    const bool either = std::holds_alternative<pipeline::LossSeen>(each.what);
    RIPS_CHECK(either || (message == nullptr) == control, "an observation in the other lane");
    if (message == nullptr) continue;
    RIPS_CHECK(message->payload.size() <= message->size_bytes, "more bytes than there were");
    sum += Touch(message->payload);
    sum += Touch(message->topic) + Touch(message->type) + Touch(message->sender);
  }
  return sum;
}

// A stream: each message is a length of two bytes, little endian, and a SensorMessage.
std::vector<v1::SensorMessage> Messages(absl::string_view input) {
  std::vector<v1::SensorMessage> out;
  while (input.size() >= 2 && out.size() < kMessagesMax) {
    const size_t size = static_cast<unsigned char>(input[0]) |
                        static_cast<size_t>(static_cast<unsigned char>(input[1])) << 8;
    input.remove_prefix(2);
    const absl::string_view bytes = input.substr(0, size);
    input.remove_prefix(bytes.size());
    v1::SensorMessage message;
    google::protobuf::io::ArrayInputStream encoded(bytes.data(), static_cast<int>(bytes.size()));
    const size_t foretold = wire_limits::ParsedSize(*message.descriptor(), encoded);
    const bool parsed = message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()));
    if (parsed) {
      RIPS_CHECK(message.SpaceUsedLong() <= foretold, "more memory than its bytes foretell");
      out.push_back(std::move(message));
    }
  }
  return out;
}

// What became of each message, until one is refused.
std::vector<std::string> Decode(const std::vector<v1::SensorMessage>& messages) {
  std::vector<std::string> out;
  std::vector<pipeline::Batch> batches;
  auto decoder = std::make_unique<ObservationDecoder>();
  for (const v1::SensorMessage& message : messages) {
    if (const auto hit = wire_limits::Check(message)) {
      out.push_back(hit->Text());
      break;  // the stream is closed
    }
    if (message.has_hello()) {
      const auto hello = DecodeHello(message.hello());
      out.push_back(hello.status().ToString());
    } else if (message.has_heartbeat()) {
      RIPS_CHECK(DecodeHeartbeat(message.heartbeat()).clock.boottime_ns >= 0, "a negative time");
    } else if (message.has_chunk()) {
      v1::PayloadChunk chunk = message.chunk();
      const absl::Status taken = decoder->TakeChunk(chunk);
      out.push_back(taken.ToString());
      if (!taken.ok()) break;  // the stream is closed
    } else if (message.has_batch()) {
      absl::StatusOr<pipeline::Batch> batch = decoder->Decode(message.batch());
      out.push_back(batch.status().ToString());
      if (!batch.ok()) break;  // the stream is closed
      RIPS_CHECK(batch->observations.size() <= 256, "more observations than a batch may have");
      RIPS_CHECK(
          batch->observations.size() == static_cast<size_t>(message.batch().observations_size()),
          "an observation is gone or was made up");
      batches.push_back(*std::move(batch));
    }
  }
  decoder.reset();
  size_t sum = 0;
  for (const pipeline::Batch& batch : batches) sum += Read(batch);
  out.push_back(std::to_string(sum));
  return out;
}

}  // namespace
}  // namespace rips::ingest

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > 200'000) return 0;  // Larger inputs find nothing new, slowly.
  const std::string input(reinterpret_cast<const char*>(data), size);
  const auto messages = rips::ingest::Messages(input);
  RIPS_CHECK(rips::ingest::Decode(messages) == rips::ingest::Decode(messages),
             "the same stream is decoded otherwise");
  return 0;
}

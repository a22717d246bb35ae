// Whatever comes through the socket of rips-exec: a message is decoded only if it is exactly what
// the other end encodes, and packets join to what was split.
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "mode_actuator/steps/program/exec_message.h"
#include "services/base/check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace rips::actuator;  // One translation unit, nothing else in it.
  const std::string input(reinterpret_cast<const char*>(data), size);
  if (const auto call = DecodeExecCall(input); call.ok()) {
    RIPS_CHECK(EncodeExecCall(*call) == input, "a call that is encoded otherwise");
    RIPS_CHECK(CheckProgramArgs(call->program.args).ok(), "arguments past their limits");
  }
  if (const auto answer = DecodeExecAnswer(input); answer.ok()) {
    RIPS_CHECK(EncodeExecAnswer(*answer) == input, "an answer that is encoded otherwise");
    RIPS_CHECK(answer->result.output_tail.size() <= kOutputBytesMax, "more output than is kept");
  }
  // As one message, and as hostile packets that a byte each cuts.
  PacketJoiner whole;
  std::string joined;
  for (const std::string& packet : SplitIntoPackets(input)) {
    RIPS_CHECK(packet.size() <= kExecPacketBytesMax, "a packet past its limit");
    const auto done = whole.Add(packet, &joined);
    if (!done.ok()) {
      RIPS_CHECK(input.size() > kExecMessageBytesMax, "a packet of ours is refused");
      break;
    }
    if (*done) RIPS_CHECK(joined == input, "the message changed");
  }
  PacketJoiner hostile;
  size_t start = 0;
  for (size_t i = 0; i <= input.size(); ++i) {
    if (i != input.size() && input[i] != '\n') continue;
    const auto done = hostile.Add(input.substr(start, i - start), &joined);
    if (!done.ok()) break;
    if (*done) RIPS_CHECK(joined.size() <= kExecMessageBytesMax, "a message past its limit");
    start = i + 1;
  }
  return 0;
}

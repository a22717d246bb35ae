#include "mode_actuator/steps/program/exec_message.h"

#include <random>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ::testing::HasSubstr;

ExecCall LargestCall() {
  ExecCall call;
  call.verb = ExecVerb::kStart;
  call.program.name = std::string(kProgramNameBytesMax, 'n');
  call.program.args.assign(kArgsMax, std::string(kArgBytesMax, '\xff'));
  call.program.timeout = kExecTimeoutMax;
  call.program.drill = true;
  call.program.level_from = std::string(64, 'F');
  call.program.level_to = std::string(64, 'T');
  return call;
}

TEST(ExecMessageTest, CallsComeBackAsTheyWere) {
  ExecCall call;
  call.verb = ExecVerb::kStart;
  call.program = {.name = "usb alarm\n", .args = {"", "a\nb 7\n", "\xff\x01"}};
  call.program.timeout = absl::Milliseconds(1500);
  call.program.level_to = "ALERT";
  for (const ExecCall& each : {call, LargestCall()}) {
    const auto decoded = DecodeExecCall(EncodeExecCall(each));
    ASSERT_THAT(decoded, IsOk());
    EXPECT_EQ(decoded->verb, each.verb);
    EXPECT_EQ(decoded->program.name, each.program.name);
    EXPECT_EQ(decoded->program.args, each.program.args);
    EXPECT_EQ(decoded->program.timeout, each.program.timeout);
    EXPECT_EQ(decoded->program.drill, each.program.drill);
    EXPECT_EQ(decoded->program.level_from, each.program.level_from);
    EXPECT_EQ(decoded->program.level_to, each.program.level_to);
  }
  EXPECT_LE(EncodeExecCall(LargestCall()).size(), kExecMessageBytesMax);
  call.program.timeout = absl::InfiniteDuration();
  EXPECT_EQ(DecodeExecCall(EncodeExecCall(call))->program.timeout, absl::InfiniteDuration());
  EXPECT_EQ(DecodeExecCall(EncodeExecCall({}))->verb, ExecVerb::kCancel);
}

TEST(ExecMessageTest, AnswersComeBackAsTheyWere) {
  ExecAnswer ended;
  ended.result.status = absl::AbortedError("exit code 7");
  ended.result.exit_code = 7;
  ended.result.output_tail = std::string(kOutputBytesMax, '\0');
  ended.result.output_bytes = 1ull << 40;
  ended.result.took_ms = 12;
  ended.result.note = "left 1 process behind, killed";
  const auto decoded = DecodeExecAnswer(EncodeExecAnswer(ended));
  ASSERT_THAT(decoded, IsOk());
  EXPECT_EQ(decoded->result.status, ended.result.status);
  EXPECT_EQ(decoded->result.exit_code, 7);
  EXPECT_EQ(decoded->result.output_tail, ended.result.output_tail);
  EXPECT_EQ(decoded->result.output_bytes, 1ull << 40);
  EXPECT_EQ(decoded->result.took_ms, 12u);
  EXPECT_EQ(decoded->result.note, ended.result.note);
  EXPECT_TRUE(decoded->result.begun);

  ExecAnswer begun;
  begun.kind = ExecAnswer::Kind::kBegun;
  begun.timeout = absl::InfiniteDuration();
  EXPECT_EQ(DecodeExecAnswer(EncodeExecAnswer(begun))->timeout, kExecTimeoutMax);
  ExecAnswer refused;
  refused.result.begun = false;
  refused.result.status = absl::PermissionDeniedError(std::string(5000, 'x'));
  EXPECT_EQ(DecodeExecAnswer(EncodeExecAnswer(refused))->result.status.message().size(),
            kExecTextBytesMax);
  EXPECT_FALSE(DecodeExecAnswer(EncodeExecAnswer(refused))->result.begun);
}

TEST(ExecMessageTest, AnythingElseIsRefused) {
  const std::string good =
      "rips-exec 1\nverb 5\nstart\nname 4\necho\narg 1\na\ntimeout_ms 4\n1500\nlevel_from 0\n\n"
      "level_to 0\n\n";
  ASSERT_THAT(DecodeExecCall(good), IsOk());
  const std::pair<const char*, const char*> kEdits[] = {
      {"rips-exec 1", "rips-exec 2"},
      {"verb 5\nstart", "verb 4\nstar"},
      {"verb 5\nstart\n", ""},
      {"name 4\necho\n", ""},
      {"name 4", "name 3"},
      {"name 4", "name 5"},
      {"name 4", "name 04"},
      {"name 4", "name +4"},
      {"name 4", "name -1"},
      {"name 4", "name 18446744073709551615"},
      {"name 4", "name 18446744073709551616"},
      {"name 4", "path 4"},
      {"arg 1\na\n", "arg 1\na\nname 4\necho\n"},
      {"timeout_ms 4\n1500", "timeout_ms 1\n0"},
      {"timeout_ms 4\n1500", "timeout_ms 2\n-1"},
      {"timeout_ms 4\n1500", "timeout_ms 5\n01500"},
      {"timeout_ms 4\n1500", "timeout_ms 9\n999999999"},
      {"timeout_ms", "timeout_ms x"},
      {"1500\n", "1500"},
      {"1500\n", "1500\n\n"},
      {"1500\n", "1500\ndrill 1\n0\n"},
      {"1500\n", "1500\nlevel_to 1\nX\n"},
  };
  for (const auto& [from, to] : kEdits) {
    const std::string bad = absl::StrReplaceAll(good, {{from, to}});
    ASSERT_NE(bad, good);
    EXPECT_THAT(DecodeExecCall(bad), StatusIs(absl::StatusCode::kInvalidArgument)) << bad;
  }
  EXPECT_THAT(DecodeExecCall(std::string("rips-exec 1\nverb 5\nstart\nname 1\n\0\n", 33)),
              StatusIs(absl::StatusCode::kInvalidArgument));
  ExecCall many = LargestCall();
  many.program.args.emplace_back("one more");
  EXPECT_THAT(DecodeExecCall(EncodeExecCall(many)), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(DecodeExecAnswer(good), StatusIs(absl::StatusCode::kDataLoss));
}

TEST(ExecMessageTest, EveryPrefixAndEveryFlippedByteIsRefusedOrCanonical) {
  ExecAnswer ended;
  ended.result.status = absl::UnknownError("why");
  ended.result.output_tail = "out";
  for (const std::string& good : {EncodeExecCall({}), EncodeExecAnswer(ended)}) {
    for (size_t cut = 0; cut < good.size(); ++cut) {
      EXPECT_FALSE(DecodeExecCall(good.substr(0, cut)).ok());
      EXPECT_FALSE(DecodeExecAnswer(good.substr(0, cut)).ok());
    }
    std::mt19937 random(1);
    for (int i = 0; i < 20'000; ++i) {
      std::string bad = good;
      bad[random() % bad.size()] = static_cast<char>(random());
      if (const auto call = DecodeExecCall(bad); call.ok()) {
        EXPECT_EQ(EncodeExecCall(*call), bad);
      }
      if (const auto answer = DecodeExecAnswer(bad); answer.ok()) {
        EXPECT_EQ(EncodeExecAnswer(*answer), bad);
      }
    }
  }
}

TEST(ExecMessageTest, MessagesArePacketsOfBoundedSize) {
  for (const size_t size :
       {size_t{0}, size_t{1}, kExecPacketBytesMax - 1, kExecPacketBytesMax, kExecMessageBytesMax}) {
    const std::string message(size, 'm');
    PacketJoiner joiner;
    std::string joined = "?";
    bool whole = false;
    for (const std::string& packet : SplitIntoPackets(message)) {
      EXPECT_LE(packet.size(), kExecPacketBytesMax);
      ASSERT_FALSE(whole);
      const auto added = joiner.Add(packet, &joined);
      ASSERT_THAT(added, IsOk());
      whole = *added;
    }
    EXPECT_TRUE(whole);
    EXPECT_EQ(joined, message);
  }
}

TEST(ExecMessageTest, PacketsThatAreNoneAreRefused) {
  PacketJoiner joiner;
  std::string message;
  for (const absl::string_view packet : {"", "+", "x", "\xff"}) {
    EXPECT_THAT(joiner.Add(packet, &message), StatusIs(absl::StatusCode::kInvalidArgument));
  }
  const std::string full = "+" + std::string(kExecPacketBytesMax - 1, 'm');
  absl::StatusOr<bool> added = false;
  for (size_t i = 0; added.ok() && i <= kExecMessageBytesMax / kExecPacketBytesMax + 1; ++i) {
    added = joiner.Add(full, &message);
  }
  EXPECT_THAT(added, StatusIs(absl::StatusCode::kResourceExhausted,
                              HasSubstr("a message exceeds limit 294912 bytes")));
}

}  // namespace
}  // namespace rips::actuator

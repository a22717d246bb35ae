#include "mode_actuator/steps/program/exec_message.h"

#include <functional>
#include <random>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "rips/v1/helper.pb.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ::testing::HasSubstr;
using Kind = ExecAnswer::Kind;

ExecCall SmallCall() {
  ExecCall call;
  call.verb = ExecVerb::kStart;
  call.program = {.name = "echo", .args = {"a"}, .timeout = absl::Milliseconds(1500)};
  return call;
}

ExecCall LargestCall() {
  ExecCall call;
  call.verb = ExecVerb::kStart;
  call.program.name = std::string(kProgramNameBytesMax, 'n');
  call.program.args.assign(kArgsMax, std::string(kArgBytesMax, '\xff'));
  call.program.timeout = kExecTimeoutMax;
  call.program.drill = true;
  call.program.level_from = std::string(kProgramNameBytesMax, 'F');
  call.program.level_to = std::string(kProgramNameBytesMax, '\xff');
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

ExecAnswer LargestAnswer() {
  ExecAnswer ended;
  ended.result.status = absl::Status(absl::StatusCode::kUnauthenticated, std::string(2048, '\xff'));
  ended.result.exit_code = 255;
  ended.result.output_tail = std::string(kOutputBytesMax, '\0');
  ended.result.output_bytes = INT64_MAX;
  ended.result.took_ms = UINT32_MAX;
  ended.result.note = std::string(kExecTextBytesMax, '\n');
  return ended;
}

ExecAnswer SmallAnswer(Kind kind) {
  ExecAnswer answer;
  answer.kind = kind;
  answer.timeout = absl::Milliseconds(50);
  answer.result.status = absl::UnknownError("why");
  answer.result.output_tail = "out";
  return answer;
}

TEST(ExecMessageTest, AnswersComeBackAsTheyWere) {
  ExecAnswer ended;
  ended.result.status = absl::AbortedError("exit code 7");
  ended.result.exit_code = 7;
  ended.result.output_tail = std::string("a\0\xff", 3);
  ended.result.output_bytes = 1ull << 40;
  ended.result.took_ms = 12;
  ended.result.note = "left 1 process behind, killed";
  ExecAnswer refused;
  refused.result.begun = false;
  refused.result.status = absl::PermissionDeniedError("not in the allow-list");
  for (const ExecAnswer& each : {ended, LargestAnswer(), refused, ExecAnswer{}}) {
    const auto decoded = DecodeExecAnswer(EncodeExecAnswer(each));
    ASSERT_THAT(decoded, IsOk());
    EXPECT_EQ(decoded->kind, Kind::kEnded);
    EXPECT_EQ(decoded->result.status, each.result.status);
    EXPECT_EQ(decoded->result.begun, each.result.begun);
    EXPECT_EQ(decoded->result.exit_code, each.result.exit_code);
    EXPECT_EQ(decoded->result.output_tail, each.result.output_tail);
    EXPECT_EQ(decoded->result.output_bytes, each.result.output_bytes);
    EXPECT_EQ(decoded->result.took_ms, each.result.took_ms);
    EXPECT_EQ(decoded->result.note, each.result.note);
  }
  EXPECT_LE(EncodeExecAnswer(LargestAnswer()).size(), kExecMessageBytesMax);
  for (int code = 0; code <= 16; ++code) {
    ExecAnswer examined = SmallAnswer(Kind::kExamined);
    examined.result.status = absl::Status(static_cast<absl::StatusCode>(code), "why");
    const auto decoded = DecodeExecAnswer(EncodeExecAnswer(examined));
    ASSERT_THAT(decoded, IsOk());
    EXPECT_EQ(decoded->kind, Kind::kExamined);
    EXPECT_EQ(decoded->result.status, examined.result.status);
  }
  ExecAnswer begun = SmallAnswer(Kind::kBegun);
  EXPECT_EQ(DecodeExecAnswer(EncodeExecAnswer(begun))->timeout, absl::Milliseconds(50));
  EXPECT_EQ(DecodeExecAnswer(EncodeExecAnswer(begun))->kind, Kind::kBegun);
  begun.timeout = absl::InfiniteDuration();
  EXPECT_EQ(DecodeExecAnswer(EncodeExecAnswer(begun))->timeout, kExecTimeoutMax);
}

TEST(ExecMessageTest, TextsOfAnswersAreCut) {
  ExecAnswer answer;
  answer.result.status = absl::PermissionDeniedError(std::string(kExecTextBytesMax + 1, 'x'));
  answer.result.note = std::string(kExecTextBytesMax + 1, 'x');
  const auto decoded = DecodeExecAnswer(EncodeExecAnswer(answer));
  ASSERT_THAT(decoded, IsOk());
  EXPECT_EQ(decoded->result.status.message().size(), kExecTextBytesMax);
  EXPECT_EQ(decoded->result.note.size(), kExecTextBytesMax);
}

// `good` as `edit` changes it.
template <typename Wire>
std::string Edited(const std::string& good, const std::function<void(Wire&)>& edit) {
  Wire wire;
  EXPECT_TRUE(wire.ParseFromString(good));
  edit(wire);
  return wire.SerializeAsString();
}

constexpr absl::string_view kUnknownField = "\x78\x01";  // field 15

TEST(ExecMessageTest, CallsPastALimitOrOfAnotherShapeAreRefused) {
  const std::string good = EncodeExecCall(SmallCall());
  using Wire = v1::ExecCall;
  ASSERT_THAT(DecodeExecCall(Edited<Wire>(good, [](Wire&) {})), IsOk());
  const std::function<void(Wire&)> kEdits[] = {
      [](Wire& wire) { wire.clear_verb(); },
      [](Wire& wire) { wire.set_verb(v1::EXEC_VERB_CANCEL); },
      [](Wire& wire) { wire.set_verb(v1::EXEC_VERB_EXAMINE); },
      [](Wire& wire) { wire.set_verb(static_cast<v1::ExecVerb>(4)); },
      [](Wire& wire) { wire.set_verb(static_cast<v1::ExecVerb>(-1)); },
      [](Wire& wire) { wire.clear_name(); },
      [](Wire& wire) { wire.set_name(std::string(kProgramNameBytesMax + 1, 'n')); },
      [](Wire& wire) { wire.set_name(std::string("a\0b", 3)); },
      [](Wire& wire) { wire.set_args(0, std::string("a\0b", 3)); },
      [](Wire& wire) { wire.set_args(0, std::string(kArgBytesMax + 1, 'a')); },
      [](Wire& wire) {
        for (size_t i = 0; i < kArgsMax; ++i) wire.add_args("b");
      },
      [](Wire& wire) { wire.set_timeout_ms(0); },
      [](Wire& wire) { wire.set_timeout_ms(86'400'001); },
      [](Wire& wire) { wire.clear_drill(); },
      [](Wire& wire) { wire.clear_level_from(); },
      [](Wire& wire) { wire.clear_level_to(); },
      [](Wire& wire) { wire.set_level_from(std::string("A\0", 2)); },
      [](Wire& wire) { wire.set_level_from(std::string(kProgramNameBytesMax + 1, 'A')); },
      [](Wire& wire) { wire.set_level_to(std::string(kProgramNameBytesMax + 1, 'A')); },
  };
  for (size_t i = 0; i < std::size(kEdits); ++i) {
    const std::string bad = Edited<Wire>(good, kEdits[i]);
    ASSERT_NE(bad, good) << i;
    EXPECT_THAT(DecodeExecCall(bad), StatusIs(absl::StatusCode::kInvalidArgument)) << i;
  }
  EXPECT_THAT(DecodeExecCall(absl::StrCat(good, kUnknownField)),
              StatusIs(absl::StatusCode::kInvalidArgument));
  // A cancel of ours says nothing but that.
  const std::string cancel = EncodeExecCall({});
  EXPECT_THAT(DecodeExecCall(cancel), IsOk());
  EXPECT_FALSE(DecodeExecCall(Edited<Wire>(cancel, [](Wire& wire) { wire.set_name("x"); })).ok());
}

TEST(ExecMessageTest, CallsThatAreSerializedOtherwiseAreRefused) {
  const std::string good = EncodeExecCall(SmallCall());
  ASSERT_EQ(good.substr(0, 2), "\x08\x01");
  ASSERT_EQ(good.substr(good.size() - 6), std::string("\x28\0\x32\0\x3a\0", 6));
  const std::string verbless = good.substr(2);
  const std::string drilless = good.substr(0, good.size() - 6);
  const std::string levels("\x32\0\x3a\0", 4);
  for (const std::string& bad :
       {std::string("\x08\x81\x00", 3) + verbless,  // the verb in two bytes
        std::string("\x08\x02\x08\x01", 4) + verbless, good + "\x08\x01", verbless + "\x08\x01",
        "\x0a\x01\x01" + verbless, drilless + std::string("\x28\x02", 2) + levels,
        drilless + std::string("\x28\0\x3a\0\x32\0", 6), good + std::string(1, '\0'),
        good + "\x12\x04" + "echo", std::string("rips-exec 1\nverb 6\ncancel\n"),
        std::string("GET / HTTP/1.1\r\n\r\n"), std::string(kExecMessageBytesMax + 1, '\x08')}) {
    EXPECT_THAT(DecodeExecCall(bad), StatusIs(absl::StatusCode::kInvalidArgument))
        << testing::PrintToString(bad.substr(0, 80));
  }
  EXPECT_THAT(DecodeExecCall("\x08\x01" + verbless), IsOk());
  EXPECT_THAT(DecodeExecCall(drilless + std::string("\x28\x01", 2) + levels), IsOk());
}

TEST(ExecMessageTest, AnswersPastALimitOrOfAnotherShapeAreRefused) {
  const std::string good = EncodeExecAnswer(LargestAnswer());
  using Wire = v1::ExecAnswer;
  ASSERT_THAT(DecodeExecAnswer(Edited<Wire>(good, [](Wire&) {})), IsOk());
  const std::function<void(Wire&)> kEdits[] = {
      [](Wire& wire) { wire.clear_kind(); },
      [](Wire& wire) { wire.set_kind(v1::EXEC_KIND_EXAMINED); },
      [](Wire& wire) { wire.set_kind(v1::EXEC_KIND_BEGUN); },
      [](Wire& wire) { wire.set_kind(static_cast<v1::ExecKind>(4)); },
      [](Wire& wire) { wire.set_timeout_ms(5); },
      [](Wire& wire) { wire.clear_code(); },
      [](Wire& wire) { wire.set_code(0); },  // which has no message
      [](Wire& wire) { wire.set_code(17); },
      [](Wire& wire) { wire.set_code(UINT32_MAX); },
      [](Wire& wire) { wire.clear_message(); },
      [](Wire& wire) { wire.set_message(std::string(kExecTextBytesMax + 1, 'x')); },
      [](Wire& wire) { wire.clear_begun(); },
      [](Wire& wire) { wire.clear_exit_code(); },
      [](Wire& wire) { wire.set_exit_code(256); },
      [](Wire& wire) { wire.set_exit_code(UINT32_MAX); },
      [](Wire& wire) { wire.clear_output_bytes(); },
      [](Wire& wire) { wire.set_output_bytes(1ull << 63); },
      [](Wire& wire) { wire.clear_output_tail(); },
      [](Wire& wire) { wire.set_output_tail(std::string(kOutputBytesMax + 1, 'x')); },
      [](Wire& wire) { wire.clear_took_ms(); },
      [](Wire& wire) { wire.clear_note(); },
      [](Wire& wire) { wire.set_note(std::string(kExecTextBytesMax + 1, 'x')); },
  };
  for (size_t i = 0; i < std::size(kEdits); ++i) {
    const std::string bad = Edited<Wire>(good, kEdits[i]);
    ASSERT_NE(bad, good) << i;
    EXPECT_THAT(DecodeExecAnswer(bad), StatusIs(absl::StatusCode::kDataLoss)) << i;
  }
  EXPECT_THAT(DecodeExecAnswer(absl::StrCat(good, kUnknownField)),
              StatusIs(absl::StatusCode::kDataLoss));
  const std::string begun = EncodeExecAnswer(SmallAnswer(Kind::kBegun));
  const auto timeout = [&](uint32_t ms) {
    return DecodeExecAnswer(Edited<Wire>(begun, [&](Wire& wire) { wire.set_timeout_ms(ms); }));
  };
  EXPECT_THAT(timeout(86'400'000), IsOk());
  EXPECT_THAT(timeout(86'400'001), StatusIs(absl::StatusCode::kDataLoss));
}

std::vector<std::string> SmallCalls() {
  ExecCall examine = SmallCall();
  examine.verb = ExecVerb::kExamine;
  return {EncodeExecCall({}), EncodeExecCall(SmallCall()), EncodeExecCall(examine)};
}

std::vector<std::string> SmallAnswers() {
  return {EncodeExecAnswer(SmallAnswer(Kind::kExamined)),
          EncodeExecAnswer(SmallAnswer(Kind::kBegun)), EncodeExecAnswer(SmallAnswer(Kind::kEnded))};
}

TEST(ExecMessageTest, EveryPrefixIsRefused) {
  for (const std::string& good : SmallCalls()) {
    EXPECT_THAT(DecodeExecCall(good), IsOk());
    EXPECT_THAT(DecodeExecAnswer(good), StatusIs(absl::StatusCode::kDataLoss));
    for (size_t cut = 0; cut < good.size(); ++cut) {
      EXPECT_THAT(DecodeExecCall(good.substr(0, cut)),
                  StatusIs(absl::StatusCode::kInvalidArgument));
    }
  }
  for (const std::string& good : SmallAnswers()) {
    EXPECT_THAT(DecodeExecAnswer(good), IsOk());
    EXPECT_THAT(DecodeExecCall(good), StatusIs(absl::StatusCode::kInvalidArgument));
    for (size_t cut = 0; cut < good.size(); ++cut) {
      EXPECT_THAT(DecodeExecAnswer(good.substr(0, cut)), StatusIs(absl::StatusCode::kDataLoss));
    }
  }
}

void ExpectRefusedOrCanonical(const std::string& bytes) {
  if (const auto call = DecodeExecCall(bytes); call.ok()) {
    EXPECT_EQ(EncodeExecCall(*call), bytes);
  }
  if (const auto answer = DecodeExecAnswer(bytes); answer.ok()) {
    EXPECT_EQ(EncodeExecAnswer(*answer), bytes);
  }
}

TEST(ExecMessageTest, FlippedBytesAndGarbageAreRefusedOrCanonical) {
  std::mt19937 random(1);
  std::vector<std::string> messages = SmallCalls();
  for (std::string& answer : SmallAnswers()) messages.push_back(std::move(answer));
  for (const std::string& good : messages) {
    for (int i = 0; i < 10'000; ++i) {
      std::string bad = good;
      bad[random() % bad.size()] = static_cast<char>(random());
      ExpectRefusedOrCanonical(bad);
    }
  }
  for (int i = 0; i < 10'000; ++i) {
    std::string garbage(random() % 64, '\0');
    for (char& c : garbage) c = static_cast<char>(random());
    ExpectRefusedOrCanonical(garbage);
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

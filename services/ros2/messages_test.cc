#include <functional>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/ros2/cdr.h"
#include "services/ros2/service_header.h"
#include "tests/support/ros2/server_messages.h"

namespace rips::ros2 {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

// Payloads below were recorded from ROS 2 Humble with system_modes 0.9 and rmw_cyclonedds 1.3.4.
constexpr char kChangeModeRequest[] =
    "00010000267421a790730c7501000000000000000c000000504552464f524d414e434500";
constexpr char kChangeModeReply[] = "00010000267421a790730c75010000000000000001000000";
constexpr char kGetModeRequest[] = "000100005f13811348447222010000000000000000000000";
constexpr char kGetModeReply[] =
    "000100005f1381134844722201000000000000000c000000504552464f524d414e434500";
constexpr char kGetAvailableModesReply[] =
    "000100007fd340276293a7d4010000000000000003000000090000004d4f444552415445000000000c000000"
    "504552464f524d414e4345000c0000005f5f44454641554c545f5f00";
constexpr char kChangeStateRequest[] =
    "00010000fcc376e564c6e19a0100000000000000010000000a000000636f6e666967757265000000";
constexpr char kChangeStateRefused[] = "00010000fcc376e564c6e19a060000000000000000000000";
// rt/parameter_events, body bytes 48..95: the value "none" from its integer_value on.
constexpr char kRecordedStringValue[] =
    "00000000000000000000000000000000050000006e6f6e650000000000000000000000000000000000000000"
    "00000000";

std::string Message(const char* recorded) {
  return SplitServiceHeader(absl::HexStringToBytes(recorded))->payload;
}

TEST(ServiceHeaderTest, RecordedRequestAndReplyCorrelate) {
  const auto request = SplitServiceHeader(absl::HexStringToBytes(kChangeModeRequest));
  const auto reply = SplitServiceHeader(absl::HexStringToBytes(kChangeModeReply));
  ASSERT_THAT(request, IsOk());
  ASSERT_THAT(reply, IsOk());
  EXPECT_EQ(request->header.client_id, 0x750c7390a7217426u);
  EXPECT_EQ(request->header.sequence, 1);
  EXPECT_EQ(request->header, reply->header);
}

TEST(ServiceHeaderTest, RoundTripInBothOrders) {
  const ServiceHeader header = {.client_id = 0x0102030405060708, .sequence = -3};
  for (ByteOrder order : {ByteOrder::kLittle, ByteOrder::kBig}) {
    CdrWriter writer(order);
    writer.U64(0x1122334455667788);
    const std::string payload = std::move(writer).Finish();
    const auto with = AddServiceHeader(payload, header);
    ASSERT_THAT(with, IsOk());
    EXPECT_EQ(with->size(), payload.size() + 16);
    const auto split = SplitServiceHeader(*with);
    ASSERT_THAT(split, IsOk());
    EXPECT_EQ(split->header, header);
    EXPECT_EQ(split->payload, payload);
  }
}

TEST(ServiceHeaderTest, ShortOrForeignPayloads) {
  const std::string whole = absl::HexStringToBytes(kChangeModeRequest);
  for (size_t size = 0; size < 20; ++size) {
    EXPECT_THAT(SplitServiceHeader(whole.substr(0, size)), StatusIs(absl::StatusCode::kDataLoss));
  }
  EXPECT_THAT(AddServiceHeader("", {}), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(AddServiceHeader(std::string("\0\7\0\0\0\0\0\0", 8), {}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("0x0007")));
}

TEST(SystemModesTest, RecordedMessages) {
  EXPECT_EQ(*DecodeChangeModeRequest(Message(kChangeModeRequest)), "PERFORMANCE");
  EXPECT_EQ(*DecodeSuccessReply(Message(kChangeModeReply)), true);
  EXPECT_THAT(DecodeEmptyRequest(Message(kGetModeRequest)), IsOk());
  EXPECT_EQ(*DecodeGetModeReply(Message(kGetModeReply)), "PERFORMANCE");
  EXPECT_THAT(*DecodeGetAvailableModesReply(Message(kGetAvailableModesReply)),
              ElementsAre("MODERATE", "PERFORMANCE", "__DEFAULT__"));
  EXPECT_EQ(*DecodeChangeStateRequest(Message(kChangeStateRequest)),
            (LifecycleLabel{1, "configure"}));
  EXPECT_EQ(*DecodeSuccessReply(Message(kChangeStateRefused)), false);
}

TEST(SystemModesTest, EncodesAsRecorded) {
  const auto with_header = [](const std::string& payload, const char* recorded) {
    const auto header = SplitServiceHeader(absl::HexStringToBytes(recorded))->header;
    return absl::BytesToHexString(*AddServiceHeader(payload, header));
  };
  EXPECT_EQ(with_header(EncodeChangeModeRequest("PERFORMANCE"), kChangeModeRequest),
            kChangeModeRequest);
  EXPECT_EQ(with_header(EncodeSuccessReply(true), kChangeModeReply), kChangeModeReply);
  EXPECT_EQ(with_header(EncodeEmptyRequest(), kGetModeRequest), kGetModeRequest);
  EXPECT_EQ(with_header(EncodeGetModeReply("PERFORMANCE"), kGetModeReply), kGetModeReply);
  EXPECT_EQ(with_header(EncodeGetAvailableModesReply({"MODERATE", "PERFORMANCE", "__DEFAULT__"}),
                        kGetAvailableModesReply),
            kGetAvailableModesReply);
  EXPECT_EQ(with_header(EncodeChangeStateRequest({1, "configure"}), kChangeStateRequest),
            kChangeStateRequest);
}

TEST(SystemModesTest, GetStateRoundTrip) {
  const LifecycleLabel state = {3, "active"};
  EXPECT_EQ(*DecodeGetStateReply(EncodeGetStateReply(state)), state);
}

TEST(SystemModesTest, TooManyModes) {
  const std::vector<std::string> modes(kModesMax + 1, "m");
  EXPECT_THAT(DecodeGetAvailableModesReply(EncodeGetAvailableModesReply(modes)),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("limit 1024")));
  EXPECT_EQ(
      DecodeGetAvailableModesReply(EncodeGetAvailableModesReply({modes.begin(), modes.end() - 1}))
          ->size(),
      kModesMax);
}

const std::vector<ParameterValue>& AllTypes() {
  static const auto& values = *new std::vector<ParameterValue>{std::monostate(),
                                                               true,
                                                               int64_t{-7},
                                                               0.25,
                                                               std::string("text"),
                                                               ByteArray{std::string("\0\xff", 2)},
                                                               std::vector<bool>{true, false},
                                                               std::vector<int64_t>{1, -2},
                                                               std::vector<double>{0.5},
                                                               std::vector<std::string>{"a", ""}};
  return values;
}

TEST(ParametersTest, EveryTypeRoundTrips) {
  EXPECT_EQ(*DecodeGetParametersReply(EncodeGetParametersReply(AllTypes())), AllTypes());
  EXPECT_EQ(*DecodeGetParametersReply(EncodeGetParametersReply({})), std::vector<ParameterValue>());
  EXPECT_THAT(*DecodeGetParametersRequest(EncodeGetParametersRequest({"max_speed", "x"})),
              ElementsAre("max_speed", "x"));
}

TEST(ParametersTest, RecordedValue) {
  // The recorded value stands at an offset that differs by a multiple of 8 from its place here.
  const std::string payload = absl::HexStringToBytes(
      absl::StrCat("00010000", "01000000", "04000000", kRecordedStringValue));
  const auto values = DecodeGetParametersReply(payload);
  ASSERT_THAT(values, IsOk());
  ASSERT_EQ(values->size(), 1u);
  EXPECT_EQ((*values)[0], ParameterValue(std::string("none")));
  EXPECT_EQ(absl::BytesToHexString(EncodeGetParametersReply(*values)),
            absl::BytesToHexString(payload));
}

TEST(ParametersTest, TextForms) {
  std::vector<std::string> texts;
  for (const ParameterValue& value : AllTypes()) texts.push_back(ToString(value));
  EXPECT_THAT(texts, ElementsAre("not set", "true", "-7", "0.25", "text", "00ff", "[true, false]",
                                 "[1, -2]", "[0.5]", "[a, ]"));
}

TEST(ParametersTest, UnknownTypeAndLimits) {
  std::string payload = EncodeGetParametersReply({ParameterValue(true)});
  payload[8] = 10;
  EXPECT_THAT(DecodeGetParametersReply(payload),
              StatusIs(absl::StatusCode::kDataLoss, "parameter type 10 exceeds 9"));
  const std::vector<std::string> names(kParametersMax + 1, "n");
  EXPECT_THAT(DecodeGetParametersRequest(EncodeGetParametersRequest(names)),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("limit 1024")));
  const std::vector<bool> elements(kParameterElementsMax + 1, true);
  EXPECT_THAT(DecodeGetParametersReply(EncodeGetParametersReply({elements})),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("limit 65536")));
}

// Every decoder refuses every proper prefix that lacks more than padding.
TEST(MessagesTest, TruncationAtEveryByte) {
  struct Case {
    std::string payload;
    size_t padding;
    std::function<absl::Status(absl::string_view)> decode;
  };
  const Case cases[] = {
      {EncodeEmptyRequest(), 3, DecodeEmptyRequest},
      {EncodeChangeModeRequest("ALERT"), 2,
       [](absl::string_view p) { return DecodeChangeModeRequest(p).status(); }},
      {EncodeSuccessReply(true), 3,
       [](absl::string_view p) { return DecodeSuccessReply(p).status(); }},
      {EncodeGetModeReply("ALERT"), 2,
       [](absl::string_view p) { return DecodeGetModeReply(p).status(); }},
      {EncodeGetAvailableModesReply({"A", "BCD"}), 0,
       [](absl::string_view p) { return DecodeGetAvailableModesReply(p).status(); }},
      {EncodeGetStateReply({3, "active"}), 1,
       [](absl::string_view p) { return DecodeGetStateReply(p).status(); }},
      {EncodeChangeStateRequest({3, "activate"}), 3,
       [](absl::string_view p) { return DecodeChangeStateRequest(p).status(); }},
      {EncodeGetParametersRequest({"abc", "d"}), 2,
       [](absl::string_view p) { return DecodeGetParametersRequest(p).status(); }},
      {EncodeGetParametersReply(AllTypes()), 3,
       [](absl::string_view p) { return DecodeGetParametersReply(p).status(); }},
  };
  for (size_t i = 0; i < std::size(cases); ++i) {
    const Case& c = cases[i];
    for (size_t size = 0; size <= c.payload.size(); ++size) {
      const std::string cut = c.payload.substr(0, size);
      EXPECT_EQ(c.decode(cut).ok(), size + c.padding >= c.payload.size()) << i << " at " << size;
    }
    EXPECT_FALSE(c.decode(c.payload + "abcd").ok()) << i;
  }
}

TEST(SetParametersTest, RoundTrips) {
  const std::vector<NamedParameter> parameters = {{"speed", 0.2},
                                                  {"limits.gear", int64_t{2}},
                                                  {"on", true},
                                                  {"name", std::string("x")},
                                                  {"", {}}};
  const std::string request = EncodeSetParametersRequest(parameters);
  const auto decoded = DecodeSetParametersRequest(request);
  ASSERT_THAT(decoded, IsOk());
  EXPECT_EQ(*decoded, parameters);
  for (const SetParametersResult& result :
       {SetParametersResult{true, ""}, SetParametersResult{false, "not declared"}}) {
    const auto reply = DecodeSetParametersReply(EncodeSetParametersReply(result));
    ASSERT_THAT(reply, IsOk());
    EXPECT_EQ(*reply, result);
  }
}

TEST(SetParametersTest, WhatIsCutOrTooMuchIsRefused) {
  const std::string request = EncodeSetParametersRequest({{"speed", 0.2}, {"gear", int64_t{1}}});
  for (size_t length = 0; length < request.size(); ++length) {
    EXPECT_FALSE(DecodeSetParametersRequest(request.substr(0, length)).ok()) << length;
  }
  const std::string reply = EncodeSetParametersReply({false, "not"});  // ends without padding
  for (size_t length = 0; length < reply.size(); ++length) {
    EXPECT_FALSE(DecodeSetParametersReply(reply.substr(0, length)).ok()) << length;
  }
  std::vector<NamedParameter> many(kParametersMax);
  EXPECT_THAT(DecodeSetParametersRequest(EncodeSetParametersRequest(many)), IsOk());
  many.emplace_back();
  EXPECT_FALSE(DecodeSetParametersRequest(EncodeSetParametersRequest(many)).ok());
}

}  // namespace
}  // namespace rips::ros2

#include "mode_actuator/steps/alarm/frames.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr AlarmState kOff = {AlarmPattern::kOff, {}};
constexpr AlarmState kSteadyGreen = {AlarmPattern::kSteady, {0, 0xff, 0}};
constexpr AlarmState kStrobeRed = {AlarmPattern::kStrobe, {0xff, 0, 0}};
constexpr AlarmState kPolice = {AlarmPattern::kPolice, {}};

// --- states

TEST(AlarmStateTest, EveryStateIsReadAsWritten) {
  for (const auto& [name, kind] : AlarmKinds()) {
    EXPECT_EQ(AlarmKindName(kind), name);
    for (const AlarmState& state : AlarmStatesOf(kind)) {
      const auto parsed = ParseAlarmState(kind, ToString(state));
      ASSERT_THAT(parsed, IsOk()) << ToString(state);
      EXPECT_EQ(*parsed, state);
    }
  }
  EXPECT_EQ(AlarmStatesOf(AlarmKind::kUsbRelay).size(), 2u);
  EXPECT_EQ(AlarmStatesOf(AlarmKind::kBlink1).size(), 18u);
  EXPECT_EQ(ToString(kStrobeRed), "strobe RED");
  EXPECT_EQ(ToString({AlarmPattern::kSteady, {10, 20, 30}}), "steady #0a141e");
}

TEST(AlarmStateTest, AnUnknownStateIsToldWithTheNearest) {
  const struct {
    AlarmKind kind;
    std::string text;
    const char* nearest;
  } kCases[] = {
      {AlarmKind::kUsbRelay, "ON", "did you mean `on`"},
      {AlarmKind::kLcus, "true", "no state of a lcus"},
      {AlarmKind::kUsbRelay, "steady RED", "no state of a usb_relay"},
      {AlarmKind::kLuxafor, "steady red", "did you mean `steady RED`"},
      {AlarmKind::kLuxafor, "strobe", "did you mean `strobe RED`"},
      {AlarmKind::kBlink1, "steady GREN", "did you mean `steady GREEN`"},
      {AlarmKind::kBlink1, "polise", "did you mean `police`"},
      {AlarmKind::kBlink1, "", "no state of a blink1"},
      {AlarmKind::kBlink1, "of\n", "`of\\n` is no state of a blink1; did you mean `off`"},
      {AlarmKind::kBlink1, std::string(100000, 'x'), "no state of a blink1"},
  };
  for (const auto& test : kCases) {
    EXPECT_THAT(ParseAlarmState(test.kind, test.text),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(test.nearest)));
  }
}

// --- V-USB relay board

Frame RelayReport(const std::string& id, uint8_t relays) {
  Frame report(kUsbRelayFrameBytes);
  for (size_t i = 0; i < id.size() && i < 5; ++i) report[1 + i] = static_cast<uint8_t>(id[i]);
  report[8] = relays;
  return report;
}

TEST(UsbRelayFrameTest, NamesTheRelayAndItsState) {
  EXPECT_THAT(UsbRelayFrame(1, true), ElementsAre(0, 0xff, 1, 0, 0, 0, 0, 0, 0));
  EXPECT_THAT(UsbRelayFrame(8, false), ElementsAre(0, 0xfd, 8, 0, 0, 0, 0, 0, 0));
}

TEST(UsbRelayFrameTest, ReadsIdAndRelays) {
  const auto status = DecodeUsbRelayStatus(RelayReport("A1B2C", 0x81));
  ASSERT_THAT(status, IsOk());
  EXPECT_EQ(status->id, "A1B2C");
  EXPECT_EQ(status->relays, 0x81);
  EXPECT_EQ(DecodeUsbRelayStatus(RelayReport("AB", 0))->id, "AB");
}

TEST(UsbRelayFrameTest, RefusesWhatABoardDoesNotAnswer) {
  const Frame good = RelayReport("A1B2C", 1);
  for (size_t length = 0; length < good.size(); ++length) {
    EXPECT_THAT(DecodeUsbRelayStatus(std::span(good).first(length)),
                StatusIs(absl::StatusCode::kDataLoss))
        << length;
  }
  Frame longer = good;
  longer.push_back(0);
  EXPECT_THAT(DecodeUsbRelayStatus(longer), StatusIs(absl::StatusCode::kDataLoss));
  Frame numbered = good;
  numbered[0] = 1;
  EXPECT_THAT(DecodeUsbRelayStatus(numbered), StatusIs(absl::StatusCode::kDataLoss));
  EXPECT_THAT(DecodeUsbRelayStatus(Frame(kUsbRelayFrameBytes)),
              StatusIs(absl::StatusCode::kDataLoss));
  EXPECT_THAT(DecodeUsbRelayStatus(RelayReport("A\x1b[2J", 0)),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("9 bytes `00411b")));
}

TEST(UsbRelayFrameTest, OnlyTheProductStringTellsARelayBoard) {
  EXPECT_EQ(UsbRelayCount("USBRelay1"), 1);
  EXPECT_EQ(UsbRelayCount("USBRelay8"), 8);
  for (const char* other : {"", "USBRelay", "USBRelay0", "USBRelay9", "USBRelay10", "usbrelay2",
                            "Keyboard", "USBRelayA"}) {
    EXPECT_EQ(UsbRelayCount(other), std::nullopt) << other;
  }
}

// --- LCUS

TEST(LcusFrameTest, CarriesTheSumOfItsBytes) {
  EXPECT_THAT(LcusFrame(1, true), ElementsAre(0xa0, 1, 1, 0xa2));
  EXPECT_THAT(LcusFrame(1, false), ElementsAre(0xa0, 1, 0, 0xa1));
  EXPECT_THAT(LcusFrame(8, true), ElementsAre(0xa0, 8, 1, 0xa9));
}

TEST(LcusFrameTest, ReadsBothFormsOfAnswer) {
  for (const char* text :
       {"CH1: ON \r\nCH2:OFF\r\n", "CH1:ON\nCH2: OFF", "ch1:on\r\nch2:off\r\n"}) {
    const auto relays = DecodeLcusStatus(text);
    ASSERT_THAT(relays, IsOk()) << text;
    EXPECT_THAT(*relays, ElementsAre(true, false));
  }
  const auto bytes = DecodeLcusStatus(absl::string_view("\x00\x01\x00\x01", 4));
  ASSERT_THAT(bytes, IsOk());
  EXPECT_THAT(*bytes, ElementsAre(false, true, false, true));
}

TEST(LcusFrameTest, RefusesWhatABoardDoesNotAnswer) {
  std::string nine;
  for (int i = 1; i <= 9; ++i) absl::StrAppend(&nine, "CH", i, ":ON\r\n");
  for (const std::string& text :
       {std::string(), std::string("\r\n"), std::string("ON"), std::string("CH1"),
        std::string("CH1:MAYBE"), std::string("CH2:ON"), std::string("CH1:ON\r\nCH3:ON"),
        std::string("CH1:ON\r\nCH1:ON"), std::string("CH1:ON\r\ngarbage"), std::string("\x02"),
        std::string("\x01\x07", 2), std::string(9, '\0'), nine, std::string(100000, 'C')}) {
    EXPECT_THAT(DecodeLcusStatus(text), StatusIs(absl::StatusCode::kDataLoss))
        << text.substr(0, 40);
  }
}

// --- Luxafor

TEST(LuxaforFrameTest, MapsEachPattern) {
  EXPECT_THAT(LuxaforFrame(kOff), ElementsAre(0, 1, 0xff, 0, 0, 0, 0, 0, 0));
  EXPECT_THAT(LuxaforFrame(kSteadyGreen), ElementsAre(0, 1, 0xff, 0, 0xff, 0, 0, 0, 0));
  EXPECT_THAT(LuxaforFrame(kStrobeRed), ElementsAre(0, 3, 0xff, 0xff, 0, 0, 10, 0, 0));
  EXPECT_THAT(LuxaforFrame(kPolice), ElementsAre(0, 6, 5, 0, 0, 0, 0, 0, 0));
}

// --- blink(1)

TEST(Blink1FrameTest, AColourStopsThePatternFirst) {
  EXPECT_THAT(Blink1Frames(kSteadyGreen), ElementsAre(ElementsAre(1, 'p', 0, 0, 1, 0, 0, 0, 0),
                                                      ElementsAre(1, 'n', 0, 0xff, 0, 0, 0, 0, 0)));
  EXPECT_THAT(Blink1Frames(kOff)[1], ElementsAre(1, 'n', 0, 0, 0, 0, 0, 0, 0));
}

TEST(Blink1FrameTest, AStrobeIsTwoLinesThatTheLightPlaysByItself) {
  EXPECT_THAT(Blink1Frames(kStrobeRed), ElementsAre(ElementsAre(1, 'P', 0xff, 0, 0, 0, 25, 0, 0),
                                                    ElementsAre(1, 'P', 0, 0, 0, 0, 25, 1, 0),
                                                    ElementsAre(1, 'p', 1, 0, 1, 0, 0, 0, 0)));
  EXPECT_THAT(Blink1Frames(kPolice)[1], ElementsAre(1, 'P', 0, 0, 0xff, 0, 25, 1, 0));
}

TEST(Blink1FrameTest, TellsTheStateFromTheAnswers) {
  const Colour dark, red = {0xff, 0, 0}, blue = {0, 0, 0xff}, green = {0, 0xff, 0};
  const Blink1Playing still, loop = {true, 0, 1};
  EXPECT_EQ(Blink1State(still, dark, {}), kOff);
  EXPECT_EQ(Blink1State(still, green, {}), kSteadyGreen);
  EXPECT_EQ(Blink1State(loop, dark, std::vector<Colour>{red, dark}), kStrobeRed);
  EXPECT_EQ(Blink1State(loop, dark, std::vector<Colour>{red, blue}), kPolice);
  EXPECT_EQ(Blink1State(loop, dark, std::vector<Colour>{red, green}), std::nullopt);
  EXPECT_EQ(Blink1State(loop, dark, std::vector<Colour>{dark, dark}), std::nullopt);
  EXPECT_EQ(Blink1State(loop, dark, std::vector<Colour>{red}), std::nullopt);
  EXPECT_EQ(Blink1State({true, 0, 31}, dark, std::vector<Colour>{red, dark}), std::nullopt);
}

TEST(Blink1FrameTest, AnAnswerToAnotherQuestionIsNone) {
  const Frame playing = {1, 'S', 1, 0, 1, 0, 0, 0, 0};
  const auto decoded = DecodeBlink1Playing(playing);
  ASSERT_THAT(decoded, IsOk());
  EXPECT_TRUE(decoded->playing);
  EXPECT_EQ(decoded->last, 1);
  EXPECT_THAT(DecodeBlink1Colour(Blink1AskColour(), playing),
              StatusIs(absl::StatusCode::kDataLoss));
  EXPECT_THAT(DecodeBlink1Playing(Blink1AskColour()), StatusIs(absl::StatusCode::kDataLoss));
  EXPECT_THAT(DecodeBlink1Playing({{1, 'S', 2, 0, 1, 0, 0, 0, 0}}),
              StatusIs(absl::StatusCode::kDataLoss));
  for (size_t length = 0; length + 1 < playing.size(); ++length) {
    EXPECT_THAT(DecodeBlink1Playing(std::span(playing).first(length)),
                StatusIs(absl::StatusCode::kDataLoss))
        << length;
  }
  const auto colour = DecodeBlink1Colour(Blink1AskLine(1), Frame{1, 'R', 9, 8, 7, 0, 25, 1, 0});
  ASSERT_THAT(colour, IsOk());
  EXPECT_EQ(*colour, (Colour{9, 8, 7}));
}

}  // namespace
}  // namespace rips::actuator

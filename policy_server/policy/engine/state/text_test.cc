#include "policy_server/policy/engine/state/text.h"

#include <cmath>
#include <cstdlib>
#include <limits>
#include <random>

#include "gmock/gmock.h"

namespace rips::engine {
namespace {

TEST(TextTest, FormatsFloatsInTheShortestForm) {
  const struct {
    double value;
    const char* text;
  } kCases[] = {
      {0, "0"},
      {-0.0, "-0"},
      {1, "1"},
      {-1.5, "-1.5"},
      {0.1, "0.1"},
      {0.1 + 0.2, "0.30000000000000004"},
      {100, "100"},
      {123456789, "123456789"},
      {0.0001, "0.0001"},
      {0.00012, "0.00012"},
      {0.00009, "9e-05"},
      {1.5e-7, "1.5e-07"},
      {1e20, "100000000000000000000"},
      {123456789012345680000.0, "123456789012345680000"},
      {1e21, "1e+21"},
      {-1.25e22, "-1.25e+22"},
      {1e100, "1e+100"},
      {5e-324, "5e-324"},
      {1.7976931348623157e308, "1.7976931348623157e+308"},
      {std::numeric_limits<double>::infinity(), "+Inf"},
      {-std::numeric_limits<double>::infinity(), "-Inf"},
      {std::numeric_limits<double>::quiet_NaN(), "NaN"},
  };
  for (const auto& c : kCases) EXPECT_EQ(FormatFloat(c.value), c.text);
}

TEST(TextTest, FloatsReadBack) {
  std::mt19937_64 random(7);
  for (int i = 0; i < 10'000; ++i) {
    const double value =
        std::ldexp(static_cast<double>(random()), static_cast<int>(random() % 200) - 160);
    EXPECT_EQ(std::strtod(FormatFloat(value).c_str(), nullptr), value) << FormatFloat(value);
  }
}

TEST(TextTest, CutsAtCodePoints) {
  EXPECT_EQ(CutCodePoints("", 0), "");
  EXPECT_EQ(CutCodePoints("abc", 3), "abc");
  EXPECT_EQ(CutCodePoints("abc", 2), "ab");
  EXPECT_EQ(CutCodePoints("äöü", 2), "äö");
  EXPECT_EQ(CutCodePoints("äöü", 3), "äöü");
  EXPECT_EQ(CutCodePoints("→↛x", 1), "→");
  EXPECT_EQ(CutCodePoints("😀😀", 1), "😀");
}

TEST(TextTest, CountsBrokenBytesOneEach) {
  // A lone continuation, a start without its rest, an overlong form, a surrogate, above 10FFFF.
  for (const char* broken : {"\x80", "\xC3", "\xC0\x80", "\xE0\x80\x80", "\xED\xA0\x80",
                             "\xF4\x90\x80\x80", "\xF5\x80\x80\x80", "\xFF"}) {
    const std::string text = std::string(broken) + "z";
    EXPECT_EQ(CutCodePoints(text, 1), absl::string_view(broken, 1)) << text;
    EXPECT_EQ(CutCodePoints(text, text.size()), text);
    EXPECT_EQ(CutCodePoints(text, text.size() - 1).size(), text.size() - 1);
  }
}

}  // namespace
}  // namespace rips::engine

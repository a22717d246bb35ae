#include "policy_server/policy/lang/value_text.h"

#include <charconv>
#include <cmath>
#include <cstdlib>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace rips::lang {
namespace {

constexpr int kExponentMin = -4;
constexpr int kExponentMax = 20;

}  // namespace

std::string FormatFloat(double value) {
  if (std::isnan(value)) return "NaN";
  if (std::isinf(value)) return value > 0 ? "+Inf" : "-Inf";
  char buffer[64];
  const auto end =
      std::to_chars(buffer, buffer + sizeof(buffer), value, std::chars_format::scientific);
  const absl::string_view scientific(buffer, end.ptr - buffer);
  const size_t e = scientific.find('e');
  int exponent = 0;
  (void)absl::SimpleAtoi(scientific.substr(e + 1), &exponent);
  if (exponent < kExponentMin || exponent > kExponentMax) return std::string(scientific);

  // Digits without sign and point; the point belongs after digits[exponent].
  std::string digits;
  for (const char c : scientific.substr(0, e)) {
    if (c != '-' && c != '.') digits.push_back(c);
  }
  const std::string sign = std::signbit(value) ? "-" : "";
  if (exponent < 0) return absl::StrCat(sign, "0.", std::string(-exponent - 1, '0'), digits);
  const size_t whole = static_cast<size_t>(exponent) + 1;
  if (digits.size() <= whole)
    return absl::StrCat(sign, digits, std::string(whole - digits.size(), '0'));
  return absl::StrCat(sign, digits.substr(0, whole), ".", digits.substr(whole));
}

std::string ToText(const Value& value) {
  if (const auto* integer = std::get_if<int64_t>(&value)) return absl::StrCat(*integer);
  if (const auto* floating = std::get_if<double>(&value)) return FormatFloat(*floating);
  if (const auto* boolean = std::get_if<bool>(&value)) return *boolean ? "true" : "false";
  return std::get<std::string>(value);
}

}  // namespace rips::lang

#include "services/ros2/parameter_messages.h"

#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/base/status_macros.h"
#include "services/ros2/cdr.h"

namespace rips::ros2 {
namespace {

constexpr uint8_t kParameterTypeMax = 9;

static_assert(std::variant_size_v<ParameterValue> == kParameterTypeMax + 1);

template <typename T>
T As(const ParameterValue& value) {
  const T* held = std::get_if<T>(&value);
  return held == nullptr ? T() : *held;
}

template <typename T, typename Read>
std::vector<T> ReadArray(CdrReader& reader, size_t element_bytes_min, Read read) {
  std::vector<T> elements;
  const uint32_t count = reader.Count(element_bytes_min, kParameterElementsMax);
  elements.reserve(count);
  for (uint32_t i = 0; i < count && reader.ok(); ++i) elements.push_back(read());
  return elements;
}

std::string Text(std::monostate) { return "not set"; }
std::string Text(bool value) { return value ? "true" : "false"; }
std::string Text(int64_t value) { return absl::StrCat(value); }
std::string Text(double value) { return absl::StrCat(value); }
std::string Text(const std::string& value) { return value; }
std::string Text(const ByteArray& value) { return absl::BytesToHexString(value.bytes); }
template <typename T>
std::string Text(const std::vector<T>& values) {
  return absl::StrCat(
      "[",
      absl::StrJoin(values, ", ",
                    [](std::string* out, const T& value) { absl::StrAppend(out, Text(value)); }),
      "]");
}

}  // namespace

// Every member is on the wire, whichever of them `type` makes count.
void WriteParameterValue(const ParameterValue& value, CdrWriter& writer) {
  writer.U8(static_cast<uint8_t>(value.index()));
  writer.Bool(As<bool>(value));
  writer.I64(As<int64_t>(value));
  writer.F64(As<double>(value));
  writer.String(As<std::string>(value));
  const ByteArray octets = As<ByteArray>(value);
  writer.U32(static_cast<uint32_t>(octets.bytes.size()));
  writer.Octets(octets.bytes);
  const auto bools = As<std::vector<bool>>(value);
  writer.U32(static_cast<uint32_t>(bools.size()));
  for (bool element : bools) writer.Bool(element);
  const auto integers = As<std::vector<int64_t>>(value);
  writer.U32(static_cast<uint32_t>(integers.size()));
  for (int64_t element : integers) writer.I64(element);
  const auto doubles = As<std::vector<double>>(value);
  writer.U32(static_cast<uint32_t>(doubles.size()));
  for (double element : doubles) writer.F64(element);
  const auto strings = As<std::vector<std::string>>(value);
  writer.U32(static_cast<uint32_t>(strings.size()));
  for (const std::string& element : strings) writer.String(element);
}

ParameterValue ReadParameterValue(CdrReader& reader) {
  const uint8_t type = reader.U8();
  const bool boolean = reader.Bool();
  const int64_t integer = reader.I64();
  const double real = reader.F64();
  std::string text(reader.String());
  ByteArray octets{std::string(reader.Octets(reader.Count(1, kParameterElementsMax)))};
  auto bools = ReadArray<bool>(reader, 1, [&] { return reader.Bool(); });
  auto integers = ReadArray<int64_t>(reader, 8, [&] { return reader.I64(); });
  auto doubles = ReadArray<double>(reader, 8, [&] { return reader.F64(); });
  auto strings = ReadArray<std::string>(reader, kCdrStringBytesMin,
                                        [&] { return std::string(reader.String()); });
  switch (type) {
    case 0:
      return std::monostate();
    case 1:
      return boolean;
    case 2:
      return integer;
    case 3:
      return real;
    case 4:
      return text;
    case 5:
      return octets;
    case 6:
      return bools;
    case 7:
      return integers;
    case 8:
      return doubles;
    case kParameterTypeMax:
      return strings;
    default:
      reader.Fail(absl::StrCat("parameter type ", type, " exceeds ", kParameterTypeMax));
      return std::monostate();
  }
}

std::string EncodeGetParametersRequest(const std::vector<std::string>& names) {
  CdrWriter writer;
  writer.U32(static_cast<uint32_t>(names.size()));
  for (const std::string& name : names) writer.String(name);
  return std::move(writer).Finish();
}

absl::StatusOr<std::vector<ParameterValue>> DecodeGetParametersReply(absl::string_view payload) {
  CdrReader reader(payload);
  std::vector<ParameterValue> values;
  const uint32_t count = reader.Count(kParameterValueBytesMin, kParametersMax);
  for (uint32_t i = 0; i < count && reader.ok(); ++i) values.push_back(ReadParameterValue(reader));
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return values;
}

std::string EncodeSetParametersRequest(const std::vector<NamedParameter>& parameters) {
  CdrWriter writer;
  writer.U32(static_cast<uint32_t>(parameters.size()));
  for (const NamedParameter& parameter : parameters) {
    writer.String(parameter.name);
    WriteParameterValue(parameter.value, writer);
  }
  return std::move(writer).Finish();
}

absl::StatusOr<SetParametersResult> DecodeSetParametersReply(absl::string_view payload) {
  CdrReader reader(payload);
  SetParametersResult result;
  result.successful = reader.Bool();
  result.reason = std::string(reader.String());
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return result;
}

std::string ToString(const ParameterValue& value) {
  return std::visit([](const auto& held) { return Text(held); }, value);
}

}  // namespace rips::ros2

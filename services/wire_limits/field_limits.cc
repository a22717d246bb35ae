#include "services/wire_limits/field_limits.h"

#include <iterator>
#include <memory>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "google/protobuf/descriptor.h"
#include "google/protobuf/unknown_field_set.h"
#include "rips/v1/observation.pb.h"
#include "services/base/check.h"
#include "services/base/cut_text.h"
#include "services/base/payload_limits.h"

namespace rips::wire_limits {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::Reflection;
using What = LimitHit::What;

constexpr FieldLimit kRows[] = {
#define TEXT(field, bytes) {field, 1, bytes, true},
#define TEXTS(field, count, bytes) {field, count, bytes, true},
#define EXACT(field, bytes) {field, 1, bytes, false},
#define EXACTS(field, count, bytes) {field, count, bytes, false},
#define LIST(field, count) {field, count, kAnyValue, false},
#define TIME(field) {field, 1, kTimeMax, false},
#define NUMBER(field, most) {field, 1, most, false},
#define COUNT(field, most) {field, 1, most, true},
#define ANY(field) {field, 1, kAnyValue, false},
#include "services/wire_limits/field_limits.def"
    {kUnknownFields, kUnknownFieldsMax, kAnyValue, false},
    {kParsedSize, 1, kParsedBytesMax, false},
#undef TEXT
#undef TEXTS
#undef EXACT
#undef EXACTS
#undef LIST
#undef TIME
#undef NUMBER
#undef COUNT
#undef ANY
};

constexpr size_t kNoRow = std::size(kRows);

constexpr bool Same(const char* a, const char* b) {
  while (*a != 0 && *a == *b) ++a, ++b;
  return *a == *b;
}

constexpr size_t RowOf(const char* field) {
  size_t row = 0;
  while (row < kNoRow && !Same(kRows[row].field, field)) ++row;
  return row;
}

constexpr size_t kUnknownRow = RowOf(kUnknownFields);
constexpr size_t kParsedSizeRow = RowOf(kParsedSize);

// What has to be looked at in one kind of message.
struct Plan {
  struct Field {
    const FieldDescriptor* descriptor;
    size_t row;          // kNoRow: only what is in it is limited
    const Plan* inside;  // of a message; else null
    bool observations;   // those of an ObservationBatch
  };
  std::vector<Field> fields;
};

absl::string_view ShortName(absl::string_view full_name) {
  return full_name.substr(full_name.rfind('.') + 1);
}

// Of all kinds of messages in the files that peers and servers speak.
class Plans {
 public:
  Plans() {
    const auto* pool = google::protobuf::DescriptorPool::generated_pool();
    for (const char* name :
         {"session", "observation", "sensor", "command", "actuator", "operator", "enrolment"}) {
      // Null if this program uses none of its messages.
      const auto* file = pool->FindFileByName(absl::StrCat("rips/v1/", name, ".proto"));
      for (int i = 0; file != nullptr && i < file->message_type_count(); ++i) {
        Make(file->message_type(i));
      }
    }
  }

  static const Plan& Of(const Descriptor* type) {
    static const Plans* const kPlans = new Plans();
    const auto known = kPlans->plans_.find(type);
    RIPS_CHECK(known != kPlans->plans_.end(), "a message that no peer sends");
    return *known->second;
  }

 private:
  const Plan* Make(const Descriptor* type) {
    const auto known = plans_.find(type);
    if (known != plans_.end()) return known->second.get();
    Plan* plan = (plans_[type] = std::make_unique<Plan>()).get();
    for (int i = 0; i < type->field_count(); ++i) {
      const FieldDescriptor* field = type->field(i);
      const std::string name = absl::StrCat(ShortName(type->full_name()), ".", field->name());
      size_t row = RowOf(name.c_str());
      const bool any = row != kNoRow && kRows[row].value_max == kAnyValue;
      if (any && !field->is_repeated()) row = kNoRow;
      const Plan* inside = nullptr;
      if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
        inside = Make(field->message_type());
      }
      if (row != kNoRow || inside != nullptr)
        plan->fields.push_back({field, row, inside, name == "ObservationBatch.observations"});
    }
    return plan;
  }

  absl::flat_hash_map<const Descriptor*, std::unique_ptr<Plan>> plans_;
};

std::optional<LimitHit> CheckBytes(size_t row, size_t bytes) {
  if (bytes <= kRows[row].value_max) return std::nullopt;
  return LimitHit{row, bytes, What::kBytes};
}

std::optional<LimitHit> CheckNumber(size_t row, uint64_t value) {
  if (value <= kRows[row].value_max) return std::nullopt;
  return LimitHit{row, value, What::kValue};
}

// Stops counting past the limit.
size_t CountUnknown(const google::protobuf::UnknownFieldSet& unknown) {
  auto count = static_cast<size_t>(unknown.field_count());
  for (int i = 0; i < unknown.field_count() && count <= kUnknownFieldsMax; ++i) {
    const google::protobuf::UnknownField& field = unknown.field(i);
    if (field.type() == google::protobuf::UnknownField::TYPE_GROUP) {
      count += CountUnknown(field.group());
    }
  }
  return count;
}

std::optional<LimitHit> CheckUnknown(const google::protobuf::UnknownFieldSet& unknown) {
  if (unknown.empty()) return std::nullopt;
  const size_t count = CountUnknown(unknown);
  if (count <= kUnknownFieldsMax) return std::nullopt;
  return LimitHit{kUnknownRow, count, What::kElements};
}

// Messages come a hundred thousand a second: without reflection. field_limits_test tries each row
// of these fields through here.
std::optional<LimitHit> CheckMessageSeen(const v1::Observation& observation) {
  constexpr size_t kOffset = RowOf("Observation.offset_ns");
  constexpr size_t kPayload = RowOf("MessageSeen.payload");
  constexpr size_t kChunked = RowOf("MessageSeen.chunked_payload_id");
  constexpr size_t kVersion = RowOf("MessageSeen.graph_version");
  static_assert(kOffset < kNoRow && kPayload < kNoRow && kChunked < kNoRow && kVersion < kNoRow);
  const v1::MessageSeen& message = observation.message();
  static const Reflection& of_observation = *v1::Observation::default_instance().GetReflection();
  static const Reflection& of_message = *v1::MessageSeen::default_instance().GetReflection();
  if (auto hit = CheckUnknown(of_observation.GetUnknownFields(observation))) return hit;
  if (auto hit = CheckUnknown(of_message.GetUnknownFields(message))) return hit;
  if (auto hit = CheckNumber(kOffset, observation.offset_ns())) return hit;
  if (auto hit = CheckBytes(kPayload, message.payload().size())) return hit;
  if (auto hit = CheckNumber(kChunked, message.chunked_payload_id())) return hit;
  return CheckNumber(kVersion, message.graph_version());
}

std::optional<LimitHit> CheckValue(const Message& message, const Reflection& reflection,
                                   const Plan::Field& field) {
  switch (field.descriptor->cpp_type()) {
    case FieldDescriptor::CPPTYPE_STRING: {
      std::string scratch;
      return CheckBytes(field.row,
                        reflection.GetStringReference(message, field.descriptor, &scratch).size());
    }
    case FieldDescriptor::CPPTYPE_UINT64:
      return CheckNumber(field.row, reflection.GetUInt64(message, field.descriptor));
    case FieldDescriptor::CPPTYPE_INT64: {
      const int64_t value = reflection.GetInt64(message, field.descriptor);
      if (value < 0) return LimitHit{field.row, 0, What::kNegative};
      return CheckNumber(field.row, static_cast<uint64_t>(value));
    }
    default:
      return std::nullopt;
  }
}

std::optional<LimitHit> Walk(const Message& message, const Plan& plan);

std::optional<LimitHit> WalkRepeated(const Message& message, const Reflection& reflection,
                                     const Plan::Field& field) {
  const auto count = static_cast<size_t>(reflection.FieldSize(message, field.descriptor));
  if (count == 0) return std::nullopt;
  if (field.row != kNoRow && count > kRows[field.row].elements_max) {
    return LimitHit{field.row, count, What::kElements};
  }
  if (field.observations) {
    for (const auto& each : static_cast<const v1::ObservationBatch&>(message).observations()) {
      const auto hit = each.has_message() ? CheckMessageSeen(each) : Walk(each, *field.inside);
      if (hit) return hit;
    }
    return std::nullopt;
  }
  for (int i = 0; i < static_cast<int>(count); ++i) {
    std::optional<LimitHit> hit;
    if (field.inside != nullptr) {
      hit = Walk(reflection.GetRepeatedMessage(message, field.descriptor, i), *field.inside);
    } else if (field.descriptor->cpp_type() == FieldDescriptor::CPPTYPE_STRING) {
      std::string scratch;
      hit = CheckBytes(
          field.row,
          reflection.GetRepeatedStringReference(message, field.descriptor, i, &scratch).size());
    }
    if (hit) return hit;
  }
  return std::nullopt;
}

std::optional<LimitHit> Walk(const Message& message, const Plan& plan) {
  const Reflection& reflection = *message.GetReflection();
  if (auto hit = CheckUnknown(reflection.GetUnknownFields(message))) return hit;
  for (const Plan::Field& field : plan.fields) {
    std::optional<LimitHit> hit;
    if (field.descriptor->is_repeated()) {
      hit = WalkRepeated(message, reflection, field);
    } else if (field.inside == nullptr) {
      hit = CheckValue(message, reflection, field);
    } else if (reflection.HasField(message, field.descriptor)) {
      hit = Walk(reflection.GetMessage(message, field.descriptor), *field.inside);
    }
    if (hit) return hit;
  }
  return std::nullopt;
}

void CutRepeatedText(Message& message, const Reflection& reflection, const Plan::Field& field) {
  const FieldLimit& limit = kRows[field.row];
  while (reflection.FieldSize(message, field.descriptor) > static_cast<int>(limit.elements_max)) {
    reflection.RemoveLast(&message, field.descriptor);
  }
  for (int i = 0; i < reflection.FieldSize(message, field.descriptor); ++i) {
    std::string scratch;
    const std::string& text =
        reflection.GetRepeatedStringReference(message, field.descriptor, i, &scratch);
    if (text.size() <= limit.value_max) continue;
    reflection.SetRepeatedString(&message, field.descriptor, i,
                                 std::string(CutUtf8(text, limit.value_max)));
  }
}

void CutValue(Message& message, const Reflection& reflection, const Plan::Field& field) {
  const uint64_t most = kRows[field.row].value_max;
  if (field.descriptor->cpp_type() == FieldDescriptor::CPPTYPE_STRING) {
    std::string scratch;
    const std::string& text = reflection.GetStringReference(message, field.descriptor, &scratch);
    if (text.size() <= most) return;
    reflection.SetString(&message, field.descriptor, std::string(CutUtf8(text, most)));
  } else if (field.descriptor->cpp_type() == FieldDescriptor::CPPTYPE_UINT64) {
    if (reflection.GetUInt64(message, field.descriptor) <= most) return;
    reflection.SetUInt64(&message, field.descriptor, most);
  }
}

void Cut(Message& message, const Plan& plan) {
  if (message.GetDescriptor() == v1::Observation::descriptor()) {
    // Nothing of a message is ever cut.
    if (static_cast<const v1::Observation&>(message).has_message()) return;
  }
  const Reflection& reflection = *message.GetReflection();
  for (const Plan::Field& field : plan.fields) {
    const bool cuts = field.row != kNoRow && kRows[field.row].cut_by_sender;
    if (field.inside != nullptr && field.descriptor->is_repeated()) {
      for (int i = 0; i < reflection.FieldSize(message, field.descriptor); ++i) {
        Cut(*reflection.MutableRepeatedMessage(&message, field.descriptor, i), *field.inside);
      }
    } else if (field.inside != nullptr) {
      if (!reflection.HasField(message, field.descriptor)) continue;
      Cut(*reflection.MutableMessage(&message, field.descriptor), *field.inside);
    } else if (cuts && field.descriptor->is_repeated()) {
      CutRepeatedText(message, reflection, field);
    } else if (cuts && reflection.HasField(message, field.descriptor)) {
      CutValue(message, reflection, field);
    }
  }
}

}  // namespace

absl::Span<const FieldLimit> FieldLimits() { return kRows; }

const char* LimitHit::field() const { return kRows[row].field; }

std::string LimitHit::Text() const {
  const FieldLimit& limit = kRows[row];
  if (row == kUnknownRow) {
    return absl::StrCat("a message has ", size, " or more fields that are not known here; at most ",
                        limit.elements_max);
  }
  if (row == kParsedSizeRow) {
    return absl::StrCat("a message of ", size, " bytes takes more than ", limit.value_max >> 20,
                        " MiB once it is parsed");
  }
  switch (what) {
    case What::kElements:
      return absl::StrCat(limit.field, " has ", size, " elements; at most ", limit.elements_max);
    case What::kBytes:
      return absl::StrCat(limit.field, " has ", size, " bytes; at most ", limit.value_max);
    case What::kValue:
      return absl::StrCat(limit.field, " is ", size, "; at most ", limit.value_max);
    case What::kNegative:
      return absl::StrCat(limit.field, " is negative; at least 0");
  }
  return limit.field;
}

absl::Status LimitHit::ToStatus() const { return absl::InvalidArgumentError(Text()); }

LimitHit ParsedSizeHit(size_t bytes) { return {kParsedSizeRow, bytes, What::kBytes}; }

std::optional<LimitHit> Check(const Message& message) {
  return Walk(message, Plans::Of(message.GetDescriptor()));
}

void CutToLimits(Message& message) { Cut(message, Plans::Of(message.GetDescriptor())); }

}  // namespace rips::wire_limits

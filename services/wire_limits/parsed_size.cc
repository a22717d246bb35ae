#include "services/wire_limits/parsed_size.h"

#include <cstdint>

#include "absl/container/flat_hash_map.h"
#include "google/protobuf/io/coded_stream.h"
#include "google/protobuf/message.h"
#include "google/protobuf/wire_format_lite.h"

namespace rips::wire_limits {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::MessageFactory;
using google::protobuf::internal::WireFormatLite;

// Beside what is in it, each with what its allocation and a list that grows take. Any field takes
// time, if nothing else.
constexpr size_t kFieldBytes = 32;
constexpr size_t kInListBytes = 48;
constexpr size_t kTextBytes = 64;
constexpr size_t kNumberBytes = 16;
constexpr size_t kUnknownBytes = 128;
// Of the parser.
constexpr int kDepthMax = 100;

class SizeSum {
 public:
  explicit SizeSum(google::protobuf::io::ZeroCopyInputStream& encoded) : in_(&encoded) {
    in_.SetRecursionLimit(kDepthMax);
  }

  size_t sum() const { return sum_; }

  void AddMessage(const Descriptor& type) {
    Add(SizeOf(type) + kUnknownBytes);  // of an end that is broken off
    Fields(type);
  }

 private:
  void Add(size_t bytes) { sum_ += bytes; }

  // False at the end of what can be read, or of what may be taken.
  bool Fields(const Descriptor& type) {
    while (sum_ <= kParsedBytesMax) {
      const uint32_t tag = in_.ReadTag();
      if (tag == 0) return in_.ConsumedEntireMessage();
      if (!Field(type, tag)) return false;
    }
    return false;
  }

  bool Field(const Descriptor& type, uint32_t tag) {
    const auto wire = WireFormatLite::GetTagWireType(tag);
    const FieldDescriptor* field = type.FindFieldByNumber(WireFormatLite::GetTagFieldNumber(tag));
    Add(kFieldBytes);
    if (field == nullptr || !Fits(*field, wire)) return Unknown(tag);
    if (field->is_repeated()) Add(kInListBytes);
    if (wire != WireFormatLite::WIRETYPE_LENGTH_DELIMITED) {
      return WireFormatLite::SkipField(&in_, tag);
    }
    // What it is in is made before its length is read.
    const Descriptor* inside = field->message_type();
    const bool text = field->cpp_type() == FieldDescriptor::CPPTYPE_STRING;
    Add(inside != nullptr ? SizeOf(*inside) : text ? kTextBytes : 0);
    uint32_t length = 0;
    if (!in_.ReadVarint32(&length)) return false;
    if (inside != nullptr) return Inside(*inside, length);
    Add((text ? 1 : kNumberBytes) * size_t{length});
    return Skip(length);
  }

  // A list of numbers may be packed.
  static bool Fits(const FieldDescriptor& field, WireFormatLite::WireType wire) {
    const auto own =
        WireFormatLite::WireTypeForFieldType(static_cast<WireFormatLite::FieldType>(field.type()));
    return wire == own ||
           (field.is_packable() && wire == WireFormatLite::WIRETYPE_LENGTH_DELIMITED);
  }

  bool Inside(const Descriptor& type, uint32_t length) {
    if (length > INT32_MAX) return false;
    const auto outer = in_.IncrementRecursionDepthAndPushLimit(static_cast<int>(length));
    if (outer.second < 0) return false;
    return Fields(type) && in_.DecrementRecursionDepthAndPopLimit(outer.first);
  }

  // A group may be full of fields of two bytes.
  bool Unknown(uint32_t tag) {
    const int before = in_.CurrentPosition();
    const bool whole = WireFormatLite::SkipField(&in_, tag);
    const auto bytes = static_cast<size_t>(in_.CurrentPosition() - before);
    const bool group = WireFormatLite::GetTagWireType(tag) == WireFormatLite::WIRETYPE_START_GROUP;
    Add(kUnknownBytes + (group ? kUnknownBytes / 2 : 1) * bytes);
    return whole;
  }

  bool Skip(uint32_t length) { return length <= INT32_MAX && in_.Skip(static_cast<int>(length)); }

  size_t SizeOf(const Descriptor& type) {
    size_t& known = sizes_[&type];
    if (known == 0) {
      known = MessageFactory::generated_factory()->GetPrototype(&type)->SpaceUsedLong();
    }
    return known;
  }

  google::protobuf::io::CodedInputStream in_;
  size_t sum_ = 0;
  absl::flat_hash_map<const Descriptor*, size_t> sizes_;  // of one without anything in it
};

}  // namespace

size_t ParsedSize(const Descriptor& type, google::protobuf::io::ZeroCopyInputStream& encoded) {
  SizeSum size(encoded);
  size.AddMessage(type);
  return size.sum();
}

std::optional<LimitHit> CheckParsedSize(const Descriptor& type, size_t bytes,
                                        google::protobuf::io::ZeroCopyInputStream& encoded) {
  if (bytes <= kNotLookedAtBytes || ParsedSize(type, encoded) <= kParsedBytesMax) {
    return std::nullopt;
  }
  return ParsedSizeHit(bytes);
}

}  // namespace rips::wire_limits

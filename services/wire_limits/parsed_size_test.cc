#include "services/wire_limits/parsed_size.h"

#include <algorithm>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "google/protobuf/arena.h"
#include "google/protobuf/io/coded_stream.h"
#include "google/protobuf/io/zero_copy_stream_impl_lite.h"
#include "google/protobuf/message.h"
#include "google/protobuf/wire_format_lite.h"
#include "gtest/gtest.h"
#include "rips/v1/actuator.pb.h"
#include "rips/v1/sensor.pb.h"

namespace rips::wire_limits {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::MessageFactory;
using google::protobuf::internal::WireFormatLite;

constexpr size_t kReceiveLimit = (4 << 20) + (256 << 10);

size_t SizeOf(const Descriptor& type, const std::string& encoded) {
  google::protobuf::io::ArrayInputStream in(encoded.data(), static_cast<int>(encoded.size()), 8192);
  return ParsedSize(type, in);
}

std::optional<LimitHit> CheckOf(const Descriptor& type, const std::string& encoded) {
  google::protobuf::io::ArrayInputStream in(encoded.data(), static_cast<int>(encoded.size()), 8192);
  return CheckParsedSize(type, encoded.size(), in);
}

// What its parser takes of an arena and beside it.
size_t Parsed(const Descriptor& type, const std::string& encoded) {
  google::protobuf::Arena arena;
  Message* message = MessageFactory::generated_factory()->GetPrototype(&type)->New(&arena);
  message->ParseFromString(encoded);
  // What is not known is beside the arena, and all that is in these messages then.
  return std::max<size_t>(arena.SpaceUsed(), message->SpaceUsedLong());
}

std::string Tag(const FieldDescriptor& field, WireFormatLite::WireType wire) {
  uint8_t bytes[10];
  const uint32_t tag = WireFormatLite::MakeTag(field.number(), wire);
  const auto* end = google::protobuf::io::CodedOutputStream::WriteVarint32ToArray(tag, bytes);
  return {reinterpret_cast<const char*>(bytes), reinterpret_cast<const char*>(end)};
}

std::string Delimited(const FieldDescriptor& field, const std::string& inside) {
  uint8_t bytes[10];
  const auto* end = google::protobuf::io::CodedOutputStream::WriteVarint32ToArray(
      static_cast<uint32_t>(inside.size()), bytes);
  return absl::StrCat(
      Tag(field, WireFormatLite::WIRETYPE_LENGTH_DELIMITED),
      absl::string_view(reinterpret_cast<const char*>(bytes),
                        static_cast<size_t>(end - static_cast<const uint8_t*>(bytes))),
      inside);
}

std::string Repeated(const std::string& piece, size_t bytes) {
  std::string out;
  while (out.size() + piece.size() <= bytes) out += piece;
  return out;
}

// Calls visit(path of messages to `type`, type) for each kind of message in `type`, itself first.
template <typename Visit>
void ForEachType(const Descriptor& type, std::vector<const FieldDescriptor*>& path,
                 std::set<const Descriptor*>& seen, const Visit& visit) {
  if (!seen.insert(&type).second) return;
  visit(path, type);
  for (int i = 0; i < type.field_count(); ++i) {
    if (type.field(i)->message_type() == nullptr) continue;
    path.push_back(type.field(i));
    ForEachType(*type.field(i)->message_type(), path, seen, visit);
    path.pop_back();
  }
}

// What is small on the wire and may be repeated in a message of `type`.
std::vector<std::string> SmallPieces(const Descriptor& type) {
  std::vector<std::string> pieces = {
      std::string("\xc0\x3e\x00", 3),  // unknown: a number, two texts, two groups
      std::string("\xc2\x3e\x00", 3),
      std::string("\xc2\x3e\x01x", 4),
      "\xc3\x3e\xc4\x3e",
      "\xc3\x3e" + Repeated(std::string("\x08\x00", 2), 200) + "\xc4\x3e",
  };
  std::string members;  // of oneofs, each in the place of the one before
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    const bool inside = field.message_type() != nullptr;
    if (inside || field.cpp_type() == FieldDescriptor::CPPTYPE_STRING) {
      pieces.push_back(Delimited(field, ""));
      if (field.real_containing_oneof() != nullptr) members += pieces.back();
    } else if (field.is_repeated()) {
      pieces.push_back(Delimited(field, std::string(1'000, '\0')));
      pieces.push_back(Delimited(field, std::string(1, '\0')));
    } else {
      pieces.push_back(Tag(field, WireFormatLite::WIRETYPE_FIXED32) + "1234");  // of another kind
    }
  }
  if (!members.empty()) pieces.push_back(members);
  return pieces;
}

TEST(ParsedSizeTest, IsNoLessThanTheParserTakesAndLittleCannotTakeMuch) {
  int tried = 0;
  for (const Descriptor* root :
       {v1::SensorMessage::descriptor(), v1::ActuatorMessage::descriptor()}) {
    std::vector<const FieldDescriptor*> path;
    std::set<const Descriptor*> seen;
    ForEachType(*root, path, seen, [&](const auto& at, const Descriptor& type) {
      for (const std::string& piece : SmallPieces(type)) {
        std::string encoded = Repeated(piece, 40'000);
        for (auto field = at.rbegin(); field != at.rend(); ++field) {
          encoded = Delimited(**field, encoded);
        }
        const size_t size = SizeOf(*root, encoded);
        EXPECT_GE(size, Parsed(*root, encoded)) << type.full_name();
        EXPECT_LE(size, encoded.size() * kParsedPerByteMax) << type.full_name();
        ++tried;
      }
    });
  }
  EXPECT_GT(tried, 300);
}

TEST(ParsedSizeTest, AMessageThatWouldTakeTooMuchIsRefusedWithBytesAndLimit) {
  const Descriptor& type = *v1::SensorMessage::descriptor();
  const std::string member = Delimited(*type.FindFieldByName("hello"), "");
  const auto hit = CheckOf(type, Repeated(member, 4'000'000));
  ASSERT_TRUE(hit.has_value());
  EXPECT_STREQ(hit->field(), kParsedSize);
  EXPECT_EQ(hit->Text(), "a message of 4000000 bytes takes more than 64 MiB once it is parsed");
  EXPECT_EQ(CheckOf(type, Repeated(member, kNotLookedAtBytes)), std::nullopt);
}

// More than our sensors send at once, which is a mebibyte.
TEST(ParsedSizeTest, TheLargestGraphIsParsed) {
  v1::SensorMessage message;
  auto* snapshot = message.mutable_batch()->add_observations()->mutable_snapshot();
  for (int i = 0; i < 4'096; ++i) {
    auto* participant = snapshot->add_participants();
    participant->set_guid(std::string(16, 'p'));
    participant->set_host("robot");
    participant->set_address("10.0.0.1");
    auto* node = snapshot->add_nodes();
    node->set_full_name(absl::StrCat("/namespace/node_", i));
    node->set_participant_guid(std::string(16, 'p'));
  }
  while (snapshot->endpoints_size() < 20'480) {
    auto* endpoint = snapshot->add_endpoints();
    endpoint->set_guid(std::string(16, 'e'));
    endpoint->set_name(absl::StrCat("rt/topic_", snapshot->endpoints_size()));
    endpoint->set_type("std_msgs::msg::dds_::String_");
    endpoint->set_node("/namespace/node");
    endpoint->set_why("x");
    for (int k = 0; k < 4; ++k) endpoint->mutable_qos()->add_partitions("part");
  }
  const std::string encoded = message.SerializeAsString();
  EXPECT_GT(encoded.size(), kNotLookedAtBytes);
  EXPECT_LT(encoded.size(), kReceiveLimit);
  EXPECT_EQ(CheckOf(*v1::SensorMessage::descriptor(), encoded), std::nullopt);
}

TEST(ParsedSizeTest, WhatIsMalformedIsLeftToTheParser) {
  const std::string text(kNotLookedAtBytes + 1, '\xff');
  EXPECT_EQ(CheckOf(*v1::SensorMessage::descriptor(), text), std::nullopt);
  const std::string deep = Repeated("\xc3\x3e", kReceiveLimit);  // groups within groups
  EXPECT_FALSE(v1::SensorMessage().ParseFromString(deep));
  CheckOf(*v1::SensorMessage::descriptor(), deep);  // ends
}

}  // namespace
}  // namespace rips::wire_limits

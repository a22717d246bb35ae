#include "services/wire_limits/field_limits.h"

#include <memory>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "gmock/gmock.h"
#include "google/protobuf/descriptor.h"
#include "gtest/gtest.h"
#include "rips/v1/actuator.pb.h"
#include "rips/v1/enrolment.pb.h"
#include "rips/v1/operator.pb.h"
#include "rips/v1/sensor.pb.h"
#include "services/base/status_matchers.h"

namespace rips::wire_limits {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::FileDescriptor;
using google::protobuf::Message;
using google::protobuf::MessageFactory;
using google::protobuf::Reflection;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

// What a peer may send to the server: the requests of each service there is.
std::vector<const Descriptor*> Roots() {
  std::vector<const Descriptor*> roots;
  for (const FileDescriptor* file :
       {v1::SensorMessage::descriptor()->file(), v1::ActuatorMessage::descriptor()->file(),
        v1::LevelRequest::descriptor()->file(), v1::EnrolRequest::descriptor()->file()}) {
    for (int i = 0; i < file->service_count(); ++i) {
      for (int k = 0; k < file->service(i)->method_count(); ++k) {
        roots.push_back(file->service(i)->method(k)->input_type());
      }
    }
  }
  return roots;
}

std::string NameOf(const FieldDescriptor* field) {
  return absl::StrCat(field->containing_type()->name(), ".", field->name());
}

const FieldLimit* RowFor(const FieldDescriptor* field) {
  for (const FieldLimit& row : FieldLimits()) {
    if (NameOf(field) == row.field) return &row;
  }
  return nullptr;
}

bool NeedsARow(const FieldDescriptor* field) {
  return field->is_repeated() || field->cpp_type() == FieldDescriptor::CPPTYPE_STRING ||
         field->cpp_type() == FieldDescriptor::CPPTYPE_UINT64 ||
         field->cpp_type() == FieldDescriptor::CPPTYPE_INT64;
}

void Reach(const Descriptor* type, std::set<const Descriptor*>& reached) {
  if (!reached.insert(type).second) return;
  for (int i = 0; i < type->field_count(); ++i) {
    if (type->field(i)->message_type() != nullptr) Reach(type->field(i)->message_type(), reached);
  }
}

std::set<const FieldDescriptor*> FieldsOfPeers() {
  std::set<const Descriptor*> reached;
  for (const Descriptor* root : Roots()) Reach(root, reached);
  std::set<const FieldDescriptor*> fields;
  for (const Descriptor* type : reached) {
    for (int i = 0; i < type->field_count(); ++i) fields.insert(type->field(i));
  }
  return fields;
}

TEST(FieldLimitsTest, EveryFieldThatAPeerCanSendHasALimit) {
  std::set<std::string> without;
  for (const FieldDescriptor* field : FieldsOfPeers()) {
    if (NeedsARow(field) && RowFor(field) == nullptr) without.insert(NameOf(field));
  }
  EXPECT_THAT(without, IsEmpty()) << "write a row for each in field_limits.def";
  EXPECT_EQ(Roots().size(), 40u) << "of four services; is a new one among them?";
}

TEST(FieldLimitsTest, EveryRowIsOfAFieldThatAPeerCanSendAndThereIsOne) {
  std::set<std::string> fields;
  for (const FieldDescriptor* field : FieldsOfPeers()) fields.insert(NameOf(field));
  std::set<std::string> rows;
  for (const FieldLimit& row : FieldLimits()) {
    if (row.field == absl::string_view(kUnknownFields)) continue;
    if (row.field == absl::string_view(kParsedSize)) continue;
    EXPECT_TRUE(fields.contains(row.field)) << row.field;
    EXPECT_TRUE(rows.insert(row.field).second) << row.field << " has two";
  }
}

std::string Bytes(const FieldDescriptor* field, uint64_t bytes) {
  // Two bytes a character, so that a cut has something to get wrong.
  std::string text;
  if (field->type() == FieldDescriptor::TYPE_BYTES) return std::string(bytes, '\xff');
  while (text.size() + 2 <= bytes) text += "\xc3\xa9";
  text.resize(bytes, 'x');
  return text;
}

// Sets `field` of `message` to `value` bytes, or to that number, in `count` elements.
void Set(Message& message, const FieldDescriptor* field, uint64_t count, uint64_t value) {
  const Reflection& reflection = *message.GetReflection();
  reflection.ClearField(&message, field);
  for (uint64_t i = 0; field->is_repeated() && i < count; ++i) {
    if (field->message_type() != nullptr) {
      reflection.AddMessage(&message, field);
    } else {
      if (field->cpp_type() == FieldDescriptor::CPPTYPE_UINT32) {
        reflection.AddUInt32(&message, field, static_cast<uint32_t>(value));
      } else {
        reflection.AddString(&message, field, i == 0 ? Bytes(field, value) : "");
      }
    }
  }
  if (field->is_repeated()) return;
  switch (field->cpp_type()) {
    case FieldDescriptor::CPPTYPE_STRING:
      return reflection.SetString(&message, field, Bytes(field, value));
    case FieldDescriptor::CPPTYPE_UINT64:
      return reflection.SetUInt64(&message, field, value);
    case FieldDescriptor::CPPTYPE_INT64:
      return reflection.SetInt64(&message, field, static_cast<int64_t>(value));
    default:
      FAIL() << NameOf(field);
  }
}

// Of each field in `at`, which is part of `root`: calls visit(message, field, row).
template <typename Visit>
void ForEachLimit(Message& at, const Visit& visit) {
  const Reflection& reflection = *at.GetReflection();
  const Descriptor* type = at.GetDescriptor();
  for (int i = 0; i < type->field_count(); ++i) {
    const FieldDescriptor* field = type->field(i);
    if (const FieldLimit* row = RowFor(field); row != nullptr) visit(at, field, *row);
    reflection.ClearField(&at, field);
    if (field->message_type() == nullptr) continue;
    ForEachLimit(field->is_repeated() ? *reflection.AddMessage(&at, field)
                                      : *reflection.MutableMessage(&at, field),
                 visit);
    reflection.ClearField(&at, field);
  }
}

std::unique_ptr<Message> Make(const Descriptor* type) {
  return std::unique_ptr<Message>(MessageFactory::generated_factory()->GetPrototype(type)->New());
}

void ExpectHit(const Message& root, const FieldLimit& row, LimitHit::What what) {
  const auto hit = Check(root);
  ASSERT_TRUE(hit.has_value()) << row.field << " in " << root.GetTypeName();
  EXPECT_STREQ(hit->field(), row.field);
  EXPECT_EQ(static_cast<int>(hit->what), static_cast<int>(what)) << row.field;
}

// Through the messages of a batch, too, which are not walked by reflection.
TEST(FieldLimitsTest, EveryLimitHoldsWhereverItsFieldStands) {
  for (const Descriptor* type : Roots()) {
    const std::unique_ptr<Message> root = Make(type);
    ForEachLimit(*root, [&](Message& at, const FieldDescriptor* field, const FieldLimit& row) {
      const bool number = field->cpp_type() != FieldDescriptor::CPPTYPE_STRING;
      const bool any = row.value_max == kAnyValue;
      const uint64_t most = any ? 0 : row.value_max;
      Set(at, field, row.elements_max, most);
      EXPECT_EQ(Check(*root), std::nullopt) << row.field;
      if (field->is_repeated()) {
        Set(at, field, uint64_t{row.elements_max} + 1, most);
        ExpectHit(*root, row, LimitHit::What::kElements);
      }
      if (!any) {
        Set(at, field, row.elements_max, most + 1);
        ExpectHit(*root, row, number ? LimitHit::What::kValue : LimitHit::What::kBytes);
      }
      if (field->cpp_type() == FieldDescriptor::CPPTYPE_INT64 && !any) {
        Set(at, field, 1, static_cast<uint64_t>(int64_t{-1}));
        ExpectHit(*root, row, LimitHit::What::kNegative);
      }
    });
  }
}

TEST(FieldLimitsTest, WhatOurAgentsMayCutIsWithinItsLimitAfterwards) {
  int cut = 0;
  for (const Descriptor* type : Roots()) {
    const std::unique_ptr<Message> root = Make(type);
    ForEachLimit(*root, [&](Message& at, const FieldDescriptor* field, const FieldLimit& row) {
      if (!row.cut_by_sender) return;
      // An odd start, so that the limit falls into a character.
      Set(at, field, 3 * uint64_t{row.elements_max}, row.value_max + 1'000);
      CutToLimits(*root);
      EXPECT_EQ(Check(*root), std::nullopt) << row.field;
      EXPECT_TRUE(Make(type)->ParseFromString(root->SerializeAsString())) << row.field;
      ++cut;
    });
  }
  EXPECT_GT(cut, 30);
}

TEST(FieldLimitsTest, ATextIsCutBetweenTwoCharactersAndWhatFitsStays) {
  v1::ActuatorMessage message;
  message.mutable_heartbeat()->set_floor_reason(
      "x" + Bytes(v1::ActuatorHeartbeat::descriptor()->FindFieldByName("floor_reason"), 2'000));
  message.mutable_heartbeat()->set_effective_level("ALERT");
  for (int i = 0; i < 10; ++i) message.mutable_heartbeat()->add_degraded(absl::StrCat(i));
  CutToLimits(message);
  EXPECT_EQ(message.heartbeat().floor_reason().size(), 1'023u);
  EXPECT_EQ(message.heartbeat().effective_level(), "ALERT");
  EXPECT_EQ(message.heartbeat().degraded_size(), 8);
  EXPECT_EQ(message.heartbeat().degraded(7), "7");
}

TEST(FieldLimitsTest, ALossOfMoreThanCanBeIsSentAsTheMost) {
  v1::SensorMessage message;
  v1::Loss* loss = message.mutable_batch()->add_observations()->mutable_loss();
  loss->set_count(UINT64_MAX);
  CutToLimits(message);
  EXPECT_EQ(loss->count(), kLossCountMax);
}

TEST(FieldLimitsTest, ARefusalNamesFieldSizeAndLimitAndNoContent) {
  v1::ActuatorMessage message;
  message.mutable_heartbeat()->set_floor_reason(std::string(4 << 20, 'S'));
  const auto hit = Check(message);
  ASSERT_TRUE(hit.has_value());
  EXPECT_EQ(hit->Text(), "ActuatorHeartbeat.floor_reason has 4194304 bytes; at most 1024");
  EXPECT_THAT(hit->ToStatus(), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("1024")));
  EXPECT_THAT(hit->Text(), Not(HasSubstr("SS")));
}

// `count` fields of number 1,000, which no message of ours has.
std::string Unknown(int count, const std::string& tag_and_value) {
  std::string out;
  for (int i = 0; i < count; ++i) out += tag_and_value;
  return out;
}

TEST(FieldLimitsTest, FieldsThatAreNotKnownHereAreFewInEachMessage) {
  const std::string number("\xc0\x3e\x00", 3);
  const std::string text("\xc2\x3e\x00", 3);
  const std::string group("\xc3\x3e\xc4\x3e", 4);
  const std::string nested = "\xc3\x3e" + Unknown(9, number) + "\xc4\x3e";
  for (const Descriptor* type : Roots()) {
    for (const std::string& field : {number, text, group}) {
      const std::unique_ptr<Message> root = Make(type);
      ASSERT_TRUE(root->ParseFromString(Unknown(kUnknownFieldsMax, field)));
      EXPECT_EQ(Check(*root), std::nullopt) << "of a newer peer";
      ASSERT_TRUE(root->ParseFromString(Unknown(kUnknownFieldsMax + 1, field)));
      const auto hit = Check(*root);
      ASSERT_TRUE(hit.has_value()) << type->name();
      EXPECT_STREQ(hit->field(), kUnknownFields);
      EXPECT_EQ(hit->Text(), "a message has 9 or more fields that are not known here; at most 8");
    }
    const std::unique_ptr<Message> root = Make(type);
    ASSERT_TRUE(root->ParseFromString(nested));
    EXPECT_TRUE(Check(*root).has_value()) << "in a group";
  }
}

TEST(FieldLimitsTest, NorMayMessagesWithinOneHaveMore) {
  const std::string many = Unknown(9, std::string("\xc0\x3e\x00", 3));
  v1::SensorMessage batch;
  v1::Observation* seen = batch.mutable_batch()->add_observations();
  ASSERT_TRUE(seen->mutable_message()->ParseFromString(many));
  EXPECT_TRUE(Check(batch).has_value()) << "in a message that was seen";
  v1::SensorMessage observed;
  seen = observed.mutable_batch()->add_observations();
  ASSERT_TRUE(seen->ParseFromString(many));
  seen->mutable_message();
  EXPECT_TRUE(Check(observed).has_value()) << "beside a message that was seen";
  v1::SensorMessage graph;
  auto* snapshot = graph.mutable_batch()->add_observations()->mutable_snapshot();
  ASSERT_TRUE(snapshot->add_endpoints()->ParseFromString(many));
  EXPECT_TRUE(Check(graph).has_value()) << "in an endpoint";
}

TEST(FieldLimitsTest, TimesOfABatchAddUpInSixtyFourBits) {
  EXPECT_LE(2 * kTimeMax, static_cast<uint64_t>(INT64_MAX));
}

}  // namespace
}  // namespace rips::wire_limits

// The tables: types, classes, operators, signatures, operators on constants.
#include "policy_server/policy/lang/check/type.h"

#include <cmath>
#include <limits>
#include <optional>
#include <set>
#include <string>

#include "gtest/gtest.h"
#include "policy_server/policy/lang/check/fold.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/syntax/ast.h"
#include "policy_server/policy/lang/syntax/operators.h"

namespace rips::lang {
namespace {

constexpr int64_t kMinInt = std::numeric_limits<int64_t>::min();
constexpr int64_t kMaxInt = std::numeric_limits<int64_t>::max();

TEST(TypeTest, SectionsAcceptTheirClasses) {
  using enum EventClass;
  const struct {
    EventClass section;
    bool universal, msg, graph, external;
  } kRows[] = {
      {kMsg, true, true, true, false},
      {kGraph, true, false, true, false},
      {kExternal, true, false, false, true},
  };
  for (const auto& row : kRows) {
    EXPECT_EQ(Accepts(row.section, kUniversal), row.universal) << Name(row.section);
    EXPECT_EQ(Accepts(row.section, kMsg), row.msg) << Name(row.section);
    EXPECT_EQ(Accepts(row.section, kGraph), row.graph) << Name(row.section);
    EXPECT_EQ(Accepts(row.section, kExternal), row.external) << Name(row.section);
  }
}

TEST(TypeTest, OnlyLevelsConvert) {
  constexpr ValueType kAll[] = {ValueType::kInt, ValueType::kFloat, ValueType::kBool,
                                ValueType::kString, ValueType::kLevel};
  for (const ValueType from : kAll) {
    for (const ValueType to : kAll) {
      const bool expected = from == to || (from == ValueType::kLevel && to == ValueType::kInt);
      EXPECT_EQ(Converts(from, to), expected) << Name(from) << " " << Name(to);
    }
  }
}

TEST(TypeTest, OperatorsTakeTheirTypes) {
  // For int, float, bool, string, level: the result's first letter, or `.`.
  const struct {
    BinaryOp op;
    const char* results;
  } kRows[] = {
      {BinaryOp::kOr, "..b.."},     {BinaryOp::kAnd, "..b.."},    {BinaryOp::kBitOr, "i...i"},
      {BinaryOp::kBitXor, "i...i"}, {BinaryOp::kBitAnd, "i...i"}, {BinaryOp::kEq, "bbbbb"},
      {BinaryOp::kNe, "bbbbb"},     {BinaryOp::kLt, "bbbbb"},     {BinaryOp::kLe, "bbbbb"},
      {BinaryOp::kGt, "bbbbb"},     {BinaryOp::kGe, "bbbbb"},     {BinaryOp::kAdd, "if.si"},
      {BinaryOp::kSub, "if..i"},    {BinaryOp::kMul, "if..i"},    {BinaryOp::kDiv, "if..i"},
      {BinaryOp::kMod, "i...i"},
  };
  const auto letter = [](std::optional<ValueType> type) { return type ? Name(*type)[0] : '.'; };
  for (const auto& row : kRows) {
    for (int left = 0; left < 5; ++left) {
      for (int right = 0; right < 5; ++right) {
        const bool same = left % 4 == right % 4;  // A level, 4, counts as an int, 0.
        const char expected = same ? row.results[left] : '.';
        EXPECT_EQ(
            letter(ResultType(row.op, static_cast<ValueType>(left), static_cast<ValueType>(right))),
            expected)
            << Spelling(row.op) << " " << left << " " << right;
      }
    }
  }
  const struct {
    UnaryOp op;
    const char* results;
  } kUnaryRows[] = {{UnaryOp::kPlus, "if..i"},
                    {UnaryOp::kMinus, "if..i"},
                    {UnaryOp::kNot, "..b.."},
                    {UnaryOp::kComplement, "i...i"}};
  for (const auto& row : kUnaryRows) {
    for (int type = 0; type < 5; ++type) {
      EXPECT_EQ(letter(ResultType(row.op, static_cast<ValueType>(type))), row.results[type]);
    }
  }
}

TEST(FoldTest, IntegersWrapAround) {
  EXPECT_EQ(Fold(BinaryOp::kAdd, kMaxInt, int64_t{1}), Value(kMinInt));
  EXPECT_EQ(Fold(BinaryOp::kSub, kMinInt, int64_t{1}), Value(kMaxInt));
  EXPECT_EQ(Fold(BinaryOp::kMul, kMaxInt, int64_t{2}), Value(int64_t{-2}));
  EXPECT_EQ(Fold(BinaryOp::kDiv, kMinInt, int64_t{-1}), Value(kMinInt));
  EXPECT_EQ(Fold(BinaryOp::kMod, kMinInt, int64_t{-1}), Value(int64_t{0}));
  EXPECT_EQ(Fold(UnaryOp::kMinus, kMinInt), Value(kMinInt));
}

TEST(FoldTest, DivisionTruncatesTowardZero) {
  EXPECT_EQ(Fold(BinaryOp::kDiv, int64_t{-7}, int64_t{2}), Value(int64_t{-3}));
  EXPECT_EQ(Fold(BinaryOp::kMod, int64_t{-7}, int64_t{2}), Value(int64_t{-1}));
  EXPECT_EQ(Fold(BinaryOp::kDiv, int64_t{7}, int64_t{0}), std::nullopt);
  EXPECT_EQ(Fold(BinaryOp::kMod, int64_t{7}, int64_t{0}), std::nullopt);
  EXPECT_TRUE(std::isinf(std::get<double>(*Fold(BinaryOp::kDiv, 1.0, 0.0))));
}

TEST(FoldTest, ComparesEveryType) {
  EXPECT_EQ(Fold(BinaryOp::kLt, false, true), Value(true));
  EXPECT_EQ(Fold(BinaryOp::kGe, false, true), Value(false));
  EXPECT_EQ(Fold(BinaryOp::kLt, std::string("Z"), std::string("a")), Value(true));
  EXPECT_EQ(Fold(BinaryOp::kGt, std::string("\xFF"), std::string("a")), Value(true));
  EXPECT_EQ(Fold(BinaryOp::kEq, 0.0, -0.0), Value(true));
  EXPECT_EQ(Fold(BinaryOp::kAdd, std::string("a"), std::string("b")), Value(std::string("ab")));
  EXPECT_EQ(Fold(BinaryOp::kBitXor, int64_t{6}, int64_t{3}), Value(int64_t{5}));
  EXPECT_EQ(Fold(UnaryOp::kComplement, int64_t{0}), Value(int64_t{-1}));
  EXPECT_EQ(Fold(UnaryOp::kNot, true), Value(false));
}

TEST(SignatureTest, TablesAreInTheOrderOfTheirEnums) {
  for (size_t i = 0; i < Signatures().size(); ++i) {
    EXPECT_EQ(static_cast<size_t>(Signatures()[i].builtin), i) << Signatures()[i].name;
    EXPECT_EQ(SignatureOf(Signatures()[i].builtin).name, Signatures()[i].name);
    EXPECT_FALSE(Signatures()[i].help.empty());
  }
  EXPECT_EQ(Signatures().back().builtin, Builtin::kEval);
  for (size_t i = 0; i < ActionSignatures().size(); ++i) {
    EXPECT_EQ(static_cast<size_t>(ActionSignatures()[i].action), i);
  }
  for (size_t i = 0; i < PredefinedNames().size(); ++i) {
    EXPECT_EQ(static_cast<size_t>(PredefinedNames()[i].predefined), i);
  }
}

TEST(SignatureTest, EveryNameMeansOneThing) {
  std::set<absl::string_view> names;
  for (const Signature& entry : Signatures()) EXPECT_TRUE(names.insert(entry.name).second);
  for (const ActionSignature& entry : ActionSignatures()) {
    EXPECT_TRUE(names.insert(entry.name).second);
  }
  for (const PredefinedName& entry : PredefinedNames()) {
    EXPECT_TRUE(names.insert(entry.name).second);
  }
  EXPECT_EQ(names.size(), 52u + 7u + 12u);
}

TEST(SignatureTest, SpellsItsUse) {
  EXPECT_EQ(UsageOf(*FindSignature("topicin")), "topicin(topics string...)");
  EXPECT_EQ(UsageOf(*FindSignature("topicpublishercount")),
            "topicpublishercount(topic string, min int, max int)");
  EXPECT_EQ(UsageOf(*FindSignature("services")), "services(node string, services string...)");
  EXPECT_EQ(UsageOf(*FindSignature("string")), "string(x)");
  EXPECT_EQ(FindSignature("nothing"), nullptr);
}

}  // namespace
}  // namespace rips::lang

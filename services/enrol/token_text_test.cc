#include "services/enrol/token_text.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::enrol {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

v1::EnrolmentToken Token() {
  v1::EnrolmentToken token;
  token.set_id("00112233aabbccdd");
  token.set_server("policy.example:7443");
  token.set_robot("r1");
  token.set_host("base");
  token.add_roles("sensor");
  token.set_authorities_pem("authorities");
  token.set_certificates_pem("certificates");
  token.set_key_pem("very secret");
  return token;
}

TEST(TokenTextTest, ComesBackAlsoWithLineBreaks) {
  const std::string text = FormatToken(Token());
  EXPECT_EQ(text.find_first_of(" \n+/"), std::string::npos);
  const auto same = ParseToken(text);
  ASSERT_THAT(same, IsOk());
  EXPECT_EQ(same->SerializeAsString(), Token().SerializeAsString());
  EXPECT_THAT(ParseToken(absl::StrCat("  ", text.substr(0, 30), "\r\n", text.substr(30), "\n")),
              IsOk());
}

TEST(TokenTextTest, IsRefusedCutAtAnyByteWithoutAPieceOfTheSecret) {
  const std::string text = FormatToken(Token());
  for (size_t size = 0; size < text.size(); ++size) {
    const auto cut = ParseToken(text.substr(0, size));
    if (cut.ok()) {
      // Less padding is the same token.
      EXPECT_EQ(cut->SerializeAsString(), Token().SerializeAsString()) << size;
      continue;
    }
    EXPECT_THAT(cut, StatusIs(absl::StatusCode::kInvalidArgument)) << size;
    EXPECT_THAT(cut.status().message(), Not(HasSubstr("secret"))) << size;
  }
}

TEST(TokenTextTest, RefusesWhatCannotBe) {
  EXPECT_THAT(ParseToken("rips-token-2.abc"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("another version")));
  EXPECT_THAT(ParseToken("hello"), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(ParseToken(std::string(kTokenBytesMax + 1, 'a')),
              StatusIs(absl::StatusCode::kInvalidArgument));
  const auto with = [](auto change) {
    v1::EnrolmentToken token = Token();
    change(token);
    return ParseToken(FormatToken(token));
  };
  EXPECT_THAT(with([](auto& token) { token.set_robot("../../etc"); }),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("robot id")));
  EXPECT_THAT(with([](auto& token) { token.set_host("a/b"); }),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("host")));
  EXPECT_THAT(with([](auto& token) { token.set_roles(0, "../sensor"); }),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("role")));
  EXPECT_THAT(with([](auto& token) { token.clear_roles(); }),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(with([](auto& token) { token.set_server("unix:/tmp/x"); }),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("HOST:PORT")));
  EXPECT_THAT(with([](auto& token) { token.clear_key_pem(); }),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

}  // namespace
}  // namespace rips::enrol

#include "mode_actuator/steps/firewall/fw_message.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/firewall/target.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ::testing::HasSubstr;
using Kind = FirewallStep::Kind;

TEST(FwMessageTest, RequestsComeBackAsTheyWere) {
  FirewallStep many = {.kind = Kind::kIsolateHosts, .hold_for = absl::Hours(24)};
  while (many.targets.size() < kTargetsMax) {
    many.targets.push_back("fd00:1111:2222:3333:4444:5555:6666:7777");
  }
  const FwRequest kRequests[] = {
      {.verb = FwVerb::kStatus},
      {FwVerb::kEnter, {.kind = Kind::kRules, .file = "/etc/rips/a b.nft"}},
      {FwVerb::kCheck, many},
      {FwVerb::kTry, many},
      {FwVerb::kTry, {.kind = Kind::kRelease}},
      {FwVerb::kEnter,
       {.kind = Kind::kIsolateParticipants,
        .targets = {"01104a3b0000000000000001"},
        .hold_for = absl::Seconds(12)}},
      {FwVerb::kEnter, {.kind = Kind::kRelease}},
  };
  for (const FwRequest& request : kRequests) {
    const std::string packet = EncodeFwRequest(request);
    EXPECT_LE(packet.size(), kFwPacketBytesMax);
    const auto decoded = DecodeFwRequest(packet);
    ASSERT_THAT(decoded, IsOk()) << packet;
    EXPECT_EQ(*decoded, request) << packet;
    for (size_t length = 0; length < packet.size(); ++length) {
      const auto cut = DecodeFwRequest(absl::string_view(packet).substr(0, length));
      EXPECT_FALSE(cut.ok() && *cut == request) << packet.substr(0, length);
    }
  }
}

TEST(FwMessageTest, RefusesRequestsOfAnotherShape) {
  std::string many;
  for (size_t i = 0; i <= kTargetsMax; ++i) absl::StrAppend(&many, "target 10.0.0.7\n");
  const struct {
    std::string body;
    absl::string_view message;
  } kCases[] = {
      {"", "no verb"},
      {"verb flush\n", "unknown verb"},
      {"verb status\nverb status\n", "unknown or repeated line `verb`"},
      {"verb status\nkind release\n", "`status` takes no step"},
      {"kind release\nverb enter\n", "lines out of place"},
      {"verb enter\nkind isolate_hosts\nfor_ms 5\ntarget 10.0.0.7\n", "lines out of place"},
      {"verb enter\nkind isolate_hosts\ntarget 10.0.0.7\nfor_ms 05\n", "lines out of place"},
      {"verb enter\n", "no kind"},
      {"verb enter\nkind table\n", "unknown kind"},
      {"verb enter\nkind rules\nfor_ms 5\n", "`file` is for `rules`"},
      {"verb enter\nkind release\nfile /a\n", "`file` is for `rules`"},
      {"verb enter\nkind isolate_hosts\nfor_ms 5\n", "`target` is for isolation"},
      {"verb enter\nkind rules\nfile /a\ntarget 1\nfor_ms 5\n", "`target` is for isolation"},
      {"verb enter\nkind rules\nfile /a\n", "`for_ms` is for"},
      {"verb enter\nkind release\nfor_ms 5\n", "`for_ms` is for"},
      {"verb enter\nkind rules\nfile /a\nfor_ms 0\n", "`for_ms` must be from 1 to 86400000"},
      {"verb enter\nkind rules\nfile /a\nfor_ms 86400001\n", "`for_ms` must be"},
      {"verb enter\nkind rules\nfile /a\nfor_ms x\n", "`for_ms` must be"},
      {"verb enter\nkind rules\nfile /a\nfile /b\nfor_ms 5\n", "repeated line `file`"},
      {absl::StrCat("verb enter\nkind isolate_hosts\n", many, "for_ms 5\n"),
       "targets exceed limit 64"},
      {"verb enter\nkind isolate_hosts\ntarget \nfor_ms 5\n", "no target"},
      {absl::StrCat("verb enter\nkind isolate_hosts\ntarget ", std::string(49, '1'), "\n"),
       "no target"},
      {"verb status\nnft add table inet x\n", "unknown or repeated line `nft`"},
      {"verb status\n\n", "no lines of"},
      {"verb", "no lines of"},
  };
  for (const auto& test : kCases) {
    EXPECT_THAT(DecodeFwRequest(absl::StrCat("rips-fw 1\n", test.body)),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(test.message)))
        << test.body;
  }
  for (const std::string& packet :
       {std::string(), std::string("rips-fw 2\nverb status\n"), std::string("rips-fw 1"),
        std::string("rips-fw 11\nverb status\n"), std::string("\0\xff", 2)}) {
    EXPECT_THAT(DecodeFwRequest(packet), StatusIs(absl::StatusCode::kInvalidArgument)) << packet;
  }
  EXPECT_THAT(DecodeFwRequest(std::string(kFwPacketBytesMax + 1, 'x')),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("exceeds limit 8192")));
}

TEST(FwMessageTest, ResponsesComeBackAsTheyWere) {
  const FwResponse kResponses[] = {
      {},
      {absl::OkStatus(), "firewall=a.nft", "10.0.0.7 for 4s"},
      {absl::FailedPreconditionError("table deleted"), "firewall=?", ""},
  };
  for (const FwResponse& response : kResponses) {
    const auto decoded = DecodeFwResponse(EncodeFwResponse(response));
    ASSERT_THAT(decoded, IsOk());
    EXPECT_EQ(*decoded, response);
  }
}

TEST(FwMessageTest, TextsOfResponsesAreMadeHarmlessAndCut) {
  const FwResponse response = {
      absl::UnavailableError(absl::StrCat("a\nnote b\x1b[2J\xff", std::string(5000, 'x')))};
  const auto decoded = DecodeFwResponse(EncodeFwResponse(response));
  ASSERT_THAT(decoded, IsOk());
  EXPECT_THAT(decoded->status, StatusIs(absl::StatusCode::kUnavailable));
  EXPECT_THAT(std::string(decoded->status.message()), testing::StartsWith("a|note b?[2J?xxx"));
  EXPECT_EQ(decoded->status.message().size(), kFwTextBytesMax);
  EXPECT_EQ(decoded->note, "");
}

TEST(FwMessageTest, RefusesResponsesOfAnotherShape) {
  for (const absl::string_view packet :
       {"", "rips-fw 1\n", "rips-fw 1\ncode 17\n", "rips-fw 1\ncode -1\n", "rips-fw 1\ncode x\n",
        "rips-fw 1\ncode 0\ncode 0\n", "rips-fw 1\ncode 0\nmore x\n", "hello\ncode 0\n",
        "rips-fw 1\ncode 00\n", "rips-fw 1\ncode +0\n", "rips-fw 1\nnote x\ncode 0\n",
        "rips-fw 1\ncode 0\nnote \x1b[2J\n", "rips-fw 1\ncode 0\nmessage x\n"}) {
    EXPECT_THAT(DecodeFwResponse(packet), StatusIs(absl::StatusCode::kDataLoss)) << packet;
  }
}

}  // namespace
}  // namespace rips::actuator

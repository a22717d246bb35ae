#include "mode_actuator/steps/firewall/fw_message.h"

#include <functional>
#include <random>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/firewall/target.h"
#include "rips/v1/helper.pb.h"
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
      {FwVerb::kEnter, {.kind = Kind::kRules, .file = std::string(4096, '\xff')}},
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
    ASSERT_THAT(decoded, IsOk());
    EXPECT_EQ(*decoded, request);
    for (size_t length = 0; length < packet.size(); ++length) {
      EXPECT_THAT(DecodeFwRequest(absl::string_view(packet).substr(0, length)),
                  StatusIs(absl::StatusCode::kInvalidArgument))
          << length;
    }
  }
}

// `packet` as `edit` changes it.
template <typename Wire>
std::string Edited(const std::string& packet, const std::function<void(Wire&)>& edit) {
  Wire wire;
  EXPECT_TRUE(wire.ParseFromString(packet));
  edit(wire);
  return wire.SerializeAsString();
}

constexpr absl::string_view kUnknownField = "\x78\x01";  // field 15

TEST(FwMessageTest, RefusesRequestsOfAnotherShape) {
  using Wire = v1::FwRequest;
  const auto request = [](const FirewallStep& step) {
    return EncodeFwRequest({FwVerb::kEnter, step});
  };
  const std::string status = EncodeFwRequest({.verb = FwVerb::kStatus});
  const std::string release = request({.kind = Kind::kRelease});
  const std::string rules = request({.kind = Kind::kRules, .file = "/a"});
  const std::string hosts = request({.kind = Kind::kIsolateHosts, .targets = {"10.0.0.7"}});
  const absl::string_view shape = "unknown, missing, repeated or out of place";
  const struct {
    std::string packet;
    std::function<void(Wire&)> edit;
    absl::string_view message;
  } kCases[] = {
      {release, [](Wire& wire) { wire.clear_verb(); }, "no verb"},
      {release, [](Wire& wire) { wire.set_verb(static_cast<v1::FwVerb>(5)); }, "unknown verb"},
      {release, [](Wire& wire) { wire.set_verb(static_cast<v1::FwVerb>(-1)); }, "unknown verb"},
      {release, [](Wire& wire) { wire.set_verb(v1::FW_VERB_STATUS); }, shape},
      {release, [](Wire& wire) { wire.clear_kind(); }, "no kind"},
      {release, [](Wire& wire) { wire.set_kind(static_cast<v1::FwKind>(5)); }, "unknown kind"},
      {release, [](Wire& wire) { wire.set_file("/a"); }, shape},
      {release, [](Wire& wire) { wire.set_for_ms(5); }, shape},
      {release, [](Wire& wire) { wire.add_targets("10.0.0.7"); }, shape},
      {status, [](Wire& wire) { wire.set_verb(v1::FW_VERB_ENTER); }, "no kind"},
      {rules, [](Wire& wire) { wire.set_kind(v1::FW_KIND_RELEASE); }, shape},
      {rules, [](Wire& wire) { wire.set_kind(v1::FW_KIND_ISOLATE_HOSTS); }, "no target"},
      {rules, [](Wire& wire) { wire.clear_file(); }, "no file name"},
      {rules, [](Wire& wire) { wire.set_file(""); }, "no file name"},
      {rules, [](Wire& wire) { wire.set_file(std::string(4097, 'a')); }, "no file name"},
      {rules, [](Wire& wire) { wire.set_file(std::string("/a\0b", 4)); }, "no file name"},
      {rules, [](Wire& wire) { wire.set_file("/a\nb"); }, "no file name"},
      {rules, [](Wire& wire) { wire.add_targets("10.0.0.7"); }, shape},
      {rules, [](Wire& wire) { wire.clear_for_ms(); }, shape},
      {rules, [](Wire& wire) { wire.set_for_ms(0); }, "`for_ms` must be from 1 to 86400000"},
      {rules, [](Wire& wire) { wire.set_for_ms(-1); }, "`for_ms` must be"},
      {rules, [](Wire& wire) { wire.set_for_ms(86'400'001); }, "`for_ms` must be"},
      {rules, [](Wire& wire) { wire.set_for_ms(INT64_MAX); }, "`for_ms` must be"},
      {hosts, [](Wire& wire) { wire.set_kind(v1::FW_KIND_RULES); }, "no file name"},
      {hosts, [](Wire& wire) { wire.clear_targets(); }, "no target"},
      {hosts, [](Wire& wire) { wire.set_targets(0, ""); }, "no target"},
      {hosts, [](Wire& wire) { wire.set_targets(0, std::string(49, '1')); }, "no target"},
      {hosts, [](Wire& wire) { wire.set_targets(0, "10.0.0.7\n"); }, "no target"},
      {hosts, [](Wire& wire) { wire.set_file("/a"); }, shape},
      {hosts,
       [](Wire& wire) {
         for (size_t i = 0; i < kTargetsMax; ++i) wire.add_targets("10.0.0.7");
       },
       "targets exceed limit 64"},
  };
  for (const auto& test : kCases) {
    ASSERT_THAT(DecodeFwRequest(test.packet), IsOk());
    const std::string bad = Edited<Wire>(test.packet, test.edit);
    EXPECT_THAT(DecodeFwRequest(bad),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(test.message)))
        << testing::PrintToString(bad.substr(0, 80));
    EXPECT_THAT(DecodeFwRequest(absl::StrCat(test.packet, kUnknownField)),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(shape)));
  }
}

TEST(FwMessageTest, RefusesRequestsThatAreSerializedOtherwise) {
  const std::string release = EncodeFwRequest({FwVerb::kEnter, {.kind = Kind::kRelease}});
  ASSERT_EQ(release, "\x08\x01\x10\x04");
  for (const std::string& packet :
       {std::string("\x10\x04\x08\x01"), std::string("\x08\x81\x00\x10\x04", 5), release + release,
        std::string("\x08\x02") + release, release + std::string(1, '\0'), std::string(),
        std::string("rips-fw 1\nverb status\n"), std::string("\0\xff", 2),
        std::string("GET / HTTP/1.1\r\n\r\n")}) {
    EXPECT_THAT(DecodeFwRequest(packet), StatusIs(absl::StatusCode::kInvalidArgument))
        << testing::PrintToString(packet);
  }
  EXPECT_THAT(DecodeFwRequest(std::string(kFwPacketBytesMax + 1, 'x')),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("exceeds limit 8192")));
}

TEST(FwMessageTest, FlippedBytesAndGarbageAreRefusedOrCanonical) {
  std::mt19937 random(1);
  const auto check = [](const std::string& bytes) {
    if (const auto request = DecodeFwRequest(bytes); request.ok()) {
      EXPECT_EQ(EncodeFwRequest(*request), bytes);
    }
    if (const auto response = DecodeFwResponse(bytes); response.ok()) {
      EXPECT_EQ(EncodeFwResponse(*response), bytes);
    }
  };
  for (const std::string& good :
       {EncodeFwRequest({FwVerb::kTry, {.kind = Kind::kIsolateHosts, .targets = {"10.0.0.7"}}}),
        EncodeFwResponse({absl::InternalError("why"), "firewall=?", "note"})}) {
    for (int i = 0; i < 10'000; ++i) {
      std::string bad = good;
      bad[random() % bad.size()] = static_cast<char>(random());
      check(bad);
    }
  }
  for (int i = 0; i < 10'000; ++i) {
    std::string garbage(random() % 64, '\0');
    for (char& c : garbage) c = static_cast<char>(random());
    check(garbage);
  }
}

TEST(FwMessageTest, ResponsesComeBackAsTheyWere) {
  const FwResponse kResponses[] = {
      {},
      {absl::OkStatus(), "firewall=a.nft", "10.0.0.7 for 4s"},
      {absl::FailedPreconditionError("table deleted"), "firewall=?", ""},
      {absl::Status(absl::StatusCode::kUnauthenticated, std::string(kFwTextBytesMax, 'm')),
       std::string(kFwTextBytesMax, 'o'), std::string(kFwTextBytesMax, '~')},
  };
  for (const FwResponse& response : kResponses) {
    const std::string packet = EncodeFwResponse(response);
    EXPECT_LE(packet.size(), kFwPacketBytesMax);
    const auto decoded = DecodeFwResponse(packet);
    ASSERT_THAT(decoded, IsOk());
    EXPECT_EQ(*decoded, response);
    for (size_t length = 0; length < packet.size(); ++length) {
      EXPECT_THAT(DecodeFwResponse(absl::string_view(packet).substr(0, length)),
                  StatusIs(absl::StatusCode::kDataLoss))
          << length;
    }
  }
}

TEST(FwMessageTest, WhatWasDroppedComesBackOrIsAbsent) {
  const DropCount kCounts[] = {
      {},
      {.packets = 1240, .sources = {{"10.0.0.66", 1200, 2}, {"fd00::7", 40, 60}}},
      {.packets = UINT64_MAX,
       .sources = std::vector<model::DropSource>(
           model::kDropSourcesMax,
           {std::string(model::kDropAddressBytesMax, 'f'), UINT64_MAX, UINT32_MAX}),
       .more_sources = UINT32_MAX}};
  for (const DropCount& dropped : kCounts) {
    FwResponse response;
    response.observed = std::string(kFwTextBytesMax, 'o');
    response.note = std::string(kFwTextBytesMax, 'n');
    response.dropped = dropped;
    EXPECT_LE(EncodeFwResponse(response).size(), kFwPacketBytesMax);
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

// With a count of one source.
v1::FwResponse& Count(v1::FwResponse& wire) {
  wire.set_dropped(1);
  wire.set_more_sources(0);
  if (wire.sources_size() == 0) {
    v1::FwSource& source = *wire.add_sources();
    source.set_address("10.0.0.66");
    source.set_packets(1);
    source.set_quiet_s(2);
  }
  return wire;
}

TEST(FwMessageTest, RefusesResponsesOfAnotherShape) {
  using Wire = v1::FwResponse;
  const std::string good = EncodeFwResponse({absl::AbortedError("why"), "firewall=?", "note"});
  ASSERT_THAT(DecodeFwResponse(Edited<Wire>(good, [](Wire&) {})), IsOk());
  const std::function<void(Wire&)> kEdits[] = {
      [](Wire& wire) { wire.clear_code(); },
      [](Wire& wire) { wire.set_code(0); },  // which has no message
      [](Wire& wire) { wire.set_code(17); },
      [](Wire& wire) { wire.set_code(UINT32_MAX); },
      [](Wire& wire) { wire.clear_message(); },
      [](Wire& wire) { wire.set_message("a\nb"); },
      [](Wire& wire) { wire.set_message(std::string(kFwTextBytesMax + 1, 'x')); },
      [](Wire& wire) { wire.clear_observed(); },
      [](Wire& wire) { wire.set_observed("\xff"); },
      [](Wire& wire) { wire.clear_note(); },
      [](Wire& wire) { wire.set_note("\x1b[2J"); },
      [](Wire& wire) { wire.set_more_sources(0); },  // sources of nothing
      [](Wire& wire) { wire.add_sources(); },
      [](Wire& wire) { Count(wire).clear_more_sources(); },
      [](Wire& wire) { Count(wire).mutable_sources(0)->clear_quiet_s(); },
      [](Wire& wire) { Count(wire).mutable_sources(0)->set_address("\x1b[2J"); },
      [](Wire& wire) { Count(wire).mutable_sources(0)->set_address(std::string(46, '0')); },
      [](Wire& wire) {
        while (wire.sources_size() <= 24) *wire.add_sources() = Count(wire).sources(0);
      },
  };
  for (size_t i = 0; i < std::size(kEdits); ++i) {
    const std::string bad = Edited<Wire>(good, kEdits[i]);
    ASSERT_NE(bad, good) << i;
    EXPECT_THAT(DecodeFwResponse(bad), StatusIs(absl::StatusCode::kDataLoss)) << i;
  }
  EXPECT_THAT(DecodeFwResponse(absl::StrCat(good, kUnknownField)),
              StatusIs(absl::StatusCode::kDataLoss));
  for (const std::string& packet :
       {std::string("all is well"), std::string("rips-fw 1\ncode 0\n"), good + good,
        good + std::string("\x08\x0a"), std::string(kFwPacketBytesMax + 1, 'x')}) {
    EXPECT_THAT(DecodeFwResponse(packet), StatusIs(absl::StatusCode::kDataLoss));
  }
}

}  // namespace
}  // namespace rips::actuator

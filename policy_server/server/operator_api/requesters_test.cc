#include "policy_server/server/operator_api/requesters.h"

#include <optional>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"

namespace rips::operator_api {
namespace {

using ::testing::HasSubstr;

class RequestersTest : public ::testing::Test {
 protected:
  static rpc::Peer Alice(FakeClock& clock) {
    rpc::Peer peer;
    peer.identity = *rpc::ParseSpiffeUri("spiffe://td/operator/operator/alice");
    peer.serial = "0f";
    peer.not_after = absl::FromUnixNanos(clock.Now().unix_ns) + absl::Hours(1);
    return peer;
  }

  FakeClock clock_;
  bool revoked_ = false;
  rpc::CallGate gate_{&clock_,
                      [this](const rpc::Peer&) -> std::optional<rpc::Refusal> {
                        if (!revoked_) return std::nullopt;
                        return rpc::Refusal{"revoked", absl::UnauthenticatedError("revoked")};
                      },
                      nullptr};
  Requesters requesters_;
};

TEST_F(RequestersTest, AskedWithACertificateThatIsRevokedOrExpiredLater) {
  requesters_.Add("1", Alice(clock_));
  EXPECT_THAT(requesters_.Check("1", gate_), IsOk());
  revoked_ = true;
  EXPECT_THAT(requesters_.Check("1", gate_),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("(revoked)")));
  revoked_ = false;
  clock_.Advance(2 * 3'600 * kNanosPerSecond);
  EXPECT_THAT(requesters_.Check("1", gate_),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("(expired)")));
}

TEST_F(RequestersTest, ARequestIdIsOfOneOperatorAndCall) {
  EXPECT_EQ(RequestKey(Alice(clock_), "Raise", ""), "");
  EXPECT_NE(RequestKey(Alice(clock_), "Raise", "1"), RequestKey(Alice(clock_), "Approve", "1"));
  rpc::Peer bob = Alice(clock_);
  bob.identity.name = "bob";
  EXPECT_NE(RequestKey(Alice(clock_), "Raise", "1"), RequestKey(bob, "Raise", "1"));
}

TEST_F(RequestersTest, WhatIsNotKnownIsRefusedAndOnlyTheNewestAreKept) {
  EXPECT_THAT(requesters_.Check("1", gate_), StatusIs(absl::StatusCode::kNotFound));
  for (size_t i = 0; i <= Requesters::kMax; ++i) {
    requesters_.Add(absl::StrCat(i), Alice(clock_));
    requesters_.Add(absl::StrCat(i), Alice(clock_));  // repeated
  }
  EXPECT_THAT(requesters_.Check("0", gate_), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(requesters_.Check("1", gate_), IsOk());
}

}  // namespace
}  // namespace rips::operator_api
